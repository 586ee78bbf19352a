"""Data sets of an earlier schema are read; data sets of a later schema are refused."""

import io
import json
import tarfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from gcd_dataset.cli import main
from gcd_dataset.errors import ConfigError, ShardError
from gcd_dataset.generator.recipe import recipe_of
from gcd_dataset.hub.publish import stage
from gcd_dataset.loaders import BodyDataset, GarmentDataset, Hdf5Garments
from gcd_dataset.records import Outcome
from gcd_dataset.shards import (
    MEMBERS,
    ShardReader,
    ShardWriter,
    encode_sample,
    read_index,
    read_manifest,
    rebuild_index,
)
from gcd_dataset.shards.body_set import BodyWriter
from gcd_dataset.shards.hdf5 import write_hdf5
from gcd_dataset.shards.meta import sealed
from gcd_dataset.shards.single import write_single
from gcd_dataset.spec import spec_from_pattern
from tests.shards.folders import fill
from tests.shards.people import MESH, RECIPE, fake_person
from tests.shards.real import PATTERNS, first_schema


@pytest.fixture
def first(tmp_path: Path) -> Path:
    return first_schema(tmp_path)


def stored_members(folder: Path) -> list[dict[str, bytes]]:
    """The members of each sample, read with ``tarfile``."""
    samples: dict[str, dict[str, bytes]] = {}
    with tarfile.open(folder / "train-00000.tar") as archive:
        for entry in archive:
            file = archive.extractfile(entry)
            assert file is not None
            key, _, member = entry.name.partition(".")
            samples.setdefault(key, {})[member] = file.read()
    return list(samples.values())


def assert_same(items: list[Any], samples: list[dict[str, bytes]]) -> None:
    assert len(items) == len(samples)
    for item, sample in zip(items, samples, strict=True):
        meta = json.loads(sample["meta.json"])
        assert item["spec"] == json.loads(sample["spec.json"])
        assert item["design"] == json.loads(sample["design.json"])
        assert item["measures"] == json.loads(sample["measures.json"])
        assert {name: item["meta"][name] for name in meta if name != "drape"} | {"drape": meta["drape"]} == meta
        assert (item["meta"]["grade"], item["meta"]["tags"], item["meta"]["strain"]) == ("", [], None)
        for field in ("verts", "panels", "points", "faces", "stitches"):
            array = np.load(io.BytesIO(sample[f"{field}.npy"]))
            if not len(array):  # a field of a later stage
                assert field not in item
                continue
            assert np.array_equal(item[field].numpy(), array.astype(item[field].numpy().dtype))
        assert "points" not in item or str(item["points"].dtype) == "torch.float32"


@pytest.mark.parametrize("name", ["patterns", "drapes"])
@pytest.mark.parametrize("streaming", [False, True])
@pytest.mark.parametrize("alone", [False, True])
def test_schema_1_is_read(first: Path, name: str, streaming: bool, alone: bool) -> None:
    folder = first / name
    if alone:
        (folder / "index-train.npz").unlink()
        (folder / "manifest.json").unlink()
    assert_same(list(GarmentDataset(folder, streaming=streaming)), stored_members(folder))
    field = "points" if name == "drapes" else "panels"
    items = list(GarmentDataset(folder, fields=[field], streaming=streaming))
    assert [set(item) for item in items] == [{field}] * len(items)


def test_schema_1_is_verified_and_indexed(first: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = first / "drapes"
    before = (folder / "index-train.npz").read_bytes()
    assert main(["verify", str(folder), "--full"]) == 0
    assert main(["info", str(folder)]) == 0
    assert "schema 1" in capsys.readouterr().out
    (folder / "index-train.npz").unlink()
    assert main(["index", str(folder)]) == 0
    assert dict(np.load(io.BytesIO(before))).keys() == dict(np.load(folder / "index-train.npz")).keys()
    ds = GarmentDataset(folder)
    ds.verify(0)
    assert ds.recipe(0)["recipe"]["stage"] == "drape"
    content = bytearray((folder / "train-00000.tar").read_bytes())
    content[int(read_index(folder).table.offset[0, MEMBERS.index("verts.npy")]) + 200] ^= 1
    (folder / "train-00000.tar").write_bytes(content)
    with pytest.raises(ShardError, match=r"gcd_000000000, member verts\.npy"):
        GarmentDataset(folder)[0]


def test_a_sample_of_schema_1_is_encoded_in_the_current_schema(first: Path) -> None:
    sample = ShardReader(first / "drapes").sample(0)
    assert sample.drape is not None
    assert sample.drape.outcome is Outcome.SETTLED
    members = encode_sample(sample)
    assert json.loads(members["spec.txt"]) == json.loads(stored_members(first / "drapes")[0]["spec.json"])
    assert members["verts.npy"] == stored_members(first / "drapes")[0]["verts.npy"]


def test_schema_1_is_exported(first: Path, tmp_path: Path) -> None:
    list(write_hdf5(ShardReader(first / "drapes"), tmp_path / "drapes.h5"))
    assert_same(list(Hdf5Garments(tmp_path / "drapes.h5")), stored_members(first / "drapes"))
    Hdf5Garments(tmp_path / "drapes.h5").verify(0)
    assert_same(list(Hdf5Garments(first / "patterns.h5")), stored_members(first / "patterns"))


def test_schema_1_is_published_unchanged(first: Path, tmp_path: Path) -> None:
    stage(
        first / "patterns", "org/garments", tmp_path / "staged", shares={"train": 1.0, "validation": 0.0, "test": 0.0}
    )
    manifest = read_manifest(tmp_path / "staged")
    assert manifest is not None
    assert manifest.schema == 1
    assert_same(list(GarmentDataset(tmp_path / "staged")), stored_members(first / "patterns"))
    assert "`spec.json`" in (tmp_path / "staged" / "README.md").read_text()


@pytest.mark.parametrize("alone", [False, True])
def test_data_sets_of_schema_1_are_not_extended(first: Path, alone: bool) -> None:
    folder = first / "patterns"
    if alone:
        (folder / "index-train.npz").unlink()
        (folder / "manifest.json").unlink()
    before = {path.name: path.read_bytes() for path in folder.iterdir()}
    with pytest.raises(ConfigError, match=r"of schema 1, but gcd_dataset 0\.\S+ writes schema 2: its samples can be"):
        ShardWriter(folder, seed=5, recipe=recipe_of(PATTERNS))
    assert main(["generate", str(folder), "--count", "5", "--seed", "5", "--stage", "pattern", "--quiet"]) == 2
    assert {path.name: path.read_bytes() for path in folder.iterdir()} == before


def test_people_of_schema_1_are_read(first: Path) -> None:
    people = BodyDataset(first / "bodies")
    assert len(people) == 3
    assert np.array_equal(people.person(2).straight, fake_person(2).straight)
    assert people.person(1).measurements.bust == pytest.approx(fake_person(1).measurements.bust)
    assert people.recipe(0)["recipe"]["mesh"] == MESH.sha256
    with pytest.raises(ConfigError, match="of schema 1"):
        BodyWriter(first / "bodies", MESH, seed=0, recipe=RECIPE, shard_size=4)


def test_a_later_schema_is_refused_with_both_versions(tmp_path: Path) -> None:
    folder = fill(tmp_path, range(2))
    arrays = dict(np.load(folder / "index-train.npz"))
    index = (folder / "index-train.npz").read_bytes()
    np.savez(folder / "index-train.npz", **{**arrays, "schema": np.array(3)})
    with pytest.raises(
        ShardError, match=r"index-train\.npz: an index of schema 3, but this reader knows 1 and 2: update"
    ):
        GarmentDataset(folder)
    (folder / "index-train.npz").write_bytes(index)
    members = encode_sample(ShardReader(folder).sample(0))
    meta = {**json.loads(members["meta.json"]), "schema": 3}
    del meta["crc32_before"]
    write_single(folder / "train-00000.tar", 0, {**members, "meta.json": sealed(meta)})
    for name in ("manifest.json", "index-train.npz"):
        (folder / name).unlink()
    for streaming in (False, True):
        with pytest.raises(ShardError, match=r"train-00000\.tar: .*of schema 3, but this reader knows 1 and 2: update"):
            list(GarmentDataset(folder, streaming=streaming))


def test_both_schemas_in_one_split_are_reported(first: Path) -> None:
    folder = fill(first / "new", range(2))
    (first / "patterns" / "train-00000.tar").rename(folder / "train-00001.tar")
    (folder / "index-train.npz").unlink()
    (folder / "manifest.json").unlink()
    with pytest.raises(ShardError, match=r"train-00001\.tar: sample gcd_000000000 .*schema 1"):
        rebuild_index(folder)


def test_specifications_of_schema_1_are_decoded_without_loss(first: Path) -> None:
    reader = ShardReader(first / "patterns")
    for position, sample in enumerate(stored_members(first / "patterns")):
        assert spec_from_pattern(reader.sample(position).pattern) == json.loads(sample["spec.json"])
