"""Files, box meshes, bodies and drapes of the evaluator."""

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh

from gcd_dataset.curves import Cubic
from gcd_dataset.errors import BodyError, GcdError, SpecError
from gcd_dataset.generator.body import build_body, draw_shape, measure, neutral_shape
from gcd_dataset.generator.garments import design_from_dict, draw_garment
from gcd_dataset.records import Closure, Edge, EdgeRef, InnerLine, Panel, Pattern, Placement, Seam
from gcd_dataset.scoring.answers import AnswerReader
from gcd_dataset.scoring.bodies import Wearers, wearers_of
from gcd_dataset.scoring.distances import (
    WORST,
    Cloud,
    MeshShape,
    Shape,
    distance,
    input_files,
    openings_apart,
    openings_of,
    read_points,
    read_shape,
)
from gcd_dataset.scoring.draping import arranged, panels_alike, with_drapes
from gcd_dataset.scoring.garments import box_mesh_distance, kind_of, remarks_of, score_garment, true_files
from tests.helpers import renamed
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


def test_answers_are_matched_by_the_garments_name(tmp_path: Path) -> None:
    truth = true_files(write(tmp_path / "truth", "dress_specification.json", "skirt.json", "top_specification.json"))
    answers = AnswerReader().read(write(tmp_path / "answers", "dress.json", "skirt_specification.json", "cape.json"))
    assert sorted(truth) == ["dress", "skirt", "top"]
    assert sorted(answers) == ["cape", "dress", "skirt"]
    missing, unknown = remarks_of(answers, truth)
    assert "1 of 3 garments" in missing and "top" in missing
    assert "cape" in unknown


def test_folders_that_cannot_be_matched(tmp_path: Path) -> None:
    with pytest.raises(SpecError, match="no answer is named as a garment"):
        list(remarks_of(["shirt"], ["dress"]))
    for read, files in ((true_files, "specification files"), (AnswerReader().read, "answers")):
        with pytest.raises(SpecError, match=f"no {files}"):
            read(write(tmp_path / "empty"))
        with pytest.raises(SpecError, match="no such folder"):
            read(tmp_path / "nowhere")
        with pytest.raises(SpecError, match="leave one of them"):
            read(write(tmp_path / "twice", "dress.json", "dress_specification.json"))


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
    shapes = {name: shape for name, path in files.items() if (shape := read_shape(path)) is not None}
    assert {name: type(shape) for name, shape in shapes.items()} == {
        "mesh": MeshShape, "mesh2": MeshShape, "points": Cloud, "array": Cloud,
    }  # fmt: skip
    for shape in shapes.values():
        assert distance(shapes["mesh"], shape) < 0.1  # sagitta of the edges


def test_inputs_that_cannot_be_used(tmp_path: Path) -> None:
    trimesh.creation.icosphere(subdivisions=2, radius=0.4).export(tmp_path / "metres.ply")
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


def test_points_of_a_drape_that_diverged_are_no_surface(tmp_path: Path) -> None:
    np.save(tmp_path / "diverged.npy", np.full((100, 6), np.nan, np.float32))
    np.save(tmp_path / "nothing.npy", np.zeros((0, 6)))
    for path in tmp_path.iterdir():
        assert read_shape(path) is None
        with pytest.raises(SpecError, match="fewer than 12 finite points: export the scan again"):
            read_points(path, 10)


@pytest.mark.parametrize("length", [9.0, 0.0, np.nan])
def test_normals_of_points_have_length_1(length: float, tmp_path: Path) -> None:
    """Normals of length 0 are not used."""
    ball = trimesh.creation.icosphere(subdivisions=3, radius=20.0)
    np.save(tmp_path / "ball.npy", np.hstack([ball.vertices, length * ball.vertex_normals]))
    points = read_points(tmp_path / "ball.npy", 500)
    assert points.shape == (500, 6)
    assert np.abs(np.einsum("ni,ni->n", points[:, :3] / 20, points[:, 3:])) == pytest.approx(1.0, abs=0.05)


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
    np.save(tmp_path / "giant.npy", np.full(20, 1e300))
    (tmp_path / "empty.npy").touch()
    np.savez(tmp_path / "several", weights=np.zeros(20))
    (tmp_path / "several.npz").rename(tmp_path / "several.npy")
    for name in ("giant", "empty", "several"):
        with pytest.raises(BodyError, match=f"{name}.npy: .*shape weights"):
            wearers.wearer(name, legs_apart=False)
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


@pytest.mark.parametrize("change", ["copied", "shuffled", "renamed"])
def test_lines_and_their_closures_are_arranged(change: str) -> None:
    """Also where the panels differ a little, so that they are not the true ones."""
    front, back, sleeve = garment().panels
    inner = np.array([[20.0, 5.0], [20.0, 55.0]])
    front, back = (
        replace(own, vertices=np.concatenate([own.vertices, inner]), lines=(InnerLine(4, 5),)) for own in (front, back)
    )
    seam = Seam(EdgeRef("front", 4), EdgeRef("back", 4), True, Closure.BUTTONS, (0.0, 0.5))
    whole = replace(garment(), panels=(front, back, sleeve), seams=(*garment().seams, seam))
    assert arranged(SAME[change](whole), whole) == replace(whole, extra={})
    near = each(lambda own: replace(own, vertices=own.vertices * 1.01))(whole)
    found = arranged(SAME[change](near), whole)
    assert found.seams == whole.seams
    for own, true in zip(found.panels, whole.panels, strict=True):
        for row in range(len(true.edges), len(true.edges) + len(true.lines)):
            ours, theirs = (p.placement.apply(np.array(p.edge_ends(row))) for p in (own, true))
            assert np.abs(ours - theirs).max() < 1.0


def test_arranging_keeps_panels_and_seams_without_a_match() -> None:
    whole = garment()
    far = Placement(np.array([300.0, 0.0, 0.0]), np.zeros(3))
    corners = np.array([[0.0, 0.0], [9.0, 0.0], [0.0, 9.0]])
    edges = (Edge(0, 1, Cubic((0.3, 0.1), (0.6, 0.1))), Edge(1, 2), Edge(2, 0))
    extra = Panel("front", corners, edges, far)  # named as a true panel
    ours = renamed(whole, {panel.name: f"_{panel.name}" for panel in whole.panels})
    found = arranged(replace(ours, panels=(extra, *ours.panels)), whole)
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
    assert rows["none"].failure == "no answer"
    [same] = with_drapes(scored[:1], wearers_of("neutral"), own=own, inputs={"same": None}, spacing=8.0, device="cpu")
    assert (same.values["redrape_cd_cm"], same.values["strict_within_1cm"]) == (WORST, 0)
    assert same.remarks == ("input: too few finite points for a surface",)
