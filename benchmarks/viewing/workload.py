"""A large data set for the viewer: small garments of several kinds, and a few of the size of a dress on a body."""

import json
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

from benchmarks.loading.workload import large_sample
from gcd_dataset.generator.body import named_body
from gcd_dataset.loaders.fake import fake_sample
from gcd_dataset.records import Grade, Outcome, Sample
from gcd_dataset.shards import ShardWriter, encode_sample
from gcd_dataset.shards.layout import key_of
from gcd_dataset.shards.manifest import MANIFEST
from gcd_dataset.shards.meta import SEAL, sealed

FULL = 32  # garments of full size
KINDS = ("top", "dress", "jumpsuit", "skirt", "trousers")
STYLES = ("mini", "maxi", "slit")
OUTCOMES = (Outcome.SETTLED, Outcome.SETTLED, Outcome.SETTLED, Outcome.THROUGH_ITSELF)
KIND, OUTCOME = "dress", "through itself"
RECIPE = {"viewer": 1}


def full_range(count: int) -> range:
    """Indices of the garments of full size, in the middle of a set."""
    return range(count // 2, count // 2 + FULL)


def write_set(folder: Path, count: int) -> Path:
    """Write a set of ``count`` garments; one that is there already is kept. Returns the folder."""
    small = [encode_sample(_tagged(fake_sample(0, number), number)) for number in range(len(KINDS) * len(OUTCOMES))]
    full = full_range(count)
    _, _, shape = named_body("neutral")
    if (folder / MANIFEST).exists():
        return folder
    with ShardWriter(folder, seed=0, recipe=RECIPE) as writer:
        for index in range(count):
            if index in full:
                writer.write(_tagged(replace(large_sample(index), shape=shape), index))
            else:
                writer.add(index, _renumbered(small[index % len(small)], index))
    return folder


def _tagged(sample: Sample, number: int) -> Sample:
    outcome = OUTCOMES[number % len(OUTCOMES)]
    drape = None if sample.drape is None else replace(sample.drape, outcome=outcome)
    tags = (KINDS[number % len(KINDS)], STYLES[number % len(STYLES)])
    grade = Grade.CLEAN if outcome is Outcome.SETTLED else Grade.FAILED
    return replace(sample, drape=drape, tags=tags, grade=grade)


def _renumbered(members: Mapping[str, bytes], index: int) -> dict[str, bytes]:
    """An encoded sample under another index."""
    stored = {name: value for name, value in json.loads(members["meta.json"]).items() if name != SEAL}
    return {**members, "meta.json": sealed(stored | {"index": index, "key": key_of(index)})}
