"""A tailor's landmarks on one body: points and rings by name, and how sure it is that they are right.

Given by hand, they are a JSON file such as ``{"shoulder_right": 1557, "waist": [[0.12, 1.08, 0.03]]}``: each name has
one vertex id or one position in the coordinates of the mesh file, a ring has a list of them.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Protocol, Self

import numpy as np
from jaxtyping import Float

from gcd_dataset.errors import BodyError, shown
from gcd_dataset.generator.body.asset import landmark_table
from gcd_dataset.jsonfile import found, read_json
from gcd_dataset.records import Record

__all__ = ["LEVEL_RINGS", "GivenLandmarks", "Landmarks", "levels_of", "model_landmarks", "read_landmarks"]

LEVEL_RINGS = ("bust", "underbust", "waist", "hips", "leg_right")
"""Rings that only say at which height a girth is taken."""
OUTSIDE = 0.05  # of the mesh's size: as far off its box may a landmark be


@dataclass(frozen=True, eq=False)
class Landmarks(Record):
    """LandmarkTable as positions on the skin, by the names in ``data/landmarks.json``."""

    points: Mapping[str, Float[np.ndarray, "3"]]
    """[cm]"""
    rings: Mapping[str, Float[np.ndarray, "n 3"]]
    """Points along closed rings and open lines, in order [cm]; one point is enough for a level."""
    levels: Mapping[str, float]
    """Heights about which girths are searched [cm]."""
    confidence: Mapping[str, float]
    """1 for what is known, near 0 for what was hardly found; by the name of a point or ring."""

    def with_rings(self, rings: Mapping[str, Float[np.ndarray, "n 3"]]) -> Self:
        """The marks with some rings elsewhere; levels that hang on them lie at their means."""
        means = {name: float(ring[:, 1].mean()) for name, ring in rings.items() if name in self.levels}
        return replace(self, rings={**self.rings, **rings}, levels={**self.levels, **means})

    def moved(self, points: Mapping[str, Float[np.ndarray, "3"]]) -> Self:
        """The marks with some points elsewhere."""
        return replace(self, points={**self.points, **points})


def model_landmarks(vertices: Float[np.ndarray, "v 3"]) -> Landmarks:
    """The landmarks of a body of our own mesh, by vertex id."""
    table = landmark_table()
    points = {name: vertices[vertex] for name, vertex in table.points.items()}
    rings = {name: vertices[ring] for name, ring in table.rings.items()}
    return Landmarks(
        points, rings, levels_of(rings, float(np.ptp(vertices[:, 1].copy()))), dict.fromkeys([*points, *rings], 1.0)
    )


def levels_of(rings: Mapping[str, Float[np.ndarray, "n 3"]], height: float) -> dict[str, float]:
    """Heights about which the girths of a body of that height are searched [cm]: near the means of their rings."""
    above = landmark_table().levels
    return {name: float(rings[name][:, 1].mean()) + above.get(name, 0.0) * height for name in LEVEL_RINGS}


# ------------------------------------------------------------------------------------------------------- given by hand


class _Places(Protocol):
    """What turns positions of a file into ours."""

    def apply(self, points: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 3"]: ...


@dataclass(frozen=True, eq=False)
class GivenLandmarks(Record):
    """LandmarkTable that a person gave, in the mesh's coordinates."""

    points: Mapping[str, Float[np.ndarray, "3"]]
    rings: Mapping[str, Float[np.ndarray, "n 3"]]

    def over(self, found: Landmarks, placing: _Places) -> Landmarks:
        """The landmarks found, with those given in their place."""
        points = {name: placing.apply(at[None])[0] for name, at in self.points.items()}
        rings = {name: placing.apply(ring) for name, ring in self.rings.items()}
        sure = dict.fromkeys([*points, *rings], 1.0)
        return replace(found.moved(points).with_rings(rings), confidence={**found.confidence, **sure})


def read_landmarks(path: Path, vertices: Float[np.ndarray, "v 3"], unit: float) -> GivenLandmarks:
    """The landmarks in a JSON file; ``vertices`` and positions come out times ``unit``. Raises ``BodyError``."""
    table = read_json(path, "map from landmarks to vertex ids or positions", error=BodyError)
    if not isinstance(table, dict):
        raise BodyError(f"{path}: a {type(table).__name__}: give a map from landmarks to vertex ids or positions")
    known = landmark_table()
    for name in table:
        if name not in known.points and name not in known.rings:
            names = ", ".join([*known.points, *known.rings])
            raise BodyError(f"{path}: no landmark is called {shown(name[:40])}: there are {names}")
    points = {name: _position(path, name, at, vertices) * unit for name, at in table.items() if name in known.points}
    rings = {name: _ring(path, name, at, vertices) * unit for name, at in table.items() if name in known.rings}
    return GivenLandmarks(points, rings)


def _ring(path: Path, name: str, value: Any, vertices: np.ndarray) -> Float[np.ndarray, "n 3"]:
    if not isinstance(value, list) or not value:
        raise BodyError(f"{path}: {name} is {_short(value)}: a ring is a list of vertex ids or positions")
    if name not in LEVEL_RINGS and len(value) < 3 and name != "bust_line":
        raise BodyError(f"{path}: {name} has {len(value)} points: its length is a measure, so give them all, in order")
    return np.stack([_position(path, name, at, vertices) for at in value])


def _position(path: Path, name: str, value: Any, vertices: np.ndarray) -> Float[np.ndarray, "3"]:
    if type(value) is int and 0 <= value < len(vertices):
        return vertices[value]
    if not (isinstance(value, list) and len(value) == 3 and all(type(n) in (int, float) for n in value)):
        raise BodyError(f"{path}: {name} is {_short(value)}: give a vertex id under {len(vertices)}, or [x, y, z]")
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    room = OUTSIDE * float((high - low).max())
    if not all(least - room <= n <= most + room for n, least, most in zip(value, low, high, strict=True)):
        raise BodyError(f"{path}: {name} is {_short(value)}, outside of the mesh: give it in the mesh's coordinates")
    return np.array(value, float)


def _short(value: Any) -> str:
    return shown(found(value))
