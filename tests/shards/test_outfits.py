"""Outfits in shards: garments worn over each other on one body."""

import io
import json
import tarfile
from dataclasses import replace
from pathlib import Path
from typing import Any

import datasets
import numpy as np
import pytest
import torch
import webdataset as wds
from hypothesis import given, settings
from hypothesis import strategies as st

from gcd_dataset import decode, export
from gcd_dataset.errors import ConfigError, ShardError
from gcd_dataset.exports.published import export_published
from gcd_dataset.generator.recipe import MakeConfig
from gcd_dataset.hub.publish import stage
from gcd_dataset.loaders import GarmentDataset
from gcd_dataset.loaders.fake import fake_sample
from gcd_dataset.loaders.hdf5 import Hdf5Garments
from gcd_dataset.making.garments import encoded
from gcd_dataset.records import Layer, Outcome, WornGarment
from gcd_dataset.shards import FIELDS, ShardReader, decode_fields, decode_sample, encode_sample
from gcd_dataset.shards.hdf5 import write_hdf5
from gcd_dataset.shards.layout import garments_layout, of_garment
from gcd_dataset.shards.meta import sealed
from tests.loaders.test_shards import assert_all_same
from tests.shards import stranger
from tests.shards.folders import fake_outfit, fill_outfits, write_samples
from tests.shards.test_codec import form
from tests.shards.test_integrity import resealed
from tests.shards.test_reader import flip_member

COUNTS = (1, 2, 3, 2)
LACKING = {"drape": (), "mesh": ("drape", "front", "back"), "pattern": ("box_mesh", "drape", "front", "back")}
"""Stage to what its samples lack."""


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return fill_outfits(tmp_path_factory.mktemp("outfits"), COUNTS)


@settings(max_examples=20, deadline=None)
@given(
    index=st.integers(0, 99),
    count=st.integers(1, 4),
    more=st.integers(0, 2),
    stage=st.sampled_from(sorted(LACKING)),
    wrong=st.floats(0.0, 1.0),
)
def test_an_outfit_comes_back_whole(index: int, count: int, more: int, stage: str, wrong: float) -> None:
    sample = fake_outfit(index, count, **dict.fromkeys(LACKING[stage]))
    if sample.outfit is not None:
        layers = tuple(replace(layer, wrong_order=wrong) for layer in sample.outfit.layers)
        sample = replace(sample, outfit=replace(sample.outfit, layers=layers))
    members = encode_sample(sample, garments=count + more)
    assert tuple(members) == garments_layout(garments=count + more, sides=stage == "drape").members
    once = decode_sample(members)
    assert encode_sample(once, garments=count + more) == members
    if count == 1:
        assert once.outfit is None
        return
    assert once.outfit is not None and sample.outfit is not None
    assert once.outfit.layers == sample.outfit.layers
    for read, given_ in zip(once.outfit.garments, sample.outfit.garments, strict=True):
        for entry in ("tucked", "closed", "fabric", "design", "pattern"):
            assert getattr(read, entry) == getattr(given_, entry)
        assert (read.box_mesh is None, read.drape is None) == (given_.box_mesh is None, given_.drape is None)
        if read.drape is not None and given_.drape is not None:
            assert np.abs(read.drape.vertices - given_.drape.vertices).max() < 1e-3


def test_every_sample_of_a_set_has_the_members_and_types_of_its_largest_outfit(folder: Path) -> None:
    reader = ShardReader(folder)
    assert reader.layout.members == garments_layout(garments=3).members
    assert [len(o.garments) if (o := reader.sample(i).outfit) else 1 for i in range(len(reader))] == [*COUNTS]
    metas = [json.loads(bytes(reader.read(i, ["meta.json"])["meta.json"])) for i in range(len(reader))]
    assert [len(meta["outfit"]) for meta in metas] == [*COUNTS]
    for meta in metas:
        del meta["crc32"]
    assert all(form(meta) == form(metas[0]) for meta in metas)


def test_items_hold_each_garment_and_no_rows_of_absent_ones(folder: Path, tmp_path: Path) -> None:
    garments = GarmentDataset(folder, cache_dir=tmp_path)
    for index, count in enumerate(COUNTS):
        outfit = fake_outfit(index, count).outfit
        item = dict[str, Any](garments[index])
        assert item["verts"].shape == (len(fake_sample(0, index).drape.vertices), 3)  # type: ignore[union-attr]
        assert len(item["meta"]["layers"]) == count * (count - 1) // 2
        for number in (1, 2):
            own = of_garment(number, item)
            if number >= count or outfit is None:
                assert {len(value) for value in own.values() if isinstance(value, torch.Tensor)} == {0}
                assert (own["design"], own["spec"]["pattern"]["panels"]) == ({}, {})
                continue
            worn, drape = outfit.garments[number], outfit.garments[number].drape
            assert worn.box_mesh is not None and drape is not None
            assert np.array_equal(own["faces"], worn.box_mesh.faces)
            assert np.allclose(own["verts"], drape.vertices, atol=1e-3)
            assert np.allclose(own["box"], worn.box_mesh.vertices, atol=1e-3)
            assert own["panels"].shape == (2, 14)
            entry = item["meta"]["outfit"][number]
            assert (entry["tucked"], entry["closed"], entry["fabric"]["name"]) == (False, number != 1, "denim")
    chosen = GarmentDataset(folder, fields=["g2_box", "verts"], cache_dir=tmp_path)
    columns = chosen.__getitems__(range(len(COUNTS)))  # from mapped columns
    assert_all_same(columns, list(chosen))
    assert [len(item["g2_box"]) > 0 for item in columns] == [count > 2 for count in COUNTS]


def test_readers_of_single_garments_go_on(folder: Path, tmp_path: Path) -> None:
    """With fields of the first garment, a set of outfits is a set of single garments."""
    single: list[dict[str, Any]] = [*map(dict, GarmentDataset(folder, fields=FIELDS, cache_dir=tmp_path))]
    for index in range(len(COUNTS)):
        expected = decode_fields(encode_sample(fake_sample(0, index)), ["verts", "faces", "panels", "box", "spec"])
        for name, value in expected.items():
            found = single[index][name]
            assert found == value if name == "spec" else np.allclose(found, value), name
    [(_, members), *_] = stranger.samples(str(folder / "train-00000.tar"))
    theirs = stranger.arrays({name: data for name, data in members.items() if not name.startswith("g")})
    assert theirs.keys() == {field for field, member in FIELDS.items() if member.endswith(".z")}


@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")  # webdataset leaves files open
def test_webdataset_and_datasets_read_all_garments(folder: Path, tmp_path: Path) -> None:
    tar, ours = str(folder / "train-00000.tar"), ShardReader(folder)
    names = {name for name in garments_layout(garments=3).members if not name.endswith(".jpg")}
    for index, item in enumerate(wds.WebDataset(tar, shardshuffle=False).map(decode)):
        expected = decode_fields(ours.read(index, names))
        assert item.keys() == expected.keys() | {"__key__"}
        assert all(np.array_equal(item[name], value) for name, value in expected.items() if hasattr(value, "shape"))
    for members in wds.WebDataset(tar, shardshuffle=False).decode(decode):
        assert members["g1.verts.z"].keys() == {"g1_verts"}
    rows = datasets.load_dataset("webdataset", data_files=tar, split="train", streaming=True)
    counts = [len(item["g2_verts"]) > 0 for item in rows.map(decode, remove_columns=rows.column_names)]
    assert counts == [count > 2 for count in COUNTS]


def test_an_hdf5_file_holds_all_garments(folder: Path, tmp_path: Path) -> None:
    list(write_hdf5(ShardReader(folder), tmp_path / "train.h5"))
    one = Hdf5Garments(tmp_path / "train.h5")
    assert_all_same(one, GarmentDataset(folder, cache_dir=tmp_path))
    assert one.sample(2) == GarmentDataset(folder).sample(2)


def test_other_forms_of_a_set_hold_all_garments_or_refuse_them(folder: Path, tmp_path: Path) -> None:
    export(folder, tmp_path / "plain", "plain")
    with tarfile.open(tmp_path / "plain" / "train-00000.tar") as tar:
        [third] = [tar.extractfile(name).read() for name in tar.getnames() if name == "gcd_000000002.g2_verts.npy"]  # type: ignore[union-attr]
    expected = GarmentDataset(folder, fields=["g2_verts"])[2]["g2_verts"]  # type: ignore[typeddict-item]
    assert np.array_equal(np.load(io.BytesIO(third)), expected)
    with pytest.raises(ConfigError, match="the layout of GarmentCodeData has no outfits: give --plain"):
        list(export_published({"train": ShardReader(folder)}, tmp_path / "published"))
    made = stage(folder, "org/outfits", tmp_path / "up", license="CC-BY-4.0")
    card = (made.folder / "README.md").read_text()
    assert "| g2_verts | `g2.verts.z` | of garment 2 of an outfit: vertex positions at rest on the body [cm] |" in card


def test_an_outfit_is_settled_if_all_its_garments_are(tmp_path: Path) -> None:
    """Also in a data set being made: an outfit with a failed drape goes to the failed ones."""
    sample = fake_outfit(0, 2)
    assert sample.outfit is not None and sample.outfit.garments[1].drape is not None
    inner, outer = sample.outfit.garments
    slid = replace(outer, drape=replace(sample.outfit.garments[1].drape, outcome=Outcome.SLID_OFF))
    loose = replace(sample, outfit=replace(sample.outfit, garments=(inner, slid)))
    for made, settled in ((sample, True), (loose, False)):
        folder = write_samples(tmp_path / str(settled), [made], layout=garments_layout(garments=2))
        assert ShardReader(folder).index.settled.tolist() == [settled]
        assert encoded(MakeConfig(), False, made).failed is not settled


def test_a_damaged_member_of_a_further_garment_is_named(tmp_path: Path) -> None:
    fill_outfits(tmp_path / "set", (2,) * 6)
    flip_member(tmp_path / "set", 5, "g1.mesh.z")
    with pytest.raises(ShardError, match=r"train-00001.tar: sample gcd_000000005, member g1\.mesh\.z: bytes differ"):
        ShardReader(tmp_path / "set").sample(5)
    members = encode_sample(fake_outfit(0, 2))
    for field, member in (("g1_verts", "g1.verts.z"), ("g1_spec", "g1.spec.txt"), ("g1_box", "g1.pattern.z")):
        with pytest.raises(ShardError, match=f"^member {member}: "):
            decode_fields(members | {member: b"{"}, [field])
    with pytest.raises(ShardError, match="its members contradict each other"):
        decode_sample({name: data for name, data in members.items() if not name.startswith("g1.")})


def test_errors_about_strange_outfits_are_one_line() -> None:
    members = encode_sample(fake_outfit(0, 2))
    meta = json.loads(members["meta.json"])
    first, layer = meta["outfit"][0], meta["layers"][0]
    for entries, message in (
        ({"outfit": []}, "outfit is "),
        ({"outfit": [{}]}, "outfit is "),
        ({"outfit": [first | {"tucked": 1}]}, "outfit is "),
        ({"layers": 3}, "layers is 3"),
        ({"layers": [layer | {"wrong_order": "x"}]}, "layers is "),
        ({"outfit": None}, "outfit is "),
    ):
        with pytest.raises(ShardError, match=rf"^member meta\.json: {message}"):
            decode_sample(resealed(members, **entries))
    for name in ("outfit", "layers"):
        bare = {key: value for key, value in meta.items() if key not in (name, "crc32_before")}
        with pytest.raises(ShardError, match=rf"^member meta\.json: {name} is missing"):
            decode_sample({**members, "meta.json": sealed(bare)})
    with pytest.raises(ShardError, match="gcd_000000000: its members contradict each other"):
        decode_sample(resealed(members, outfit=3 * [first]))


def test_outfits_that_the_format_cannot_hold_are_refused() -> None:
    sample, other = fake_outfit(0, 2), fake_outfit(1, 2)
    assert sample.outfit is not None and other.outfit is not None
    first: WornGarment = sample.outfit.garments[0]
    for outfit, message in (
        (other.outfit, "the first garment of its outfit differs"),
        (replace(sample.outfit, garments=(first,)), "an outfit of 1 garments: give 2 to 8"),
        (replace(sample.outfit, layers=(Layer(0, 2, 0, 0, 0.0),)), "garment 2 over 0, in an outfit of 2"),
    ):
        with pytest.raises(ShardError, match=f"sample gcd_000000000 cannot be stored: {message}"):
            encode_sample(replace(sample, outfit=outfit))
