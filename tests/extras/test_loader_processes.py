"""Loaders in processes of their own: killed trainings, threads, and the end of the interpreter."""

import gc
import multiprocessing
import random
import subprocess
import sys
import threading
from multiprocessing.connection import Connection
from multiprocessing.process import BaseProcess
from pathlib import Path
from typing import Any

import pytest
import torch
from torch.utils.data import DataLoader

from gcd_dataset.loaders import (
    Augmented,
    FakeGarments,
    FreshGarments,
    GarmentDataset,
    GarmentLoader,
    PointNoise,
    collate_list,
)
from tests.helpers import wait_until
from tests.loaders.test_loader import ids
from tests.loaders.test_shards import same
from tests.shards.folders import fill


@pytest.mark.parametrize("workers", [0, 1])
def test_a_run_killed_at_any_batch_resumes(workers: int, tmp_path: Path) -> None:
    """By a thread, and by a worker process, which the kill orphans."""
    ds = FakeGarments(10, fields=["meta"])
    stored = GarmentDataset(fill(tmp_path / "data", range(10)), fields=["meta"])
    require_resumed(ds if workers else stored, workers, tmp_path / "run.pt", kills=8)


def test_a_killed_training_leaves_no_workers() -> None:
    """Although their finished items overfill the pipe and are never read."""
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
    wait_until(lambda: not any(map(is_alive, workers)), seconds=120)


class Endless(FakeGarments):
    """All garments but the first few take forever."""

    def __getitem__(self, index: Any) -> Any:
        if index >= 4:
            threading.Event().wait()
        return super().__getitem__(index)


@pytest.mark.parametrize("ahead", [False, True])
def test_workers_exit_when_the_iterator_is_dropped(ahead: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    """Workers exit on their own; torch's shutdown would wait five seconds for each in turn."""
    monkeypatch.setattr(BaseProcess, "terminate", lambda worker: pytest.fail("waited for the workers"))
    ds = Endless(99, fields=["meta"])
    if ahead:
        loader = GarmentLoader(FreshGarments(ds, workers=2, room=1), 2, shuffle=False)
    else:
        loader = GarmentLoader(ds, 2, shuffle=False, num_workers=2)
    others = set(multiprocessing.active_children())
    next(batches := iter(loader))
    workers = set(multiprocessing.active_children()) - others
    assert len(workers) == 2
    del batches, loader
    gc.collect()
    assert [worker.exitcode for worker in workers] == [0, 0]


def is_alive(pid: int) -> bool:
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False


AT_THE_END = """
import torch
from gcd_dataset.workers import prefetch

def items():
    while True:
        yield torch.ones(1500, 1500) @ torch.ones(1500, 1500)

made = prefetch(items(), 99, wait=True)
next(made)
"""


def test_a_program_can_end_while_items_are_made() -> None:
    done = subprocess.run([sys.executable, "-c", AT_THE_END], capture_output=True, text=True, check=False, timeout=60)
    assert (done.returncode, done.stderr) == (0, "")


@pytest.mark.parametrize("method", ["fork", "spawn"])
def test_set_epoch_reaches_a_persistent_worker(method: str) -> None:
    ds = Augmented(FakeGarments(2, fields=["points"]), PointNoise(1.0))
    options: dict[str, Any] = {"num_workers": 1, "persistent_workers": True, "multiprocessing_context": method}
    loader = DataLoader(ds, batch_size=2, collate_fn=collate_list, **options)
    [first] = loader
    ds.set_epoch(1)
    [second] = loader
    assert not same(first, second)
    assert same(second, list(ds))


def test_box_meshes_do_not_import_warp() -> None:
    code = (
        "import sys; from gcd_dataset.loaders import GeneratedGarments; "
        "GeneratedGarments(2, drape=None, resolution=8.0, device='cuda:3').recipe(1); "
        "sys.exit('warp' in sys.modules)"
    )
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


def test_the_main_process_does_not_initialise_cuda() -> None:
    code = (
        "import sys, torch; torch.cuda.device_count = lambda: 2\n"
        "from gcd_dataset.loaders import ElasticSampler, FakeGarments, GarmentLoader, GeneratedGarments\n"
        "assert GeneratedGarments(2).config.device == 'cuda:0,1'\n"
        "sys.exit('warp' in sys.modules or torch.cuda.is_initialized())\n"
    )
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


def train(ds: Any, workers: int, epochs: int, log: Path, tell: Connection) -> None:
    """A training that logs its indices with its state, and resumes from the log."""
    loader = GarmentLoader(ds, 4, num_workers=workers)
    seen: list[int] = []
    if log.exists():
        kept = torch.load(log)
        seen = kept["seen"]
        loader.load_state_dict(kept["state"])
    while loader.epoch < epochs:
        for batch in loader:
            seen += ids(batch)
            torch.save({"seen": seen, "state": loader.state_dict()}, log.with_suffix(".part"))
            log.with_suffix(".part").replace(log)
            tell.send(len(seen))
    tell.send(None)


def require_resumed(ds: Any, workers: int, log: Path, *, kills: int) -> None:
    """Kill a training at ``kills`` random batches; the runs together must see the batches of one whole run."""
    chance, fork, epochs = random.Random(0), multiprocessing.get_context("fork"), kills

    def run(batches: int | None) -> None:
        """Resume the training, and kill it during the batch after ``batches`` more."""
        hear, tell = fork.Pipe(duplex=False)
        child = fork.Process(target=train, args=(ds, workers, epochs, log, tell))
        child.start()
        tell.close()
        received = 0
        while hear.recv() is not None:
            received += 1
            if received == batches:
                child.kill()
                break
        else:
            assert batches is None
        child.join()

    for _ in range(kills):
        run(chance.randint(1, 3))
    run(None)
    whole = GarmentLoader(ds, 4)
    assert torch.load(log)["seen"] == [number for _ in range(epochs) for batch in whole for number in ids(batch)]


class Uneven(FakeGarments):
    """Makes the last garment once ``last`` is set, the others immediately."""

    def __init__(self, count: int) -> None:
        super().__init__(count, fields=["meta"])
        self.last = multiprocessing.Event()

    def __getitem__(self, index: Any) -> Any:
        if index == len(self) - 1:
            self.last.wait()
        return super().__getitem__(index)


def test_a_worker_that_exits_early_does_not_block_the_end() -> None:
    ds = Uneven(4)
    made = iter(FreshGarments(ds, workers=2, room=1))
    given: list[int] = []

    def take() -> None:
        given.extend(item["meta"]["index"] for item in made)

    thread = threading.Thread(target=take, daemon=True)
    others = set(multiprocessing.active_children())
    given.append(next(made)["meta"]["index"])
    first, _ = sorted(set(multiprocessing.active_children()) - others, key=lambda worker: worker.pid or 0)
    thread.start()
    first.join(60)
    assert first.exitcode == 0
    ds.last.set()
    thread.join(60)
    assert not thread.is_alive()
    assert given == [0, 1, 2, 3]
