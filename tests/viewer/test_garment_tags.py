"""Tags of a split: read in parts, kept in the cache, left out where a sample is damaged."""

from dataclasses import replace
from pathlib import Path

import pytest

from gcd_dataset.loaders.fake import fake_sample
from gcd_dataset.shards import ShardReader, ShardWriter
from gcd_dataset.shards.sections import pack, unpack
from gcd_dataset.viewer import garments
from gcd_dataset.viewer.garments import OUTCOME, TAG, GarmentTags

COUNT = 6
WORDS = ("skirt", "dress")


def write(folder: Path, tags: tuple[str, ...] = WORDS) -> Path:
    """Samples 0 to 5 with the tags in turn."""
    with ShardWriter(folder, seed=0, recipe={}) as writer:
        for index in range(COUNT):
            writer.write(replace(fake_sample(0, index), tags=(tags[index % len(tags)],)))
    return folder


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write(tmp_path_factory.mktemp("shards"))


def unreadable(folder: Path) -> ShardReader:
    """A reader whose store must not be read."""
    reader = ShardReader(folder)
    reader.read_many = reader.read = None  # type: ignore[assignment, method-assign]
    return reader


def test_each_read_adds_the_next_garments(folder: Path) -> None:
    tags = GarmentTags(ShardReader(folder))
    tags.read(2)
    assert (tags.known, tags.counts(TAG)) == (2, {"dress": 1, "skirt": 1})
    tags.read(3)
    assert (tags.known, tags.counts(TAG)) == (5, {"dress": 2, "skirt": 3})
    tags.read()
    tags.read()
    assert (tags.known, tags.counts(OUTCOME)) == (COUNT, {"settled": COUNT})
    assert tags.positions(TAG, "dress").tolist() == [1, 3, 5]
    assert not len(tags.positions(TAG, "settled"))


def test_a_call_before_each_part_sees_what_is_known(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(garments, "CHUNK", 4)
    tags, known = GarmentTags(ShardReader(folder)), []
    tags.read(between=lambda: known.append(tags.known))
    assert known == [0, 4]


def test_tags_are_read_once_and_then_come_from_the_cache(folder: Path, tmp_path: Path) -> None:
    GarmentTags(ShardReader(folder), tmp_path).read()
    again = GarmentTags(unreadable(folder), tmp_path)
    again.read()
    assert (again.known, again.counts(TAG)) == (COUNT, {"dress": 3, "skirt": 3})
    assert again.positions(TAG, "dress").tolist() == [1, 3, 5]


def test_an_interrupted_reading_goes_on_from_the_cache(folder: Path, tmp_path: Path) -> None:
    GarmentTags(ShardReader(folder), tmp_path).read(2)
    again = GarmentTags(ShardReader(folder), tmp_path)
    assert again.known == 2
    again.read()
    assert again.counts(TAG) == {"dress": 3, "skirt": 3}


def test_the_cache_of_other_garments_is_not_taken(folder: Path, tmp_path: Path) -> None:
    GarmentTags(ShardReader(folder), tmp_path / "cache").read()
    assert GarmentTags(ShardReader(write(tmp_path / "other", ("top",))), tmp_path / "cache").known == 0


@pytest.mark.parametrize("content", [b"", b"nonsense", "negative", "beyond", "short"])
def test_a_damaged_cache_is_read_anew(content: bytes | str, folder: Path, tmp_path: Path) -> None:
    GarmentTags(ShardReader(folder), tmp_path).read()
    (path,) = tmp_path.rglob("*.z")
    if isinstance(content, bytes):
        path.write_bytes(content)
    else:
        arrays = unpack(path.read_bytes())
        arrays["positions"][0] = {"negative": -1, "beyond": 10**6, "short": 0}[content]
        if content == "short":
            arrays["positions"] = arrays["positions"][1:]
        path.write_bytes(pack(arrays))
    tags = GarmentTags(ShardReader(folder), tmp_path)
    assert tags.known == 0
    tags.read()
    assert tags.counts(TAG) == {"dress": 3, "skirt": 3}


def test_a_cache_that_cannot_be_written_is_done_without(folder: Path, tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    tags = GarmentTags(ShardReader(folder), tmp_path / "file")
    tags.read()
    assert tags.known == COUNT


def test_the_cache_keeps_the_latest_data_sets(folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(garments, "KEPT_FILES", 1)
    for name in ("top", "jumpsuit"):
        GarmentTags(ShardReader(write(tmp_path / name, (name,))), tmp_path / "cache").read()
    assert len(list((tmp_path / "cache").rglob("*.z"))) == 1


def test_a_damaged_garment_has_no_tags_and_the_others_do(tmp_path: Path) -> None:
    reader = ShardReader(write(tmp_path))
    (shard,) = tmp_path.glob("*.tar")
    content = bytearray(shard.read_bytes())
    content[int(reader.index.start[2]) + 700] ^= 1  # in its meta.json
    shard.write_bytes(content)
    tags = GarmentTags(ShardReader(tmp_path))
    tags.read()
    assert (tags.known, tags.counts(TAG)) == (COUNT, {"dress": 3, "skirt": 2})
