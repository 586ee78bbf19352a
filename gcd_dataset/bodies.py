"""People as data sets hold them: one shape in both poses, with the measures; and the mesh that all of them share."""

import hashlib
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Float32, Int, UInt8

from gcd_dataset.errors import BodyError
from gcd_dataset.records import MEASURES, Body, BodyShape, Measurements, Record

__all__ = ["POSES", "BodyMesh", "Person", "measure_row"]

POSES: tuple[str, ...] = ("straight", "apart")
"""How the legs stand; trousers are draped on the second."""


@dataclass(frozen=True, eq=False)
class BodyMesh(Record):
    """What all bodies of a set share: which vertices make a triangle, and which part of the body they are."""

    faces: Int[np.ndarray, "f 3"]
    """Triangles, counter-clockwise seen from outside."""
    parts: UInt8[np.ndarray, " v"] | None = None
    """``BodyPart`` value of each vertex; ``None`` where nobody has said."""

    @property
    def n_vertices(self) -> int:
        """Vertices that a body on this mesh has."""
        return int(self.faces.max()) + 1 if self.parts is None else len(self.parts)

    @property
    def sha256(self) -> str:
        """Hash of faces and parts, the same for any width of the integers."""
        parts = np.zeros(0, np.uint8) if self.parts is None else self.parts
        return hashlib.sha256(np.asarray(self.faces, "<u4").tobytes() + parts.tobytes()).hexdigest()


@dataclass(frozen=True, eq=False)
class Person(Record):
    """One person, standing with the legs straight and with the legs apart."""

    name: str
    shape: BodyShape
    """Weights and arms; the legs straight."""
    straight: Float32[np.ndarray, "v 3"]
    """Vertex positions with the legs straight [cm], soles at y = 0."""
    apart: Float32[np.ndarray, "v 3"]
    """Vertex positions with the legs apart [cm], soles at y = 0."""
    measurements: Measurements
    """Taken with the legs straight, and valid for both poses."""

    def body(self, mesh: BodyMesh, *, legs_apart: bool = False) -> Body:
        """The body to be dressed, in one of the poses. Raises ``BodyError`` where the mesh has no parts."""
        if mesh.parts is None:
            raise BodyError(f"{self.name}: which vertices are arms and legs is not known: give a part segmentation")
        vertices = self.apart if legs_apart else self.straight
        return Body(np.asarray(vertices, float), mesh.faces, mesh.parts, self.name)


def measure_row(measurements: Measurements) -> Float[np.ndarray, " m"]:
    """The measures as numbers in the order of ``MEASURES``: cm, inclinations in degrees; NaN where none was taken."""
    values = measurements.to_file_values()
    return np.array([values.get(name, np.nan) for name in MEASURES])
