"""Reading shards: random access, and detection of every flipped byte."""

import json
import multiprocessing
import os
import pickle
from collections.abc import Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest

from gcd_dataset.errors import ConfigError, ShardError
from gcd_dataset.loaders.fake import fake_sample
from gcd_dataset.shards import MEMBERS, ShardReader, encode_sample, read_index
from gcd_dataset.shards import folder as folders
from gcd_dataset.shards.folder import FolderStore
from gcd_dataset.shards.reader import Verify
from gcd_dataset.shards.store import MemberLocation
from tests.shards.folders import fill, forbidden, public_folder


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    return fill(tmp_path / "data", range(10))


def flip(folder: Path, sample: int, member: str) -> None:
    """Change one bit in the middle of a member."""
    index = read_index(folder)
    column = MEMBERS.index(member)
    place = int(index.table.offset[sample, column]) + int(index.table.size[sample, column]) // 2
    path = folder / index.shards[index.shard[sample]]
    content = bytearray(path.read_bytes())
    content[place] ^= 4
    path.write_bytes(content)


def test_members_are_read_in_any_order(folder: Path) -> None:
    shards = ShardReader(folder)
    for position in np.random.default_rng(0).permutation(10).tolist():
        assert shards.read(position, MEMBERS) == encode_sample(fake_sample(0, position))
    assert shards.read(3, ["verts.npy", "faces.npy"]).keys() == {"faces.npy", "verts.npy"}


def test_distant_members_are_read_by_separate_calls(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(folders, "GAP", 0)
    expected = encode_sample(fake_sample(0, 4))
    read = ShardReader(folder).read(4, ["back.jpg", "meta.json", "verts.npy"])
    assert read == {name: expected[name] for name in ("meta.json", "verts.npy", "back.jpg")}


def test_short_reads_are_continued(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    real = os.preadv

    def some(fd: int, buffers: Sequence[memoryview], place: int) -> int:
        return real(fd, [buffers[0][:1000]], place)

    monkeypatch.setattr(os, "preadv", some)
    assert ShardReader(folder).read(4, MEMBERS) == encode_sample(fake_sample(0, 4))


@pytest.mark.parametrize("member", ["meta.json", "verts.npy", "back.jpg"])
def test_a_flipped_bit_is_named(folder: Path, member: str) -> None:
    flip(folder, 5, member)
    message = f"train-00001.tar: sample gcd_000000005, member {member}"
    lazy = ShardReader(folder)
    lazy.read(4, MEMBERS)
    lazy.read(5, [name for name in MEMBERS if name != member])
    with pytest.raises(ShardError, match=message):
        lazy.read(5, [member])
    with pytest.raises(ShardError, match=message):
        ShardReader(folder, verify="full")
    blind = ShardReader(folder, verify="off")
    blind.read(5, MEMBERS)
    with pytest.raises(ShardError, match=message):
        blind.check(5)


def test_both_copies_of_a_sample_requested_twice_are_checked(folder: Path) -> None:
    """With a store that reads all samples before the first check, and fetches damaged members again."""

    class Mended(FolderStore):
        def read_many(
            self, wanted: Sequence[tuple[str, int, Sequence[MemberLocation]]]
        ) -> Iterable[dict[int, memoryview]]:
            return list(super().read_many(wanted))

        def refetch(self, shard: str, number: int, part: MemberLocation) -> memoryview:
            return memoryview(encode_sample(fake_sample(0, 5))["verts.npy"])

    flip(folder, 5, "verts.npy")
    reader = ShardReader(folder)
    reader.store = Mended(folder)
    expected = encode_sample(fake_sample(0, 5))["verts.npy"]
    assert [sample["verts.npy"] for sample in reader.read_many([5, 5], ["verts.npy"])] == [expected, expected]


def test_a_flipped_bit_is_found_without_an_index(folder: Path) -> None:
    (folder / "index-train.npz").unlink()
    flip_at = read_index(folder).table.offset[5, MEMBERS.index("verts.npy")]
    assert flip_at
    flip(folder, 5, "verts.npy")
    with pytest.raises(ShardError, match=r"gcd_000000005, member verts\.npy"):
        ShardReader(folder).read(5, MEMBERS)


def test_an_unknown_schema_is_reported_with_both_versions(folder: Path) -> None:
    path = folder / "manifest.json"
    manifest = json.loads(path.read_text())
    path.write_text(json.dumps({**manifest, "schema": 99, "generator": "7.2.0"}))
    with pytest.raises(ShardError, match=r"schema 99 by gcd_dataset 7\.2\.0.*reads schema 1 and 2"):
        ShardReader(folder)


def test_a_cut_or_missing_shard_is_named(folder: Path) -> None:
    path = folder / "train-00001.tar"
    content = path.read_bytes()
    path.write_bytes(content[:5000])
    with pytest.raises(ShardError, match=rf"train-00001\.tar: 5000 of the {len(content)} bytes"):
        ShardReader(folder)
    path.unlink()
    with pytest.raises(ShardError, match=r"train-00001\.tar: 0 of the"):
        ShardReader(folder)


def test_shards_are_read_without_index_and_manifest(folder: Path) -> None:
    (folder / "index-train.npz").unlink()
    (folder / "manifest.json").unlink()
    assert len(ShardReader(folder, verify="full")) == 10


@pytest.mark.parametrize("name", ["index-train.npz", "manifest.json"])
def test_a_broken_index_or_manifest_is_named(folder: Path, name: str) -> None:
    (folder / name).write_bytes(b"PK nonsense")
    with pytest.raises(ShardError, match=name):
        ShardReader(folder)


def test_a_missing_split_is_reported(folder: Path, tmp_path: Path) -> None:
    with pytest.raises(ShardError, match="no samples of split test: choose from train"):
        ShardReader(folder, "test")
    with pytest.raises(ShardError, match="give a folder made by gcd generate"):
        ShardReader(tmp_path)
    with pytest.raises(ConfigError, match="verify='sometimes'"):
        ShardReader(folder, verify="sometimes")  # type: ignore[arg-type]


def test_a_run_killed_in_its_first_shard_is_reported(folder: Path) -> None:
    for shard in folder.glob("*.tar"):
        shard.unlink()
    (folder / "manifest.json").unlink()
    (folder / "train-00000.tar.part").touch()
    with pytest.raises(ShardError, match=r"no samples .*run gcd generate again to finish"):
        ShardReader(folder)


@pytest.mark.parametrize("mode", [0o000, 0o444, 0o111])
def test_an_unreadable_folder_is_named(mode: int) -> None:
    message = r"data.*cannot be read \(Permission denied\): ask for the right to read it"
    with public_folder() as place:
        folder = fill(place / "data", range(3))
        with forbidden(folder, mode), pytest.raises(ShardError, match=message):
            ShardReader(folder)


@pytest.mark.parametrize("name", ["manifest.json", "index-train.npz", "train-00000.tar"])
def test_an_unreadable_file_is_named(name: str) -> None:
    message = rf"{name}: cannot be read \(Permission denied"
    with public_folder() as place:
        folder = fill(place / "data", range(3))
        with forbidden(folder / name, 0o000), pytest.raises(ShardError, match=message):
            ShardReader(folder).read(0, MEMBERS)


def test_only_remedies_that_exist_are_named(folder: Path) -> None:
    (folder / "manifest.json").write_text("{")
    with pytest.raises(ShardError, match=r"not a manifest.*: delete it") as message:
        ShardReader(folder)
    assert "download" not in str(message.value)
    (folder / "manifest.json").unlink()
    assert len(ShardReader(folder)) == 10


def test_missing_samples_leave_positions_dense(tmp_path: Path) -> None:
    shards = ShardReader(fill(tmp_path, [1, 7, 3]))
    for position, index in enumerate([1, 3, 7]):
        assert shards.read(position, ["meta.json"])["meta.json"] == encode_sample(fake_sample(0, index))["meta.json"]


@pytest.mark.parametrize("verify", ["lazy", "off"])
def test_a_shard_whose_samples_have_moved_is_reported(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, verify: Verify
) -> None:
    """Missing samples were inserted after the index was read."""
    monkeypatch.setattr(folders, "OPEN_FILES", 1)
    folder = fill(tmp_path, [0, 2, 4])
    reader = ShardReader(folder, verify=verify)
    for position in range(3):
        reader.read(position, MEMBERS)
    fill(folder, [1, 5])
    for _ in range(2):
        with pytest.raises(ShardError, match=r"train-00000\.tar: .*samples were inserted.*: open the data set again"):
            reader.read(1, MEMBERS)
    assert reader.read(2, MEMBERS) == encode_sample(fake_sample(0, 4))  # its shard has only grown at the end
    assert pickle.loads(pickle.dumps(reader)).read(2, MEMBERS) == encode_sample(fake_sample(0, 4))


def test_a_reader_may_be_pickled_spawned_and_shared_by_threads(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(folders, "OPEN_FILES", 1)
    shards = ShardReader(folder)
    expected = [encode_sample(fake_sample(0, position))["verts.npy"] for position in range(10)]
    assert shards.read(0, ["verts.npy"])["verts.npy"] == expected[0]
    copy = pickle.loads(pickle.dumps(shards))
    assert copy.read(9, ["verts.npy"])["verts.npy"] == expected[9]
    order = np.random.default_rng(1).integers(10, size=200).tolist()
    with ThreadPoolExecutor(4) as pool:
        read = list(pool.map(lambda position: shards.read(position, ["verts.npy"])["verts.npy"], order))
    assert all(data == expected[position] for position, data in zip(order, read, strict=True))
    context = multiprocessing.get_context("spawn")
    with context.Pool(1) as processes:
        assert processes.map(shards_length, [shards]) == [(10, len(expected[3]))]


def shards_length(shards: ShardReader) -> tuple[int, int]:
    return len(shards), len(shards.read(3, ["verts.npy"])["verts.npy"])
