"""Constrained Delaunay triangulation: recover missing border segments by edge flips."""

from collections import deque

import numpy as np
from jaxtyping import Bool, Float, Int

from gcd_dataset.errors import MeshError

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
