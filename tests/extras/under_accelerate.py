"""A program of two ranks: each of accelerate's ways to split the garments of a loader."""

import sys
from typing import Any

import torch
import torch.distributed as dist
from accelerate import Accelerator, DataLoaderConfiguration
from torch.utils.data import DataLoader

from gcd_dataset.errors import ConfigError
from gcd_dataset.loaders import ElasticSampler, GarmentDataset

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


def streamed(workers: int = 0) -> DataLoader:
    return DataLoader(stream, SIZE, num_workers=workers, collate_fn=numbers)


def require_refused(loader: Any, message: str) -> None:
    try:
        next(iter(loader))
    except ConfigError as error:
        assert message in str(error), error
    else:
        raise AssertionError(message)


Accelerator(cpu=True)
require_each_once("not prepared", sampled())
require_each_once("not prepared, stream", streamed())
for workers in (0, 2):
    for options in ({}, {"split_batches": True}, {"dispatch_batches": True}, {"even_batches": False}):
        loader = prepared(sampled(workers), **options)
        assert len(loader) == N // SIZE // (1 if options.get("split_batches") else 2), (options, len(loader))
        require_each_once(f"{options} {workers}", loader)
    require_each_once(f"a stream, {workers}", prepared(streamed(workers), dispatch_batches=False))
require_each_once("a stream, dispatched", prepared(streamed()))
require_each_once("all garments, explicitly", prepared(sampled(rank=0, world_size=1)))
require_refused(prepared(sampled(rank=dist.get_rank(), world_size=2)), "world_size=2: accelerate splits garments")
if dist.get_rank() == 0:  # rank 0 alone reads, and broadcasts to the other ranks
    require_refused(streamed(1), "streaming=True in workers with accelerate")

sampler = ElasticSampler(garments)
loader = prepared(DataLoader(garments, SIZE, sampler=sampler, num_workers=1, collate_fn=numbers))
seen = [number for _, batch in zip(range(2), loader, strict=False) for number in batch.tolist()]
state = sampler.state_dict(received=len(seen))
assert state["position"] == 2 * len(seen), state
again = ElasticSampler(garments)
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
