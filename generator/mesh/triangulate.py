"""Triangles that fill an outline without adding a point to it.

Inside lies a hexagonal lattice; only the strip between lattice and border is searched for its Delaunay triangulation
(Qhull). Where a triangle of the strip is too long or too sharp, its circumcentre becomes a seed, as in the refinement
of Chew (1993) and Ruppert (1995), except that no border segment is ever split: the other side of the seam has its own
points already.
"""

from dataclasses import dataclass, replace
from functools import cached_property
from typing import TypeAlias

import numpy as np
import shapely
from jaxtyping import Bool, Float, Int
from scipy.spatial import Delaunay, cKDTree
from scipy.spatial.distance import cdist

from gcd_dataset.generator.mesh.flips import has_segments, restore_segments
from gcd_dataset.generator.mesh.lattice import Lattice, build_lattice

__all__ = ["Filling", "Fillings", "fill_outline", "triangulate"]

LONGEST = 1.43  # spacings: the bound on an edge of GarmentCode's boxmeshgen.py
SHARPEST = np.radians(25.0)  # the angle refinement aims at; it is sure to end up to 20.7° (Ruppert)
ROUNDS = 10  # a seam gathered to a third of the spacing takes four
EMPTY = 0.99  # of a circumradius without another point
APART = 0.8  # circumradii that the new seeds of one round keep from each other
SAME_AREA = 1e-9  # relative: triangles of which none is missing or covers another
JITTER = 1e-6  # spacings by which points stand aside while Qhull looks at them


Filling: TypeAlias = tuple[Float[np.ndarray, "m 2"], Int[np.ndarray, "f 3"]]
"""Points [cm] and triangles."""

Fillings: TypeAlias = dict[tuple[bytes, float], Filling]
"""Seeds and triangles of outlines, by the bytes of their points and the spacing."""


def fill_outline(border: Float[np.ndarray, "n 2"], spacing: float, known: Fillings) -> Filling:
    """Points of a closed loop, then seeds inside it [cm], and triangles that run round as the loop does.

    A clockwise loop is filled as its mirror image, so that a back has the mesh of the front it mirrors; ``known``: the
    outlines that have been filled, since a left panel often is the right one's mirror image to the last bit. Raises
    ``MeshError`` as ``triangulate`` does.
    """
    mirror = np.array([1.0 if shapely.LinearRing(border).is_ccw else -1.0, 1.0])
    outline = border * mirror + 0.0  # no -0.0: its bytes are others
    key = (outline.tobytes(), spacing)
    if key not in known:
        known[key] = triangulate(outline, spacing)
    seeds, faces = known[key]
    return np.concatenate([border, seeds * mirror]), faces


def triangulate(border: Float[np.ndarray, "n 2"], spacing: float) -> Filling:
    """Seeds [cm] inside a closed counter-clockwise loop of points, and the triangles over border and seeds.

    The points of the loop are at most ``spacing`` [cm] apart and keep the numbers 0 … n-1; the seeds follow. Triangles
    are counter-clockwise, and every segment of the loop is an edge of exactly one. Raises ``MeshError`` where the loop
    touches itself.
    """
    strip = _Strip(border, spacing, build_lattice(border, spacing), np.zeros((0, 2)))
    faces = fresh = strip.faces()
    for _ in range(ROUNDS):
        seeds = strip.refinement_seeds(fresh)  # where no seed has changed anything there is no more room than before
        if not len(seeds):
            break
        strip, before = strip.with_seeds(seeds), strip
        faces, fresh = strip.refined(before, faces)
    return strip.points[len(border) :], np.concatenate([faces, len(border) + strip.lattice.faces])


@dataclass(frozen=True)
class _Strip:
    """Between a border and the triangles of the lattice inside it."""

    border: Float[np.ndarray, "n 2"]
    spacing: float
    lattice: Lattice
    added: Float[np.ndarray, "a 2"]
    """Seeds that are not of the lattice."""

    @cached_property
    def points(self) -> Float[np.ndarray, "m 2"]:
        """Border, lattice and added seeds, in this order [cm]."""
        return np.concatenate([self.border, self.lattice.points, self.added])

    @cached_property
    def jittered(self) -> Float[np.ndarray, "m 2"]:
        """The points as Qhull sees them: all that asks which side of what a point is on asks these."""
        return _jittered(self.points, JITTER * self.spacing)

    @cached_property
    def outline(self) -> shapely.Polygon:
        outline = shapely.Polygon(self.jittered[: len(self.border)])
        shapely.prepare(outline)
        return outline

    @cached_property
    def members(self) -> Int[np.ndarray, " k"]:
        """The points that triangles of the strip can have for corners."""
        n, m = len(self.border), len(self.points)
        return np.concatenate([np.arange(n), n + self.lattice.rim, np.arange(m - len(self.added), m)])

    def with_seeds(self, seeds: Float[np.ndarray, "k 2"]) -> "_Strip":
        """The strip with more points in it, and wider where they disturb the lattice."""
        return replace(self, lattice=self.lattice.without(seeds), added=np.concatenate([self.added, seeds]))

    def refined(
        self, before: "_Strip", faces: Int[np.ndarray, "f 3"]
    ) -> tuple[Int[np.ndarray, "g 3"], Int[np.ndarray, "h 3"]]:
        """The triangles of the strip, and those of them that have come with its last seeds.

        ``before`` and ``faces``: the strip without those seeds, and its triangles. Only triangles with a seed in their
        circumcircle go, and only triangles with a seed for a corner come (Bowyer, 1981; Watson, 1981): among the
        corners of those that go they are the same as among all points. Over a slit that is not so, and all is done
        again.
        """
        first_seed = len(self.points) - (len(self.added) - len(before.added))
        opened = replace(before.lattice, filled=before.lattice.filled & ~self.lattice.filled).faces
        old = np.concatenate([faces, len(self.border) + opened])
        centres, radii, _, _ = _circumcircles(self.jittered[old])
        goes = (cdist(self.jittered[first_seed:], centres) < radii).any(axis=0)
        corners = np.append(np.unique(old[goes]), np.arange(first_seed, len(self.points)))
        fresh = _counter_clockwise(self.jittered, corners[Delaunay(self.jittered[corners]).simplices])
        fresh = fresh[fresh.max(axis=1) >= first_seed]
        whole = np.concatenate([old[~goes], fresh])
        same_area = np.isclose(_area(self.jittered[fresh]), _area(self.jittered[old[goes]]), rtol=SAME_AREA, atol=0.0)
        if same_area and has_segments(whole, len(self.border)):
            return whole, fresh
        again = self.faces()
        return again, again

    def faces(self) -> Int[np.ndarray, "f 3"]:
        """The constrained Delaunay triangles of the strip, counter-clockwise."""
        faces = _counter_clockwise(self.jittered, self.members[Delaunay(self.jittered[self.members]).simplices])
        faces = faces[~self.lattice.covers(self.jittered[faces].mean(axis=1))]
        faces = restore_segments(self.jittered, faces, len(self.border))
        return faces[self._inside(faces)]

    def _inside(self, faces: Int[np.ndarray, "f 3"]) -> Bool[np.ndarray, " f"]:
        """Which triangles lie within the outline, of which every segment is an edge."""
        n = len(self.border)
        inside = faces.max(axis=1) >= n
        bare = np.flatnonzero(~inside)  # all corners on the border
        step = (np.roll(faces[bare], -1, axis=1) - faces[bare]) % n
        along, against = (step == 1).any(axis=1), (step == n - 1).any(axis=1)
        inside[bare] = along
        unsure = bare[~along & ~against]
        inside[unsure] = shapely.contains_xy(self.outline, *self.jittered[faces[unsure]].mean(axis=1).T)
        return inside

    def refinement_seeds(self, faces: Int[np.ndarray, "f 3"]) -> Float[np.ndarray, "k 2"]:
        """Circumcentres of triangles that are too long or too sharp, where there is room for them."""
        centres, radii, shortest, longest = _circumcircles(self.jittered[faces])
        poor = (longest > LONGEST * self.spacing) | (2 * np.sin(SHARPEST) * radii > shortest)
        if not poor.any():
            return centres[:0]
        centres, radii = centres[poor], radii[poor]
        room = shapely.contains_xy(self.outline, *centres.T) & self._room(centres, radii)
        return centres[room][_spread(centres[room], radii[room])]

    def _room(self, centres: Float[np.ndarray, "k 2"], radii: Float[np.ndarray, " k"]) -> Bool[np.ndarray, " k"]:
        """Which circles hold no point, as over a slit they may, and see no border segment under over a right angle."""
        ahead = np.roll(self.border, -1, axis=0)
        half = 0.5 * np.linalg.norm(ahead - self.border, axis=1)
        clear = (cdist(centres, 0.5 * (self.border + ahead)) >= half).all(axis=1)
        nearest, _ = cKDTree(self.points[self.members], balanced_tree=False).query(centres)
        return clear & (nearest > EMPTY * radii)


def _jittered(points: Float[np.ndarray, "m 2"], by: float) -> Float[np.ndarray, "m 2"]:
    """The points, each aside by a different trifle, so that no three are in line and no four on a circle.

    Ties between rows of equal triangles cost Qhull three times the rest of its work (measured), and the triangles that
    it may put on the line between points of a straight edge belong to neither side.
    """
    square = np.arange(len(points))[:, None] ** 2.0  # a linear sequence would keep equally spaced points in line
    return points + by * (square * (np.sqrt(2), np.sqrt(3)) % 1.0 - 0.5)


def _counter_clockwise(points: Float[np.ndarray, "m 2"], faces: Int[np.ndarray, "f 3"]) -> Int[np.ndarray, "f 3"]:
    """The triangles with their corners in counter-clockwise order."""
    a, b, c = points[faces].transpose(1, 2, 0)
    turn = (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])
    return np.where(turn[:, None] < 0, faces[:, ::-1], faces)


def _area(corners: Float[np.ndarray, "f 3 2"]) -> float:
    """The area of all triangles [cm²]."""
    (bx, by), (cx, cy) = (corners[:, 1] - corners[:, 0]).T, (corners[:, 2] - corners[:, 0]).T
    return 0.5 * float((bx * cy - by * cx).sum())


def _circumcircles(
    corners: Float[np.ndarray, "f 3 2"],
) -> tuple[Float[np.ndarray, "f 2"], Float[np.ndarray, " f"], Float[np.ndarray, " f"], Float[np.ndarray, " f"]]:
    """Centre, radius, shortest and longest side of each triangle [cm]."""
    b, c = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    bb, cc = (b * b).sum(axis=1), (c * c).sum(axis=1)
    twice = 2 * (b[:, 0] * c[:, 1] - b[:, 1] * c[:, 0])
    x = (c[:, 1] * bb - b[:, 1] * cc) / twice
    y = (b[:, 0] * cc - c[:, 0] * bb) / twice
    sides = np.sqrt(np.stack([bb, cc, ((c - b) ** 2).sum(axis=1)]))
    return corners[:, 0] + np.stack([x, y], axis=1), np.hypot(x, y), sides.min(axis=0), sides.max(axis=0)


def _spread(points: Float[np.ndarray, "k 2"], radii: Float[np.ndarray, " k"]) -> Int[np.ndarray, " n"]:
    """Indices of points that keep ``APART`` of their radius from each other, those of large circles first."""
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
