"""Reading shards: random access, and detection of every flipped byte."""

import multiprocessing
import os
import pickle
import shutil
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest

from gcd_dataset.check.summary import info_lines
from gcd_dataset.errors import ConfigError, ShardError
from gcd_dataset.loaders import GarmentDataset
from gcd_dataset.loaders.fake import fake_sample
from gcd_dataset.shards import MEMBERS, ShardReader, encode_sample, store
from gcd_dataset.shards.layout import key_of
from gcd_dataset.shards.store import FolderStore
from gcd_dataset.shards.tar import BLOCK
from gcd_dataset.shards.writer import draft_name
from tests.helpers import flip
from tests.shards.folders import fill, forbidden, public_folder


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    return fill(tmp_path / "data", range(10))


def flip_member(folder: Path, sample: int, member: str) -> None:
    """Change one bit in the middle of a member."""
    for path in folder.rglob("train-*.tar"):
        content = path.read_bytes()
        place = content.find(f"{key_of(sample)}.{member}\0".encode())
        if place >= 0:
            flip(path, place + BLOCK + int(content[place + 124 : place + 135], 8) // 2)


def test_members_are_read_in_any_order(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    shards, real = ShardReader(folder), os.preadv
    for position in np.random.default_rng(0).permutation(10).tolist():
        assert shards.read(position, MEMBERS) == encode_sample(fake_sample(0, position))
    for members in (["verts.z", "mesh.z"], ["back.jpg", "meta.json"]):
        assert list(shards.read(3, members)) == members
    with pytest.raises(ConfigError, match=r"its samples have no caption\.txt"):
        shards.read(3, ["caption.txt"])
    shards.read(3, ["verts.z"])["verts.z"][:] = bytes(len(shards.read(3, ["verts.z"])["verts.z"]))  # the caller's own
    assert shards.read(3, ["verts.z"])["verts.z"] == encode_sample(fake_sample(0, 3))["verts.z"]
    monkeypatch.setattr(os, "preadv", lambda fd, buffers, place: real(fd, [buffers[0][:1000]], place))  # short reads
    assert ShardReader(folder).read(4, MEMBERS) == encode_sample(fake_sample(0, 4))


@pytest.mark.parametrize("member", ["meta.json", "verts.z", "back.jpg"])
def test_a_flipped_bit_is_named(folder: Path, member: str) -> None:
    """Damage after the first read is found by a check."""
    message = f"train-00001.tar: sample gcd_000000005, member {member}"
    early, lazy, blind = ShardReader(folder), ShardReader(folder), ShardReader(folder, verify="off")
    early.read(5, MEMBERS)
    flip_member(folder, 5, member)
    lazy.read(4, MEMBERS)
    for _ in range(2):
        with pytest.raises(ShardError, match=message):
            lazy.read(5, [member])
    with pytest.raises(ShardError, match=message):
        ShardReader(folder, verify="full")
    for reader in (early, blind):
        reader.read(5, MEMBERS)
        with pytest.raises(ShardError, match=message):
            reader.check(5)


def test_a_cut_or_missing_shard_is_named(folder: Path) -> None:
    path = folder / "train-00001.tar"
    size = path.stat().st_size
    os.truncate(path, 5000)
    with pytest.raises(ShardError, match=rf"train-00001\.tar: 5000 bytes, but {size} in manifest\.json"):
        ShardReader(folder).read(5, MEMBERS)
    path.unlink()
    with pytest.raises(ShardError, match=r"train-00001\.tar: no such file, but manifest\.json lists it: copy it again"):
        ShardReader(folder)


def test_other_members_are_read_where_pictures_are_missing(folder: Path) -> None:
    shutil.rmtree(folder / "views")
    message = r"views/train-00000\.tar: no such file, but manifest\.json lists it: copy it again, or delete train-00000"
    assert len(GarmentDataset(folder, fields=["verts"])[[0, 1]]) == 2
    for read in (lambda: ShardReader(folder).read(0, ["front.jpg"]), lambda: GarmentDataset(folder, fields=["front"])):
        with pytest.raises(ShardError, match=message):
            read()
    lines = set()
    with pytest.raises(ShardError, match=message):
        for line in info_lines(FolderStore(folder)):
            lines.add(line.partition(":")[0])
    assert {"  bytes by field", "  panels"} <= lines


@pytest.mark.parametrize(
    "lost", [("train.index",), ("manifest.json",), ("train.index", "manifest.json", "train-*.json")]
)
def test_shards_are_read_without_index_manifest_and_notes(folder: Path, lost: tuple[str, ...]) -> None:
    for pattern in lost:
        for path in folder.glob(pattern):
            path.unlink()
    before = sorted(folder.iterdir())
    reader = ShardReader(folder, verify="full")
    assert [reader.number(position) for position in range(len(reader))] == list(range(10))
    assert sorted(folder.iterdir()) == before  # nothing is written


def test_a_missing_split_is_reported(folder: Path, tmp_path: Path) -> None:
    with pytest.raises(ShardError, match="no samples of split test: choose from train"):
        ShardReader(folder, "test")
    with pytest.raises(ShardError, match="no shards: give a folder made by gcd generate"):
        ShardReader(tmp_path)
    (tmp_path / draft_name("train", 0, 400)).write_bytes(bytes(512))
    with pytest.raises(ShardError, match=r"no shard of 400 samples is finished yet: give the command .* again"):
        ShardReader(tmp_path)
    with pytest.raises(ConfigError, match="verify='sometimes'"):
        ShardReader(folder, verify="sometimes")  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("name", "mode"), [("", 0), ("", 0o444), ("manifest.json", 0), ("train.index", 0), ("train-00000.tar", 0)]
)
def test_an_unreadable_file_or_folder_is_named(name: str, mode: int) -> None:
    message = rf"data.*{name}.*: cannot be read \(Permission denied\)"
    with public_folder() as place:
        folder = fill(place / "data", range(3))
        with forbidden(folder / name, mode), pytest.raises(ShardError, match=message):
            ShardReader(folder).read(0, MEMBERS)


def test_missing_samples_leave_positions_dense(tmp_path: Path) -> None:
    shards = ShardReader(fill(tmp_path, [1, 7, 3]))
    for position, index in enumerate([1, 3, 7]):
        assert shards.number(position) == index
        assert shards.read(position, ["meta.json"])["meta.json"] == encode_sample(fake_sample(0, index))["meta.json"]
    again = pickle.loads(pickle.dumps(shards.index))  # as its file
    assert again.to_bytes() == shards.index.to_bytes() == (tmp_path / "train.index").read_bytes()
    assert again.end.tolist() == shards.index.end.tolist()


def test_a_data_set_replaced_meanwhile_is_reported(folder: Path) -> None:
    """By one with shards of the same size."""
    readers = ShardReader(folder), ShardReader(folder, verify="off")
    shard = folder / "train-00001.tar"
    shard.write_bytes(shard.read_bytes().replace(b"gcd_000000005", b"gcd_000000077"))
    for reader in readers:
        with pytest.raises(ShardError, match=r"train-00001\.tar: sample gcd_000000005: "):
            reader.read(5, MEMBERS)


def test_a_reader_may_be_pickled_spawned_and_shared_by_threads(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(store, "OPEN_FILES", 1)
    shards = ShardReader(folder)
    expected = [encode_sample(fake_sample(0, position))["verts.z"] for position in range(10)]
    assert shards.read(0, ["verts.z"])["verts.z"] == expected[0]
    assert pickle.loads(pickle.dumps(shards)).read(9, ["verts.z"])["verts.z"] == expected[9]
    order = np.random.default_rng(1).integers(10, size=200).tolist()
    with ThreadPoolExecutor(4) as pool:
        read = list(pool.map(lambda position: shards.read(position, ["verts.z"])["verts.z"], order))
    assert all(data == expected[position] for position, data in zip(order, read, strict=True))
    with multiprocessing.get_context("spawn").Pool(1) as processes:
        assert processes.map(shards_length, [shards]) == [(10, len(expected[3]))]


def shards_length(shards: ShardReader) -> tuple[int, int]:
    return len(shards), len(shards.read(3, ["verts.z"])["verts.z"])
