"""Published data sets of small garments, and how the tests read them."""

import functools
import shutil
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

from gcd_dataset.loaders.fake import fake_sample
from gcd_dataset.shards import ShardWriter, encode_sample
from gcd_dataset.shards.store import Store

COUNT = 10
RECIPE = {"stage": "drape"}


def write_set(
    folder: Path,
    counts: Mapping[str, int] = {"train": COUNT},
    *,
    views: bool = True,
    seed: int = 0,
) -> Path:
    """Write a data set of shards of 4 garments, as it is published: without notes. An existing one is replaced."""
    shutil.rmtree(folder, ignore_errors=True)
    recipe, numbers = RECIPE if views else {**RECIPE, "picture": 0}, iter(range(sum(counts.values())))
    for split, count in counts.items():
        with ShardWriter(
            folder, split=split, seed=seed, recipe=recipe, count=sum(counts.values()), shard_size=4
        ) as writer:
            for number in [next(numbers) for _ in range(count)]:
                writer.add(number, _garment(seed, number, views))
    for path in (*folder.glob("*-?????.json"), folder / "rejects.jsonl"):
        path.unlink()
    return folder


@functools.cache
def _garment(seed: int, number: int, views: bool) -> Mapping[str, bytes]:
    made = fake_sample(seed, number)
    if not views:
        made = replace(
            made, front=None, back=None, provenance=replace(made.provenance, recipe={**RECIPE, "picture": 0})
        )
    return encode_sample(made)


def read(store: Store, number: int, *, views: bool = False) -> bytes:
    """The bytes of a sample of ``train`` in its tar, or in that of its pictures."""
    index = store.index("train")
    starts, ends = (index.views_start, index.views_end) if views else (index.start, index.end)
    shard = index.record.shards[index.shard[number]]
    return bytes(store.part("train", shard, int(starts[number]), int(ends[number]), views=views))


def ensure(store: Store, *, views: bool = False) -> None:
    """Bring all shards of ``train`` into the cache."""
    store.ensure("train", store.manifest().splits["train"].shards, views=views)
