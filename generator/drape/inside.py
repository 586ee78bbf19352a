"""Which points lie inside a body, by the nearest vertex of its skin: quick, and good enough for starts."""

import numpy as np
from jaxtyping import Bool, Float
from scipy.spatial import cKDTree

from gcd_dataset.records import Body

__all__ = ["InsideTest"]

SKIN = 0.5  # cm: what is nearer than this to a vertex counts as inside


class InsideTest:
    """Tells what is inside a body: behind the nearest vertex of its skin, or touching it."""

    def __init__(self, body: Body) -> None:
        self._points = np.asarray(body.vertices, float)
        a, b, c = self._points[body.faces].transpose(1, 0, 2)
        face, corner = np.cross(b - a, c - a), np.asarray(body.faces).ravel()
        sums = [np.bincount(corner, np.repeat(face[:, axis], 3), minlength=len(self._points)) for axis in range(3)]
        self._normals = np.stack(sums, axis=1)
        self._tree = cKDTree(self._points)

    def __call__(self, points: Float[np.ndarray, "m 3"]) -> Bool[np.ndarray, " m"]:
        distance, nearest = self._tree.query(points)
        away = points - self._points[nearest]
        return np.asarray(((away * self._normals[nearest]).sum(axis=1) < 0) | (distance < SKIN))
