"""Generated garments for the tests of loaders: patterns; coarse garments at their start positions, with views."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from gcd_dataset.generator.drape import DrapeJob
from gcd_dataset.generator.drapers import DrapeReply, DrapeRequest
from gcd_dataset.generator.drapers.draper import make_reply
from gcd_dataset.generator.maker import make
from gcd_dataset.generator.pipeline import finish, prepare, view_requests
from gcd_dataset.generator.recipe import MakeConfig, recipe_of
from gcd_dataset.records import Drape, Maps, Outcome, Sample
from tests.shards.folders import write_samples

SEED, SIZE, COUNT = 4, 48, 3
CONFIG = MakeConfig(resolution=10.0, picture=0, points=16, views=2, view_size=SIZE, device="cpu")


def requests(count: int, config: MakeConfig = CONFIG) -> list[DrapeRequest]:
    """The requests of garments 0 to ``count - 1``."""
    made = []
    for number in range(count):
        design = prepare(SEED, number, replace(config, stage="mesh", views=0))
        for worn, views in zip(design.dressed, view_requests(design, config), strict=True):
            assert worn.box_mesh is not None
            made.append(DrapeRequest(worn.index, DrapeJob(worn.box_mesh, worn.body, worn.size), 0, False, views))
    return made


def start_of(request: DrapeRequest) -> Drape:
    """A settled drape at the start positions, which float32 does not hold exactly."""
    vertices = request.job.box_mesh.vertices + 1e-5
    return Drape(vertices, Outcome.SETTLED, 1, 0, 0, 1.0, 1.0)


def samples(count: int, config: MakeConfig = CONFIG) -> list[Sample]:
    """Garments with their views."""
    replies = [make_reply(request, start_of(request), "cpu") for request in requests(count, config)]
    return [sample_of(reply, config) for reply in replies]


def write_mapped(folder: Path, made: Sequence[Sample]) -> Path:
    """Garments whose gap is the height of the cloth [cm], and whose pressure is 0."""
    mapped = []
    for sample in made:
        assert sample.drape is not None
        height = sample.drape.vertices[:, 1]
        mapped.append(replace(sample, maps=Maps(np.stack([height, -height], axis=1), height, 0.0 * height, 1.0)))
    return write(folder, mapped, replace(CONFIG, maps=True))


def sample_of(reply: DrapeReply, config: MakeConfig = CONFIG) -> Sample:
    design = prepare(SEED, reply.number, replace(config, stage="mesh", views=0))
    return finish(design, reply.number, config, reply)


def write(folder: Path, made: Sequence[Sample], config: MakeConfig = CONFIG) -> Path:
    return write_samples(folder, made, seed=SEED, recipe=recipe_of(config))


def diverged(request: DrapeRequest) -> Drape:
    return Drape(np.full_like(request.job.box_mesh.vertices, np.nan), Outcome.DIVERGED, 1, 0, 0, np.nan, np.nan)


def pattern_shards(folder: Path, count: int, *, seed: int = 0, shard_size: int = 1000) -> Path:
    """Write patterns 0 … ``count`` - 1 of a seed as shards; one takes 30 ms. Returns the folder."""
    config = MakeConfig(bodies="neutral", stage="pattern")
    samples = (make(seed, index, config) for index in range(count))
    return write_samples(folder, samples, seed=seed, recipe=recipe_of(config), shard_size=shard_size)
