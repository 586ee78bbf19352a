"""People of a few vertices, as body sets."""

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from gcd_dataset import __version__
from gcd_dataset.bodies import BodyMesh, Person
from gcd_dataset.records import MEASURES, BodyPart, BodyShape, Measurements
from gcd_dataset.shards import ShardWriter
from gcd_dataset.shards.body_set import encode_person, mesh_bytes
from gcd_dataset.shards.layout import BODIES, mesh_name
from tests.shards.folders import RECIPE, SHARD_SIZE

MESH = BodyMesh(
    faces=np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]]),
    parts=np.array(
        [BodyPart.LEFT_LEG.value, BodyPart.RIGHT_LEG.value, BodyPart.TRUNK.value, BodyPart.HEAD.value], np.uint8
    ),
)
"""A tetrahedron with its tip at the top."""


def fake_person(index: int) -> Person:
    """A tetrahedron; its two front corners are the legs."""
    random = np.random.default_rng(index)
    height = random.uniform(150.0, 190.0)
    straight = np.array([[10, 0, 10], [-10, 0, 10], [0, 0, -10], [0, height, 0]], np.float32)
    lengths = Measurements(**dict(zip(MEASURES, random.uniform(10.0, 100.0, len(MEASURES)), strict=True)))
    angles = {name: getattr(lengths, name) / 100.0 for name in ("shoulder_incl", "arm_pose_angle", "hip_inclination")}
    return Person(
        name=f"fake:{index}",
        shape=BodyShape(random.normal(size=3), random.uniform(-0.2, 0.2)),
        straight=straight,
        apart=straight * np.array([2.0, 1.0, 1.0], np.float32),
        measurements=Measurements(**{**vars(lengths), **angles}),
    )


def fill(
    folder: Path,
    indices: Iterable[int],
    *,
    seed: int = 0,
    split: str = "train",
    recipe: Mapping[str, Any] = RECIPE,
    **options: Any,
) -> Path:
    """Write people to a folder."""
    recipe = {**recipe, "mesh": MESH.sha256}
    origin = {"seed": seed, "versions": {"gcd_dataset": __version__}, "recipe": recipe}
    given = {"shard_size": SHARD_SIZE, **options}
    with ShardWriter(folder, split=split, seed=seed, recipe=recipe, layout=BODIES, **given) as writer:
        for index in sorted(indices):
            writer.add(index, encode_person(fake_person(index), {**origin, "index": index}))
    (folder / mesh_name(split)).write_bytes(mesh_bytes(MESH))
    return folder
