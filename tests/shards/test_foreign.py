"""Tars by other programs are read; malicious ones are refused."""

import io
import json
import os
import pickle
import struct
import tarfile
import zlib
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
import webdataset as wds
from PIL import Image

from gcd_dataset.errors import ConfigError, ShardError
from gcd_dataset.loaders import GarmentDataset
from gcd_dataset.shards import read_index, rebuild_index
from gcd_dataset.shards.contents import splits_in
from gcd_dataset.shards.foreign import samples_of

COUNT = 5


def picture() -> bytes:
    file = io.BytesIO()
    Image.new("RGB", (4, 3), (255, 0, 10)).save(file, "PNG")
    return file.getvalue()


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Two shards as ``webdataset`` writes them, one sample without a caption."""
    for shard in (0, 1):
        with wds.TarWriter(str(tmp_path / f"thing-{shard:06d}.tar")) as writer:
            for i in range(shard * COUNT, (shard + 1) * COUNT):
                sample = {"__key__": f"a{i}", "seg.npy": np.arange(i), "png": picture(), "json": {"i": i}, "cls": i}
                writer.write(sample | ({} if i == 3 else {"txt": f"No. {i}"}))
    return tmp_path


@pytest.mark.parametrize("indexed", [False, True])
def test_webdataset_shards_are_read_by_number(folder: Path, indexed: bool) -> None:
    if indexed:
        rebuild_index(folder)
    ds: Any = GarmentDataset(folder)
    assert (len(ds), ds.fields) == (2 * COUNT, ("cls", "json", "png", "seg.npy", "txt"))
    item = ds[7]
    assert (item["cls"], item["json"], item["txt"]) == (7, {"i": 7}, "No. 7")
    assert torch.equal(item["seg.npy"], torch.arange(7))
    assert item["png"][:, 0, 0].tolist() == [255, 0, 10]
    assert ds[3]["txt"] is None
    assert GarmentDataset(folder, fields=["cls"])[9].items() == {"cls": 9}.items()
    ds.verify(2)
    with pytest.raises(ConfigError, match="have no recipe"):
        ds.recipe(0)


def test_a_stream_yields_the_same_items(folder: Path) -> None:
    ds, stream = (GarmentDataset(folder, fields=["cls", "txt"], streaming=streaming) for streaming in (False, True))
    assert list(stream) == [ds[i] for i in range(len(ds))]


def test_an_index_finds_a_flipped_byte(folder: Path) -> None:
    index = rebuild_index(folder)
    column, path = index.layout.members.index("seg.npy"), folder / "thing-000001.tar"
    content = bytearray(path.read_bytes())
    content[int(index.table.offset[8, column]) + 130] ^= 1
    path.write_bytes(content)
    with pytest.raises(ShardError, match=r"thing-000001\.tar: sample a8, member seg\.npy: bytes differ"):
        GarmentDataset(folder, fields=["seg.npy"])[8]


def test_a_shard_added_later_is_found(folder: Path) -> None:
    rebuild_index(folder)
    (folder / "thing-000000.tar").rename(folder / "thing-000007.tar")
    assert [next(iter(item.values())) for item in GarmentDataset(folder, fields=["cls"])] == [
        5,
        6,
        7,
        8,
        9,
        0,
        1,
        2,
        3,
        4,
    ]


def test_splits_are_recognised_by_file_name(folder: Path) -> None:
    (folder / "thing-000001.tar").rename(folder / "thing_val.tar")
    assert splits_in(folder) == ("train", "validation")
    assert len(GarmentDataset(folder, "validation")) == len(GarmentDataset(folder)) == COUNT


Entries = Mapping[str, bytes]


def written(path: Path, entries: Entries, *, style: int = tarfile.PAX_FORMAT, change: Callable | None = None) -> Path:
    with tarfile.open(path, "w", format=style) as archive:
        for name, data in entries.items():
            info = tarfile.TarInfo(name)
            info.size = len(data)
            if change is not None and name != "ok.txt":
                change(info)
            archive.addfile(info, io.BytesIO(data))
    return path


def test_arrays_of_other_byte_orders_are_read_and_texts_reported(tmp_path: Path) -> None:
    def content(array: np.ndarray) -> bytes:
        file = io.BytesIO()
        np.save(file, array)
        return file.getvalue()

    written(tmp_path / "a.tar", {"s.big.npy": content(np.arange(3, dtype=">f4")), "s.text.npy": content(np.array("a"))})
    item: Any = GarmentDataset(tmp_path, fields=["big.npy"])[0]
    assert item["big.npy"].tolist() == [0.0, 1.0, 2.0]
    with pytest.raises(ShardError, match=r"member text\.npy: does not match its ending \(<U1, expected numbers\)"):
        GarmentDataset(tmp_path, fields=["text.npy"])[0]


def encoded(array: np.ndarray, form: str) -> bytes:
    file = io.BytesIO()
    Image.fromarray(array).save(file, form)
    return file.getvalue()


@pytest.mark.parametrize(("form", "ending"), [("PNG", "png"), ("TIFF", "tif"), ("PPM", "pgm")])
def test_a_depth_map_keeps_its_values(tmp_path: Path, form: str, ending: str) -> None:
    depth = np.array([[0, 255, 256], [4711, 65534, 65535]], np.uint16)
    written(tmp_path / "a.tar", {f"s.depth.{ending}": encoded(depth, form)})
    item: Any = GarmentDataset(tmp_path)[0]
    read = item[f"depth.{ending}"]
    assert (read.dtype, read.tolist()) == (torch.int32, [depth.tolist()])


def test_a_picture_of_floats_keeps_its_values(tmp_path: Path) -> None:
    heights = np.array([[-0.5, 1e6], [0.25, 300.0]], np.float32)
    written(tmp_path / "a.tar", {"s.height.tif": encoded(heights, "TIFF")})
    item: Any = GarmentDataset(tmp_path)[0]
    assert item["height.tif"].tolist() == [heights.tolist()]


def deep_png() -> bytes:
    """A PNG of one pixel with 16 bits a channel, which Pillow cannot write."""
    parts = {b"IHDR": struct.pack(">IIBBBBB", 1, 1, 16, 2, 0, 0, 0), b"IDAT": zlib.compress(b"\0\1\2\3\4\5\6")}
    parts[b"IEND"] = b""
    chunks = (name + data for name, data in parts.items())
    return b"\x89PNG\r\n\x1a\n" + b"".join(
        struct.pack(">I", len(chunk) - 4) + chunk + struct.pack(">I", zlib.crc32(chunk)) for chunk in chunks
    )


@pytest.mark.parametrize(
    ("name", "data"),
    [
        ("s.png", deep_png()),
        ("s.ppm", b"P6 1 1 65535 abcdef"),
        ("s.ppm", b"P6 1 1 1023 abcdef"),
        ("s.pgm", b"P5 1 1 1023 ab"),
    ],
    ids=["png", "ppm-65535", "ppm-1023", "pgm-1023"],
)
def test_pictures_that_would_lose_bits_are_reported(tmp_path: Path, name: str, data: bytes) -> None:
    written(tmp_path / "a.tar", {name: data})
    with pytest.raises(ShardError, match=r"more than 8 bits a channel, which would be reduced: store it as \.npy"):
        GarmentDataset(tmp_path)[0]


@pytest.mark.parametrize("style", [tarfile.USTAR_FORMAT, tarfile.GNU_FORMAT, tarfile.PAX_FORMAT])
def test_headers_of_any_tar_format_are_read(tmp_path: Path, style: int) -> None:
    long = "folder/" * 20 + "x" * (0 if style == tarfile.USTAR_FORMAT else 120)
    path = written(tmp_path / "a.tar", {f"{long}/one.a.TXT": b"1", "two.txt": b"22"}, style=style)
    with tarfile.open(path) as archive:
        expected = [(member.offset_data, member.size) for member in archive]
    with path.open("rb") as file:
        samples = list(samples_of(file))
    assert [sample.key for sample in samples] == [f"{long}/one", "two"]
    assert [list(sample.members) for sample in samples] == [["a.txt"], ["txt"]]
    assert [place[:2] for sample in samples for place in sample.members.values()] == expected


def linked(kind: bytes) -> Callable[[tarfile.TarInfo], None]:
    def change(info: tarfile.TarInfo) -> None:
        info.type, info.linkname, info.size = kind, "/etc/passwd", 0

    return change


@pytest.mark.parametrize(
    ("entries", "change", "message"),
    [
        ({"../evil.txt": b"x"}, None, r"member \.\./evil\.txt points outside the archive"),
        ({"a/../../evil.txt": b"x"}, None, "points outside the archive"),
        ({"/etc/evil.txt": b"x"}, None, "points outside the archive"),
        ({"a.txt": b""}, linked(tarfile.SYMTYPE), r"member a\.txt is a symbolic link, not a plain file"),
        ({"a.txt": b""}, linked(tarfile.LNKTYPE), "is a hard link"),
        ({"a.txt": b""}, linked(tarfile.FIFOTYPE), "is a pipe"),
        ({"a.txt": b""}, linked(tarfile.CHRTYPE), "is a device"),
    ],
)  # fmt: skip
@pytest.mark.parametrize("streaming", [False, True])
def test_members_outside_the_archive_are_refused(
    tmp_path: Path, entries: Entries, change: Callable | None, message: str, streaming: bool
) -> None:
    place = tmp_path / "data"
    place.mkdir()
    written(place / "train-00000.tar", {"ok.txt": b"fine", **entries}, change=change)
    before = sorted(tmp_path.rglob("*"))
    with pytest.raises(ShardError, match=rf"train-00000\.tar: .*{message}.*: get it again"):
        GarmentDataset(place, streaming=streaming)
    with pytest.raises(ShardError, match=message):
        rebuild_index(place)
    assert sorted(tmp_path.rglob("*")) == before


@pytest.mark.parametrize("kind", [tarfile.REGTYPE, tarfile.XHDTYPE, tarfile.GNUTYPE_LONGNAME, tarfile.AREGTYPE])
def test_a_declared_size_of_two_gigabytes_is_reported(tmp_path: Path, kind: bytes) -> None:
    info = tarfile.TarInfo("a.txt")
    info.size, info.type = 2 << 30, kind
    (tmp_path / "a.tar").write_bytes(info.tobuf(tarfile.GNU_FORMAT) + b"short".ljust(1024, b"\0"))
    with pytest.raises(ShardError, match=r"a\.tar: (member a\.txt is cut off: only 1024|a header of 2147483648 bytes)"):
        GarmentDataset(tmp_path)


class Bomb:
    def __reduce__(self) -> tuple[Callable, tuple[str]]:
        return os.mkdir, ("executed",)


@pytest.mark.parametrize("streaming", [False, True])
@pytest.mark.parametrize("name", ["x.pkl", "x.pickle", "x.pyd", "x.pth", "x.pt"])
def test_a_pickle_is_not_read(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str, streaming: bool) -> None:
    monkeypatch.chdir(tmp_path)
    written(tmp_path / "a.tar", {name: pickle.dumps(Bomb()), "x.json": b"[1]"})
    with pytest.raises(ShardError, match=rf"member {name[2:]} is a pickle, which could run code"):
        list(GarmentDataset(tmp_path, streaming=streaming))
    assert list(map(dict, GarmentDataset(tmp_path, fields=["json"], streaming=streaming))) == [{"json": [1]}]
    array = io.BytesIO()
    np.save(array, np.array([Bomb()], dtype=object), allow_pickle=True)
    written(tmp_path / "a.tar", {"x.npy": array.getvalue()})
    with pytest.raises(ShardError, match=r"member npy: does not match its ending"):
        list(GarmentDataset(tmp_path, streaming=streaming))
    assert not (tmp_path / "executed").exists()


@pytest.mark.parametrize("name", ["../evil.meta.json", "gcd_000000000.meta.json/../../evil"])
def test_names_in_our_archives_cannot_point_outside(tmp_path: Path, name: str) -> None:
    written(tmp_path / "train-00000.tar", {name: json.dumps({"schema": 1}).encode()})
    with pytest.raises(ShardError, match=r"outside the archive|does not begin"):
        read_index(tmp_path)


@pytest.mark.parametrize("content", [b"", b"\x1f\x8b" + bytes(2000), b"x" * 5000, bytes(10240)])
def test_a_file_that_is_no_archive_is_reported(tmp_path: Path, content: bytes) -> None:
    (tmp_path / "a.tar").write_bytes(content)
    with pytest.raises(ShardError, match=r"no tar header|no sample in a\.tar"):
        GarmentDataset(tmp_path)


@pytest.mark.parametrize("size", ["9" * 5000, "-1", "1e3", "\u0663", "", "0x10"])
def test_a_size_that_is_no_number_is_reported(tmp_path: Path, size: str) -> None:
    """In extended attributes a size may have any number of digits."""
    path = tmp_path / "a-train.tar"
    with tarfile.open(path, "w", format=tarfile.PAX_FORMAT) as tar:
        info = tarfile.TarInfo("a.txt")
        info.pax_headers, info.size = {"size": size}, 2
        tar.addfile(info, io.BytesIO(b"hi"))
    with pytest.raises(ShardError, match=r"a-train\.tar: a damaged header of extended attributes: get it again"):
        GarmentDataset(tmp_path)


def test_mutated_headers_are_reported_or_read() -> None:
    """Mutated names, sizes, kinds and extended attributes, under valid checksums."""
    content = io.BytesIO()
    with tarfile.open(fileobj=content, mode="w", format=tarfile.PAX_FORMAT) as tar:
        for name in ("d/a.json", "d/a.npy", "x" * 150 + ".txt", "d/b.cls"):
            info = tarfile.TarInfo(name)
            info.size = 600
            tar.addfile(info, io.BytesIO(bytes(600)))
    whole, random = content.getvalue(), np.random.default_rng(2)
    headers = [place for place in range(0, len(whole), 512) if whole[place + 257 : place + 262] == b"ustar"]
    for _ in range(300):
        mutated, place = bytearray(whole), int(random.choice(headers))
        for byte in random.integers(0, 600, 2).tolist():
            mutated[place + byte] = int(random.choice([0, 57, 128, 255]))
        mutated[place + 148 : place + 156] = b" " * 8
        mutated[place + 148 : place + 156] = b"%06o\0 " % sum(mutated[place : place + 512])
        try:
            found = list(samples_of(io.BytesIO(mutated)))
        except ShardError as error:
            assert "\n" not in str(error)
        else:
            assert sum(len(sample.members) for sample in found) <= 4
