"""Strips of cloth, meshed with equilateral triangles like a panel, and Peirce's cantilever test."""

from collections.abc import Mapping
from typing import Literal

import numpy as np
import trimesh
import warp as wp
from jaxtyping import Float

from gcd_dataset.generator.drape import DrapeConfig, DrapeJob, Fabric
from gcd_dataset.generator.drape.config import GRAVITY
from gcd_dataset.generator.drape.model import ClothModel, build_model
from gcd_dataset.generator.drape.solver import Solver
from gcd_dataset.records import Body, BoxMesh, Measurements

__all__ = ["Grain", "bending_length", "cantilever", "hold_fast", "strip", "strip_job"]

Grain = Literal["warp", "weft"]
DUMMY_MEASURES = Measurements(height=170.0, head_l=26.0, waist_line=37.0, neck_w=19.0, armscye_depth=13.0)
ORIENTATION = {
    "weft": np.array([[1.0, 0.0], [0.0, 0.0], [0.0, -1.0]]),
    "warp": np.array([[0.0, 1.0], [0.0, 0.0], [1.0, 0.0]]),
}
LEVEL = 80.0  # cm, height of the strip
CLAMPED = 2.0  # cm, length of the clamped end
WIDTH = 6.0  # cm
PEIRCE = 8.0  # c³ = l³ cos(angle / 2) / (8 tan(angle))
HEAVY = 1e12  # g


def strip(
    width: float,
    height: float,
    spacing: float,
    *,
    orientation: Float[np.ndarray, "3 2"] = ORIENTATION["weft"],
    labels: Mapping[str, np.ndarray] | None = None,
) -> BoxMesh:
    """A rectangle of equilateral triangles of edge length ``spacing``, of about ``width`` × ``height`` [cm].

    Its centre is at (0, ``LEVEL``, 0). Every second row is completed with half triangles. ``orientation``: the images
    of the panel's x and y axes in space.
    """
    columns, rows = round(width / spacing), round(height / spacing / np.sqrt(0.75))
    flat, row_of = [], []
    for row in range(rows + 1):
        inner = np.arange(columns + 1.0) if row % 2 == 0 else np.array([0.0, *(np.arange(columns) + 0.5), columns])
        flat += [(spacing * x, spacing * np.sqrt(0.75) * row) for x in inner]
        row_of.append(len(inner))
    first = np.cumsum([0, *row_of])
    faces: list[tuple[int, int, int]] = []
    for row in range(rows):
        even, odd = (row, row + 1) if row % 2 == 0 else (row + 1, row)
        a, b, up = int(first[even]), int(first[odd]), row % 2 == 0
        sides = [(a + i, b + i + 1, b + i) for i in range(columns + 1)]
        sides += [(a + i, a + i + 1, b + i + 1) for i in range(columns)]
        faces += sides if up else [(i, k, j) for i, j, k in sides]
    uv, f = np.array(flat), np.array(faces)
    vertices = (uv - 0.5 * uv.max(axis=0)) @ orientation.T + np.array([0.0, LEVEL, 0.0])
    return BoxMesh(
        vertices=vertices,
        faces=f,
        uv=uv,
        corners=f,
        uv_vertex=np.arange(len(uv)),
        panel_id=np.zeros(len(f), int),
        panel_names=("strip",),
        panel_labels=("body",),
        seams=np.zeros((0, 2), int),
        labels=labels or {},
    )


def strip_job(mesh: BoxMesh, fabric: Fabric) -> DrapeJob:
    """A drape job for a strip, its body far away."""
    ball = trimesh.creation.icosphere(subdivisions=1, radius=5.0)
    ball.apply_translation([0.0, 5.0, 300.0])
    body = Body(np.asarray(ball.vertices, float), np.asarray(ball.faces), np.zeros(len(ball.vertices), np.uint8))
    return DrapeJob(mesh, body, DUMMY_MEASURES, fabric)


def hold_fast(model: ClothModel, held: np.ndarray) -> None:
    """Fix vertices by a huge inertia; their weight stays."""
    inertia = model.cloth.inertia.numpy()
    inertia[held] = HEAVY
    model.cloth.inertia.assign(wp.array(inertia, dtype=float, device=model.device))


def bending_length(fabric: Fabric, grain: Grain) -> float:
    """The theoretical bending length of a strip cut along the grain: (rigidity / weight)^(1/3) [cm].

    Peirce, The handle of cloth as a measurable quantity, J. Textile Inst. 21, 1930; ISO 9073-7.
    """
    return float((getattr(fabric.bend, grain) * 1e7 / (fabric.mass * GRAVITY)) ** (1 / 3))


def cantilever(fabric: Fabric, grain: Grain, *, spacing: float = 1.0, device: str = "cpu") -> float:
    """The bending length measured on a strip that overhangs an edge by twice the theoretical length [cm]."""
    overhang = 2 * bending_length(fabric, grain)
    length = overhang + CLAMPED
    size = (length, WIDTH) if grain == "weft" else (WIDTH, length)
    mesh = strip(*size, spacing, orientation=ORIENTATION[grain])
    x = mesh.vertices[:, 0]
    config = DrapeConfig(sewing_time=1e-4, held_time=1e6, max_frames=10_000, damping=8.0)
    solver = Solver(build_model([strip_job(mesh, fabric)], config, device), config)
    edge = np.unique(np.round(x[x <= x.min() + CLAMPED + 1e-6], 6)).max()
    hold_fast(solver.model, x <= edge + 1e-6)
    solver.run_for(1.5)
    tip = solver.state.x.numpy()[x >= x.max() - 1e-6].mean(axis=0)
    free = float(x.max() - edge)
    angle = float(np.arctan2(LEVEL - tip[1], tip[0] - edge))
    return float(free * (np.cos(angle / 2) / (PEIRCE * np.tan(angle))) ** (1 / 3))
