"""Cusick's drapemeter: the shadow of a disc of cloth that hangs over a smaller disc (BS 5058; ISO 9073-9)."""

from typing import NamedTuple

import numpy as np
import shapely
import warp as wp
from jaxtyping import Bool, Float
from scipy.spatial import Delaunay

from benchmarks.strips import HALF_ROW, hold_fast, one_panel, strip_job
from gcd_dataset.errors import DrapeError
from gcd_dataset.generator.drape import DrapeConfig, Fabric
from gcd_dataset.generator.drape.config import GRAVITY
from gcd_dataset.generator.drape.fabrics import STIFFEST
from gcd_dataset.generator.drape.model import build_model
from gcd_dataset.generator.drape.solver import Solver
from gcd_dataset.records import BoxMesh

SPECIMEN, SUPPORT = 15.0, 9.0  # cm, radii of the cloth and of the support
# Positions are single precision: at 80 cm discs of 0.5 cm stopped before rest, 0.8 points high, since displacements of
# a substep below 4e-6 cm are lost.
LEVEL = 10.0  # cm, height of the support
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
    return one_panel("disc", np.stack([uv[:, 0], np.full(len(uv), LEVEL), -uv[:, 1]], axis=1), faces, uv)


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
