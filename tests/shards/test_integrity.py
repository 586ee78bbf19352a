"""Edited and damaged files are reported in one line that names the file, before anything large is allocated."""

import hashlib
import json
import os
import struct
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from gcd_dataset.errors import ShardError
from gcd_dataset.jsonfile import DEEPEST
from gcd_dataset.loaders import GarmentDataset
from gcd_dataset.loaders.fake import fake_sample
from gcd_dataset.shards import ShardReader, decode_sample, encode_sample
from gcd_dataset.shards.codec import decode_field
from gcd_dataset.shards.layout import is_picture
from gcd_dataset.shards.meta import read_meta, sealed
from gcd_dataset.shards.notes import gather
from gcd_dataset.shards.place import FolderPlace
from gcd_dataset.shards.tar import BLOCK, END, tar_entry
from tests.shards.folders import fill

DEEP = b"[" * 100_000
HUGE = b'{"n":' + b"9" * 5000 + b"}"


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    return fill(tmp_path / "data", range(6))


def shard_of(folder: Path, *samples: dict[str, bytes]) -> Path:
    """A folder with one shard of these samples, without notes."""
    (folder / "views").mkdir(parents=True)
    for path, pictures in ((folder / "train-00000.tar", False), (folder / "views" / "train-00000.tar", True)):
        entries = [
            tar_entry(f"gcd_{number:09d}.{member}", data)
            for number, members in enumerate(samples)
            for member, data in members.items()
            if is_picture(member) is pictures
        ]
        path.write_bytes(b"".join([*entries, bytes(END)]))
    return folder


def resealed(members: dict[str, bytes], **entries: Any) -> dict[str, bytes]:
    """The sample with changed entries in its ``meta.json``, and matching checksums."""
    crc = {member: zlib.crc32(data) for member, data in members.items() if member != "meta.json"}
    meta = json.loads(members["meta.json"]) | {"crc32": crc} | entries
    del meta["crc32_before"]
    return {**members, "meta.json": sealed(meta)}


def test_a_flipped_bit_in_meta_is_found_by_every_reader(folder: Path) -> None:
    """Forty random bytes of ``meta.json``, one at a time."""
    path = folder / "train-00000.tar"
    whole = path.read_bytes()
    size = int(whole[124:135], 8)
    for place in np.random.default_rng(0).integers(size, size=40).tolist():
        content = bytearray(whole)
        content[BLOCK + place] ^= 1
        path.write_bytes(content)
        with pytest.raises(ShardError, match=r"train-00000\.tar: sample gcd_000000000"):
            ShardReader(folder).read(0, ["meta.json"])
        with pytest.raises(ShardError, match=r"train-00000\.tar"):
            GarmentDataset(folder, fields=["meta"])[0]


# ------------------------------------------------------------------------------------------------------------- manifest


def changed_shard(number: int, value: Any) -> Callable[[dict[str, Any]], object]:
    return lambda manifest: manifest["splits"]["train"]["shards"][0].__setitem__(number, value)


def changed_split(**entries: Any) -> Callable[[dict[str, Any]], object]:
    return lambda manifest: manifest["splits"]["train"].update(entries)


def changed_plan(**entries: Any) -> Callable[[dict[str, Any]], object]:
    return lambda manifest: manifest["splits"]["train"]["plan"].update(entries)


BROKEN_MANIFESTS: dict[str, Callable[[dict[str, Any]], object]] = {
    "number": changed_shard(0, 7),
    "text": changed_shard(0, "../x"),
    "negative": changed_shard(1, -1),
    "count": changed_shard(1, 2**40),
    "size": changed_shard(2, 2**70),
    "list": changed_shard(2, []),
    "hash": changed_shard(3, "x" * 64),
    "short": lambda manifest: manifest["splits"]["train"]["shards"][0].pop(),
    "rejects": changed_split(rejects={"long": "many"}),
    "redraws": changed_split(redraws={"long": -1}),
    "members": changed_split(members=["../evil"]),
    "shards": changed_split(shards={}),
    "index": changed_split(index_sha256="abc"),
    "seed": changed_plan(seed="5"),
    "recipe": changed_plan(recipe=[]),
    "shard size": changed_plan(shard_size=0),
    "kind": changed_plan(kind=None),
    "named": changed_plan(named=["a"]),
    "split": lambda manifest: manifest["splits"].update({"../evil": manifest["splits"]["train"]}),
    "splits": lambda manifest: manifest.update(splits=3),
    "no schema": lambda manifest: manifest.pop("schema"),
    "true schema": lambda manifest: manifest.update(schema=True),
    "recipe record": lambda manifest: manifest.update(recipe={"name": 3}),
}


@pytest.mark.parametrize("change", BROKEN_MANIFESTS.values(), ids=BROKEN_MANIFESTS)
def test_errors_about_a_broken_manifest_are_one_line(folder: Path, change: Callable[[dict[str, Any]], object]) -> None:
    """Its digest is made to match."""
    manifest = json.loads((folder / "manifest.json").read_text())
    change(manifest)
    del manifest["digest"]
    content = json.dumps(manifest, separators=(",", ":"), sort_keys=True)
    manifest["digest"] = hashlib.sha256(content.encode()).hexdigest()
    (folder / "manifest.json").write_text(json.dumps(manifest))
    with pytest.raises(ShardError, match=r"manifest\.json: not a manifest \(.*: delete it, then run gcd index"):
        ShardReader(folder)


def test_a_flipped_bit_in_the_manifest_is_found(folder: Path) -> None:
    whole = (folder / "manifest.json").read_bytes()
    for place in np.random.default_rng(0).integers(len(whole) - 1, size=60).tolist():
        content = bytearray(whole)
        content[place] ^= 1
        (folder / "manifest.json").write_bytes(content)
        with pytest.raises(ShardError, match=r"manifest\.json: "):
            ShardReader(folder)


def test_another_schema_is_refused_with_both_versions(folder: Path) -> None:
    manifest = json.loads((folder / "manifest.json").read_text())
    (folder / "manifest.json").write_text(json.dumps({**manifest, "schema": 99, "generator": "7.2.0"}))
    with pytest.raises(ShardError, match=r"of schema 99, made by gcd_dataset 7\.2\.0; .*reads schema 3 alone"):
        ShardReader(folder)


@pytest.mark.parametrize(
    "content", [DEEP, HUGE, b"[]", b"\xff", b"NaN"], ids=["deep", "digits", "list", "bytes", "NaN"]
)
@pytest.mark.parametrize("name", ["manifest.json", "train-00000.json"])
def test_errors_about_strange_json_are_one_line(folder: Path, name: str, content: bytes) -> None:
    (folder / "manifest.json").unlink()
    (folder / name).write_bytes(content)
    with pytest.raises(ShardError, match=rf"{name}: not "):
        ShardReader(folder)


def test_shards_that_contradict_each_other_are_reported(folder: Path) -> None:
    (folder / "manifest.json").unlink()
    for name in ("train-00001.tar", "views/train-00001.tar"):
        (folder / name).write_bytes((folder / name.replace("1.tar", "0.tar")).read_bytes())
    (folder / "train-00001.json").unlink()
    with pytest.raises(ShardError, match="shards of split train contradict each other: a sample occurs twice"):
        ShardReader(folder)


# -------------------------------------------------------------------------------------------------------------- samples


@pytest.mark.parametrize(
    "entries",
    [
        {"index": 2**70}, {"index": -1}, {"index": 1.5}, {"index": 4}, {"seed": "x"}, {"pattern": None},
        {"rejects": "x"}, {"rejects": [{"rule": "x"}]}, {"versions": 3}, {"recipe": "["}, {"recipe": "[" * 2000},
        {"panel_names": {}}, {"drape": None}, {"drape": {"outcome": 1}}, {"strain": 3}, {"holds": []},
        {"gathers": ["x"]}, {"fabric": {"name": "x", "parameters": 3}}, {"redraws": [3]},
    ],
    ids=str,
)  # fmt: skip
def test_errors_about_strange_meta_are_one_line(tmp_path: Path, entries: dict[str, Any]) -> None:
    folder = shard_of(tmp_path / "data", resealed(encode_sample(fake_sample(0, 0)), **entries))
    with pytest.raises(ShardError, match=r"train-00000\.tar: sample gcd_000000000: "):
        ShardReader(folder)


def test_samples_without_a_member_are_named(tmp_path: Path) -> None:
    members = encode_sample(fake_sample(0, 1))
    del members["mesh.z"]
    folder = shard_of(tmp_path / "data", encode_sample(fake_sample(0, 0)), members)
    with pytest.raises(ShardError, match=r"sample gcd_000000001: its members differ .* in mesh\.z: copy it again"):
        gather(FolderPlace(folder))


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
    bomb = bytearray(fake_sample(0, 0).front or b"")
    place = bomb.index(b"\xff\xc0") + 5
    bomb[place : place + 4] = struct.pack(">HH", 13_000, 13_000)
    with pytest.raises(ShardError, match=r"member front\.jpg: (a picture of 13000 x 13000 pixels|not a picture)"):
        decode_field("front", {"front.jpg": bytes(bomb)})
    with pytest.raises(ShardError, match=r"member front\.jpg: not a picture"):
        decode_field("front", {"front.jpg": png_of(16)})


def test_a_member_of_gigabytes_is_refused_before_it_is_read(tmp_path: Path) -> None:
    header = bytearray(tar_entry("gcd_000000000.meta.json", b""))
    header[124:135] = b"%011o" % (8**11 - 1)
    header[148:156] = 8 * b" "
    header[148:156] = b"%06o\0 " % sum(header)
    path = tmp_path / "train-00000.tar"
    path.write_bytes(header)
    os.truncate(path, 8**11 + 2048)
    with pytest.raises(ShardError, match=r"train-00000\.tar: .* bytes of JSON, over the limit"):
        ShardReader(tmp_path)


def test_brackets_in_strings_do_not_count_as_nesting() -> None:
    members = encode_sample(fake_sample(0, 0))
    recipe = json.dumps({"note": "[" * 3 * DEEPEST})
    assert read_meta(resealed(members, recipe=recipe)["meta.json"])["recipe"]["note"] == "[" * 3 * DEEPEST
