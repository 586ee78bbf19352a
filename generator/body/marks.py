"""A tailor's landmarks on one body: points and rings by name, and how sure it is that they are right."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Self

import numpy as np
from jaxtyping import Float

from gcd_dataset.generator.body.asset import landmarks
from gcd_dataset.records import Record

__all__ = ["CLOSED_RINGS", "Marks", "own_marks"]

CLOSED_RINGS = frozenset({"wrist_right"})
"""Rings whose length is a measure from the last point back to the first."""


@dataclass(frozen=True, eq=False)
class Marks(Record):
    """Landmarks as positions on the skin, by the names in ``data/landmarks.json``."""

    points: Mapping[str, Float[np.ndarray, "3"]]
    """[cm]"""
    rings: Mapping[str, Float[np.ndarray, "n 3"]]
    """Points along closed rings and open lines, in order [cm]; one point is enough to give a girth its level."""
    confidence: Mapping[str, float]
    """1 for what is known, near 0 for what was hardly found; by the name of a point or ring."""

    def level(self, ring: str) -> float:
        """Mean height of a ring [cm]."""
        return float(self.rings[ring][:, 1].mean())

    def moved(self, points: Mapping[str, Float[np.ndarray, "3"]]) -> Self:
        """The marks with some points elsewhere."""
        return replace(self, points={**self.points, **points})


def own_marks(vertices: Float[np.ndarray, "v 3"]) -> Marks:
    """The landmarks of a body of our own mesh, by vertex id."""
    table = landmarks()
    points = {name: vertices[vertex] for name, vertex in table.points.items()}
    rings = {name: vertices[ring] for name, ring in table.rings.items()}
    return Marks(points, rings, dict.fromkeys([*points, *rings], 1.0))
