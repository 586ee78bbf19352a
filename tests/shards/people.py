"""People of a few vertices, as body sets."""

from collections.abc import Iterable
from pathlib import Path

import numpy as np

from gcd_dataset.bodies import BodyMesh, Person
from gcd_dataset.records import MEASURES, BodyPart, BodyShape, Measurements
from gcd_dataset.shards.body_set import BodyWriter

SHARD_SIZE = 4
RECIPE = {"fake": True}
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


def fill(folder: Path, indices: Iterable[int], *, seed: int = 0, mesh: BodyMesh = MESH) -> Path:
    """Write people to a folder with one writer."""
    with open_writer(folder, seed=seed, mesh=mesh) as writer:
        for index in sorted(indices):
            writer.write(index, fake_person(index))
    return folder


def open_writer(folder: Path, *, seed: int = 0, mesh: BodyMesh = MESH) -> BodyWriter:
    return BodyWriter(folder, mesh, seed=seed, recipe=RECIPE, shard_size=SHARD_SIZE)
