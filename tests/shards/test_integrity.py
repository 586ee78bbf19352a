"""Edited, damaged and huge files are reported in one line that names the file, before anything large is allocated."""

import io
import json
import os
import struct
import zipfile
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from gcd_dataset.errors import ShardError
from gcd_dataset.jsonfile import DEEPEST
from gcd_dataset.loaders import GarmentDataset
from gcd_dataset.loaders.fake import fake_sample
from gcd_dataset.shards import MEMBERS, ShardReader, decode_sample, encode_sample, read_index
from gcd_dataset.shards.arrays import Column, read_arrays
from gcd_dataset.shards.codec import decode_field
from gcd_dataset.shards.foreign_member import decode_member
from gcd_dataset.shards.index import ShardIndex
from gcd_dataset.shards.layout import shard_number
from gcd_dataset.shards.meta import read_meta, sealed
from gcd_dataset.shards.npy import read_any_npy, read_npy, write_npy
from gcd_dataset.shards.tar import BLOCK, END, tar_entry
from tests.shards.folders import fill

DEEP = b"[" * 100_000
HUGE = b'{"n":' + b"9" * 5000 + b"}"


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    return fill(tmp_path / "data", range(6))


def shard_of(folder: Path, *samples: dict[str, bytes]) -> Path:
    """A folder with one shard of these samples, without index."""
    folder.mkdir()
    entries = [
        tar_entry(f"gcd_{number:09d}.{member}", data)
        for number, members in enumerate(samples)
        for member, data in members.items()
    ]
    (folder / "train-00000.tar").write_bytes(b"".join([*entries, bytes(END)]))
    return folder


def resealed(members: dict[str, bytes], **entries: Any) -> dict[str, bytes]:
    """The sample with changed entries in its ``meta.json``, and matching checksums."""
    meta = json.loads(members["meta.json"]) | {"crc32": {m: zlib.crc32(members[m]) for m in MEMBERS[1:]}} | entries
    del meta["crc32_before"]
    return {**members, "meta.json": sealed(meta)}


def edited(folder: Path, change: Callable[[dict[str, np.ndarray]], object]) -> Path:
    """The folder with an edited index."""
    path = folder / "index-train.npz"
    arrays = dict(np.load(path))
    change(arrays)
    np.savez(path, **arrays)
    return folder


# -------------------------------------------------------------------------------------------------------------- silent


def test_a_flipped_bit_in_meta_is_found_by_every_reader(folder: Path) -> None:
    """Sixty random bytes of ``meta.json``, one at a time."""
    path = folder / "train-00000.tar"
    whole = path.read_bytes()
    size = int(whole[124:135], 8)
    for place in np.random.default_rng(0).integers(size, size=60).tolist():
        content = bytearray(whole)
        content[BLOCK + place] ^= 1
        path.write_bytes(content)
        for streaming in (False, True):
            with pytest.raises(ShardError, match=r"train-00000\.tar: sample gcd_000000000"):
                next(iter(GarmentDataset(folder, fields=["meta"], streaming=streaming)))
        (folder / "index-train.npz").rename(folder / "kept")
        with pytest.raises(ShardError, match=r"train-00000\.tar: "):
            GarmentDataset(folder)
        (folder / "kept").rename(folder / "index-train.npz")


def test_samples_swapped_in_the_index_are_reported(folder: Path) -> None:
    def swap(arrays: dict[str, np.ndarray]) -> None:
        arrays["sample"][[0, 1]] = arrays["sample"][[1, 0]]

    with pytest.raises(ShardError, match=r"index-train\.npz: .*its digest does not match.*: delete it"):
        GarmentDataset(edited(folder, swap))


@pytest.mark.parametrize("name", ["sample", "offset", "size", "crc", "settled", "length"])
def test_every_edited_column_is_reported(folder: Path, name: str) -> None:
    def change(arrays: dict[str, np.ndarray]) -> None:
        arrays[name].reshape(-1)[-1] ^= 1

    with pytest.raises(ShardError, match=r"index-train\.npz: "):
        GarmentDataset(edited(folder, change))


def test_a_sample_under_another_number_is_reported(folder: Path) -> None:
    """An index with a valid digest that belongs to other shards; one of schema 1 has no digest."""
    index = read_index(folder)
    sample = index.table.sample.copy()
    sample[[0, 1]] = sample[[1, 0]]
    object.__setattr__(index.table, "sample", sample)
    index.write(folder / "index-train.npz")
    with pytest.raises(ShardError, match=r"train-00000\.tar: holds sample 1 where the index has gcd_000000000: delete"):
        GarmentDataset(folder, fields=["meta"])[0]
    with pytest.raises(ShardError, match="sample 0 where the index has gcd_000000001"):
        GarmentDataset(folder, verify="off").verify(1)


def test_points_of_a_damaged_meta_are_not_decoded(folder: Path) -> None:
    content = bytearray((folder / "train-00000.tar").read_bytes())
    place = content.index(b'"centre":[') + len(b'"centre":[') + 1
    content[place] = ord("9")
    (folder / "train-00000.tar").write_bytes(content)
    for streaming in (False, True):
        with pytest.raises(ShardError, match=r"member meta\.json: bytes differ"):
            next(iter(GarmentDataset(folder, fields=["points"], streaming=streaming)))


# ---------------------------------------------------------------------------------------------------------------- index


def put(name: str, value: Any) -> Callable[[dict[str, np.ndarray]], object]:
    return lambda arrays: arrays.__setitem__(name, np.array(value))


def cast(name: str, dtype: str) -> Callable[[dict[str, np.ndarray]], object]:
    return lambda arrays: arrays.__setitem__(name, arrays[name].astype(dtype))


BROKEN_INDICES: dict[str, Callable[[dict[str, np.ndarray]], object]] = {
    "no number": put("members", 3),
    "real offset": cast("offset", "f4"),
    "words": cast("sample", "U3"),
    "complex": put("crc", [[1j]]),
    "no axis": put("sample", 0),
    "two schemas": put("schema", [1, 1]),
    "flags as numbers": cast("settled", "i8"),
    "lost": lambda arrays: arrays.pop("length"),
    "short": lambda arrays: arrays.__setitem__("sample", arrays["sample"][:-1]),
    "digest": put("digest", 1),
    "of nobody": put("members", ["a", "b"]),
}


@pytest.mark.parametrize("change", BROKEN_INDICES.values(), ids=BROKEN_INDICES)
def test_errors_about_a_broken_index_are_one_line(
    folder: Path, change: Callable[[dict[str, np.ndarray]], object]
) -> None:
    with pytest.raises(ShardError, match=r"index-train\.npz: not an index") as error:
        GarmentDataset(edited(folder, change))
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("name", "value"),
    [("offset", 2**63 - 1), ("offset", -5), ("size", 2**32 - 1), ("sample", -1), ("shard", 9), ("length", -1)],
)
def test_an_offset_outside_the_shard_is_reported(folder: Path, name: str, value: int) -> None:
    """Also in schema 1, where the index has no digest."""
    arrays = dict(np.load(folder / "index-train.npz"))
    changed = arrays[name].copy()
    changed.reshape(-1)[-1] = value
    del arrays["digest"]
    first = ("spec.txt", "spec.json"), ("design.txt", "design.json")
    members = [dict(first).get(member, member) for member in arrays["members"].tolist()]
    file = io.BytesIO()
    np.savez(file, **{**arrays, name: changed, "schema": np.array(1), "members": np.array(members)})
    with pytest.raises(ShardError, match=r"i\.npz: not an index"):
        ShardIndex.parse(file.getvalue(), "i.npz", partial=True)


def npy_of(shape: str, data: bytes = b"", descr: str = "<i8") -> bytes:
    text = f"{{'descr': '{descr}', 'fortran_order': False, 'shape': {shape}, }}".encode().ljust(117) + b"\n"
    return b"\x93NUMPY\x01\x00" + struct.pack("<H", len(text)) + text + data


def test_an_index_that_declares_gigabytes_is_refused(folder: Path) -> None:
    path = folder / "index-train.npz"
    with zipfile.ZipFile(path) as file:
        content = {name: file.read(name) for name in file.namelist()}
    with zipfile.ZipFile(path, "w") as file:
        for name, data in {**content, "offset.npy": npy_of("(1000000000000, 20)", bytes(100))}.items():
            file.writestr(name, data)
    with pytest.raises(ShardError, match=r"column offset: a \.npy file of 100 bytes for int64 of shape \(10{12}, "):
        GarmentDataset(folder)
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as file:
        for name, data in {**content, "offset.npy": npy_of("(100000, 20)", bytes(16_000_000))}.items():
            file.writestr(name, data)
    with pytest.raises(ShardError, match=r"160\d+ bytes in a file of \d+"):
        GarmentDataset(folder)
    path.write_bytes(b"")
    os.truncate(path, 8 << 30)
    with pytest.raises(ShardError, match=r"index-train\.npz: 8589934592 bytes, over the limit of \d+"):
        GarmentDataset(folder)


def test_broken_npz_archives_are_reported() -> None:
    file = io.BytesIO()
    np.savez(file, a=np.zeros(3))
    assert read_arrays(file.getvalue(), {"a": Column("f", 1)})["a"].tolist() == [0, 0, 0]
    for content in (b"", b"PK", file.getvalue()[:-30], file.getvalue()[:50] + bytes(40) + file.getvalue()[90:]):
        with pytest.raises(ShardError):
            read_arrays(content, {"a": Column("f", 1)})
    with pytest.raises(ShardError, match="column b is missing"):
        read_arrays(file.getvalue(), {"b": Column("f", 1)})


# ------------------------------------------------------------------------------------------------------------- manifest


def changed_shard(**entries: Any) -> Callable[[dict[str, Any]], object]:
    return lambda manifest: manifest["splits"]["train"]["shards"][0].update(entries)


def changed_split(**entries: Any) -> Callable[[dict[str, Any]], object]:
    return lambda manifest: manifest["splits"]["train"].update(entries)


BROKEN_MANIFESTS: dict[str, Callable[[dict[str, Any]], object]] = {
    "size": changed_shard(size="x"),
    "no name": changed_shard(name=None),
    "outside": changed_shard(name="../train-00000.tar"),
    "of another split": changed_shard(name="test-00000.tar"),
    "rejects": changed_shard(rejects={"long": "many"}),
    "negative": changed_shard(count=-1),
    "seed": changed_split(seed="5"),
    "recipe": changed_split(recipe=[]),
    "shards": changed_split(shards={}),
    "shard size": changed_split(shard_size=0),
    "kind": changed_split(kind=None),
    "split": lambda manifest: manifest["splits"].update({"../evil": manifest["splits"]["train"]}),
    "splits": lambda manifest: manifest.update(splits=3),
    "schema is missing": lambda manifest: manifest.pop("schema"),
    "true schema": lambda manifest: manifest.update(schema=True),
}


@pytest.mark.parametrize("change", BROKEN_MANIFESTS.values(), ids=BROKEN_MANIFESTS)
def test_errors_about_a_broken_manifest_are_one_line(folder: Path, change: Callable[[dict[str, Any]], object]) -> None:
    manifest = json.loads((folder / "manifest.json").read_text())
    change(manifest)
    (folder / "manifest.json").write_text(json.dumps(manifest))
    with pytest.raises(ShardError, match=r"manifest\.json: not a manifest \(.*: delete it"):
        GarmentDataset(folder)


@pytest.mark.parametrize(
    "content", [DEEP, HUGE, b"[]", b"\xff", b"NaN"], ids=["deep", "digits", "list", "bytes", "NaN"]
)
@pytest.mark.parametrize("name", ["manifest.json", "download.json"])
def test_errors_about_strange_json_are_one_line(folder: Path, name: str, content: bytes) -> None:
    (folder / name).write_bytes(content)
    with pytest.raises(ShardError, match=rf"{name}: not "):
        GarmentDataset(folder)


# -------------------------------------------------------------------------------------------------------------- samples


@pytest.mark.parametrize(
    "entries",
    [
        {"index": 2**70}, {"index": -1}, {"index": 1.5}, {"index": True}, {"seed": "x"}, {"pattern": None},
        {"rejects": "x"}, {"versions": 3}, {"recipe": "["}, {"recipe": "[" * 2000}, {"panel_names": {}},
        {"drape": None}, {"drape": {"outcome": 1}}, {"strain": 3}, {"holds": []}, {"gathers": ["x"]},
        {"fabric": {"name": "x", "parameters": 3}}, {"redraws": [3]}, {"crc32": {"spec.txt": 2**40}}, {"crc32": None},
        {"crc32": []},
    ],
    ids=str,
)  # fmt: skip
@pytest.mark.parametrize("streaming", [False, True])
def test_errors_about_strange_meta_are_one_line(tmp_path: Path, entries: dict[str, Any], streaming: bool) -> None:
    folder = shard_of(tmp_path / "data", resealed(encode_sample(fake_sample(0, 0)), **entries))
    with pytest.raises(ShardError, match=r"train-00000\.tar: sample gcd_000000000"):
        list(GarmentDataset(folder, streaming=streaming))


@pytest.mark.parametrize(
    ("member", "content"),
    [
        ("spec.txt", DEEP), ("spec.txt", HUGE), ("spec.txt", b"3"), ("design.txt", b"null"), ("design.txt", b"{"),
        ("measures.json", b'{"bust":"x"}'), ("measures.json", b'{"bust":1e400}'), ("measures.json", b"[]"),
        ("verts.npy", npy_of("(1000000000000, 3)", bytes(36), "<f4")), ("verts.npy", npy_of("(0, 1000000000000)")),
        ("verts.npy", npy_of("((((")), ("verts.npy", npy_of("(1,)", bytes(8), "<f3")), ("verts.npy", b""),
        ("faces.npy", write_npy(np.zeros((2, 3)))), ("panels.npy", write_npy(np.zeros((2, 3)))),
        ("points.npy", write_npy(np.zeros((2, 6), np.int32))), ("stitches.npy", write_npy(np.zeros(3, np.int32))),
        ("front.jpg", b"\xff\xd8"), ("front.jpg", b""),
    ],
)  # fmt: skip
def test_errors_about_strange_members_name_shard_and_sample(tmp_path: Path, member: str, content: bytes) -> None:
    members = resealed({**encode_sample(fake_sample(0, 0)), member: content})
    # The second sample is intact, and holds every field.
    ds = GarmentDataset(shard_of(tmp_path / "data", members, encode_sample(fake_sample(0, 1))))
    with pytest.raises(ShardError, match=rf"train-00000\.tar: sample gcd_000000000, member {member}: "):
        ds[0]
    with pytest.raises(ShardError):
        ShardReader(tmp_path / "data").sample(0) if member != "front.jpg" else ds[0]


def test_errors_about_contradictory_members_are_one_line() -> None:
    members = encode_sample(fake_sample(0, 0))
    with pytest.raises(ShardError, match="outcome 'FLEW'"):
        drape = {**json.loads(members["meta.json"])["drape"], "outcome": "FLEW"}
        decode_sample(resealed(members, drape=drape))
    with pytest.raises(ShardError, match=r"gcd_000000000: .*contradict each other"):
        decode_sample(resealed(members, vertex_labels=["nobody"]))
    with pytest.raises(ShardError, match=r"gcd_000000000: .*contradict each other"):
        decode_sample(resealed(members, grade="good"))
    with pytest.raises(ShardError, match=r"member meta\.json: pattern is missing"):
        meta = json.loads(members["meta.json"])
        del meta["pattern"], meta["crc32_before"]
        decode_sample({**members, "meta.json": sealed(meta)})


def png_of(side: int) -> bytes:
    def chunk(name: bytes, data: bytes) -> bytes:
        return struct.pack(">I", len(data)) + name + data + struct.pack(">I", zlib.crc32(name + data))

    head = chunk(b"IHDR", struct.pack(">IIBBBBB", side, side, 8, 2, 0, 0, 0))
    return b"\x89PNG\r\n\x1a\n" + head + chunk(b"IDAT", zlib.compress(bytes(1000))) + chunk(b"IEND", b"")


def test_pictures_of_a_hundred_million_pixels_are_not_decoded() -> None:
    small = io.BytesIO()
    Image.new("RGB", (16, 16)).save(small, "JPEG")
    bomb = bytearray(small.getvalue())
    place = bomb.index(b"\xff\xc0") + 5
    bomb[place : place + 4] = struct.pack(">HH", 13_000, 13_000)
    with pytest.raises(ShardError, match=r"member front\.jpg: (a picture of 13000 x 13000 pixels|not a picture)"):
        decode_field("front", {"front.jpg": bytes(bomb)})
    with pytest.raises(ShardError, match=r"member front\.jpg: not a picture"):
        decode_field("front", {"front.jpg": png_of(16)})
    for side in (9_000, 13_000, 60_000):
        with pytest.raises(ShardError, match=r"member seg\.png: does not match its ending"):
            decode_member("seg.png", png_of(side))


def test_foreign_npy_headers_are_checked_against_their_bytes() -> None:
    for content in (
        npy_of("(1000000000000,)", bytes(8)), npy_of("((((", bytes(8)), npy_of("('a',)"), npy_of("(-1,)"),
        npy_of("(3,)", bytes(24), "|O"), npy_of("(1,)", bytes(4), "<U1000000000"), b"\x93NUMPY\x09\x00", b"",
    ):  # fmt: skip
        with pytest.raises(ShardError):
            read_any_npy(content, "biufc")
        with pytest.raises(ShardError):
            read_npy(content)
    array = np.asfortranarray(np.arange(6, dtype=">i2").reshape(2, 3))
    file = io.BytesIO()
    np.save(file, array)
    assert np.array_equal(read_any_npy(file.getvalue(), "i"), array)
    assert decode_member("a.json", b'{"n": NaN}')["n"] != 0  # Python writes it
    for member, content in (("a.json", DEEP), ("a.json", HUGE), ("a.cls", b"9" * 5000)):
        with pytest.raises(ShardError, match=rf"member {member}: does not match its ending"):
            decode_member(member, content)


def test_a_meta_of_gigabytes_is_refused_before_it_is_read(tmp_path: Path) -> None:
    header = bytearray(tar_entry("gcd_000000000.meta.json", b""))
    header[124:135] = b"%011o" % (8**11 - 1)
    header[148:156] = 8 * b" "
    header[148:156] = b"%06o\0 " % sum(header)
    path = tmp_path / "train-00000.tar"
    path.write_bytes(header)
    os.truncate(path, 8**11 + 2048)
    with pytest.raises(ShardError, match=r"train-00000\.tar: sample gcd_000000000 has more than 536870912 bytes"):
        GarmentDataset(tmp_path)


def test_brackets_in_strings_do_not_count_as_nesting() -> None:
    members = encode_sample(fake_sample(0, 0))
    recipe = json.dumps({"note": "[" * 3 * DEEPEST})
    assert read_meta(resealed(members, recipe=recipe)["meta.json"])["recipe"]["note"] == "[" * 3 * DEEPEST


def test_a_shard_number_with_too_many_digits_is_ignored() -> None:
    assert shard_number(f"train-{'9' * 5004}.tar", "train") is None
