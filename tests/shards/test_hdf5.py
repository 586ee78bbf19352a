"""One HDF5 file holds what the shards hold, byte for byte."""

import pickle
import threading
from pathlib import Path

import h5py
import numpy as np
import pytest
import torch
from torch.utils.data import DataLoader

from gcd_dataset.errors import ConfigError, OutputError, ShardError
from gcd_dataset.loaders import GarmentDataset, GarmentLoader, Hdf5Garments, collate_list
from gcd_dataset.loaders.base import Item
from gcd_dataset.shards import MEMBERS, ShardReader
from gcd_dataset.shards.hdf5 import Hdf5Reader, write_hdf5
from tests.shards.folders import fill

COUNT = 6


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return fill(tmp_path_factory.mktemp("shards"), range(COUNT))


@pytest.fixture
def file(folder: Path, tmp_path: Path) -> Path:
    path = tmp_path / "train.h5"
    assert list(write_hdf5(ShardReader(folder), path)) == list(range(COUNT))
    return path


def test_every_member_is_byte_for_byte_that_of_the_shard(folder: Path, file: Path) -> None:
    shards, one = ShardReader(folder), Hdf5Reader(file)
    assert len(one) == COUNT
    assert one.split == "train"
    for position in reversed(range(COUNT)):
        there, here = shards.read(position, MEMBERS), one.read(position, MEMBERS)
        assert {member: bytes(data) for member, data in there.items()} == {m: bytes(d) for m, d in here.items()}
        one.check(position)


def test_items_are_those_of_the_shards(folder: Path, file: Path) -> None:
    shards, one = GarmentDataset(folder), Hdf5Garments(file)
    assert len(one) == len(shards)
    for before, after in zip(shards, one, strict=True):
        assert before.keys() == after.keys()
        for field, value in before.items():
            same = torch.equal(value, after[field]) if isinstance(value, torch.Tensor) else value == after[field]
            assert same, field
    assert Hdf5Garments(file, fields=("verts",))[-1].keys() == {"verts"}
    assert one.recipe(2) == shards.recipe(2)
    with pytest.raises(IndexError):
        one[COUNT]


def test_they_are_read_beside_the_training_loop(file: Path) -> None:
    readers: set[int] = set()

    def noted(item: Item) -> Item:
        readers.add(threading.get_ident())
        return item

    assert len(list(GarmentLoader(Hdf5Garments(file, fields=["verts"], transform=noted), 2))) == 3
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


def test_forked_and_unpickled_readers_open_the_file_for_themselves(file: Path) -> None:
    one = Hdf5Garments(file, fields=("verts", "meta"))
    first = one[0]["verts"]  # open here, before workers are forked
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


def test_a_changed_byte_of_what_is_known_of_a_garment_is_found(folder: Path, file: Path) -> None:
    meta = bytes(ShardReader(folder).read(2, MEMBERS)["meta.json"])
    content = bytearray(file.read_bytes())
    content[content.index(meta) + meta.index(b'"attempts":') + len(b'"attempts":')] ^= 1
    file.write_bytes(content)
    one = Hdf5Garments(file)
    one.verify(1)
    with pytest.raises(ShardError, match=r"sample 2, member meta\.json: bytes differ"):
        one.verify(2)


def test_files_that_are_not_ours_are_told(file: Path, tmp_path: Path) -> None:
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
    with pytest.raises(ShardError, match="not a file that gcd export has made"):
        Hdf5Garments(tmp_path / "other.h5")
    with h5py.File(file, "r+") as newer:
        newer.attrs["schema"] = 99
    with pytest.raises(ShardError, match="of schema 99, and this reader knows 1 and 2"):
        Hdf5Garments(file)
    with pytest.raises(ConfigError, match="no field"):
        Hdf5Garments(file, fields="vertices")


def test_a_file_has_its_name_once_it_is_whole(folder: Path, tmp_path: Path) -> None:
    path = tmp_path / "train.h5"
    path.write_bytes(b"before")
    writing = write_hdf5(ShardReader(folder), path)
    next(writing)
    assert path.read_bytes() == b"before"
    writing.close()
    assert [file.name for file in tmp_path.iterdir()] == ["train.h5"]
    with pytest.raises(OutputError, match="cannot be written"):
        list(write_hdf5(ShardReader(folder), tmp_path / "no" / "train.h5"))
