"""Standard tests of cloth: Peirce's cantilever, a tensile strip, and Cusick's drapemeter.

Panels are meshed with equilateral triangles, like those of garments. The drapemeter (BS 5058; ISO 9073-9) measures the
shadow of a disc of cloth that hangs over a smaller disc.
"""

from collections.abc import Mapping
from dataclasses import replace
from typing import Literal, NamedTuple

import numpy as np
import shapely
import trimesh
import warp as wp
from jaxtyping import Bool, Float, Int
from scipy.spatial import Delaunay

from gcd_dataset.errors import DrapeError
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


# ----------------------------------------------------------------------------------------------------------- drapemeter


SPECIMEN, SUPPORT = 15.0, 9.0  # cm, radii of the cloth and of the support
# Positions are single precision: at 80 cm discs of 0.5 cm stopped before rest, 0.8 points high, since displacements of
# a substep below 4e-6 cm are lost.
DISC_LEVEL = 10.0  # cm, height of the support
# A cotton disc stores half of its bending energy within 1 cm of the support's edge. Uniform meshes of 1 and 2 cm do not
# resolve it: their coefficients came out 2 and 5 points below that of 0.35 cm. Garments have no such edge.
EDGE = 0.25  # cm, edge length there
ROWS, GAP = 2.0, 0.25  # width of the band of each edge length, and gap to the next [edge lengths]
CLEAR = 0.6  # least distance of lattice points from both rings of vertices [edge lengths]
LOWERING, STEPS = 3.0, 30  # time over which the weight grows [s], and the number of steps in which it grows
LOOK_EVERY = 0.25  # s between two evaluations of the drape coefficient
AT_REST = 0.05  # the disc is at rest if its coefficient changes less between two evaluations [%]
LONGEST = 20.0  # s of simulated time until a disc must be at rest
FOLD = 0.15  # cm: a rim has folds only if its distances from the axis vary by more


class Draped(NamedTuple):
    """A disc at rest in the drapemeter."""

    coefficient: float
    """Area of the shadow outside the support over area of the cloth outside the support [%]."""
    folds: int
    vertices: Float[np.ndarray, "v 3"]
    """Positions [cm]; y is up."""


def disc(spacing: float, *, specimen: int = 0, edge: float = EDGE) -> BoxMesh:
    """A disc meshed like a panel: sampled border, triangular lattice with rows along the weft.

    Toward the edge of the support the spacing is halved down to ``edge`` [cm]; an ``edge`` of at least the spacing
    gives a uniform mesh. A ring of vertices lies where the support clamps the cloth, so that the clamped area is the
    same at any spacing. ``specimen``: seed of the shift of the lattices relative to the disc.
    """
    shift, sizes = np.random.default_rng(specimen).random(2), _sizes(spacing, edge)
    clamp = _clamp(sizes[0])
    points, near = [_ring(SPECIMEN, spacing), _ring(clamp, sizes[0])], 0.0
    for size in sizes:
        far = np.inf if size == spacing else near + ROWS * size
        lattice = _lattice(size) + size * shift
        radius = np.linalg.norm(lattice, axis=1)
        beside = np.abs(radius - clamp)
        inside = (beside > max(near, CLEAR * size)) & (beside <= far) & (radius < SPECIMEN - CLEAR * spacing)
        points.append(lattice[inside])
        near = far + GAP * size
    uv = np.concatenate(points)
    faces = np.asarray(Delaunay(uv).simplices, int)
    return one_panel("disc", np.stack([uv[:, 0], np.full(len(uv), DISC_LEVEL), -uv[:, 1]], axis=1), faces, uv)


def _sizes(spacing: float, edge: float) -> list[float]:
    """Edge lengths from the edge of the support outward [cm]."""
    sizes = [spacing]
    while sizes[0] > edge:
        sizes.insert(0, max(0.5 * sizes[0], edge))
    return sizes


def _clamp(size: float) -> float:
    """Radius of the held vertices [cm]: larger than ``SUPPORT``, since cloth is clamped ``HALF_ROW`` behind them.

    ``size``: edge length at the clamp [cm].
    """
    return SUPPORT + HALF_ROW * size


def _held(mesh: BoxMesh, spacing: float, edge: float) -> Bool[np.ndarray, " v"]:
    return np.linalg.norm(mesh.uv, axis=1) <= _clamp(_sizes(spacing, edge)[0]) + 1e-6


def _ring(radius: float, spacing: float) -> Float[np.ndarray, "n 2"]:
    count = max(round(2 * np.pi * radius / spacing), 12)
    angle = 2 * np.pi * np.arange(count) / count
    return radius * np.stack([np.cos(angle), np.sin(angle)], axis=1)


def _lattice(spacing: float) -> Float[np.ndarray, "n 2"]:
    half = int(np.ceil(1.3 * SPECIMEN / spacing))
    row, column = np.mgrid[-half : half + 1, -half : half + 1]
    return spacing * np.stack([column + 0.5 * (row % 2), np.sqrt(0.75) * row], axis=-1).reshape(-1, 2)


def drape_coefficient(
    fabric: Fabric,
    *,
    spacing: float = 1.0,
    specimens: int = 1,
    edge: float = EDGE,
    stiffest: float = STIFFEST,
    device: str = "cpu",
) -> float:
    """Cusick's drape coefficient of a fabric [%], the mean over ``specimens`` discs; see ``drape_disc``."""
    found = [
        drape_disc(fabric, spacing=spacing, specimen=number, edge=edge, stiffest=stiffest, device=device).coefficient
        for number in range(specimens)
    ]
    return float(np.mean(found))


def drape_disc(
    fabric: Fabric,
    *,
    spacing: float = 1.0,
    specimen: int = 0,
    edge: float = EDGE,
    stiffest: float = STIFFEST,
    device: str = "cpu",
) -> Draped:
    """Drape a disc with the garments' solver. ``edge``: as in ``disc``; ``stiffest``: as in ``DrapeConfig``.

    The weight grows over ``LOWERING`` seconds, since in the laboratory test the table round the support is lowered by
    hand: cloth that falls freely buckles into more folds. Raises ``DrapeError`` for a disc that does not come to rest.
    """
    mesh = disc(spacing, specimen=specimen, edge=edge)
    config = DrapeConfig(sewing_time=1e-4, held_time=1e6, max_frames=1_000_000, stiffest=stiffest)
    solver = Solver(build_model([strip_job(mesh, fabric)], config, device), config)
    hold_fast(solver.model, _held(mesh, spacing, edge))
    _lower(solver)
    before, time = np.inf, LOWERING
    while time < LONGEST:
        time += LOOK_EVERY
        solver.run_for(time)
        x = solver.state.x.numpy().astype(float)
        coefficient = _coefficient(x, mesh)
        if abs(coefficient - before) < AT_REST:
            return Draped(coefficient, folds(x, mesh), x)
        before = coefficient
    raise DrapeError(f"a disc of spacing {spacing} cm still moves after {LONGEST} s: raise LONGEST")


def _lower(solver: Solver) -> None:
    for step in range(1, STEPS + 1):
        worlds = solver.model.worlds.numpy()
        worlds["gravity"] = GRAVITY * step / STEPS
        wp.copy(solver.model.worlds, wp.array(worlds, dtype=solver.model.worlds.dtype, device=solver.model.device))
        solver.run_for(LOWERING * step / STEPS)


def _coefficient(x: Float[np.ndarray, "v 3"], mesh: BoxMesh) -> float:
    support = np.pi * SUPPORT**2
    flat = float(shapely.area(shapely.polygons(mesh.uv[mesh.faces])).sum())
    return 100 * (shadow(x, mesh) - support) / (flat - support)


def shadow(x: Float[np.ndarray, "v 3"], mesh: BoxMesh) -> float:
    """Area of the mesh seen from above [cm²]; layers count once."""
    seen = shapely.polygons(x[mesh.faces][:, :, [0, 2]])
    return float(shapely.union_all(seen[shapely.area(seen) > 1e-9], grid_size=1e-6).area)


def folds(x: Float[np.ndarray, "v 3"], mesh: BoxMesh) -> int:
    """Number of folds of the rim: along it, the distance from the axis rises above its mean once per fold."""
    rim = x[_on_rim(mesh)]
    radius = np.linalg.norm(rim[:, [0, 2]], axis=1)
    out = radius > radius.mean()
    return int((out & ~np.roll(out, 1)).sum()) if np.ptp(radius) > FOLD else 0


def _on_rim(mesh: BoxMesh) -> Bool[np.ndarray, " v"]:
    return np.linalg.norm(mesh.uv, axis=1) > SPECIMEN - 1e-6
