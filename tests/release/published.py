"""A small data set of fake garments in the published layout, written by ``export_published``."""

import atexit
import json
import shutil
import tarfile
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from gcd_dataset.bodies import POSES, BodyMesh, Person
from gcd_dataset.bodyfiles import write_measurements
from gcd_dataset.exports.published import export_published, exported_splits
from gcd_dataset.loaders.fake import fake_sample
from gcd_dataset.records import MEASURES, BodyPart, Measurements, Sample
from gcd_dataset.release.published_names import ENDINGS
from tests.shards.folders import write_samples

RELEASE = "GarmentCodeData_v2"
BODIES = ("default_body", "random_body")
BATCH = "garments_5000_0"
TRAIN, TEST = ("rand_AAAAAAAAA0", "rand_AAAAAAAAA1"), ("rand_AAAAAAAAA2",)
DESIGNS: Mapping[str, tuple[str, ...]] = {"train": TRAIN, "test": TEST}
SIZE = Measurements(**{name: 1.0 if name.endswith("incl") else 50.0 + i for i, name in enumerate(MEASURES)})


def garment(name: str, number: int, body: str) -> Sample:
    """A fake garment for a release."""
    made = fake_sample(7, 2 * number + BODIES.index(body))
    wearer = "mean_all" if body == BODIES[0] else f"{number:05d}_straight"
    source = f"{RELEASE}/{BATCH}/{body}/{name}"
    return replace(
        made,
        provenance=replace(made.provenance, body_name=wearer, source=source),
        pattern=replace(made.pattern, name=name),
        measurements=SIZE,
        design={"skirt": {"width": {"v": 1.5, "range": [1, 2], "type": "float"}}},
        shape=None,
    )


@cache
def _published() -> TemporaryDirectory:
    """The published folder, written once in each process of the tests."""
    folder = TemporaryDirectory()
    atexit.register(folder.cleanup)
    made = Path(folder.name)
    for split, names in DESIGNS.items():
        samples = (garment(name, number, body) for number, name in enumerate(names) for body in BODIES)
        write_samples(made / "shards", samples, split=split, seed=7)
    list(export_published(exported_splits(made / "shards"), made / RELEASE))
    return folder


def publish(folder: Path) -> Path:
    """The same designs in the published layout, in folders; and as shards in ``folder``/shards."""
    shutil.copytree(_published().name, folder, dirs_exist_ok=True)
    return folder / RELEASE


def pack(root: Path) -> Path:
    """Pack the garments of each batch into an archive, as in the download."""
    for data in root.glob("*/*/data"):
        with tarfile.open(data.parent / "data.tar.gz", "w:gz") as tar:
            tar.add(data, "data")
        shutil.rmtree(data)
    return root


def file_of(root: Path, name: str, kind: str, body: str = BODIES[0]) -> Path:
    """One file of a garment."""
    return root / BATCH / body / "data" / name / f"{name}{ENDINGS[kind]}"


def split_lists(root: Path) -> dict[str, list[str]]:
    """The content of the split file."""
    (path,) = root.glob("*split*.json")
    lists: dict[str, list[str]] = json.loads(path.read_text())
    return lists


def publish_people(folder: Path, people: Sequence[Person], mesh: BodyMesh) -> Path:
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
