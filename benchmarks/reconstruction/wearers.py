"""The bodies that garments of a set are worn on: built from shape weights and pose."""

from functools import lru_cache, partial

import numpy as np
from jaxtyping import Float, Int

from benchmarks.reconstruction.derived import CENTRE
from benchmarks.reconstruction.garments import GarmentSet
from benchmarks.reconstruction.surfaces import METRE, farthest_points
from gcd_dataset.generator.body.shape import build_body
from gcd_dataset.generator.render.figure import vertex_normals
from gcd_dataset.generator.views import stored_body
from gcd_dataset.measurements import MEASURES, Measurements
from gcd_dataset.records import Body, BodyPart, BodyShape, BoxMesh
from gcd_dataset.scoring.arrays import box_mesh_of as arrays_mesh
from gcd_dataset.scoring.inputs import MESH
from gcd_dataset.workers import parallel_map

HIDDEN = tuple(part.value for part in (BodyPart.INTERNAL, BodyPart.HEAD, BodyPart.HANDS, BodyPart.FEET))


def shape_of(garments: GarmentSet, k: int) -> BodyShape:
    """Shape and pose of the wearer of garment ``k``, of a set with ``pose``."""
    angle, apart = garments.ragged["pose"][k][0].tolist()
    return BodyShape(garments.shapes[k].astype(float), float(angle), legs_apart=bool(apart))


def wearer_of(garments: GarmentSet, k: int) -> Body:
    """The body of the wearer of garment ``k``."""
    return stored_body(shape_of(garments, k))


def measurements_of(garments: GarmentSet, k: int) -> Measurements:
    """The measures of the wearer of garment ``k``."""
    return Measurements.from_file_values(dict(zip(MEASURES, garments.measures[k].tolist(), strict=True)))


def body_points(garments: GarmentSet, count: int, *, workers: int = 0) -> list[Float[np.ndarray, "n 6"]]:
    """``count`` points of each wearer's skin, relative to ``CENTRE`` [m], and normals.

    The same vertices of every body, without head, hands and feet.
    """
    rows = skin_rows(count, len(garments.shapes[0]))
    return list(parallel_map(partial(_points, rows), (shape_of(garments, k) for k in range(len(garments))), workers))


def box_mesh_of(garments: GarmentSet, k: int) -> BoxMesh:
    """The box mesh of garment ``k`` as it was draped; panels are named by number."""
    arrays = {name: garments.ragged[name][k] for name in MESH} | {"vertices": garments.ragged["box"][k]}
    return arrays_mesh(arrays, garments.pattern(k))


def unhidden(body: Body) -> Int[np.ndarray, " n"]:
    """Vertices of a body without head, hands and feet."""
    return np.flatnonzero(~np.isin(body.parts, HIDDEN))


@lru_cache(maxsize=4)
def skin_rows(count: int, weights: int) -> Int[np.ndarray, " n"]:
    """Vertices of the mean body, spread evenly."""
    body = build_body(BodyShape(np.zeros(weights)))
    shown = unhidden(body)
    return shown[farthest_points(body.vertices[shown], count)]


def _points(rows: Int[np.ndarray, " n"], shape: BodyShape) -> Float[np.ndarray, "n 6"]:
    return skin_points(stored_body(shape), rows)


def skin_points(body: Body, rows: Int[np.ndarray, " n"]) -> Float[np.ndarray, "n 6"]:
    """Vertices of a body, relative to ``CENTRE`` [m], and normals."""
    normals = vertex_normals(body.vertices, body.faces)
    return np.concatenate([(body.vertices - CENTRE) / METRE, normals], axis=1)[rows].astype(np.float32)
