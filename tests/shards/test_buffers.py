"""Read buffers are reused, but never while an array refers to them."""

import multiprocessing
import random
from collections import defaultdict
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
import torch

from gcd_dataset.shards import buffers
from gcd_dataset.shards.buffers import read_buffer

LARGE = 100_000


def marked(number: int, size: int) -> np.ndarray:
    memory = read_buffer(size)
    memory[:] = number % 251
    return memory


def test_buffers_in_use_are_not_shared() -> None:
    chance, held = random.Random(0), dict[int, np.ndarray]()
    for number in range(2000):
        held[number] = marked(number, chance.choice([100, LARGE, 3 * LARGE]))
        if len(held) > 20:
            del held[chance.choice(list(held))]
        assert all((memory == number % 251).all() for number, memory in list(held.items())[-3:])
    assert all((memory == number % 251).all() for number, memory in held.items())


def test_a_view_keeps_its_buffer() -> None:
    tensor = torch.from_numpy(read_buffer(LARGE)).view(torch.float32)[5:9]
    tensor.fill_(7.0)
    others = [marked(0, LARGE) for _ in range(10)]
    assert tensor.tolist() == 4 * [7.0]
    assert len({memory.ctypes.data for memory in others}) == 10


def test_free_buffers_are_reused() -> None:
    first, second = read_buffer(LARGE), read_buffer(LARGE)
    places = {first.ctypes.data, second.ctypes.data}
    del first, second
    again = [read_buffer(LARGE + 1), read_buffer(LARGE - 1)]
    assert {memory.ctypes.data for memory in again} == places


def test_the_pool_is_limited(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(buffers, "MOST_KEPT", 3 << 17)
    monkeypatch.setattr(buffers, "_kept", defaultdict(list))
    memories = [read_buffer(LARGE) for _ in range(9)]
    assert len({memory.ctypes.data for memory in memories}) == 9
    del memories
    assert [len(kept) for kept in buffers._kept.values()] == [3]


def _sums(sizes: Sequence[int]) -> list[int]:
    return [int(marked(number, size).sum(dtype=np.int64)) for number, size in enumerate(sizes)]


def test_threads_and_forked_processes_do_not_share_buffers() -> None:
    sizes = [LARGE + number for number in range(60)]
    expected = [number % 251 * size for number, size in enumerate(sizes)]
    with ThreadPoolExecutor(4) as threads:
        assert all(sums == expected for sums in threads.map(_sums, 8 * [sizes]))
    held = marked(9, LARGE)
    with multiprocessing.get_context("fork").Pool(2) as processes:
        assert all(sums == expected for sums in processes.map(_sums, 4 * [sizes]))
    assert (held == 9).all()
