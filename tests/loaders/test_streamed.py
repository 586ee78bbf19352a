"""Streams: the garments of the shards in order, read through webdataset; tars are checked before it sees them."""

import io
import tarfile
import zlib
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
import webdataset as wds
from torch.utils.data import DataLoader, IterableDataset

from gcd_dataset.errors import ConfigError, ShardError
from gcd_dataset.loaders import GarmentDataset, collate_list
from gcd_dataset.loaders.fake import fake_sample
from gcd_dataset.records import Grade, Outcome, View
from gcd_dataset.shards.reader import Verify
from gcd_dataset.shards.tar import BLOCK, CheckedTar, tar_entry
from tests.shards.folders import fill, open_writer

COUNT = 10


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Shards of 4, 4 and 2 garments."""
    return fill(tmp_path_factory.mktemp("data"), range(COUNT))


def assert_all_same(items: Iterable[Any], others: Iterable[Any]) -> None:
    for item, other in zip(items, others, strict=True):
        assert item.keys() == other.keys()
        for field, value in item.items():
            assert torch.equal(value, other[field]) if isinstance(value, torch.Tensor) else value == other[field], field


def test_a_stream_holds_the_same_garments(folder: Path) -> None:
    stream = GarmentDataset(folder, streaming=True)
    assert isinstance(stream, IterableDataset)
    ds = GarmentDataset(folder)
    for _ in range(2):  # two epochs
        assert_all_same(stream, [ds[i] for i in range(COUNT)])
    assert (len(stream), stream.recipe(7)) == (COUNT, ds.recipe(7))
    for wrong in (lambda: stream[0], lambda: stream.select([0]), lambda: stream[1:]):
        with pytest.raises(ConfigError, match="a stream has no indices: leave out streaming=True"):
            wrong()


@pytest.mark.parametrize("count", [COUNT, 3])  # three shards, or one, for two workers
def test_workers_split_a_stream(tmp_path: Path, count: int) -> None:
    stream = GarmentDataset(fill(tmp_path, range(count)), fields=("meta", "faces"), streaming=True)
    loader = DataLoader(stream, batch_size=None, num_workers=2)
    assert sorted(item["meta"]["index"] for item in loader) == list(range(count))


def test_pictures_come_from_their_own_tars(tmp_path: Path) -> None:
    with open_writer(tmp_path) as writer:
        for index in range(6):
            sample = fake_sample(0, index)
            view = View(sample.back or b"", {"camera": {"k": np.eye(3).tolist(), "rt": np.eye(4)[:3].tolist()}})
            writer.write(replace(sample, views=(view,), caption=f"skirt {index}"))
    for fields in (["front"], ["verts", "view_0_json", "caption"], ["view_0"], ["views", "camera_k"], None):
        ds = GarmentDataset(tmp_path, "train[2:]", fields)
        assert_all_same(GarmentDataset(tmp_path, "train[2:]", fields, streaming=True), [ds[i] for i in range(4)])
    (tmp_path / "views" / "train-00001.tar").unlink()
    assert len(list(GarmentDataset(tmp_path, fields=["verts"], streaming=True))) == 6
    with pytest.raises(ShardError, match=r"views/train-00001\.tar: no such file, but manifest\.json lists it"):
        list(GarmentDataset(tmp_path, fields=["front"], streaming=True))


@pytest.mark.parametrize("verify", ["lazy", "off"])
def test_a_stream_without_fields_has_an_item_for_each_garment(folder: Path, verify: Verify) -> None:
    assert list(GarmentDataset(folder, fields=[], streaming=True, verify=verify)) == COUNT * [{}]


def test_a_stream_leaves_out_what_was_not_asked_for(tmp_path: Path) -> None:
    ends = [(Outcome.NOT_SETTLED, Grade.FAILED), (Outcome.SETTLED, Grade.CLEAN), (Outcome.DIVERGED, Grade.FAILED)] * 2
    with open_writer(tmp_path) as writer:
        for index, (outcome, grade) in enumerate(ends):
            sample = fake_sample(0, index)
            writer.write(replace(sample, drape=replace(sample.drape, outcome=outcome), grade=grade))  # type: ignore[type-var]
    for option in ({"settled_only": True}, {"quality": "paper"}):
        given: dict[str, Any] = {"fields": ["meta"], "streaming": True, **option}
        for verify in ("lazy", "off"):
            stream = GarmentDataset(tmp_path, verify=verify, **given)
            assert [item["meta"]["index"] for item in stream] == [1, 4]
        loader = DataLoader(stream, 1, num_workers=2, collate_fn=collate_list)
        assert sorted(batch[0]["meta"]["index"] for batch in loader) == [1, 4]


# ------------------------------------------------------------------------------------------------------------- damage


def changed(folder: Path, place: int) -> None:
    content = bytearray((folder / "train-00000.tar").read_bytes())
    content[place] ^= 1
    (folder / "train-00000.tar").write_bytes(content)


def test_damage_in_a_stream_is_named(tmp_path: Path) -> None:
    folder = fill(tmp_path, range(3))
    with tarfile.open(folder / "train-00000.tar") as tar:
        entry = tar.getmember("gcd_000000001.verts.z")
    changed(folder, entry.offset_data + 100)
    stream = GarmentDataset(folder, fields=["verts"], streaming=True)
    with pytest.raises(ShardError, match=r"train-00000\.tar: sample gcd_000000001, member verts\.z: bytes differ"):
        list(stream)
    changed(folder, entry.offset + 5)
    with pytest.raises(ShardError, match=r"train-00000\.tar: a damaged archive \(no tar header at byte \d+\): copy"):
        list(GarmentDataset(folder, fields=["faces"], streaming=True))


def test_a_truncated_stream_is_named(tmp_path: Path) -> None:
    stream = GarmentDataset(fill(tmp_path, range(3)), fields=["meta"], streaming=True)
    shard = tmp_path / "train-00000.tar"
    content = shard.read_bytes()
    for broken in (
        b"\1" + content[1:],
        content[: len(content) // 2],
        content[: len(content) // 2 // BLOCK * BLOCK],
        b"",
    ):
        shard.write_bytes(broken)
        with pytest.raises(ShardError, match=r"train-00000\.tar: .*: copy"):
            list(stream)


def test_samples_of_another_number_are_named(tmp_path: Path) -> None:
    stream = GarmentDataset(fill(tmp_path / "a", range(3)), fields=["meta"], streaming=True)
    other = fill(tmp_path / "b", range(3), seed=1) / "train-00000.tar"
    (tmp_path / "a" / "train-00000.tar").write_bytes(other.read_bytes().replace(b"gcd_000000002.m", b"gcd_000000003.m"))
    with pytest.raises(ShardError, match=r"train-00000\.tar: "):
        list(stream)


# --------------------------------------------------------------------------------------------- tars of unknown origin


def entry(name: str, kind: bytes = tarfile.REGTYPE, size: int = 0, **more: Any) -> bytes:
    info = tarfile.TarInfo(name)
    info.type, info.size = kind, size
    for attribute, value in more.items():
        setattr(info, attribute, value)
    return info.tobuf(tarfile.USTAR_FORMAT)


def twelve_digits() -> bytes:
    """A size of which other readers read twelve digits."""
    header = bytearray(tar_entry("gcd_000000000.verts.z", b"")[:BLOCK])
    header[124:136] = b"000000000017"
    header[148:156] = 8 * b" "
    header[148:156] = b"%06o\0 " % sum(header)
    return bytes(header) + bytes(BLOCK)


def sparse() -> bytes:
    """A GNU sparse file that declares 64 GiB."""
    header = bytearray(entry("gcd_000000000.verts.z", tarfile.GNUTYPE_SPARSE))
    header[386:410] = b"00000000000\000000000000000"[:24]
    header[483:495] = b"1000000000000"[:12]
    header[148:156] = 8 * b" "
    header[148:156] = b"%06o\0 " % sum(header[:BLOCK])
    return bytes(header)


def pax(**headers: str) -> bytes:
    info = tarfile.TarInfo("gcd_000000000.verts.z")
    info.pax_headers = headers
    return info.tobuf(tarfile.PAX_FORMAT)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (sparse(), "not a plain file"),
        (pax(size="99999999999"), "not a plain file"),
        (pax(**{"GNU.sparse.major": "1", "GNU.sparse.realsize": "99999999999"}), "not a plain file"),
        (entry("x" * 90, tarfile.GNUTYPE_LONGNAME, 1 << 32), "not a plain file"),
        (entry("gcd_000000000.verts.z", tarfile.SYMTYPE, linkname="/etc/passwd"), "not a plain file"),
        (entry("gcd_000000000.verts.z", tarfile.LNKTYPE, linkname="meta.json"), "not a plain file"),
        (entry("gcd_000000000.verts.z", size=1 << 30), "1073741824 bytes, over the limit of 536870912"),
        (twelve_digits(), "tar header of another program"),
        (b"".join(entry(f"gcd_000000000.{number}") for number in range(300)), "has over 232 members"),
        (2 * entry("gcd_000000000.verts.z"), "occurs twice"),
        (zlib.compress(bytes(1 << 20), wbits=31), "no tar header"),
        (b"BZh91AY" + bytes(2000), "no tar header"),
    ],
)
def test_harmful_headers_are_refused_before_webdataset_sees_them(tmp_path: Path, content: bytes, message: str) -> None:
    shard = fill(tmp_path, range(2)) / "train-00000.tar"
    stream = GarmentDataset(tmp_path, streaming=True)
    shard.write_bytes(content + shard.read_bytes())
    with pytest.raises(ShardError, match=rf"train-00000\.tar: a damaged archive \([^\n]*{message}"):
        list(stream)


@pytest.mark.parametrize("name", ["thing-000000.tar", "train-00000.tar", "train.tar"])
@pytest.mark.parametrize("streaming", [False, True])
def test_tars_of_other_programs_are_left_to_webdataset(tmp_path: Path, name: str, streaming: bool) -> None:
    with wds.TarWriter(str(tmp_path / name)) as writer:
        writer.write({"__key__": "a1", "txt": "hi", "json": {"a": 1}})
    with pytest.raises(ShardError, match=rf"^{tmp_path}/?: tars of another program: read them with webdataset"):
        GarmentDataset(tmp_path, streaming=streaming)


@pytest.mark.parametrize("size", [1, 100, 511, 512, 513, 10_240, 1 << 20])
def test_headers_are_found_in_reads_of_any_size(folder: Path, size: int) -> None:
    content = (folder / "train-00000.tar").read_bytes()
    checked = CheckedTar(io.BytesIO(content))
    assert b"".join(iter(lambda: checked.read(size), b"")) == content
    last = content.rindex(b"gcd_000000003.points.z")
    damaged = CheckedTar(io.BytesIO(content[:last] + b"x" + content[last + 1 :]))
    with pytest.raises(ShardError, match=f"no tar header at byte {last}"):
        list(iter(lambda: damaged.read(size), b""))
