"""Landmarks on one body: points and rings by name, with a confidence for each.

A user may give landmarks in a JSON file such as ``{"shoulder_right": 1557, "waist": [[0.12, 1.08, 0.03]]}``: a point is
a vertex id or a position in the coordinates of the mesh file, a ring a list of them.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Self

import numpy as np
from jaxtyping import Float

from gcd_dataset.errors import BodyError, shown
from gcd_dataset.generator.body.asset import landmark_table
from gcd_dataset.jsonfile import found, read_json, whole
from gcd_dataset.records import Record

LEVEL_RINGS = ("bust", "underbust", "waist", "hips", "leg_right")
"""Rings used for their mean height alone: the level of a girth."""
OUTSIDE = 0.05  # largest distance of a landmark from the mesh's bounding box, as a share of the box's size


@dataclass(frozen=True, eq=False)
class Landmarks(Record):
    """Landmarks as positions on the skin, by the names in ``data/landmarks.json``."""

    points: Mapping[str, Float[np.ndarray, "3"]]
    """[cm]"""
    rings: Mapping[str, Float[np.ndarray, "n 3"]]
    """Points along closed rings and open lines, in order [cm]; a ring of ``LEVEL_RINGS`` may have one point."""
    levels: Mapping[str, float]
    """Heights at which the search for each girth is centred [cm]."""
    confidence: Mapping[str, float]
    """By the name of a point or ring: 1 for known landmarks, down to 0 for unreliable ones."""

    def with_rings(self, rings: Mapping[str, Float[np.ndarray, "n 3"]]) -> Self:
        """The landmarks with some rings replaced, and the levels that follow from them."""
        means = {name: float(ring[:, 1].mean()) for name, ring in rings.items() if name in self.levels}
        return replace(self, rings={**self.rings, **rings}, levels={**self.levels, **means})


def model_landmarks(vertices: Float[np.ndarray, "v 3"]) -> Landmarks:
    """The landmarks of a body with the model's mesh, by vertex id."""
    table = landmark_table()
    points = {name: vertices[vertex] for name, vertex in table.points.items()}
    rings = {name: vertices[ring] for name, ring in table.rings.items()}
    return Landmarks(
        points, rings, levels_of(rings, float(np.ptp(vertices[:, 1].copy()))), dict.fromkeys([*points, *rings], 1.0)
    )


def levels_of(rings: Mapping[str, Float[np.ndarray, "n 3"]], height: float) -> dict[str, float]:
    """Centre of the search for each girth [cm]: the mean height of its ring plus a share of the body's height."""
    above = landmark_table().levels
    return {name: float(rings[name][:, 1].mean()) + above.get(name, 0.0) * height for name in LEVEL_RINGS}


@dataclass(frozen=True, eq=False)
class GivenLandmarks(Record):
    """Landmarks given by a user, in the mesh file's coordinates."""

    points: Mapping[str, Float[np.ndarray, "3"]]
    rings: Mapping[str, Float[np.ndarray, "n 3"]]

    def override(self, found: Landmarks, placed: Callable[[np.ndarray], np.ndarray]) -> Landmarks:
        """The found landmarks, replaced by the given ones, with confidence 1.

        ``placed`` maps points (n, 3) in the mesh file's coordinates to the measured body's [cm].
        """
        points = {name: placed(at[None])[0] for name, at in self.points.items()}
        rings = {name: placed(ring) for name, ring in self.rings.items()}
        certain = dict.fromkeys([*points, *rings], 1.0)
        return replace(
            found.with_rings(rings), points={**found.points, **points}, confidence={**found.confidence, **certain}
        )


def read_landmarks(path: Path, vertices: Float[np.ndarray, "v 3"]) -> GivenLandmarks:
    """The landmarks in a JSON file; ``vertices``: the mesh. Raises ``BodyError`` with the file and the bad entry."""
    table = read_json(path, "map from landmarks to vertex ids or positions", error=BodyError)
    if not isinstance(table, dict):
        raise BodyError(f"{path}: a {type(table).__name__}: give a map from landmarks to vertex ids or positions")
    known = landmark_table()
    for name in table:
        if name not in known.points and name not in known.rings:
            names = ", ".join([*known.points, *known.rings])
            raise BodyError(f"{path}: no landmark is called {shown(name[:40])}: there are {names}")
    points = {name: _position(path, name, at, vertices) for name, at in table.items() if name in known.points}
    rings = {name: _ring(path, name, at, vertices) for name, at in table.items() if name in known.rings}
    return GivenLandmarks(points, rings)


def _ring(path: Path, name: str, value: Any, vertices: np.ndarray) -> Float[np.ndarray, "n 3"]:
    if not isinstance(value, list) or not value:
        raise BodyError(f"{path}: {name} is {_short(value)}: a ring is a list of vertex ids or positions")
    if name not in LEVEL_RINGS and len(value) < 3 and name != "bust_line":
        raise BodyError(f"{path}: {name} has {len(value)} points: its length is a measure, so give them all, in order")
    return np.stack([_position(path, name, at, vertices) for at in value])


def _position(path: Path, name: str, value: Any, vertices: np.ndarray) -> Float[np.ndarray, "3"]:
    if (vertex := whole(value)) is not None and 0 <= vertex < len(vertices):
        return vertices[vertex]
    if not (isinstance(value, list) and len(value) == 3 and all(type(n) in (int, float) for n in value)):
        raise BodyError(f"{path}: {name} is {_short(value)}: give a vertex id under {len(vertices)}, or [x, y, z]")
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    room = OUTSIDE * float((high - low).max())
    if not all(least - room <= n <= most + room for n, least, most in zip(value, low, high, strict=True)):
        raise BodyError(f"{path}: {name} is {_short(value)}, outside the mesh: give it in the mesh's coordinates")
    return np.array(value, float)


def _short(value: Any) -> str:
    return shown(found(value))
