"""Which way up a mesh stands, where it looks, and in which unit it is: found by laying our body model over it."""

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

__all__ = ["StandingTransform", "UprightScan", "placed", "unit_of"]

TALLEST = 300.0  # cm; between this and SHORTEST a body's extent says its unit
SHORTEST = 30.0
ADULT = (120.0, 230.0)  # cm; outside it the unit is stated as doubtful
UNITS = {"centimetres": 1.0, "metres": 100.0, "millimetres": 0.1}
LIKENESS = 1.0  # cm of misfit that a body standing as it should may have in a coarse fit, drawn ones have 0.2 to 0.6
CLEARLY = 1.3  # by which factor a turned guess must lie nearer than the upright one
LIKELY = 6  # ways of standing that are looked at closely
LEVEL = np.radians(4.0)  # a body that leans or looks aside by less is left as it stands

_AXES = [np.eye(3)[list(order)] for order in itertools.permutations(range(3))]
_SIGNS = [np.diag(signs) for signs in itertools.product((1.0, -1.0), repeat=3)]
QUARTER_TURNS = tuple(turn for axes in _AXES for signs in _SIGNS if np.linalg.det(turn := signs @ axes) > 0)
"""The 24 rotations that take axes to axes; the first leaves all as it is."""
BACK_TO_FRONT = np.diag([-1.0, 1.0, -1.0])


@dataclass(frozen=True, eq=False)
class StandingTransform(Record):
    """From a file's coordinates to ours: ``factor · turn · point``, then down to the floor."""

    factor: float
    turn: Float[np.ndarray, "3 3"]
    floor: float
    """Height of the lowest vertex before it came to stand [cm]."""

    @classmethod
    def standing(cls, vertices: Float[np.ndarray, "v 3"], factor: float, turn: Float[np.ndarray, "3 3"]) -> Self:
        """The placing that puts the lowest vertex on y = 0."""
        return cls(factor, turn, float((factor * vertices @ turn[1]).min()))

    @property
    def turned(self) -> bool:
        """Whether the mesh stood otherwise."""
        return not np.allclose(self.turn, np.eye(3))

    def apply(self, points: Float[np.ndarray, "*n 3"]) -> Float[np.ndarray, "*n 3"]:
        """Points of the file [cm]."""
        return self.factor * points @ self.turn.T - [0.0, self.floor, 0.0]


@dataclass(frozen=True, eq=False)
class UprightScan(Record):
    """A scan turned upright and scaled to the model's height, and the guess that found it so."""

    scan: Scan
    """As it stands [cm]."""
    placing: StandingTransform
    """What turned it."""
    surface: SkinSurface
    """Of the scan times ``scale``, its middle over the origin."""
    scale: float
    shift: Float[np.ndarray, "3"]
    """Added to the scan times ``scale``."""
    guess: Alignment


def unit_of(extent: float, name: str) -> tuple[str, float]:
    """The unit in which a person is that tall, and its length [cm]. Raises ``BodyError`` where there is none."""
    for unit, factor in UNITS.items():
        if SHORTEST < extent * factor < TALLEST:
            return unit, factor
    raise BodyError(f"{name}: {extent:.4g} tall, which is a person's height in no unit: turn y up, scale it to cm")


def placed(scan: Scan, name: str) -> UprightScan:
    """The scan upright and facing +z, turned where it was not. Raises ``BodyError`` where no body is found in it."""
    turn = np.eye(3)
    found, behind = _try(scan, turn), _try(scan, BACK_TO_FRONT)
    if found.guess.misfit > LIKENESS or behind.guess.misfit < found.guess.misfit:
        tries = [(_try(scan, quarter, quick_alignment).guess.misfit, row) for row, quarter in enumerate(QUARTER_TURNS)]
        likely = [QUARTER_TURNS[row] for _, row in sorted(tries)[:LIKELY]]
        close = [_try(scan, quarter) for quarter in likely]
        row = int(np.argmin([one.guess.misfit for one in close]))
        if CLEARLY * close[row].guess.misfit < found.guess.misfit:
            found, turn = close[row], likely[row]
    if found.guess.misfit > LIKENESS:
        raise BodyError(
            f"{name}: no standing body is found in it: the nearest one is {found.guess.misfit:.1f} cm off on average: "
            "give one whole body with bare arms and legs, standing along y and facing +z"
        )
    lean = found.guess.turn
    if np.arccos(np.clip((np.trace(lean) - 1) / 2, -1, 1)) > LEVEL:
        found = _try(scan, lean.T @ turn)
    return found


def _try(
    scan: Scan, turn: Float[np.ndarray, "3 3"], guess: Callable[[SkinSurface], Alignment] = coarse_alignment
) -> UprightScan:
    """The scan in one turn, with the model laid over it."""
    placing = StandingTransform.standing(scan.vertices, 1.0, turn)
    standing = placing.apply(scan.vertices)
    scale = model_height() / float(np.ptp(standing[:, 1]))
    middle = (standing.max(axis=0) + standing.min(axis=0)) / 2
    shift = np.array([-middle[0], 0.0, -middle[2]]) * scale
    surface = SkinSurface.of(standing * scale + shift, scan.faces, scan.patched)
    turned = replace(scan, vertices=standing)
    return UprightScan(turned, placing, surface, scale, shift, guess(surface))
