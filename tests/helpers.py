"""Shapes with known answers, changed records and files, and a wait for other processes."""

import time
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
import trimesh

from gcd_dataset.generator.device import Result, Resumable
from gcd_dataset.records import Body, BoxMesh, Drape, EdgeRef, Measurements, Outcome, Pattern, Sample, Seam
from tests.generator.mesh.shapes import panel, rectangle

SIZE = Measurements(height=170.0, head_l=26.0, waist_line=37.0, neck_w=19.0, armscye_depth=13.0)


def waited(work: Resumable[Result]) -> Result:
    """The result of work on a CPU, where each step ends at once."""
    while True:
        try:
            next(work)
        except StopIteration as end:
            result: Result = end.value
            return result


def body_from(shape: trimesh.Trimesh) -> Body:
    """A body of any closed shape, all trunk."""
    vertices = np.asarray(shape.vertices, float)
    return Body(vertices, np.asarray(shape.faces), np.zeros(len(vertices), np.uint8))


def far_ball() -> Body:
    """A body far from any cloth: a sphere of 5 cm radius, 2 m in front."""
    ball = trimesh.creation.icosphere(subdivisions=2, radius=5.0)
    ball.apply_translation([0.0, 5.0, 200.0])
    return body_from(ball)


def patch(
    columns: int,
    rows: int,
    *,
    spacing: float = 1.0,
    place: np.ndarray | None = None,
    origin: tuple[float, float, float] = (0.0, 0.0, 0.0),
    labels: Mapping[str, np.ndarray] | None = None,
) -> BoxMesh:
    """A rectangle of cloth, ``columns`` × ``rows`` cells of two triangles; ``place`` (3, 2) maps its plane to space."""
    u, v = np.meshgrid(np.arange(columns + 1), np.arange(rows + 1))
    uv = spacing * np.stack([u.ravel(), v.ravel()], axis=1).astype(float)
    cell = (np.arange(rows)[:, None] * (columns + 1) + np.arange(columns)).ravel()
    lower = np.stack([cell, cell + 1, cell + columns + 2], axis=1)
    upper = np.stack([cell, cell + columns + 2, cell + columns + 1], axis=1)
    faces = np.concatenate([lower, upper])
    frame = np.eye(3)[:, :2] if place is None else place
    return BoxMesh(
        vertices=uv @ frame.T + np.asarray(origin),
        faces=faces,
        uv=uv,
        corners=faces,
        uv_vertex=np.arange(len(uv)),
        panel_id=np.zeros(len(faces), int),
        panel_names=("patch",),
        panel_labels=("body",),
        seams=np.zeros((0, 2), int),
        labels=labels or {},
    )


def joined(first: BoxMesh, second: BoxMesh) -> BoxMesh:
    """Two pieces of cloth as one garment of two panels, not sewn together."""
    n, c, p = len(first.vertices), len(first.uv), len(first.panel_names)
    return BoxMesh(
        vertices=np.concatenate([first.vertices, second.vertices]),
        faces=np.concatenate([first.faces, second.faces + n]),
        uv=np.concatenate([first.uv, second.uv]),
        corners=np.concatenate([first.corners, second.corners + c]),
        uv_vertex=np.concatenate([first.uv_vertex, second.uv_vertex + n]),
        panel_id=np.concatenate([first.panel_id, second.panel_id + p]),
        panel_names=first.panel_names + second.panel_names,
        panel_labels=first.panel_labels + second.panel_labels,
        seams=np.zeros((0, 2), int),
        labels={**first.labels, **{k: v + n for k, v in second.labels.items()}},
    )


def tube(columns: int, rows: int, *, radius: float, spacing: float = 1.0, height: float = 0.0) -> BoxMesh:
    """A ring of cloth, cut ``columns * spacing`` round, hung on a circle of ``radius`` round the y axis."""
    sheet = patch(columns, rows, spacing=spacing)
    column, row = np.arange(len(sheet.uv)) % (columns + 1), np.arange(len(sheet.uv)) // (columns + 1)
    vertex = row * columns + column % columns  # the last column is the first
    angle = 2 * np.pi * (column % columns) / columns
    points = np.stack([radius * np.sin(angle), height + sheet.uv[:, 1], radius * np.cos(angle)], axis=1)
    placed = np.zeros((columns * (rows + 1), 3))
    placed[vertex] = points
    return replace(sheet, vertices=placed, faces=vertex[sheet.corners], uv_vertex=vertex)


def napkins() -> Pattern:
    """Two panels of 20 × 10 cm, sewn together."""
    panels = panel("one", rectangle(20, 10)), panel("two", rectangle(20, 10))
    return Pattern("napkins", panels, (Seam(EdgeRef("one", 1), EdgeRef("two", 3)),))


def renamed(pattern: Pattern, names: Mapping[str, str]) -> Pattern:
    """The pattern with other names of its panels; ``names``: old to new."""

    def ref(old: EdgeRef) -> EdgeRef:
        return replace(old, panel=names.get(old.panel, old.panel))

    panels = [replace(panel, name=names.get(panel.name, panel.name)) for panel in pattern.panels]
    seams = [replace(seam, left=ref(seam.left), right=ref(seam.right)) for seam in pattern.seams]
    return replace(pattern, panels=tuple(panels), seams=tuple(seams))


def parts(sample: Sample) -> tuple[BoxMesh, Drape]:
    """Mesh and drape of a draped sample."""
    assert sample.box_mesh is not None and sample.drape is not None
    return sample.box_mesh, sample.drape


def as_draped(made: Sample, outcome: Outcome = Outcome.SETTLED) -> Sample:
    """A garment whose box mesh, a little moved, stands for its drape."""
    assert made.box_mesh is not None
    moved = made.box_mesh.vertices + 1e-3 * (1 + made.box_mesh.vertices[:, :1])
    return replace(made, drape=Drape(moved, outcome, 100, 1, 2, 1.0, 1.1))


def flip(path: Path, place: int, *, after: bytes = b"") -> None:
    """Change a bit of a file, ``place`` bytes after the beginning of a text."""
    content = bytearray(path.read_bytes())
    content[content.index(after) + place] ^= 1
    path.write_bytes(content)


def wait_until(holds: Callable[[], bool], *, seconds: float = 90.0) -> None:
    end = time.monotonic() + seconds
    while not holds():
        assert time.monotonic() < end, f"not within {seconds:.0f} s"
        time.sleep(0.1)
