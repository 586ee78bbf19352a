"""Edited and damaged files are reported in one line with file and remedy, before anything large is allocated."""

import hashlib
import io
import json
import os
import shutil
import struct
import tarfile
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from gcd_dataset.check.files import set_faults
from gcd_dataset.errors import ConfigError, OutputError, ShardError
from gcd_dataset.loaders import GarmentDataset
from gcd_dataset.loaders.fake import fake_sample
from gcd_dataset.making.run import index
from gcd_dataset.shards import ShardReader, cache, columns, decode_sample, encode_sample
from gcd_dataset.shards.access import Place
from gcd_dataset.shards.cache import make_room, size_in_bytes
from gcd_dataset.shards.codec import decode_field
from gcd_dataset.shards.meta import sealed
from gcd_dataset.shards.notes import gather
from gcd_dataset.shards.tar import BLOCK, END
from tests.helpers import flip
from tests.shards.folders import fill, forbidden, public_folder, write_members

Change = Callable[[Any], object]
STRANGE = (b"[" * 100_000, b'{"n":' + b"9" * 5000 + b"}", b"[]", b"\xff", b"NaN")
REMEDY = "copy it again, or delete it and run gcd generate again$"


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Six samples in two shards."""
    return fill(tmp_path / "data", range(6))


@pytest.fixture
def bare(folder: Path) -> Path:
    """The same without manifest, index and notes."""
    for path in (*folder.glob("*.json"), *folder.glob("*.index")):
        path.unlink()
    return folder


def shard_of(folder: Path, *samples: dict[str, bytes], first: int = 0) -> Path:
    """A folder with one shard of these samples, without notes."""
    write_members(folder, {f"gcd_{number:09d}": members for number, members in enumerate(samples, first)})
    return folder


def resealed(members: dict[str, bytes], **entries: Any) -> dict[str, bytes]:
    """The sample with changed entries in its ``meta.json``, and matching checksums."""
    crc = {member: zlib.crc32(data) for member, data in members.items() if member != "meta.json"}
    meta = json.loads(members["meta.json"]) | {"crc32": crc} | entries
    del meta["crc32_before"]
    return {**members, "meta.json": sealed(meta)}


def change_json(path: Path, change: Change) -> None:
    """Edit a note, or a manifest, whose digest is made to match."""
    entry = json.loads(path.read_text())
    is_manifest = entry.pop("digest", None) is not None
    change(entry)
    body = json.dumps(entry, separators=(",", ":"), sort_keys=True).encode()
    digest = b'{"digest":"%s",' % hashlib.sha256(body).hexdigest().encode()
    path.write_bytes(digest + body[1:] if is_manifest else body)


def setting(*path: str | int, to: Any) -> Change:
    """The change of one value of a JSON file."""

    def change(entry: Any) -> None:
        for name in path[:-1]:
            entry = entry[name]
        entry[path[-1]] = to

    return change


TRAIN, SHARD = ("splits", "train"), ("splits", "train", "shards", 0)
BROKEN_MANIFESTS = [
    setting(*SHARD, 0, to=7), setting(*SHARD, 0, to="../x"), setting(*SHARD, 1, to=-1), setting(*SHARD, 1, to=2**40),
    setting(*SHARD, 2, to=2**70), setting(*SHARD, 2, to=[]), setting(*SHARD, 3, to="x" * 64), setting(*SHARD, to=[1]),
    setting(*TRAIN, "rejects", to={"long": "many"}), setting(*TRAIN, "redraws", to={"long": -1}),
    setting(*TRAIN, "members", to=["../evil"]), setting(*TRAIN, "members", to=[]),
    setting(*TRAIN, "members", 0, to="spec.txt"), setting(*TRAIN, "shards", to={}),
    setting(*TRAIN, "index_sha256", to="abc"), setting(*TRAIN, "plan", "seed", to="5"),
    setting(*TRAIN, "plan", "recipe", to=[]), setting(*TRAIN, "plan", "shard_size", to=0),
    setting(*TRAIN, "plan", "kind", to=None), setting(*TRAIN, "plan", "named", to=["a"]),
    setting("splits", "../evil", to={}), setting("splits", to=3), setting("schema", to=True), setting("recipe", to={}),
    setting("recipe", to={"name": 3}), lambda manifest: manifest.pop("schema"),
]  # fmt: skip


MANIFEST_FAULT = r"manifest\.json: not a manifest \((?!.*digest).*: delete it, then run gcd i"


BROKEN_NOTES = [
    setting("rows", to=None), setting("rows", 0, to=3), setting("rows", 0, to=[]), setting("rows", 0, 0, to=2**31),
    setting("rows", 0, 0, to=1.5), setting("rows", 0, 1, to=2**70), setting("rows", 0, 2, to="x"),
    setting("rows", 0, 3, to="good"), setting("rows", 0, 4, to="FLEW"), setting("rejects", to=3),
    setting("rejects", to=[{}]), setting("rejects", to=[{"design": [], "attempt": 0}]),
    setting("rejected", to={"x": None}), setting("redraws", to=[]), setting("skipped", to={"x": "y"}),
    setting("skipped", to=3), setting("members", to=[3]), setting("patterns", to=["zz", [], 0]),
    setting("patterns", to=["0", [], -1]), setting("plan", "count", to=-1), lambda note: note.pop("plan"),
    setting("split", to="other"), setting("record", 0, to=1),
]  # fmt: skip


NOTE_FAULT = r"train-00000\.json: not the note of this shard \(.*: delete it, then run gcd"
BROKEN = [
    *(("manifest.json", change, MANIFEST_FAULT) for change in BROKEN_MANIFESTS),
    *(("train-00000.json", change, NOTE_FAULT) for change in BROKEN_NOTES),
    *((name, content, rf"{name}: not ") for name in ("manifest.json", "train-00000.json") for content in STRANGE),
]


@pytest.mark.parametrize(("name", "change", "message"), BROKEN, ids=range(len(BROKEN)))
def test_errors_about_broken_json_are_one_line(folder: Path, name: str, change: Change | bytes, message: str) -> None:
    if isinstance(change, bytes):
        (folder / name).write_bytes(change)
    else:
        change_json(folder / name, change)
    if name != "manifest.json":
        (folder / "manifest.json").unlink()
    with pytest.raises(ShardError, match=message):
        ShardReader(folder)


def test_a_flipped_bit_in_the_manifest_another_schema_and_another_index(folder: Path, tmp_path: Path) -> None:
    path = folder / "manifest.json"
    for place in np.random.default_rng(0).integers(path.stat().st_size - 1, size=60).tolist():
        flip(path, place)
        with pytest.raises(ShardError, match=r"manifest\.json: "):
            ShardReader(folder)
        flip(path, place)
    other = (fill(tmp_path / "other", range(1, 7)) / "train.index").read_bytes()
    for content in (other, b"PK nonsense", b""):
        (folder / "train.index").write_bytes(content)
        with pytest.raises(ShardError, match=r"train\.index: not the index of these shards \(.*\): run gcd index"):
            ShardReader(folder)
    change_json(path, lambda manifest: manifest.update(schema=99, generator="7.2.0"))
    with pytest.raises(ShardError, match=r"of schema 99, made by gcd_dataset 7\.2\.0; .*reads schema 3 alone"):
        ShardReader(folder)


def test_shards_that_contradict_each_other_are_reported(bare: Path) -> None:
    shutil.copy(bare / "views" / "train-00001.tar", bare / "views" / "train-00000.tar")
    with pytest.raises(ShardError, match=rf"views/train-00000\.tar: its samples differ .*: {REMEDY}"):
        gather(Place(bare))
    for folder in (bare, bare / "views"):
        shutil.copy(folder / "train-00001.tar", folder / "train-00000.tar")
    with pytest.raises(ShardError, match="shards of split train contradict each other: a sample occurs twice: move"):
        ShardReader(bare)


def test_a_cut_tar_is_not_taken_for_a_whole_one(bare: Path) -> None:
    """Cut between two samples it holds whole samples alone."""
    path = bare / "train-00001.tar"
    size = path.stat().st_size
    for left in (size - BLOCK, size - END, 512, 0):
        os.truncate(path, left)
        with pytest.raises(ShardError, match=rf"train-00001\.tar: .*: {REMEDY}"):
            gather(Place(bare))


def test_notes_are_made_again_from_whole_members_alone(bare: Path) -> None:
    path = bare / "train-00001.tar"
    flip(path, BLOCK, after=b"gcd_000000005.design.txt\0")
    with pytest.raises(ShardError, match=rf"sample gcd_000000005: member design\.txt: bytes differ .*: {REMEDY}"):
        GarmentDataset(bare)
    (bare / "train-00000.tar").unlink()
    (bare / "train-00000.tar").mkdir()
    with pytest.raises(ShardError, match=rf"^{bare}/train-00000\.tar: cannot be read \(Is a directory\): {REMEDY}"):
        gather(Place(bare))


def test_a_member_of_gigabytes_is_refused_before_it_is_read(tmp_path: Path) -> None:
    path, info = tmp_path / "train-00000.tar", tarfile.TarInfo("gcd_000000000.meta.json")
    info.size = 8**11 - 1
    path.write_bytes(info.tobuf(tarfile.USTAR_FORMAT))
    os.truncate(path, 8**11 + 2048)
    with pytest.raises(ShardError, match=r"train-00000\.tar: .* bytes of JSON, over the limit"):
        ShardReader(tmp_path)


DRAPE = dict.fromkeys(
    ("frames", "self_crossings", "body_crossings", "body_through", "stretch_median", "stretch_p99"), 1
)
REJECTS = [{"index": 0, "rule": "r", "reason": "s", "figures": "{}"}]


@pytest.mark.parametrize(
    "entries",
    [
        {"index": 2**70}, {"index": -1}, {"index": 1.5}, {"index": 4}, {"seed": "x"}, {"pattern": None},
        {"rejects": "x"}, {"rejects": [{"rule": "x"}]}, {"versions": 3}, {"recipe": "["}, {"recipe": "[" * 2000},
        {"panel_names": {}}, {"drape": None}, {"drape": {"outcome": 1}}, {"strain": 3}, {"holds": []},
        {"gathers": ["x"]}, {"fabric": {"name": "x", "parameters": 3}}, {"redraws": [3]}, {"grade": "good"},
        {"drape": {**DRAPE, "outcome": "FLEW"}}, {"recipe": '{"bodies_each":0}', "rejects": REJECTS},
        {"recipe": '{"bodies_each":"x"}', "rejects": REJECTS}, {"crc32": None}, {"crc32": 3}, {"crc32": {}},
    ],
    ids=str,
)  # fmt: skip
def test_errors_about_strange_meta_are_one_line(tmp_path: Path, entries: dict[str, Any]) -> None:
    folder = shard_of(tmp_path / "data", resealed(encode_sample(fake_sample(0, 0)), **entries))
    with pytest.raises(ShardError, match=r"train-00000\.tar: sample gcd_000000000: "):
        ShardReader(folder)


def test_numbers_beyond_the_index_and_samples_without_a_member_are_named(tmp_path: Path) -> None:
    members = encode_sample(fake_sample(0, 0))
    with pytest.raises(ShardError, match=r"train-00000\.tar: sample gcd_1099511627776: index 1099511627776, "):
        ShardReader(shard_of(tmp_path / "far", resealed(members, index=2**40), first=2**40))
    partial = {name: data for name, data in encode_sample(fake_sample(0, 1)).items() if name != "mesh.z"}
    with pytest.raises(ShardError, match=r"sample gcd_000000001: its members differ .* in mesh\.z: copy it again"):
        gather(Place(shard_of(tmp_path / "partial", members, partial)))


def test_errors_about_contradictory_members_are_one_line() -> None:
    members = encode_sample(fake_sample(0, 0))
    with pytest.raises(ShardError, match="outcome 'FLEW'"):
        drape = {**json.loads(members["meta.json"])["drape"], "outcome": "FLEW"}
        decode_sample(resealed(members, drape=drape))
    for entries in ({"vertex_labels": ["nobody"]}, {"grade": "good"}):
        with pytest.raises(ShardError, match=r"gcd_000000000: .*contradict each other"):
            decode_sample(resealed(members, **entries))
    with pytest.raises(ShardError, match=r"member meta\.json: pattern is missing"):
        meta = json.loads(members["meta.json"])
        del meta["pattern"], meta["crc32_before"]
        decode_sample({**members, "meta.json": sealed(meta)})


def test_pictures_of_other_formats_or_a_hundred_million_pixels_are_not_decoded() -> None:
    bomb, png = bytearray(fake_sample(0, 0).front or b""), io.BytesIO()
    place = bomb.index(b"\xff\xc0") + 5
    bomb[place : place + 4] = struct.pack(">HH", 13_000, 13_000)
    with pytest.raises(ShardError, match=r"member front\.jpg: (a picture of 13000 x 13000 pixels|not a picture)"):
        decode_field("front", {"front.jpg": bytes(bomb)})
    Image.new("RGB", (16, 16)).save(png, "PNG")
    with pytest.raises(ShardError, match=r"member front\.jpg: not a picture"):
        decode_field("front", {"front.jpg": png.getvalue()})


@pytest.mark.parametrize(
    "damage",
    [
        lambda path: os.truncate(path, path.stat().st_size - 100),
        lambda path: os.truncate(path, 40),
        lambda path: os.truncate(path, 0),
        lambda path: path.write_bytes(b"gcdcol1\0" + b"\xff" * 999),
        lambda path: path.write_bytes(b"gcdcol1\0xx" + bytes(999)),
    ],
    ids=["cut", "head cut", "empty", "huge", "unknown type"],
)
def test_damaged_columns_are_made_again(folder: Path, tmp_path: Path, damage: Callable[[Path], object]) -> None:
    options: Any = {"fields": ["verts"], "cache_dir": tmp_path / "cache"}
    first = GarmentDataset(folder, **options)[[1]][0]["verts"]
    (column,) = (tmp_path / "cache").glob("shards/*/verts")
    damage(column)
    assert GarmentDataset(folder, **options)[[1]][0]["verts"].equal(first)


def test_a_cache_smaller_than_the_set_is_read_again_with_more_fields(folder: Path, tmp_path: Path) -> None:
    options: Any = {"cache_dir": tmp_path / "cache", "max_cache_size": 7_500, "window": 1}
    for fields in (["meta"], ["meta", "verts"]):
        dataset = GarmentDataset(folder, fields=fields, **options)
        assert [len(dataset[[index]]) for index in range(6)] == [1] * 6


def test_a_shard_is_not_evicted_while_it_is_filled(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    shards, write = tmp_path / "cache" / "shards", columns._write_column

    def write_beside_another_process(path: Path, rows: Any) -> None:
        make_room(shards, 1000, 1000)
        write(path, rows)

    monkeypatch.setattr(columns, "_write_column", write_beside_another_process)
    GarmentDataset(folder, fields=["verts", "faces"], cache_dir=tmp_path / "cache")[[0]]
    assert len(list(shards.glob("*/*"))) == 2
    make_room(shards, 1000, 1000)
    assert not list(shards.iterdir())


def test_room_is_made_beside_what_other_processes_evict(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / ".abc.tar.part").symlink_to(tmp_path / "gone")
    for number in range(2):
        (tmp_path / f"{number}").mkdir()
        (tmp_path / f"{number}" / "tar").write_bytes(bytes(300))
        os.utime(tmp_path / f"{number}", (number, number))

    def use_before_eviction(path: Path, use_of: Any = cache._use_of) -> Any:
        use = use_of(path)
        if path.name == "0":
            shutil.rmtree(path)
        return use

    monkeypatch.setattr(cache, "_use_of", use_before_eviction)
    make_room(tmp_path, 500, 1000)
    assert (tmp_path / "1").exists()
    assert size_in_bytes("9007199254740993") == 9007199254740993
    with pytest.raises(ConfigError, match="max_cache_size='9999"):
        size_in_bytes("9" * 400)


@pytest.mark.parametrize("mode", [0o555, 0])
@pytest.mark.parametrize("scheme", ["", "file://"])
def test_a_cache_that_cannot_be_written_is_named(mode: int, scheme: str) -> None:
    message = r"cache/shards.* \(Permission denied\): .*: cache_dir= or GCD_CACHE gives the cache$"
    with public_folder() as place:
        source = f"{scheme}{fill(place / 'data', range(3))}"
        dataset = GarmentDataset(source, fields=["verts"], cache_dir=place / "cache")
        (place / "cache" / "shards").mkdir(parents=True)
        with forbidden(place / "cache" / "shards", mode), pytest.raises(OutputError, match=message):
            dataset[[0]]


def test_a_reader_that_checks_nothing_leaves_no_damage_in_the_cache(folder: Path, tmp_path: Path) -> None:
    options: Any = {"fields": ["design"], "cache_dir": tmp_path / "cache"}
    path = folder / "train-00000.tar"
    place = path.read_bytes().index(b"gcd_000000001.design.txt\0") + BLOCK + 2
    flip(path, place)
    with pytest.raises(ShardError, match=r"train-00000\.tar: bytes differ from the written ones: copy it again"):
        GarmentDataset(folder, verify="off", **options)[[1]]
    flip(path, place)
    assert GarmentDataset(folder, **options)[[1]][0]["design"] == GarmentDataset(folder)[1]["design"]


@pytest.mark.parametrize(
    ("name", "old", "new"),
    [
        ("train-00000.json", b'"seed":0', b'"seed":1'),
        ("train-00000.json", b"[1,20,6,", b"[1,20,7,"),
        ("train-00001.json", b'"rejected":{}', b'"rejected":{"cuff":1}'),
        ("train-00001.json", b'"skipped":{}}\n', b'"skipped":{}}'),
        ("train-00001.json", b'{"split"', b'{"spliu"'),
        ("rejects.jsonl", b"", b"\n"),
    ],
)
def test_a_full_check_finds_changed_notes_and_rejects(folder: Path, name: str, old: bytes, new: bytes) -> None:
    assert not [*set_faults(folder, every_byte=True)]
    content = (folder / name).read_bytes()
    (folder / name).write_bytes(content.replace(old, new, 1))
    assert (folder / name).read_bytes() != content
    (fault,) = set_faults(folder, every_byte=True)
    assert fault.startswith(f"{folder / name}: ") and fault.endswith("run gcd index")
    (folder / name).unlink()
    index(Place(folder))
    assert not [*set_faults(folder, every_byte=True)]
