"""People of a body set: shape, two poses and measures of each; and the mesh that all bodies of a set share."""

import hashlib
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Float32, Int, UInt8

from gcd_dataset.errors import BodyError
from gcd_dataset.records import MEASURES, Body, BodyShape, Measurements, Record

POSES: tuple[str, ...] = ("straight", "apart")
"""Poses of the legs; trousers are draped on ``apart``."""
Wearer = Callable[[bool], tuple[Body, Measurements]]
"""Body and measures, with legs straight or apart."""


@dataclass(frozen=True, eq=False)
class BodyMesh(Record):
    """Triangles and part labels, the same for all bodies of a set."""

    faces: Int[np.ndarray, "f 3"]
    """Triangles, counter-clockwise seen from outside."""
    parts: UInt8[np.ndarray, " v"] | None = None
    """``BodyPart`` value of each vertex; ``None`` without a segmentation."""

    @property
    def n_vertices(self) -> int:
        """Number of vertices of each body."""
        return int(self.faces.max()) + 1 if self.parts is None else len(self.parts)

    @property
    def sha256(self) -> str:
        """Hash of faces and parts; the integer type of the arrays does not matter."""
        parts = np.zeros(0, np.uint8) if self.parts is None else self.parts
        return hashlib.sha256(np.asarray(self.faces, "<u4").tobytes() + parts.tobytes()).hexdigest()


@dataclass(frozen=True, eq=False)
class Person(Record):
    """One person, standing with the legs straight and with the legs apart."""

    name: str
    shape: BodyShape
    """Shape weights and arm angle; ``legs_apart`` is False."""
    straight: Float32[np.ndarray, "v 3"]
    """Vertex positions with the legs straight [cm], soles at y = 0."""
    apart: Float32[np.ndarray, "v 3"]
    """Vertex positions with the legs apart [cm], soles at y = 0."""
    measurements: Measurements
    """Measured with the legs straight; valid for both poses."""

    def body(self, mesh: BodyMesh, *, legs_apart: bool = False) -> Body:
        """The body in one pose of the legs, for draping. Raises ``BodyError`` if the mesh has no part labels."""
        if mesh.parts is None:
            raise BodyError(f"{self.name}: the mesh has no labels for arms and legs: give a part segmentation")
        vertices = self.apart if legs_apart else self.straight
        return Body(np.asarray(vertices, float), mesh.faces, mesh.parts, self.name)


def measure_row(measurements: Measurements) -> Float[np.ndarray, " m"]:
    """The measures in the order of ``MEASURES``: cm, inclinations in degrees; NaN for a missing measure."""
    values = measurements.to_file_values()
    return np.array([values.get(name, np.nan) for name in MEASURES])
