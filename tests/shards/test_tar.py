"""Our archives, read by other programs, with ``gcd_dataset.decode``, and by this package."""

import io
import json
import tarfile
import zlib
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import datasets
import numpy as np
import pytest
import webdataset as wds

from gcd_dataset import decode
from gcd_dataset.errors import ShardError
from gcd_dataset.loaders.fake import fake_sample
from gcd_dataset.records import StoredView
from gcd_dataset.shards import FIELDS, MEMBERS, decode_fields, encode_sample
from gcd_dataset.shards.body_set import encode_person
from gcd_dataset.shards.layout import is_picture
from gcd_dataset.shards.tar import BLOCK, END, samples_in, tar_entries, tar_entry
from tests.shards.folders import fill, write_shard, write_tar
from tests.shards.people import fake_person

MAIN = [member for member in MEMBERS if not is_picture(member)]


# webdataset closes no tar.
pytestmark = pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")

ARRAYS = {field for field, member in FIELDS.items() if member.endswith(".z")}


@pytest.fixture(scope="module")
def tars(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """A shard of three samples, and the tar of its pictures."""
    folder = fill(tmp_path_factory.mktemp("tars"), range(3))
    return folder / "train-00000.tar", folder / "views" / "train-00000.tar"


def test_tarfile_reads_a_shard(tars: tuple[Path, Path]) -> None:
    with tarfile.open(tars[0]) as archive:
        members = archive.getmembers()
        assert [m.name for m in members] == [f"gcd_{i:09d}.{member}" for i in range(3) for member in MAIN]
        assert {(m.mtime, m.uid, m.gid, m.mode, m.uname, m.type) for m in members} == {(0, 0, 0, 0o644, "", b"0")}
        assert all(m.offset_data % BLOCK == 0 for m in members)
        file = archive.extractfile("gcd_000000001.verts.z")
        assert file is not None
        assert file.read() == encode_sample(fake_sample(0, 1))["verts.z"]


def test_entries_of_any_size_are_read_back_and_damage_is_reported_with_its_offset(tmp_path: Path) -> None:
    def entries_of(archive: bytes) -> list[tuple[str, int, int]]:
        (tmp_path / "a.tar").write_bytes(archive)
        with (tmp_path / "a.tar").open("rb") as file:
            return list(tar_entries(file.fileno()))

    for size in (0, 1, BLOCK - 1, BLOCK, BLOCK + 1, 100_000):
        archive = tar_entry("first", b"x" * size) + tar_entry("second", b"yy") + bytes(END)
        first, second = entries_of(archive)
        assert (first[0], first[2], second[0], second[2]) == ("first", size, "second", 2)
        assert archive[second[1] :][:2] == b"yy"
        with tarfile.open(fileobj=io.BytesIO(archive)) as read:
            assert [member.size for member in read] == [size, 2]
    damaged = bytearray(tar_entry("first", b"x") + tar_entry("second", b"yy"))
    damaged[BLOCK * 2 + 3] ^= 1
    with pytest.raises(ShardError, match="no tar header at byte 1024"):
        entries_of(bytes(damaged))
    with pytest.raises(ShardError, match="first is cut off at byte 1500"):
        entries_of(tar_entry("first", b"x" * 2000)[:1500])
    with pytest.raises(ShardError, match="do not fit into a tar header"):
        tar_entry("x" * 101, b"")


def test_samples_of_an_archive_in_memory_are_found(tars: tuple[Path, Path]) -> None:
    content = memoryview(tars[0].read_bytes())
    samples = dict(samples_in(content))
    assert list(samples) == [f"gcd_{index:09d}" for index in range(3)]
    assert bytes(samples["gcd_000000002"]["verts.z"]) == encode_sample(fake_sample(0, 2))["verts.z"]
    again = memoryview(b"".join([tar_entry("a.x", b"1"), tar_entry("b.x", b"2"), tar_entry("a.y", b"3")]))
    for damaged, message in ((content[:3000], "is cut off"), (again, "occurs twice")):
        with pytest.raises(ShardError, match=message):
            list(samples_in(damaged))


def assert_arrays(found: Mapping[str, Any], index: int) -> None:
    for name, array in decode_fields(encode_sample(fake_sample(0, index)), ARRAYS).items():
        assert np.array_equal(np.reshape(found[name], array.shape), array), name  # HF gives an empty one as a list


def test_webdataset_decodes_members_and_maps_whole_samples(tars: tuple[Path, Path]) -> None:
    tar = wds.WebDataset(str(tars[0]), shardshuffle=False)
    for index, (sample, whole) in enumerate(zip(tar.decode(decode), list(tar.map(decode)), strict=True)):
        found = {name: array for member in sample if member.endswith(".z") for name, array in sample[member].items()}
        assert found.keys() == ARRAYS - {"box"}
        assert_arrays({**found, "box": whole["box"]}, index)
        assert sample["__key__"] == whole["__key__"] == f"gcd_{index:09d}"
        assert sample["meta.json"]["index"] == index
        assert sample["design.txt"] == fake_sample(0, index).design
        assert sample["measures.json"] == fake_sample(0, index).measurements.to_file_values()
        assert whole.keys() == ARRAYS | {"meta", "spec", "design", "measures", "__key__"}
        assert_arrays(whole, index)
    assert next(iter(tar.decode(decode).map(decode))).keys() == whole.keys() - {"box"}


def test_pictures_are_left_to_webdataset(tmp_path: Path) -> None:
    sample = fake_sample(0, 0)
    view = StoredView(sample.front or b"", {"camera": {"size": [16, 16]}})
    tars = write_shard(tmp_path, [replace(sample, caption="a skirt", views=(view,))])
    (pictures,) = wds.WebDataset(str(tars[1]), shardshuffle=False).decode(decode, "rgb8")
    assert pictures["front.jpg"].shape == pictures["view_0.jpg"].shape == (16, 16, 3)
    assert pictures["view_0.json"] == view.facts
    (item,) = wds.WebDataset(str(tars[0]), shardshuffle=False).map(decode)
    assert item["caption"] == "a skirt"
    assert decode(".front.jpg", sample.front or b"") is None
    assert decode({"front.jpg": sample.front}) == {}


@pytest.mark.parametrize("streaming", [True, False])
def test_datasets_maps_whole_samples(tars: tuple[Path, Path], tmp_path: Path, streaming: bool) -> None:

    def rows(path: Path) -> Any:
        given = {"data_files": str(path), "streaming": streaming, "cache_dir": str(tmp_path), "split": "train"}
        return datasets.load_dataset("webdataset", **given)

    items = rows(tars[0]).map(decode, remove_columns=rows(tars[0]).column_names)
    for index, item in enumerate(items):
        assert item.keys() == ARRAYS | {"meta", "spec", "design", "measures"}
        assert_arrays(item, index)
        assert item["meta"]["index"] == index
        assert json.loads(item["design"]) == fake_sample(0, index).design  # a text: its keys differ between samples
    assert next(iter(rows(tars[1]).map(decode)))["front.jpg"].size == (16, 16)


def test_people_are_decoded(tmp_path: Path) -> None:
    origin = {"index": 3, "seed": 0, "recipe": {}, "versions": {}}
    tar = write_tar(tmp_path / "people.tar", {"gcd_000000003": encode_person(fake_person(3), origin)})
    (person,) = wds.WebDataset(str(tar), shardshuffle=False).map(decode)
    assert person["meta"]["name"] == "fake:3"
    assert np.abs(person["apart"] - fake_person(3).apart).max() < 1e-3


def test_a_damaged_member_is_named() -> None:
    members = encode_sample(fake_sample(0, 0))
    damaged = bytearray(members["verts.z"])
    damaged[-1] ^= 1
    with pytest.raises(ShardError, match=r"member verts\.z: not a whole frame"):
        decode(".verts.z", bytes(damaged))
    with pytest.raises(ShardError, match=r"member verts\.z"):
        decode({**members, "verts.z": bytes(damaged)})
    with pytest.raises(ShardError, match=r"member future\.z: not a whole frame"):
        decode(".future.z", b"abc")


def header(kind: bytes = tarfile.REGTYPE, name: str = "gcd_000000000.verts.z", **more: Any) -> bytes:
    info = tarfile.TarInfo(name)
    info.type = kind
    for attribute, value in more.items():
        setattr(info, attribute, value)
    return info.tobuf(tarfile.PAX_FORMAT if "pax_headers" in more else tarfile.USTAR_FORMAT)


def signed(position: int, field: bytes, kind: bytes = tarfile.REGTYPE) -> bytes:
    """A header with other bytes at a position, and the checksum that belongs to them."""
    content = bytearray(header(kind)[:BLOCK])
    content[position : position + len(field)] = field
    content[148:156] = 8 * b" "
    content[148:156] = b"%06o\0 " % sum(content)
    return bytes(content)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (signed(483, b"100000000000", tarfile.GNUTYPE_SPARSE), "not a plain file"),  # declares 8 GiB
        (header(pax_headers={"size": "99999999999"}), "not a plain file"),
        (header(tarfile.GNUTYPE_LONGNAME, size=1 << 32), "not a plain file"),
        (header(tarfile.SYMTYPE, linkname="/etc/passwd"), "not a plain file"),
        (header(size=1 << 30), r"verts\.z is cut off"),
        (signed(124, b"000000000017"), "tar header of another program"),  # other readers read twelve digits
        (2 * header(), "occurs twice"),
        (zlib.compress(bytes(1 << 20), wbits=31), "no tar header"),
    ],
)
def test_headers_that_other_readers_understand_otherwise_are_refused(content: bytes, message: str) -> None:
    with pytest.raises(ShardError, match=message):
        list(samples_in(memoryview(content)))
