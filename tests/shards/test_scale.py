"""Index and manifest of the largest data sets are read, with bounded memory and number of writes."""

import gc
import hashlib
import json
import tracemalloc
from dataclasses import asdict
from pathlib import Path

import numpy as np
import pytest

from gcd_dataset.loaders.fake import fake_sample
from gcd_dataset.shards import ShardReader, writer
from gcd_dataset.shards.index import ShardIndex, ShardTable
from gcd_dataset.shards.layout import GARMENTS, shard_name, shard_number
from gcd_dataset.shards.limits import LARGEST_FILE
from gcd_dataset.shards.manifest import Manifest, ShardRecord, SplitRecord, keep_split, parse_manifest, read_manifest
from gcd_dataset.shards.writer import SHARD_SIZE
from gcd_dataset.verbs.making_plan import MOST
from tests.shards.folders import RECIPE, contents, fill, open_writer

MEMBER = 40_000  # bytes


def index_of(count: int) -> ShardIndex:
    """The index of ``count`` garments in shards of the default size."""
    members, shards = len(GARMENTS.members), -(-count // SHARD_SIZE)
    size = np.full((count, members), MEMBER, np.uint32)
    place = np.arange(count)[:, None] % SHARD_SIZE * members + np.arange(members)[None]
    crc = np.random.default_rng(0).integers(0, 1 << 32, (count, members), np.uint32)
    table = ShardTable(
        np.arange(count), place * 2 * MEMBER, size, crc, np.ones(count, bool), np.full(count, 3, np.uint8)
    )
    shard = np.repeat(np.arange(shards, dtype=np.int32), SHARD_SIZE)[:count]
    length = np.full(shards, SHARD_SIZE * members * 2 * MEMBER)
    return ShardIndex(tuple(shard_name("train", number) for number in range(shards)), length, shard, table)


def test_the_index_of_the_largest_data_set_is_read() -> None:
    few, more = (len(index_of(count).to_bytes()) for count in (1_000, 2_000))
    assert (more - few) / 1_000 * MOST < LARGEST_FILE


def test_the_manifest_of_the_largest_data_set_is_read() -> None:
    rejects = {f"a_rule_with_a_long_name_{number}": 17 for number in range(8)}
    shards = tuple(
        ShardRecord(shard_name("train", n), SHARD_SIZE, 1 << 28, hashlib.sha256(b"%d" % n).hexdigest(), rejects)
        for n in range(-(-MOST // SHARD_SIZE))
    )
    manifest = Manifest({"train": SplitRecord(0, RECIPE, SHARD_SIZE, shards)})
    assert parse_manifest(json.dumps(asdict(manifest)).encode(), "manifest.json") == manifest


def test_an_index_is_read_in_less_than_three_times_its_size() -> None:
    content = index_of(50_000).to_bytes()
    gc.collect()
    tracemalloc.start()
    before = tracemalloc.get_traced_memory()[0]
    index = ShardIndex.parse(content, "index-train.npz")
    peak = tracemalloc.get_traced_memory()[1] - before
    tracemalloc.stop()
    assert len(index) == 50_000
    assert peak < 2 * len(content)  # in addition to the content


def test_shards_beyond_the_five_digits_of_their_names_stay_in_order() -> None:
    names = [shard_name("train", number) for number in (99_999, 100_000, 390_624)]
    assert [shard_number(name, "train") for name in names] == [99_999, 100_000, 390_624]


def test_the_manifest_is_written_less_often_with_more_shards(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    kept = []

    def counted(folder: Path, split: str, record: SplitRecord) -> None:
        kept.append(len(record.shards))
        keep_split(folder, split, record)

    monkeypatch.setattr(writer, "keep_split", counted)
    monkeypatch.setattr(writer, "UNLISTED", 1 / 4)
    fill(tmp_path, range(100))
    assert kept == [0, 1, 2, 3, 4, 6, 8, 11, 15, 20, 25]


def test_a_kill_leaves_shards_that_the_manifest_lists_later(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(writer, "UNLISTED", 1 / 2)
    writing = open_writer(tmp_path / "killed")
    for index in range(13):
        writing.write(fake_sample(0, index))
    del writing  # without close, as after kill -9
    behind = read_manifest(tmp_path / "killed")
    assert behind is not None
    assert len(behind.splits["train"].shards) == 2
    fill(tmp_path / "killed", range(13, 16))
    assert contents(tmp_path / "killed") == contents(fill(tmp_path / "whole", range(16)))
    assert len(ShardReader(tmp_path / "killed")) == 16
