"""Bodies of other models and scanners: in another pose, mesh, unit, axes and origin."""

from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh

from benchmarks.broken_bodies import broken_body
from benchmarks.cases.measures import tolerance
from benchmarks.skin import skin_crossings
from benchmarks.stand_ins import SMPLX_VERTICES, like_smplx
from gcd_dataset.generator.body import (
    build_body,
    draw_shape,
    female_shape,
    measure,
    mesh_bodies,
    read_body,
    read_measurements,
)
from gcd_dataset.generator.body.measuring import FoundBody, find_body
from gcd_dataset.generator.body.mesh_bodies import measure_file
from gcd_dataset.generator.body.shape import T_POSE
from gcd_dataset.generator.drape.body_field import body_field
from gcd_dataset.records import MEASURES, Body, BodyPart, BodyShape, Measurements
from gcd_dataset.seeding import Stage, rng

SURE_ANYWHERE = ("height", "bust", "waist", "hips", "leg_circ", "wrist", "head_l")
"""Heights, and girths at searched levels: always accurate, even where a remark states a doubt."""


def off(found: Measurements, known: Measurements) -> dict[str, float]:
    values, expected = found.to_file_values(), known.to_file_values()
    return {key: values[key] - expected[key] for key in MEASURES if key in expected}


def written(path: Path, vertices: np.ndarray, faces: np.ndarray) -> Path:
    trimesh.Trimesh(vertices, faces, process=False).export(path)
    return path


def level(body: Body) -> float:
    """Angle of the arms below the horizontal [degrees]."""
    return measure(body).to_file_values()["arm_pose_angle"]


def check_in_t_pose(found: Measurements, shape: BodyShape) -> None:
    """All measures equal those in the A-pose; ``arm_pose_angle`` alone is measured in the T-pose."""
    lifted = build_body(replace(shape, arm_angle=T_POSE))
    by = off(found, measure(build_body(shape)))
    assert found.to_file_values()["arm_pose_angle"] == pytest.approx(level(lifted), abs=3.0)
    assert not {key: one for key, one in by.items() if abs(one) > tolerance(key) and key != "arm_pose_angle"}


@cache
def lifted_woman() -> FoundBody:
    body = build_body(replace(female_shape(), arm_angle=T_POSE))
    order = np.random.default_rng(0).permutation(len(body.vertices))
    return find_body(body.vertices[order], np.argsort(order)[body.faces])


def test_raised_arms_are_moved_to_the_a_pose_to_be_measured() -> None:
    check_in_t_pose(lifted_woman().result.measurements, female_shape())
    assert np.degrees(lifted_woman().arm_turn) == pytest.approx(45.0, abs=2.0)


@pytest.mark.parametrize("angle", [-32.0, 60.0])
def test_raised_arms_of_the_models_mesh_are_moved_exactly(angle: float, tmp_path: Path) -> None:
    """The woman is slim: on other bodies a lowered arm folds the armpit, and untangling changes the skin."""
    shape = draw_shape(rng(5, 18, Stage.BODY), group="female")
    lifted = build_body(BodyShape(shape.weights, np.radians(angle)))
    assert skin_crossings(lifted) == 0
    by = off(measure(lifted), measure(build_body(BodyShape(shape.weights))))
    assert by.pop("arm_pose_angle") == pytest.approx(-angle, abs=2.0)
    assert max(map(abs, by.values())) < 0.1
    result, remarks = measure_file(written(tmp_path / "own.obj", lifted.vertices, lifted.faces))
    assert result.measurements.to_file_values() == pytest.approx(measure(lifted).to_file_values(), abs=0.02)
    assert any("moved there to be measured" in remark for remark in remarks)


def test_landmarks_of_raised_arms_lie_on_them() -> None:
    shoulder, wrist = (lifted_woman().marks.points[name] for name in ("shoulder_right", "wrist_right"))
    assert wrist[0] < shoulder[0] - 40.0
    assert abs(wrist[1] - shoulder[1]) < 8.0


def test_arms_near_the_a_pose_are_measured_as_they_are() -> None:
    body = build_body(BodyShape(female_shape().weights, np.radians(15.0)))
    found = find_body(body.vertices, np.roll(body.faces, 1, axis=0))
    assert found.arm_turn == 0.0
    assert found.result.measurements.shoulder_incl == pytest.approx(measure(body).shoulder_incl, abs=np.radians(1.0))


def test_moved_arms_of_a_body_unlike_the_model_are_reported_as_doubtful(examples: Path) -> None:
    """The published T-pose has shoulders bent differently from the model's."""
    result, remarks = measure_file(examples / "bodies" / "mean_all_tpose.obj")
    assert any(remark.startswith("doubtful: shoulder") and "shoulder_w" in remark for remark in remarks)
    by = off(result.measurements, read_measurements(examples / "bodies" / "mean_all.yaml"))
    assert max(abs(by[key]) for key in SURE_ANYWHERE) < 1.0


@pytest.fixture
def fitted_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """Cache the fit of each mesh across reads."""
    known: dict[tuple[bytes, bytes], FoundBody] = {}

    def fit(vertices: np.ndarray, faces: np.ndarray, *place: Any, **options: Any) -> FoundBody:
        mesh = vertices.tobytes(), faces.tobytes()
        if mesh not in known:
            known[mesh] = find_body(vertices, faces, *place, **options)
        return known[mesh]

    monkeypatch.setattr(mesh_bodies, "find_body", fit)


@pytest.mark.usefixtures("fitted_once")
def test_a_body_like_smplxs_lying_in_z_up_centimetres(tmp_path: Path) -> None:
    """10,475 vertices with two eyeballs and an open mouth, which cloth must not touch."""
    shape = BodyShape(female_shape().weights)
    vertices, faces = like_smplx(shape)
    assert len(vertices) == SMPLX_VERTICES
    path = written(tmp_path / "smplx.obj", 100.0 * vertices[:, [0, 2, 1]] * [1.0, -1.0, 1.0], faces)
    result, remarks = measure_file(path)
    check_in_t_pose(result.measurements, shape)
    assert "did not stand upright facing +z and was turned" in remarks
    body, size = read_body(path)
    assert size == result.measurements
    assert body.vertices[:, 1].min() == pytest.approx(0.0)
    pieces = trimesh.graph.connected_component_labels(trimesh.Trimesh(body.vertices, body.faces).face_adjacency)
    eyes = body.faces[pieces != np.bincount(pieces).argmax()]
    assert (body.parts[eyes] == BodyPart.INTERNAL.value).all()
    mouth = (body.parts == BodyPart.INTERNAL.value).sum() - len(np.unique(eyes))
    assert mouth > 50
    assert not (body_field(body, "cpu").part.numpy() == BodyPart.INTERNAL.value).any()


def test_many_small_holes_do_not_change_the_measures(tmp_path: Path) -> None:
    made = broken_body("pinholes", rng(0, 1, Stage.BODY, 1))
    assert made.truth is not None
    result, remarks = measure_file(made.write(tmp_path))
    assert not {key for key, by in off(result.measurements, made.truth).items() if abs(by) > tolerance(key)}
    assert any("holes in the skin, up to" in remark for remark in remarks)
