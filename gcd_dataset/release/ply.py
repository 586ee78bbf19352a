"""Meshes as the published PLY files hold them: binary, a vertex for each side of a seam, with texture coordinates.

An OBJ of one vertex list was converted by a tool that keeps one pair of texture coordinates a vertex, and so stores a
vertex of a seam once for every panel it lies in: numbers in the other files of a garment are not those of the PLY.
Vertices at the very same place, in the order of their first mention, are the vertices that the other files number.
"""

import re
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from gcd_dataset.errors import ShardError
from gcd_dataset.records import Record

__all__ = ["Ply", "read_ply", "weld", "write_ply"]

VERTEX = np.dtype([("place", "<f4", 3), ("texture", "<f8", 2)])
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
    """A mesh file; ``c`` vertices as it counts them."""

    vertices: Float[np.ndarray, "c 3"]
    """f32 [cm]"""
    texture: Float[np.ndarray, "c 2"]
    """Texture coordinates, 0 to 1; x and y each by a scale of their own."""
    faces: Int[np.ndarray, "f 3"]
    """Rows of ``vertices``."""


def read_ply(content: bytes) -> Ply:
    """The mesh in a file. Raises ``ShardError`` for one of another form, or that is cut off."""
    header, _, body = content.partition(END)
    counts = re.findall(r"^element \S+ (\S+)$", header.decode("ascii", "replace"), re.MULTILINE)
    lines = (line for line in (header + END).decode("ascii", "replace").split("\n") if not line.startswith("comment"))
    form = (line for line in HEADER.format(*counts, *"??").split("\n") if not line.startswith("comment"))
    if len(counts) != 2 or list(lines) != list(form) or not all(DIGITS.fullmatch(count) for count in counts):
        raise ShardError("not a binary PLY of float x y z, double s t and triangles")
    n, m = map(int, counts)
    if len(body) != n * VERTEX.itemsize + m * FACE.itemsize:
        raise ShardError(f"{len(body)} bytes for {n} vertices and {m} triangles")
    vertices = np.frombuffer(body, VERTEX, n)
    faces = np.frombuffer(body, FACE, m, n * VERTEX.itemsize)
    rows = faces["rows"].astype(np.int64)
    if (faces["corners"] != 3).any() or (m and not 0 <= rows.min() <= rows.max() < n):
        raise ShardError(f"a face that is no triangle of its {n} vertices")
    for name, what in (("place", "position"), ("texture", "texture coordinate")):
        if not np.abs(vertices[name]).max(initial=0.0) <= LARGEST:  # nor for what is no number
            raise ShardError(f"a {what} beyond {LARGEST:g}, or that is no number")
    return Ply(vertices["place"].copy(), vertices["texture"].copy(), rows)


def write_ply(mesh: Ply) -> bytes:
    """The mesh as a file."""
    vertices, faces = np.zeros(len(mesh.vertices), VERTEX), np.zeros(len(mesh.faces), FACE)
    vertices["place"], vertices["texture"] = mesh.vertices, mesh.texture
    faces["corners"], faces["rows"] = 3, mesh.faces
    return HEADER.format(len(vertices), len(faces)).encode() + vertices.tobytes() + faces.tobytes()


def weld(*vertices: Float[np.ndarray, "c 3"]) -> tuple[Int[np.ndarray, " v"], Int[np.ndarray, " c"]]:
    """Welded vertices: the first row of each, in order, and the vertex of every row.

    Rows are one vertex where all of ``vertices`` (f32) have the very same bytes.
    """
    keys = np.ascontiguousarray(np.concatenate(vertices, axis=1), np.float32)
    _, first, vertex = np.unique(keys.view(f"V{keys.shape[1] * 4}").ravel(), return_index=True, return_inverse=True)
    order = np.argsort(first)
    number = np.empty_like(order)
    number[order] = np.arange(len(order))
    return first[order], number[vertex.ravel()]
