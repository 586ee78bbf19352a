"""Body sets: people are read back to the stored precision."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from gcd_dataset.errors import ConfigError, ShardError
from gcd_dataset.records import MEASURES
from gcd_dataset.shards import BODIES, ShardReader
from gcd_dataset.shards.body_set import decode_body_fields, decode_person, encode_person, mesh_bytes, read_set_mesh
from gcd_dataset.shards.sections import pack, unpack
from tests.shards import folders
from tests.shards.folders import RECIPE
from tests.shards.people import MESH, fake_person, fill

ORIGIN = {"index": 3, "seed": 0, "recipe": RECIPE, "versions": {"gcd_dataset": "0"}}


def test_a_person_is_stored_to_a_hundredth_of_a_millimetre() -> None:
    person = fake_person(3)
    person = replace(person, measurements=replace(person.measurements, underbust=np.nan))
    members = encode_person(person, ORIGIN)
    again = decode_person(members)
    assert again.shape == person.shape  # exactly
    assert again.name == person.name
    for pose in ("straight", "apart"):
        read, given = getattr(again, pose), getattr(person, pose)
        assert read.dtype == np.float32
        assert np.abs(read - given).max() < 1e-3  # cm
    for name in MEASURES:  # inclinations are stored in degrees: rounding; a missing measure stays missing
        given = getattr(person.measurements, name)
        assert getattr(again.measurements, name) == pytest.approx(given, rel=1e-15, nan_ok=True)
    assert encode_person(again, ORIGIN) == members  # a second round trip changes nothing
    row = decode_body_fields(members, ["measures"])["measures"]
    assert [MEASURES[i] for i in np.flatnonzero(np.isnan(row))] == ["underbust"]


def test_nan_positions_are_not_stored() -> None:
    broken = np.array(fake_person(3).apart)
    broken[1, 2] = np.nan
    with pytest.raises(ShardError, match="person fake:3 cannot be stored: apart holds NaN or infinity"):
        encode_person(replace(fake_person(3), apart=broken), ORIGIN)
    shape = replace(fake_person(3).shape, arm_angle=np.inf)
    with pytest.raises(ShardError, match="person fake:3 cannot be stored"):
        encode_person(replace(fake_person(3), shape=shape), ORIGIN)


def test_manifest_and_mesh_are_read_back(tmp_path: Path) -> None:
    whole = fill(tmp_path / "whole", range(10))
    split = ShardReader(whole, layout=BODIES).record
    assert (split.plan.kind, split.plan.recipe) == ("bodies", {**RECIPE, "mesh": MESH.sha256})
    assert [shard.count for shard in split.shards] == [4, 4, 2]
    for mesh in (MESH, replace(MESH, parts=None)):
        (tmp_path / "mesh-train.z").write_bytes(mesh_bytes(mesh))
        again = read_set_mesh(tmp_path, "train", mesh.sha256)
        assert np.array_equal(again.faces, mesh.faces)
        assert (again.parts is None) == (mesh.parts is None)
    assert (whole / "mesh-train.z").read_bytes() == mesh_bytes(MESH)


@pytest.mark.parametrize(
    "change",
    [{"shape": np.zeros(3, np.float32)}, {"apart": np.zeros((4, 2))}, {"straight": np.zeros(4)}, {"shape": None}],
)
def test_damaged_people_are_one_sentence(change: dict[str, np.ndarray | None]) -> None:
    members = encode_person(fake_person(3), ORIGIN)
    sections = {**unpack(members["person.z"]), **change}
    damaged = pack({name: array for name, array in sections.items() if array is not None})
    for data in (damaged, members["person.z"][:-1], b""):
        with pytest.raises(ShardError, match=r"^member person\.z: [^\n]*: copy it again"):
            decode_person({**members, "person.z": data})


def test_garments_and_bodies_are_distinguished_and_share_a_folder_as_two_splits(tmp_path: Path) -> None:
    whole = fill(tmp_path / "whole", range(1))
    with pytest.raises(ShardError, match="holds bodies, not garments: read them with BodyDataset"):
        ShardReader(whole)
    with pytest.raises(ConfigError, match="holds split train already: choose another folder"):
        fill(whole, [0])
    garments = folders.fill(tmp_path / "garments", range(2))
    with pytest.raises(ShardError, match="holds garments, not bodies: read them with GarmentDataset"):
        ShardReader(garments, layout=BODIES)
    fill(garments, [0], split="wearers")
    assert len(ShardReader(garments)) == 2
    assert len(ShardReader(garments, "wearers", layout=BODIES)) == 1
