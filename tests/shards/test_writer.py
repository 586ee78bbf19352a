"""The bytes of shards do not depend on interruptions, and no finished sample is lost."""

import errno
import fcntl
import hashlib
import io
import json
import os
import random
import re
import signal
import tarfile
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from gcd_dataset import __version__
from gcd_dataset.errors import ConfigError, OutputError, ShardError
from gcd_dataset.loaders import GarmentDataset
from gcd_dataset.loaders.fake import fake_sample
from gcd_dataset.records import Sample, View
from gcd_dataset.shards import (
    MEMBERS,
    ShardReader,
    ShardWriter,
    decode_sample,
    encode_sample,
    read_index,
    rebuild_index,
)
from gcd_dataset.shards.index import ShardTable, scan_shard
from gcd_dataset.shards.layout import Layout, garments_layout, recipe_hash
from gcd_dataset.shards.manifest import read_manifest
from gcd_dataset.shards.meta import sealed
from gcd_dataset.shards.single import write_single
from tests.shards.folders import RECIPE, SHARD_SIZE, contents, fill, forbidden, open_writer, public_folder


@pytest.fixture
def whole(tmp_path: Path) -> Path:
    """Ten samples in shards of four, by one writer."""
    return fill(tmp_path / "whole", range(10))


def test_a_shard_holds_its_own_indices(whole: Path) -> None:
    index = read_index(whole)
    assert index.shards == ("train-00000.tar", "train-00001.tar", "train-00002.tar")
    assert index.table.sample.tolist() == list(range(10))
    assert index.shard.tolist() == [0] * 4 + [1] * 4 + [2] * 2


def test_equal_samples_give_equal_shards(whole: Path, tmp_path: Path) -> None:
    assert contents(fill(tmp_path / "again", range(10))) == contents(whole)


def test_bytes_do_not_depend_on_the_order_of_writing(whole: Path, tmp_path: Path) -> None:
    indices = list(range(10))
    random.Random(3).shuffle(indices)
    assert contents(fill(tmp_path / "shuffled", indices)) == contents(whole)


@pytest.mark.parametrize("stop", [1, 4, 6, 9])
def test_an_interrupted_run_continues_to_the_same_bytes(whole: Path, tmp_path: Path, stop: int) -> None:
    folder = tmp_path / "interrupted"
    with pytest.raises(KeyboardInterrupt), open_writer(folder) as writer:
        for index in range(stop):
            writer.write(fake_sample(0, index))
        raise KeyboardInterrupt
    assert len(ShardReader(folder, verify="full")) == stop
    with open_writer(folder) as writer:
        assert writer.done == frozenset(range(stop))
    fill(folder, range(stop, 10))
    assert contents(folder) == contents(whole)


def test_a_killed_run_loses_only_the_sample_being_written(whole: Path, tmp_path: Path) -> None:
    folder = tmp_path / "killed"
    writer = open_writer(folder)
    for index in range(7):
        writer.write(fake_sample(0, index))
    part = folder / "train-00001.tar.part"
    os.truncate(part, part.stat().st_size - 1000)
    del writer  # without close, as after kill -9
    assert list(ShardReader(folder).index.table.sample) == [0, 1, 2, 3]


def test_a_part_file_of_a_killed_run_is_recovered(whole: Path, tmp_path: Path) -> None:
    folder = fill(tmp_path / "killed", range(4))
    torn = (whole / "train-00001.tar").read_bytes()
    second = int(read_index(whole).table.offset[5, 0])
    (folder / "train-00001.tar.part").write_bytes(torn[: second + 100])
    with open_writer(folder) as writer:
        assert writer.done == frozenset(range(5))
    fill(folder, range(5, 10))
    assert contents(folder) == contents(whole)


def test_a_broken_sample_in_a_part_file_is_written_again(whole: Path, tmp_path: Path) -> None:
    folder = fill(tmp_path / "killed", range(4))
    torn = bytearray((whole / "train-00001.tar").read_bytes())
    torn[int(read_index(whole).table.offset[6, MEMBERS.index("verts.npy")]) + 200] ^= 1
    (folder / "train-00001.tar.part").write_bytes(torn)
    with open_writer(folder) as writer:
        assert writer.done == frozenset(range(6))


def full_disk(monkeypatch: pytest.MonkeyPatch, *, room: int) -> None:
    """Let ``os.pwrite`` write ``room`` more bytes, then fail."""
    left, pwrite = [room], os.pwrite

    def write(file: int, data: memoryview, offset: int) -> int:
        if left[0] == 0:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        taken = data[: left[0]]
        left[0] -= len(taken)
        return pwrite(file, taken, offset)

    monkeypatch.setattr(os, "pwrite", write)


def test_a_full_disk_costs_no_finished_sample(whole: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = tmp_path / "full"
    size = sum(read_index(whole).table.size[0].tolist())
    full_disk(monkeypatch, room=6 * size + 15 * 1024 * 6)
    with pytest.raises(OutputError, match=r"train-0000\d\.tar\.part.*No space left.*are kept.*make room"):
        fill(folder, range(10))
    monkeypatch.undo()
    finished = len(ShardReader(folder, verify="full"))
    assert 0 < finished < 10
    assert not list(folder.glob("*.part"))
    fill(folder, range(finished, 10))
    assert contents(folder) == contents(whole)


def test_a_disk_too_full_for_the_manifest_costs_no_sample(
    whole: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = fill(tmp_path / "full", range(4))
    with pytest.raises(OutputError, match=r"train-00001\.tar\.part"), open_writer(folder) as writer:
        writer.write(fake_sample(0, 4))
        full_disk(monkeypatch, room=100)
        monkeypatch.setattr(os, "fsync", refuse)
        writer.write(fake_sample(0, 5))
    monkeypatch.undo()
    assert len(ShardReader(folder, verify="full")) == 4
    with open_writer(folder) as writer:
        assert writer.done == frozenset(range(5))
    fill(folder, range(5, 10))
    assert contents(folder) == contents(whole)


@pytest.mark.parametrize("room", [100, 40_000])
def test_a_disk_too_full_to_continue_costs_no_sample(
    whole: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, room: int
) -> None:
    folder = fill(tmp_path / "full", range(7))
    full_disk(monkeypatch, room=room)
    with pytest.raises(OutputError, match=r"train-00001\.tar\.part.*No space left"):
        fill(folder, range(7, 10))
    monkeypatch.undo()
    assert len(ShardReader(folder, verify="full")) == 7
    fill(folder, range(7, 10))
    assert contents(folder) == contents(whole)


def refuse(file: int) -> None:
    raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))


def test_a_grown_data_set_equals_one_of_the_larger_count(whole: Path, tmp_path: Path) -> None:
    folder = fill(tmp_path / "grown", range(3))
    fill(folder, range(3, 10))
    assert contents(folder) == contents(whole)


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"seed": 1}, "seed=0.*seed=1"),
        ({"recipe": {"fake": False}}, "fake=True.*fake=False"),
        ({"shard_size": 8}, "shard_size=4.*shard_size=8"),
    ],
)
def test_another_recipe_is_refused_naming_both(whole: Path, changed: dict[str, object], message: str) -> None:
    options: dict[str, object] = {"seed": 0, "recipe": RECIPE, "shard_size": SHARD_SIZE, **changed}
    with pytest.raises(ConfigError, match=message):
        ShardWriter(whole, **options)  # type: ignore[arg-type]


def test_a_sample_is_written_once(whole: Path) -> None:
    with open_writer(whole) as writer:
        for index in (0, 9):
            with pytest.raises(ConfigError, match=f"gcd_00000000{index} is there already"):
                writer.write(fake_sample(0, index))
        writer.write(fake_sample(0, 10))
        with pytest.raises(ConfigError, match="gcd_000000010 is there already"):
            writer.write(fake_sample(0, 10))


def test_two_writers_of_a_split_exclude_each_other(tmp_path: Path) -> None:
    with open_writer(tmp_path) as writer:
        for _ in range(2):  # before the first sample, and after it
            with pytest.raises(OutputError, match="another process is writing split train"):
                open_writer(tmp_path)
            writer.write(fake_sample(0, len(writer.done)))
    with open_writer(tmp_path) as writer:
        assert writer.done == {0, 1}
    assert not list(tmp_path.glob(".*"))


def test_the_lock_of_a_writer_holds_in_forked_processes(tmp_path: Path) -> None:
    writer = open_writer(tmp_path)
    read, write = os.pipe()
    child = os.fork()
    if child == 0:
        try:
            open_writer(tmp_path)
        except OutputError as error:
            os.write(write, str(error).encode())
        finally:
            del writer  # dropping the forked copy releases no lock
            os._exit(0)
    os.waitpid(child, 0)
    os.close(write)
    assert b"another process is writing split train" in os.read(read, 1000)
    os.close(read)
    with pytest.raises(OutputError, match="another process"):
        open_writer(tmp_path)
    writer.close()


def test_a_kill_frees_the_lock(tmp_path: Path) -> None:
    child = os.fork()
    if child == 0:
        open_writer(tmp_path).write(fake_sample(0, 0))
        os.kill(os.getpid(), signal.SIGKILL)
    os.waitpid(child, 0)
    with open_writer(tmp_path) as writer:
        assert writer.done == {0}


def test_a_closed_writer_writes_no_more(tmp_path: Path) -> None:
    writer = open_writer(tmp_path)
    writer.close()
    with pytest.raises(OutputError, match="this writer is closed"):
        writer.write(fake_sample(0, 0))
    fill(tmp_path, [0])
    writer.close()  # again: changes nothing
    assert len(ShardReader(tmp_path)) == 1


def test_splits_may_be_written_concurrently(tmp_path: Path) -> None:
    with open_writer(tmp_path) as train, open_writer(tmp_path, split="test", seed=7) as test:
        for index in range(5):
            train.write(fake_sample(0, index))
            test.write(fake_sample(7, index))
    splits = json.loads((tmp_path / "manifest.json").read_text())["splits"]
    assert [(name, len(split["shards"])) for name, split in splits.items()] == [("test", 2), ("train", 2)]


@pytest.mark.parametrize("code", [errno.ENOLCK, errno.ENOSYS, errno.EOPNOTSUPP])
def test_a_file_system_without_locks_is_reported(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, code: int) -> None:
    def flock(file: int, operation: int) -> None:
        raise OSError(code, os.strerror(code))

    monkeypatch.setattr(fcntl, "flock", flock)
    with pytest.raises(OutputError, match=r"cannot be locked .*-o flock.*local disk"):
        open_writer(tmp_path)


def test_a_read_only_folder_is_reported() -> None:
    message = r"cannot be written \(Permission denied\): its samples can be read; to add some, .*allow writing"
    with public_folder() as folder:
        before = contents(fill(folder, range(3)))
        with forbidden(folder, 0o555), pytest.raises(OutputError, match=message):
            open_writer(folder)
        assert contents(folder) == before


def test_another_version_is_refused_naming_both(whole: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("gcd_dataset.__version__", "99.1")
    message = rf"made by gcd_dataset {re.escape(__version__)}, but this is 99\.1: .*another folder"
    with pytest.raises(ConfigError, match=message):
        open_writer(whole)
    (whole / "manifest.json").unlink()
    with pytest.raises(ConfigError, match=message):
        open_writer(whole)


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"seed": 1}, "seed=0.*seed=1"),
        ({"recipe": {"fake": False}}, "fake=True.*fake=False"),
        ({"shard_size": 3}, "shard_size=3"),
    ],
)
@pytest.mark.parametrize("half_written", [False, True])
def test_without_a_manifest_the_recipe_comes_from_the_samples(
    tmp_path: Path, changed: dict[str, object], message: str, half_written: bool
) -> None:
    folder = fill(tmp_path, range(7))
    (folder / "manifest.json").unlink()
    if half_written:
        (folder / "train-00000.tar").unlink()
        (folder / "train-00001.tar").rename(folder / "train-00001.tar.part")
    options: dict[str, object] = {"seed": 0, "recipe": RECIPE, "shard_size": SHARD_SIZE, **changed}
    before = contents(folder)
    with pytest.raises(ConfigError, match=message):
        ShardWriter(folder, **options)  # type: ignore[arg-type]
    assert contents(folder) == before


def test_a_lost_manifest_is_written_again(whole: Path) -> None:
    before = contents(whole)
    (whole / "manifest.json").unlink()
    open_writer(whole).close()
    assert contents(whole) == before


def test_shards_of_another_kind_are_reported(tmp_path: Path) -> None:
    folder = fill(tmp_path, [0])
    members = encode_sample(fake_sample(0, 0))
    meta = json.loads(members["meta.json"])
    del meta["seed"], meta["crc32_before"]
    write_single(folder / "train-00000.tar", 0, {**members, "meta.json": sealed(meta)})
    for name in ("manifest.json", "index-train.npz"):
        (folder / name).unlink()
    with pytest.raises(ShardError, match=r"train-00000\.tar: .*seed is missing"):
        open_writer(folder)


def test_recipes_with_4_and_4_0_are_equal(tmp_path: Path) -> None:
    for spacing in (4, 4.0):
        ShardWriter(tmp_path, seed=0, recipe={"spacing": spacing, "nested": {"list": [spacing]}}).close()
    with pytest.raises(ConfigError, match=r"nested=.*True"):
        ShardWriter(tmp_path, seed=0, recipe={"spacing": 4, "nested": True})
    assert recipe_hash({"n": 1}) != recipe_hash({"n": True})
    assert recipe_hash({"n": 1}) != recipe_hash({"n": 1.5})


def test_a_deleted_damaged_shard_is_written_again(whole: Path) -> None:
    before = contents(whole)
    shard = whole / "train-00001.tar"
    os.truncate(shard, 5000)
    with pytest.raises(ShardError, match="delete it and run gcd generate again"):
        open_writer(whole)
    shard.unlink()
    fill(whole, range(4, 8))
    assert contents(whole) == before


def test_an_unwritable_path_is_named(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(OutputError, match="file/out: cannot be written"):
        open_writer(tmp_path / "file" / "out")


def test_the_manifest_lists_each_shard(whole: Path) -> None:
    manifest = json.loads((whole / "manifest.json").read_text())
    split = manifest["splits"]["train"]
    assert (manifest["schema"], split["seed"], split["recipe"]) == (2, 0, RECIPE)
    for shard in split["shards"]:
        content = (whole / shard["name"]).read_bytes()
        assert (shard["size"], shard["sha256"]) == (len(content), hashlib.sha256(content).hexdigest())
    assert [shard["count"] for shard in split["shards"]] == [4, 4, 2]


def test_splits_share_a_folder(tmp_path: Path) -> None:
    fill(tmp_path, range(3))
    with open_writer(tmp_path, seed=7, split="test") as writer:
        writer.write(fake_sample(7, 0))
    assert (len(ShardReader(tmp_path)), len(ShardReader(tmp_path, "test"))) == (3, 1)


def test_the_index_is_rebuilt_from_the_shards(whole: Path) -> None:
    index = read_index(whole)
    path = whole / "index-train.npz"
    kept = path.read_bytes()
    path.unlink()
    assert read_index(whole) == index
    assert not path.exists()
    assert rebuild_index(whole) == index
    assert path.read_bytes() == kept


def test_a_missing_member_is_named(whole: Path) -> None:
    with tarfile.open(whole / "train-00000.tar") as old:
        entries = [(entry, old.extractfile(entry)) for entry in old]
        kept = [(entry, file.read()) for entry, file in entries if file is not None]
    with tarfile.open(whole / "train-00000.tar", "w", format=tarfile.USTAR_FORMAT) as new:
        for entry, content in kept:
            if entry.name != "gcd_000000001.faces.npy":
                new.addfile(entry, io.BytesIO(content))
    for name in ("manifest.json", "index-train.npz"):
        (whole / name).unlink()
    with pytest.raises(ShardError, match=r"sample gcd_000000001 .* lacks faces\.npy"):
        read_index(whole)


@pytest.mark.parametrize("made", [rebuild_index, read_index])
def test_an_index_built_while_a_shard_is_replaced_is_correct(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, made: Any
) -> None:
    """Another run fills a gap in a shard that has just been scanned."""
    folder = fill(tmp_path, [0, 2])
    (folder / "index-train.npz").unlink()

    def scanned(path: Path, layout: Layout) -> ShardTable:
        table = scan_shard(path, layout)
        monkeypatch.undo()
        fill(folder, [1, 3, 4])
        return table

    monkeypatch.setattr("gcd_dataset.shards.index.scan_shard", scanned)
    assert made(folder).table.sample.tolist() == [0, 1, 2, 3, 4]
    assert len(ShardReader(folder, verify="full")) == 5


def test_the_manifest_counts_rejects_by_rule(tmp_path: Path) -> None:
    reasons = [(), ("too_long: 180 cm", "too_long: 190 cm"), ("self_crossing: panel a",), ("too_long: 170 cm",)]
    with open_writer(tmp_path) as writer:
        for index, rejects in enumerate(reasons):
            sample = fake_sample(0, index)
            writer.write(replace(sample, provenance=replace(sample.provenance, rejects=rejects)))
    split = read_manifest(tmp_path).splits["train"]  # type: ignore[union-attr]
    assert [dict(shard.rejects) for shard in split.shards] == [{"self_crossing": 1, "too_long": 3}]
    assert list(split.rejects.items()) == [("too_long", 3), ("self_crossing", 1)]


def test_captions_and_views_are_in_every_sample_or_in_none(tmp_path: Path) -> None:
    layout = garments_layout(caption=True, views=1)
    picture = fake_sample(0, 0).front
    assert picture is not None

    def captioned(index: int) -> Sample:
        return replace(fake_sample(0, index), caption=f"skirt {index}", views=(View(picture, {"fov": 40.0}),))

    for indices in (range(3), range(3, 6)):
        with ShardWriter(tmp_path, seed=0, recipe=RECIPE, shard_size=4, layout=layout) as writer:
            for index in indices:
                writer.write(captioned(index))
            with pytest.raises(
                ShardError, match=r"gcd_000000009 has no caption\.txt, which all samples of this data set"
            ):
                writer.write(fake_sample(0, 9))
    for streaming in (False, True):
        ds: Any = GarmentDataset(tmp_path, streaming=streaming)
        for index, item in enumerate(ds):
            assert (item["caption"], item["view_0_json"]) == (f"skirt {index}", {"fov": 40.0})
            assert item["view_0"].shape == (3, 16, 16)
    only = GarmentDataset(tmp_path, fields=["caption", "points"])[5]
    assert set(only) == {"caption", "points"}
    assert ShardReader(tmp_path).sample(2) == decode_sample(encode_sample(captioned(2)))
    before = read_index(tmp_path)
    (tmp_path / "index-train.npz").unlink()
    assert rebuild_index(tmp_path) == before
    with pytest.raises(ShardError, match="an index of samples with a caption or views"):
        ShardWriter(tmp_path, seed=0, recipe=RECIPE, shard_size=4)
    plain = tmp_path / "plain"
    with ShardWriter(plain, seed=0, recipe=RECIPE) as writer:
        writer.write(fake_sample(0, 0))
        with pytest.raises(ShardError, match=r"gcd_000000001 has caption\.txt, which no other sample"):
            writer.write(captioned(1))
    with pytest.raises(ConfigError, match="no field caption"):
        GarmentDataset(plain, fields=["caption"])


def test_the_manifest_sums_redraws_by_rule(tmp_path: Path) -> None:
    with open_writer(tmp_path) as writer:
        for index, redraws in enumerate([{}, {"tight_cuff": 2}, {"tight_cuff": 1, "self_crossing": 5}]):
            sample = fake_sample(0, index)
            writer.write(replace(sample, provenance=replace(sample.provenance, redraws=redraws)))
    split = read_manifest(tmp_path).splits["train"]  # type: ignore[union-attr]
    assert [dict(shard.redraws) for shard in split.shards] == [{"self_crossing": 5, "tight_cuff": 3}]
    assert list(split.redraws.items()) == [("self_crossing", 5), ("tight_cuff", 3)]
