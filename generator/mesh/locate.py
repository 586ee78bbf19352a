"""Point location: the triangles that hold points of the plane, and barycentric weights."""

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial import cKDTree


def barycentric(
    points: Float[np.ndarray, "m 2"], triangles: Int[np.ndarray, "n 3"], queries: Float[np.ndarray, "n 2"]
) -> Float[np.ndarray, "3 n"]:
    """The barycentric weights of each query point in its triangle of ``points``."""
    (ax, bx, cx), (ay, by, cy) = (np.ascontiguousarray(axis)[triangles.T] for axis in points.T)
    bx, by, cx, cy = bx - ax, by - ay, cx - ax, cy - ay
    x, y, area = queries[:, 0] - ax, queries[:, 1] - ay, bx * cy - by * cx
    second, third = (x * cy - y * cx) / area, (bx * y - by * x) / area
    return np.stack([1 - second - third, second, third])


def locate(
    points: Float[np.ndarray, "m 2"], faces: Int[np.ndarray, "f 3"], queries: Float[np.ndarray, "n 2"], cell: float
) -> Int[np.ndarray, " n"]:
    """The triangle that holds each query point; for a point outside all of them, the one that it lies least beyond.

    The query points are sorted into square cells of side ``cell``; each triangle is compared with the points in the
    cells that it may touch.
    """
    triangle, point = _near_pairs(points[faces], queries, cell)
    least = _least(barycentric(points, faces[triangle], queries[point]))
    found = np.full(len(queries), -1)
    inside = least >= 0.0
    found[point[inside]] = triangle[inside]
    beside = np.flatnonzero((found < 0)[point])
    beside = beside[np.argsort(least[beside], kind="stable")]
    found[point[beside]] = triangle[beside]  # assigned in order, so the greatest counts
    lost = np.flatnonzero(found < 0)
    if len(lost):
        found[lost] = _nearest(points, faces, queries[lost])
    return found


def _near_pairs(
    corners: Float[np.ndarray, "f 3 2"], queries: Float[np.ndarray, "n 2"], cell: float
) -> tuple[Int[np.ndarray, " k"], Int[np.ndarray, " k"]]:
    """Pairs of a triangle and a query point in the cells that the triangle's bounding box touches."""
    if not len(queries):
        return np.zeros(0, int), np.zeros(0, int)
    low = queries.min(axis=0)
    at = np.floor((queries - low) / cell).astype(int)
    columns, rows = (at.max(axis=0) + 1).tolist()
    number = at[:, 1] * columns + at[:, 0]
    order = np.argsort(number, kind="stable")
    first = np.concatenate([[0], np.cumsum(np.bincount(number, minlength=rows * columns))])
    x, y = (corners - low).transpose(2, 1, 0) / cell
    left, right = (np.floor(bound).astype(int) for bound in (_least(x), -_least(-x)))
    bottom, top = (np.floor(bound).astype(int) for bound in (_least(y), -_least(-y)))
    left, bottom = np.maximum(left, 0), np.maximum(bottom, 0)
    right, top = np.minimum(right, columns - 1), np.minimum(top, rows - 1)
    triangle, row = _runs(bottom, np.where(left <= right, top + 1 - bottom, 0))
    begin, end = first[row * columns + left[triangle]], first[row * columns + right[triangle] + 1]
    run, place = _runs(begin, end - begin)
    return triangle[run], order[place]


def _least(values: Float[np.ndarray, "3 n"]) -> Float[np.ndarray, " n"]:
    return np.minimum(np.minimum(values[0], values[1]), values[2])  # three times as fast as a reduction


def _runs(first: Int[np.ndarray, " n"], count: Int[np.ndarray, " n"]) -> tuple[np.ndarray, np.ndarray]:
    """For runs of ``count`` consecutive numbers (none if negative), the run of each number, and the number."""
    count = np.maximum(count, 0)
    run = np.repeat(np.arange(len(first)), count)
    return run, np.arange(len(run)) + (first - np.cumsum(count) + count)[run]


def _nearest(
    points: Float[np.ndarray, "m 2"], faces: Int[np.ndarray, "f 3"], queries: Float[np.ndarray, "n 2"]
) -> Int[np.ndarray, " n"]:
    """The triangles with the nearest centroid."""
    return np.asarray(cKDTree(points[faces].mean(axis=1)).query(queries)[1])
