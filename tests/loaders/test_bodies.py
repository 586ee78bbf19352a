"""Data sets of bodies: shards and the published folder give the same items."""

import re
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from torch.utils.data import ConcatDataset, DataLoader

from gcd_dataset import generate_people
from gcd_dataset.bodies import POSES
from gcd_dataset.errors import BodyError, ConfigError, ShardError
from gcd_dataset.generator.body import build_body, measure
from gcd_dataset.generator.body.by_name import make_person
from gcd_dataset.generator.maker import make
from gcd_dataset.generator.recipe import MakeConfig
from gcd_dataset.loaders import Bodies, BodyDataset, PublishedBodies
from gcd_dataset.records import MEASURES, BodyPart
from gcd_dataset.shards.body_set import mesh_bytes
from tests.loaders.test_shards import same
from tests.release.published import publish_people, segmentation
from tests.shards.people import MESH, fill
from tests.shards.test_reader import flip_member

COUNT = 3
SEED = 5


@pytest.fixture(scope="module")
def ours(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Three generated people in shards."""
    folder = tmp_path_factory.mktemp("ours")
    generate_people(folder, COUNT, seed=SEED, workers=0)
    return folder


@pytest.fixture(scope="module")
def published(ours: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The same people in the published layout."""
    ds = BodyDataset(ours)
    return publish_people(tmp_path_factory.mktemp("published") / "5000", [ds.person(i) for i in range(COUNT)], ds.mesh)


def assert_same(item: Mapping[str, Any], other: Mapping[str, Any]) -> None:
    """Everything but the name."""
    assert same({**item, "name": ""}, {**other, "name": ""})


def test_a_stored_shape_builds_the_stored_meshes(ours: Path) -> None:
    ds = BodyDataset(ours)
    for index in range(COUNT):
        person = ds.person(index)
        made = make_person(SEED, index)
        assert (person.name, person.shape) == (made.name, made.shape)
        values, expected = (each.measurements.to_file_values() for each in (person, made))
        assert values == pytest.approx(expected, rel=1e-12)  # angles were in degrees meanwhile
        for pose in POSES:
            assert np.abs(getattr(person, pose) - getattr(made, pose)).max() < 1e-3  # cm
        assert np.abs(person.straight - build_body(person.shape).vertices).max() < 1e-3


def test_an_item_holds_the_persons_fields(ours: Path) -> None:
    ds = BodyDataset(ours)
    item, person = ds[1], ds.person(1)
    assert item["name"] == person.name
    assert person.name in (f"female:{SEED}:1", f"male:{SEED}:1")
    for field in ("straight", "apart"):
        assert torch.equal(item[field], torch.from_numpy(np.array(getattr(person, field))))
    assert torch.equal(item["shape"], torch.tensor(person.shape.weights, dtype=torch.float32))
    assert item["arm_angle"].item() == pytest.approx(person.shape.arm_angle, rel=1e-6)
    measures = dict(zip(ds.columns, item["measures"].tolist(), strict=True))
    assert measures == pytest.approx(person.measurements.to_file_values(), rel=1e-6)


def test_one_person_has_the_same_measures_in_both_poses(ours: Path) -> None:
    ds = BodyDataset(ours)
    for index in range(COUNT):
        person = ds.person(index)
        stored = person.measurements.to_file_values()
        straight = measure(person.body(ds.mesh)).to_file_values()
        apart = measure(person.body(ds.mesh, legs_apart=True)).to_file_values()
        assert straight == pytest.approx(stored, abs=0.02)
        # Measures above the pelvis do not depend on the pose of the legs.
        above = [
            *("head_l", "neck_w", "shoulder_w", "shoulder_incl", "arm_length", "wrist", "bust", "waist", "waist_line")
        ]
        assert {name: apart[name] for name in above} == pytest.approx({name: stored[name] for name in above}, abs=0.03)
        # Spread legs lower the body and move the feet apart.
        assert apart["height"] < straight["height"]
        feet = np.flatnonzero(ds.mesh.parts == BodyPart.FEET.value)
        assert np.ptp(person.apart[feet, 0]) > np.ptp(person.straight[feet, 0]) + 4.0
        assert person.straight[:, 1].min() == person.apart[:, 1].min() == 0.0


def test_person_i_wears_design_i(ours: Path) -> None:
    sample = make(SEED, 2, MakeConfig(stage="pattern"))
    person = BodyDataset(ours).person(2)
    assert sample.shape is not None
    assert np.array_equal(sample.shape.weights, person.shape.weights)
    assert sample.provenance.body_name == person.name
    assert sample.measurements.to_file_values() == pytest.approx(person.measurements.to_file_values(), rel=1e-15)


def test_the_mesh_is_stored_once(ours: Path) -> None:
    ds = BodyDataset(ours)
    assert ds.faces.dtype == torch.int32 and ds.parts is not None
    assert ds.faces.max() + 1 == len(ds.parts) == len(ds[0]["straight"])
    volume = torch.linalg.det(ds[0]["straight"][ds.faces.long()].double()).sum() / 6
    assert 40_000 < volume < 150_000  # cm³, of a person with outward faces


def test_a_plain_loader_stacks_people(ours: Path, published: Path) -> None:
    both = BodyDataset(ours), PublishedBodies(published)
    batches: DataLoader[Any] = DataLoader(ConcatDataset(both), batch_size=COUNT)
    for ds, batch in zip(both, batches, strict=True):
        assert batch["measures"].shape == (COUNT, len(MEASURES))
        assert batch["apart"].shape == (COUNT, len(ds[0]["apart"]), 3)
        assert batch["arm_angle"].shape == (COUNT,)
        for index in range(COUNT):
            assert_same(ds[index], {field: values[index] for field, values in batch.items()})


def test_damage_is_named(tmp_path: Path) -> None:
    folder = fill(tmp_path, range(2))
    flip_member(folder, 1, "person.z")
    with pytest.raises(ShardError, match=r"sample gcd_000000001, member person\.z: bytes differ"):
        BodyDataset(folder)[1]
    with pytest.raises(ShardError, match=r"member person\.z"):
        BodyDataset(folder, fields=["measures"]).verify(1)
    assert BodyDataset(folder, fields=["straight"])[0]["straight"].shape == (4, 3)
    for content in (b"", b"(\xb5/\xfd", mesh_bytes(replace(MESH, faces=MESH.faces[:, [1, 2, 0]]))):
        (folder / "mesh-train.z").write_bytes(content)
        with pytest.raises(ShardError, match=r"mesh-train\.z: not the mesh of (a body set|these bodies)"):
            BodyDataset(folder)


def test_the_published_layout_gives_the_same_items(ours: Path, published: Path, tmp_path: Path) -> None:
    shards = BodyDataset(ours)
    folder = PublishedBodies(published, segmentation=segmentation(tmp_path / "parts.json", shards.mesh))
    assert len(folder) == len(shards) == COUNT
    for index in range(COUNT):
        assert_same(folder[index], shards[index])
    assert folder.names == tuple(folder[i]["name"] for i in range(COUNT)) == ("00000", "00001", "00002")
    assert torch.equal(folder.faces, shards.faces)
    assert folder.parts is not None and shards.parts is not None
    assert torch.equal(folder.parts, shards.parts)
    dressed = folder.person(1).body(folder.mesh, legs_apart=True)
    assert dressed.vertices.dtype == float and len(dressed.vertices) == len(dressed.parts)


def test_an_unfinished_run_is_warned_of(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    fill(tmp_path, range(3), seed=SEED, recipe={"stage": "body", "bodies": "random"}, count=9)
    BodyDataset(tmp_path, partial=True)
    assert not caplog.messages
    BodyDataset(tmp_path)
    words = "3 of 9 samples .*gcd generate .* --count 9 --seed 5 --bodies random --stage body"
    assert re.search(words, "".join(caplog.messages))


def test_only_the_files_of_the_fields_are_read(ours: Path, few: Path) -> None:
    for ds in (BodyDataset(ours, fields=("measures", "name")), PublishedBodies(few, fields=("measures", "name"))):
        assert list(ds[0]) == ["name", "measures"]
        assert isinstance(ds, Bodies)
        with pytest.raises(
            ConfigError, match="no field waist: there are name, shape, arm_angle, measures, straight, apart"
        ):
            type(ds)(few, fields=["waist"])
        with pytest.raises(IndexError, match="person 7 of"):
            ds[7]
    first: Any = PublishedBodies(few, fields=["measures"], transform=lambda item: item["measures"][0])
    assert first[-1] > 0
    for path in (few / "meshes").iterdir():
        path.unlink()
    assert PublishedBodies(few, fields=["shape"])[0]["shape"].shape == (3,)


def test_a_missing_file_is_named(few: Path) -> None:
    (few / "meshes" / "00001_apart.obj").unlink()
    with pytest.raises(ShardError, match=r"meshes/00001_apart\.obj: missing; 1 of 8 files are missing: extract"):
        PublishedBodies(few)
    assert len(PublishedBodies(few, names=["00000"])) == 1
    assert PublishedBodies(few, fields=["straight"])[1]["straight"].shape == (4, 3)
    without = PublishedBodies(few, fields=["straight"])
    assert without.parts is None
    with pytest.raises(BodyError, match="00000: the mesh has no labels for arms and legs"):
        without.person(0).body(without.mesh)


APART, META, WHOLE = "meshes/00001_apart.obj", "meta/00001_meta.json", r"(?s)\A.*\Z"


@pytest.mark.parametrize(
    ("file", "pattern", "put", "message"),
    [
        (APART, r"^v (\S+) ", "v nan ", "a position that is NaN or infinite"),
        (APART, r"^v (\S+) \S+ \S+", r"v \1", "a vertex that is not three numbers"),
        (APART, r"^f (.*)$", r"f \1 4", r"a face that is not a triangle \(f 1 3 2 4\)"),
        (APART, r"^f (.*)$", "f 1 2 9", "a face with a vertex that is not one of its 4"),
        (APART, r"^f (.*)$", "f 1 2 x", "a face without vertex numbers"),
        (APART, r"^f (.*)$", "f 3 2 1", "its mesh differs from 00000_straight.obj: all people must be on one mesh"),
        (APART, r"^v (\S+) (\S+) (\S+)$", r"v 0 0 0\nv \1 \2 \3", "its mesh differs from"),
        (APART, r"^v (\S+) (1\.\S+) ", r"v \1 \g<2>e3 ", "m tall: published meshes are in metres"),
        (META, WHOLE, "{", "no object with pca_weights"),
        (META, WHOLE, "[]", "no object with pca_weights"),
        (META, WHOLE, '{"pca_weights": [1.0]}', "arm_inclination"),
        (META, WHOLE, '{"pca_weights": [], "arm_inclination": 1}', r"pca_weights \[\]"),
        (META, WHOLE, '{"pca_weights": [NaN], "arm_inclination": 1}', r"pca_weights \[nan\]"),
        (META, WHOLE, '{"pca_weights": [1.0], "arm_inclination": "1"}', "arm_inclination '1'"),
    ],
)
def test_a_broken_mesh_and_broken_weights_are_named(few: Path, file: str, pattern: str, put: str, message: str) -> None:
    text, count = re.subn(pattern, put, (few / file).read_text(), count=1, flags=re.M)
    assert count
    (few / file).write_text(text)
    with pytest.raises(BodyError, match=rf"{file}: .*{message}"):
        PublishedBodies(few, fields=["shape"] if file == META else None)[1]


def test_bodies_in_the_published_layout_are_read(examples: Path) -> None:
    """Stand-ins of the reference system: none is a body that ETH published."""
    root = examples / "published" / "GarmentCodeData_v2_unpacked"
    parts = examples / "bodies" / "ggg_body_segmentation.json"
    with pytest.raises(ShardError, match="missing"):  # only one of four meshes was unpacked
        PublishedBodies(root)
    ds = PublishedBodies(root, fields=("name", "measures", "shape", "straight"), names=["00345"], segmentation=parts)
    item, height = ds[0], ds.columns.index("height")
    assert item["straight"].shape == (23752, 3)
    assert ds.faces.shape == (47500, 3)
    assert item["measures"][height] == pytest.approx(173.175)
    assert item["straight"][:, 1].max() == pytest.approx(166.2, abs=0.1)  # cm: of the mean woman's mesh
    assert ds.parts is not None
    assert (ds.parts == BodyPart.LEFT_ARM.value).sum() == 3094
    everybody = PublishedBodies(root, fields=["measures"])
    assert everybody.names == ("00345", "00377")
    assert everybody[1]["measures"][height] == pytest.approx(178.0073)
