"""Index and manifest of large data sets are small, and read within bounded memory."""

import gc
import hashlib
import pickle
import tracemalloc
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from gcd_dataset.errors import ShardError
from gcd_dataset.making.tasks import MOST
from gcd_dataset.shards.index import SplitIndex
from gcd_dataset.shards.layout import LARGEST_MANIFEST, MEMBERS
from gcd_dataset.shards.manifest import Manifest, Plan, ShardRecord, SplitRecord, parse_manifest
from gcd_dataset.shards.notes import shards_named
from gcd_dataset.shards.sections import pack
from gcd_dataset.shards.tar import BLOCK, END

SIZE = 128  # samples of a shard
SAMPLE = 254  # blocks: 130 kB


def record_of(count: int) -> SplitRecord:
    """The record of ``count`` garments with pictures."""
    length = SIZE * SAMPLE * BLOCK + END
    hashes = [hashlib.sha256(b"%d" % n).hexdigest() for n in range(count // SIZE)]
    shards = tuple(ShardRecord(n, SIZE, length, sha256, length, sha256) for n, sha256 in enumerate(hashes))
    plan = Plan("garments", 0, {"stage": "drape"}, count, SIZE)
    return SplitRecord(plan, shards, MEMBERS, {f"a_rule_with_a_long_name_{n}": 17 for n in range(30)})


def index_of(count: int) -> SplitIndex:
    random = np.random.default_rng(0)
    blocks = (np.arange(SIZE) * SAMPLE + np.append(0, random.integers(-99, 99, SIZE - 1))).astype(np.int32)
    blocks = np.tile(blocks, count // SIZE)
    grade, outcome = random.integers(1, 4, count, np.uint8), np.ones(count, np.uint8)
    return SplitIndex(record_of(count), np.arange(count, dtype=np.int32), blocks, blocks, grade, outcome)


def test_the_manifest_of_the_largest_data_set_is_read() -> None:
    few, more = (len(Manifest({"train": record_of(count)}).to_bytes()) for count in (12_800, 25_600))
    assert (more - few) / 12_800 * MOST < LARGEST_MANIFEST
    manifest = Manifest({"train": record_of(256_000)})
    assert parse_manifest(manifest.to_bytes(), "manifest.json") == manifest


def test_the_index_of_equally_large_samples_is_read_again() -> None:
    """It compresses more than any other."""
    count = 1_280_000
    record = replace(record_of(SIZE), shards=tuple(replace(one, views_size=0) for one in record_of(count).shards))
    blocks = np.tile(np.arange(SIZE, dtype=np.int32) * SAMPLE, count // SIZE)
    none, number = np.zeros(count, np.uint8), np.arange(count, dtype=np.int32)
    index = SplitIndex(record, number, blocks, blocks[:0], none, none)
    assert np.array_equal(SplitIndex.from_bytes(index.to_bytes(), record, "train.index").start, index.start)


def test_an_index_takes_a_few_bytes_a_sample_on_disk_in_memory_and_pickled() -> None:
    count = 128_000
    index = index_of(count)
    content = index.to_bytes()
    assert len(content) < 8 * count
    assert len(pickle.dumps(index)) < 8 * count + 400 * count // SIZE
    gc.collect()
    tracemalloc.start()
    again = SplitIndex.from_bytes(content, index.record, "train.index")
    kept, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert kept < 20 * count and peak < 100 * count
    for name in ("number", "start", "end", "views_start", "views_end", "shard", "grade", "outcome", "settled"):
        assert np.array_equal(getattr(again, name), getattr(index, name)), name
    assert (again.end[:-1] == again.start[1:])[again.shard[:-1] == again.shard[1:]].all()
    assert set(again.end[again.first[1:] - 1].tolist()) == {SIZE * SAMPLE * BLOCK}


HOSTILE: dict[str, list[Callable[[Any], Any]]] = {
    "number": [
        lambda a: a - 1,
        lambda a: a * 0,
        lambda a: a[:-1],
        lambda a: a.astype(float),
        lambda a: np.tile(a, 1 << 16),
    ],
    "start": [lambda a: a - 1, lambda a: a[::-1].copy(), lambda a: a + SIZE * SAMPLE, lambda a: a * 0],
    "views_start": [lambda a: a[:0], lambda a: a * 0],
    "grade": [lambda a: a + np.uint8(200), lambda a: np.tile(a, 1000)],
    "outcome": [lambda a: a + np.uint8(200), lambda a: a.reshape(-1, 1)],
}


@pytest.mark.parametrize(("name", "number"), [(name, k) for name in HOSTILE for k in range(len(HOSTILE[name]))])
def test_an_index_that_does_not_fit_its_shards_is_refused(name: str, number: int) -> None:
    index = index_of(256)
    arrays = {"number": index.number, "start": index.blocks, "views_start": index.views_blocks}
    arrays |= {"grade": index.grade, "outcome": index.outcome}
    arrays[name] = HOSTILE[name][number](arrays[name])
    content = pack(arrays)
    tracemalloc.start()
    with pytest.raises(ShardError, match=r"train\.index: not the index of these shards \(.*\): run gcd index"):
        SplitIndex.from_bytes(content, index.record, "train.index")
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 1 << 20


def test_shards_beyond_the_five_digits_of_their_names_stay_in_order() -> None:
    names = ["train-100000.tar", "train-99999.tar", f"train-{'9' * 5004}.tar", "train-1.tar", ".train-00001.tar", "x/a"]
    assert shards_named(names) == [("train", 99_999), ("train", 100_000)]
