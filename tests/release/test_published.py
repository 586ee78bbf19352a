"""``PublishedGarmentCodeData``: items equal those of shards; damaged or foreign files are reported by name."""

import json
import pickle
import re
import shutil
import struct
import zlib
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
import yaml

from gcd_dataset.errors import ConfigError, ShardError
from gcd_dataset.loaders import GarmentDataset, PublishedGarmentCodeData
from gcd_dataset.records import MEASURES
from gcd_dataset.release.batches import Facts
from gcd_dataset.release.published_names import ENDINGS, properties_name
from gcd_dataset.release.read_garment import PublishedGarment
from gcd_dataset.release.write import garment_files
from tests.loaders.test_shards import same
from tests.release.published import BATCH, BODIES, TEST, TRAIN, file_of, garment, pack, split_lists


def numbers(published: PublishedGarmentCodeData) -> list[int]:
    return [published.number(index) for index in range(len(published))]


def test_items_equal_those_of_the_exported_shards(folders: Path) -> None:
    ours: Any = GarmentDataset(folders.parent / "shards")
    published: Any = PublishedGarmentCodeData(folders)
    assert len(ours) == len(published) == 4
    for before, after in zip(ours, published, strict=True):
        assert before.keys() == after.keys()
        for field in ("faces", "panel_id", "labels", "seams", "verts", "stitches"):
            assert same(before[field], after[field]), field
        for field in ("uv", "uv_vertex"):  # corners are renumbered; the faces they form are the same
            flat, there = (item[field][item["corners"]] for item in (before, after))
            assert torch.allclose(flat, there, atol=1e-3) and flat.dtype == there.dtype
        for field, most in (("box", 1e-3), ("panels", 1e-9), ("edges", 1e-9)):  # cm
            assert torch.allclose(before[field], after[field], atol=most)
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


def test_archives_and_folders_give_the_same_items(folders: Path, own: Path) -> None:
    packed = pack(own)
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
    path = own / BATCH / BODIES[1] / properties_name(BODIES[1])
    tree = yaml.safe_load(path.read_text())
    tree["sim"]["stats"]["fails"]["static_equilibrium"].append(TRAIN[0])
    # The authors' tools write NumPy scalars with such tags.
    path.write_text(yaml.safe_dump(tree) + "odd: !!python/object/apply:numpy.core.multiarray.scalar [a, b]\n")
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
    sample = garment(TRAIN[0], 0, BODIES[0])
    files = {kind: file_of(folders, TRAIN[0], kind).read_bytes() for kind in ENDINGS}
    assert sample.drape is not None and sample.box_mesh is not None
    vertices = np.array(sample.drape.vertices)
    before = (np.rint(vertices[-1].astype(np.float32) * 512) / 512).astype("<f4").tobytes()  # as shards store it
    vertices[-1] = vertices[-2]
    assert files["sim"].partition(b"end_header\n")[2].count(before) == 1
    files["sim"] = files["sim"].replace(before, vertices[-1].astype("<f4").tobytes())
    opened = PublishedGarment(TRAIN[0], "there", lambda kinds: {k: files[k] for k in kinds}, Facts(), True)
    assert np.abs(opened.vertices - vertices).max() < 1e-3
    assert np.array_equal(opened.faces, sample.box_mesh.faces)


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


def with_nan(content: bytes) -> bytes:
    head, end, rows = content.partition(b"end_header\n")
    return head + end + struct.pack("<f", np.nan) + rows[4:]


def of_many_pixels(content: bytes) -> bytes:
    header = b"IHDR" + struct.pack(">IIBBBBB", 60_000, 60_000, 8, 6, 0, 0, 0)
    return content[:8] + struct.pack(">I", 13) + header + struct.pack(">I", zlib.crc32(header)) + content[33:]


def doubling(name: str, times: int) -> bytes:
    """A small YAML file with aliases that expand to 2**times values."""
    lines = [f"l{i + 1}: &l{i + 1} [*l{i}, *l{i}]" for i in range(times)]
    return "\n".join(["l0: &l0 [1]", *lines, f"{name}: {{a: *l{times}}}"]).encode()


FAULTS: tuple[tuple[str, Callable[[bytes], bytes], str], ...] = (
    ("spec", swapped(b'"edges"', b'"seams"'), "panel front: edges must be a list"),
    ("sim", lambda content: content[:-1], "_sim.ply: .* bytes for .* vertices"),
    ("segmentation", lambda content: content + b"front\n", "_sim_segmentation.txt: labels"),
    ("segmentation", swapped(b"front", b"sleeve"), "names sleeve, which is not a panel"),
    ("segmentation", swapped(b"stitch_1", b"stitch_7"), "names a stitch outside the 2"),
    ("vertex_labels", swapped(b"lower_interface", b"hem"), "_vertex_labels.yaml: hem is on no edge"),
    ("vertex_labels", swapped(b"- ", b"- -"), "lower_interface is not a list of vertices of the mesh"),
    ("measures", swapped(b"height", b"length"), "_body_measurements.yaml: body lacks height"),
    ("box", swapped(b"element vertex ", b"element "), "not a binary PLY"),
    ("sim", lambda content: b"", "not a binary PLY"),
    ("sim", with_nan, "a position coordinate that is over 1e\\+06, or NaN"),
    ("front", lambda content: content[:33] + b"\0\0\0\0\xc3D\rD" + content[33:], "not a picture"),
    ("front", of_many_pixels, "not a picture"),
    ("spec", lambda content: b"[" * 100_000, "Expecting value|levels deep|recursion"),
    ("spec", lambda content: content.replace(b"100", b"1" * 5000, 1), "digits|is not a number"),
    ("spec", lambda content: re.sub(rb'"edge": \d+', b'"edge": 77', content, count=1), "seam 0 joins .*, edge 77"),
    (
        "spec",
        lambda content: re.sub(rb'"endpoints": \[\s*\d+', b'"endpoints": [99', content, count=1),
        "no vertex 99 or",
    ),
    ("design", lambda content: doubling("design", 60), "more than 64 levels deep, or 300000 values"),
    ("design", lambda content: b"design: {a: " + b"[" * 100 + b"]" * 100 + b"}", "more than 64 levels"),
    ("measures", lambda content: b"body: {height: " + b"9" * 5000 + b"}", "not YAML|height is"),
    ("vertex_labels", lambda content: b"a: [99999999]", "is not a list of vertices of the mesh"),
    ("segmentation", lambda content: b"stitch_" + b"9" * 5000 + b"\n" + content, "labels"),
    ("segmentation", lambda content: content.replace(b"stitch_0", b"stitch_" + b"9" * 5000), "names a stitch"),
)


@pytest.mark.parametrize(("kind", "spoil", "message"), FAULTS, ids=[f"{kind}: {text}" for kind, _, text in FAULTS])
def test_a_broken_file_is_named_with_a_remedy(
    own: Path, kind: str, spoil: Callable[[bytes], bytes], message: str
) -> None:
    path = file_of(own, TRAIN[0], kind)
    path.write_bytes(spoil(path.read_bytes()))
    with pytest.raises(ShardError, match=message) as caught:
        PublishedGarmentCodeData(own)[0]
    assert str(caught.value).startswith(f"{path}: ") and str(caught.value).endswith(": extract or download it again")
    assert "\n" not in str(caught.value)


def test_an_invalid_body_entry_is_reported(own: Path) -> None:
    path = file_of(own, TRAIN[0], "measures", BODIES[1])
    path.write_bytes(b"body: text")
    with pytest.raises(ShardError, match="body_sample is missing") as caught:
        PublishedGarmentCodeData(own, bodies="random", fields=["meta"])[0]
    assert str(caught.value).startswith(f"{path}: ")


@pytest.mark.parametrize("kept", [b"[" * 100_000, b'{"stamp": STAMP, "fails": ["rand_AAAAAAAAA0"], "facts": {}}'])
def test_invalid_cached_properties_are_made_again(own: Path, kept: bytes) -> None:
    PublishedGarmentCodeData(own)[0]
    (path,) = (own / BATCH / BODIES[0]).glob(".*.gcd.json")
    stamp = re.search(rb"\[[\d, ]+\]", path.read_bytes())
    assert stamp is not None
    path.write_bytes(kept.replace(b"STAMP", stamp[0]))
    assert PublishedGarmentCodeData(own, bodies="default").names[0].endswith(TRAIN[0])


def test_invalid_properties_are_reported(own: Path) -> None:
    path = own / BATCH / BODIES[0] / properties_name(BODIES[0])
    for content in (
        b"[" * 3000,
        b"sim: {stats: {fails: 3}}",
        b"sim: {stats: {fails: {}, fin_frame: {a: x}}}",
        b"\xff",
        b"",
    ):
        path.write_bytes(content)
        with pytest.raises(ShardError, match="not the properties of a batch") as caught:
            PublishedGarmentCodeData(own)[0]
        assert str(caught.value).startswith(f"{path}: ")


@pytest.mark.parametrize("kind", sorted(set(ENDINGS) - {"svg", "drawing", "rest_lengths", "texture"}))
def test_a_missing_file_is_named(own: Path, kind: str) -> None:
    path = file_of(own, TRAIN[0], kind)
    path.unlink()
    with pytest.raises(ShardError, match=f"^{path}: missing: extract or download it again$"):
        PublishedGarmentCodeData(own)[0]


def test_a_garment_of_the_split_without_files_is_logged(own: Path, caplog: pytest.LogCaptureFixture) -> None:
    shutil.rmtree(file_of(own, TRAIN[0], "spec").parent)
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
    for options, message in (
        ({"fields": ("vertices",)}, "no field vertices"),
        ({"split": "trian"}, r"split='trian': choose from .*: did you mean train\?"),
        ({"bodies": "defualt"}, r"bodies='defualt': choose from .*: did you mean default\?"),
    ):
        with pytest.raises(ConfigError, match=message):
            PublishedGarmentCodeData(folders, **options)
    with pytest.raises(ShardError, match="no folder such as garments_5000_0/default_body"):
        PublishedGarmentCodeData(tmp_path)
    for path, found in ((next(folders.glob("*.json")), "a file"), (tmp_path / "nothing", "no such folder")):
        with pytest.raises(ShardError, match=f"{found}: give the folder that holds garments_5000_0"):
            PublishedGarmentCodeData(path)


def test_opening_a_published_folder_as_shards_names_the_right_class(folders: Path) -> None:
    for folder in (folders.parent, folders, folders / BATCH, folders / BATCH / BODIES[0]):
        with pytest.raises(ShardError, match="PublishedGarmentCodeData, or make shards of it with gcd convert"):
            GarmentDataset(folder)


def test_a_broken_split_file_is_named_and_a_folder_without_is_read_whole(own: Path) -> None:
    (path,) = own.glob("*split*.json")
    path.write_text('{"training": ["rand_AAAAAAAAA0"]}')
    with pytest.raises(ShardError, match="lacks a list named training"):
        PublishedGarmentCodeData(own)
    path.unlink()
    with pytest.raises(ShardError, match=r"no official split .*: download it into this folder; split='all' does not"):
        PublishedGarmentCodeData(own)
    assert len(PublishedGarmentCodeData(own, "all")) == 6


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
