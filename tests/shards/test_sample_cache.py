"""The sample cache of several processes is a valid data set at any time, also after kills."""

import multiprocessing
import os
import signal
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from gcd_dataset.errors import ShardError
from gcd_dataset.files import make_folder
from gcd_dataset.loaders import GarmentDataset
from gcd_dataset.loaders.fake import fake_sample
from gcd_dataset.shards import ShardWriter, encode_sample
from gcd_dataset.shards.layout import MEMBERS
from gcd_dataset.shards.sample_cache import SampleCache
from tests.shards.folders import RECIPE, SHARD_SIZE, fill

CONTEXT = multiprocessing.get_context("fork")


def kept(folder: Path, count: int = 10) -> SampleCache:
    return SampleCache(folder, count, seed=0, recipe=RECIPE, shard_size=SHARD_SIZE)


def members(index: int) -> dict[str, bytes]:
    return encode_sample(fake_sample(0, index))


def keep(folder: Path, indices: Iterable[int], count: int = 10) -> None:
    for index in indices:
        kept(folder, count).keep(index, members(index))


def names(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir() if path.suffix == ".tar")


def content(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in folder.iterdir() if path.is_file()}


def test_the_last_sample_of_a_shard_triggers_its_writing(tmp_path: Path) -> None:
    samples = kept(tmp_path)
    for index in (9, 2, 0, 3):
        samples.keep(index, members(index))
    assert names(tmp_path) == []
    with pytest.raises(ShardError, match="4 samples wait for the rest of their shard"):
        GarmentDataset(tmp_path)
    samples.keep(1, members(1))
    assert names(tmp_path) == ["train-00000.tar"]
    samples.keep(8, members(8))  # the last shard has two samples
    assert names(tmp_path) == ["train-00000.tar", "train-00002.tar"]
    assert [index for index in range(10) if samples.read(index) is None] == [4, 5, 6, 7]
    for index in (0, 3, 9):
        assert samples.read(index, MEMBERS) == members(index)
    assert set(samples.read(2, ("box.npy",)) or ()) >= {"box.npy"}


def test_the_folder_equals_a_writers_folder(tmp_path: Path) -> None:
    keep(tmp_path / "kept", [7, 1, 5, 3, 9, 0, 2, 8, 6, 4])
    written = fill(tmp_path / "written", range(10))
    assert content(tmp_path / "kept") == content(written)
    GarmentDataset(tmp_path / "kept", verify="full")


def test_several_processes_add_each_sample_once(tmp_path: Path) -> None:
    workers = [CONTEXT.Process(target=keep, args=(tmp_path, range(part, 10, 3))) for part in range(3)]
    for worker in workers:
        worker.start()
    for worker in workers:
        worker.join(60)
        assert worker.exitcode == 0
    dataset = GarmentDataset(tmp_path, fields=["meta"], verify="full")
    assert [dataset[i]["meta"]["index"] for i in range(len(dataset))] == list(range(10))


def test_samples_packed_by_another_process_are_found(tmp_path: Path) -> None:
    early = kept(tmp_path)
    keep(tmp_path, [0, 1, 2])
    assert early.read(1) == members(1)
    keep(tmp_path, [3])
    for index in range(4):
        assert early.read(index) == members(index)
    keep(tmp_path, [4, 5, 6, 7])
    assert early.read(6) == members(6)


def test_a_thread_may_read_during_a_refresh(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    samples = kept(tmp_path)
    keep(tmp_path, range(4, 8))
    assert samples.read(5) == members(5)
    keep(tmp_path, range(4))  # a shard before the known samples
    sort, meanwhile = np.sort, []

    def sort_and_read(numbers: Any) -> Any:
        monkeypatch.undo()
        meanwhile.append(samples.read(5))
        return sort(numbers)

    monkeypatch.setattr(np, "sort", sort_and_read)
    assert samples.read(0) == members(0)
    assert meanwhile == [members(5)]


def test_a_killed_process_loses_no_cached_sample(tmp_path: Path) -> None:
    def fsync(fd: Any) -> None:
        if "train-" in str(Path(f"/proc/self/fd/{fd}").readlink()):
            os.kill(os.getpid(), signal.SIGKILL)

    def killed_while_packing() -> None:
        os.fsync = fsync
        keep(tmp_path, range(4))

    worker = CONTEXT.Process(target=killed_while_packing)
    worker.start()
    worker.join(60)
    assert worker.exitcode == -signal.SIGKILL
    assert names(tmp_path) == []
    samples = kept(tmp_path)
    assert all(samples.read(index) == members(index) for index in range(4))
    samples.pack()
    assert names(tmp_path) == ["train-00000.tar"]
    assert not (tmp_path / ".waiting" / "00000").exists()


def test_two_processes_may_add_the_same_sample(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Between the creation of folder and file, the other process packs the shard and removes the folder."""
    keep(tmp_path, [0, 1, 2])

    def late(path: Path) -> Path:
        make_folder(path)
        monkeypatch.undo()
        keep(tmp_path, [3])
        return path

    monkeypatch.setattr("gcd_dataset.shards.sample_cache.make_folder", late)
    keep(tmp_path, [3])
    assert names(tmp_path) == ["train-00000.tar"]
    assert len(GarmentDataset(tmp_path, verify="full")) == 4
    assert not list((tmp_path / ".waiting").iterdir())


def test_packed_samples_can_be_added_to(tmp_path: Path) -> None:
    keep(tmp_path, [0, 2, 5])
    kept(tmp_path).pack()
    assert names(tmp_path) == ["train-00000.tar", "train-00001.tar"]
    assert len(GarmentDataset(tmp_path)) == 3
    keep(tmp_path, [1, 3])
    assert len(GarmentDataset(tmp_path, verify="full")) == 5


def test_a_larger_count_lets_the_last_shard_grow(tmp_path: Path) -> None:
    keep(tmp_path, [0, 1], count=2)
    assert len(GarmentDataset(tmp_path)) == 2
    keep(tmp_path, [2, 3], count=10)
    assert len(GarmentDataset(tmp_path, verify="full")) == 4


def test_a_damaged_sample_is_reported_and_replaced(tmp_path: Path) -> None:
    keep(tmp_path, range(4))
    whole = content(tmp_path)
    shard = tmp_path / "train-00000.tar"
    damaged = bytearray(shard.read_bytes())
    place = damaged.find(members(2)["box.npy"]) + 200
    damaged[place] ^= 1
    shard.write_bytes(damaged)
    samples = kept(tmp_path)
    with pytest.raises(ShardError, match="gcd_000000002, member"):
        samples.read(2)
    samples.keep(2, members(2))
    assert content(tmp_path) == whole
    assert all(samples.read(index) == members(index) for index in range(4))


@pytest.mark.parametrize("there", [10, 4])  # the deleted shard is one of several, or the only one
def test_a_deleted_shard_is_written_again(tmp_path: Path, there: int) -> None:
    keep(tmp_path, range(there))
    before = content(tmp_path)
    (tmp_path / "train-00000.tar").unlink()
    worker = CONTEXT.Process(target=keep, args=(tmp_path, range(4)), daemon=True)  # a deadlock would hang the test
    worker.start()
    worker.join(60)
    assert worker.exitcode == 0
    assert content(tmp_path) == before


def test_a_shard_deleted_during_a_run_is_written_again(tmp_path: Path) -> None:
    keep(tmp_path, range(10))
    before, samples = content(tmp_path), kept(tmp_path)
    assert samples.read(4) == members(4)
    (tmp_path / "train-00000.tar").unlink()
    for index in range(4):
        samples.keep(index, members(index))
    assert content(tmp_path) == before
    assert all(samples.read(index) == members(index) for index in range(10))


def test_a_kill_during_the_repair_of_a_shard_loses_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    keep(tmp_path, range(10))
    before = content(tmp_path)
    shard = tmp_path / "train-00001.tar"
    damaged = bytearray(shard.read_bytes())
    damaged[damaged.find(members(6)["box.npy"]) + 200] ^= 1
    shard.write_bytes(damaged)

    def killed(self: SampleCache) -> ShardWriter:
        raise KeyboardInterrupt

    monkeypatch.setattr(SampleCache, "_writer", killed)
    with pytest.raises(KeyboardInterrupt):
        keep(tmp_path, [6])
    monkeypatch.undo()
    assert names(tmp_path) == ["train-00000.tar", "train-00002.tar"]
    worker = CONTEXT.Process(target=kept(tmp_path).pack, daemon=True)
    worker.start()
    worker.join(60)
    assert worker.exitcode == 0
    assert content(tmp_path) == before
