"""Poses in which a body does not touch itself: random standing ones, and those of a motion."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from gcd_dataset.generator.body.pose import STANDING, named_pose, pose_body, pose_of, side_and_kind
from gcd_dataset.generator.body.shape import ARM_ROOM, arm_clearance
from gcd_dataset.generator.drape.self_contact import skin_crossings
from gcd_dataset.records import BONES, Body, Pose

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
DRAWS = 20
SAMPLED = 6  # every how many poses of a motion are tried
SPREADS = {"upper_arm": (4.0, 28.0), "thigh": (2.0, 8.0)}
"""Of ``with_room``: step and most of the further spread [degrees]."""


def draw_pose(rng: np.random.Generator, body: Body) -> Pose:
    """A random standing pose, bones within 45° of the A-pose, in which the body does not touch itself.

    Trunk and arms are drawn from ``DRAWN``, legs from ``STRIDE``, ``KNEES`` and ``STANCE``; drawn again while the skin
    of ``body`` crosses itself, or arm and trunk have less room for cloth between them than ``ARM_ROOM``, or than in the
    A-pose. After ``DRAWS`` such draws the pose is the one named ``a-pose``, without rotations.
    """
    room = min(ARM_ROOM, arm_clearance(body))
    for _ in range(DRAWS):
        pose = pose_of(_drawn(rng), STANDING)
        posed = pose_body(body, pose)
        if arm_clearance(posed) >= room and not skin_crossings(posed):
            return pose
    return named_pose("a-pose")


def _drawn(rng: np.random.Generator) -> dict[str, Any]:
    """Bend, spread and twist of each bone [degrees]."""
    ranges = {bone: DRAWN[kind] for bone in BONES if (kind := side_and_kind(bone)[1]) in DRAWN}
    drawn: dict[str, Any] = {bone: rng.uniform(*zip(*each, strict=True)) for bone, each in ranges.items()}
    stride, knees, stance = rng.uniform(-STRIDE, STRIDE), rng.uniform(*KNEES), rng.uniform(*STANCE)
    for side, ahead in (("left_", stride), ("right_", -stride)):
        drawn |= {f"{side}thigh": (ahead + knees, stance, 0.0), f"{side}shin": (-2 * knees, 0.0, 0.0)}
        drawn |= {f"{side}foot": (knees - ahead, -stance, 0.0)}
    return drawn


def with_room(poses: Sequence[Pose], body: Body) -> tuple[Pose, ...]:
    """The poses of a motion with arms, then legs, spread further all along it, until the skin does not touch itself.

    Arm and trunk get the room of ``draw_pose``. Feet turn back by as much as thighs spread. Raises ``BodyError`` as
    ``pose_body`` does.
    """
    room = min(ARM_ROOM, arm_clearance(pose_body(body, named_pose("a-pose"))))
    given = tuple(poses)
    for bone, (step, most) in SPREADS.items():
        spread, extra = given, 0.0
        while extra < most and _touches(spread, body, bone, room):
            extra += step
            spread = tuple(_spread(pose, bone, extra) for pose in given)
        given = spread
    return given


def _touches(poses: Sequence[Pose], body: Body, bone: str, room: float) -> bool:
    """Whether an arm has less than ``room`` [cm] in one of the poses, or the skin crosses itself."""
    posed = (pose_body(body, pose) for pose in poses[::SAMPLED])
    return any(arm_clearance(each) < room if bone == "upper_arm" else skin_crossings(each) for each in posed)


def _spread(pose: Pose, bone: str, extra: float) -> Pose:
    """The pose with a bone of both sides spread by further degrees."""
    turns = {name: np.degrees(turn) for name, turn in pose.turns.items()}
    for side in ("left_", "right_"):
        for name, by in ((f"{side}{bone}", extra), *([(f"{side}foot", -extra)] if bone == "thigh" else [])):
            turns[name] = turns.get(name, np.zeros(3)) + [0.0, by, 0.0]
    return pose_of(turns, pose.name)


def counted(pose: Pose, body: Body) -> Pose:
    """The pose with the number of edges at which ``body`` cuts itself in it."""
    return replace(pose, cuts=skin_crossings(pose_body(body, pose)))
