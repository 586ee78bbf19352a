"""Approximate test whether points are inside a body, by the nearest face centre: accurate enough to place panels."""

import numpy as np
from jaxtyping import Bool, Float
from scipy.spatial import cKDTree

from gcd_dataset.records import Body

SKIN = 0.5  # cm: a point nearer than this to a face centre counts as inside
EVERY = 4  # sampling: every fourth face


class InsideTest:
    """Tests points. A point behind the nearest sampled face, or within ``SKIN`` of its centre, counts as inside."""

    def __init__(self, body: Body) -> None:
        corners = np.asarray(body.vertices, float)[body.faces[::EVERY]]
        self._centres = corners.mean(axis=1)
        self._normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        self._tree = cKDTree(self._centres)

    def __call__(self, points: Float[np.ndarray, "m 3"]) -> Bool[np.ndarray, " m"]:
        distance, nearest = self._tree.query(points)
        offset = points - self._centres[nearest]
        return np.asarray(((offset * self._normals[nearest]).sum(axis=1) < 0) | (distance < SKIN))
