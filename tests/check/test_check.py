"""Each fault is found in a data set that carries just this fault, and a good data set has none."""

import json
import re
import shutil
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from gcd_dataset.check import checks, examine
from gcd_dataset.check.checks import CHECKS, Harm
from gcd_dataset.check.garments import CheckedGarment, garment_faults
from gcd_dataset.check.report import Report
from gcd_dataset.check.sets import SplitCensus
from gcd_dataset.cli import main
from gcd_dataset.generator.body import build_body, measure, neutral_shape
from gcd_dataset.generator.garments import design_from_dict, draw_garment
from gcd_dataset.loaders import GarmentDataset
from gcd_dataset.loaders.fake import fake_sample
from gcd_dataset.making.run import index
from gcd_dataset.records import BodyShape, Closure, Grade, Layer, Outcome, Sample
from gcd_dataset.release.bodies import FOLDER, KINDS
from gcd_dataset.shards import ShardReader, ShardWriter, encode_sample
from gcd_dataset.shards.access import Place
from gcd_dataset.shards.hdf5 import write_hdf5
from gcd_dataset.shards.layout import garments_layout
from gcd_dataset.shards.tar import END, tar_entry
from tests.helpers import flip, parts
from tests.release import published
from tests.shards.folders import fake_outfit
from tests.shards.test_codec import with_maps
from tests.shards.test_integrity import resealed, shard_of

TRAIN, TEST = 30, 10
Samples = list[Sample]


@cache
def good() -> tuple[Sample, ...]:
    """Garments of a train split, then those of a test split."""
    return tuple(fake_sample(0, index) for index in range(TRAIN + TEST))


def written(
    folder: Path, train: Sequence[Sample], test: Sequence[Sample] = (), *, shard_size: int = 100, garments: int = 1
) -> Path:
    options: dict[str, Any] = {"recipe": {"fake": True}, "layout": garments_layout(garments=garments)}
    for split, samples in {"train": train, "test": test}.items():
        if samples:
            with ShardWriter(folder, split=split, seed=0, shard_size=shard_size, **options) as writer:
                for sample in samples:
                    writer.write(sample)
    return folder


def edited(folder: Path, edit: Callable[[Samples, Samples], None]) -> Report:
    train, test = list(good()[:TRAIN]), list(good()[TRAIN:])
    edit(train, test)
    return examine(written(folder, train, test))


def names(report: Report, harm: Harm = Harm.HARMFUL) -> set[str]:
    return {finding.check.name for finding in report.findings if finding.harm is harm}


def test_a_good_data_set_has_no_finding(tmp_path: Path) -> None:
    report = edited(tmp_path, lambda train, test: None)
    assert report.findings == ()
    assert [(split.name, split.count, split.examined) for split in report.splits] == [
        ("train", 30, 30),
        ("test", 10, 10),
    ]
    assert report.splits[0].shares["outcome"] == {"SETTLED": TRAIN}


def test_bytes_of_a_url_of_this_machine_are_checked(tmp_path: Path) -> None:
    folder = written(tmp_path / "set", good())
    assert main(["check", "--bytes", "--quiet", f"file://{folder}"]) == 0


def test_a_broken_specification_stands_in_the_json(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "bad.json").write_text("{")
    assert main(["check", "--json", str(tmp_path / "bad.json")]) == 1
    assert "bad.json" in json.loads(capsys.readouterr().out)[str(tmp_path / "bad.json")][0]


def with_mesh(sample: Sample, **arrays: Any) -> Sample:
    return replace(sample, box_mesh=replace(parts(sample)[0], **arrays))


def with_drape(sample: Sample, **values: Any) -> Sample:
    return replace(sample, drape=replace(parts(sample)[1], **values))


def with_pattern(sample: Sample, **values: Any) -> Sample:
    return replace(sample, pattern=replace(sample.pattern, **values))


def moved(sample: Sample, change: Callable[[np.ndarray], np.ndarray]) -> Sample:
    """The garment with its vertices changed, before sewing and at rest."""
    mesh, drape = parts(sample)
    return with_drape(with_mesh(sample, vertices=change(mesh.vertices)), vertices=change(drape.vertices))


def not_a_number(sample: Sample) -> Sample:
    vertices = np.array(parts(sample)[1].vertices)
    vertices[3, 1] = np.nan
    return with_drape(sample, vertices=vertices)


def in_metres(sample: Sample) -> Sample:
    return uv_in_metres(moved(sample, lambda at: at / 100))


def uv_in_metres(sample: Sample) -> Sample:
    return with_mesh(sample, uv=parts(sample)[0].uv / 100)


def measured_in_metres(sample: Sample) -> Sample:
    return replace(sample, measurements=replace(sample.measurements, height=1.7))


def drawn_in_metres(sample: Sample) -> Sample:
    """The pattern, its placement included."""
    panels = sample.pattern.panels
    places = [replace(panel.placement, translation=panel.placement.translation / 100) for panel in panels]
    smaller = [replace(p, vertices=p.vertices / 100, placement=at) for p, at in zip(panels, places, strict=True)]
    return with_pattern(sample, panels=tuple(smaller))


def lying(sample: Sample) -> Sample:
    """z up, as in Blender."""
    return moved(sample, lambda at: np.stack([at[:, 0], -at[:, 2], at[:, 1] + 60], axis=1))


def turned_round(sample: Sample) -> Sample:
    return moved(sample, lambda at: at * [-1.0, 1.0, -1.0])


def inside_out(sample: Sample) -> Sample:
    mesh, _ = parts(sample)
    return with_mesh(sample, faces=mesh.faces[:, ::-1], corners=mesh.corners[:, ::-1])


def partly_inside_out(sample: Sample) -> Sample:
    faces, corners = (np.array(rows) for rows in (parts(sample)[0].faces, parts(sample)[0].corners))
    faces[::5], corners[::5] = faces[::5, ::-1], corners[::5, ::-1]
    return with_mesh(sample, faces=faces, corners=corners)


def mirrored(sample: Sample) -> Sample:
    return with_mesh(sample, uv=parts(sample)[0].uv * [-1.0, 1.0])


def unsewn(sample: Sample) -> Sample:
    """Each panel has vertices of its own along the seams."""
    mesh, drape = parts(sample)
    vertex = mesh.uv_vertex
    seam_of = dict(mesh.seams.tolist())
    seams = np.array([(row, seam_of[at]) for row, at in enumerate(vertex.tolist()) if at in seam_of])
    labels = {name: np.flatnonzero(np.isin(vertex, ids)) for name, ids in mesh.labels.items()}
    apart = with_mesh(
        sample,
        vertices=mesh.vertices[vertex],
        faces=mesh.corners,
        uv_vertex=np.arange(len(vertex)),
        seams=seams[np.argsort(seams[:, 1], kind="stable")],
        labels=labels,
    )
    return with_drape(apart, vertices=drape.vertices[vertex])


def bow_tie(sample: Sample) -> Sample:
    """The front's upper corners exchanged: its sides cross."""
    front, back = sample.pattern.panels
    tied = with_pattern(sample, panels=(replace(front, vertices=front.vertices[[0, 1, 3, 2]]), back))
    return replace(tied, gathers=tied.pattern.gather_ratios())


def reversed_loop(sample: Sample) -> Sample:
    """The back's loop runs the other way round; its seams name the same edges."""
    front, back = sample.pattern.panels
    edges = tuple(replace(edge, start=edge.end, end=edge.start) for edge in reversed(back.edges))
    number = {old: new for new, old in enumerate(reversed(range(len(edges))))}
    seams = tuple(replace(s, right=replace(s.right, edge=number[s.right.edge])) for s in sample.pattern.seams)
    return with_pattern(sample, panels=(front, replace(back, edges=edges)), seams=seams)


def missing_seam(sample: Sample) -> Sample:
    seams = np.array(parts(sample)[0].seams)
    seams[:, 1] += 5
    return with_mesh(sample, seams=seams)


GARMENT_FAULTS = [
    (not_a_number, "nan", "verts"),
    (in_metres, "units", "vertices in metres"),
    (uv_in_metres, "units", "uv and vertices have different units"),
    (measured_in_metres, "units", "measures in metres"),
    (drawn_in_metres, "units", "pattern of a size unlikely for a person"),
    (lying, "axes", "y is not up: the garment is not above the floor"),
    (turned_round, "axes", "front and back are exchanged"),
    (inside_out, "winding", "normals point into the body"),
    (partly_inside_out, "winding", "both ways within a panel"),
    (mirrored, "mirrored-uv", "all panels"),
    (unsewn, "open-seams", "both edges are on the border of the mesh"),
    (
        lambda sample: replace(sample, gathers=(1.5, 1.0)),
        "seam-lengths",
        "edges of other lengths than meta[gathers] says",
    ),
    (bow_tie, "invalid-patterns", "outline crosses itself"),
    (missing_seam, "references", "seams refers to rows that stitches lacks"),
    (lambda sample: replace(sample, drape=None), "missing-members", "verts"),
    (lambda sample: with_drape(sample, outcome=Outcome.NOT_SETTLED), "failed-drapes", "outcome NOT_SETTLED"),
]


def test_open_seams_of_the_pattern_are_no_fault_of_the_mesh(tmp_path: Path) -> None:
    def opened(train: Samples, test: Samples) -> None:
        seams = tuple(replace(seam, closure=Closure.OPEN) for seam in train[0].pattern.seams)
        train[0] = with_pattern(with_mesh(unsewn(train[0]), seams=np.zeros((0, 2), int)), seams=seams)
        train[1] = with_mesh(unsewn(train[1]), seams=np.zeros((0, 2), int))

    (finding,) = edited(tmp_path, opened).harmful
    assert (finding.check.name, list(finding.examples)) == ("open-seams", ["gcd_000000001"])


def test_each_fault_of_a_garment_is_found_and_no_other(tmp_path: Path) -> None:
    """In a set with one garment of each fault: further findings would raise a count."""

    def one_of_each(train: Samples, test: Samples) -> None:
        for number, (edit, _, _) in enumerate(GARMENT_FAULTS):
            train[number] = edit(train[number])

    report = edited(tmp_path, one_of_each)
    details, keys = dict[str, dict[str, int]](), dict[str, list[str]]()
    for number, (_, name, fault) in enumerate(GARMENT_FAULTS):
        details.setdefault(name, {})[fault] = 1
        keys.setdefault(name, []).append(f"gcd_{number:09d}")
    assert {finding.check.name: dict(finding.details) for finding in report.harmful} == details
    for finding in report.harmful:
        name = finding.check.name
        assert (finding.split, finding.count, finding.total) == ("train", len(keys[name]), TRAIN)
        assert list(finding.examples) == keys[name]


def test_a_loop_that_runs_the_wrong_way_round_is_found(tmp_path: Path) -> None:
    flat = [replace(sample, box_mesh=None, drape=None, points=None) for sample in good()[:TRAIN]]
    report = examine(written(tmp_path, [*map(reversed_loop, flat[:3]), *flat[3:]]))
    assert names(report) == {"reversed-loops"}


def same_design(train: Samples, test: Samples, row: int = 2) -> None:
    test[row] = replace(test[row], design=train[row + 3].design)


def same_body(train: Samples, test: Samples, row: int = 2) -> None:
    test[row] = replace(test[row], shape=train[row + 3].shape)


def same_pattern(train: Samples, test: Samples, row: int = 2) -> None:
    """The garment of a train design, on another body, with its own key."""
    own = ("key", "provenance", "design", "shape", "measurements", "gathers")
    test[row] = replace(train[row + 3], **{name: getattr(test[row], name) for name in own})


def test_splits_that_share_garments_are_found(tmp_path: Path) -> None:
    def shared(train: Samples, test: Samples) -> None:
        for row, edit in enumerate((same_design, same_body, same_pattern)):
            edit(train, test, row)

    report = edited(tmp_path, shared)
    assert {finding.check.name: finding.examples for finding in report.harmful} == {
        "leaked-design": ("gcd_000000030",),
        "leaked-body": ("gcd_000000031",),
        "leaked-pattern": ("gcd_000000032",),
    }
    for finding in report.harmful:
        count = len(finding.examples)
        assert (finding.split, finding.count, finding.details) == ("test", count, {"also in train": count})


def test_a_ruffle_of_eight_metres_is_no_wrong_unit(tmp_path: Path) -> None:
    """Its edges are long, but most edges of the garment, a skirt of five levels, each gathered, are not."""
    levels = {"level_ruffle": 1.7, "num_levels": 5, "base": "PencilSkirt", "level": "Skirt2"}
    design = design_from_dict({"meta": {"bottom": "SkirtLevels"}, "levels-skirt": levels})
    pattern = draw_garment(measure(build_body(neutral_shape())), design)
    assert max(np.ptp(panel.vertices, axis=0).max() for panel in pattern.panels) > 400
    flat = replace(good()[0], pattern=pattern, box_mesh=None, drape=None, points=None, gathers=())
    assert "units" not in names(examine(written(tmp_path, [flat])))


def test_the_neutral_body_may_be_in_every_split(tmp_path: Path) -> None:
    neutral = BodyShape(np.zeros(8))

    def dressed(train: Samples, test: Samples) -> None:
        for samples in (train, test):
            made = replace(samples[0].provenance, body_name="neutral")
            samples[0] = replace(samples[0], shape=neutral, provenance=made)

    assert not names(edited(tmp_path, dressed))


def test_one_kind_for_nearly_all_garments_is_a_warning(tmp_path: Path) -> None:
    report = examine(written(tmp_path, [dressed_in(sample, "Shirt") for sample in good()[:TRAIN]]))
    assert (names(report), names(report, Harm.WARNING)) == (set(), {"skewed"})
    assert report.findings[0].details == {"upper Shirt: 100%": 1}


def test_splits_with_other_shares_are_a_warning(tmp_path: Path) -> None:
    samples = [fake_sample(0, index) for index in range(120)]
    train = [dressed_in(sample, ("Shirt", "FittedShirt")[n % 2]) for n, sample in enumerate(samples[:60])]
    test = [dressed_in(sample, ("Shirt", "FittedShirt")[n % 8 > 0]) for n, sample in enumerate(samples[60:])]
    report = examine(written(tmp_path, train, test))
    assert names(report, Harm.WARNING) >= {"skewed"}
    assert "in train" in next(iter(report.finding("skewed").details))  # type: ignore[union-attr]


def dressed_in(sample: Sample, upper: str) -> Sample:
    return replace(sample, design={**sample.design, "meta": {"upper": {"v": upper}}})


def test_failed_garments_belong_into_the_failed_split(tmp_path: Path) -> None:
    failed = [with_drape(not_a_number(sample), outcome=Outcome.DIVERGED) for sample in good()[:4]]
    with ShardWriter(tmp_path, split="failed", seed=0, recipe={"fake": True}) as writer:
        for sample in failed:
            writer.write(sample)
    assert not names(examine(written(tmp_path, good()[4:TRAIN])))


@pytest.fixture
def shards(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("GCD_CACHE", str(tmp_path / "cache"))  # other tests have columns of equal shards in theirs
    return written(tmp_path / "shards", good()[:TRAIN], shard_size=8)


def test_a_damaged_garment_is_named_and_the_others_are_examined(shards: Path) -> None:
    flip(shards / "train-00000.tar", 600, after=b"gcd_000000002.verts.z\0")
    report = examine(shards)
    assert names(report) == {"unreadable"}
    found = report.finding("unreadable")
    assert found is not None
    assert (found.count, found.examples) == (1, ("gcd_000000002",))
    assert "verts.z" in next(iter(found.details))
    assert report.splits[0].examined == TRAIN - 1


@pytest.mark.parametrize(
    ("change", "fault"),
    [
        ({"closed": [0.5]}, "spec: closure 0: closed must be 2 numbers"),
        ({"closure": "velcro"}, "seam 0: closure velcro: give one of sewn"),
        ({"closed": [0.5, 0.9]}, "spec and closures have different closures"),
    ],
)
def test_closures_that_differ_from_the_arrays_are_named(change: dict[str, Any], fault: str, tmp_path: Path) -> None:
    seams = good()[0].pattern.seams
    zipped = (replace(seams[0], closure=Closure.ZIP, closed=(0.5, 1.0)), *seams[1:])
    sample = with_pattern(good()[0], seams=zipped)
    garment = CheckedGarment.of(GarmentDataset(written(tmp_path / "set", [sample]))[0])
    assert not [text for check, text in garment_faults(garment) if check is checks.REFERENCES]
    garment.spec["pattern"]["closures"][0].update(change)  # type: ignore[index]
    [found] = [text for check, text in garment_faults(garment) if check is checks.REFERENCES]
    assert found.startswith(fault)


@pytest.mark.parametrize("row", [0, 1])
def test_maps_of_another_garment_are_named(row: int, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    made = [encode_sample(with_maps(sample, np.ones(len(sample.drape.vertices)))) for sample in good()[:2]]  # type: ignore[union-attr]
    made[row] = resealed({**made[row], "maps.z": made[1 - row]["maps.z"]})
    folder = shard_of(tmp_path / "set", *made)
    index(Place(folder))
    assert main(["check", "--bytes", "--quiet", str(folder)]) == 1
    assert f"sample gcd_{row:09d}, member maps.z: stretch has " in capsys.readouterr().out


def test_files_that_do_not_match_the_index_are_listed(shards: Path) -> None:
    path = shards / "train-00003.tar"
    content = path.read_bytes()
    path.write_bytes(content[:-END] + tar_entry("gcd_000000099.notes.txt", b"added by hand") + bytes(END))
    [fault] = examine(shards).faults
    assert re.search(r"train-00003\.tar: \d+ bytes, but manifest\.json lists \d+", fault)
    path.write_bytes(content)
    shutil.copy(shards / "train-00000.tar", shards / "train-00009.tar")
    [fault] = examine(shards).faults
    assert "train-00009.tar: not listed in manifest.json: run gcd index" in fault
    (shards / "train-00009.tar").unlink()
    (shards / "train-00002.tar").unlink()
    report = examine(shards)
    assert names(report) == {"unreadable"}
    assert "\n".join(report.lines()).count("train-00002.tar: no such file") == 1


def test_an_unfinished_set_is_listed(tmp_path: Path) -> None:
    with ShardWriter(tmp_path, seed=0, recipe={}, count=40) as writer:
        for sample in good()[:30]:
            writer.write(sample)
    [fault] = examine(tmp_path).faults
    assert "30 of 40 samples are made" in fault


def test_quick_reads_a_part_of_each_split(shards: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("gcd_dataset.check.examination.QUICK", 7)
    report = examine(shards, quick=True)
    assert (report.splits[0].count, report.splits[0].examined) == (TRAIN, 7)
    assert report.findings == ()


def test_an_hdf5_file_is_examined_as_its_shards(tmp_path: Path) -> None:
    reader = ShardReader(written(tmp_path / "shards", [*good()[:5], not_a_number(good()[5])]))
    for _ in write_hdf5(reader, tmp_path / "train.h5"):
        pass
    report = examine(tmp_path / "train.h5")
    assert names(report) == {"nan"}
    assert report.finding("nan").examples == ("gcd_000000005",)  # type: ignore[union-attr]


def test_faults_of_further_garments_and_of_layers_are_found(tmp_path: Path) -> None:
    """In a set of outfits each with one fault; the last has none."""
    outfits, faulty = [fake_outfit(index, 2) for index in range(7)], list[Sample]()
    for edit in (not_a_number, in_metres, None):
        sample = outfits[len(faulty)]
        assert sample.outfit is not None
        inner, outer = sample.outfit.garments
        if edit is not None:
            broken = edit(replace(sample, box_mesh=outer.box_mesh, drape=outer.drape))
            outer = replace(outer, box_mesh=broken.box_mesh, drape=broken.drape)
        faulty.append(replace(sample, outfit=replace(sample.outfit, garments=(inner, outer))))
    for layers in ((), (Layer(0, 1, 0, 5000, 0.0),), (Layer(0, 1, 0, 5, 1.5),)):
        sample = outfits[len(faulty)]
        assert sample.outfit is not None
        faulty.append(replace(sample, outfit=replace(sample.outfit, layers=layers)))
    faulty.append(replace(outfits[6], grade=Grade.CLEAN))
    report = examine(written(tmp_path, [*faulty, fake_sample(0, 7)], garments=3))
    found = {finding.check.name: (dict(finding.details), finding.examples) for finding in report.harmful}
    beyond, missing = (
        "meta[layers] holds a share above 1, or counts more vertices than there are",
        "meta[layers] has not one row",
    )
    assert found.pop("nan") == ({"garment 1 of the outfit: verts": 1}, ("gcd_000000000",))
    assert found.pop("units") == ({"garment 1 of the outfit: vertices in metres": 1}, ("gcd_000000001",))
    details, examples = found.pop("references")
    clean = "meta[grade] is clean, and garments cross or lie in wrong order"
    assert (details.pop(beyond), details.pop(clean)) == (2, 1)
    assert {text[: len(missing)]: count for text, count in details.items()} == {missing: 1}
    assert (examples, found) == (tuple(f"gcd_{index:09d}" for index in range(3, 7)), {})


def test_outfits_that_share_one_garment_have_different_patterns(tmp_path: Path) -> None:
    """Four skirts, each also under another one; the last outfit is there twice."""
    outfits = [fake_outfit(index % 4, 1 + index // 4) for index in range(8)]
    numbered = [
        replace(sample, key=f"gcd_{index:09d}", provenance=replace(sample.provenance, index=index))
        for index, sample in enumerate([*outfits, outfits[-1]])
    ]
    census = SplitCensus()
    for position, item in enumerate(GarmentDataset(written(tmp_path, numbered, garments=2))):
        census.add(position, CheckedGarment.joined(item))
    assert len(set(census.pattern)) == 8 and census.pattern[7] == census.pattern[8]


def test_patterns_alone_have_few_fields_and_no_fault(tmp_path: Path) -> None:
    flat = [replace(s, box_mesh=None, drape=None, points=None, front=None, back=None) for s in good()[:TRAIN]]
    report = examine(written(tmp_path, flat))
    assert (names(report), names(report, Harm.NOTE)) == (set(), {"fields"})


@pytest.fixture(scope="module")
def first_release(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return published.publish(tmp_path_factory.mktemp("first"))


@pytest.fixture
def release(first_release: Path, tmp_path: Path) -> Path:
    """Two designs for training and one for testing, each on two bodies."""
    return shutil.copytree(first_release, tmp_path / first_release.name)


def test_a_broken_file_of_a_release_is_named(release: Path) -> None:
    path = published.file_of(release, published.TRAIN[0], "segmentation")
    path.write_text("front\n")
    found = examine(release).finding("unreadable")
    assert found is not None
    assert found.examples == (f"{published.BATCH}/default_body/{published.TRAIN[0]}",)
    assert str(path) in next(iter(found.details))


def test_garments_in_no_split_and_missing_ones_are_found(release: Path) -> None:
    (path,) = release.glob("*split*.json")
    lists = published.split_lists(release)
    name = next(name for name in lists if name.startswith("test"))
    lists[name] = [entry.replace(published.TEST[0], "rand_AAAAAAAAA9") for entry in lists[name]]
    path.write_text(json.dumps(lists))
    report = examine(release)
    orphans, missing = report.finding("orphans"), report.finding("incomplete")
    assert orphans is not None and missing is not None
    assert orphans.details == {"garments in no split": 2}
    assert missing.details == {"listed in the split, but neither on disk nor failed": 2}


def test_bodies_without_garment_and_without_mesh_are_found(release: Path) -> None:
    people = release / FOLDER
    for name in ("00000", "00077"):
        for kind in KINDS.values():
            path = people / kind.format(name)
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text("")
    (people / KINDS["straight"].format("00000")).unlink()
    report = examine(release)
    orphans, bodiless = report.finding("orphans"), report.finding("bodiless")
    assert orphans is not None and bodiless is not None
    assert (orphans.examples, orphans.details) == ((f"{FOLDER}/00077",), {"bodies without a garment": 1})
    assert bodiless.details["a body without mesh or metadata"] == 1
    assert examine(release, quick=True).finding("bodiless") is None  # not all wearers are known


def test_the_release_of_the_reference_system_has_no_harmful_finding(examples: Path, tmp_path: Path) -> None:
    """Reference patterns in the published layout, draped by another solver."""
    report = examine(examples / "published" / "GarmentCodeData_v2_unpacked", cache_dir=tmp_path)
    assert [(split.name, split.examined) for split in report.splits] == [("train", 2), ("test", 2)]
    assert not report.harmful


def test_the_verb_prints_findings_in_order_of_harm_and_exits_1(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    def edit(train: Samples, test: Samples) -> None:
        same_design(train, test)
        train[3] = not_a_number(train[3])
        same_pattern(train, test, 4)

    monkeypatch.setattr("gcd_dataset.check.examination.FEW_LEAKED", 0.1)

    edited(tmp_path, edit)
    assert main(["check", str(tmp_path), "--quiet"]) == 1
    text = capsys.readouterr().out
    places = [text.index(f"({name})") for name in ("leaked-design", "nan", "leaked-pattern")]
    assert places == sorted(places)
    assert "remedy: " in text and "effect: " in text and text.endswith("2 harmful, 1 warning, 1 in files and splits\n")
    assert main(["check", str(tmp_path), "--quiet", "--json"]) == 1
    report = json.loads(capsys.readouterr().out)
    assert [finding["check"] for finding in report["findings"]] == ["leaked-design", "nan", "leaked-pattern"]
    assert report["findings"][1]["examples"] == ["gcd_000000003"]


def test_a_small_share_of_known_patterns_is_a_warning_and_fails_a_strict_check_alone(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("gcd_dataset.check.examination.FEW_LEAKED", 0.1)
    report = edited(tmp_path, same_pattern)
    assert (names(report), names(report, Harm.WARNING)) == (set(), {"leaked-pattern"})
    assert main(["check", str(tmp_path), "--quiet"]) == 0
    assert main(["check", str(tmp_path), "--quiet", "--strict"]) == 1
    assert capsys.readouterr().out.count("(leaked-pattern)") == 2
    assert main(["check", str(tmp_path), "--quiet", "--errors"]) == 0
    assert "(leaked-pattern)" not in capsys.readouterr().out


def test_every_check_has_an_effect_a_remedy_and_an_entry_of_the_guide() -> None:
    assert all(check.effect and check.remedy and check.fault for check in CHECKS)
    guide = (Path(__file__).resolve().parents[2] / "docs" / "check.md").read_text()
    listed = [line.split("`")[1] for line in guide.splitlines() if line.startswith("| `")]
    assert listed == [check.name for check in CHECKS]
    assert len({*listed}) == len(listed)
