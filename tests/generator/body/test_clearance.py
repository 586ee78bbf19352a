"""The gap between arms and trunk."""

from dataclasses import replace

import numpy as np

from gcd_dataset.generator.body import build_body, draw_shape, neutral_shape
from gcd_dataset.generator.body.shape import arm_clearance
from gcd_dataset.records import BodyPart, BodyShape
from gcd_dataset.seeding import Stage, rng


def test_clearance_grows_by_the_shift_of_the_arms() -> None:
    body = build_body(BodyShape(neutral_shape().weights, np.radians(10.0)))
    arms = np.isin(body.parts, [BodyPart.LEFT_ARM.value, BodyPart.RIGHT_ARM.value])
    beside = (np.sign(body.vertices[:, 0]) * arms)[:, None] * [4.0, 0.0, 0.0]
    moved = arm_clearance(replace(body, vertices=body.vertices + beside)) - arm_clearance(body)
    assert 3.9 < moved < 4.0 + 1e-9  # the shortest gap is not exactly along x


def test_raised_arms_have_more_clearance() -> None:
    weights = neutral_shape().weights
    gaps = [arm_clearance(build_body(BodyShape(weights, np.radians(angle)))) for angle in (-15.0, 0.0, 15.0)]
    assert 0.0 < gaps[0] < gaps[1] < gaps[2]


def test_arms_of_drawn_bodies_are_clear_by_a_centimetre() -> None:
    for index in range(8):
        for group in ("female", "male", "pooled"):
            shape = draw_shape(rng(13, index, Stage.BODY), group=group)
            assert arm_clearance(build_body(shape)) > 1.0
            assert abs(shape.arm_angle) <= np.radians(15.0)
