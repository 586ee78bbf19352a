"""Random standing poses in which a body does not touch itself."""

from typing import Any

import numpy as np

from gcd_dataset.generator.body.pose import BONES, pose_body, pose_of, side_and_kind
from gcd_dataset.generator.drape.self_contact import skin_crossings
from gcd_dataset.records import Body, Pose

STANDING = "standing"
DRAWN = {  # ranges of ``draw_pose``, uniform; of each side on its own [degrees]
    "lower_spine": ((-4, 8), (-5, 5), (-8, 8)),
    "upper_spine": ((-4, 8), (-5, 5), (-8, 8)),
    "neck": ((-8, 8), (-6, 6), (-15, 15)),
    "head": ((-8, 8), (-6, 6), (-15, 15)),
    "shoulder": ((-5, 8), (-3, 8), (0, 0)),
    "upper_arm": ((-25, 35), (-25, 22), (-12, 12)),
    "forearm": ((0, 40), (0, 0), (-20, 20)),
    "hand": ((-15, 15), (-8, 8), (0, 0)),
}
STRIDE, KNEES, STANCE = 12.0, (0.0, 12.0), (1.0, 9.0)
"""Of ``draw_pose`` [degrees]: largest bend of one thigh, the other bending as far back; bend of both knees, and spread
of both legs. The feet turn back, so that the soles stay level."""
SHARES = (1.0, 0.8, 0.6, 0.4, 0.2)  # of a drawn pose, until the body does not touch itself


def draw_pose(rng: np.random.Generator, body: Body) -> Pose:
    """A random standing pose in which the body does not touch itself, its bones within 45° of the A-pose.

    Trunk and arms are drawn from ``DRAWN``, legs from ``STRIDE``, ``KNEES`` and ``STANCE``; all angles are scaled down
    in steps of a fifth until the skin of ``body`` does not cross itself.
    """
    ranges = {bone: DRAWN[kind] for bone in BONES if (kind := side_and_kind(bone)[1]) in DRAWN}
    drawn: dict[str, Any] = {bone: rng.uniform(*zip(*each, strict=True)) for bone, each in ranges.items()}
    stride, knees, stance = rng.uniform(-STRIDE, STRIDE), rng.uniform(*KNEES), rng.uniform(*STANCE)
    for side, ahead in (("left_", stride), ("right_", -stride)):
        drawn |= {f"{side}thigh": (ahead + knees, stance, 0.0), f"{side}shin": (-2 * knees, 0.0, 0.0)}
        drawn |= {f"{side}foot": (knees - ahead, -stance, 0.0)}
    for share in SHARES:
        pose = pose_of({bone: share * np.asarray(turn) for bone, turn in drawn.items()}, STANDING)
        if not skin_crossings(pose_body(body, pose)):
            return pose
    return Pose({}, STANDING)
