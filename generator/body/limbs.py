"""Trunk and arms as elliptic tubes: an axis, and an ellipse that contains all cross sections of the part."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from types import MappingProxyType

import numpy as np
from jaxtyping import Float

from gcd_dataset.errors import BodyError
from gcd_dataset.generator.body.surface import kept_per_body
from gcd_dataset.records import Body, BodyPart

FRONT = np.array([0.0, 0.0, 1.0])
UP = np.array([0.0, 1.0, 0.0])
OUTLIERS = 0.5  # percent of the vertices at either end of each axis that a segmentation may mislabel
OUTLIER_DISTANCE = 5.0  # cm beyond that percentile from which a vertex is left out
ARM_ENDS = (0.015, 0.963)  # shoulder and wrist, as shares of the length of the body part
MIN_POINTS = 8  # a part with as many points or fewer counts as missing


@dataclass(frozen=True, eq=False)
class Limb:
    """A part of a body, or a section of a part, along an axis."""

    skin: Float[np.ndarray, "n 3"]
    """Points on the skin of the part [cm]."""
    axis: Float[np.ndarray, "3"]
    """Unit vector along the part: down the arm, up the trunk."""
    origin: Float[np.ndarray, "3"]
    """Centre of the enclosing ellipse [cm]."""
    wide: float
    """Half the width of the ellipse that contains all cross sections [cm]."""
    deep: float
    """Half the depth of that ellipse [cm]."""

    @cached_property
    def frame(self) -> Float[np.ndarray, "3 3"]:
        """Unit vectors across (in the body's frontal plane), along the axis, and to the front."""
        across = np.cross(self.axis, FRONT)
        across /= np.linalg.norm(across)
        return np.stack([across, self.axis, np.cross(across, self.axis)])

    def local(self, points: Float[np.ndarray, "*n 3"]) -> Float[np.ndarray, "*n 3"]:
        """Coordinates in ``frame`` relative to ``origin`` [cm]."""
        return (np.asarray(points) - self.origin) @ self.frame.T

    def world(self, local: Float[np.ndarray, "*n 3"]) -> Float[np.ndarray, "*n 3"]:
        """The inverse of ``local`` [cm]."""
        return np.asarray(local) @ self.frame + self.origin

    def at_height(self, height: float) -> Float[np.ndarray, "3"]:
        """The point of the axis at a height [cm]."""
        return self.origin + (height - self.origin[1]) / self.axis[1] * self.axis

    def clad(self, cloth: Float[np.ndarray, "c 3"]) -> "Limb":
        """The limb with points of cloth round it as skin too [cm]."""
        return _tube(np.concatenate([self.skin, cloth]), self.axis) if len(cloth) else self

    def section(self, low: float, high: float) -> "Limb":
        """The section between two positions along the axis [cm]; the whole limb if the section has too few points."""
        along = self.skin @ self.axis
        within = (along >= low) & (along <= high)
        return _tube(self.skin[within], self.axis) if within.sum() > MIN_POINTS else self


@kept_per_body
def limbs_of(body: Body) -> Mapping[BodyPart, Limb]:
    """The trunk with legs and feet, and each arm that the body has. Raises ``BodyError`` for a body without a trunk."""
    core = _points_of(body, BodyPart.TRUNK, BodyPart.LEFT_LEG, BodyPart.RIGHT_LEG, BodyPart.FEET)
    if len(core) <= MIN_POINTS:
        raise BodyError(f"body {body.name} has no trunk: give a segmentation")
    limbs = {BodyPart.TRUNK: _tube(core, UP)}
    for part in (BodyPart.LEFT_ARM, BodyPart.RIGHT_ARM):
        arm = _points_of(body, part)
        if len(arm) > MIN_POINTS:
            centre, axis = arm.mean(axis=0), _long_axis(arm)
            limbs[part] = _tube(arm, axis if abs(centre[0] + axis[0]) > abs(centre[0]) else -axis)  # off the trunk
    return MappingProxyType(limbs)


def along_arm(arm: Limb, place: float) -> Float[np.ndarray, "3"]:
    """The point of an arm's axis at a place between shoulder, 0, and wrist, 1 [cm]."""
    along = (arm.skin - arm.origin) @ arm.axis
    start, end = along.min() + np.array(ARM_ENDS) * np.ptp(along)
    return arm.origin + (start + place * (end - start)) * arm.axis


def leg_of(body: Body, part: BodyPart) -> Limb | None:
    """The left or right leg, without the foot, with its axis to the foot; ``None`` for a body without it."""
    return _legs_of(body).get(part)


@kept_per_body
def _legs_of(body: Body) -> Mapping[BodyPart, Limb]:
    legs = {}
    for part in (BodyPart.LEFT_LEG, BodyPart.RIGHT_LEG):
        leg = _points_of(body, part)
        if len(leg) > MIN_POINTS:
            axis = _long_axis(leg)
            legs[part] = _tube(leg, axis if axis[1] < 0.0 else -axis)
    return legs


def _long_axis(points: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "3"]:
    return np.linalg.svd(points - points.mean(axis=0), full_matrices=False)[2][0]


def _points_of(body: Body, *parts: BodyPart) -> Float[np.ndarray, "n 3"]:
    """The vertices of body parts, without the outliers that some segmentations mislabel."""
    points = np.asarray(body.vertices[np.isin(body.parts, [part.value for part in parts])], float)
    if not len(points):
        return points
    columns = points.T.copy()  # NumPy reduces rows many times as fast as columns
    # As ``np.percentile``, which takes twice the time.
    rank = np.array([OUTLIERS, 100 - OUTLIERS]) / 100 * (len(points) - 1)
    below, above = np.floor(rank).astype(int), np.ceil(rank).astype(int)
    ordered = np.partition(columns, np.unique([below, above]), axis=1)
    low, high = (ordered[:, below] + (rank - below) * (ordered[:, above] - ordered[:, below])).T[:, :, None]
    return points[((columns >= low - OUTLIER_DISTANCE) & (columns <= high + OUTLIER_DISTANCE)).all(axis=0)]


def _tube(skin: Float[np.ndarray, "n 3"], axis: Float[np.ndarray, "3"]) -> Limb:
    limb = Limb(skin, axis, np.zeros(3), 0.0, 0.0)
    local = limb.local(skin).T.copy()
    low, high = local.min(axis=1), local.max(axis=1)
    half, middle = 0.5 * (high - low), 0.5 * (low + high)
    half[1] = 1.0  # a single section has no extent along the axis
    across, _, depth = (local - middle[:, None]) / half[:, None]
    scale = np.sqrt((across**2 + depth**2).max())
    return replace(limb, origin=limb.world(middle), wide=float(scale * half[0]), deep=float(scale * half[2]))
