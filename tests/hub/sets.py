"""Data sets of samples with arbitrary bytes, for tests that do not look into the samples."""

import hashlib
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np

from gcd_dataset.shards.index import SplitIndex, index_name
from gcd_dataset.shards.layout import key_of
from gcd_dataset.shards.manifest import MANIFEST, Manifest, Plan, ShardRecord, SplitRecord
from gcd_dataset.shards.tar import BLOCK, END, tar_entry

MEMBERS = ("meta.json", "verts.z")
PICTURES = ("front.jpg",)


def content(number: int, member: str, *, seed: int = 0) -> bytes:
    """The content of a member: up to 20 kB, not compressible."""
    rng = np.random.default_rng([seed, number, len(member)])
    return rng.bytes(int(rng.integers(10_000, 20_000)))


def sample(number: int, members: tuple[str, ...], *, seed: int = 0) -> bytes:
    """A sample in a tar."""
    return b"".join(tar_entry(f"{key_of(number)}.{member}", content(number, member, seed=seed)) for member in members)


def write_set(
    folder: Path,
    counts: Mapping[str, int] = {"train": 10},
    *,
    shard_size: int = 4,
    views: bool = True,
    seed: int = 0,
) -> Path:
    """Write a data set whose splits have these numbers of samples; an existing one grows."""
    splits, start = {}, 0
    for split, count in counts.items():
        splits[split] = _write_split(folder, split, range(start, start + count), shard_size, views, seed)
        start += count
    plan = Plan("garments", seed, {"stage": "drape"}, start, shard_size)
    manifest = Manifest({split: replace(record, plan=plan) for split, record in splits.items()})
    (folder / MANIFEST).write_bytes(manifest.to_bytes())
    return folder


def _write_split(folder: Path, split: str, numbers: range, size: int, views: bool, seed: int) -> SplitRecord:
    records, blocks, views_blocks = [], list[int](), list[int]()
    for shard in range(-(-len(numbers) // size)):
        own = numbers[shard * size : (shard + 1) * size]
        named = ShardRecord(shard, len(own), 0, "")
        tar = _write_tar(folder / named.name(split), [sample(n, MEMBERS, seed=seed) for n in own], blocks)
        pictures: tuple[int, str] | tuple[()] = ()
        if views:
            pictures = _write_tar(
                folder / named.views_name(split), [sample(n, PICTURES, seed=seed) for n in own], views_blocks
            )
        records.append(ShardRecord(shard, len(own), *tar, *pictures))
    members = MEMBERS + (PICTURES if views else ())
    plan = Plan("garments", seed, {"stage": "drape"}, len(numbers), size)
    record = SplitRecord(plan, tuple(records), members)
    number, marks = np.array(numbers, np.int32), np.ones(len(numbers), np.uint8)
    index = SplitIndex(record, number, np.array(blocks, np.int32), np.array(views_blocks, np.int32), marks, marks)
    (folder / index_name(split)).write_bytes(index.to_bytes())
    return replace(record, index_sha256=hashlib.sha256(index.to_bytes()).hexdigest())


def _write_tar(path: Path, samples: list[bytes], blocks: list[int]) -> tuple[int, str]:
    starts = np.cumsum([0, *map(len, samples)])[:-1] // BLOCK
    blocks += starts.tolist()
    data = b"".join(samples) + bytes(END)
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(data)
    return len(data), hashlib.sha256(data).hexdigest()
