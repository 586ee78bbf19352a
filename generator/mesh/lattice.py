"""The inside of a panel as a triangular lattice: its triangles follow from the indices, without a search.

Odd rows ``j`` of the lattice are shifted by half a pitch. Between rows ``j`` and ``j + 1`` the triangle ``(j, i, 0)``
points up from the base (j, i), (j, i + 1), and ``(j, i, 1)`` points down to (j, i).
"""

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Self, TypeAlias

import numpy as np
from jaxtyping import Bool, Float, Int

PITCH = 0.97  # lattice spacing over border spacing: the median edge of GarmentCode's meshes
CLEAR_OF_POINT = 0.60  # pitches: least distance of a seed from the border's points
CLEAR_OF_MIDDLE = 0.60  # pitches: least distance of a seed from the midpoints of the border's segments
FAR = 1.27  # pitches from the border beyond which all six triangles are Delaunay: see _certain
CIRCLE = (1 + 1e-6) / 3  # square pitches: the square of the circumradius
ROW = np.sqrt(0.75)  # pitches from row to row

Grid: TypeAlias = tuple[Float[np.ndarray, "2"], tuple[int, int]]
"""Origin [cm], rows and columns of a lattice."""


@dataclass(frozen=True)
class Lattice:
    """Seeds inside a border, and the lattice triangles between them that are Delaunay for any border."""

    number: Int[np.ndarray, "row column"]
    """The seed at each lattice point; -1 for none."""
    filled: Bool[np.ndarray, "row column 2"]
    """Flags of the triangles that are certain to be Delaunay."""
    origin: Float[np.ndarray, "2"]
    pitch: float

    @property
    def size(self) -> int:
        """The number of seeds."""
        return int(self.number.max(initial=-1)) + 1

    @cached_property
    def points(self) -> Float[np.ndarray, "n 2"]:
        """The seeds [cm]."""
        j, i = np.nonzero(self.number >= 0)
        return self.origin + self.pitch * np.stack([i + 0.5 * (j % 2), ROW * j], axis=1)

    @cached_property
    def faces(self) -> Int[np.ndarray, "f 3"]:
        """The filled triangles, counter-clockwise."""
        j, i, down = np.nonzero(self.filled)
        columns = self.number.shape[1]
        first = j * columns + i
        third = first + columns + j % 2
        second, third = np.where(down, (third, third - 1), (first + 1, third))
        return self.number.ravel()[np.stack([first, second, third], axis=1)]

    @cached_property
    def rim(self) -> Int[np.ndarray, " r"]:
        """The seeds on the rim of the filled triangles: corners of fewer than six."""
        return np.flatnonzero(np.bincount(self.faces.ravel(), minlength=self.size) < 6)

    def covers(self, points: Float[np.ndarray, "m 2"]) -> Bool[np.ndarray, " m"]:
        """Flags of the points that lie in a filled triangle."""
        within, triangle = self._triangles_at(points)
        return within & self.filled[triangle]

    def faces_at(self, points: Float[np.ndarray, "m 2"]) -> Int[np.ndarray, " m"]:
        """The row of ``faces`` that holds each point; -1 for points outside all filled triangles."""
        number = np.full(self.filled.shape, -1)
        number[self.filled] = np.arange(np.count_nonzero(self.filled))
        within, triangle = self._triangles_at(points)
        return np.where(within, number[triangle], -1)

    def _triangles_at(
        self, points: Float[np.ndarray, "m 2"]
    ) -> tuple[Bool[np.ndarray, " m"], tuple[Int[np.ndarray, " m"], ...]]:
        """Flags of the points on the lattice, and the index into ``filled`` of the triangle that holds each."""
        row, column = _coordinates(points, self.origin, self.pitch)
        j = np.floor(row).astype(int)
        slant = 0.5 * (row - j)
        along = column - 0.5 * (j % 2)
        left, right = np.floor(along - slant).astype(int), np.floor(along + slant).astype(int)
        rows, columns = self.filled.shape[:2]
        within = (j >= 0) & (j < rows) & (left >= 0) & (right < columns)
        return within, (j % rows, right % columns, (left != right).astype(int))

    def without(self, points: Float[np.ndarray, "m 2"]) -> Self:
        """The lattice without the triangles that have one of these points in their circumcircle."""
        row, column = _coordinates(points, self.origin, self.pitch)
        j = np.floor(row).astype(int)[:, None, None] + np.arange(-1, 2)[:, None]
        shift = 0.5 * (j % 2)
        i = np.floor(column[:, None, None] - shift).astype(int) + np.arange(-1, 2)
        filled = self.filled.copy()
        for down, (along, up) in enumerate(((1 / 2, 1 / 3), (0, 2 / 3))):
            square = (i + along + shift - column[:, None, None]) ** 2 + (ROW * (j + up - row[:, None, None])) ** 2
            inside = square < CIRCLE
            filled[np.broadcast_to(j, i.shape)[inside], i[inside], down] = False
        return replace(self, filled=filled)


def build_lattice(
    border: Float[np.ndarray, "n 2"],
    spacing: float,
    *,
    after: Int[np.ndarray, " n"] | None = None,
    grid: Grid | None = None,
) -> Lattice:
    """The seeds inside a counter-clockwise loop of points at most ``spacing`` [cm] apart.

    ``after``: the next point of each, if there are several loops. ``grid``: the lattice's origin [cm], rows and
    columns; by default over the border, symmetric about the middle of its width.
    """
    pitch = PITCH * spacing
    origin, shape = grid or _grid(border, pitch)
    ahead = np.roll(border, -1, axis=0) if after is None else border[after]
    inside = _inside(border, ahead, origin, pitch, shape)
    clear, far = _clearances(border, ahead, origin, pitch, shape)
    kept = inside & clear
    number = np.where(kept, np.cumsum(kept).reshape(shape) - 1, -1)
    return Lattice(number, _certain(kept, far), origin, pitch)


def lattice_size(border: Float[np.ndarray, "n 2"], spacing: float) -> int:
    """Number of lattice points over the bounding box of a border."""
    _, (rows, columns) = _grid(border, PITCH * spacing)
    return rows * columns


def _grid(border: Float[np.ndarray, "n 2"], pitch: float) -> Grid:
    """Origin [cm] and (rows, columns) of a lattice over the border, symmetric about the middle of its width."""
    low, high = border.min(axis=0), border.max(axis=0)
    columns, rows = np.ceil(0.5 * (high - low) / pitch / (1.0, ROW)).astype(int) + 2
    origin = 0.5 * (low + high) - pitch * np.array([columns, ROW * rows])
    return origin, (2 * int(rows) + 1, 2 * int(columns) + 1)


def _coordinates(
    points: Float[np.ndarray, "n 2"], origin: Float[np.ndarray, "2"], pitch: float
) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"]]:
    """Row and (unshifted) column of points, as real numbers."""
    column, row = ((points - origin) / pitch / (1.0, ROW)).T
    return row, column


def _inside(
    border: Float[np.ndarray, "n 2"],
    ahead: Float[np.ndarray, "n 2"],
    origin: Float[np.ndarray, "2"],
    pitch: float,
    shape: tuple[int, int],
) -> Bool[np.ndarray, "row column"]:
    """Flags of the lattice points inside the loop, by the parity of crossed segments along each row."""
    row, column = _coordinates(border, origin, pitch)
    row_next, column_next = _coordinates(ahead, origin, pitch)
    first = np.ceil(np.minimum(row, row_next)).astype(int)
    crossed = np.ceil(np.maximum(row, row_next)).astype(int) - first
    segment = np.repeat(np.arange(len(border)), crossed)
    j = first[segment] + np.arange(len(segment)) - np.repeat(np.cumsum(crossed) - crossed, crossed)
    share = (j - row[segment]) / (row_next[segment] - row[segment])
    at = column[segment] + share * (column_next[segment] - column[segment])
    cell = j * shape[1] + np.ceil(at - 0.5 * (j % 2)).astype(int)
    passed = np.bincount(cell, minlength=shape[0] * shape[1]).reshape(shape) % 2 == 1
    return np.logical_xor.accumulate(passed, axis=1)


def _clearances(
    border: Float[np.ndarray, "n 2"],
    ahead: Float[np.ndarray, "n 2"],
    origin: Float[np.ndarray, "2"],
    pitch: float,
    shape: tuple[int, int],
) -> tuple[Bool[np.ndarray, "row column"], Bool[np.ndarray, "row column"]]:
    """Flags of the lattice points that are clear of the border, and of those further than ``FAR`` from it."""
    midpoints = 0.5 * (border + ahead)
    row, column = _coordinates(np.concatenate([border, midpoints]), origin, pitch)
    radius = np.repeat([CLEAR_OF_POINT, CLEAR_OF_MIDDLE], len(border))
    # The nearest row and column and their neighbours suffice: all others are at least 1.299 pitches away.
    j = np.rint(row).astype(int)[:, None, None] + np.arange(-1, 2)[:, None]
    shift = 0.5 * (j % 2)
    i = np.rint(column[:, None, None] - shift).astype(int) + np.arange(-1, 2)
    square = (i + shift - column[:, None, None]) ** 2 + (ROW * (j - row[:, None, None])) ** 2
    j = np.broadcast_to(j, i.shape)
    clear, far = np.ones(shape, bool), np.ones(shape, bool)
    near = square < radius[:, None, None] ** 2
    clear[j[near], i[near]] = False
    near = square < FAR**2
    far[j[near], i[near]] = False
    return clear, far


def _certain(
    kept: Bool[np.ndarray, "row column"], far: Bool[np.ndarray, "row column"]
) -> Bool[np.ndarray, "row column 2"]:
    """Flags of the lattice triangles that stay Delaunay whatever the border.

    A border point in the circumcircle of a triangle is within 1.155 pitches of all its corners, and a border segment
    that passes through the triangle has an end or its midpoint within 1.26 pitches. So one far corner is enough.
    """
    here, right, above, before = _neighbours(kept)
    filled = np.stack([here & right & above, here & above & before], axis=2)
    here, right, above, before = _neighbours(far)
    return filled & np.stack([here | right | above, here | above | before], axis=2)


def _neighbours(flag: Bool[np.ndarray, "row column"]) -> tuple[Bool[np.ndarray, "_ _"], ...]:
    """A flag of the lattice points at each point, at the next in its row, and at the two above: right, then left."""
    upper = flag[1:]
    before = np.roll(upper, 1, axis=1)  # the column that wraps round is outside every border
    odd = np.arange(len(upper))[:, None] % 2 == 1
    above, before = (np.where(odd, a, b)[:, :-1] for a, b in ((np.roll(upper, -1, axis=1), upper), (upper, before)))
    return flag[:-1, :-1], flag[:-1, 1:], above, before
