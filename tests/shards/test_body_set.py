"""Body sets: people are read back unchanged; the bytes do not depend on order and interruptions of writing."""

import random
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from webdataset.autodecode import Decoder
from webdataset.tariterators import group_by_keys, tar_file_expander

from gcd_dataset.errors import ConfigError, ShardError
from gcd_dataset.records import MEASURES
from gcd_dataset.shards import ShardReader, ShardWriter, rebuild_index
from gcd_dataset.shards.body_set import BodyWriter, decode_body_fields, decode_person, encode_person, read_set_mesh
from gcd_dataset.shards.layout import BODIES, mesh_name
from gcd_dataset.shards.manifest import read_manifest
from tests.shards import folders
from tests.shards.folders import contents
from tests.shards.people import MESH, RECIPE, fake_person, fill, open_writer

ORIGIN = {"index": 3, "seed": 0, "recipe": RECIPE, "versions": {"gcd_dataset": "0"}}


@pytest.fixture
def whole(tmp_path: Path) -> Path:
    """Ten people in shards of four, by one writer."""
    return fill(tmp_path / "whole", range(10))


def test_encoding_a_person_is_lossless() -> None:
    person = fake_person(3)
    again = decode_person(encode_person(person, ORIGIN))
    assert replace(again, measurements=person.measurements) == person
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


def test_bytes_do_not_depend_on_the_order_of_writing(whole: Path, tmp_path: Path) -> None:
    indices = list(range(10))
    random.Random(3).shuffle(indices)
    assert contents(fill(tmp_path / "shuffled", indices)) == contents(whole)


@pytest.mark.parametrize("stop", [0, 3, 4, 9])
def test_an_interrupted_run_continues_to_the_same_bytes(whole: Path, tmp_path: Path, stop: int) -> None:
    folder = tmp_path / "interrupted"
    with pytest.raises(KeyboardInterrupt), open_writer(folder) as writer:
        for index in range(stop):
            writer.write(index, fake_person(index))
        raise KeyboardInterrupt
    with open_writer(folder) as writer:
        assert writer.done == frozenset(range(stop))
    assert contents(fill(folder, range(stop, 10))) == contents(whole)


def test_a_part_file_of_a_killed_run_is_recovered(whole: Path, tmp_path: Path) -> None:
    folder = fill(tmp_path / "killed", range(4))
    torn = (whole / "train-00001.tar").read_bytes()
    (folder / "train-00001.tar.part").write_bytes(torn[: len(torn) // 2])
    with open_writer(folder) as writer:
        done = writer.done
    assert {0, 1, 2, 3} < done < set(range(8))
    assert contents(fill(folder, sorted(set(range(10)) - done))) == contents(whole)


def test_deleted_index_and_mesh_are_written_again(whole: Path, tmp_path: Path) -> None:
    for name in ("index-train.npz", mesh_name("train")):
        (whole / name).unlink()
    with open_writer(whole) as writer:
        assert writer.done == frozenset(range(10))
    assert contents(whole) == contents(fill(tmp_path / "again", range(10)))
    rebuild_index(whole, layout=BODIES)
    assert contents(whole) == contents(tmp_path / "again")


def test_webdataset_reads_body_sets(whole: Path) -> None:
    with (whole / "train-00000.tar").open("rb") as stream:
        samples = list(group_by_keys(tar_file_expander([{"url": "shard", "stream": stream}])))
    assert [sample["__key__"] for sample in samples] == [f"gcd_{i:09d}" for i in range(4)]
    for index, sample in enumerate(map(Decoder([]), samples)):
        assert np.array_equal(sample["apart.npy"], fake_person(index).apart)
        assert sample["measures.json"] == fake_person(index).measurements.to_file_values()


def test_the_manifest_lists_the_shards(whole: Path) -> None:
    manifest = read_manifest(whole)
    assert manifest is not None
    split = manifest.splits["train"]
    assert split.kind == "bodies"
    assert split.recipe == {**RECIPE, "mesh": MESH.sha256}
    assert [shard.count for shard in split.shards] == [4, 4, 2]


def test_a_set_is_not_continued_on_another_mesh(whole: Path) -> None:
    turned = replace(MESH, faces=MESH.faces[::-1])
    with pytest.raises(ConfigError, match=f"mesh='{MESH.sha256}', asked for mesh='{turned.sha256}'"):
        open_writer(whole, mesh=turned)
    with pytest.raises(ConfigError, match="seed=0, asked for seed=1"):
        open_writer(whole, seed=1)
    assert read_set_mesh(whole, "train", MESH.sha256) == replace(MESH, faces=MESH.faces.astype(np.int32))


def test_people_on_another_mesh_are_not_stored(tmp_path: Path) -> None:
    person = fake_person(0)
    with (
        open_writer(tmp_path) as writer,
        pytest.raises(ShardError, match="3 vertices in pose apart, but the mesh of this set has 4"),
    ):
        writer.write(0, replace(person, apart=person.apart[:3]))
    assert contents(tmp_path) == contents(fill(tmp_path / "nobody", []))


def test_garments_and_bodies_are_distinguished(whole: Path, tmp_path: Path) -> None:
    with pytest.raises(ShardError, match="an index of bodies, not of garments: read them with BodyDataset"):
        ShardReader(whole)
    with pytest.raises(ShardError, match="an index of bodies"):
        ShardWriter(whole, seed=0, recipe=RECIPE, shard_size=4)
    garments = folders.fill(tmp_path / "garments", range(2))
    with pytest.raises(ShardError, match="an index of garments, not of bodies: read them with GarmentDataset"):
        ShardReader(garments, layout=BODIES)
    for folder in (whole, garments):
        (folder / "index-train.npz").unlink()
    with pytest.raises(ShardError, match=r"does not begin with a meta\.json of a data set of garments"):
        ShardReader(whole)
    with pytest.raises(ShardError, match=r"does not begin with a meta\.json of a data set of bodies"):
        ShardReader(garments, layout=BODIES)


def test_garments_and_bodies_share_a_folder_as_two_splits(tmp_path: Path) -> None:
    folders.fill(tmp_path, range(2))
    with BodyWriter(tmp_path, MESH, split="wearers", seed=0, recipe=RECIPE) as writer:
        writer.write(0, fake_person(0))
    assert len(ShardReader(tmp_path)) == 2
    assert len(ShardReader(tmp_path, "wearers", layout=BODIES)) == 1
