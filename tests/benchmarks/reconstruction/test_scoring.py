"""Files, box meshes, bodies and drapes of the evaluator."""

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
import trimesh

from benchmarks.reconstruction.garments import GarmentSet, generated
from benchmarks.reconstruction.judging import Patterns, draw_mesh, judge_of, score_measures
from benchmarks.reconstruction.models import baselines
from benchmarks.reconstruction.models.baselines import box_mesh, mean_measures, nearest_labels, nearest_measures
from benchmarks.reconstruction.models.measures import scans_of
from benchmarks.reconstruction.scoring.bodies import Wearers, wearers_of
from benchmarks.reconstruction.scoring.distances import (
    WORST,
    Cloud,
    MeshShape,
    Shape,
    distance,
    input_files,
    openings_apart,
    openings_of,
    read_shape,
)
from benchmarks.reconstruction.scoring.draping import arranged, panels_alike, with_drapes
from benchmarks.reconstruction.scoring.garments import (
    box_mesh_distance,
    garment_files,
    kind_of,
    match_folders,
    score_garment,
)
from benchmarks.reconstruction.tasks import task_named
from gcd_dataset.curves import Cubic
from gcd_dataset.errors import BodyError, GcdError, SpecError
from gcd_dataset.generator.body import build_body, draw_shape, measure, neutral_shape
from gcd_dataset.generator.garments import design_from_dict, draw_garment
from gcd_dataset.generator.lay_plan import PALETTE
from gcd_dataset.generator.mesh import build_box_mesh
from gcd_dataset.measurements import ANGLES, MEASURES
from gcd_dataset.records import Edge, Panel, Pattern, Placement, Seam
from gcd_dataset.spec import read_pattern
from tests.benchmarks.reconstruction.conftest import SKIRTS
from tests.test_metrics import SAME, drawn_from_behind, each, garment


@pytest.fixture(scope="module")
def skirt() -> Pattern:
    """A pencil skirt of the neutral body, with darts."""
    return draw_garment(measure(build_body(neutral_shape())), design_from_dict({"meta": {"bottom": "PencilSkirt"}}))


# --------------------------------------------------------------------------------------------------------------- files


def write(folder: Path, *names: str) -> Path:
    folder.mkdir(exist_ok=True)
    for name in names:
        (folder / name).parent.mkdir(exist_ok=True, parents=True)
        (folder / name).write_text("{}")
    return folder


def test_files_are_matched_by_the_garments_name(tmp_path: Path) -> None:
    truth = write(tmp_path / "truth", "dress_specification.json", "skirt.json", "top_specification.json")
    predictions = write(tmp_path / "predictions", "dress.json", "skirt_specification.json", "cape.json")
    folders = match_folders(predictions, truth)
    assert [(case.name, case.predicted is not None) for case in folders.cases] == [
        ("dress", True),
        ("skirt", True),
        ("top", False),
    ]
    assert folders.unknown == ("cape",)
    missing, unknown = folders.remarks()
    assert "1 of 3 garments" in missing and "top" in missing
    assert "cape" in unknown


def test_files_in_a_folder_for_each_garment(tmp_path: Path) -> None:
    """The layout of the published data, and of predictions named after their folder."""
    folder = write(tmp_path / "truth", "a/dress/dress_specification.json", "a/skirt/specification.json")
    assert sorted(garment_files(folder)) == ["dress", "skirt"]


def test_folders_that_cannot_be_matched(tmp_path: Path) -> None:
    truth = write(tmp_path / "truth", "dress.json")
    with pytest.raises(SpecError, match="no file is named as one of"):
        match_folders(write(tmp_path / "other", "shirt.json"), truth)
    with pytest.raises(SpecError, match="no specification files"):
        match_folders(write(tmp_path / "empty"), truth)
    with pytest.raises(SpecError, match="no such folder"):
        match_folders(tmp_path / "nowhere", truth)
    with pytest.raises(SpecError, match="the same garment"):
        garment_files(write(tmp_path / "twice", "dress.json", "dress_specification.json"))


@pytest.mark.parametrize(
    ("names", "kind"),
    [
        (["right_ftorso", "skirt_front"], "dress"),
        (["right_ftorso", "pant_f_r"], "jumpsuit"),
        (["right_ftorso", "sl_right_cuff_skirt_f"], "top"),
        (["wb_front", "skirt_front"], "skirt"),
        (["wb_front", "pant_f_r"], "trousers"),
        (["0", "1"], "other"),
    ],
)
def test_kinds_by_the_names_of_panels(names: list[str], kind: str) -> None:
    square = garment().panels[0]
    assert kind_of(Pattern("p", tuple(replace(square, name=name) for name in names), ())) == kind


# ----------------------------------------------------------------------------------------------------------- distances


def square(height: float, *, side: float = 40.0) -> MeshShape:
    """A horizontal square of four triangles round its centre [cm]."""
    corners = 0.5 * side * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1], [0, 0]])
    vertices = np.column_stack([corners[:, 0], np.full(5, height), corners[:, 1]])
    return MeshShape.of(vertices, np.array([[0, 1, 4], [1, 2, 4], [2, 3, 4], [3, 0, 4]]))


def grid(height: float) -> Cloud:
    """A horizontal square of points, 1.25 cm apart."""
    x, z = np.meshgrid(np.linspace(-20, 20, 33), np.linspace(-20, 20, 33))
    return Cloud.of(np.column_stack([x.ravel(), np.full(x.size, height), z.ravel()]))


@pytest.mark.parametrize("shapes", [(square, square), (grid, square), (square, grid), (grid, grid)])
def test_parallel_squares(shapes: tuple[Callable[[float], Shape], Callable[[float], Shape]]) -> None:
    """3 cm apart; and 0 from themselves, not the spacing of the points."""
    for height in (0.0, 3.0):
        assert distance(shapes[0](0.0), shapes[1](height)) == pytest.approx(height, abs=1e-6)


def test_inputs_are_read_as_meshes_and_points(tmp_path: Path) -> None:
    ball = trimesh.creation.icosphere(subdivisions=3, radius=20.0)
    ball.export(tmp_path / "mesh.ply")
    ball.export(tmp_path / "mesh2.obj")
    trimesh.PointCloud(ball.vertices).export(tmp_path / "points.ply")
    np.save(tmp_path / "array.npy", np.hstack([ball.vertices, ball.vertex_normals]).astype(np.float16))
    files = input_files(tmp_path)
    assert set(files) == {"mesh", "mesh2", "points", "array"}
    shapes = {name: read_shape(path) for name, path in files.items()}
    assert {name: type(shape) for name, shape in shapes.items()} == {
        "mesh": MeshShape, "mesh2": MeshShape, "points": Cloud, "array": Cloud,
    }  # fmt: skip
    for shape in shapes.values():
        assert distance(shapes["mesh"], shape) < 0.1  # sagitta of the edges


def test_inputs_that_cannot_be_used(tmp_path: Path) -> None:
    ball = trimesh.creation.icosphere(subdivisions=2, radius=0.4)
    ball.export(tmp_path / "metres.ply")
    np.save(tmp_path / "flat.npy", np.zeros((100, 2)))
    (tmp_path / "text.obj").write_text("nothing")
    (tmp_path / "broken.ply").write_bytes(b"ply\n")
    for name, message in (
        ("metres.ply", "centimetres"),
        ("flat.npy", r"shape \(100, 2\)"),
        ("text.obj", "text.obj"),
        ("broken.ply", "broken.ply"),
    ):
        with pytest.raises(SpecError, match=message):
            read_shape(tmp_path / name)


def test_box_meshes_of_a_garment_moved_by_2_cm(skirt: Pattern) -> None:
    """Front and back move along their normals: every point is 2 cm from the other mesh, or a little less at corners."""

    def moved(panel: Panel) -> Panel:
        away = 2.0 * panel.placement.matrix[:, 2]
        return replace(panel, placement=replace(panel.placement, translation=panel.placement.translation + away))

    loose = replace(skirt, seams=())  # seams would weld the borders half-way
    apart, remarks = box_mesh_distance(each(moved)(loose), loose, spacing=4.0)
    assert remarks == ()
    assert apart == pytest.approx(2.0, rel=0.02)
    assert box_mesh_distance(skirt, skirt, spacing=4.0)[0] == pytest.approx(0, abs=1e-3)


# -------------------------------------------------------------------------------------------------------------- bodies


def test_bodies_of_a_folder(tmp_path: Path) -> None:
    """A garment's own shape first, then ``bodies.json``, then the default; poses by garment."""
    shapes = {"dress": draw_shape(np.random.default_rng(0)), "default": neutral_shape()}
    for name, shape in shapes.items():
        np.save(tmp_path / f"{name}.npy", shape.weights.astype(np.float32))
    (tmp_path / "dress.meta.json").write_text(json.dumps({"pose": {"arm_angle": float(shapes["dress"].arm_angle)}}))
    (tmp_path / "bodies.json").write_text(json.dumps({"cape": "dress", "top": "male"}))
    wearers = wearers_of(str(tmp_path))
    dress, size = wearers.wearer("dress", legs_apart=False)
    assert np.allclose(dress.vertices, build_body(shapes["dress"]).vertices, atol=1e-3)
    assert size.waist == pytest.approx(measure(build_body(shapes["dress"])).waist, abs=1e-2)
    assert wearers.wearer("cape", legs_apart=False)[0] is dress
    assert np.allclose(
        wearers.wearer("skirt", legs_apart=False)[0].vertices, build_body(neutral_shape()).vertices, atol=1e-3
    )
    male = wearers.wearer("top", legs_apart=True)[0]
    assert np.ptp(male.vertices[:, 1]) > np.ptp(build_body(neutral_shape()).vertices[:, 1])


def test_an_answer_without_a_body_of_its_own_is_worn_by_the_neutral_one(tmp_path: Path) -> None:
    shape = draw_shape(np.random.default_rng(3))
    np.save(tmp_path / "dress.npy", shape.weights)
    own = Wearers(tmp_path, "neutral", {})
    assert own.wearer("dress", legs_apart=False)[1].height == pytest.approx(measure(build_body(shape)).height)
    assert own.wearer("cape", legs_apart=False)[1] == wearers_of("neutral").wearer("cape", legs_apart=False)[1]


def test_missing_and_broken_bodies(tmp_path: Path) -> None:
    np.save(tmp_path / "dress.npy", np.zeros(3))
    wearers = wearers_of(str(tmp_path))
    with pytest.raises(BodyError, match="no body for skirt"):
        wearers.wearer("skirt", legs_apart=False)
    with pytest.raises(BodyError, match="shape weights"):
        wearers.wearer("dress", legs_apart=False)
    with pytest.raises(GcdError, match="nobody"):
        wearers_of("nobody")
    (tmp_path / "bodies.json").write_text("[]")
    with pytest.raises(BodyError, match=r"bodies\.json"):
        wearers_of(str(tmp_path))


# -------------------------------------------------------------------------------------------------------------- drapes


@pytest.mark.parametrize("change", SAME)
def test_the_same_garment_is_arranged_as_the_true_one(change: str, skirt: Pattern) -> None:
    """However it is numbered, named or drawn: so it drapes to the same bytes."""
    for whole in (garment(), skirt):
        ours = arranged(SAME[change](whole), whole)
        assert ours.panels == whole.panels
        assert ours.seams == whole.seams


def test_arranging_keeps_panels_and_seams_without_a_match() -> None:
    whole = garment()
    far = Placement(np.array([300.0, 0.0, 0.0]), np.zeros(3))
    corners = np.array([[0.0, 0.0], [9.0, 0.0], [0.0, 9.0]])
    edges = (Edge(0, 1, Cubic((0.3, 0.1), (0.6, 0.1))), Edge(1, 2), Edge(2, 0))
    extra = Panel("front", corners, edges, far)  # named as a true panel
    ours = Pattern("p", (extra, *(replace(panel, name=f"_{panel.name}") for panel in whole.panels)), ())
    seams = tuple(
        Seam(replace(s.left, panel=f"_{s.left.panel}"), replace(s.right, panel=f"_{s.right.panel}"))
        for s in whole.seams
    )
    found = arranged(replace(ours, seams=seams), whole)
    assert [panel.name for panel in found.panels] == ["front", "back", "sleeve", "extra 0"]
    assert found.seams == whole.seams
    assert len(found.panels[-1].edges) == 3


def test_the_openings_of_a_tube_are_its_two_ends() -> None:
    """A tube that is 4 cm shorter at one end has this end 4 cm away, whatever its mean distance is."""
    tube = trimesh.creation.cylinder(10.0, 60.0, sections=64)
    faces = np.array([face for face in tube.faces if np.ptp(tube.vertices[face, 2]) > 1.0])
    ends = openings_of(tube.vertices, faces)
    assert sorted(float(end[:, 2].mean()) for end in ends) == [-30.0, 30.0]
    shorter = openings_of(np.minimum(tube.vertices, [99.0, 99.0, 26.0]), faces)
    assert openings_apart(ends, ends) == 0
    assert openings_apart(ends, shorter) == openings_apart(shorter, ends) == pytest.approx(4.0)
    assert (openings_apart(ends, []), openings_apart([], [])) == (WORST, 0)


def test_panels_turned_inside_out_are_not_alike() -> None:
    mirrored = each(lambda panel: replace(drawn_from_behind(panel), placement=panel.placement))(garment())
    assert score_garment("g", mirrored, garment()).values["iou"] == pytest.approx(1)
    assert not panels_alike(mirrored, garment())
    assert panels_alike(SAME["all of it"](garment()), garment())


@pytest.mark.long
def test_predictions_are_draped_and_compared_with_the_true_drape(skirt: Pattern, tmp_path: Path) -> None:
    """A skirt that is lower on one side: the same one otherwise numbered, one 3 cm too short, one scaled by 0.95, its
    mirror image, one that cannot be sewn, and none. Only the first is right."""

    def lifted(pattern: Pattern, by: Callable[[np.ndarray], np.ndarray]) -> Pattern:
        """The hem lifted by a height [cm] that depends on its place from the wearer's right to the left."""

        def changed(panel: Panel) -> Panel:
            low = panel.vertices[:, 1] < panel.vertices[:, 1].min() + 1.0
            height = by(panel.placement.apply(panel.vertices)[:, 0]) * low
            return replace(panel, vertices=panel.vertices + np.outer(height, [0.0, 1.0]))

        return each(changed)(pattern)

    true = lifted(skirt, lambda x: 5.0 * (x > 0))
    answers = {
        "same": SAME["all of it"](true),
        "short": lifted(skirt, lambda x: 3.0 + 5.0 * (x > 0)),
        "small": each(lambda panel: replace(panel, vertices=0.95 * panel.vertices))(true),
        "mirrored": lifted(skirt, lambda x: 5.0 * (x < 0)),
        "broken": each(lambda panel: replace(panel, vertices=0.001 * panel.vertices))(true),
        "none": None,
    }
    scored = [score_garment(name, pattern, true, spacing=8.0) for name, pattern in answers.items()]
    np.save(tmp_path / "short.npy", np.zeros(3))  # no body: an answer that brings one stops nothing
    own = Wearers(tmp_path, "neutral", {})
    rows = {r.name: r for r in with_drapes(scored, wearers_of("neutral"), own=own, spacing=8.0, device="cpu")}
    assert list(rows) == list(answers)
    names = ("sim_ok", "redrape_cd_cm", "openings_cm", "strict_within_1cm")
    values = {name: [row.values[key] for key in names] for name, row in rows.items()}
    assert values["same"] == pytest.approx([1, 0, 0, 1], abs=1e-6)
    for name in ("short", "small", "mirrored"):
        passed, mean, openings, right = values[name]
        assert passed == 1
        assert mean < 1.0  # what a mean distance of the surfaces accepts
        assert openings > 1.5
        assert right == rows[name].values["strict_unaided"] == 0
    assert rows["same"].values["strict_unaided"] == 1
    assert "drape without help" in rows["short"].remarks[-1]
    assert values["broken"] == values["none"] == [0, WORST, WORST, 0]
    assert rows["none"].failure == "no prediction"


# -------------------------------------------------------------------------------------------------------------- judging


CPU = torch.device("cpu")


def files_in(folder: Path) -> list[str]:
    return sorted(str(path.relative_to(folder)) for path in folder.rglob("*") if path.is_file())


@pytest.mark.parametrize(("task", "answer"), [("T4", nearest_labels), ("T5", mean_measures), ("T6", box_mesh)])
def test_answers_are_drawn_and_written(
    task: str, answer: Callable[..., list[Any]], draped: GarmentSet, tmp_path: Path
) -> None:
    answers, judge = answer(draped, draped, device=CPU), judge_of(task_named(task), watching=True)
    assert judge.picture(answers, draped).ndim == 3
    judge.write(answers, draped, tmp_path)
    assert sorted(judge.files(draped)) == files_in(tmp_path)
    assert len(judge.scores(answers, draped)) == len(draped)


def test_the_nearer_of_two_faces_is_seen() -> None:
    low, high = np.array([[0, 0, 0], [9, 0, 0], [0, 9, 0]], float), np.array([[0, 0, 5], [9, 0, 5], [0, 9, 5]], float)
    vertices, faces = np.concatenate([low, high]), np.array([[0, 1, 2], [3, 4, 5]])
    picture = draw_mesh(vertices, faces, np.array([0, 1]), frame=vertices, size=60)
    assert np.allclose(picture[35, 25] / 255, PALETTE[1], atol=0.02)


def test_the_evaluator_reads_inputs_and_bodies_of_draped_garments(tmp_path: Path) -> None:
    garments = generated(2, 0, points=512, extra=("pose",), drape=None, resolution=8.0, design=SKIRTS)
    truth = [garments.pattern(k) for k in range(2)]
    Patterns(draped=True).write(truth, garments, tmp_path)
    assert sorted(Patterns(draped=True).files(garments)) == files_in(tmp_path)
    wearers = wearers_of(str(tmp_path / "bodies"))
    for key, pattern in zip(garments.keys, truth, strict=True):
        assert read_pattern(tmp_path / "truth" / f"{key}.json").extra["properties"]["kind"] == "skirt"
        points = read_shape(tmp_path / "inputs" / f"{key}.npy").samples
        places = build_box_mesh(pattern, spacing=8.0).vertices
        assert np.abs(np.ptp(points, axis=0) - np.ptp(places, axis=0)).max() < 5.0
        assert np.abs(points.max(axis=0) - places.max(axis=0)).max() < 5.0
        assert 140.0 < wearers.wearer(key, legs_apart=False)[1].height < 210.0
    Patterns().write(truth, garments, tmp_path / "flat")
    assert not (tmp_path / "flat" / "inputs").exists()
    assert sorted(Patterns().files(garments)) == files_in(tmp_path / "flat")


def test_lengths_and_angles_have_errors_of_their_own() -> None:
    true = np.full(len(MEASURES), 40.0)
    answer = true + [3.0 if name in ANGLES else -2.0 for name in MEASURES]
    score = score_measures(answer, true)
    assert (score.error_cm, score.error_degrees, score.waist) == (2, 3, 2)
    with pytest.raises(ValueError, match="25 measures"):
        score_measures(answer[1:], true)


def test_the_references_answer_from_known_bodies(draped: GarmentSet, monkeypatch: pytest.MonkeyPatch) -> None:
    scans = scans_of(draped)
    monkeypatch.setattr(baselines, "scans_of", lambda garments, workers: scans)
    mean = mean_measures(draped, draped, device=CPU)
    assert np.allclose(mean[0], draped.measures.mean(axis=0), atol=1e-3)
    for k, answer in enumerate(nearest_measures(draped, draped, device=CPU)):
        assert np.allclose(answer, draped.measures[k])


def test_scans_show_cloth_and_skin(draped: GarmentSet) -> None:
    for scan in scans_of(draped):
        heights = 100 * scan[:, 1] + 100
        on_cloth = scan[:, 6] > 0
        assert 0.05 < on_cloth.float().mean() < 0.95
        assert heights.min() > -2
        assert heights[~on_cloth].max() > heights[on_cloth].max()  # skirts end below the head


def test_a_scan_depends_on_its_garment_alone(draped: GarmentSet) -> None:
    assert torch.equal(scans_of(draped.select([1]))[0], scans_of(draped)[1])
