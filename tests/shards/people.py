"""People of a few vertices, as body sets and in the published layout."""

import json
from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np

from gcd_dataset.bodies import POSES, BodyMesh, Person
from gcd_dataset.bodyfiles import write_measurements
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


def publish(folder: Path, people: Sequence[Person], mesh: BodyMesh) -> Path:
    """The people in the layout of GarmentCodeData's ``5000_body_shapes_and_measures``, in metres, named by number."""
    for kind in ("meshes", "measurements", "meta"):
        (folder / kind).mkdir(parents=True)
    corners = "".join(f"f {a} {b} {c}\n" for a, b, c in np.asarray(mesh.faces) + 1)
    for number, person in enumerate(people):
        for pose in POSES:
            metres = np.asarray(getattr(person, pose), float) / 100.0
            text = "".join(f"v {x!r} {y!r} {z!r}\n" for x, y, z in metres.tolist())
            (folder / "meshes" / f"{number:05d}_{pose}.obj").write_text("# OBJ export\n" + text + corners)
        write_measurements(person.measurements, folder / "measurements" / f"{number:05d}.yaml")
        meta = {
            "arm_inclination": float(np.degrees(person.shape.arm_angle)),
            "pca_weights": person.shape.weights.tolist(),
        }
        (folder / "meta" / f"{number:05d}_meta.json").write_text(json.dumps(meta, indent=2))
    return folder


def segmentation(path: Path, mesh: BodyMesh) -> Path:
    """The mesh's parts as a JSON of vertex ids by GarmentCode's names."""
    names = {
        "body": BodyPart.TRUNK, "left_arm": BodyPart.LEFT_ARM, "right_arm": BodyPart.RIGHT_ARM, "head": BodyPart.HEAD,
        "left_leg": BodyPart.LEFT_LEG, "right_leg": BodyPart.RIGHT_LEG, "hands": BodyPart.HANDS, "feet": BodyPart.FEET,
        "face_internal": BodyPart.INTERNAL,
    }  # fmt: skip
    assert mesh.parts is not None
    path.write_text(
        json.dumps({name: np.flatnonzero(mesh.parts == part.value).tolist() for name, part in names.items()})
    )
    return path
