"""The bodies that garments of a set are worn on: built from shape weights and pose."""

import hashlib
from functools import lru_cache, partial
from typing import Any

import numpy as np
from jaxtyping import Float, Int

from benchmarks.reconstruction.derived import CENTRE
from benchmarks.reconstruction.garments import GarmentSet
from benchmarks.reconstruction.surfaces import METRE, farthest_points
from gcd_dataset.errors import ConfigError
from gcd_dataset.generator.body.shape import build_body
from gcd_dataset.generator.render.figure import vertex_normals
from gcd_dataset.generator.views import stored_body, stored_scene
from gcd_dataset.measurements import MEASURES, Measurements
from gcd_dataset.records import Body, BodyPart, BodyShape, BoxMesh
from gcd_dataset.tensors import EDGE_LABELS
from gcd_dataset.workers import parallel_map

SCAN_CAMERAS, SCAN_POINTS, SCAN_SIZE = 4, 4096, 200
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
    rows = _rows(count, len(garments.shapes[0]))
    return list(parallel_map(partial(_points, rows), (shape_of(garments, k) for k in range(len(garments))), workers))


def dressed_scans(garments: GarmentSet, *, workers: int = 0) -> Float[np.ndarray, "g n 7"]:
    """Points of garment and visible skin as four cameras see them: relative to ``CENTRE`` [m], normals, 1 on cloth.

    Without noise, so that the error of a measure is that of the model. Raises ``ConfigError`` where no camera sees the
    garment.
    """
    jobs = (
        (key, box_mesh_of(garments, k), garments.ragged["verts"][k].astype(float), shape_of(garments, k))
        for k, key in enumerate(garments.keys)
    )
    found = np.stack(list(parallel_map(_scanned, jobs, workers)))
    for key, points in zip(garments.keys, found, strict=True):
        if not np.isfinite(points).all():
            raise ConfigError(f"garment {key}: no camera sees it: leave it out of the set")
    return found


def _scanned(job: tuple[str, BoxMesh, Float[np.ndarray, "v 3"], BodyShape]) -> Float[np.ndarray, "n 7"]:
    from gcd_dataset.generator.render.scans import NOISELESS, draw_scan_cameras, scan

    key, mesh, vertices, shape = job
    scene = stored_scene(mesh, vertices, stored_body(shape))
    chance = np.random.default_rng(list(hashlib.sha256(key.encode()).digest()))
    cameras = draw_scan_cameras(chance, scene, SCAN_CAMERAS, body=True)
    options: dict[str, Any] = {"noise": NOISELESS, "body": True, "size": SCAN_SIZE, "device": "cpu"}
    found = scan(scene, cameras, chance, points=SCAN_POINTS, **options)
    columns = [(found.points - CENTRE) / METRE, found.normals, (found.panel_id >= 0)[:, None]]
    return np.concatenate(columns, axis=1).astype(np.float32)


def box_mesh_of(garments: GarmentSet, k: int) -> BoxMesh:
    """The box mesh of garment ``k`` as it was draped; panels are named by number."""
    ragged, pattern = garments.ragged, garments.pattern(k)
    labels = ragged["labels"][k]
    known = {name: labels[labels[:, 1] == row, 0].astype(int) for row, name in enumerate(EDGE_LABELS) if name}
    return BoxMesh(
        vertices=ragged["box"][k].astype(float),
        uv=ragged["uv"][k].astype(float),
        panel_names=tuple(panel.name for panel in pattern.panels),
        panel_labels=tuple(panel.label for panel in pattern.panels),
        labels={name: rows for name, rows in known.items() if len(rows)},
        **{name: ragged[name][k].astype(np.int64) for name in ("faces", "corners", "uv_vertex", "panel_id", "seams")},
    )


@lru_cache(maxsize=4)
def _rows(count: int, weights: int) -> Int[np.ndarray, " n"]:
    """Vertices of the mean body, spread evenly."""
    body = build_body(BodyShape(np.zeros(weights)))
    shown = np.flatnonzero(~np.isin(body.parts, HIDDEN))
    return shown[farthest_points(body.vertices[shown], count)]


def _points(rows: Int[np.ndarray, " n"], shape: BodyShape) -> Float[np.ndarray, "n 6"]:
    body = stored_body(shape)
    normals = vertex_normals(body.vertices, body.faces)
    return np.concatenate([(body.vertices - CENTRE) / METRE, normals], axis=1)[rows].astype(np.float32)
