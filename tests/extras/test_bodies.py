"""Bodies in other meshes, poses and with other damage than ``tests/generator/body`` measures."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh

from benchmarks.draping.coarser import coarser
from gcd_dataset.cli.garment import measured_text
from gcd_dataset.generator import named_body, pose_body
from gcd_dataset.generator.body import (
    build_body,
    draw_shape,
    fit_shape,
    measure,
    mesh_bodies,
    named_shape,
    read_body,
    read_measurements,
)
from gcd_dataset.generator.body.measuring import FoundBody, find_body
from gcd_dataset.generator.body.mesh_bodies import measure_file
from gcd_dataset.generator.body.pose import pose_of
from gcd_dataset.generator.body.repair import VisibleSkin
from gcd_dataset.generator.body.shape import T_POSE
from gcd_dataset.generator.drape.body_field import body_fields
from gcd_dataset.records import ANGLES, MEASURES, Body, BodyPart, BodyShape
from gcd_dataset.seeding import Stage, rng
from tests.generator.body.broken_bodies import broken_body
from tests.generator.body.test_find import (
    SAME,
    SLOW_ERRORS,
    check_in_t_pose,
    clustered,
    fitted_woman,
    off,
    person,
    require_an_error,
    require_exact_measures_of_turned_arms,
    require_the_published_measures,
    require_the_stated_bounds,
    scene,
    too_far,
    woman,
    written,
)
from tests.generator.drape.test_contact import check_closed_to_cloth

SURE_ANYWHERE = ("height", "bust", "waist", "hips", "leg_circ", "wrist", "head_l")
"""Heights, and girths at searched levels: always accurate, even where a remark states a doubt."""
HARMLESS = {
    "some faces flipped": "",
    "facing away": "turned",
    "on a floor": "such as a floor",
    "pinholes": "holes in the skin, up to",
}
"""Damage to the remark about it."""
SMPL_VERTICES = 6890
SMPLX_VERTICES = 10475
EYE = 642  # vertices of an eyeball; SMPL-X has 546
PELVIS = 0.53  # height of the pelvis over the height of the body

_Mesh = tuple[np.ndarray, np.ndarray]  # vertices, faces


# SMPL (closed mouth, origin at the pelvis) and SMPL-X (open mouth, two separate eyeballs) may not be redistributed.


def like_smpl(shape: BodyShape) -> _Mesh:
    """A body in SMPL's form [m]: one closed skin, y up, facing +z, origin at the pelvis."""
    body = build_body(replace(shape, arm_angle=T_POSE))
    skin = VisibleSkin.of(body.faces, body.parts)
    return _from_pelvis(coarser(skin.points(body.vertices), skin.faces, SMPL_VERTICES))


def like_smplx(shape: BodyShape) -> _Mesh:
    """A body in SMPL-X's form [m]: the mouth open to a cavity, eyeballs as separate components."""
    body = build_body(replace(shape, arm_angle=T_POSE))
    sockets = (body.parts == BodyPart.INTERNAL.value) & (body.vertices[:, 1] > 0.92 * body.vertices[:, 1].max())
    parts = np.where(sockets, BodyPart.INTERNAL.value, BodyPart.HEAD.value).astype(np.uint8)
    seen = VisibleSkin.of(body.faces, parts)
    skin = coarser(seen.points(body.vertices), seen.faces, SMPLX_VERTICES - 2 * EYE)
    eyes = [_eye(body.vertices[sockets & (side * body.vertices[:, 0] > 0)]) for side in (1, -1)]
    both = trimesh.util.concatenate([trimesh.Trimesh(*skin, process=False), *eyes])
    return _from_pelvis((np.asarray(both.vertices), np.asarray(both.faces)))


def _eye(socket: np.ndarray) -> trimesh.Trimesh:
    ball = trimesh.creation.icosphere(subdivisions=3, radius=1.2)
    ball.apply_translation(socket.mean(axis=0))
    return ball


def _from_pelvis(mesh: _Mesh) -> _Mesh:
    vertices, faces = mesh
    return (vertices - [0.0, PELVIS * vertices[:, 1].max(), 0.0]) / 100.0, faces


def test_a_body_like_smpls(tmp_path: Path) -> None:
    """6,890 vertices in metres, arms level, the origin at the pelvis."""
    shape = BodyShape(draw_shape(rng(4, 5, Stage.BODY), group="female").weights)
    vertices, faces = like_smpl(shape)
    assert len(vertices) == SMPL_VERTICES
    result, remarks = measure_file(written(tmp_path / "smpl.obj", vertices, faces))
    check_in_t_pose(result.measurements, shape)
    assert "metres" in remarks[0]
    assert not any("doubtful" in remark for remark in remarks)


def test_a_widened_body_is_measured_or_reported_as_doubtful(tmp_path: Path) -> None:
    """A body of seed 0, 38 % wider, its underbust 0.6 cm off."""
    made = broken_body("squashed", rng(0, 156, Stage.BODY, 1))
    assert made.truth is not None
    result, remarks = measure_file(made.write(tmp_path))
    assert too_far(result.measurements, made.truth).keys() <= {"underbust"}
    assert any(remark.startswith("doubtful: underbust") for remark in remarks)


def test_a_coarse_mesh_of_a_body_of_another_model(examples: Path, tmp_path: Path) -> None:
    """The published mean woman, decimated to SMPL's number of vertices, y down; outside the model's shape space."""
    mean = trimesh.load(examples / "bodies" / "mean_female.obj", process=False)
    vertices, faces = coarser(100.0 * np.asarray(mean.vertices), np.asarray(mean.faces), SMPL_VERTICES)
    path = written(tmp_path / "woman.obj", vertices * [1.0, -1.0, -1.0] / 100.0, faces)
    result, remarks = measure_file(path)
    by = off(result.measurements, read_measurements(examples / "bodies" / "mean_female.yaml"))
    assert max(abs(by[key]) for key in SURE_ANYWHERE) < 1.0
    assert abs(by["underbust"]) < 2.5
    assert any(remark.startswith("doubtful: underbust may be up to") for remark in remarks)


def nearest(body: Body, point: list[float]) -> int:
    return int(np.linalg.norm(body.vertices - point, axis=1).argmin())


def test_a_scan_with_holes_has_the_field_of_the_whole_body(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    """A hole in the shin, a loose scrap and inconsistent winding change the distance field by less than 1.5 cm."""
    woman = build_body(named_shape("female"))
    shin = np.linalg.norm(woman.vertices - woman.vertices[nearest(woman, [12.0, 35.0, 20.0])], axis=1) < 2.0
    faces = woman.faces[~shin[woman.faces].any(axis=1)]
    faces = np.where((np.arange(len(faces)) % 7 == 0)[:, None], faces[:, ::-1], faces)
    scrap = trimesh.creation.icosphere(subdivisions=1, radius=3.0)
    scrap.apply_translation([0.0, 150.0, 60.0])
    path = tmp_path / "scan.obj"
    both = trimesh.util.concatenate([trimesh.Trimesh(woman.vertices, faces, process=False), scrap])
    both.export(path)
    body, _ = read_body(path)
    assert "were closed with flat patches" in caplog.text
    assert (body.parts[len(woman.vertices) : len(both.vertices)] == BodyPart.INTERNAL.value).all()
    whole, mended = body_fields([woman], "cpu")[0], body_fields([body], "cpu")[0]
    assert whole.distance.shape == mended.distance.shape
    assert np.abs(whole.distance.numpy() - mended.distance.numpy()).max() < 1.5


@pytest.mark.parametrize("kind", HARMLESS)
def test_harmless_damage_does_not_change_the_measures(kind: str, tmp_path: Path) -> None:
    made = broken_body(kind, rng(1, [*HARMLESS].index(kind), Stage.BODY))
    assert made.truth is not None
    result, remarks = measure_file(made.write(tmp_path))
    assert not too_far(result.measurements, made.truth)
    said = {word for word in HARMLESS.values() if word and any(word in remark for remark in remarks)}
    assert said == {HARMLESS[kind]} - {""}


@pytest.mark.parametrize("name", ["all", "male"])
def test_the_published_means_have_the_published_measures(name: str, examples: Path) -> None:
    require_the_published_measures(examples / "bodies" / f"mean_{name}.obj")


def test_raised_arms_are_measured_as_in_the_a_pose(tmp_path: Path) -> None:
    require_exact_measures_of_turned_arms(-32.0, tmp_path)


def test_hanging_arms_take_no_skin_of_the_trunk_along(tmp_path: Path) -> None:
    """The flank is nearer to a hanging arm than to some skin of its own; the bust was 11 cm too large."""
    body, size, _ = named_body("random:5")
    posed = pose_body(body, pose_of({"upper_arm": [0, -28, 0]}, "hanging"))
    order = rng(0, 0, Stage.BODY).permutation(len(posed.vertices))
    result, remarks = measure_file(written(tmp_path / "a.obj", posed.vertices[order], np.argsort(order)[posed.faces]))
    assert any("moved there to be measured" in remark for remark in remarks)
    assert result.measurements.bust == pytest.approx(size.bust, abs=0.7)
    assert result.measurements.back_width == pytest.approx(size.back_width, abs=0.7)


def test_a_bun_counts_as_height_and_is_told(tmp_path: Path) -> None:
    body = build_body(named_shape("female"))
    top = body.vertices[body.vertices[:, 1].argmax()]
    bun = 5.0 * np.exp(-((np.linalg.norm(body.vertices - top, axis=1) / 4.0) ** 2))
    lifted = body.vertices + bun[:, None] * [0.0, 1.0, 0.0]
    result, remarks = measure_file(written(tmp_path / "bun.obj", lifted, body.faces))
    assert result.measurements.height == pytest.approx(measure(body).height + 5.0, abs=0.1)
    assert any(remark.startswith("doubtful: the mesh reaches 5 cm above the head") for remark in remarks)


def test_ten_percent_larger_measures_fit_a_ten_percent_larger_body() -> None:
    small = draw_shape(rng(0, 0, Stage.BODY))
    size, lengths = measure(build_body(small)), [name for name in MEASURES if name not in ANGLES]
    found = fit_shape(replace(size, **{name: 1.1 * getattr(size, name) for name in lengths}))
    assert np.sqrt(np.mean([getattr(found.residual, name) ** 2 for name in lengths])) < 0.3
    apart = build_body(found.shape).vertices - 1.1 * build_body(small).vertices
    assert np.linalg.norm(apart, axis=1).mean() < 1.5


def test_our_mesh_in_a_scene_is_measured_upright_and_alone(tmp_path: Path) -> None:
    body = build_body(named_shape("female"))
    scene(body).export(tmp_path / "scene.obj")
    _, size = read_body(tmp_path / "scene.obj", height=float(np.ptp(body.vertices[:, 1])))
    assert max(map(abs, off(size, measure(body)).values())) < 0.7


def test_errors_of_a_finer_mesh_are_within_the_stated_bounds(tmp_path: Path) -> None:
    clustered(person(), 2.7).export(tmp_path / "coarse.obj")
    require_the_stated_bounds(measured_text(str(tmp_path / "coarse.obj")))


@pytest.mark.parametrize("name", ["female", "male"])
def test_eyes_and_mouth_of_the_published_bodies_are_closed_to_cloth(name: str, examples: Path) -> None:
    mesh = examples / "bodies" / f"mean_{name}.obj"
    body, _ = read_body(mesh, mesh.with_suffix(".yaml"), examples / "bodies" / "ggg_body_segmentation.json")
    check_closed_to_cloth(body)


def test_numbering_and_subdivision_do_not_change_a_body() -> None:
    vertices, faces = woman().vertices, woman().faces
    vertices, faces = trimesh.remesh.subdivide(vertices, faces)
    order = rng(0, 0, Stage.BODY).permutation(len(vertices))
    other = find_body(vertices[order], np.argsort(order)[faces])
    assert max(map(abs, off(other.result.measurements, fitted_woman().result.measurements).values())) < SAME


def test_moved_arms_of_a_body_unlike_the_model_are_reported_as_doubtful(examples: Path) -> None:
    """The published T-pose has shoulders bent differently from the model's."""
    result, remarks = measure_file(examples / "bodies" / "mean_all_tpose.obj")
    assert any(remark.startswith("doubtful: shoulder") and "shoulder_w" in remark for remark in remarks)
    by = off(result.measurements, read_measurements(examples / "bodies" / "mean_all.yaml"))
    assert max(abs(by[key]) for key in SURE_ANYWHERE) < 1.0


def test_a_body_scaled_and_moved_has_scaled_measures() -> None:
    larger = find_body(
        1.1 * woman().vertices + [250.0, -30.0, 80.0], woman().faces
    ).result.measurements.to_file_values()
    for key, value in fitted_woman().result.measurements.to_file_values().items():
        assert larger[key] == pytest.approx(value if key in ANGLES else 1.1 * value, abs=SAME)


@pytest.mark.parametrize("kind", SLOW_ERRORS)
def test_damage_that_a_fit_finds_is_an_error(kind: str, tmp_path: Path) -> None:
    require_an_error(kind, tmp_path)


def test_arms_near_the_a_pose_are_measured_as_they_are(tmp_path: Path) -> None:
    body = build_body(BodyShape(named_shape("female").weights, np.radians(15.0)))
    found, remarks = measure_file(written(tmp_path / "own.obj", body.vertices, np.roll(body.faces, 1, axis=0)))
    assert "arms 15° off the A-pose, measured as they are: shoulder_w may be 2 cm off" in remarks
    assert found.measurements.shoulder_incl == pytest.approx(measure(body).shoulder_incl, abs=np.radians(1.0))


def test_a_body_like_smplxs_lying_in_z_up_centimetres(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """10,475 vertices in the T-pose with two eyeballs and an open mouth, which cloth must not touch."""
    fits: list[FoundBody] = []

    def fit(*mesh: Any, **options: Any) -> FoundBody:
        """The fit of the mesh, which is read twice."""
        if not fits:
            fits.append(find_body(*mesh, **options))
        return fits[0]

    monkeypatch.setattr(mesh_bodies, "find_body", fit)
    shape = BodyShape(named_shape("female").weights)
    vertices, faces = like_smplx(shape)
    assert len(vertices) == SMPLX_VERTICES
    path = written(tmp_path / "smplx.obj", 100.0 * vertices[:, [0, 2, 1]] * [1.0, -1.0, 1.0], faces)
    result, remarks = measure_file(path)
    check_in_t_pose(result.measurements, shape)
    assert "did not stand upright facing +z and was turned" in remarks
    assert np.degrees(fits[0].arm_turn) == pytest.approx(45.0, abs=2.0)
    shoulder, wrist = (fits[0].marks.points[name] for name in ("shoulder_right", "wrist_right"))
    assert wrist[0] < shoulder[0] - 40.0
    assert abs(wrist[1] - shoulder[1]) < 8.0
    body, size = read_body(path)
    assert size == result.measurements
    assert body.vertices[:, 1].min() == pytest.approx(0.0)
    pieces = trimesh.graph.connected_component_labels(trimesh.Trimesh(body.vertices, body.faces).face_adjacency)
    eyes = body.faces[pieces != np.bincount(pieces).argmax()]
    assert (body.parts[eyes] == BodyPart.INTERNAL.value).all()
    mouth = (body.parts == BodyPart.INTERNAL.value).sum() - len(np.unique(eyes))
    assert mouth > 50
    assert not (body_fields([body], "cpu")[0].part.numpy() == BodyPart.INTERNAL.value).any()
