"""Triangulate an outline without adding a point to it.

The inside is a triangular lattice. Where a triangle is too long or too sharp, its circumcentre becomes a seed, as in
Delaunay refinement (Chew, 1993; Ruppert, 1995), except that no border segment is ever split: the other side of the seam
has its points already. The work is done by the kernels of ``filling``.
"""

import threading
from dataclasses import dataclass
from math import ceil
from typing import TypeAlias

import numpy as np
import shapely
from jaxtyping import Float, Int

from gcd_dataset.errors import MeshError

LONGEST = 1.43  # spacings: the longest edge, as in GarmentCode's boxmeshgen.py
SHARPEST = np.radians(25.0)  # refinement's target angle; termination is proved up to 20.7° (Ruppert)
PITCH = 0.97  # lattice spacing over border spacing: the median edge of GarmentCode's meshes
ROW = 0.75**0.5  # pitches from row to row of the lattice
MARGIN = 2  # rows and columns of the lattice on each side of an outline
ROOM = 1.5  # times the present need: buffers are made so much larger


@dataclass(frozen=True)
class Quality:
    """The triangles that refinement splits, if there is room."""

    longest: float = LONGEST
    """Spacings: triangles with a longer edge are split."""
    sharpest: float = SHARPEST
    """Triangles with a sharper angle are split [rad]."""


FINE = Quality()

Filling: TypeAlias = tuple[Float[np.ndarray, "m 2"], Int[np.ndarray, "f 3"]]
"""Points [cm] and triangles."""

Fillings: TypeAlias = dict[tuple[bytes, float], Filling]
"""Seeds and triangles of outlines, by the bytes of their points and the spacing."""


def fill_outline(border: Float[np.ndarray, "n 2"], spacing: float, cache: Fillings) -> Filling:
    """Points of a closed loop, then seeds inside it [cm], and triangles with the winding of the loop.

    A clockwise loop is filled as its mirror image, so that a back has the mesh of the front it mirrors. ``cache`` holds
    the outlines filled so far: a left panel often is the mirror image of the right one to the last bit. Raises
    ``MeshError`` as ``Triangulator.fill`` does.
    """
    mirror = np.array([1.0 if shapely.LinearRing(border).is_ccw else -1.0, 1.0])
    outline = border * mirror + 0.0  # no -0.0: the bytes are the cache's key
    key = (outline.tobytes(), spacing)
    if key not in cache:
        cache[key] = triangulator().fill(outline, spacing)
    seeds, faces = cache[key]
    return np.concatenate([border, seeds * mirror]), faces


def lattice_size(border: Float[np.ndarray, "n 2"], spacing: float) -> int:
    """Number of lattice points over the bounding box of a border."""
    _, rows, columns = _lattice(border, spacing)
    return rows * columns


def _lattice(border: Float[np.ndarray, "n 2"], spacing: float) -> tuple[tuple[float, float], int, int]:
    """Origin [cm], rows and columns of a lattice over a border, symmetric about the middle of its width."""
    step_x, step_y = PITCH * spacing, PITCH * spacing * ROW
    (left, low), (right, high) = border.min(axis=0).tolist(), border.max(axis=0).tolist()
    i, j = (ceil(0.5 * extent) + MARGIN for extent in ((right - left) / step_x, (high - low) / step_y))
    return (0.5 * (left + right) - i * step_x, 0.5 * (low + high) - j * step_y), 2 * j + 1, 2 * i + 1


_own = threading.local()


def triangulator() -> "Triangulator":
    """The triangulator of this thread."""
    if not hasattr(_own, "triangulator"):
        _own.triangulator = Triangulator()
    triangulator: Triangulator = _own.triangulator
    return triangulator


class Triangulator:
    """Fills outlines, one after the other, in buffers that it keeps."""

    def __init__(self) -> None:
        from gcd_dataset.generator.device import launch_lock, load_kernels  # not before the first panel: imports Warp
        from gcd_dataset.generator.mesh import filling

        load_kernels("meshes", filling, device="cpu")
        self._kernels, self._lock = filling, launch_lock
        self._room = (0, 0)

    def fill(self, border: Float[np.ndarray, "n 2"], spacing: float, quality: Quality = FINE) -> Filling:
        """Seeds [cm] inside a closed counter-clockwise loop of points, and the triangles over border and seeds.

        The points of the loop are at most ``spacing`` [cm] apart and keep the numbers 0 … n-1; the seeds follow.
        Triangles are counter-clockwise, and every segment of the loop is an edge of exactly one triangle. Raises
        ``MeshError`` where the loop touches itself.
        """
        n, (origin, rows, columns) = len(border), _lattice(border, spacing)
        with self._lock:
            self._make_room(2 * n + rows * columns, rows * columns)
            self._views["points"][:n] = border
            self._views["size"][:] = n, rows, columns, rows, 0
            self._views["option"][:] = *origin, spacing, quality.longest, quality.sharpest
            self._fill.launch()
        size, count = self._views["size"][:2].tolist()
        if count < 0:
            x, y = self._views["points"][-1 - count]
            raise MeshError(f"the outline touches itself near ({x:.2f}, {y:.2f}) cm: move its edges apart")
        return self._views["points"][n:size].copy(), self._views["faces"][:count].astype(int)

    def holding(self, queries: Float[np.ndarray, "k 2"]) -> Int[np.ndarray, " k"]:
        """The triangle of the last outline that holds each point, or the one that it lies least beyond."""
        with self._lock:
            if len(queries) > len(self._asked):
                self._make_room_for_queries(int(ROOM * len(queries)))
            self._asked[: len(queries)] = queries
            self._views["size"][4] = len(queries)
            self._find.launch()
        return self._found[: len(queries)].astype(int)

    def _make_room(self, points: int, cells: int) -> None:
        """Buffers for so many points and lattice points."""
        import warp as wp

        if points <= self._room[0] and cells <= self._room[1]:
            return
        self._room = p, cells = int(ROOM * max(points, self._room[0])), int(ROOM * max(cells, self._room[1]))
        f = 2 * p  # a triangulation of p points has fewer triangles
        # In the order of the kernel's arguments.
        shapes = {"points": p, "faces": (f, 3), "beside": (f, 3), "touching": p, "seen": f, "fresh": f, "work": f}
        shapes |= {"ring": (f, 3), "cells": cells, "poor": f, "radius": f, "centre": f, "size": 5, "option": 5}
        types = {"points": wp.vec2d, "centre": wp.vec2d, "radius": wp.float64, "option": wp.float64}
        # A recorded launch does not keep its arrays.
        self._buffers = {
            name: wp.empty(shape, dtype=types.get(name, wp.int32), device="cpu") for name, shape in shapes.items()
        }
        self._views = {name: self._buffers[name].numpy() for name in ("points", "faces", "size", "option")}
        self._fill = wp.launch(self._kernels.fill, 1, [*self._buffers.values()], device="cpu", record_cmd=True)
        self._make_room_for_queries(p)

    def _make_room_for_queries(self, count: int) -> None:
        import warp as wp

        mesh = [self._buffers[name] for name in ("points", "faces", "beside", "touching", "cells", "size", "option")]
        self._queries = [wp.empty(count, dtype=kind, device="cpu") for kind in (wp.vec2d, wp.int32)]
        self._asked, self._found = (buffer.numpy() for buffer in self._queries)
        self._find = wp.launch(self._kernels.find, 1, [*mesh, *self._queries], device="cpu", record_cmd=True)


def flat_areas(corners: Float[np.ndarray, "f 3 2"]) -> Float[np.ndarray, " f"]:
    """Signed areas of flat triangles, positive for counter-clockwise ones [cm²]."""
    (ax, ay), (bx, by) = (corners[:, 1] - corners[:, 0]).T, (corners[:, 2] - corners[:, 0]).T
    return np.asarray(0.5 * (ax * by - ay * bx))


def barycentric(
    points: Float[np.ndarray, "m 2"], triangles: Int[np.ndarray, "n 3"], queries: Float[np.ndarray, "n 2"]
) -> Float[np.ndarray, "3 n"]:
    """The barycentric weights of each query point in its triangle of ``points``."""
    (ax, bx, cx), (ay, by, cy) = (np.ascontiguousarray(axis)[triangles.T] for axis in points.T)
    bx, by, cx, cy = bx - ax, by - ay, cx - ax, cy - ay
    x, y, area = queries[:, 0] - ax, queries[:, 1] - ay, bx * cy - by * cx
    second, third = (x * cy - y * cx) / area, (bx * y - by * x) / area
    return np.stack([1 - second - third, second, third])
