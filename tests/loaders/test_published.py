"""``PublishedGarmentCodeData``: items equal those of shards; faults of files."""

import json
import pickle
import shutil
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from gcd_dataset.errors import ConfigError, PatternError, ShardError
from gcd_dataset.loaders import GarmentDataset, PublishedGarmentCodeData
from gcd_dataset.records import MEASURES
from gcd_dataset.release.batches import Facts
from gcd_dataset.release.published_names import ENDINGS, properties_name
from gcd_dataset.release.read_garment import PublishedGarment
from gcd_dataset.release.write import garment_files
from tests.loaders.test_shards import same
from tests.release.published import (
    BATCH,
    BODIES,
    TEST,
    TRAIN,
    fail,
    file_of,
    garment,
    pack,
    publish,
    remove,
    split_lists,
    touch_vertex,
)

EXACT = ("faces", "panel_id", "labels", "seams", "uv_vertex", "corners", "verts", "stitches")
NEAR = {"uv": 1e-3, "panels": 1e-9, "edges": 1e-9}  # cm


@pytest.fixture(scope="module")
def folders(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return publish(tmp_path_factory.mktemp("folders"))


@pytest.fixture
def own(folders: Path, tmp_path: Path) -> Path:
    """A copy that the test may damage."""
    return Path(shutil.copytree(folders, tmp_path / "own"))


@pytest.fixture(scope="module")
def packed(folders: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return pack(Path(shutil.copytree(folders, tmp_path_factory.mktemp("packed") / "root")))


def numbers(published: PublishedGarmentCodeData) -> list[int]:
    return [published.number(index) for index in range(len(published))]


def test_items_equal_those_of_the_exported_shards(folders: Path) -> None:
    ours: Any = GarmentDataset(folders.parent / "shards")
    published: Any = PublishedGarmentCodeData(folders)
    assert len(ours) == len(published) == 4
    for before, after in zip(ours, published, strict=True):
        assert before.keys() == after.keys()
        for field in EXACT:
            assert before[field].dtype == after[field].dtype
            # Corners are renumbered; the faces they form are the same.
            same = before["uv_vertex"][before["corners"]] if field == "corners" else before[field]
            there = after["uv_vertex"][after["corners"]] if field == "corners" else after[field]
            if field != "uv_vertex":
                assert torch.equal(same, there), field
        assert torch.allclose(before["box"], after["box"], atol=1e-3)
        flat, there = (item["uv"][item["corners"]] for item in (before, after))
        assert torch.allclose(flat, there, atol=NEAR["uv"])
        for field in ("panels", "edges"):
            assert torch.allclose(before[field], after[field], atol=NEAR[field])
        assert before["measures"] == pytest.approx({key: after["measures"][key] for key in MEASURES}, rel=1e-12)
        # GarmentCode's derived measures are kept too: floor to hip line.
        measures = after["measures"]
        legs = measures["height"] - measures["head_l"] - measures["waist_line"] - measures["hips_line"]
        assert measures["_leg_length"] == pytest.approx(legs)
        assert before["design"] == after["design"]
        for name in ("body", "pattern", "source", "panel_names", "vertex_labels"):
            assert before["meta"][name] == after["meta"][name]
        assert before["meta"]["gathers"] == pytest.approx(after["meta"]["gathers"], abs=2e-4)
        assert len(after["meta"]["gathers"]) == len(after["stitches"])


def test_archives_and_folders_give_the_same_items(folders: Path, packed: Path) -> None:
    for split in ("train", "test"):
        extracted, archived = PublishedGarmentCodeData(folders, split), PublishedGarmentCodeData(packed, split)
        assert extracted.names == archived.names
        for item, other in zip(extracted, archived, strict=True):
            assert same(item, other)


def test_the_two_garments_of_a_design_are_adjacent(folders: Path) -> None:
    both = PublishedGarmentCodeData(folders)
    assert both.names == tuple(f"{BATCH}/{body}/{name}" for name in TRAIN for body in BODIES)
    assert numbers(both) == [0, 1, 2, 3]
    on_random = PublishedGarmentCodeData(folders, "training", bodies="random")
    assert (on_random.names, numbers(on_random)) == (both.names[1::2], [1, 3])
    assert both.name(-1) == both.names[3]
    assert same(on_random[0], both[1])
    assert both[1]["meta"]["body"] == "00000_straight"
    assert both[0]["meta"]["body"] == "mean_all"
    assert both[0]["meta"]["drape"]["body_through"] == -1  # the release does not count it
    assert PublishedGarmentCodeData(folders, "all").names == tuple(
        f"{BATCH}/{body}/{name}" for name in (*TRAIN, *TEST) for body in BODIES
    )
    assert len(PublishedGarmentCodeData(folders.parent, "test")) == 2  # the folder above


def test_failed_garments_are_left_out(own: Path) -> None:
    fail(own, TRAIN[0], BODIES[1])
    published = PublishedGarmentCodeData(own)
    assert published.names == (
        f"{BATCH}/{BODIES[0]}/{TRAIN[0]}", f"{BATCH}/{BODIES[0]}/{TRAIN[1]}", f"{BATCH}/{BODIES[1]}/{TRAIN[1]}"
    )  # fmt: skip
    assert numbers(published) == [0, 2, 3]


def test_without_properties_no_garment_counts_as_failed(own: Path, caplog: pytest.LogCaptureFixture) -> None:
    (own / BATCH / BODIES[1] / properties_name(BODIES[1])).unlink()
    published = PublishedGarmentCodeData(own, bodies="random", fields=("meta",))
    assert "failed garments are not left out" in caplog.text
    assert published[0]["meta"]["drape"]["frames"] == -1


def test_version_1_has_no_folder_named_data(own: Path, folders: Path) -> None:
    for data in own.glob("*/*/data"):
        for folder in data.iterdir():
            folder.rename(data.parent / folder.name)
        data.rmdir()
    (own / BATCH / BODIES[0] / "renders").mkdir()
    assert same(PublishedGarmentCodeData(own)[0], PublishedGarmentCodeData(folders)[0])


def test_only_the_files_of_the_fields_are_read(own: Path, folders: Path) -> None:
    kept = {"verts": ("sim", "segmentation"), "panels": ("spec",), "measures": ("measures",), "front": ("front",)}
    for field, kinds in kept.items():
        for kind in ENDINGS:
            path = file_of(own, TRAIN[0], kind)
            path.unlink(missing_ok=True)
            if kind in kinds:
                path.write_bytes(file_of(folders, TRAIN[0], kind).read_bytes())
        item = PublishedGarmentCodeData(own, fields=field)[0]
        assert same(item, PublishedGarmentCodeData(folders, fields=field)[0])


def test_vertices_that_touch_in_the_drape_stay_distinct(folders: Path) -> None:
    """Two vertices at one position stay distinct if their box mesh positions differ."""
    sample = touch_vertex(garment(TRAIN[0], 0, BODIES[0]))
    files = {kind: file_of(folders, TRAIN[0], kind).read_bytes() for kind in ENDINGS}
    assert sample.drape is not None
    rows = np.frombuffer(files["sim"].partition(b"end_header\n")[2], np.uint8)
    place = np.asarray(sample.drape.vertices[-1], "<f4").tobytes()
    last = np.asarray(garment(TRAIN[0], 0, BODIES[0]).drape.vertices[-1], np.float32)  # type: ignore[union-attr]
    before = (np.rint(last * 512) / 512).astype("<f4").tobytes()  # as shards store it
    assert rows.tobytes().count(before) == 1
    files["sim"] = files["sim"].replace(before, place)
    opened = PublishedGarment(TRAIN[0], "there", lambda kinds: {k: files[k] for k in kinds}, Facts(), True)
    assert np.abs(opened.vertices - sample.drape.vertices).max() < 1e-3
    assert np.array_equal(opened.faces, sample.box_mesh.faces)  # type: ignore[union-attr]


def test_verify_finds_files_that_disagree(own: Path) -> None:
    published = PublishedGarmentCodeData(own, fields=())
    published.verify(0)
    file_of(own, TRAIN[0], "box").write_bytes(file_of(own, TRAIN[1], "box").read_bytes())
    with pytest.raises(ShardError, match=r"_boxmesh\.ply: its mesh differs from"):
        published.verify(0)
    assert published.recipe(1)["index"] == 1


def swapped(old: bytes, new: bytes) -> Callable[[bytes], bytes]:
    def swap(content: bytes) -> bytes:
        assert old in content
        return content.replace(old, new)

    return swap


FAULTS: tuple[tuple[str, Callable[[bytes], bytes], str], ...] = (
    ("spec", swapped(b'"edges"', b'"seams"'), "panel front: edges must be a list"),
    ("sim", lambda content: content[:-1], "_sim.ply: .* bytes for .* vertices"),
    ("segmentation", lambda content: content + b"front\n", "_sim_segmentation.txt: labels"),
    ("segmentation", swapped(b"front", b"sleeve"), "names sleeve, which is not a panel"),
    ("segmentation", swapped(b"stitch_1", b"stitch_7"), "names a stitch outside the 2"),
    ("vertex_labels", swapped(b"lower_interface", b"hem"), "_vertex_labels.yaml: hem is on no edge"),
    ("vertex_labels", swapped(b"- ", b"- -"), "lower_interface is not a list of vertices of the mesh"),
    ("measures", swapped(b"height", b"length"), "_body_measurements.yaml: body lacks height"),
)


@pytest.mark.parametrize(("kind", "spoil", "message"), FAULTS, ids=[f"{kind}: {text}" for kind, _, text in FAULTS])
def test_a_broken_file_is_named_with_a_remedy(
    own: Path, kind: str, spoil: Callable[[bytes], bytes], message: str
) -> None:
    path = file_of(own, TRAIN[0], kind)
    path.write_bytes(spoil(path.read_bytes()))
    with pytest.raises(ShardError, match=message) as caught:
        PublishedGarmentCodeData(own)[0]
    assert str(path) in str(caught.value)
    assert str(caught.value).endswith(": extract or download it again")


def test_an_edge_without_its_corner_is_named(own: Path) -> None:
    path = file_of(own, TRAIN[0], "spec")
    content = json.loads(path.read_bytes())
    content["pattern"]["panels"]["front"]["edges"][2]["endpoints"][1] = 99
    path.write_text(json.dumps(content))
    with pytest.raises(PatternError, match="front, edge 2: no vertex 2 or 99"):
        PublishedGarmentCodeData(own, fields=["meta"])[0]


@pytest.mark.parametrize("kind", sorted(set(ENDINGS) - {"svg", "drawing", "rest_lengths", "texture"}))
def test_a_missing_file_is_named(own: Path, kind: str) -> None:
    path = file_of(own, TRAIN[0], kind)
    path.unlink()
    with pytest.raises(ShardError, match=f"^{path}: missing: extract or download it again$"):
        PublishedGarmentCodeData(own)[0]


def test_a_garment_of_the_split_without_files_is_logged(own: Path, caplog: pytest.LogCaptureFixture) -> None:
    remove(file_of(own, TRAIN[0], "spec").parent)
    assert numbers(PublishedGarmentCodeData(own)) == [1, 2, 3]
    assert "1 garments of the split are neither on disk nor listed as failed" in caplog.text


def test_missing_batches_are_skipped(own: Path) -> None:
    lists = split_lists(own)
    lists["training"].insert(0, "garments_5000_1/default_body/rand_BBBBBBBBBB")
    lists["validation"] = ["garments_5000_1/default_body/rand_BBBBBBBBBC"]
    (path,) = own.glob("*split*.json")
    path.write_text(json.dumps(lists))
    assert numbers(PublishedGarmentCodeData(own)) == [2, 3, 4, 5]
    with pytest.raises(ShardError, match="no garment of split validation"):
        PublishedGarmentCodeData(own, "validation")


def test_invalid_arguments_are_refused_with_the_choices(folders: Path, tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="no field vertices"):
        PublishedGarmentCodeData(folders, fields=("vertices",))
    with pytest.raises(ShardError, match="no folder such as garments_5000_0/default_body"):
        PublishedGarmentCodeData(tmp_path)
    for path, found in ((next(folders.glob("*.json")), "a file"), (tmp_path / "nothing", "no such folder")):
        with pytest.raises(ShardError, match=f"{found}: give the folder that holds garments_5000_0"):
            PublishedGarmentCodeData(path)


def test_opening_a_published_folder_as_shards_names_the_right_class(folders: Path) -> None:
    for folder in (folders.parent, folders, folders / BATCH, folders / BATCH / BODIES[0]):
        with pytest.raises(ShardError, match="PublishedGarmentCodeData, or make shards of it with gcd convert"):
            GarmentDataset(folder)


def test_a_folder_without_the_split_file_is_read_whole(own: Path) -> None:
    next(own.glob("*split*.json")).unlink()
    with pytest.raises(
        ShardError, match=r"no official split .*: download it into this folder; split='all' does not need it"
    ):
        PublishedGarmentCodeData(own)
    assert len(PublishedGarmentCodeData(own, "all")) == 6


def test_a_broken_split_file_is_named(own: Path) -> None:
    next(own.glob("*split*.json")).write_text('{"training": ["rand_AAAAAAAAA0"]}')
    with pytest.raises(ShardError, match="lacks a list named training"):
        PublishedGarmentCodeData(own)


def test_garments_of_the_reference_system_are_read_as_expected(examples: Path, tmp_path: Path) -> None:
    expected = json.loads((examples / "published" / "expected.json").read_text())["samples"]
    for root in ("GarmentCodeData_v2", "GarmentCodeData_v2_unpacked"):
        published = PublishedGarmentCodeData(examples / "published" / root, "all", cache_dir=tmp_path)
        assert len(published) == 4
        for place, item in zip(published.names, published, strict=True):
            _, body, name = place.split("/")
            check_garment(item, expected[name][body])


def check_garment(item: Mapping[str, Any], facts: Mapping[str, Any]) -> None:
    meta = item["meta"]
    assert len(item["verts"]) == len(item["box"]) == facts["canonical_vertices"]
    assert len(item["uv"]) == facts["ply_vertices"]
    assert len(item["faces"]) == facts["faces"]
    assert sorted(meta["panel_names"]) == sorted(facts["panels"])
    assert len(item["stitches"]) == facts["n_stitches"]
    assert len(item["seams"][:, 0].unique()) == facts["seam_vertices"]
    assert len(item["seams"]) == facts["seam_vertices"] + facts["multi_seam_vertices"]
    for label, known in facts["labels"].items():
        ids = item["labels"][item["labels"][:, 1] == meta["edge_labels"].index(label), 0]
        assert len(ids) == known["count"]
        assert [int(ids.min()), int(ids.max())] == known["id_range"]
    for field, box in (("verts", facts["sim_bbox_cm"]), ("box", facts["boxmesh_bbox_cm"])):
        corners = torch.stack([item[field].min(0).values, item[field].max(0).values])
        assert torch.allclose(corners, torch.tensor(box), atol=1e-3)
    assert meta["body"] == (facts["body_sample"] or "mean_all")
    assert item["front"].shape == (3, 800, 800)


def test_files_of_the_reference_system_survive_a_round_trip(examples: Path, tmp_path: Path) -> None:
    """Exporting a garment of the reference system, draped by another solver, reproduces its files."""
    from gcd_dataset.exports.published import _drawing

    root = examples / "published" / "GarmentCodeData_v2_unpacked"
    published = PublishedGarmentCodeData(root, "all", cache_dir=tmp_path)
    for position, place in enumerate(published.names):
        batch, body, name = place.split("/")
        sample = published.sample(position)
        wearer = None if body == BODIES[0] else sample.provenance.body_name
        ours = garment_files(sample, name, sample.design, _drawing(sample), body_sample=wearer)
        theirs = {path.name: path.read_bytes() for path in (root / batch / body / "data" / name).iterdir()}
        assert ours.keys() == theirs.keys()
        for kind in ("segmentation", "vertex_labels", "design"):
            assert ours[name + ENDINGS[kind]] == theirs[name + ENDINGS[kind]]
        length = {
            key: _pickled_lengths(files[name + ENDINGS["rest_lengths"]])
            for key, files in (("ours", ours), ("theirs", theirs))
        }
        assert length["ours"].keys() == length["theirs"].keys()
        assert length["ours"] == pytest.approx(length["theirs"], abs=1e-4)


def _pickled_lengths(content: bytes) -> dict[tuple[int, int], float]:
    """Edge pair to length. Unpickles only trusted files: made for these tests by the reference system, or by us."""
    return {(int(a), int(b)): float(length) for (a, b), length in pickle.loads(content).items()}
