"""Tags of a split: read in parts, left out where a sample is damaged."""

from dataclasses import replace
from pathlib import Path

import pytest

from gcd_dataset.loaders.fake import fake_sample
from gcd_dataset.shards import ShardReader, ShardWriter
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


def test_a_damaged_garment_has_no_tags_and_the_others_do(tmp_path: Path) -> None:
    reader = ShardReader(write(tmp_path))
    (shard,) = tmp_path.glob("*.tar")
    content = bytearray(shard.read_bytes())
    content[int(reader.index.start[2]) + 700] ^= 1  # in its meta.json
    shard.write_bytes(content)
    tags = GarmentTags(ShardReader(tmp_path))
    tags.read()
    assert (tags.known, tags.counts(TAG)) == (COUNT, {"dress": 3, "skirt": 2})
