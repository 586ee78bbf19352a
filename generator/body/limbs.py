"""Trunk and arms as tubes: an axis, and an ellipse that all of the part's cross sections lie within."""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from jaxtyping import Float

from gcd_dataset.errors import BodyError
from gcd_dataset.records import Body, BodyPart

__all__ = ["Limb", "limbs_of"]

FRONT = np.array([0.0, 0.0, 1.0])
UP = np.array([0.0, 1.0, 0.0])
STRAY = 0.5  # percent of a part's vertices that may stray on either side
NEAR = 5.0  # cm beyond the others from which they do
FEWEST = 8  # points that make a part
STEPS = 512  # of a curve round a part


@dataclass(frozen=True, eq=False)
class Limb:
    """A part of a body, or a stretch of it, along an axis."""

    skin: Float[np.ndarray, "n 3"]
    """Points of its skin [cm]."""
    axis: Float[np.ndarray, "3"]
    """Unit vector along it: down the arm, up the trunk."""
    origin: Float[np.ndarray, "3"]
    """The middle of what is seen of it along the axis [cm]."""
    wide: float
    """Half the width, and half the depth, of an ellipse round all cross sections [cm]."""
    deep: float

    @cached_property
    def frame(self) -> Float[np.ndarray, "3 3"]:
        """Unit vectors across (in the body's frontal plane), along the axis, and to the front."""
        across = np.cross(self.axis, FRONT)
        across /= np.linalg.norm(across)
        return np.stack([across, self.axis, np.cross(across, self.axis)])

    def local(self, points: Float[np.ndarray, "*n 3"]) -> Float[np.ndarray, "*n 3"]:
        """Coordinates across, along and to the front [cm]."""
        return (np.asarray(points) - self.origin) @ self.frame.T

    def world(self, local: Float[np.ndarray, "*n 3"]) -> Float[np.ndarray, "*n 3"]:
        """Back from ``local`` [cm]."""
        return np.asarray(local) @ self.frame + self.origin

    def stretch(self, low: float, high: float) -> "Limb":
        """What lies between two places along the axis [cm]; all of it where nothing does."""
        along = self.skin @ self.axis
        there = (along >= low) & (along <= high)
        return _tube(self.skin[there], self.axis) if there.sum() > FEWEST else self

    def curve(self, offset: float) -> Float[np.ndarray, "n 2"]:
        """Once round the part, ``offset`` cm outside its ellipse: across and forward, from the middle of the front."""
        turn = np.linspace(0.0, 2 * np.pi, STEPS + 1)
        return np.stack([(self.wide + offset) * np.sin(turn), (self.deep + offset) * np.cos(turn)], axis=1)


def limbs_of(body: Body) -> dict[BodyPart, Limb]:
    """The trunk, with the legs and feet, and the arms there are. Raises ``BodyError`` for a body without a trunk."""
    core = _piece(body, BodyPart.TRUNK, BodyPart.LEFT_LEG, BodyPart.RIGHT_LEG, BodyPart.FEET)
    if len(core) <= FEWEST:
        raise BodyError(f"body {body.name} has no trunk: give a segmentation")
    limbs = {BodyPart.TRUNK: _tube(core, UP)}
    for part in (BodyPart.LEFT_ARM, BodyPart.RIGHT_ARM):
        arm = _piece(body, part)
        if len(arm) > FEWEST:
            limbs[part] = _arm(arm)
    return limbs


def _piece(body: Body, *parts: BodyPart) -> Float[np.ndarray, "n 3"]:
    """The vertices of parts, without the few that stray: some bodies' segmentations have vertices of other parts."""
    points = np.asarray(body.vertices, float)[np.isin(body.parts, [part.value for part in parts])]
    if not len(points):
        return points
    low, high = np.percentile(points, [STRAY, 100 - STRAY], axis=0)
    return points[((points >= low - NEAR) & (points <= high + NEAR)).all(axis=1)]


def _arm(arm: Float[np.ndarray, "n 3"]) -> Limb:
    centre = arm.mean(axis=0)
    axis = np.linalg.svd(arm - centre, full_matrices=False)[2][0]
    return _tube(arm, axis if abs(centre[0] + axis[0]) > abs(centre[0]) else -axis)  # away from the trunk


def _tube(skin: Float[np.ndarray, "n 3"], axis: Float[np.ndarray, "3"]) -> Limb:
    limb = Limb(skin, axis, np.zeros(3), 0.0, 0.0)
    seen = limb.local(skin)
    low, high = seen.min(axis=0), seen.max(axis=0)
    half, middle = 0.5 * (high - low), 0.5 * (low + high)
    half[1] = 1.0  # a single section has no extent along the axis
    out = np.sqrt((((seen - middle) / half)[:, [0, 2]] ** 2).sum(axis=1).max())
    return replace(limb, origin=limb.world(middle), wide=float(out * half[0]), deep=float(out * half[2]))
