"""An HDF5 file holds the items of the shards."""

import json
import os
import pickle
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
import torch
from torch.utils.data import DataLoader

from gcd_dataset.errors import ConfigError, OutputError, ShardError
from gcd_dataset.loaders import GarmentDataset, GarmentLoader, Hdf5Garments, collate_list
from gcd_dataset.loaders.fake import fake_sample
from gcd_dataset.records import StoredView
from gcd_dataset.shards import FIELDS, ShardReader
from gcd_dataset.shards.hdf5 import write_hdf5
from tests.helpers import flip
from tests.loaders.test_shards import assert_all_same
from tests.shards.folders import fill, open_writer

COUNT = 6


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return fill(tmp_path_factory.mktemp("shards"), range(3, 3 + COUNT))


@pytest.fixture(scope="module")
def file(folder: Path) -> Path:
    assert list(write_hdf5(ShardReader(folder), folder / "train.h5")) == list(range(COUNT))
    return folder / "train.h5"


@pytest.mark.parametrize("dtype", [torch.float32, None])
def test_items_equal_the_items_of_the_shards(folder: Path, file: Path, dtype: torch.dtype | None) -> None:
    shards, one = GarmentDataset(folder, dtype=dtype), Hdf5Garments(file, dtype=dtype)
    assert_all_same(shards, one)
    assert list(shards[0]) == list(one[0])
    assert (len(one), one.split, one.recipe(2)) == (COUNT, "train", shards.recipe(2))
    assert Hdf5Garments(file, fields="verts")[-1].keys() == {"verts"}
    with pytest.raises(ConfigError, match="no field views: there are"):
        Hdf5Garments(file, fields=["views"])


def test_captions_views_and_skipped_stages(tmp_path: Path) -> None:
    bare: dict[str, Any] = dict.fromkeys(("box_mesh", "drape", "points", "shape", "front", "back"))
    for name in ("views", "patterns"):
        with open_writer(tmp_path / name) as writer:
            for index in range(3):
                camera = {"k": (index * np.eye(3)).tolist(), "rt": np.full((3, 4), 0.5).tolist()}
                views = tuple(StoredView(fake_sample(0, index + k).front or b"", {"camera": camera}) for k in (0, 5))
                optional = {"caption": f"Röckchen {index}", "views": views} if name == "views" else bare
                writer.write(replace(fake_sample(0, index), **optional))
        list(write_hdf5(ShardReader(tmp_path / name), tmp_path / f"{name}.h5"))
    one = Hdf5Garments(tmp_path / "views.h5")
    assert set(one[0]) == {*FIELDS, "caption", "view_0", "view_0_json", "view_1", "view_1_json"}
    for fields in (None, ["views", "camera_k", "camera_rt"], ["caption", "verts"]):
        assert_all_same(GarmentDataset(tmp_path / "views", fields=fields), Hdf5Garments(tmp_path / "views.h5", fields))
    one = Hdf5Garments(tmp_path / "patterns.h5")
    assert one.fields == ("meta", "spec", "design", "measures", "panels", "edges", "stitches", "closures", "lines")


def test_other_programs_find_arrays_and_texts(folder: Path, file: Path) -> None:
    item: Any = GarmentDataset(folder)[3]
    with h5py.File(file) as data:
        found = {name: data[name][slice(*data[f"{name}_ptr"][3:5])] for name in ("verts", "design", "front")}
        assert (data.attrs["count"], data["verts"].chunks) == (COUNT, None)
    assert np.array_equal(found["verts"], item["verts"].numpy())
    assert json.loads(found["design"].tobytes()) == item["design"]
    assert found["front"].tobytes()[:2] == b"\xff\xd8"  # JPEG


def test_processes_and_threads_open_their_own_file(file: Path) -> None:
    one = Hdf5Garments(file, fields=("verts", "meta"))
    first = one[0]["verts"]  # opens the file before workers are forked
    for context in ("fork", "spawn"):
        loader = DataLoader(one, 2, num_workers=1, collate_fn=collate_list, multiprocessing_context=context)
        items = [item for batch in loader for item in batch]
        assert [item["meta"]["index"] for item in items] == list(range(3, 3 + COUNT))
        assert torch.equal(items[0]["verts"], first)
    assert torch.equal(pickle.loads(pickle.dumps(one))[0]["verts"], first)
    assert len(list(GarmentLoader(one, 2))) == COUNT // 2


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


def test_files_by_other_programs_are_reported(file: Path, tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe.h5")
    (tmp_path / "folder.h5").mkdir()
    with h5py.File(tmp_path / "other.h5", "w") as other:
        other["a"] = [1]
    for number, content in enumerate((b"", b"not HDF5", file.read_bytes()[:-1000])):
        (tmp_path / f"{number}.h5").write_bytes(content)
    for name, told in (
        ("nothing", r"cannot be read \(No such file.*: give a file by gcd export"),
        ("folder", r"cannot be read \(Is a directory\)"),
        ("pipe", r"cannot be read \(a pipe, not a file\)"),
        ("other", "not written by gcd export"),
        *((str(number), "not HDF5, or damaged") for number in range(3)),
    ):
        with pytest.raises(ShardError, match=rf"{name}\.h5: {told}"):
            Hdf5Garments(tmp_path / f"{name}.h5")


def replaced(name: str, value: Any = None, **given: Any) -> Callable[[h5py.File], None]:
    """By a value, a link, or a data set of these options."""

    def change(file: h5py.File) -> None:
        del file[name]
        if value is None:
            file.create_dataset(name, **given)
        else:
            file[name] = value

    return change


def external(file: h5py.File) -> None:
    verts = file["verts"]
    replaced("verts", shape=verts.shape, dtype=verts.dtype, external=[("/dev/zero", 0, verts.nbytes)])(file)


def virtual(file: h5py.File) -> None:
    layout = h5py.VirtualLayout(file["verts"].shape, file["verts"].dtype)
    layout[:] = h5py.VirtualSource("/etc/passwd", "verts", file["verts"].shape)
    del file["verts"]
    file.create_virtual_dataset("verts", layout)


def sparse(file: h5py.File) -> None:
    """12 TB that no one has written."""
    file["verts_ptr"][COUNT] = 1 << 40
    replaced("verts", shape=(1 << 40, 3), dtype="<f4")(file)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda file: file.attrs.__setitem__("schema", 99), "of schema 99, but this reader knows 3: export it again"),
        (lambda file: file.attrs.__setitem__("format", [1, 2]), "not written by gcd export"),
        (lambda file: file.attrs.__setitem__("count", 1 << 40), r"crc32 is uint32 of shape \(6,\), expected"),
        (replaced("spec", np.zeros(COUNT)), r"spec is float64 of shape \(6,\)"),
        (replaced("panels", np.zeros((12, 14), ">f8")), "panels is >f8 of shape"),
        (replaced("verts", data=np.zeros((99, 3), "<f4"), chunks=(9, 3), compression="gzip"), "verts is no contiguous"),
        (lambda file: file["verts_ptr"].__setitem__(1, 1 << 40), "verts_ptr does not rise from 0"),
        (lambda file: file["verts_ptr"].__setitem__(COUNT, 1 << 40), "verts is float32 of shape"),
        (lambda file: file.__delitem__("verts_ptr"), "verts_ptr is no contiguous array"),
        (replaced("verts", h5py.ExternalLink("/etc/passwd", "verts")), "verts is no contiguous array|unable"),
        (replaced("verts", h5py.SoftLink("/faces")), "verts is no contiguous array"),
        (external, "verts is no contiguous array of this file"),
        (virtual, "verts is no contiguous array of this file"),
        (sparse, "verts ends at byte"),
    ],
)
def test_another_layout_is_one_sentence(
    file: Path, tmp_path: Path, change: Callable[[h5py.File], Any], message: str
) -> None:
    path = tmp_path / "spoiled.h5"
    path.write_bytes(file.read_bytes())
    with h5py.File(path, "r+") as opened:
        change(opened)
    with pytest.raises(ShardError, match=rf"^{path}: [^\n]*({message})"):
        Hdf5Garments(path)


def test_a_changed_byte_is_found(folder: Path, file: Path, tmp_path: Path) -> None:
    verts = GarmentDataset(folder)[2]["verts"].numpy()
    design = bytes(ShardReader(folder).read(2, ["design.txt"])["design.txt"])
    for part in (verts.tobytes(), design):
        changed = Path(shutil.copy(file, tmp_path / "changed.h5"))
        flip(changed, 11, after=part)
        one = Hdf5Garments(changed)
        one.verify(1)
        with pytest.raises(ShardError, match=r"changed\.h5: sample 2: bytes differ from the written ones"):
            one.verify(2)
