"""Garments made ahead of a training, and given several times."""

import multiprocessing
import os
import signal
import subprocess
import sys
import threading
import time
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from torch.utils.data import DataLoader

from gcd_dataset.errors import ConfigError
from gcd_dataset.generator.pipeline import prepare
from gcd_dataset.loaders import FakeGarments, FreshGarments, GarmentLoader, GeneratedGarments, PointNoise
from tests.loaders.test_shards import assert_all_same, same


def fresh(n: int = 20, **options: Any) -> FreshGarments:
    return FreshGarments(FakeGarments(n, fields=["meta"]), **options)


def numbers(garments: FreshGarments) -> list[int]:
    return [item["meta"]["index"] for item in garments]


@pytest.mark.parametrize(("replay", "times"), [(1, {1}), (3, {3}), (2.5, {2, 3})])
def test_each_is_given_as_often_as_asked(replay: float, times: set[int]) -> None:
    garments = fresh(replay=replay, room=6)
    given = numbers(garments)
    assert len(given) == len(garments) == 20 * replay
    assert set(Counter(given)) == set(range(20))
    assert set(Counter(given).values()) == times


def test_workers_change_nothing() -> None:
    alone = numbers(fresh(replay=2, room=4))
    assert alone == numbers(fresh(replay=2, room=4))
    assert alone == numbers(fresh(replay=2, room=4, workers=2))
    assert alone != numbers(fresh(replay=2, room=4, seed=1))


def test_no_more_are_held_than_there_is_room_for() -> None:
    given: set[int] = set()
    counts: Counter[int] = Counter()
    for number in numbers(fresh(50, replay=4, room=5)):
        given.add(number)
        counts[number] += 1
        # Of those made so far all but the last five have been given as often as they should.
        assert sum(counts[n] < 4 for n in range(max(given) + 1)) <= 5


def test_each_time_it_is_changed_otherwise() -> None:
    garments = FreshGarments(FakeGarments(1), replay=2, augment=PointNoise(1.0))
    first, second = garments
    assert same(first["verts"], second["verts"])
    assert not same(first["points"], second["points"])
    assert_all_same(garments, [first, second])


def test_they_are_loaded_in_batches() -> None:
    batches = list(GarmentLoader(fresh(8, replay=2, room=4), 4, shuffle=False))
    assert [meta["index"] for batch in batches for meta in batch["meta"]] == numbers(fresh(8, replay=2, room=4))


def test_workers_of_the_loader_are_refused() -> None:
    with pytest.raises(ConfigError, match="num_workers=0"):
        next(iter(DataLoader(fresh(), batch_size=None, num_workers=1)))
    for options in ({"replay": 0.5}, {"replay": float("nan")}, {"room": 0}):
        with pytest.raises(ConfigError):
            fresh(**options)


def test_what_a_worker_has_made_is_taken_without_its_answer() -> None:
    """It is at work on the next garment, and would answer late: here it is stopped."""
    others = set(multiprocessing.active_children())
    made = iter(FreshGarments(FakeGarments(9, fields=["meta", "verts"]), room=1, workers=1))
    next(made)
    [worker] = set(multiprocessing.active_children()) - others
    assert worker.pid is not None
    wait_until_idle(worker.pid)  # it has made the next meanwhile
    os.kill(worker.pid, signal.SIGSTOP)
    goes_on = threading.Timer(30.0, os.kill, (worker.pid, signal.SIGCONT))
    goes_on.start()
    item = next(made)
    assert goes_on.is_alive(), "it was waited for"
    goes_on.cancel()
    os.kill(worker.pid, signal.SIGCONT)
    assert item["verts"].isfinite().all()


def test_memory_does_not_grow_with_garments_made() -> None:
    made = iter(FreshGarments(GeneratedGarments(200, stage="pattern", fields=["meta", "panels", "edges"]), room=8))
    for _ in range(60):
        next(made)
    before = resident()
    assert sum(1 for _ in made) == 140
    assert resident() - before < 8 << 20


def wait_until_idle(pid: int) -> None:
    """Until a process has used no CPU time for half a second."""
    used, still = "", 0
    while still < 10:
        fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
        now = f"{fields[0]} {fields[11]} {fields[12]}"  # state, ticks as user, ticks in the kernel
        still = still + 1 if now == used and fields[0] == "S" else 0
        used = now
        time.sleep(0.05)


def resident() -> int:
    """Bytes of memory that this process holds."""
    with open("/proc/self/statm") as file:  # noqa: PTH123
        return int(file.read().split()[1]) * 4096


def test_a_design_is_made_once_for_all_its_bodies(monkeypatch: pytest.MonkeyPatch) -> None:
    """By one worker, whatever their number: else one would have the neutral bodies and the other the random ones."""
    designs = multiprocessing.Value("i", 0)

    def counted(*options: Any) -> Any:
        with designs.get_lock():
            designs.value += 1
        return prepare(*options)

    monkeypatch.setattr("gcd_dataset.generator.pipeline.prepare", counted)
    whole = GeneratedGarments(5, seed=5, bodies="both", stage="pattern", fields=["panels", "body"])
    made = list(FreshGarments(whole, room=1, workers=2))
    assert designs.value == 3
    assert_all_same(made, [whole[index] for index in range(5)])


def test_different_ranks_make_different_garments() -> None:
    whole = FakeGarments(9, fields=["meta"])
    ranks = [numbers(FreshGarments(whole.select(range(rank, 9, 2)))) for rank in range(2)]
    assert np.array_equal(sorted(ranks[0] + ranks[1]), np.arange(9))


def test_a_killed_training_leaves_no_workers() -> None:
    """Though nobody takes what they have made, which is more than the pipe to the training holds."""
    code = (
        "import multiprocessing, os, signal\n"
        "from gcd_dataset.loaders import FakeGarments, FreshGarments\n"
        "ds = FakeGarments(99, fields=['meta'], transform=lambda item: 1_000_000 * 'a')\n"
        "next(made := iter(FreshGarments(ds, workers=2, room=1)))\n"
        "print(*(worker.pid for worker in multiprocessing.active_children()), flush=True)\n"
        "os.kill(os.getpid(), signal.SIGKILL)\n"
    )
    with subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, text=True) as training:
        assert training.stdout is not None
        workers = [int(pid) for pid in training.stdout.readline().split()]
    assert len(workers) == 2
    deadline = time.monotonic() + 120
    while any(map(is_alive, workers)) and time.monotonic() < deadline:
        time.sleep(0.1)
    assert [pid for pid in workers if is_alive(pid)] == []


def is_alive(pid: int) -> bool:
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False
