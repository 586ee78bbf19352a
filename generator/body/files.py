"""Bodies from mesh files, OBJ and PLY."""

import io
import logging
from pathlib import Path

import numpy as np
import trimesh
from jaxtyping import Float

from gcd_dataset.bodyfiles import file_content, read_measurements, read_parts
from gcd_dataset.errors import BodyError
from gcd_dataset.generator.body.asset import body_model
from gcd_dataset.generator.body.pose import stand
from gcd_dataset.generator.body.tailor import measure
from gcd_dataset.records import Body, Measurements

__all__ = ["read_body"]

log = logging.getLogger(__name__)

TALLEST = 300.0  # cm; between this and SHORTEST a body's extent in y says its unit
SHORTEST = 30.0
UNITS = {"centimetres": 1.0, "metres": 100.0, "millimetres": 0.1}


def read_body(
    mesh: Path | str, measurements: Path | str | None = None, segmentation: Path | str | None = None
) -> tuple[Body, Measurements]:
    """The body in a mesh file and its measures.

    The mesh stands upright along y and faces +z, in metres, centimetres or millimetres; its vertices keep their order.
    ``measurements`` (YAML) and ``segmentation`` (JSON: part name to vertex ids) may be left out only for a mesh of our
    own, whose landmarks are known. Raises ``BodyError`` with the file and a remedy.
    """
    path = Path(mesh)
    vertices, faces = _read_mesh(path)
    ours = np.array_equal(faces, body_model().faces)
    if segmentation is None and not ours:
        raise BodyError(
            f"{path}: which vertices are arms and legs is not known: give a part segmentation (--segmentation)"
        )
    if measurements is None and not ours:
        raise BodyError(f"{path}: its landmarks are not known: give its measures (--measurements)")
    parts = body_model().parts if segmentation is None else read_parts(Path(segmentation), len(vertices), path)
    body = Body(vertices, faces, parts, path.stem)
    return body, measure(body) if measurements is None else read_measurements(measurements)


# ---------------------------------------------------------------------------------------------------------------- mesh


def _read_mesh(path: Path) -> tuple[Float[np.ndarray, "v 3"], np.ndarray]:
    """Vertices [cm] standing at y = 0, and faces seen counter-clockwise from outside."""
    content = file_content(path)
    kind = path.suffix.lower().removeprefix(".")
    if kind not in ("obj", "ply"):
        raise BodyError(f"{path}: a body is read from .obj or .ply: convert it")
    # Only names and remarks can be other than ASCII.
    stream = io.StringIO(content.decode(errors="replace")) if kind == "obj" else io.BytesIO(content)
    try:
        mesh = trimesh.load(stream, file_type=kind, force="mesh", process=False, maintain_order=True)
    except (ValueError, IndexError, KeyError, TypeError) as error:
        raise BodyError(f"{path}: cannot be read as {kind.upper()} ({error}): export the mesh again") from error
    vertices, faces = np.array(mesh.vertices, float), np.array(mesh.faces, int)
    if not len(faces) or not np.isfinite(vertices).all():
        raise BodyError(f"{path}: holds no triangles, or positions that are no numbers: export the mesh again")
    if not mesh.is_watertight:
        raise BodyError(f"{path}: the skin is not closed, so inside and outside are not known: fill its holes")
    if mesh.volume < 0:
        log.info("%s: its faces look inwards and were turned", path)
        faces = faces[:, ::-1]
    return stand(vertices * _unit(path, vertices)), faces


def _unit(path: Path, vertices: np.ndarray) -> float:
    """The factor to centimetres, by the height of a person."""
    height = np.ptp(vertices[:, 1])
    for name, factor in UNITS.items():
        if SHORTEST < height * factor < TALLEST:
            log.info("%s: taken to be in %s, %.1f cm tall", path, name, height * factor)
            return factor
    raise BodyError(
        f"{path}: {height:.4g} tall along y, which is a person's height in no unit: turn y up, scale it to cm"
    )
