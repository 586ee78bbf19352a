"""Body sets: people are read back unchanged; the bytes do not depend on order and interruptions of writing."""

from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from webdataset.autodecode import Decoder
from webdataset.tariterators import group_by_keys, tar_file_expander

from gcd_dataset.errors import ConfigError, ShardError
from gcd_dataset.records import MEASURES
from gcd_dataset.shards import ShardReader
from gcd_dataset.shards.body_set import (
    BodyWriter,
    decode_body_fields,
    decode_person,
    encode_person,
    mesh_bytes,
    read_set_mesh,
)
from gcd_dataset.shards.layout import BODIES, GARMENTS
from gcd_dataset.shards.manifest import read_manifest
from gcd_dataset.shards.place import FolderPlace
from gcd_dataset.shards.sections import pack, unpack
from gcd_dataset.verbs import Job, generate_people, index
from tests.making.real import killed
from tests.shards import folders
from tests.shards.folders import contents
from tests.shards.people import MESH, RECIPE, fake_person, fill, open_writer

ORIGIN = {"index": 3, "seed": 0, "recipe": RECIPE, "versions": {"gcd_dataset": "0"}}


@pytest.fixture
def whole(tmp_path: Path) -> Path:
    """Ten people in shards of four, by one writer."""
    return fill(tmp_path / "whole", range(10))


def test_encoding_a_person_keeps_all_but_a_hundredth_of_a_millimetre() -> None:
    person = fake_person(3)
    again = decode_person(encode_person(person, ORIGIN))
    assert np.abs(again.straight - person.straight).max() <= 1e-3
    assert np.abs(again.apart - person.apart).max() <= 1e-3
    stored = {"straight": person.straight, "apart": person.apart, "measurements": person.measurements}
    assert replace(again, **stored) == person
    assert again.straight.dtype == again.apart.dtype == np.float32
    for name in MEASURES:  # inclinations are stored in degrees: rounding
        assert getattr(again.measurements, name) == pytest.approx(getattr(person.measurements, name), rel=1e-15)


def test_missing_measures_stay_missing() -> None:
    person = fake_person(3)
    person = replace(person, measurements=replace(person.measurements, underbust=np.nan))
    members = encode_person(person, ORIGIN)
    assert np.isnan(decode_person(members).measurements.underbust)
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


def test_deleted_index_and_manifest_are_written_again(whole: Path) -> None:
    before = contents(whole)
    for name in ("train.index", "manifest.json"):
        (whole / name).unlink()
    index(FolderPlace(whole))
    assert contents(whole) == before


@pytest.mark.parametrize("after", [0, 3, 9])
def test_a_killed_run_continues_to_the_same_bytes(after: int, tmp_path: Path) -> None:
    make = partial(generate_people, count=12, seed=3, bodies="female", workers=0)
    killed(partial(make, tmp_path / "killed"), after=after)
    assert make(tmp_path / "killed").made == 12 - after
    make(tmp_path / "whole")
    assert contents(tmp_path / "killed") == contents(tmp_path / "whole")
    for number in (1, 0):
        make(tmp_path / "jobs", job=Job(number, 2))
    assert contents(tmp_path / "jobs") == contents(tmp_path / "whole")
    generate_people(tmp_path / "grown", 5, seed=3, bodies="female", workers=0)
    make(tmp_path / "grown")
    assert contents(tmp_path / "grown") == contents(tmp_path / "whole")
    with pytest.raises(ConfigError, match="bodies='female', asked for bodies='male'"):
        generate_people(tmp_path / "whole", 12, seed=3, bodies="male")


def test_webdataset_reads_body_sets(whole: Path) -> None:
    with (whole / "train-00000.tar").open("rb") as stream:
        samples = list(group_by_keys(tar_file_expander([{"url": "shard", "stream": stream}])))
    assert [sample["__key__"] for sample in samples] == [f"gcd_{i:09d}" for i in range(4)]
    for number, sample in enumerate(map(Decoder([]), samples)):
        assert np.allclose(unpack(sample["person.z"])["apart"], fake_person(number).apart, atol=1e-3)
        assert sample["measures.json"] == fake_person(number).measurements.to_file_values()


def test_the_manifest_lists_the_shards(whole: Path) -> None:
    manifest = read_manifest(whole)
    assert manifest is not None
    split = manifest.splits["train"]
    assert split.plan.kind == "bodies"
    assert split.plan.recipe == {**RECIPE, "mesh": MESH.sha256}
    assert [shard.count for shard in split.shards] == [4, 4, 2]


def test_people_on_another_mesh_are_not_stored(tmp_path: Path) -> None:
    person = fake_person(0)
    with (
        open_writer(tmp_path) as writer,
        pytest.raises(ShardError, match="3 vertices in pose apart, but the mesh of this set has 4"),
    ):
        writer.write(0, replace(person, apart=person.apart[:3]))
    assert contents(tmp_path) == contents(fill(tmp_path / "nobody", []))


def test_garments_and_bodies_are_distinguished(whole: Path, tmp_path: Path) -> None:
    garments = folders.fill(tmp_path / "garments", range(2))
    for folder in (whole, garments):
        for lost in ((), ("manifest.json",), ("train-00000.json",)):
            for name in lost:
                (folder / name).unlink()
            kind, other = ("bodies", "garments") if folder is whole else ("garments", "bodies")
            reader = "BodyDataset" if folder is whole else "GarmentDataset"
            with pytest.raises(ShardError, match=f"holds {kind}, not {other}: read them with {reader}"):
                ShardReader(folder, layout=GARMENTS if folder is whole else BODIES)


def test_garments_and_bodies_share_a_folder_as_two_splits(tmp_path: Path) -> None:
    folders.fill(tmp_path, range(2))
    with BodyWriter(tmp_path, MESH, split="wearers", seed=0, recipe=RECIPE) as writer:
        writer.write(0, fake_person(0))
    assert len(ShardReader(tmp_path)) == 2
    assert len(ShardReader(tmp_path, "wearers", layout=BODIES)) == 1


def test_the_mesh_is_read_back(whole: Path, tmp_path: Path) -> None:
    for mesh in (MESH, replace(MESH, parts=None)):
        (tmp_path / "mesh-train.z").write_bytes(mesh_bytes(mesh))
        again = read_set_mesh(tmp_path, "train", mesh.sha256)
        assert np.array_equal(again.faces, mesh.faces)
        assert (again.parts is None) == (mesh.parts is None)
    assert (whole / "mesh-train.z").read_bytes() == mesh_bytes(MESH)
    with pytest.raises(ShardError, match=r"mesh-train\.z: not the mesh of these bodies"):
        read_set_mesh(whole, "train", replace(MESH, faces=MESH.faces[::-1]).sha256)


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


def test_nothing_stays_of_a_stopped_writer(tmp_path: Path) -> None:
    with pytest.raises(KeyboardInterrupt), open_writer(tmp_path) as writer:
        writer.write(0, fake_person(0))
        raise KeyboardInterrupt
    assert contents(tmp_path) == {}
