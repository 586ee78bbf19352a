"""Sleeves turned to arms in other poses."""

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from benchmarks.draping.other_bodies import FORWARD, OTHER_BODIES, arms_forward
from gcd_dataset.generator.body import build_body, measure, neutral_shape
from gcd_dataset.generator.body.shape import T_POSE
from gcd_dataset.generator.dressing import dress
from gcd_dataset.generator.dressing.openings import panel_outline
from gcd_dataset.generator.garments import sample_design, try_on
from gcd_dataset.generator.garments.overlay import Overlay
from gcd_dataset.records import Body, BodyPart, Measurements, PanelRole, Pattern
from gcd_dataset.seeding import Stage, rng

SLEEVED = {
    "meta": {"upper": "Shirt", "bottom": None},
    "sleeve": {"sleeveless": False, "length": 0.8},
    "left": {"enable_asym": False},
}


@cache
def a_pose() -> tuple[Body, Measurements]:
    body = build_body(neutral_shape())
    return body, measure(body)


@cache
def shirt() -> Pattern:
    """A shirt with sleeves, placed round the arms of the A-pose."""
    _, size = a_pose()
    for attempt in range(30):
        design = sample_design(rng(0, 0, Stage.DESIGN, attempt), [size], overlay=Overlay.from_dict(SLEEVED))
        pattern = try_on(size, design, name="shirt")
        if isinstance(pattern, Pattern):
            return pattern
    raise AssertionError("no shirt was accepted")


def sleeve_middle(pattern: Pattern) -> np.ndarray:
    """The centroid of the left sleeve's outlines [cm]."""
    middles = [p.placement.apply(panel_outline(p)).mean(axis=0) for p in pattern.panels if p.label == PanelRole.ARM]
    return np.mean([middle for middle in middles if middle[0] > 0], axis=0)


def off_axis(pattern: Pattern, body: Body) -> float:
    """Distance of the left sleeve's middle from the axis of the left arm [cm]."""
    arm = body.vertices[body.parts == BodyPart.LEFT_ARM.value]
    axis = np.linalg.svd(arm - arm.mean(axis=0), full_matrices=False)[2][0]
    offset = sleeve_middle(pattern) - arm.mean(axis=0)
    return float(np.linalg.norm(offset - (offset @ axis) * axis))


@pytest.mark.parametrize("pose", ["t_pose", "arms_forward"])
def test_sleeves_of_the_a_pose_are_turned_to_other_arms(pose: str) -> None:
    usual, size = a_pose()
    body = (
        build_body(replace(neutral_shape(), arm_angle=T_POSE))
        if pose == "t_pose"
        else arms_forward(usual, neutral_shape())
    )
    assert off_axis(shirt(), body) > 12.0
    dressing = dress(shirt(), body, size)
    assert off_axis(dressing.pattern, body) < 6.0
    assert sum("sleeve points" in sentence and "turned to it" in sentence for sentence in dressing.assumed) == 2


def test_turned_sleeves_keep_their_shape_and_stay_mirror_images() -> None:
    usual, size = a_pose()
    turned = dress(shirt(), arms_forward(usual, neutral_shape()), size).pattern
    for before, after in zip(shirt().panels, turned.panels, strict=True):
        assert np.array_equal(before.vertices, after.vertices)
    middles = [p.placement.apply(panel_outline(p)).mean(axis=0) for p in turned.panels if p.label == PanelRole.ARM]
    assert np.sum(middles, axis=0)[0] == pytest.approx(0.0, abs=0.5)


def test_sleeves_on_the_arms_stay() -> None:
    body, size = a_pose()
    dressing = dress(shirt(), body, size)
    assert sleeve_middle(dressing.pattern) == pytest.approx(sleeve_middle(shirt()))
    assert not any("sleeve points" in sentence for sentence in dressing.assumed)


def test_arms_forward_point_forward() -> None:
    body = arms_forward(a_pose()[0], neutral_shape())
    arm, hands = (body.vertices[body.parts == part.value] for part in (BodyPart.LEFT_ARM, BodyPart.HANDS))
    reach = hands[hands[:, 0] > 0].mean(axis=0) - arm[arm[:, 2].argsort()[:50]].mean(axis=0)
    assert reach @ FORWARD / np.linalg.norm(reach) / np.linalg.norm(FORWARD) > 0.97


@pytest.mark.parametrize("name", ["arms_up", "arms_down_25", "legs_wide", "arms_forward"])
def test_posed_bodies_have_the_measures_of_the_a_pose(name: str) -> None:
    _, size = a_pose()
    posed = OTHER_BODIES[name](Path()).size.to_file_values()
    expected = size.to_file_values()
    for measure_name in ("shoulder_w", "arm_length", "bust", "hips", "leg_circ"):
        assert posed[measure_name] == pytest.approx(expected[measure_name], rel=0.01), measure_name
