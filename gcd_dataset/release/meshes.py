"""Meshes of the publication: bodies as OBJ; garments as binary PLY, seam vertices split by panel.

The authors' converter keeps one pair of texture coordinates per vertex, so it stores a seam vertex once for each of its
panels, and the vertex numbers of the other files of a garment do not apply. Welding vertices of equal position,
numbered by first occurrence, restores these numbers.
"""

import hashlib
import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int

from gcd_dataset.bodyfiles import obj_lines, read_body_file
from gcd_dataset.errors import BodyError, ShardError
from gcd_dataset.records import Record

VERTEX = np.dtype([("position", "<f4", 3), ("texture", "<f8", 2)])
FACE = np.dtype([("corners", "u1"), ("rows", "<i4", 3)])
HEADER = """ply
format binary_little_endian 1.0
comment https://github.com/mikedh/trimesh
element vertex {}
property float x
property float y
property float z
property double s
property double t
element face {}
property list uchar int vertex_indices
end_header
"""
END = b"end_header\n"
DIGITS = re.compile(r"[0-9]{1,9}")
LARGEST = 1e6  # cm


@dataclass(frozen=True, eq=False)
class Ply(Record):
    """A mesh file with ``c`` split vertices."""

    vertices: Float[np.ndarray, "c 3"]
    """Positions, f32 [cm]."""
    texture: Float[np.ndarray, "c 2"]
    """Texture coordinates, 0 to 1, with separate scales along x and y."""
    faces: Int[np.ndarray, "f 3"]
    """Rows of ``vertices``."""


def read_ply(content: bytes) -> Ply:
    """The mesh in a file. Raises ``ShardError`` for another format, and for a truncated file."""
    header, _, body = content.partition(END)
    counts = re.findall(r"^element \S+ (\S+)$", header.decode("ascii", "replace"), re.MULTILINE)
    actual = (line for line in (header + END).decode("ascii", "replace").split("\n") if not line.startswith("comment"))
    expected = (line for line in HEADER.format(*counts, *"??").split("\n") if not line.startswith("comment"))
    if len(counts) != 2 or list(actual) != list(expected) or not all(DIGITS.fullmatch(count) for count in counts):
        raise ShardError("not a binary PLY of float x y z, double s t and triangles")
    n, m = map(int, counts)
    if len(body) != n * VERTEX.itemsize + m * FACE.itemsize:
        raise ShardError(f"{len(body)} bytes for {n} vertices and {m} triangles")
    vertices = np.frombuffer(body, VERTEX, n)
    faces = np.frombuffer(body, FACE, m, n * VERTEX.itemsize)
    rows = faces["rows"].astype(np.int64)
    if (faces["corners"] != 3).any() or (m and not 0 <= rows.min() <= rows.max() < n):
        raise ShardError(f"a face that is not a triangle of its {n} vertices")
    for name in ("position", "texture"):
        if not np.abs(vertices[name]).max(initial=0.0) <= LARGEST:  # false for NaN
            raise ShardError(f"a {name} coordinate that is over {LARGEST:g}, or NaN")
    return Ply(vertices["position"].copy(), vertices["texture"].copy(), rows)


def write_ply(mesh: Ply) -> bytes:
    """The content of a mesh file."""
    vertices, faces = np.zeros(len(mesh.vertices), VERTEX), np.zeros(len(mesh.faces), FACE)
    vertices["position"], vertices["texture"] = mesh.vertices, mesh.texture
    faces["corners"], faces["rows"] = 3, mesh.faces
    return HEADER.format(len(vertices), len(faces)).encode() + vertices.tobytes() + faces.tobytes()


def weld(*positions: Float[np.ndarray, "c 3"]) -> tuple[Int[np.ndarray, " v"], Int[np.ndarray, " c"]]:
    """Merge rows of equal positions: first row of each welded vertex [v], welded vertex of each row [c].

    Rows are equal if all arrays of ``positions`` (f32) have the same bytes there.
    """
    keys = np.ascontiguousarray(np.concatenate(positions, axis=1), np.float32)
    _, first, vertex = np.unique(keys.view(f"V{keys.shape[1] * 4}").ravel(), return_index=True, return_inverse=True)
    order = np.argsort(first)
    number = np.empty_like(order)
    number[order] = np.arange(len(order))
    return first[order], number[vertex.ravel()]


@dataclass(frozen=True)
class ObjText:
    """The vertex and face lines of an OBJ file."""

    path: Path
    v: tuple[bytes, ...]
    f: tuple[bytes, ...]

    def positions(self) -> Float[np.ndarray, "v 3"]:
        """Vertex positions in the unit of the file. Raises ``BodyError``."""
        try:
            found = np.loadtxt([line.decode("ascii") for line in self.v], usecols=(1, 2, 3), ndmin=2)
        except ValueError as error:
            raise self._broken(f"a vertex that is not three numbers ({error})") from error
        if not np.isfinite(found).all():
            raise self._broken("a position that is NaN or infinite")
        return found

    def triangles(self) -> Int[np.ndarray, "f 3"]:
        """Rows of the vertices at the corners of each face. Raises ``BodyError``."""
        corners = [[corner.partition(b"/")[0] for corner in line.split()[1:]] for line in self.f]
        if odd := next((line for line, face in zip(self.f, corners, strict=True) if len(face) != 3), None):
            raise self._broken(f"a face that is not a triangle ({odd[:60].decode(errors='replace')})")
        try:
            found = np.array(corners, dtype="S").astype(np.int64) - 1
        except (ValueError, OverflowError) as error:
            raise self._broken(f"a face without vertex numbers ({error})") from error
        if found.min() < 0 or found.max() >= len(self.v):
            raise self._broken(f"a face with a vertex that is not one of its {len(self.v)}")
        return found.astype(np.int32)

    def faces_hash(self) -> str:
        """SHA-256 of the face lines."""
        return hashlib.sha256(b"\n".join(self.f)).hexdigest()

    def _broken(self, problem: str) -> BodyError:
        return BodyError(f"{self.path}: holds {problem}: extract or export it again")


def read_obj(path: Path) -> ObjText:
    """The vertex and face lines of a file. Raises ``BodyError`` for a file without vertices or faces."""
    lines = obj_lines(read_body_file(path))
    text = ObjText(
        path,
        tuple(line for line in lines if line.startswith(b"v")),
        tuple(line for line in lines if line.startswith(b"f")),
    )
    if not (text.v and text.f):
        raise BodyError(
            f"{path}: {len(text.v)} vertices and {len(text.f)} faces, not a mesh: extract or export it again"
        )
    return text
