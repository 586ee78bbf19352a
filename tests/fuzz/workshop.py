"""Files of every form that the package reads, made from a few real garments."""

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import trimesh

from gcd_dataset.generator.drawing import jpeg_bytes
from gcd_dataset.generator.maker import make
from gcd_dataset.generator.recipe import MakeConfig, recipe_of
from gcd_dataset.records import Drape, Outcome, Sample
from gcd_dataset.shards import ShardWriter

CONFIG = MakeConfig(stage="mesh", resolution=8.0, points=64)
COUNT = 2


@cache
def garments() -> tuple[Sample, ...]:
    """Garments of the sampler with the box mesh as drape; draping would take minutes."""
    return tuple(_with_drape(make(3, index, CONFIG)) for index in range(COUNT))


def write_shards(folder: Path, *, count: int = COUNT) -> Path:
    """The first garments as a data set of one shard."""
    with ShardWriter(folder, seed=3, recipe=recipe_of(replace(CONFIG, stage="drape", device="cpu"))) as writer:
        for sample in garments()[:count]:
            writer.write(sample)
    return folder


def small_body() -> trimesh.Trimesh:
    """A closed shape of a person's height, of few triangles [cm]."""
    shape = trimesh.creation.capsule(height=130.0, radius=20.0, count=[8, 8])
    shape.apply_transform(trimesh.transformations.rotation_matrix(-np.pi / 2, [1, 0, 0]))
    shape.apply_translation([0.0, -shape.vertices[:, 1].min(), 0.0])
    return shape


def _with_drape(sample: Sample) -> Sample:
    assert sample.box_mesh is not None
    picture = jpeg_bytes(np.full((16, 16, 3), 90 + sample.provenance.index, np.uint8))
    drape = Drape(sample.box_mesh.vertices, Outcome.SETTLED, 100, 3, 0, 1.0, 1.1)
    return replace(sample, drape=drape, front=picture, back=picture)
