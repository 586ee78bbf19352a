"""Training on generated patterns: random draws and order depend on seeds, not on the way of loading."""

import pickle
import random
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from torch.utils.data import DataLoader, Dataset, DistributedSampler, Subset

from gcd_dataset.errors import ConfigError, TransformError
from gcd_dataset.loaders import (
    Augmented,
    ElasticSampler,
    FreshGarments,
    GarmentDataset,
    GarmentLoader,
    MixedDataset,
    Yaw,
    collate_list,
    collate_packed,
)
from gcd_dataset.loaders.loader import BatchMaker, Step
from tests.loaders.rendered import pattern_shards
from tests.loaders.test_loader import ids

N = 12


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """One shard."""
    return pattern_shards(tmp_path_factory.mktemp("patterns"), N)


@pytest.fixture(scope="module")
def three(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Shards of 5, 5 and 2 garments."""
    return pattern_shards(tmp_path_factory.mktemp("three"), N, shard_size=5)


def become(monkeypatch: pytest.MonkeyPatch, rank: int, world_size: int) -> None:
    """Set the environment of a rank started by ``torchrun``."""
    monkeypatch.setenv("RANK", str(rank))
    monkeypatch.setenv("WORLD_SIZE", str(world_size))


def every(loader: Any) -> list[int]:
    """Indices of all garments of an epoch."""
    return [number for batch in loader for number in ids(batch)]


def jittered(item: dict[str, Any]) -> dict[str, Any]:
    """A user's transform that draws from all three global streams."""
    noise = torch.rand(()) + np.random.rand() + random.random()  # noqa: NPY002
    return {**item, "noise": noise}


def jittered_batch(items: list[Any]) -> Any:
    return {**collate_packed(items), "noise": torch.rand(len(items))}


def trained(loader: Any) -> tuple[list[float], list[float]]:
    """Outputs of a model with dropout, and the random part of its inputs."""
    torch.manual_seed(3)
    sums, given = [], []
    for batch in loader:
        sums += [float(torch.nn.functional.dropout(torch.ones(50_000), 0.5).sum()) for _ in range(20)]
        given += [float(noise) for noise in batch.get("noise", ())]
    return sums, given


def test_loading_does_not_change_the_models_random_draws(folder: Path) -> None:
    plain = GarmentDataset(folder, fields=["panels", "meta"])
    changed = GarmentDataset(folder, fields=["panels", "meta"], transform=jittered)
    alone, _ = trained(GarmentLoader(plain, 2))
    _, noise = trained(GarmentLoader(changed, 2))
    assert len(set(noise)) == N
    for workers in (0, 0, 2):
        assert trained(GarmentLoader(changed, 2, num_workers=workers)) == (alone, noise)
    assert trained(GarmentLoader(plain, 2, collate_fn=jittered_batch))[0] == alone


def test_draws_of_a_transform_depend_on_seed_epoch_and_garment(folder: Path) -> None:
    """Equal in other batches and after a resume; different in the next epoch and with another seed."""

    def noise(loader: Any) -> dict[int, float]:
        drawn = [zip(ids(batch), batch["noise"], strict=True) for batch in loader]
        return {number: float(value) for batch in drawn for number, value in batch}

    ds = GarmentDataset(folder, fields=["meta"], transform=jittered)
    loader = GarmentLoader(ds, 2)
    first = noise(loader)
    assert first == noise(GarmentLoader(ds, 5)) == noise(GarmentLoader(ds[:], 3))
    assert not set(first.values()) & set(noise(loader).values())
    assert not set(first.values()) & set(noise(GarmentLoader(ds, 2, seed=1)).values())
    stopped, resumed = GarmentLoader(ds, 2), GarmentLoader(ds, 2)
    next(iter(stopped))
    resumed.load_state_dict(stopped.state_dict())
    assert noise(resumed).items() < first.items()


WRAPPED: list[Any] = [
    lambda ds: ds[2:],
    lambda ds: Augmented(ds, Yaw()),
    lambda ds: MixedDataset([ds, ds[::2]], [2, 1], transform=jittered),
]


@pytest.mark.parametrize(
    "wrapped", [*WRAPPED, lambda ds: Augmented(ds, lambda item, _: jittered(item)), lambda ds: Subset(ds, range(8))]
)
def test_loaded_items_equal_those_of_the_data_set(folder: Path, wrapped: Any) -> None:
    """A thread reads the items; the training thread transforms them."""
    fields = ["panels", "edges", "meta"]
    plain = wrapped(GarmentDataset(folder, fields=fields))
    marked = wrapped(
        GarmentDataset(folder, fields=fields, transform=lambda item: {**item, "mark": item["meta"]["index"]})
    )
    torch.manual_seed(0)
    before = torch.get_rng_state()
    batches = GarmentLoader(marked, 4, collate_fn=collate_list)
    for first, second in zip(batches, GarmentLoader(plain, 4, collate_fn=collate_list), strict=True):
        for item, without in zip(first, second, strict=True):
            assert item["mark"] == item["meta"]["index"] == without["meta"]["index"]
            assert torch.equal(item["panels"], without["panels"])
    assert torch.equal(torch.get_rng_state(), before)


@pytest.mark.parametrize("wrapped", [lambda ds: ds, *WRAPPED])
def test_the_batch_maker_can_be_pickled(folder: Path, wrapped: Any) -> None:
    """Spawned workers receive it pickled."""
    making = BatchMaker(wrapped(GarmentDataset(folder, fields=["meta"], transform=jittered)), collate_packed, 0)
    sent, turn = pickle.loads(pickle.dumps(making)), Step(2, [1, 1], 1, [3, 0])
    assert torch.equal(making.__getitems__(turn)[1]["noise"], sent.__getitems__(turn)[1]["noise"])


class UsersDataset(Dataset):
    """A user's data set that draws from the model's random stream."""

    def __len__(self) -> int:
        return 8

    def __getitem__(self, index: int) -> float:
        return index + float(torch.rand(()))


def test_users_data_sets_do_not_change_the_models_random_draws() -> None:
    loader = partial(GarmentLoader, UsersDataset(), 4, collate_fn=collate_list)
    torch.manual_seed(0)
    before = torch.get_rng_state()
    assert list(loader()) == list(loader()) == list(loader(num_workers=1))
    assert torch.equal(torch.get_rng_state(), before)


def test_the_rank_is_looked_up_at_each_pass(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A loader may be built before ``torchrun``'s environment or a framework sets the rank."""
    ds = GarmentDataset(folder, fields=["meta"])
    loaders = [GarmentLoader(ds, 2) for _ in range(2)]
    samplers = [ElasticSampler(ds) for _ in range(2)]
    fixed = GarmentLoader(ds, 2, rank=0, world_size=1)
    assert [len(loaders[0]), len(samplers[0])] == [6, 12]
    seen, numbers = [], []
    for rank in range(2):
        become(monkeypatch, rank, 2)
        assert [len(loaders[rank]), len(samplers[rank]), samplers[rank].rank] == [3, 6, rank]
        seen += every(loaders[rank])
        numbers += list(samplers[rank])
    assert sorted(seen) == sorted(numbers) == list(range(N))
    assert sorted(every(fixed)) == list(range(N))


def test_a_framework_sets_the_epoch() -> None:
    sampler = ElasticSampler(range(N))
    epochs = [list(sampler) for _ in range(4)]
    again = ElasticSampler(range(N))
    assert isinstance(again, DistributedSampler)  # else Lightning would replace it
    for epoch in (2, 0, 3, 3):
        again.set_epoch(epoch)
        assert list(again) == epochs[epoch]
    # A framework that counts epochs from 0 loads the state in epoch 1.
    resumed = ElasticSampler(range(N))
    resumed.load_state_dict({**again.state_dict(), "position": N + 5})
    for epoch, expected in enumerate((epochs[1][5:], epochs[2], epochs[3])):
        resumed.set_epoch(epoch)
        assert list(resumed) == expected
    with pytest.raises(ConfigError, match="epoch=-1"):
        sampler.set_epoch(-1)


@pytest.mark.parametrize("workers", [0, 1])
def test_a_broken_off_pass_is_not_continued(folder: Path, workers: int) -> None:
    """Lightning's sanity check takes two batches: the next pass covers the whole epoch."""
    ds = GarmentDataset(folder, fields=["meta"])
    loader = GarmentLoader(ds, 2, shuffle=False, num_workers=workers)
    for _, _ in zip(range(2), loader, strict=False):
        pass
    assert every(loader) == every(loader) == list(range(N))
    trained = GarmentLoader(ds, 2)
    epochs = [every(trained) for _ in range(3)]
    broken = GarmentLoader(ds, 2)
    starts = [ids(next(iter(broken))) for _ in range(3)]
    assert starts == [epoch[:2] for epoch in epochs]  # not the same garments each time
    unused = GarmentLoader(ds, 2)
    iter(unused), iter(unused)
    assert every(unused) == epochs[0]


def test_the_state_of_another_data_set_is_refused(folder: Path, tmp_path: Path) -> None:
    ds = GarmentDataset(folder, fields=["meta"])
    other = GarmentDataset(pattern_shards(tmp_path, N, seed=1), fields=["meta"])
    named = (
        r"its dataset is GarmentDataset of 12, seed 0, numbers 0 to 11 \('\w{16}'\), here it is GarmentDataset of "
        r"12, seed 1, numbers 0 to 11 \('\w{16}'\): load it with the same data set"
    )
    with pytest.raises(ConfigError, match=named):
        GarmentLoader(other, 2).load_state_dict(GarmentLoader(ds, 2).state_dict())
    pairs: list[tuple[Any, Any]] = [
        (FreshGarments(ds), FreshGarments(other)),
        (FreshGarments(ds), FreshGarments(ds, replay=2)),
        (FreshGarments(ds), FreshGarments(ds, seed=1)),
        (FreshGarments(ds), FreshGarments(ds, room=3)),
        (Subset(ds, [0, 1, 2]), Subset(ds, [0, 1, 3])),
        (Subset(ds, [0, 1]), Subset(other, [0, 1])),
        (ds[::2], ds[1::2]),
        (MixedDataset([ds], [1]), MixedDataset([ds], [1], seed=1)),
        (torch.utils.data.ConcatDataset([ds, ds]), torch.utils.data.ConcatDataset([ds, other])),
    ]
    for first, second in pairs:
        state, fresh = GarmentLoader(first, 1, shuffle=False).state_dict(), GarmentLoader(second, 1, shuffle=False)
        with pytest.raises(ConfigError, match=r"the state of another order: its (dataset|length) is"):
            fresh.load_state_dict(state)
        GarmentLoader(first, 1, shuffle=False).load_state_dict(state)


@pytest.mark.parametrize(
    "entry",
    [
        {"seed": np.zeros(3)},
        {"length": float("nan")},
        {"dataset": np.zeros((40, 40))},
        {"position": 2**70},
        {"position": -1},
        {"position": "8"},
    ],
)
def test_the_error_for_an_invalid_state_is_one_line(folder: Path, entry: dict[str, Any]) -> None:
    loader = GarmentLoader(GarmentDataset(folder, fields=["meta"]), 2)
    with pytest.raises(ConfigError, match=next(iter(entry))) as raised:
        loader.load_state_dict({**loader.state_dict(), **entry})
    assert "\n" not in str(raised.value)
    assert len(str(raised.value)) < 400
    none: tuple[Any, ...] = (None, [], 3, "state")
    for nothing in none:
        with pytest.raises(ConfigError, match=r"state .* is not a dict"):
            loader.load_state_dict(nothing)


@pytest.mark.parametrize(("world_size", "workers"), [(1, 0), (2, 3), (3, 0)])
def test_ranks_and_workers_split_a_stream_evenly(
    folder: Path, three: Path, monkeypatch: pytest.MonkeyPatch, world_size: int, workers: int
) -> None:
    for where in (folder, three):
        stream = GarmentDataset(where, fields=["meta"], streaming=True)
        seen, counts = [], []
        for rank in range(world_size):
            become(monkeypatch, rank, world_size)
            own = every(DataLoader(stream, 2, collate_fn=collate_packed, num_workers=workers))
            counts.append(len(own))
            seen += own
        assert sorted(seen) == list(range(N))
        assert max(counts) - min(counts) <= 1
        assert workers or seen == list(range(N))


def fails_at_7(item: dict[str, Any]) -> dict[str, Any]:
    if item["meta"]["index"] == 7:
        raise ZeroDivisionError("not\nthis one")
    return item


@pytest.mark.parametrize("streaming", [False, True])
def test_an_error_of_a_transform_names_the_garment(folder: Path, streaming: bool) -> None:
    """``__cause__`` is the original error; an error from a worker process has the same message."""
    ds = GarmentDataset(folder, "train[2:]", fields=["meta"], transform=fails_at_7, streaming=streaming)
    message = rf"the transform of gcd_000000007, number 5 of \w+\(train of {folder}\): ZeroDivisionError: not this one"
    ways: list[Any] = [ds, GarmentLoader(ds, 3)]
    if not streaming:
        ways += [ds.select([1, 5]), Augmented(ds, Yaw()), MixedDataset([ds], [1])]
    for way in ways:
        with pytest.raises(TransformError, match=message) as raised:
            for _ in way:
                pass
        assert isinstance(raised.value.__cause__, ZeroDivisionError)
    with pytest.raises(TransformError, match=message):
        list(DataLoader(ds, 3, num_workers=1, collate_fn=collate_list))
