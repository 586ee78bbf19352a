"""Reads meshes from OBJ, PLY, STL and GLB files as arrays, in the file's vertex order and unit."""

import contextlib
import io
import logging
import re
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float, Int

from gcd_dataset.bodyfiles import obj_lines
from gcd_dataset.errors import BodyError
from gcd_dataset.files import read_whole
from gcd_dataset.generator.body.asset import body_model
from gcd_dataset.generator.body.gltf import require_readable
from gcd_dataset.generator.body.scan import is_convex

if TYPE_CHECKING:
    from trimesh import Trimesh

MAX_BYTES = 512 << 20  # a scan of a million triangles has 100 MB as OBJ text
MAX_FACES = 2_000_000  # scans have up to a million; larger ones take minutes and 10 GB
MAIN_SHARE = 0.8  # share of the total area above which one of several meshes is taken for the body
EXPORT_AGAIN = "export the mesh again"

_Mesh = tuple[Float[np.ndarray, "v 3"], Int[np.ndarray, "f 3"]]


def read_mesh(path: Path) -> _Mesh:
    """Vertices (v, 3) and triangles (f, 3) of a mesh file, in its order and unit; polygons are triangulated.

    Vertices of OBJ and PLY are kept one to one. STL stores triangles without shared vertices: coincident corners are
    merged, in order of appearance. GLB is read with the transforms of its nodes. Raises ``BodyError``.
    """
    reader = READERS.get(path.suffix.lower())
    if reader is None:
        raise BodyError(f"{path}: not a readable mesh format: convert it to {', '.join(READERS)}")
    content = read_whole(path, "mesh", limit=MAX_BYTES, error=BodyError)
    try:
        with _trimesh_silent():
            vertices, faces = reader(content, path)
    except BodyError:
        raise
    except Exception as error:  # trimesh raises any exception for malformed files
        kind = path.suffix[1:].upper()
        raise BodyError(f"{path}: cannot be read as {kind} ({_first_line(error)}): {EXPORT_AGAIN}") from error
    if not len(faces):
        raise BodyError(f"{path}: holds no triangles: {EXPORT_AGAIN}")
    if len(faces) > MAX_FACES:
        raise BodyError(f"{path}: {len(faces)} triangles, more than {MAX_FACES}: decimate the mesh")
    if faces.min() < 0 or faces.max() >= len(vertices):
        odd = faces.min() if faces.min() < 0 else faces.max()
        raise BodyError(f"{path}: a face names vertex {odd} of {len(vertices)}, numbered from 0: {EXPORT_AGAIN}")
    if not np.isfinite(vertices).all():
        odd = int(np.flatnonzero(~np.isfinite(vertices).all(axis=1))[0])
        raise BodyError(f"{path}: the position of vertex {odd} is not a number: {EXPORT_AGAIN}")
    return vertices, faces


def _read_obj(content: bytes, path: Path) -> _Mesh:
    """Reads positions and faces only: trimesh renumbers vertices by texture seams, materials and groups."""
    plain = re.sub(rb"/\S*", b"", b"\n".join(obj_lines(content)))
    if odd := re.search(rb"^f.*\s(-\d+|\+?0+)(?!\S)", plain, re.MULTILINE):
        raise ValueError(f"a face names vertex {odd[1].decode()}, but OBJ counts from 1")
    return _arrays(_loaded(io.StringIO(plain.decode("ascii", errors="replace")), "obj"))


def _read_ply(content: bytes, path: Path) -> _Mesh:
    return _arrays(_loaded(io.BytesIO(content), "ply"))


def _read_stl(content: bytes, path: Path) -> _Mesh:
    corners = np.asarray(_loaded(io.BytesIO(content), "stl").triangles, float)
    if (body := _with_model_numbering(corners)) is not None:
        return body
    _, first, number = np.unique(corners.reshape(-1, 3), axis=0, return_index=True, return_inverse=True)
    order = np.argsort(first)
    faces = np.argsort(order)[number.ravel()].reshape(-1, 3)
    return corners.reshape(-1, 3)[first[order]], faces


def _with_model_numbering(corners: Float[np.ndarray, "f 3 3"]) -> _Mesh | None:
    """The mesh with the body model's vertex numbers, if its triangles are the model's; else ``None``."""
    model = body_model()
    if len(corners) != len(model.faces):
        return None
    vertices = np.full(model.mean.shape, np.nan)
    vertices[model.faces] = corners
    return (vertices, model.faces) if np.array_equal(vertices[model.faces], corners) else None


def _read_glb(content: bytes, path: Path) -> _Mesh:
    import trimesh

    require_readable(content, path)
    scene = trimesh.load(io.BytesIO(content), file_type="glb", force="scene", process=False, skip_materials=True)
    meshes = [mesh for mesh in scene.dump() if isinstance(mesh, trimesh.Trimesh)]  # with transforms
    areas = [mesh.area for mesh in meshes if not is_convex(np.asarray(mesh.vertices))]  # leaves out a floor
    if len(areas) > 1 and not max(areas) > MAIN_SHARE * sum(areas):
        names = ", ".join(ascii(name)[1:-1] for name in list(scene.geometry)[:9])
        raise BodyError(f"{path}: holds {len(meshes)} meshes ({names}), none of them clearly the body: export it alone")
    return _arrays(trimesh.util.concatenate(meshes) if meshes else trimesh.Trimesh())


def _loaded(stream: io.StringIO | io.BytesIO, kind: str) -> "Trimesh":
    import trimesh  # here, not above: drawn patterns need no trimesh, which takes 0.4 s

    return trimesh.load(stream, file_type=kind, force="mesh", process=False, maintain_order=True)


def _arrays(mesh: "Trimesh") -> _Mesh:
    return np.array(mesh.vertices, float).reshape(-1, 3), np.array(mesh.faces, int).reshape(-1, 3)


@contextlib.contextmanager
def _trimesh_silent() -> Iterator[None]:
    """Suppress trimesh's logged tracebacks of malformed files: the caller raises a one-line error."""
    logger = logging.getLogger("trimesh")
    previous, logger.disabled = logger.disabled, True
    try:
        yield
    finally:
        logger.disabled = previous


def _first_line(error: BaseException) -> str:
    text = " ".join(str(error).split())
    return ascii(text[:80])[1:-1] or type(error).__name__


READERS: Mapping[str, Callable[[bytes, Path], _Mesh]] = {
    ".obj": _read_obj,
    ".ply": _read_ply,
    ".stl": _read_stl,
    ".glb": _read_glb,
}
