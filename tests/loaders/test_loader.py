"""``GarmentLoader``: a run that is stopped at any batch and resumed elsewhere sees the same garments."""

import errno
import itertools
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from unittest.mock import Mock

import pytest
import torch
from torch.utils.data import DataLoader, Dataset, IterableDataset

from gcd_dataset.errors import ConfigError, ShardError
from gcd_dataset.loaders import (
    Augmented,
    ElasticSampler,
    FakeGarments,
    FreshGarments,
    GarmentDataset,
    GarmentLoader,
    Yaw,
    collate_list,
    collate_packed,
)
from gcd_dataset.workers import prefetch

N = 50


def garments(n: int = N, **options: Any) -> FakeGarments:
    return FakeGarments(n, fields=["meta"], **options)


def loaders(ranks: int, n: int = N, batch_size: int = 4, **options: Any) -> list[GarmentLoader]:
    return [GarmentLoader(garments(n), batch_size, rank=r, world_size=ranks, **options) for r in range(ranks)]


def ids(batch: Any) -> list[int]:
    """Indices of a batch's garments."""
    return [meta["index"] for meta in batch["meta"]]


def merged(ranks: list[GarmentLoader], steps: int | None = None) -> list[int]:
    """Indices of ``steps`` batches, or of the rest of the epoch, over all ranks, ordered by position."""
    seen: list[int] = []
    streams = [iter(rank) for rank in ranks]
    while steps is None or steps > 0:
        batches = [batch for stream in streams if (batch := next(stream, None)) is not None]
        if not batches:
            return seen
        assert len(batches) == len(ranks)  # no rank waits for another
        seen += [number for turn in zip(*map(ids, batches), strict=True) for number in turn]
        steps = None if steps is None else steps - 1
    return seen


ORDER = merged(loaders(1))


@pytest.mark.parametrize(
    ("dataset", "folder"), [("garments", "'garments'"), (FakeGarments, "…"), (None, "…"), (iter(garments()), "…")]
)
def test_anything_but_a_data_set_is_refused_at_once(dataset: Any, folder: str) -> None:
    for make in (lambda: GarmentLoader(dataset, 2), lambda: ElasticSampler(dataset)):
        with pytest.raises(ConfigError, match=rf"dataset=.*give GarmentDataset\({folder}\) or"):
            make()


def test_sizes_are_whole_numbers() -> None:
    sizes: tuple[Any, ...] = (0, -2, 1.5, "8", None, True)
    for batch_size in sizes:
        with pytest.raises(ConfigError, match=r"batch_size=.*: give a whole number, 1 or more"):
            GarmentLoader(garments(), batch_size)
    for workers in (-1, *sizes[2:]):
        with pytest.raises(ConfigError, match=rf"num_workers={workers!r}: give a whole number, 0 or more"):
            GarmentLoader(garments(), 4, num_workers=workers)


@pytest.mark.parametrize(
    "collate", [collate_packed, collate_list, lambda items: tuple(item["verts"] for item in items)]
)
def test_a_batch_without_room_in_shared_memory_is_an_error(monkeypatch: pytest.MonkeyPatch, collate: Any) -> None:
    """torch's thread in the worker would print it, and the training would wait forever."""
    ds = FakeGarments(4, fields=["verts"])
    makers: list[Any] = [
        GarmentLoader(ds, 2, num_workers=1, collate_fn=collate),
        *([] if collate.__name__ == "<lambda>" else [DataLoader(ds, 2, num_workers=1, collate_fn=collate)]),
        FreshGarments(ds, workers=1),
    ]
    full = RuntimeError("unable to allocate shared memory(shm) for file </torch_1>: No space left on device (28)")
    monkeypatch.setattr(torch.Tensor, "share_memory_", Mock(side_effect=full))
    for made in makers:
        with pytest.raises(ConfigError, match=r"shared memory \(/dev/shm\) is full.*num_workers=0.*--shm-size"):
            next(iter(made))
    assert len(list(GarmentLoader(ds, 2, collate_fn=collate))) == 2
    with pytest.raises(ConfigError, match="shared memory"):
        Augmented(ds, Yaw())


def test_shared_memory_without_room_for_queues_is_recognised_before_workers_start(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    full = Mock(side_effect=OSError(errno.ENOSPC, "No space left on device"))
    monkeypatch.setattr("multiprocessing.context.BaseContext.Semaphore", full)
    with pytest.raises(ConfigError, match=r"shared memory \(/dev/shm\) is full.*num_workers=0.*--shm-size"):
        GarmentLoader(garments(), 2, num_workers=1)
    with pytest.raises(ConfigError, match=r"shared memory \(/dev/shm\) is full"):
        next(iter(FreshGarments(garments(), workers=1)))
    assert len(GarmentLoader(garments(), 5)) == 10


def test_an_epoch_holds_every_garment_once_and_epochs_follow_on() -> None:
    loader = GarmentLoader(garments(), 8)
    epochs = [[ids(batch) for batch in loader] for _ in range(3)]
    assert [len(epoch) for epoch in epochs] == 3 * [len(loader)] == [7, 7, 7]
    flat = [[number for batch in epoch for number in batch] for epoch in epochs]
    assert all(sorted(epoch) == list(range(N)) for epoch in flat)
    assert len({tuple(epoch) for epoch in flat}) == 3
    assert loader.epoch == 3
    assert flat[0] == ORDER


def test_the_state_counts_received_batches() -> None:
    """Two workers have made four batches when the loop has received one."""
    loader = GarmentLoader(garments(), 4, num_workers=2)
    batches = iter(loader)
    assert loader.state_dict()["position"] == 0
    for count in (1, 2, 3):
        next(batches)
        assert loader.state_dict()["position"] == 4 * count


@pytest.mark.parametrize("stop", [1, 7, 12, 13])
def test_a_stopped_run_resumes(stop: int) -> None:
    first = GarmentLoader(garments(), 4)
    seen = [number for _, batch in zip(range(stop), first, strict=False) for number in ids(batch)]
    second = GarmentLoader(garments(), 4)
    second.load_state_dict(first.state_dict())
    rest = [number for batch in second for number in ids(batch)]
    if stop == 13:  # the whole epoch: the next one follows
        assert (seen, second.epoch) == (ORDER, 2)
        assert sorted(rest) == sorted(ORDER)
    else:
        assert seen + rest == ORDER


def test_three_ranks_resume_the_state_of_four() -> None:
    four = loaders(4, batch_size=2)
    seen = merged(four, steps=3)
    states = [rank.state_dict() for rank in four]
    assert states == 4 * [states[0]]
    three = loaders(3, batch_size=5)
    for rank in three:
        rank.load_state_dict(states[0])
    seen += merged(three)
    assert seen == ORDER[: len(seen)]
    assert N - len(seen) < 3
    assert {rank.state_dict()["position"] for rank in three} == {N}


def test_a_rest_smaller_than_the_ranks_is_skipped() -> None:
    three = loaders(3)
    for rank in three:
        rank.load_state_dict({**rank.state_dict(), "position": N - 2})
    assert len(merged(three)) == N - N % 3
    assert {rank.epoch for rank in three} == {2}


def test_padding_is_marked() -> None:
    ranks = loaders(4, n=10, batch_size=2, pad="repeat")
    batches = [list(rank) for rank in ranks]
    assert [len(mine) for mine in batches] == 4 * [2]
    assert [batch["repeated"].tolist() for batch in batches[1]] == [[False, False], [False]]
    assert [batch["repeated"].tolist() for batch in batches[3]] == [[False, False], [True]]
    real = [n for mine in batches for b in mine for n, again in zip(ids(b), b["repeated"], strict=True) if not again]
    assert sorted(real) == list(range(10))


def test_drop_last_leaves_out_the_smaller_batch() -> None:
    loader = GarmentLoader(garments(), 8, drop_last=True)
    assert [len(ids(batch)) for batch in loader] == len(loader) * [8] == 6 * [8]
    assert loader.state_dict()["position"] == N
    with pytest.raises(ConfigError, match="no rank has 51 of 50 garments: leave out drop_last"):
        GarmentLoader(garments(), 51, drop_last=True)


@pytest.mark.parametrize("workers", [0, 2])
def test_an_iterator_from_before_load_state_dict_is_refused(workers: int) -> None:
    state = {**GarmentLoader(garments(), 4).state_dict(), "position": 8}
    loader = GarmentLoader(garments(), 4, num_workers=workers)
    unused, used = iter(loader), iter(loader)
    next(used)
    loader.load_state_dict(state)
    for early in (unused, used):
        with pytest.raises(ConfigError, match=r"ended with a later iter\(\) or load_state_dict\(\): take batches"):
            next(early)
    assert ids(next(iter(loader))) == ORDER[8:12]


def test_garments_made_on_demand_and_read_from_shards_have_one_state(folder: Path) -> None:
    stored = GarmentLoader(GarmentDataset(folder, fields=["meta"]), 4)
    stored.load_state_dict(GarmentLoader(garments(10), 4).state_dict())


class Broken(Dataset):
    """Integers, one of which raises."""

    def __len__(self) -> int:
        return 8

    def __getitem__(self, index: int) -> int:
        if index == 5:
            raise ShardError("torn")
        return index


@pytest.mark.parametrize("workers", [0, 1])
def test_an_error_names_the_garment(workers: int) -> None:
    loader = GarmentLoader(Broken(), 4, shuffle=False, num_workers=workers, collate_fn=collate_list)
    batches = iter(loader)
    assert next(batches) == [0, 1, 2, 3]
    with pytest.raises(ShardError, match="while loading garment 5 of Broken"):
        next(batches)
    assert loader.state_dict()["position"] == 4


class Count(IterableDataset):
    """0, 1, … 10, in each epoch."""

    def __len__(self) -> int:
        return 11

    def __iter__(self) -> Iterator[int]:
        return self.begin_at(0)

    def begin_at(self, position: int) -> Iterator[int]:
        return iter(range(position % 11, 11))


class Endless(IterableDataset):
    def __iter__(self) -> Iterator[int]:
        return itertools.count()


def stream(**options: Any) -> GarmentLoader:
    return GarmentLoader(Count(), 3, shuffle=False, collate_fn=collate_list, **options)


def test_ranks_split_a_stream_and_resume_it() -> None:
    assert list(stream()) == [[0, 1, 2], [3, 4, 5], [6, 7, 8], [9, 10]]
    ranks = [stream(rank=rank, world_size=2) for rank in (0, 1)]
    assert [list(rank) for rank in ranks] == [[[0, 2, 4], [6, 8]], [[1, 3, 5], [7, 9]]]
    first, second = stream(rank=0, world_size=2), stream()
    next(iter(first))
    second.load_state_dict(first.state_dict())
    assert list(second) == [[6, 7, 8], [9, 10]]
    assert list(second) == list(stream())  # the next pass
    done = stream()
    for _ in done:
        state = done.state_dict()
    second.load_state_dict(state)
    assert list(second) == list(stream())  # no item was left


def test_options_that_a_stream_lacks_are_refused() -> None:
    for options, message in (
        ({}, "a stream has its own order"),
        ({"shuffle": False, "num_workers": 2}, "each worker would read the whole stream"),
        ({"shuffle": False, "pad": "repeat"}, "cannot repeat its first items"),
    ):
        with pytest.raises(ConfigError, match=message):
            GarmentLoader(Count(), 3, **options)
    with pytest.raises(ConfigError, match="Endless is a stream: give FreshGarments"):
        GarmentLoader(Endless(), 3, shuffle=False)


def test_the_thread_makes_no_more_items_than_the_queue_holds() -> None:
    taken, ahead = 0, []

    def items() -> Iterator[int]:
        for number in range(50):
            ahead.append(number + 1 - taken)
            yield number

    for number, item in enumerate(prefetch(items(), 3)):
        assert item == number
        taken = number + 1
    assert taken == 50
    assert max(ahead) <= 3 + 1  # taking an item has freed a slot


@pytest.mark.parametrize("wait", [False, True])
def test_closing_the_iterator_ends_the_thread(wait: bool) -> None:
    threads: list[threading.Thread] = []

    def items() -> Iterator[int]:
        threads.append(threading.current_thread())
        while True:
            yield 0

    ahead = prefetch(items(), 2, wait=wait)
    next(ahead)
    ahead.close()
    if not wait:
        threads[0].join(60)
    assert not threads[0].is_alive()


@pytest.mark.parametrize("error", [ValueError, SystemExit])
def test_an_error_or_an_exit_comes_after_the_items_before_it(error: type[BaseException]) -> None:
    """``SystemExit``, ``KeyboardInterrupt`` and the like are no ``Exception``."""

    def items() -> Iterator[int]:
        yield from (0, 1)
        raise error("the third")

    taken: list[Any] = []

    def take() -> None:
        try:
            taken.extend(prefetch(items(), 8))
        except error as raised:
            taken.append(str(raised))

    thread = threading.Thread(target=take, daemon=True)
    thread.start()
    thread.join(60)
    assert taken == [0, 1, "the third"]
