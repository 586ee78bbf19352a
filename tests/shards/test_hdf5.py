"""An HDF5 file holds the members of the shards, byte for byte."""

import json
import os
import pickle
import struct
import threading
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
import torch
from torch.utils.data import DataLoader

from gcd_dataset.errors import ConfigError, GcdError, OutputError, ShardError
from gcd_dataset.generator import make
from gcd_dataset.generator.recipe import MakeConfig
from gcd_dataset.generator.views import MISSING_VIEW
from gcd_dataset.loaders import GarmentDataset, GarmentLoader, Hdf5Garments, collate_list
from gcd_dataset.loaders.fake import fake_sample
from gcd_dataset.records import Sample, View
from gcd_dataset.shards import FIELDS, MEMBERS, ShardReader, ShardWriter, hdf5
from gcd_dataset.shards.hdf5 import Hdf5Reader, write_hdf5
from gcd_dataset.shards.layout import garments_layout
from tests.shards.folders import fill

COUNT = 6
GARMENTS = 3  # generated garments


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return fill(tmp_path_factory.mktemp("shards"), range(COUNT))


@pytest.fixture
def file(folder: Path, tmp_path: Path) -> Path:
    path = tmp_path / "train.h5"
    assert list(write_hdf5(ShardReader(folder), path)) == list(range(COUNT))
    return path


def test_every_member_equals_the_shards_byte_for_byte(folder: Path, file: Path) -> None:
    shards, one = ShardReader(folder), Hdf5Reader(file)
    assert len(one) == COUNT
    assert one.split == "train"
    for position in reversed(range(COUNT)):
        there, here = shards.read(position, MEMBERS), one.read(position, MEMBERS)
        assert {member: bytes(data) for member, data in there.items()} == {m: bytes(d) for m, d in here.items()}
        one.check(position)


def captioned(folder: Path) -> Path:
    """A file of two samples with captions and two views, beside its shards."""
    layout = garments_layout(caption=True, views=2)
    with ShardWriter(folder, seed=0, recipe={}, layout=layout) as writer:
        for index in range(2):
            one, other = fake_sample(0, index).front, fake_sample(0, index + 5).front
            assert one is not None and other is not None
            views = (View(one, MISSING_VIEW.facts), View(other, {**MISSING_VIEW.facts, "number": index}))
            writer.write(replace(fake_sample(0, index), caption=f"skirt {index}", views=views))
    list(write_hdf5(ShardReader(folder), folder / "train.h5"))
    return folder / "train.h5"


def test_a_file_holds_views(tmp_path: Path, file: Path) -> None:
    folder = tmp_path / "own"
    own, shards = captioned(folder), ShardReader(folder)
    reader = Hdf5Reader(own)
    assert reader.members == shards.layout.members
    for position in range(2):
        there, here = shards.read(position, reader.members), reader.read(position, reader.members)
        assert {member: bytes(data) for member, data in there.items()} == {m: bytes(d) for m, d in here.items()}
        reader.check(position)
    views = ("view_0", "view_0_json", "view_1", "view_1_json")
    ds: Any = Hdf5Garments(own)
    assert set(ds[0]) == {*FIELDS, "caption", *views}
    assert [item["view_1_json"]["number"] for item in ds] == [0, 1]
    joint = ("views", "camera_k", "camera_rt")
    for one, other in zip(
        map(dict[str, Any], Hdf5Garments(own, joint)),
        map(dict[str, Any], GarmentDataset(folder, fields=joint)),
        strict=True,
    ):
        assert all(torch.equal(one[field], other[field]) for field in joint)
    with h5py.File(own) as data:
        start, end = data["ptr/view_1"][1:3]
        assert data["view_1"][start:end].tobytes()[:2] == b"\xff\xd8"  # JPEG
        assert json.loads(data["view_1_json"].asstr()[1])["number"] == 1
    with pytest.raises(ConfigError, match="no field views"):
        Hdf5Garments(file, fields=["views"])


def test_a_damaged_view_is_found(tmp_path: Path) -> None:
    own = captioned(tmp_path)
    with h5py.File(own, "r+") as data:
        start = data["ptr/view_1"][1]
        data["view_1"][start + 9] ^= 1
    Hdf5Garments(own).verify(0)
    with pytest.raises(ShardError, match=r"sample 1, member view_1\.jpg"):
        Hdf5Garments(own).verify(1)


def test_a_file_holds_captions(tmp_path: Path, file: Path) -> None:
    ds = Hdf5Garments(captioned(tmp_path / "captioned"), fields=["caption"])
    assert [item["caption"] for item in ds] == ["skirt 0", "skirt 1"]
    ds.verify(1)
    damaged = tmp_path / "damaged.h5"
    damaged.write_bytes((tmp_path / "captioned" / "train.h5").read_bytes().replace(b"skirt 1", b"skirt 9"))
    with pytest.raises(ShardError, match=r"sample 1, member caption\.txt"):
        Hdf5Garments(damaged).verify(1)
    with pytest.raises(ConfigError, match="no field caption"):
        Hdf5Garments(file, fields=["caption"])


def test_a_damaged_sample_is_to_be_made_again_not_the_file_being_written(tmp_path: Path) -> None:
    def misshapen(sample: Sample, index: int) -> Sample:
        assert sample.points is not None
        return replace(sample, points=sample.points[:, :3] if index else sample.points)

    with ShardWriter(tmp_path, seed=0, recipe={}) as writer:
        for index in range(2):
            writer.write(misshapen(fake_sample(0, index), index))
    with pytest.raises(ShardError, match=r"sample 1, member points\.npy: .*copy the shard again, or delete it and run"):
        list(write_hdf5(ShardReader(tmp_path), tmp_path / "train.h5"))


def test_items_equal_the_items_of_the_shards(folder: Path, file: Path) -> None:
    shards, one = GarmentDataset(folder), Hdf5Garments(file)
    assert len(one) == len(shards)
    for before, after in zip(map(dict[str, Any], shards), map(dict[str, Any], one), strict=True):
        assert before.keys() == after.keys()
        for field, value in before.items():
            same = torch.equal(value, after[field]) if isinstance(value, torch.Tensor) else value == after[field]
            assert same, field
    assert Hdf5Garments(file, fields=("verts",))[-1].keys() == {"verts"}
    assert one.recipe(2) == shards.recipe(2)
    with pytest.raises(IndexError):
        one[COUNT]


def test_a_loader_with_workers_reads_the_file(file: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    readers, read = set[int](), Hdf5Reader.read

    def noted(reader: Hdf5Reader, *asked: Any) -> Any:
        readers.add(threading.get_ident())
        return read(reader, *asked)

    loader = GarmentLoader(Hdf5Garments(file, fields=["verts"]), 2)
    loader.state_dict()  # reads the first and the last garment in this thread
    monkeypatch.setattr(Hdf5Reader, "read", noted)
    assert len(list(loader)) == 3
    assert readers
    assert threading.get_ident() not in readers


def test_other_programs_find_arrays_and_texts(folder: Path, file: Path) -> None:
    item = GarmentDataset(folder)[3]
    with h5py.File(file) as data:
        start, end = data["ptr/verts"][3:5]
        assert np.array_equal(data["verts"][start:end], item["verts"].numpy())
        assert data["meta"].asstr()[3].startswith('{"schema":2')
        assert data.attrs["count"] == COUNT
        assert data["verts"].chunks is None


def test_forked_and_unpickled_readers_open_their_own_file(file: Path) -> None:
    one = Hdf5Garments(file, fields=("verts", "meta"))
    first = one[0]["verts"]  # opens the file before workers are forked
    loader = DataLoader(one, 2, num_workers=2, collate_fn=collate_list, multiprocessing_context="fork")
    items = [item for batch in loader for item in batch]
    assert [item["meta"]["index"] for item in items] == list(range(COUNT))
    assert torch.equal(items[0]["verts"], first)
    assert torch.equal(pickle.loads(pickle.dumps(one))[0]["verts"], first)


def test_a_changed_byte_is_found(folder: Path, file: Path) -> None:
    verts = GarmentDataset(folder)[2]["verts"].numpy()
    content = bytearray(file.read_bytes())
    content[content.index(verts.tobytes())] ^= 1
    file.write_bytes(content)
    one = Hdf5Garments(file)
    one.verify(1)
    with pytest.raises(ShardError, match=r"sample 2, member verts\.npy: bytes differ"):
        one.verify(2)


def test_a_changed_byte_of_meta_is_found(folder: Path, file: Path) -> None:
    meta = bytes(ShardReader(folder).read(2, MEMBERS)["meta.json"])
    content = bytearray(file.read_bytes())
    content[content.index(meta) + meta.index(b'"attempts":') + len(b'"attempts":')] ^= 1
    file.write_bytes(content)
    one = Hdf5Garments(file)
    one.verify(1)
    with pytest.raises(ShardError, match=r"sample 2, member meta\.json: bytes differ"):
        one.verify(2)


def test_files_by_other_programs_are_reported(file: Path, tmp_path: Path) -> None:
    with pytest.raises(ShardError, match="no such file: give one that gcd export --hdf5 has made"):
        Hdf5Garments(tmp_path / "nothing.h5")
    with pytest.raises(ShardError, match=r"a folder: give a file .*; GarmentDataset reads folders of shards"):
        Hdf5Garments(tmp_path)
    (tmp_path / "text.h5").write_text("not HDF5")
    with pytest.raises(ShardError, match="not HDF5, or damaged"):
        Hdf5Garments(tmp_path / "text.h5")
    cut = tmp_path / "cut.h5"
    cut.write_bytes(file.read_bytes()[:-1000])
    with pytest.raises(ShardError, match="not HDF5, or damaged"):
        Hdf5Garments(cut)
    with h5py.File(tmp_path / "other.h5", "w") as other:
        other["a"] = [1]
    with pytest.raises(ShardError, match="not written by gcd export"):
        Hdf5Garments(tmp_path / "other.h5")
    with h5py.File(file, "r+") as newer:
        newer.attrs["schema"] = 99
    with pytest.raises(ShardError, match="of schema 99, but this reader knows 1 and 2"):
        Hdf5Garments(file)
    with pytest.raises(ConfigError, match="no field"):
        Hdf5Garments(file, fields="vertices")


def test_a_file_appears_when_it_is_complete(folder: Path, tmp_path: Path) -> None:
    path = tmp_path / "train.h5"
    path.write_bytes(b"before")
    writing = write_hdf5(ShardReader(folder), path)
    next(writing)
    assert path.read_bytes() == b"before"
    writing.close()
    assert [file.name for file in tmp_path.iterdir()] == ["train.h5"]
    with pytest.raises(OutputError, match="cannot be written"):
        list(write_hdf5(ShardReader(folder), tmp_path / "no" / "train.h5"))


# ---------------------------------------------------------------------------------------------------------- damage


@pytest.fixture(scope="module")
def generated(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Generated garments, meshed, with their points, in an HDF5 file."""
    folder = tmp_path_factory.mktemp("generated")
    config = MakeConfig(stage="mesh", resolution=4.0, points=256)
    with ShardWriter(folder, split="train", seed=3, recipe={"stage": "mesh"}) as writer:
        for index in range(GARMENTS):
            writer.write(make(3, index, config))
    list(write_hdf5(ShardReader(folder), folder / "train.h5"))
    return folder / "train.h5"


@pytest.fixture
def spoiled(generated: Path, tmp_path: Path) -> Callable[[Callable[[h5py.File], Any]], Path]:
    """Copies of the file, changed through h5py."""

    def spoil(change: Callable[[h5py.File], Any]) -> Path:
        path = tmp_path / "spoiled.h5"
        path.write_bytes(generated.read_bytes())
        with h5py.File(path, "r+") as file:
            change(file)
        return path

    return spoil


def read_all(path: Path) -> list[dict[str, bytes]]:
    reader = Hdf5Reader(path)
    return [{m: bytes(d) for m, d in reader.read(i, MEMBERS).items()} for i in range(len(reader))]


def test_a_flipped_bit_is_reported_or_changes_nothing(generated: Path, tmp_path: Path) -> None:
    """Each flipped bit is reported when its member is read, or changes nothing."""
    reader, path = Hdf5Reader(generated), tmp_path / "flipped.h5"
    raw = generated.read_bytes()
    before = read_all(generated)
    random = np.random.default_rng(0)
    reported = 0
    # The layout is parsed once, from the undamaged file, so that each bit takes milliseconds.
    for place in random.integers(0, len(raw), 200).tolist():
        flipped = bytearray(raw)
        flipped[place] ^= 1 << int(random.integers(8))
        path.write_bytes(flipped)
        state = reader.__getstate__() | {"path": path, "_stamp": None}
        damaged = Hdf5Reader.__new__(Hdf5Reader)
        damaged.__setstate__(state)
        for position in range(GARMENTS):
            try:
                content = damaged.read(position, MEMBERS)
            except ShardError as error:
                assert str(path) in str(error)
                reported += 1
            else:
                assert {member: bytes(data) for member, data in content.items()} == before[position]
    assert reported > 150


def test_a_member_is_checked_once_and_again_on_demand(generated: Path, tmp_path: Path) -> None:
    path = tmp_path / "train.h5"
    path.write_bytes(generated.read_bytes())
    reader = Hdf5Reader(path)
    verts = reader.read(1, ["box.npy"])["box.npy"]
    place = path.read_bytes().index(bytes(verts)[-400:])
    with path.open("r+b") as file:  # changed on disk after the first check
        file.seek(place)
        file.write(b"\1\2\3")
    reader.read(1, ["box.npy"])
    with pytest.raises(ShardError, match=r"sample 1, member box\.npy: bytes differ"):
        reader.check(1)
    with pytest.raises(ShardError, match=r"sample 1, member box\.npy: bytes differ"):
        reader.read(1, ["box.npy"])


@pytest.mark.parametrize(
    ("name", "row", "value"), [("ptr/box", 1, 3), ("ptr/front", 2, 0), ("bytes/panels", 0, 2), ("bytes/faces", 1, 4)]
)
def test_edited_row_pointers_are_reported(
    spoiled: Callable[[Callable[[h5py.File], Any]], Path], name: str, row: int, value: int
) -> None:
    path = spoiled(lambda file: file[name].__setitem__(row, value))
    with pytest.raises(ShardError, match=r"spoiled\.h5: .*: copy it again, or make it again with gcd export"):
        read_all(path)


def replaced(name: str, **given: Any) -> Callable[[h5py.File], Any]:
    def change(file: h5py.File) -> None:
        del file[name]
        file.create_dataset(name, **given)

    return change


def to_elsewhere(file: h5py.File) -> None:
    del file["verts"]
    file["verts"] = h5py.ExternalLink("other.h5", "verts")


def from_another_file(file: h5py.File) -> None:
    shape, dtype = file["box"].shape, file["box"].dtype
    del file["box"]
    size = int(np.prod(shape)) * dtype.itemsize
    file.create_dataset("box", shape, dtype, external=[("/dev/zero", 0, size)])


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda file: file.attrs.__delitem__("schema"), "of schema nothing"),
        (lambda file: file.attrs.__setitem__("count", float("nan")), "its count is NaN"),
        (lambda file: file.attrs.__setitem__("count", -1), "its count is -1"),
        (lambda file: file.attrs.__setitem__("count", 2), "for 2 samples"),
        (lambda file: file.attrs.__setitem__("count", 1 << 40), f"its count is {1 << 40}"),
        (lambda file: file.attrs.__setitem__("format", [1, 2]), "not written by gcd export"),
        (replaced("spec", data=np.zeros(GARMENTS)), "spec is <f8"),
        (replaced("panels", data=np.zeros((9, 14), ">f8")), "panels is >f8"),
        (replaced("panels", data="text"), "panels is text of shape"),
        (replaced("ptr/box", data=np.zeros(GARMENTS, np.int64)), "ptr/box is <i8"),
        (replaced("box", data=np.zeros((99, 3)), chunks=(9, 3), compression="gzip"), "box is not contiguous"),
        (lambda file: file.__delitem__("panels") or file.create_group("panels"), "panels is a group"),
        (lambda file: file.__delitem__("edges"), "edges is missing"),
        (lambda file: file.__delitem__("ptr"), "ptr/panels is missing"),
        (to_elsewhere, "verts is a link"),
        (from_another_file, "box is not contiguous in this file"),
        (lambda file: file["bytes/panels"].__setitem__(0, 255), "numbers of 255 bytes in panels of sample 0"),
        (lambda file: file["spec"].__setitem__(0, "[" * 100_000), r"sample 0, member spec\.\w+: bytes differ"),
        (lambda file: file["meta"].__setitem__(0, "[" * 100_000), r"sample 0, member meta\.json: bytes differ"),
    ],
)
def test_errors_about_another_layout_are_one_line(
    spoiled: Callable[[Callable[[h5py.File], Any]], Path], change: Callable[[h5py.File], Any], message: str
) -> None:
    path = spoiled(change)
    with pytest.raises(ShardError, match=message) as caught:
        read_all(path)
    assert str(caught.value).startswith(f"{path}: ")
    assert "\n" not in str(caught.value)


def test_a_file_without_checksums_of_meta_is_read_with_a_warning(
    spoiled: Callable[[Callable[[h5py.File], Any]], Path], generated: Path, caplog: pytest.LogCaptureFixture
) -> None:
    path = spoiled(lambda file: file.__delitem__("crc32"))
    assert read_all(path) == read_all(generated)
    (message,) = [record.getMessage() for record in caplog.records]
    assert "spoiled.h5" in message
    assert "written by an early version, without checksums of meta.json: make it again with gcd export" in message
    with h5py.File(path, "r+") as file:
        file["meta"][0] = "[" * 100_000
    with pytest.raises(ShardError, match=r"meta\.json of sample 0 holds no CRC-32"):
        read_all(path)


def collections_in(content: bytes) -> list[int]:
    """Offsets of the heap collections."""
    places = [content.find(b"GCOL")]
    while places[-1] >= 0:
        places.append(content.find(b"GCOL", places[-1] + 1))
    return places[:-1]


def test_heap_collections_on_which_libhdf5_hangs_are_reported(generated: Path, tmp_path: Path) -> None:
    """An entry of no size, or of nearly 2⁶⁴ bytes, leads libhdf5 back to the same entry forever."""
    path = tmp_path / "endless.h5"
    whole = generated.read_bytes()
    for size in (0, (1 << 64) - 16, (1 << 64) - 1, 1 << 40):
        content = bytearray(whole)
        for place in collections_in(whole)[1:]:  # the first holds the attributes
            struct.pack_into("<Q", content, place + 24, size)
        path.write_bytes(content)
        with pytest.raises(ShardError, match=r"is not in the heap|it ends before"):
            read_all(path)
    content = bytearray(whole)
    place = collections_in(whole)[0]
    struct.pack_into("<Q", content, place + 24, (1 << 64) - 16)
    path.write_bytes(content)
    with pytest.raises(ShardError, match=r"endless\.h5: not HDF5, or damaged \("):
        Hdf5Reader(path)


def test_headers_that_take_too_long_are_given_up(
    generated: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    forever = tmp_path / "forever.py"
    forever.write_text("import time\ntime.sleep(60)\n")
    monkeypatch.setattr(hdf5, "LAYOUT_PROGRAM", forever)
    monkeypatch.setattr(hdf5, "WALL_SECONDS", 0.2)
    with pytest.raises(ShardError, match=r"reading its headers takes over 0\.2 s"):
        Hdf5Reader(generated)
    forever.write_text("import os, signal\nos.kill(os.getpid(), signal.SIGKILL)\n")
    monkeypatch.setattr(hdf5, "WALL_SECONDS", 60)
    with pytest.raises(ShardError, match=r"its headers crash libhdf5 \(signal 9\)"):
        Hdf5Reader(generated)


def test_a_pipe_and_a_replaced_file_are_reported(file: Path, tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe.h5")
    with pytest.raises(ShardError, match="not a file: give one written by gcd export --hdf5"):
        Hdf5Reader(tmp_path / "pipe.h5")
    reader = Hdf5Reader(file)
    reader.close()
    file.write_bytes(file.read_bytes() + b"\0")
    with pytest.raises(ShardError, match="changed since it was opened: open it again"):
        reader.read(0, MEMBERS)


def test_mutated_files_are_reported_or_read_unchanged(generated: Path, tmp_path: Path) -> None:
    """Also with mutated headers, which libhdf5 parses in a child process."""
    before, whole = read_all(generated), generated.read_bytes()
    random = np.random.default_rng(1)
    path = tmp_path / "mutated.h5"
    for _ in range(3):
        content = bytearray(whole)
        for place in random.integers(0, 12_000, 3).tolist():
            content[place] = int(random.integers(256))
        path.write_bytes(content)
        try:
            assert read_all(path) == before
        except GcdError as error:
            assert str(error).startswith(str(path))
