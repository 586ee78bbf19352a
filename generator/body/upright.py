"""Finds the orientation and unit of a body mesh, by registering the body model in several orientations."""

import itertools
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Self

import numpy as np
from jaxtyping import Float

from gcd_dataset.bodyfiles import OTHER_UNITS
from gcd_dataset.errors import BodyError, ConfigError
from gcd_dataset.generator.body.register import (
    Alignment,
    Registration,
    coarse_alignment,
    model_height,
    quick_alignment,
    register,
)
from gcd_dataset.generator.body.scan import Scan
from gcd_dataset.generator.body.surface import SkinSurface
from gcd_dataset.measurements import ADULT, is_adult_height
from gcd_dataset.records import Record

UNITS = {"centimetres": 1.0, "metres": 100.0, "millimetres": 0.1}
MAX_MISFIT = 1.0  # cm; of an upright body in a coarse fit; drawn bodies have 0.2 to 0.6
MIN_GAIN = 1.3  # a turned orientation is chosen if the misfit as given is larger by this factor
SHORTLIST = 6  # orientations refined after the quick fits
COARSE_LEAN = np.radians(4.0)  # error of a coarse fit's rotation
SMALL_LEAN = np.radians(1.5)  # a smaller lean or turn is not corrected
POSTURE = np.radians(6.0)  # per cm of misfit, further lean forwards or backwards that stays: the posture may differ

_AXES = [np.eye(3)[list(order)] for order in itertools.permutations(range(3))]
_SIGNS = [np.diag(signs) for signs in itertools.product((1.0, -1.0), repeat=3)]
QUARTER_TURNS = tuple(turn for axes in _AXES for signs in _SIGNS if np.linalg.det(turn := signs @ axes) > 0)
"""The 24 rotations that permute the axes; the identity first."""
BACK_TO_FRONT = np.diag([-1.0, 1.0, -1.0])


@dataclass(frozen=True, eq=False)
class StandingTransform(Record):
    """From a mesh's coordinates to upright ones [cm]: ``turn · point``, down to y = 0, times ``unit``."""

    turn: Float[np.ndarray, "3 3"]
    floor: float
    """Height of the lowest vertex before the shift to y = 0 [unit of the mesh]."""
    unit: float = 1.0
    """Length of the mesh's unit [cm]."""

    @classmethod
    def standing(cls, vertices: Float[np.ndarray, "v 3"], turn: Float[np.ndarray, "3 3"]) -> Self:
        """The transform with this rotation that puts the lowest vertex at y = 0."""
        return cls(turn, float((vertices @ turn[1]).min()))

    @property
    def turned(self) -> bool:
        """Whether the transform rotates."""
        return not np.allclose(self.turn, np.eye(3))

    def apply(self, points: Float[np.ndarray, "*n 3"]) -> Float[np.ndarray, "*n 3"]:
        """Transform points of the mesh."""
        return (points @ self.turn.T - [0.0, self.floor, 0.0]) * self.unit


@dataclass(frozen=True, eq=False)
class UprightScan(Record):
    """A scan in upright orientation, with the body model coarsely aligned to it."""

    scan: Scan
    """In upright coordinates."""
    transform: StandingTransform
    """From the input to upright coordinates."""
    surface: SkinSurface
    """The surface of ``scan · scale + shift``: as tall as the model, centred over the origin."""
    scale: float
    shift: Float[np.ndarray, "3"]
    alignment: Alignment

    def in_cm(self, unit: float) -> "UprightScan":
        """The scan in centimetres; ``unit``: the length of the mesh's unit [cm]."""
        lengths = ("vertices", "holes", "mean_edge", "sagitta")
        scan = replace(self.scan, **{name: getattr(self.scan, name) * unit for name in lengths})
        return replace(self, scan=scan, transform=replace(self.transform, unit=unit), scale=self.scale / unit)


def unit_of(tall: float, name: str, height: float | None = None) -> float:
    """The length of the unit [cm] in which a body is ``tall``: it gives an adult's height, or ``height`` [cm] if given.

    Raises ``BodyError`` if ``tall`` is no adult's height in any of ``UNITS``, ``ConfigError`` if ``height`` is none.

    >>> unit_of(1.72, "scan.obj"), unit_of(0.5, "scan.obj", height=170.0)
    (100.0, 340.0)
    """
    if height is not None:
        if not is_adult_height(height):
            raise ConfigError(f"height {height:g}: no adult's: give it in centimetres, {ADULT[0]:g} to {ADULT[1]:g}")
        if tall > 0:
            return height / tall
    for unit in UNITS.values():
        if is_adult_height(tall * unit):
            return unit
    guesses = [f" ({tall * cm:.1f} cm if in {unit})" for unit, cm in OTHER_UNITS.items() if is_adult_height(tall * cm)]
    raise BodyError(
        f"{name}: {tall:.4g} tall, no adult's height in {', '.join(UNITS)}{''.join(guesses[:1])}: give the height of "
        "the body with --height CM (Python: height=)"
    )


def find_upright(scan: Scan, name: str) -> tuple[UprightScan, Registration]:
    """The scan upright and facing +z, turned if necessary, in its own unit; and the body model registered to it.

    Raises ``BodyError`` if it holds no body.
    """
    found = _nearest_quarter_turn(scan)
    if leans := np.linalg.norm(found.alignment.pose[3:6]) > COARSE_LEAN:
        found = _try(scan, found.alignment.turn.T @ found.transform.turn)
    if found.alignment.misfit > MAX_MISFIT:
        raise BodyError(
            f"{name}: no standing body is found: the nearest is {found.alignment.misfit:.1f} cm off on "
            "average: give one whole body with bare arms and legs, standing along y and facing +z"
        )
    registration = register(found.surface, found.alignment)
    if leans or not _is_upright(registration.alignment):
        found = _try(scan, registration.alignment.turn.T @ found.transform.turn)
        registration = register(found.surface, found.alignment)
    return found, registration


def _is_upright(alignment: Alignment) -> bool:
    pitch, yaw, roll = np.abs(alignment.pose[3:6])
    return bool(max(yaw, roll) < SMALL_LEAN and pitch < SMALL_LEAN + POSTURE * alignment.misfit)


def _nearest_quarter_turn(scan: Scan) -> UprightScan:
    """The scan as it is, unless the model fits it clearly better after one of ``QUARTER_TURNS``."""
    found, backward = _try(scan, np.eye(3)), _try(scan, BACK_TO_FRONT)
    if found.alignment.misfit > MAX_MISFIT or backward.alignment.misfit < found.alignment.misfit:
        quick = [_try(scan, quarter, quick_alignment).alignment.misfit for quarter in QUARTER_TURNS]
        shortlist = [QUARTER_TURNS[row] for row in np.argsort(quick, kind="stable")[:SHORTLIST]]
        candidates = [_try(scan, quarter) for quarter in shortlist]
        best = int(np.argmin([candidate.alignment.misfit for candidate in candidates]))
        if MIN_GAIN * candidates[best].alignment.misfit < found.alignment.misfit:
            return candidates[best]
    return found


def _try(
    scan: Scan, turn: Float[np.ndarray, "3 3"], align: Callable[[SkinSurface], Alignment] = coarse_alignment
) -> UprightScan:
    """The scan in one orientation, with the model aligned to it."""
    transform = StandingTransform.standing(scan.vertices, turn)
    standing = transform.apply(scan.vertices)
    scale = model_height() / float(np.ptp(standing[:, 1]))
    middle = (standing.max(axis=0) + standing.min(axis=0)) / 2
    shift = np.array([-middle[0], 0.0, -middle[2]]) * scale
    surface = SkinSurface.of(standing * scale + shift, scan.faces, scan.patched)
    turned = replace(scan, vertices=standing)
    return UprightScan(turned, transform, surface, scale, shift, align(surface))
