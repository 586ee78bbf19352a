"""Point clouds sampled from a triangle mesh."""

import numpy as np
from jaxtyping import Float, Int

from gcd_dataset.shards.codec import spread


def sample_surface(
    vertices: Float[np.ndarray, "v 3"], faces: Int[np.ndarray, "f 3"], count: int, rng: np.random.Generator
) -> Float[np.ndarray, "n 6"]:
    """``count`` points [cm] with the unit normals of their triangles, uniform by area, the first far apart.

    They have the order of the faces, then that of ``shards.codec.spread``.

    Uniform within a triangle after Osada et al., Shape Distributions (ACM TOG 2002), section 3.1.
    """
    a, b, c = np.asarray(vertices, float)[faces].transpose(1, 0, 2)
    normals = np.cross(b - a, c - a)
    doubled_area = np.linalg.norm(normals, axis=1)
    share = np.cumsum(doubled_area)
    # Stratified: one point in each of ``count`` equal shares of the area, so no region is missed.
    chosen = np.searchsorted(share, (np.arange(count) + rng.random(count)) / count * share[-1])
    face = np.minimum(chosen, len(faces) - 1)
    root, along = np.sqrt(rng.random(count))[:, None], rng.random(count)[:, None]
    points = (1 - root) * a[face] + root * ((1 - along) * b[face] + along * c[face])
    unit = normals[face] / np.maximum(doubled_area[face], np.finfo(float).tiny)[:, None]
    return np.concatenate([points, unit], axis=1)[spread(count)]
