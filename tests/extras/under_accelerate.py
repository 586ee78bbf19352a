"""A program of two ranks: each of accelerate's ways to split the garments of a loader, and those that are refused."""

import sys
from typing import Any

import torch
import torch.distributed as dist
from accelerate import Accelerator, DataLoaderConfiguration
from torch.utils.data import DataLoader

from gcd_dataset.errors import ConfigError
from gcd_dataset.loaders import ElasticSampler, GarmentDataset, GarmentLoader

garments = GarmentDataset(sys.argv[1], fields=["meta"])
stream = GarmentDataset(sys.argv[1], fields=["meta"], streaming=True)
N, SIZE = len(garments), 4


def numbers(items: list[Any]) -> torch.Tensor:
    return torch.tensor([item["meta"]["index"] for item in items])


def prepared(loader: DataLoader, **options: Any) -> Any:
    accelerator = Accelerator(cpu=True, dataloader_config=DataLoaderConfiguration(**options))
    return accelerator.prepare(loader)


def require_each_once(name: str, loader: Any) -> None:
    """Require each garment once, for two epochs."""
    for epoch in range(2):
        own = [number for batch in loader for number in batch.tolist()]
        every: list[Any] = [None] * dist.get_world_size()
        dist.all_gather_object(every, own)
        assert sorted(number for part in every for number in part) == list(range(N)), (name, epoch, every)
        assert {len(part) for part in every} == {N // 2}, (name, every)


def sampled(workers: int = 0, **options: Any) -> DataLoader:
    return DataLoader(
        garments, SIZE, sampler=ElasticSampler(garments, **options), num_workers=workers, collate_fn=numbers
    )


def require_refused(loader: Any, message: str) -> None:
    try:
        next(iter(loader))
    except ConfigError as error:
        assert message in str(error), error
    else:
        raise AssertionError(message)


Accelerator(cpu=True)
whole: dict[str, Any] = {"rank": 0, "world_size": 1}
CASES: list[tuple[int, dict[str, bool]]] = [
    (0, {}),
    (2, {}),
    (0, {"split_batches": True}),
    (2, {"dispatch_batches": True}),
    (0, {"even_batches": False}),
]
for workers, options in CASES:
    loader = prepared(sampled(workers, **whole), **options)
    assert len(loader) == N // SIZE // (1 if options.get("split_batches") else 2), (options, len(loader))
    require_each_once(f"{options} {workers}", loader)
for given in ({}, {"rank": dist.get_rank(), "world_size": 2}):
    require_refused(sampled(**given), "give rank=0, world_size=1")
require_refused(DataLoader(stream, SIZE, collate_fn=numbers), "streaming=True with 2 processes of accelerate")
require_each_once("a GarmentLoader", GarmentLoader(garments, SIZE, collate_fn=numbers))
require_each_once("a GarmentLoader of a stream", GarmentLoader(stream, SIZE, shuffle=False, collate_fn=numbers))

sampler = ElasticSampler(garments, **whole)
loader = prepared(DataLoader(garments, SIZE, sampler=sampler, num_workers=1, collate_fn=numbers))
seen = [number for _, batch in zip(range(2), loader, strict=False) for number in batch.tolist()]
state = sampler.state_dict(received=2 * len(seen))
assert state["position"] == 2 * len(seen), state
again = ElasticSampler(garments, **whole)
again.load_state_dict(state)
seen += [
    number
    for batch in prepared(DataLoader(garments, SIZE, sampler=again, collate_fn=numbers))
    for number in batch.tolist()
]
every: list[Any] = [None] * 2
dist.all_gather_object(every, seen)
assert sorted(number for part in every for number in part) == list(range(N)), every
print(f"rank {dist.get_rank()}: every loader yielded each garment once", flush=True)
dist.barrier()
dist.destroy_process_group()
