"""Triangulate an outline without adding a point to it.

The inside is a triangular lattice; Qhull triangulates only the strip between lattice and border. Where a triangle of
the strip is too long or too sharp, its circumcentre becomes a seed, as in Delaunay refinement (Chew, 1993; Ruppert,
1995), except that no border segment is ever split: the other side of the seam has its points already.
"""

from collections import deque
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Self, TypeAlias

import numpy as np
import shapely
from jaxtyping import Bool, Float, Int
from scipy.spatial import Delaunay, cKDTree
from scipy.spatial.distance import cdist

from gcd_dataset.errors import MeshError
from gcd_dataset.generator.mesh.lattice import Lattice, build_lattice

LONGEST = 1.43  # spacings: the longest edge, as in GarmentCode's boxmeshgen.py
SHARPEST = np.radians(25.0)  # refinement's target angle; termination is proved up to 20.7° (Ruppert)
ROUNDS = 10  # rounds of refinement; a seam gathered to a third of the spacing takes four
EMPTY = 0.99  # circumradii: least distance of a new seed from all older points
APART = 0.8  # circumradii: least distance between new seeds of one round
SAME_AREA = 1e-9  # relative: tolerance of the test that triangles neither overlap nor leave a hole
JITTER = 1e-6  # spacings: shift of each point before Qhull


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
    ``MeshError`` as ``triangulate`` does.
    """
    mirror = np.array([1.0 if shapely.LinearRing(border).is_ccw else -1.0, 1.0])
    outline = border * mirror + 0.0  # no -0.0: the bytes are the cache's key
    key = (outline.tobytes(), spacing)
    if key not in cache:
        cache[key] = triangulate(outline, spacing)
    seeds, faces = cache[key]
    return np.concatenate([border, seeds * mirror]), faces


def triangulate(border: Float[np.ndarray, "n 2"], spacing: float) -> Filling:
    """Seeds [cm] inside a closed counter-clockwise loop of points, and the triangles over border and seeds.

    The points of the loop are at most ``spacing`` [cm] apart and keep the numbers 0 … n-1; the seeds follow. Triangles
    are counter-clockwise, and every segment of the loop is an edge of exactly one triangle. Raises ``MeshError`` where
    the loop touches itself.
    """
    return triangulate_loops(
        Loops.numbered(border, np.zeros(len(border), int)), spacing, build_lattice(border, spacing)
    ).filling


@dataclass(frozen=True)
class Loops:
    """Closed counter-clockwise loops of points in one plane, apart from each other."""

    points: Float[np.ndarray, "n 2"]
    """[cm]"""
    after: Int[np.ndarray, " n"]
    """The next point on the loop of each point."""
    number: Int[np.ndarray, " n"]
    """The loop of each point, ascending."""

    @classmethod
    def numbered(cls, points: Float[np.ndarray, "n 2"], number: Int[np.ndarray, " n"]) -> Self:
        """Loops of the points with the same number, which are consecutive and in the order of the loop."""
        after = np.arange(1, len(points) + 1)
        last = np.flatnonzero(np.diff(number, append=-1))
        after[last] = np.concatenate([[0], last[:-1] + 1])
        return cls(points, after, number)


@dataclass(frozen=True)
class Triangulated:
    """Triangulated loops."""

    strip: "_Strip"
    strip_faces: Int[np.ndarray, "g 3"]
    """The triangles between loops and lattice."""

    @property
    def lattice(self) -> Lattice:
        """The lattice; its filled triangles follow those of the strip."""
        return self.strip.lattice

    @property
    def points(self) -> Float[np.ndarray, "m 2"]:
        """The points of the loops, then seeds: of the lattice, then of the refinement [cm]."""
        return self.strip.points

    @cached_property
    def faces(self) -> Int[np.ndarray, "f 3"]:
        """The triangles, counter-clockwise: of the strip, then of the lattice."""
        return np.concatenate([self.strip_faces, len(self.strip.border) + self.lattice.faces])

    @property
    def filling(self) -> Filling:
        """Seeds and triangles."""
        return self.points[len(self.strip.border) :], self.faces


def triangulate_loops(loops: Loops, spacing: float, lattice: Lattice, quality: Quality = FINE) -> Triangulated:
    """As ``triangulate``, for loops that share a lattice: Qhull runs once for all of them."""
    strip = _Strip.of(loops, spacing, lattice, quality)
    faces = fresh = strip.faces()
    for _ in range(ROUNDS):
        seeds = strip.refinement_seeds(fresh)  # unchanged triangles had no room for a seed in the last round either
        if not len(seeds):
            break
        strip, opened = strip.with_seeds(seeds)
        faces, fresh = strip.refined(len(seeds), np.concatenate([faces, opened]))
    return Triangulated(strip, faces)


@dataclass(frozen=True)
class _Strip:
    """The strip between closed loops and the filled triangles of the lattice inside them."""

    loops: Loops
    spacing: float
    lattice: Lattice
    quality: Quality
    points: Float[np.ndarray, "m 2"]  # border, lattice and seeds that refinement has added, in this order [cm]
    jittered: Float[np.ndarray, "m 2"]  # the points as Qhull sees them; all orientation tests use these
    rim: Int[np.ndarray, " r"]  # the points on the rim of the lattice's filled triangles

    @classmethod
    def of(cls, loops: Loops, spacing: float, lattice: Lattice, quality: Quality) -> Self:
        """The strip without added seeds."""
        points = np.concatenate([loops.points, lattice.points])
        jittered = _jittered(points, JITTER * spacing)
        return cls(loops, spacing, lattice, quality, points, jittered, len(loops.points) + lattice.rim)

    @property
    def border(self) -> Float[np.ndarray, "n 2"]:
        """The points of the loops [cm]."""
        return self.loops.points

    @cached_property
    def outline(self) -> shapely.MultiPolygon:
        rings = shapely.linearrings(self.jittered[: len(self.border)], indices=self.loops.number)
        outline = shapely.multipolygons(shapely.polygons(rings))
        shapely.prepare(outline)
        return outline

    @cached_property
    def corners(self) -> Int[np.ndarray, " k"]:
        """The points that can be corners of the strip's triangles."""
        n, m = len(self.border), len(self.points)
        return np.concatenate([np.arange(n), self.rim, np.arange(n + self.lattice.size, m)])

    def with_seeds(self, seeds: Float[np.ndarray, "k 2"]) -> tuple["_Strip", Int[np.ndarray, "o 3"]]:
        """The strip with more seeds, widened by the lattice triangles that they invalidate; and these triangles."""
        lattice = self.lattice.without(seeds)
        opened = len(self.border) + replace(lattice, filled=self.lattice.filled & ~lattice.filled).faces
        wider = replace(
            self,
            lattice=lattice,
            points=np.concatenate([self.points, seeds]),
            jittered=np.concatenate([self.jittered, _jittered(seeds, JITTER * self.spacing, first=len(self.points))]),
            rim=np.union1d(self.rim, opened),
        )
        return wider, opened

    def refined(self, seeds: int, old: Int[np.ndarray, "f 3"]) -> tuple[Int[np.ndarray, "g 3"], Int[np.ndarray, "h 3"]]:
        """The triangles of the strip, and the subset that its newest seeds have created.

        ``seeds``: their number. ``old``: the triangles of the strip without them. Incremental insertion (Bowyer, 1981;
        Watson, 1981): a seed removes the triangles with the seed in their circumcircle and creates triangles among
        their corners, all with the seed as a corner. Over a slit this fails; the strip is then triangulated anew.
        """
        first_seed = len(self.points) - seeds
        centres, radii, _, _ = _circumcircles(self.jittered[old])
        removed = (cdist(self.jittered[first_seed:], centres) < radii).any(axis=0)
        corners = np.append(np.unique(old[removed]), np.arange(first_seed, len(self.points)))
        fresh = _counter_clockwise(self.jittered, corners[Delaunay(self.jittered[corners]).simplices])
        fresh = fresh[fresh.max(axis=1) >= first_seed]
        updated = np.concatenate([old[~removed], fresh])
        area, removed_area = (flat_areas(self.jittered[faces]).sum() for faces in (fresh, old[removed]))
        if np.isclose(area, removed_area, rtol=SAME_AREA, atol=0.0) and has_segments(updated, self.loops.after):
            return updated, fresh
        anew = self.faces()
        return anew, anew

    def faces(self) -> Int[np.ndarray, "f 3"]:
        """The constrained Delaunay triangles of the strip, counter-clockwise."""
        faces = _counter_clockwise(self.jittered, self.corners[Delaunay(self.jittered[self.corners]).simplices])
        faces = faces[~self.lattice.covers(_centroids(self.jittered, faces))]
        faces = restore_segments(self.jittered, faces, self.loops.after)
        return faces[self._inside(faces)]

    def _inside(self, faces: Int[np.ndarray, "f 3"]) -> Bool[np.ndarray, " f"]:
        """Flags of the triangles inside the outline; every segment of the outline is an edge of a triangle."""
        inside = np.maximum(np.maximum(faces[:, 0], faces[:, 1]), faces[:, 2]) >= len(self.border)
        on_border = np.flatnonzero(~inside)  # all three corners
        start, after = faces[on_border], self.loops.after
        end = start[:, [1, 2, 0]]
        along, against = (after[start] == end).any(axis=1), (after[end] == start).any(axis=1)
        inside[on_border] = along
        unsure = on_border[~along & ~against]
        inside[unsure] = shapely.contains_xy(self.outline, *_centroids(self.jittered, faces[unsure]).T)
        return inside

    def refinement_seeds(self, faces: Int[np.ndarray, "f 3"]) -> Float[np.ndarray, "k 2"]:
        """Circumcentres of triangles that are too long or too sharp, where there is room for a seed [cm]."""
        centres, radii, shortest, longest = _circumcircles(self.jittered[faces])
        sharp = 2 * np.sin(self.quality.sharpest) * radii > shortest
        poor = (longest > self.quality.longest * self.spacing) | sharp
        if not poor.any():
            return centres[:0]
        poor[poor] = shapely.contains_xy(self.outline, *centres[poor].T)
        # A point encroaches on a segment that it sees under more than a right angle (Ruppert, 1995).
        ahead = self.border[self.loops.after]
        half = 0.5 * np.linalg.norm(ahead - self.border, axis=1)
        poor[poor] = (cdist(centres[poor], 0.5 * (self.border + ahead)) >= half).all(axis=1)
        if poor.any():  # over a slit, some circumcircles hold points
            nearest, _ = cKDTree(self.points[self.corners], balanced_tree=False).query(centres[poor])
            poor[poor] = nearest > EMPTY * radii[poor]
        return centres[poor][_spaced_out(centres[poor], radii[poor])]


def _centroids(points: Float[np.ndarray, "m 2"], faces: Int[np.ndarray, "f 3"]) -> Float[np.ndarray, "f 2"]:
    return (points[faces[:, 0]] + points[faces[:, 1]] + points[faces[:, 2]]) / 3  # a third of the time of ``mean``


def _jittered(points: Float[np.ndarray, "m 2"], by: float, *, first: int = 0) -> Float[np.ndarray, "m 2"]:
    """The points, each shifted by a different tiny vector, so that no three are collinear and no four cocircular.

    Ties between rows of equal triangles triple Qhull's time (measured), and a degenerate triangle between points of a
    straight edge lies on neither side of it. ``first``: the number of the first point.
    """
    square = (
        np.arange(first, first + len(points))[:, None] ** 2.0
    )  # a linear sequence would keep equally spaced points collinear
    return points + by * (square * (np.sqrt(2), np.sqrt(3)) % 1.0 - 0.5)


def _counter_clockwise(points: Float[np.ndarray, "m 2"], faces: Int[np.ndarray, "f 3"]) -> Int[np.ndarray, "f 3"]:
    """The triangles with their corners in counter-clockwise order."""
    turn = _orientation(*points[faces].transpose(1, 2, 0))
    return np.where(turn[:, None] < 0, faces[:, ::-1], faces)


def flat_areas(corners: Float[np.ndarray, "f 3 2"]) -> Float[np.ndarray, " f"]:
    """Signed areas of flat triangles, positive for counter-clockwise ones [cm²]."""
    (ax, ay), (bx, by) = (corners[:, 1] - corners[:, 0]).T, (corners[:, 2] - corners[:, 0]).T
    return np.asarray(0.5 * (ax * by - ay * bx))


def _circumcircles(
    corners: Float[np.ndarray, "f 3 2"],
) -> tuple[Float[np.ndarray, "f 2"], Float[np.ndarray, " f"], Float[np.ndarray, " f"], Float[np.ndarray, " f"]]:
    """Centre, radius, shortest and longest side of each triangle [cm]."""
    (ax, ay), (bx, by), (cx, cy) = corners.transpose(1, 2, 0)
    bx, by, cx, cy = bx - ax, by - ay, cx - ax, cy - ay
    bb, cc = bx * bx + by * by, cx * cx + cy * cy
    twice = 2 * (bx * cy - by * cx)
    x, y = (cy * bb - by * cc) / twice, (bx * cc - cx * bb) / twice
    across = (cx - bx) ** 2 + (cy - by) ** 2
    shortest, longest = (np.sqrt(least(least(bb, cc), across)) for least in (np.minimum, np.maximum))
    return np.stack([ax + x, ay + y], axis=1), np.hypot(x, y), shortest, longest


def _spaced_out(points: Float[np.ndarray, "k 2"], radii: Float[np.ndarray, " k"]) -> Int[np.ndarray, " n"]:
    """Indices of points at least ``APART`` of their radius from each other, chosen greedily by decreasing radius."""
    order = np.lexsort((points[:, 1], points[:, 0], -radii))
    if not len(order):
        return order
    pairs = cKDTree(points[order]).query_pairs(APART * radii.max(), output_type="ndarray")
    first, second = np.sort(pairs, axis=1).T
    reach = APART * radii[order[second]]
    close = np.linalg.norm(points[order[first]] - points[order[second]], axis=1) < reach
    first, second = first[close], second[close]
    open_, chosen = np.ones(len(order), bool), np.zeros(len(order), bool)
    while open_.any():
        beaten = np.zeros(len(order), bool)
        beaten[second[open_[first] & open_[second]]] = True
        best = open_ & ~beaten
        chosen |= best
        open_ &= ~best
        open_[second[best[first]]] = False
        open_[first[best[second]]] = False
    return order[chosen]


ROUNDING = 1e-9  # rad: either diagonal of four points on one circle is legal


def restore_segments(
    points: Float[np.ndarray, "m 2"], faces: Int[np.ndarray, "f 3"], after: Int[np.ndarray, " n"]
) -> Int[np.ndarray, "f 3"]:
    """The constrained Delaunay triangles: every segment (i, after[i]) of the loops is one of their edges.

    Flips the edges that cross a missing segment (Sloan, A fast algorithm for generating constrained Delaunay
    triangulations, 1993), then the edges that violate Delaunay's criterion. Segments are rarely missing: only along
    slits narrower than the spacing of their points.
    Raises ``MeshError`` where a loop touches itself.
    """
    missing = np.flatnonzero(~_present_segments(faces, after))
    if not len(missing):
        return faces
    faces = faces.copy()
    for start in missing:
        _restore(points, faces, int(start), int(after[start]))
    while _flip_illegal(points, faces, after):
        pass
    lost = np.flatnonzero(~_present_segments(faces, after))  # a corner lies on a segment, or two segments cross
    if len(lost):
        raise _touch_error(points[lost[0]])
    return faces


def has_segments(faces: Int[np.ndarray, "f 3"], after: Int[np.ndarray, " n"]) -> bool:
    """Whether every segment (i, after[i]) of the loops is an edge of a triangle."""
    return bool(_present_segments(faces, after).all())


def _present_segments(faces: Int[np.ndarray, "f 3"], after: Int[np.ndarray, " n"]) -> Bool[np.ndarray, " n"]:
    """Flags of the loops' segments that are edges of triangles, in either direction."""
    start, end = faces.ravel(), faces[:, [1, 2, 0]].ravel()
    on_border = np.flatnonzero(np.maximum(start, end) < len(after))
    start, end = start[on_border], end[on_border]
    present = np.zeros(len(after), bool)
    present[start[after[start] == end]] = True
    present[end[after[end] == start]] = True
    return present


def _restore(points: Float[np.ndarray, "m 2"], faces: Int[np.ndarray, "f 3"], a: int, b: int) -> None:
    """Flip edges in place until (a, b) is an edge."""
    crossing = deque(_crossing_edges(points, faces, a, b))
    for _ in range(len(crossing) ** 2 + len(crossing) + 1):  # Sloan's queue empties well before
        if not crossing:
            return
        u, v = crossing.popleft()
        (f, g), (p, q) = _adjacent_faces(faces, u, v)
        if _orientation(points[p], points[q], points[u]) * _orientation(points[p], points[q], points[v]) >= 0:
            crossing.append((u, v))  # the quadrilateral is not convex: no flip yet
            continue
        faces[f], faces[g] = (p, u, q), (q, v, p)
        if {p, q} != {a, b} and _segments_cross(points, (p, q), (a, b)):
            crossing.append((p, q))
    raise _touch_error(points[a])


def _touch_error(point: Float[np.ndarray, "2"]) -> MeshError:
    x, y = point
    return MeshError(f"the outline touches itself near ({x:.2f}, {y:.2f}) cm: move its edges apart")


def _crossing_edges(
    points: Float[np.ndarray, "m 2"], faces: Int[np.ndarray, "f 3"], a: int, b: int
) -> list[tuple[int, int]]:
    """The edges that cross the segment (a, b), each once."""
    u, v = faces.ravel(), np.roll(faces, -1, axis=1).ravel()
    once = u < v
    u, v = u[once], v[once]
    side_u, side_v = (_orientation(points[a], points[b], points[end].T) for end in (u, v))
    side_a, side_b = (_orientation(points[u].T, points[v].T, points[end]) for end in (a, b))
    apart = (u != a) & (u != b) & (v != a) & (v != b)
    crossing = apart & (side_u * side_v < 0) & (side_a * side_b < 0)
    return list(zip(u[crossing].tolist(), v[crossing].tolist(), strict=True))


def _flip_illegal(
    points: Float[np.ndarray, "m 2"], faces: Int[np.ndarray, "f 3"], after: Int[np.ndarray, " n"]
) -> bool:
    """Flip, in place, edges with a corner of one face in the circumcircle of the other, at most one edge of each face.

    Never flips a segment of the loops. Returns whether any edge was illegal.
    """
    f, i, g, j = _inner_edges(faces)
    u, v, p, q = faces[f, i], faces[f, (i + 1) % 3], faces[f, i - 1], faces[g, j - 1]
    border = (u < len(after)) & (v < len(after))
    border[border] = (after[u[border]] == v[border]) | (after[v[border]] == u[border])
    illegal = _angle(points, u, p, v) + _angle(points, u, q, v) > np.pi + ROUNDING
    illegal &= ~border
    f, g, u, v, p, q = (x[illegal] for x in (f, g, u, v, p, q))
    rank = np.arange(len(f))
    first = np.full(len(faces), len(f))
    np.minimum.at(first, np.concatenate([f, g]), np.tile(rank, 2))
    alone = (first[f] == rank) & (first[g] == rank)
    faces[f[alone]] = np.stack([p, u, q], axis=1)[alone]
    faces[g[alone]] = np.stack([q, v, p], axis=1)[alone]
    return len(f) > 0


def _inner_edges(faces: Int[np.ndarray, "f 3"]) -> tuple[Int[np.ndarray, " e"], ...]:
    """Face and corner where each inner edge starts: ``(face, corner)`` of one side, then of the other."""
    ends = np.sort(np.stack([faces.ravel(), np.roll(faces, -1, axis=1).ravel()]), axis=0)
    order = np.lexsort(ends)
    twins = np.flatnonzero((np.diff(ends[:, order], axis=1) == 0).all(axis=0))
    return (*np.divmod(order[twins], 3), *np.divmod(order[twins + 1], 3))


def _angle(
    points: Float[np.ndarray, "m 2"], a: Int[np.ndarray, " e"], apex: Int[np.ndarray, " e"], b: Int[np.ndarray, " e"]
) -> Float[np.ndarray, " e"]:
    """The angle a–apex–b [rad]."""
    to_a, to_b = points[a] - points[apex], points[b] - points[apex]
    return np.arctan2(np.abs(to_a[:, 0] * to_b[:, 1] - to_a[:, 1] * to_b[:, 0]), (to_a * to_b).sum(axis=1))


def _adjacent_faces(faces: Int[np.ndarray, "f 3"], u: int, v: int) -> tuple[tuple[int, int], tuple[int, int]]:
    """The faces left and right of the edge (u, v), and the third corner of each."""
    after = np.roll(faces, -1, axis=1)
    f, i = (int(x[0]) for x in np.nonzero((faces == u) & (after == v)))
    g, j = (int(x[0]) for x in np.nonzero((faces == v) & (after == u)))
    return (f, g), (int(faces[f, i - 1]), int(faces[g, j - 1]))


def _segments_cross(points: Float[np.ndarray, "m 2"], first: tuple[int, int], second: tuple[int, int]) -> bool:
    (u, v), (a, b) = first, second
    if len({u, v, a, b}) < 4:
        return False
    apart = _orientation(points[a], points[b], points[u]) * _orientation(points[a], points[b], points[v]) < 0
    return bool(
        apart and _orientation(points[u], points[v], points[a]) * _orientation(points[u], points[v], points[b]) < 0
    )


def _orientation(
    a: Float[np.ndarray, "2 *n"], b: Float[np.ndarray, "2 *n"], c: Float[np.ndarray, "2 *n"]
) -> Float[np.ndarray, " *n"]:
    """Twice the signed area of (a, b, c): positive for a left turn."""
    result: Float[np.ndarray, " *n"] = (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])
    return result
