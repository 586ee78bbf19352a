"""Reads body meshes from OBJ files by the authors' tools: one mesh of triangles, in the file's order of vertices."""

import hashlib
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int

from gcd_dataset.bodyfiles import obj_lines, read_body_file
from gcd_dataset.errors import BodyError


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
