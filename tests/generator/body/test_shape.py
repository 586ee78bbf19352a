"""Bodies of the shape space: closed, symmetric, posed, linear in their weights; and bodies fitted to measures."""

import sys
from dataclasses import replace

import numpy as np
import pytest
import trimesh
from scipy.spatial import cKDTree

from gcd_dataset.errors import BodyError
from gcd_dataset.generator.body import build_body, draw_shape, fit_shape, measure, named_shape, neutral_shape
from gcd_dataset.generator.body.asset import body_model
from gcd_dataset.generator.body.shape import T_POSE, arm_clearance
from gcd_dataset.records import ANGLES, MEASURES, BodyPart, BodyShape, Measurements
from gcd_dataset.seeding import Stage, rng


@pytest.mark.parametrize(
    "shape", [neutral_shape(), named_shape("female", legs_apart=True), draw_shape(rng(1, 0, Stage.BODY))]
)
def test_skin_is_closed_and_faces_outwards(shape: BodyShape) -> None:
    body = build_body(shape)
    mesh = trimesh.Trimesh(body.vertices, body.faces, process=False)
    assert mesh.is_watertight
    assert mesh.is_winding_consistent
    assert 40e3 < mesh.volume < 150e3  # cm³: litres of a person
    assert mesh.body_count == 1


@pytest.mark.parametrize("legs_apart", [False, True])
def test_bodies_stand_on_the_floor_and_face_z(legs_apart: bool) -> None:
    body = build_body(neutral_shape(legs_apart=legs_apart))
    assert body.vertices[:, 1].min() == pytest.approx(0.0, abs=1e-12)
    feet = body.vertices[body.parts == BodyPart.FEET.value]
    assert feet[:, 2].max() > 10.0  # toes in front of the ankles
    assert body.vertices[body.parts == BodyPart.LEFT_ARM.value, 0].min() > 0
    assert body.vertices[body.parts == BodyPart.RIGHT_LEG.value, 0].max() < 1.0
    for side in (1, -1):  # both soles on the floor
        assert feet[side * feet[:, 0] > 0, 1].min() < 0.3


def test_left_is_the_mirror_image_of_right() -> None:
    vertices = build_body(neutral_shape()).vertices
    gaps, partner = cKDTree(vertices).query(vertices * [-1, 1, 1])
    assert gaps.max() < 1e-3
    assert np.array_equal(partner[partner], np.arange(len(vertices)))


def test_legs_apart_do_not_change_the_head() -> None:
    straight, apart = build_body(neutral_shape()), build_body(neutral_shape(legs_apart=True))
    feet, head = (straight.parts == part.value for part in (BodyPart.FEET, BodyPart.HEAD))
    assert np.abs(apart.vertices[feet, 0]).mean() > np.abs(straight.vertices[feet, 0]).mean() + 3.0
    moved = apart.vertices[head] - straight.vertices[head]
    assert np.abs(moved - moved[0]).max() < 1e-9  # spread legs lower the whole head
    assert -1.5 < moved[0, 1] <= 0.0


def test_arms_are_level_in_the_t_pose() -> None:
    """Forearm and upper arm are level, and the trunk is unchanged."""
    weights = neutral_shape().weights
    arms = [BodyPart.LEFT_ARM.value, BodyPart.RIGHT_ARM.value]
    standing, level = build_body(BodyShape(weights)), build_body(BodyShape(weights, T_POSE))
    outer = np.isin(level.parts, arms) & (np.abs(level.vertices[:, 0]) > 25.0)
    assert np.ptp(level.vertices[outer, 1]) < 15.0  # the thickness of an arm, plus its bend
    assert np.ptp(level.vertices[:, 0]) == pytest.approx(level.vertices[:, 1].max(), rel=0.08)  # span, height
    assert abs(np.degrees(measure(level).arm_pose_angle)) < 6.0
    assert measure(level).waist == pytest.approx(measure(standing).waist, abs=0.01)


def test_pooled_weights_have_the_papers_spread() -> None:
    shapes = [draw_shape(rng(0, index, Stage.BODY), group="pooled") for index in range(80)]
    assert np.array([shape.weights for shape in shapes]).std() == pytest.approx(0.7, abs=0.06)
    assert max(abs(shape.arm_angle) for shape in shapes) <= np.radians(15.0)


def test_a_body_is_linear_in_its_weights() -> None:
    a, b = (draw_shape(rng(0, index, Stage.BODY), group="pooled").weights for index in (1, 2))
    bodies = [build_body(BodyShape(weights)).vertices for weights in (a, b, (a + b) / 2)]
    middle = (bodies[0] + bodies[1]) / 2
    assert bodies[2] - bodies[2][0] == pytest.approx(middle - middle[0], abs=1e-9)


def test_halves_do_not_cross_the_midplane() -> None:
    """Bodies are symmetric: skin that crosses x = 0 intersects its mirror image."""
    left = body_model().mean[:, 0] > 1e-9
    for index in range(4):
        drawn = draw_shape(rng(21, index, Stage.BODY))
        body = build_body(BodyShape(3.0 * drawn.weights))
        assert body.vertices[left, 0].min() > 0.0


def test_parts_lie_where_they_belong() -> None:
    body = build_body(neutral_shape())
    height = {part: body.vertices[body.parts == part.value, 1] for part in BodyPart}
    assert all(len(levels) for levels in height.values())
    assert height[BodyPart.FEET].max() < 15.0
    assert height[BodyPart.HEAD].min() > 140.0
    assert height[BodyPart.INTERNAL].min() > height[BodyPart.HEAD].min() - 5.0
    assert height[BodyPart.LEFT_LEG].max() < height[BodyPart.LEFT_ARM].max()


def test_a_wrong_number_of_weights_is_an_error() -> None:
    with pytest.raises(BodyError, match=f"3 shape weights, the body model takes {len(body_model().components)}"):
        build_body(BodyShape(np.zeros(3)))


def test_clearance_grows_by_the_shift_of_the_arms() -> None:
    body = build_body(BodyShape(neutral_shape().weights, np.radians(10.0)))
    arms = np.isin(body.parts, [BodyPart.LEFT_ARM.value, BodyPart.RIGHT_ARM.value])
    beside = (np.sign(body.vertices[:, 0]) * arms)[:, None] * [4.0, 0.0, 0.0]
    moved = arm_clearance(replace(body, vertices=body.vertices + beside)) - arm_clearance(body)
    assert 3.9 < moved < 4.0 + 1e-9  # the shortest gap is not exactly along x


def test_arms_of_drawn_bodies_are_clear_by_a_centimetre() -> None:
    for index in range(3):
        for group in ("female", "male", "pooled"):
            shape = draw_shape(rng(13, index, Stage.BODY), group=group)
            assert arm_clearance(build_body(shape)) > 1.0
            assert abs(shape.arm_angle) <= np.radians(15.0)


LENGTHS = [name for name in MEASURES if name not in ANGLES]


def values(size: Measurements, names: list[str] | tuple[str, ...] = MEASURES) -> np.ndarray:
    return np.array([getattr(size, name) for name in names])


def test_residuals_are_the_errors_of_the_fitted_body_and_open_measures_get_probable_values() -> None:
    neutral = measure(build_body(neutral_shape()))
    wanted = Measurements(height=neutral.height, waist=neutral.waist + 4.0)
    found = fit_shape(wanted)
    measured = measure(build_body(found.shape))
    for name in ("height", "waist"):
        assert getattr(measured, name) == pytest.approx(getattr(wanted, name), abs=0.1)
        assert getattr(measured, name) - getattr(wanted, name) == pytest.approx(getattr(found.residual, name), abs=1e-9)
    assert np.isnan(found.residual.wrist)
    assert values(measured, LENGTHS) == pytest.approx(values(neutral, LENGTHS), rel=0.1)


@pytest.mark.long
def test_the_measures_of_a_drawn_body_are_fitted_to_a_millimetre() -> None:
    drawn = draw_shape(rng(0, 2, Stage.BODY))
    found = fit_shape(measure(build_body(drawn)))
    assert np.abs(values(found.residual, LENGTHS)).max() < 0.1
    assert np.degrees(np.abs(values(found.residual, tuple(ANGLES)))).max() < 0.2
    assert found.shape.arm_angle == pytest.approx(drawn.arm_angle, abs=0.01)
    apart = build_body(found.shape).vertices - build_body(drawn).vertices
    assert np.linalg.norm(apart, axis=1).mean() < 0.5


@pytest.mark.parametrize(
    ("size", "message"),
    [
        (Measurements(), "no measure is given"),
        (Measurements(height=-3.0), "height is -3 cm.*give a length in cm"),
        (Measurements(waist=np.inf), "waist is inf"),
        (Measurements(height=1.72), "height is 1.72 cm, and 17"),
    ],
)
def test_impossible_measures_are_errors_with_a_remedy(size: Measurements, message: str) -> None:
    with pytest.raises(BodyError, match=message):
        fit_shape(size)


def test_a_body_too_far_from_the_mean_is_an_error(monkeypatch: pytest.MonkeyPatch) -> None:
    """``REACH`` is lowered, so that few iterations exceed it."""
    monkeypatch.setattr(sys.modules["gcd_dataset.generator.body.shape_fit"], "REACH", 1.0)
    with pytest.raises(BodyError, match=r"no adult has these.*standard deviations.*in cm, all of one person"):
        fit_shape(Measurements(height=215.0))
