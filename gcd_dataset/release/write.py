"""Garments of ours as the files of the published layout, so that code written for it reads them.

Where the layout stores less than we have, or in a worse form, we follow the layout: ply files split vertices at seams,
texture coordinates lose their scale, the rest lengths of seams are a pickle (of plain numbers: any reader takes them).
"""

import io
import json
import pickle
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import yaml
from jaxtyping import Float, Int
from PIL import Image

from gcd_dataset.bodyfiles import measurements_tree
from gcd_dataset.errors import ShardError
from gcd_dataset.records import ANGLES, BoxMesh, Drape, Measurements, Outcome, Record, Sample
from gcd_dataset.release.ply import Ply, weld, write_ply
from gcd_dataset.release.published_names import ENDINGS
from gcd_dataset.spec import spec_from_pattern

__all__ = ["FAIL_CLASSES", "PatternDrawing", "garment_files", "yaml_bytes"]

DUMPER = getattr(yaml, "CSafeDumper", yaml.SafeDumper)
PICTURE = 800  # pixels, of a render
PICKLE = 4  # protocol
DEGREE_DIGITS = 10

FAIL_CLASSES: Mapping[Outcome, str] = {
    Outcome.NOT_SETTLED: "static_equilibrium",
    Outcome.THROUGH_BODY: "cloth_body_intersection",
    Outcome.THROUGH_ITSELF: "cloth_self_intersection",
    Outcome.OVERSTRETCHED: "crashes",
    Outcome.SLID_OFF: "crashes",
    Outcome.FELL: "crashes",
    Outcome.OVERFULL: "crashes",
    Outcome.DIVERGED: "crashes",
}
"""How the properties of a batch call a drape that failed; they have one word for what they did not foresee."""


@dataclass(frozen=True, eq=False)
class PatternDrawing(Record):
    """What is drawn of a pattern, and where its panels lie in the drawing."""

    svg: bytes
    drawing: bytes
    """PNG of the pattern."""
    texture: bytes
    """PNG that the texture coordinates point into."""
    shifts: Float[np.ndarray, "p 2"]
    """From each panel's plane to the texture [cm]."""
    size: Float[np.ndarray, "2"]
    """Of the texture [cm]."""


def garment_files(
    sample: Sample, name: str, design: Mapping[str, Any], drawn: PatternDrawing, *, body_sample: str | None
) -> dict[str, bytes]:
    """File name to content, of the 13 files that a draped garment has there.

    ``design``: the tree of its parameters. ``body_sample``: who wears it; ``None`` on the default body. Raises
    ``ShardError`` for a garment that is not draped, or that the layout cannot hold.
    """
    mesh, drape = sample.box_mesh, sample.drape
    if mesh is None or drape is None:
        raise ShardError(f"sample {sample.key} is not draped, and the published layout holds drapes: make it so")
    content = {
        "spec": json.dumps(spec_from_pattern(sample.pattern), indent=2).encode(),
        "svg": drawn.svg,
        "drawing": drawn.drawing,
        "design": yaml_bytes({"design": design}),
        "measures": yaml_bytes({"body": _measures(sample.measurements, body_sample)}),
        **_meshes(sample.key, mesh, drape, drawn),
        "segmentation": "".join(f"{line}\n" for line in _segments(mesh)).encode(),
        "vertex_labels": yaml_bytes({str(label): ids.tolist() for label, ids in mesh.labels.items()}),
        "rest_lengths": pickle.dumps(_rest_lengths(mesh), protocol=PICKLE),
        "texture": drawn.texture,
        "front": _render(sample.front),
        "back": _render(sample.back),
    }
    return {f"{name}{ending}": content[kind] for kind, ending in ENDINGS.items()}


def yaml_bytes(tree: Mapping[str, Any]) -> bytes:
    """A tree as YAML with every digit, in its own order."""
    return yaml.dump(tree, Dumper=DUMPER, sort_keys=False, default_flow_style=False).encode()


def _measures(measurements: Measurements, body_sample: str | None) -> dict[str, float | str]:
    """The measures, without the digits that degrees gain on their way through radians."""
    tree: dict[str, float | str] = {
        key: round(value, DEGREE_DIGITS) if key.removeprefix("_") in ANGLES else value
        for key, value in measurements_tree(measurements).items()
    }
    return dict(sorted((tree if body_sample is None else tree | {"body_sample": body_sample}).items()))


def _meshes(key: str, mesh: BoxMesh, drape: Drape, drawn: PatternDrawing) -> dict[str, bytes]:
    """Both ply files: a vertex for each row of ``uv``, those of one vertex side by side."""
    panel_of_row = np.zeros(len(mesh.uv), np.int64)
    panel_of_row[mesh.corners] = mesh.panel_id[:, None]
    texture = (mesh.uv + drawn.shifts[panel_of_row]) / drawn.size
    rows = np.argsort(mesh.uv_vertex, kind="stable")
    place = np.empty_like(rows)
    place[rows] = np.arange(len(rows))
    faces = place[mesh.corners]
    positions = {
        kind: np.asarray(vertices, np.float32)[mesh.uv_vertex[rows]]
        for kind, vertices in (("box", mesh.vertices), ("sim", drape.vertices))
    }
    # Readers find a vertex again by its place.
    if not np.array_equal(weld(positions["sim"])[1], mesh.uv_vertex[rows]):
        raise ShardError(f"sample {key}: two vertices of its drape lie on each other, or one has no face: leave it out")
    return {kind: write_ply(Ply(places, texture[rows], faces)) for kind, places in positions.items()}


def _segments(mesh: BoxMesh) -> list[str]:
    """Panel, or seams, of every vertex."""
    segments = [""] * len(mesh.vertices)
    for face, panel in zip(mesh.faces.tolist(), mesh.panel_id.tolist(), strict=True):
        for vertex in face:
            segments[vertex] = mesh.panel_names[panel]
    seams: dict[int, list[str]] = {}
    for vertex, seam in mesh.seams.tolist():
        seams.setdefault(vertex, []).append(f"stitch_{seam}")
    for vertex, names in seams.items():
        segments[vertex] = ",".join(dict.fromkeys(names))
    return segments


def _rest_lengths(mesh: BoxMesh) -> dict[tuple[int, int], float]:
    """Length in the plane [cm] of every edge of the triangles that touch a seam; along a seam the shorter side's."""
    faces, corners = _touching(mesh)
    lengths: dict[tuple[int, int], float] = {}
    for face, corner in zip(faces.tolist(), corners.tolist(), strict=True):
        for i, j in ((0, 1), (1, 2), (0, 2)):
            edge = min(face[i], face[j]), max(face[i], face[j])
            flat = float(np.hypot(*(mesh.uv[corner[i]] - mesh.uv[corner[j]])))
            lengths[edge] = min(flat, lengths.get(edge, flat))
    return lengths


def _touching(mesh: BoxMesh) -> tuple[Int[np.ndarray, "n 3"], Int[np.ndarray, "n 3"]]:
    """Faces with a vertex on a seam, and their corners."""
    on_seam = np.zeros(len(mesh.vertices), bool)
    on_seam[mesh.seams[:, 0]] = True
    touching = on_seam[mesh.faces].any(axis=1)
    return mesh.faces[touching], mesh.corners[touching]


def _render(picture: bytes | None) -> bytes:
    """A picture of ours as the layout has them; of nothing where none was taken."""
    file = io.BytesIO()
    if picture is None:
        image = Image.new("RGBA", (PICTURE, PICTURE))
    else:
        image = Image.open(io.BytesIO(picture)).convert("RGBA")
    if image.size != (PICTURE, PICTURE):
        image = image.resize((PICTURE, PICTURE), Image.Resampling.LANCZOS)
    image.save(file, "PNG")
    return file.getvalue()
