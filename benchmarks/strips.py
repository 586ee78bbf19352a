"""Strips of cloth, meshed with equilateral triangles like a panel; Peirce's cantilever test and a tensile test."""

from collections.abc import Mapping
from dataclasses import replace
from typing import Literal

import numpy as np
import trimesh
import warp as wp
from jaxtyping import Bool, Float, Int

from gcd_dataset.generator.drape import DrapeConfig, DrapeJob, Fabric
from gcd_dataset.generator.drape.config import GRAVITY
from gcd_dataset.generator.drape.fabrics import STIFFEST
from gcd_dataset.generator.drape.model import ClothModel, build_model
from gcd_dataset.generator.drape.solver import Solver
from gcd_dataset.records import Body, BoxMesh, Measurements

Grain = Literal["warp", "weft"]
Direction = Literal["warp", "weft", "bias"]
DUMMY_MEASURES = Measurements(height=170.0, head_l=26.0, waist_line=37.0, neck_w=19.0, armscye_depth=13.0)
ORIENTATION = {
    "weft": np.array([[1.0, 0.0], [0.0, 0.0], [0.0, -1.0]]),
    "warp": np.array([[0.0, 1.0], [0.0, 0.0], [1.0, 0.0]]),
}
LEVEL = 80.0  # cm, height of the strip
CLAMPED = 2.0  # cm, length of the clamped end
WIDTH = 6.0  # cm
PEIRCE = 8.0  # c³ = l³ cos(angle / 2) / (8 tan(angle))
HEAVY = 1e12  # g: inertia of a held vertex
# The hinges at the outermost held vertices bend the cloth over half a row of faces to either side. Cloth is therefore
# clamped half a row behind these vertices. Without this, the bending length at 2 cm came out 20 to 30 % short.
HALF_ROW = 0.25 * np.sqrt(3)  # along the warp, across the rows [edges]
HALF_STEP = 0.25  # along the weft: rows are shifted by half an edge [edges]
HANGING, HANGING_WIDTH = 20.0, 5.0  # cm, strip of the tensile test, as in ISO 13934-1
STRAIN = 0.01  # strain of the tensile test


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
    return one_panel("strip", vertices, f, uv, labels)


def one_panel(
    name: str,
    vertices: Float[np.ndarray, "v 3"],
    faces: Int[np.ndarray, "f 3"],
    uv: Float[np.ndarray, "v 2"],
    labels: Mapping[str, np.ndarray] | None = None,
) -> BoxMesh:
    """The box mesh of a single panel without seams; positions and flat positions ``uv`` in cm."""
    return BoxMesh(
        vertices=vertices,
        faces=faces,
        uv=uv,
        corners=faces,
        uv_vertex=np.arange(len(uv)),
        panel_id=np.zeros(len(faces), int),
        panel_names=(name,),
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
    length = 2 * bending_length(fabric, grain) + CLAMPED
    size = (length, WIDTH) if grain == "weft" else (WIDTH, length)
    mesh = strip(*size, spacing, orientation=ORIENTATION[grain])
    x = mesh.vertices[:, 0]
    held = np.unique(np.round(x[x <= x.min() + max(CLAMPED, spacing) + 1e-6], 6)).max()
    tip = _settled(mesh, fabric, x <= held + 1e-6, device=device)[x >= x.max() - 1e-6].mean(axis=0)
    edge = held - spacing * (HALF_STEP if grain == "weft" else HALF_ROW)
    angle = float(np.arctan2(LEVEL - tip[1], tip[0] - edge))
    return float((x.max() - edge) * (np.cos(angle / 2) / (PEIRCE * np.tan(angle))) ** (1 / 3))


def tensile_stiffness(
    fabric: Fabric, direction: Direction, *, spacing: float = 1.0, stiffest: float = STIFFEST, device: str = "cpu"
) -> float:
    """Tensile stiffness of a hanging strip with a weight on its lower end [N/m]: force per width over strain.

    The strain is that of the middle half of the strip, away from the clamp. The weight stretches the strip by about
    ``STRAIN``. ``stiffest``: as in ``DrapeConfig``.
    """
    mesh = _hanging(direction, spacing)
    height = mesh.vertices[:, 1]
    width = float(np.ptp(mesh.vertices[:, 0]))
    pull = 1e3 * getattr(fabric.softened(stiffest).pull, direction) * STRAIN  # dyn/cm
    weight = _shares(mesh) * pull * width / GRAVITY
    x = _settled(mesh, fabric, height > height.max() - 1e-6, weight=weight, stiffest=stiffest, device=device)
    upper, lower = (_row(mesh, height.min() + share * np.ptp(height)) for share in (0.75, 0.25))
    flat = height[upper].mean() - height[lower].mean()
    strain = (x[upper, 1].mean() - x[lower, 1].mean()) / flat - 1
    below = 0.5 * (height[upper].mean() + height[lower].mean()) - height.min()
    return float((pull + fabric.mass * GRAVITY * below) / strain / 1e3)


def _hanging(direction: Direction, spacing: float) -> BoxMesh:
    """A vertical strip cut along ``direction``, in the plane z = 0."""
    if direction == "weft":
        return strip(HANGING, HANGING_WIDTH, spacing, orientation=np.array([[0.0, 1.0], [1.0, 0.0], [0.0, 0.0]]))
    mesh = strip(HANGING_WIDTH, HANGING, spacing, orientation=np.array([[1.0, 0.0], [0.0, 1.0], [0.0, 0.0]]))
    turn = np.sqrt(0.5) * np.array([[1.0, 1.0], [-1.0, 1.0]])
    return replace(mesh, uv=mesh.uv @ turn) if direction == "bias" else mesh


def _row(mesh: BoxMesh, level: float) -> Bool[np.ndarray, " v"]:
    """The vertices of the row nearest to a height [cm]; where rows are shifted, of both half rows."""
    height = mesh.vertices[:, 1]
    nearest = height[np.abs(height - level).argmin()]
    return np.abs(height - nearest) < 1e-6


def _shares(mesh: BoxMesh) -> Float[np.ndarray, " v"]:
    """Share of each vertex of the lower end in the width of the strip; 0 for the other vertices."""
    height = mesh.vertices[:, 1]
    end = np.flatnonzero(height < height.min() + 1e-6)
    end = end[np.argsort(mesh.vertices[end, 0])]
    gaps = np.diff(mesh.vertices[end, 0])
    shares = np.zeros(len(height))
    shares[end] = 0.5 * (np.append(gaps, 0.0) + np.append(0.0, gaps)) / gaps.sum()
    return shares


def _settled(
    mesh: BoxMesh,
    fabric: Fabric,
    held: Bool[np.ndarray, " v"],
    *,
    weight: Float[np.ndarray, " v"] | float = 0.0,
    stiffest: float = STIFFEST,
    device: str,
) -> Float[np.ndarray, "v 3"]:
    """Positions of a strip at rest [cm]; ``weight``: mass added to the vertices [g]."""
    config = DrapeConfig(sewing_time=1e-4, held_time=1e6, max_frames=1_000_000, damping=8.0, stiffest=stiffest)
    solver = Solver(build_model([strip_job(mesh, fabric)], config, device), config)
    hold_fast(solver.model, held)
    mass = solver.model.cloth.mass
    mass.assign((mass.numpy() + weight).astype(np.float32))
    solver.run_for(1.5)
    return np.asarray(solver.state.x.numpy().astype(float))
