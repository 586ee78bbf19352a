"""Finds the orientation and unit of a body mesh, by registering the body model in several orientations."""

import itertools
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Self

import numpy as np
from jaxtyping import Float

from gcd_dataset.errors import BodyError
from gcd_dataset.generator.body.register import Alignment, coarse_alignment, model_height, quick_alignment
from gcd_dataset.generator.body.scan import Scan
from gcd_dataset.generator.body.surface import SkinSurface
from gcd_dataset.records import Record

__all__ = ["StandingTransform", "UprightScan", "find_upright", "unit_of"]

SHORTEST, TALLEST = 30.0, 300.0  # cm; heights accepted in deciding the unit
UNITS = {"centimetres": 1.0, "metres": 100.0, "millimetres": 0.1}
MAX_MISFIT = 1.0  # cm; of an upright body in a coarse fit; drawn bodies have 0.2 to 0.6
MIN_GAIN = 1.3  # a turned orientation is chosen if the misfit as given is larger by this factor
SHORTLIST = 6  # orientations refined after the quick fits
MAX_LEAN = np.radians(4.0)  # a body that leans or looks aside by less stays as it is

_AXES = [np.eye(3)[list(order)] for order in itertools.permutations(range(3))]
_SIGNS = [np.diag(signs) for signs in itertools.product((1.0, -1.0), repeat=3)]
QUARTER_TURNS = tuple(turn for axes in _AXES for signs in _SIGNS if np.linalg.det(turn := signs @ axes) > 0)
"""The 24 rotations that permute the axes; the identity first."""
BACK_TO_FRONT = np.diag([-1.0, 1.0, -1.0])


@dataclass(frozen=True, eq=False)
class StandingTransform(Record):
    """From a mesh's coordinates to upright ones [cm]: ``turn · point``, then down to y = 0."""

    turn: Float[np.ndarray, "3 3"]
    floor: float
    """Height of the lowest vertex before the shift to y = 0 [cm]."""

    @classmethod
    def standing(cls, vertices: Float[np.ndarray, "v 3"], turn: Float[np.ndarray, "3 3"]) -> Self:
        """The transform with this rotation that puts the lowest vertex at y = 0."""
        return cls(turn, float((vertices @ turn[1]).min()))

    @property
    def turned(self) -> bool:
        """Whether the transform rotates."""
        return not np.allclose(self.turn, np.eye(3))

    def apply(self, points: Float[np.ndarray, "*n 3"]) -> Float[np.ndarray, "*n 3"]:
        """Transform points of the mesh [cm]."""
        return points @ self.turn.T - [0.0, self.floor, 0.0]


@dataclass(frozen=True, eq=False)
class UprightScan(Record):
    """A scan in upright orientation, with the body model coarsely aligned to it."""

    scan: Scan
    """In upright coordinates [cm]."""
    transform: StandingTransform
    """From the input to upright coordinates."""
    surface: SkinSurface
    """The surface of ``scan · scale + shift``: as tall as the model, centred over the origin."""
    scale: float
    shift: Float[np.ndarray, "3"]
    alignment: Alignment


def unit_of(extent: float, name: str) -> tuple[str, float]:
    """The unit in which ``extent`` is a person's height, and the unit's length [cm]. Raises ``BodyError`` for none.

    >>> unit_of(1.72, "scan.obj")
    ('metres', 100.0)
    """
    for unit, factor in UNITS.items():
        if SHORTEST < extent * factor < TALLEST:
            return unit, factor
    raise BodyError(f"{name}: {extent:.4g} tall, no person's height in {', '.join(UNITS)}: turn y up, scale it to cm")


def find_upright(scan: Scan, name: str) -> UprightScan:
    """The scan upright and facing +z, turned if necessary. Raises ``BodyError`` if it holds no body."""
    turn = np.eye(3)
    found, backward = _try(scan, turn), _try(scan, BACK_TO_FRONT)
    if found.alignment.misfit > MAX_MISFIT or backward.alignment.misfit < found.alignment.misfit:
        quick = [_try(scan, quarter, quick_alignment).alignment.misfit for quarter in QUARTER_TURNS]
        shortlist = [QUARTER_TURNS[row] for row in np.argsort(quick, kind="stable")[:SHORTLIST]]
        candidates = [_try(scan, quarter) for quarter in shortlist]
        best = int(np.argmin([candidate.alignment.misfit for candidate in candidates]))
        if MIN_GAIN * candidates[best].alignment.misfit < found.alignment.misfit:
            found, turn = candidates[best], shortlist[best]
    if found.alignment.misfit > MAX_MISFIT:
        raise BodyError(
            f"{name}: no standing body is found: the nearest is {found.alignment.misfit:.1f} cm off on "
            "average: give one whole body with bare arms and legs, standing along y and facing +z"
        )
    lean = found.alignment.turn
    if np.arccos(np.clip((np.trace(lean) - 1) / 2, -1, 1)) > MAX_LEAN:
        found = _try(scan, lean.T @ turn)
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
