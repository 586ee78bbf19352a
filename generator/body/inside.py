"""Which points lie inside a body, by the nearest of its faces' middles: quick, and good enough for starts."""

import numpy as np
from jaxtyping import Bool, Float
from scipy.spatial import cKDTree

from gcd_dataset.records import Body

__all__ = ["InsideTest"]

SKIN = 0.5  # cm: what is nearer than this to a face's middle counts as inside
EVERY = 4  # of the faces, one in so many is looked at


class InsideTest:
    """Tells what is inside a body: behind the nearest face that is looked at, or touching it."""

    def __init__(self, body: Body) -> None:
        corners = np.asarray(body.vertices, float)[body.faces[::EVERY]]
        self._points = corners.mean(axis=1)
        self._normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        self._tree = cKDTree(self._points)

    def __call__(self, points: Float[np.ndarray, "m 3"]) -> Bool[np.ndarray, " m"]:
        distance, nearest = self._tree.query(points)
        away = points - self._points[nearest]
        return np.asarray(((away * self._normals[nearest]).sum(axis=1) < 0) | (distance < SKIN))
