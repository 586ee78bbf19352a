"""Reads the authors' shape space, ``point.pca`` of github.com/mbotsch/GarmentMeasurements.

The file is under the GPL: neither it nor code of that project is part of this package. Its format, little-endian and
unpadded:

    u32 m, u32 n          coordinates (three per vertex) and components
    f64 [n, m]            the components, one after the other, each of length 1; x, y, z of a vertex are adjacent
    f64 [m]               the mean body [m]
    f64 [n]               variance along each component, the largest first

A body is ``mean + Σ wᵢ √varianceᵢ componentᵢ`` with weights in standard deviations, such as ``pca_weights`` of the
published people. It has the pose of the training bodies; the poses of the data set need the authors' rig.
"""

import struct
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float

from gcd_dataset.bodies import BodyMesh
from gcd_dataset.bodyfiles import read_body_file
from gcd_dataset.errors import BodyError
from gcd_dataset.records import Body, Record

HEADER = struct.Struct("<II")
METRE = 100.0  # cm
UNIT_TOLERANCE = 1e-6  # error of the components' dot products; rounding leaves 1e-12
SHORTEST, TALLEST = 30.0, 300.0  # cm
LARGEST_SWAY = 100.0  # cm: RMS displacement of the skin by one standard deviation; real people vary far less
LFS_POINTER = b"version https://git-lfs"


@dataclass(frozen=True, eq=False)
class PcaShapes(Record):
    """A linear shape space: body = ``mean + weights · components``."""

    mean: Float[np.ndarray, "v 3"]
    """[cm]"""
    components: Float[np.ndarray, "k v 3"]
    """Displacement by one standard deviation of each component [cm]."""

    def vertices(self, weights: Float[np.ndarray, "*batch k"]) -> Float[np.ndarray, "*batch v 3"]:
        """Vertex positions [cm], soles at y = 0. Raises ``BodyError`` for another number of weights."""
        weights = np.asarray(weights, float)
        if weights.shape[-1:] != (len(self.components),):
            raise BodyError(
                f"weights of shape {weights.shape}, for {len(self.components)} components: give one weight for each"
            )
        vertices = self.mean + np.einsum("...k,kvi->...vi", weights, self.components)
        vertices[..., 1] -= vertices[..., 1].min(axis=-1, keepdims=True)
        return vertices

    def body(self, weights: Float[np.ndarray, " k"], mesh: BodyMesh, *, name: str = "pca") -> Body:
        """The body of these weights; ``mesh``: the mesh of the published bodies, with parts. Raises ``BodyError``."""
        if mesh.n_vertices != len(self.mean) or mesh.parts is None:
            known = "with" if mesh.parts is not None else "without"
            raise BodyError(
                f"{name}: a mesh of {mesh.n_vertices} vertices {known} parts for shapes of {len(self.mean)}: give the "
                "mesh of the published bodies, with their segmentation"
            )
        return Body(self.vertices(weights), mesh.faces, mesh.parts, name)


def read_pca(path: Path | str) -> PcaShapes:
    """The shape space in a ``point.pca``. Raises ``BodyError``."""
    path = Path(path)
    content = read_body_file(path)
    if content.startswith(LFS_POINTER):
        raise BodyError(f"{path}: a pointer to the file: fetch the file itself with git lfs pull")
    if len(content) < HEADER.size:
        raise BodyError(f"{path}: {len(content)} bytes: not a point.pca: copy it again")
    m, n = HEADER.unpack_from(content)
    if not (0 < n <= m and m % 3 == 0) or len(content) != HEADER.size + 8 * (m * n + m + n):
        raise BodyError(
            f"{path}: {len(content)} bytes, beginning with {m} and {n}: not a point.pca, which has 8 + 8 (m n + m + n) "
            "bytes for m coordinates, three a vertex, and n components: copy it again"
        )
    numbers = np.frombuffer(content, "<f8", offset=HEADER.size)
    components, mean, variance = numbers[: m * n].reshape(n, m), numbers[m * n : m * n + m], numbers[-n:]
    _check(path, components, mean, variance)
    scaled = components * np.sqrt(np.maximum(variance, 0.0))[:, None]
    return PcaShapes(METRE * mean.reshape(-1, 3), METRE * scaled.reshape(n, -1, 3))


def _check(
    path: Path,
    components: Float[np.ndarray, "n m"],
    mean: Float[np.ndarray, " m"],
    variance: Float[np.ndarray, " n"],
) -> None:
    """Raise ``BodyError`` unless these are the principal components of bodies."""
    if not all(np.isfinite(array).all() for array in (components, mean, variance)):
        raise BodyError(f"{path}: holds NaN or infinity: copy it again")
    if variance[0] <= 0 or (np.diff(variance) > 0).any() or variance[-1] < -UNIT_TOLERANCE * variance[0]:
        raise BodyError(
            f"{path}: variances from {variance[0]:.3g} to {variance[-1]:.3g} do not fall to 0: copy it again"
        )
    longest = np.abs(components).max()  # checked first: squares of larger numbers may overflow
    slant = np.abs(components @ components.T - np.eye(len(components))).max() if longest < 2.0 else longest
    if slant > UNIT_TOLERANCE:
        raise BodyError(f"{path}: components are not orthonormal, by {slant:.3g}: copy it again")
    sway = METRE * float(np.sqrt(variance[0] / (len(mean) / 3)))
    if sway > LARGEST_SWAY:
        raise BodyError(f"{path}: one weight moves the skin by {sway:.3g} cm: not a shape space of people in metres")
    height = METRE * float(np.ptp(mean[1::3]))
    if not SHORTEST < height < TALLEST:
        raise BodyError(f"{path}: a mean body {height / METRE:.4g} m tall: not a shape space of people in metres")
