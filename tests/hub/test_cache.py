"""The member cache never exceeds its limit and never yields wrong bytes, for any number of processes."""

import errno
import multiprocessing
import os
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from gcd_dataset.hub.cache import COUNTER, Cache, CachedMember

from gcd_dataset.hub import cache as cache_module
from gcd_dataset.loaders import GarmentDataset
from gcd_dataset.shards import read_index
from gcd_dataset.shards.store import MemberLocation
from tests.hub.server import Hub
from tests.loaders.test_shards import assert_all_same
from tests.shards.folders import forbidden, public_folder

# Spawned processes would take longer to start than the tests to run.
pytestmark = pytest.mark.filterwarnings("ignore:.*use of fork:DeprecationWarning")

SIZE = 1000  # bytes of a member
MEMBERS = 8  # of a shard


def piece(flag: int, shard: int = 0) -> CachedMember:
    data = np.random.default_rng((shard, flag)).integers(256, size=SIZE, dtype=np.uint8)
    return CachedMember(flag, flag * SIZE, data.data)


def parts(flags: Any) -> list[tuple[int, MemberLocation]]:
    return [(flag, MemberLocation(0, flag * SIZE, SIZE, 0)) for flag in flags]


def disk_use(folder: Path) -> int:
    return sum(path.stat().st_blocks * 512 for path in (folder / "shards").glob("*.tar"))


def test_cached_members_are_read_back(tmp_path: Path) -> None:
    Cache(tmp_path).keep("a", MEMBERS, [piece(3), piece(1)])
    kept = Cache(tmp_path).read("a", MEMBERS, parts(range(MEMBERS)))
    assert kept == {1: piece(1).data, 3: piece(3).data}
    assert Cache(tmp_path).read("b", MEMBERS, parts([1])) == {}
    assert Cache(tmp_path).used == 2 * SIZE


def test_a_read_only_cache_is_read(caplog: pytest.LogCaptureFixture) -> None:
    with public_folder() as folder:
        Cache(folder / "cache").keep("a", MEMBERS, [piece(0)])
        with forbidden(folder / "cache", 0o755):
            reader = Cache(folder / "cache", 5 * SIZE)
            assert reader.read("a", MEMBERS, parts([0])) == {0: piece(0).data}
            reader.keep("a", MEMBERS, [piece(1)])
            assert reader.read("a", MEMBERS, parts([0, 1])) == {0: piece(0).data}
    assert "continuing without caching" in caplog.text


def test_the_cache_never_exceeds_its_limit(tmp_path: Path) -> None:
    cache = Cache(tmp_path, 5 * SIZE + 10)
    for shard in range(4):
        for flag in range(4):
            cache.keep(f"{shard}", MEMBERS, [piece(flag, shard)])
            assert cache.used <= 5 * SIZE
            assert int((tmp_path / "used").read_text()) == cache.used
            assert cache.read(f"{shard}", MEMBERS, parts([flag])) == {flag: piece(flag, shard).data}
    assert disk_use(tmp_path) <= 8 * 4096
    assert not Cache(tmp_path).read("0", MEMBERS, parts(range(4)))


def test_the_least_recently_used_shard_is_evicted_first(tmp_path: Path) -> None:
    cache = Cache(tmp_path, 4 * SIZE)
    for order, key in enumerate("abcd"):
        cache.keep(key, MEMBERS, [piece(0)])
        os.utime(tmp_path / "shards" / f"{key}.have", (order, order))
    assert Cache(tmp_path).read("a", MEMBERS, parts([0]))  # now the most recently used
    cache.keep("e", MEMBERS, [piece(0)])
    assert [key for key in "abcde" if Cache(tmp_path).read(key, MEMBERS, parts([0]))] == ["a", "c", "d", "e"]


def test_a_shard_in_constant_use_is_not_evicted(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cache_module, "TOUCHED_EVERY", 0.0)
    reader, writer = Cache(tmp_path), Cache(tmp_path, 2 * SIZE)
    writer.keep("a", MEMBERS, [piece(0)])
    assert reader.read("a", MEMBERS, parts([0]))  # stays open from here on
    writer.keep("b", MEMBERS, [piece(0)])
    for order, key in enumerate("ab"):
        os.utime(tmp_path / "shards" / f"{key}.have", (order, order))
    assert reader.read("a", MEMBERS, parts([0]))
    writer.keep("c", MEMBERS, [piece(0)])
    assert [key for key in "abc" if Cache(tmp_path).read(key, MEMBERS, parts([0]))] == ["a", "c"]


def test_eviction_frees_the_bytes_of_a_shard_held_open(tmp_path: Path) -> None:
    reader, writer = Cache(tmp_path, 2 * SIZE), Cache(tmp_path, 2 * SIZE)
    writer.keep("a", MEMBERS, [piece(0), piece(1)])
    assert reader.read("a", MEMBERS, parts([0, 1]))
    (shard,) = reader._open.values()
    writer.keep("b", MEMBERS, [piece(0)])
    assert os.fstat(shard.fd).st_size == 0
    assert reader.read("a", MEMBERS, parts([0, 1])) == {}
    reader.keep("a", MEMBERS, [piece(1)])
    assert writer.read("a", MEMBERS, parts([0, 1])) == {1: piece(1).data}
    assert reader.used == 2 * SIZE


def test_members_over_the_limit_are_not_cached(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    cache = Cache(tmp_path, SIZE - 1)
    cache.keep("a", MEMBERS, [piece(0)])
    assert cache.used == 0
    assert "raise max_cache_size" in caplog.text


def test_a_full_disk_loses_no_cached_member(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    cache = Cache(tmp_path)
    cache.keep("a", MEMBERS, [piece(0)])
    real = os.pwrite

    def full(fd: int, data: Any, place: int) -> int:
        if place >= SIZE:
            raise OSError(errno.ENOSPC, "No space left on device")
        return real(fd, data, place)

    monkeypatch.setattr(os, "pwrite", full)
    cache.keep("a", MEMBERS, [piece(5), piece(6)])
    assert cache.read("a", MEMBERS, parts(range(MEMBERS))) == {0: piece(0).data}
    assert cache.used == SIZE
    assert "No space left on device): make room there" in caplog.text


def test_a_kill_leaves_no_flag_set(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    cache = Cache(tmp_path, 10 * SIZE)
    cache.keep("a", MEMBERS, [piece(0)])

    def killed(path: Path, place: int, content: bytes) -> None:
        if place >= COUNTER:
            raise KeyboardInterrupt

    monkeypatch.setattr(cache_module, "_set", killed)
    with pytest.raises(KeyboardInterrupt):
        cache.keep("a", MEMBERS, [piece(1)])
    monkeypatch.undo()
    after = Cache(tmp_path, 10 * SIZE)
    assert after.read("a", MEMBERS, parts(range(MEMBERS))) == {0: piece(0).data}
    after.keep("a", MEMBERS, [piece(1)])
    assert after.read("a", MEMBERS, parts([1])) == {1: piece(1).data}


@pytest.mark.parametrize("step", ["_set", "Cache._write_down"])
def test_a_kill_during_counting_does_not_exceed_the_limit(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, step: str
) -> None:
    cache = Cache(tmp_path, 2 * SIZE)
    cache.keep("a", MEMBERS, [piece(0)])

    def killed(*_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(f"gcd_dataset.hub.cache.{step}", killed)
    with pytest.raises(KeyboardInterrupt):
        cache.keep("a", MEMBERS, [piece(1)])
    monkeypatch.undo()
    after = Cache(tmp_path, 2 * SIZE)
    after.keep("a", MEMBERS, [piece(2)])
    assert after.read("a", MEMBERS, parts([2])) == {2: piece(2).data}
    assert after.used <= 2 * SIZE


def test_a_kill_during_eviction_yields_no_wrong_bytes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    reader, writer = Cache(tmp_path, 2 * SIZE), Cache(tmp_path, 2 * SIZE)
    writer.keep("a", MEMBERS, [piece(0), piece(1)])
    assert reader.read("a", MEMBERS, parts([0, 1]))

    def killed(path: Path, size: int) -> None:
        with path.open("r+b") as file:
            file.truncate(size)
        raise KeyboardInterrupt

    monkeypatch.setattr(os, "truncate", killed)
    with pytest.raises(KeyboardInterrupt):
        writer.keep("b", MEMBERS, [piece(0)])
    monkeypatch.undo()
    Cache(tmp_path, 2 * SIZE).keep("a", MEMBERS, [piece(1)])
    assert reader.read("a", MEMBERS, parts([0, 1])) == {1: piece(1).data}


def test_a_shard_replaced_while_it_is_opened_yields_no_wrong_bytes(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Between the opening of its two files the shard is evicted and created again, with other members."""
    writer, reader = Cache(tmp_path, 2 * SIZE), Cache(tmp_path, 2 * SIZE)
    writer.keep("a", MEMBERS, [piece(0), piece(1)])
    real = np.memmap

    def late(*args: Any, **options: Any) -> Any:
        opened = real(*args, **options)
        monkeypatch.setattr(np, "memmap", real)
        writer.keep("b", MEMBERS, [piece(0)])
        writer.keep("a", MEMBERS, [piece(1)])
        return opened

    monkeypatch.setattr(np, "memmap", late)
    assert reader.read("a", MEMBERS, parts([0, 1])) in ({}, {1: piece(1).data})
    assert reader.read("a", MEMBERS, parts([0, 1])) == {1: piece(1).data}


def fill_at_random(folder: Path, limit: int | None, seed: int, count: int) -> int:
    """Cache and read members in random order; return the number of wrong results."""
    cache, wrong = Cache(folder, limit), 0
    for shard, flag in np.random.default_rng(seed).integers((6, MEMBERS), size=(count, 2)).tolist():
        found = cache.read(f"{shard}", MEMBERS, parts([flag]))
        wrong += flag in found and found[flag] != piece(flag, shard).data
        if not found:
            cache.keep(f"{shard}", MEMBERS, [piece(flag, shard), piece((flag + 1) % MEMBERS, shard)])
        wrong += limit is not None and int((folder / "used").read_text()) > limit
    return wrong


@pytest.mark.parametrize("limit", [None, 20 * SIZE])
def test_processes_share_a_cache(tmp_path: Path, limit: int | None) -> None:
    with multiprocessing.get_context("fork").Pool(2) as pool:
        wrong = pool.starmap(fill_at_random, [(tmp_path, limit, seed, 300) for seed in (1, 2)])
    assert wrong == [0, 0]
    flags = [np.fromfile(path, np.uint8)[COUNTER:] for path in (tmp_path / "shards").glob("*.have")]
    assert Cache(tmp_path).used == int((tmp_path / "used").read_text()) == SIZE * int(np.sum(flags))
    assert limit is not None or len(flags) == 6
    assert limit is None or Cache(tmp_path).used <= limit


def test_killed_processes_leave_a_consistent_cache(tmp_path: Path) -> None:
    for seed in range(8):
        child = multiprocessing.get_context("fork").Process(
            target=fill_at_random, args=(tmp_path, 20 * SIZE, seed, 100_000)
        )
        child.start()
        used = tmp_path / "used"
        before = used.stat().st_ino if used.exists() else 0
        while not used.exists() or used.stat().st_ino == before:
            assert child.is_alive()
            time.sleep(0.001)
        time.sleep(0.003 * seed)  # each kill comes at another moment
        child.kill()
        child.join()
        cache = Cache(tmp_path, 20 * SIZE)
        for shard in range(6):
            found = cache.read(f"{shard}", MEMBERS, parts(range(MEMBERS)))
            assert all(data == piece(flag, shard).data for flag, data in found.items())
        cache.keep("0", MEMBERS, [piece(seed)])
        assert cache.read("0", MEMBERS, parts([seed]))
        assert cache.used <= 20 * SIZE


def test_threads_share_a_cache(tmp_path: Path) -> None:
    with ThreadPoolExecutor(4) as pool:
        assert not sum(pool.map(lambda seed: fill_at_random(tmp_path, 20 * SIZE, seed, 100), range(4)))
    assert Cache(tmp_path).used == int((tmp_path / "used").read_text()) <= 20 * SIZE


# ---------------------------------------------------------------------------------------------- through GarmentDataset


def read_all(endpoint: str, cache_dir: Path, limit: int | None) -> list[float]:
    """The sum of each garment's vertices, read from a server forwards and backwards."""
    ds = GarmentDataset("org/garments", fields=["verts"], endpoint=endpoint, cache_dir=cache_dir, max_cache_size=limit)
    return [float(ds[i]["verts"].sum()) for i in [*range(len(ds)), *reversed(range(len(ds)))]]


@pytest.mark.parametrize("limit", [None, 6000])
def test_two_processes_fill_one_cache(hub: Hub, commit: str, folder: Path, tmp_path: Path, limit: int | None) -> None:
    here = [float(item["verts"].sum()) for item in GarmentDataset(folder, fields=["verts"])]
    with multiprocessing.get_context("fork").Pool(2) as pool:
        read = pool.starmap(read_all, 2 * [(hub.endpoint, tmp_path, limit)])
    assert read == 2 * [here + here[::-1]]
    assert limit is None or Cache(tmp_path).used <= limit
    if limit is None:
        column = read_index(folder).layout.members.index("verts.npy")
        assert Cache(tmp_path).used == int(read_index(folder).table.size[:, column].sum())


def test_a_full_cache_is_still_read(hub: Hub, commit: str, folder: Path, tmp_path: Path) -> None:
    for limit in ("1B", "7kB", "1GB"):
        ds = GarmentDataset("org/garments", endpoint=hub.endpoint, cache_dir=tmp_path, max_cache_size=limit)
        assert_all_same(ds, GarmentDataset(folder))
        assert_all_same(ds[::-1], GarmentDataset(folder)[::-1])


def test_an_unwritable_cache_is_still_read(hub: Hub, commit: str, folder: Path, tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    ds = GarmentDataset("org/garments", endpoint=hub.endpoint, cache_dir=tmp_path / "file", fields=["verts"])
    assert_all_same(ds, GarmentDataset(folder, fields=["verts"]))
