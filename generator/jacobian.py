"""Derivatives of a drape by design parameters, from one batch of drapes of designs that differ a little.

Cloth that folds has no useful exact derivative: a fold that flips moves it by centimetres. So all parameters are
changed at once by about a step up or down, at random, in pairs of opposite signs, and positions are fitted by least
squares: each drape tells of each parameter, and single folds average out. Material points are the same in all drapes,
though patterns and meshes differ: a point of a panel is carried to the other outline by mean value coordinates
(Hormann and Floater, ACM TOG 25(4), 2006).
"""

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cache, partial
from itertools import chain
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial import cKDTree
from trimesh.triangles import closest_point, points_to_barycentric

from gcd_dataset.errors import ConfigError, DrapeError, GcdError, did_you_mean
from gcd_dataset.generator.drape import DrapeJob, Fabric, drape_batch
from gcd_dataset.generator.drape.config import USUAL_FABRIC
from gcd_dataset.generator.dressing.openings import panel_outline
from gcd_dataset.generator.dressing.sewing_start import sewing_start
from gcd_dataset.generator.garments import GarmentDesign, design_from_dict, design_to_dict
from gcd_dataset.generator.garments.parameter import Real
from gcd_dataset.generator.garments.rules import DrawnGarment
from gcd_dataset.generator.garments.space import leaves
from gcd_dataset.generator.mesh import build_box_mesh, coarse_start
from gcd_dataset.records import Body, BoxMesh, Drape, Measurements, Outcome, Pattern
from gcd_dataset.workers import Pool, parallel_map

STEP = 0.05  # of a parameter's range
EACH = 12  # points of an edge, without its end, to which material points are related
NEAR = 6  # triangles among which the one at a material point is looked for
PAIRS_EACH = 2  # pairs of drapes for each parameter
FEWEST_PAIRS = 12
CARRIED = 8  # drapes of a task of a worker
ON_OUTLINE = 1e-3  # cm
RIDGE = 1e-3  # of a variance: keeps parameters apart that changed alike


@dataclass(frozen=True, eq=False)
class Worn:
    """A design drawn for a wearer, dressed and meshed."""

    pattern: Pattern
    job: DrapeJob


@dataclass(frozen=True)
class Fitting:
    """Draws designs for one wearer; ``body`` has its legs apart for garments with legs."""

    body: Body
    size: Measurements
    resolution: float = 2.0
    """Edges of the meshes [cm]."""
    fabric: Fabric = USUAL_FABRIC

    def worn(self, design: GarmentDesign) -> Worn | None:
        """The design on the wearer; ``None`` if it cannot be drawn, placed or meshed."""
        try:
            pattern = DrawnGarment.of(self.size, design).pattern
            mesh = build_box_mesh(pattern, spacing=self.resolution)
            coarse = coarse_start(mesh)
            start = sewing_start(coarse.mesh if coarse else mesh, self.body)
        except GcdError:
            return None
        return Worn(pattern, DrapeJob(mesh, self.body, self.size, self.fabric, coarse, start))


@dataclass(frozen=True, eq=False)
class DrapeJacobian:
    """A drape, and the movement of its vertices with the parameters of its design.

    Vertices are those of ``worn.job.box_mesh``.
    """

    parameters: tuple[str, ...]
    """Paths in design files, such as ``pants.length``."""
    spans: Float[np.ndarray, " d"]
    """Length of each parameter's range, in its unit."""
    worn: Worn
    drape: Drape
    positions: Float[np.ndarray, "v 3"]
    """Of the fitted linear map at the design [cm]: the mean of many drapes, smoother than ``drape``."""
    derivatives: Float[np.ndarray, "d v 3"]
    """Movement [cm] for a change by a parameter's whole range; divide by ``spans`` for centimetres per unit."""
    fitted: Sequence["Draped"]
    """The drapes to which the map is fitted; the first is ``drape``."""


class Draped(NamedTuple):
    """A design, dressed, and its drape."""

    design: GarmentDesign
    worn: Worn
    drape: Drape


def real_parameters(design: GarmentDesign, size: Measurements, *, workers: int | Pool = 1) -> tuple[str, ...]:
    """The real parameters that move the outlines of a design for a wearer, by their paths.

    Those that would add edges, such as the depth of a slit that the design lacks, are choices. ``workers``: processes
    that draw. Raises ``PatternError`` for a design that cannot be drawn.
    """
    drawn = DrawnGarment.of(size, design).pattern
    tree, used = design_to_dict(design), design.sections_used() | {"left"}
    some = [path for path in _reals() if path.split(".")[0].replace("-", "_") in used]
    known = [path for path in some if value_at(tree, path) is not None]
    changes = parallel_map(partial(_changes, design, size, drawn), known, workers)
    return tuple(path for path, is_one in zip(known, changes, strict=True) if is_one)


def _changes(design: GarmentDesign, size: Measurements, drawn: Pattern, path: str) -> bool:
    """Whether a parameter, moved inwards, moves the outlines of the drawn pattern, and adds no edge."""
    inward = 0.02 if value_at(design_to_dict(design), path) < 0.5 * sum(_reals()[path].range) else -0.02
    with suppress(GcdError):
        other = DrawnGarment.of(size, moved(design, {path: inward})).pattern
        return _alike(drawn, other) and not all(
            np.array_equal(panel_outline(a, EACH + 1), panel_outline(b, EACH + 1))
            for a, b in zip(drawn.panels, other.panels, strict=True)
        )
    return False


def moved(design: GarmentDesign, by: Mapping[str, float]) -> GarmentDesign:
    """The design with real parameters moved by shares of their ranges, and kept in these."""
    tree, reals = design_to_dict(design), _reals()
    for path, share in by.items():
        *parents, name = path.split(".")
        node = tree
        for key in parents:
            node = node[key]
        low, high = reals[path].range
        node[name] = float(np.clip(node[name] + share * (high - low), low, high))
    return design_from_dict(tree)


def moves_between(one: GarmentDesign, other: GarmentDesign, paths: Sequence[str]) -> Float[np.ndarray, " d"]:
    """From one design to another: differences of real parameters, in shares of their ranges."""
    trees, ranges = [design_to_dict(each) for each in (one, other)], [_reals()[path].range for path in paths]
    before, after = ([value_at(tree, path) for path in paths] for tree in trees)
    return np.array([(b - a) / (high - low) for a, b, (low, high) in zip(before, after, ranges, strict=True)])


def choices_of(design: GarmentDesign) -> str:
    """The same text for designs that differ in real parameters alone."""
    tree = design_to_dict(design)
    return repr(moved(design, {path: -1.0 for path in _reals() if value_at(tree, path) is not None}))


def drape_jacobian(
    design: GarmentDesign,
    fitting: Fitting,
    parameters: Sequence[str] | None = None,
    *,
    step: float = STEP,
    pairs: int | None = None,
    seed: int = 0,
    device: str = "auto",
    workers: int | Pool = 1,
) -> DrapeJacobian:
    """Derivatives of the drape by ``parameters``, by default ``real_parameters``.

    ``step``: change of each parameter, as a share of its range. ``pairs``: of drapes (default: two for each parameter,
    at least twelve). ``workers``: processes that draw, dress, mesh and carry points. Raises ``ConfigError`` for an
    unknown parameter, ``DrapeError`` if the design or too many of its neighbours cannot be draped.
    """
    names = tuple(parameters) if parameters is not None else real_parameters(design, fitting.size, workers=workers)
    tree, known = design_to_dict(design), _reals()
    for name in names:
        if name not in known:
            raise ConfigError(f"no real parameter {name}{did_you_mean(name, known)}")
        if value_at(tree, name) is None:
            raise ConfigError(f"the design has no {name}: leave it out")
    low, high = np.array([known[name].range for name in names], float).reshape(-1, 2).T
    spans = high - low
    centre = (np.array([value_at(tree, name) for name in names], float) - low) / spans
    count = pairs or max(PAIRS_EACH * len(names), FEWEST_PAIRS)
    rng = np.random.default_rng(seed)
    ways = rng.choice([-step, step], (count, len(names))) * rng.uniform(0.5, 1.5, (count, 1))
    places = np.clip(np.concatenate([centre[None], centre + ways, centre - ways]), 0.0, 1.0)
    shifts = [dict(zip(names, by.tolist(), strict=True)) for by in places[1:] - centre]
    designs, worn = zip(*parallel_map(partial(_near, design, fitting), [{}, *shifts], workers), strict=True)
    if worn[0] is None:
        raise DrapeError("the design cannot be drawn, placed or meshed for this wearer: change one of them")
    alike = [row for row, each in enumerate(worn) if each is not None and _alike(each.pattern, worn[0].pattern)]
    jobs = [replace(worn[row].job, body=fitting.body, measurements=fitting.size) for row in alike]
    drapes = drape_batch(jobs, device=device)
    settled = [k for k, drape in enumerate(drapes) if drape.outcome is Outcome.SETTLED]
    if 0 not in settled:
        raise DrapeError(f"the design does not settle: {drapes[0].outcome.value}")
    if len(settled) <= len(names):
        raise DrapeError(
            f"{len(settled)} of {len(places)} designs near this one settle, too few for {len(names)} parameters: take "
            "a smaller step, or more pairs"
        )
    fitted = [Draped(designs[alike[k]], worn[alike[k]], drapes[k]) for k in settled]
    parts = [fitted[first : first + CARRIED] for first in range(0, len(fitted), CARRIED)]
    carried = np.array([*chain.from_iterable(parallel_map(partial(_carried, worn[0]), parts, workers))])
    at = places[[alike[k] for k in settled]]
    offsets, mean = at - at.mean(axis=0), carried.mean(axis=0)
    normal = offsets.T @ offsets + RIDGE * len(settled) * step**2 * np.eye(len(names))
    derivatives = np.linalg.solve(normal, offsets.T @ (carried - mean).reshape(len(settled), -1)).reshape(
        len(names), *mean.shape
    )
    positions = mean + np.tensordot(centre - at.mean(axis=0), derivatives, 1)
    return DrapeJacobian(names, spans, worn[0], drapes[0], positions, derivatives, fitted)


def _near(design: GarmentDesign, fitting: Fitting, by: Mapping[str, float]) -> tuple[GarmentDesign, Worn | None]:
    near = moved(design, by) if by else design
    return near, fitting.worn(near)


def _carried(base: Worn, part: Sequence[Draped]) -> list[Float[np.ndarray, "v 3"]]:
    """The positions of the vertices of ``base`` in the drapes."""
    carrier = Carrier.of(base)
    return [carrier.positions(each.worn, each.drape) for each in part]


@dataclass(frozen=True, eq=False)
class Carrier:
    """The material points of a mesh's vertices, related to the outlines of its panels."""

    worn: Worn
    rows: tuple[np.ndarray, ...]
    """Rows of ``uv`` of each panel."""
    weights: tuple[Float[np.ndarray, "n k"], ...]
    """Mean value coordinates of these points by the points of the panel's outline."""

    @staticmethod
    def of(worn: Worn) -> "Carrier":
        """The carrier of the vertices of a mesh."""
        mesh = worn.job.box_mesh
        rows = tuple(np.flatnonzero(mesh.panel_of_row == number) for number in range(len(worn.pattern.panels)))
        outlines = [panel_outline(panel, EACH + 1) for panel in worn.pattern.panels]
        return Carrier(
            worn, rows, tuple(mean_value_coordinates(mesh.uv[r], o) for r, o in zip(rows, outlines, strict=True))
        )

    def positions(self, other: Worn, drape: Drape) -> Float[np.ndarray, "v 3"]:
        """Where these material points lie in the drape of another design with the same panels [cm]."""
        mesh, base = other.job.box_mesh, self.worn.job.box_mesh
        found = np.zeros((len(base.uv), 3))
        for number, (rows, weights) in enumerate(zip(self.rows, self.weights, strict=True)):
            places = weights @ panel_outline(other.pattern.panels[number], EACH + 1)
            faces = np.flatnonzero(mesh.panel_id == number)
            found[rows] = _interpolated(mesh, faces, places, drape.vertices)
        sums, counts = np.zeros((len(base.vertices), 3)), np.zeros(len(base.vertices))
        np.add.at(sums, base.uv_vertex, found)
        np.add.at(counts, base.uv_vertex, 1.0)
        return sums / np.maximum(counts, 1.0)[:, None]


def mean_value_coordinates(
    points: Float[np.ndarray, "n 2"], loop: Float[np.ndarray, "k 2"]
) -> Float[np.ndarray, "n k"]:
    """Weights of the corners of a polygon that give back the points; each row sums to 1."""
    spokes = loop[None] - points[:, None]
    after = np.roll(spokes, -1, axis=1)
    radius = np.linalg.norm(spokes, axis=2)
    cross = spokes[..., 0] * after[..., 1] - spokes[..., 1] * after[..., 0]
    product = radius * np.roll(radius, -1, axis=1)
    with np.errstate(divide="ignore", invalid="ignore"):
        half = (product - np.einsum("nki,nki->nk", spokes, after)) / cross  # tangent of half the angle of two spokes
        half = np.where(np.abs(cross) < 1e-12 * product, 0.0, half)  # spokes of one direction
        weights = (half + np.roll(half, 1, axis=1)) / radius
    step = np.roll(loop, -1, axis=0) - loop
    share = np.clip(-np.einsum("nki,ki->nk", spokes, step) / np.einsum("ki,ki->k", step, step), 0.0, 1.0)
    apart = np.linalg.norm(spokes + share[..., None] * step, axis=2)
    row, side = np.arange(len(points)), apart.argmin(axis=1)
    border = apart[row, side] < ON_OUTLINE
    weights[border] = 0.0
    weights[row[border], side[border]] = 1.0 - share[row, side][border]
    weights[row[border], (side[border] + 1) % len(loop)] = share[row, side][border]
    return weights / weights.sum(axis=1, keepdims=True)


def _interpolated(
    mesh: BoxMesh, faces: np.ndarray, places: Float[np.ndarray, "n 2"], vertices: Float[np.ndarray, "v 3"]
) -> Float[np.ndarray, "n 3"]:
    flat = np.zeros((len(faces), 3, 3))
    flat[..., :2] = mesh.uv[mesh.corners[faces]]
    _, face, shares = nearest_on(flat, np.column_stack([places, np.zeros(len(places))]))
    return np.einsum("nc,nci->ni", shares, vertices[mesh.faces[faces[face]]])


def nearest_on(
    triangles: Float[np.ndarray, "f 3 3"], points: Float[np.ndarray, "n 3"]
) -> tuple[Float[np.ndarray, "n 3"], Int[np.ndarray, " n"], Float[np.ndarray, "n 3"]]:
    """The nearest place to each point, its triangle, and its barycentric coordinates.

    Of the triangles, ``NEAR`` with the nearest centres are compared.
    """
    _, near = cKDTree(triangles.mean(axis=1)).query(points, k=min(NEAR, len(triangles)))
    near = near.reshape(len(points), -1)
    found = closest_point(triangles[near.ravel()], np.repeat(points, near.shape[1], axis=0)).reshape(*near.shape, 3)
    best = np.linalg.norm(found - points[:, None], axis=2).argmin(axis=1)
    row = np.arange(len(points))
    face, places = near[row, best], found[row, best]
    return places, face, points_to_barycentric(triangles[face], places)


def _alike(one: Pattern, other: Pattern) -> bool:
    shape = [[(panel.name, len(panel.edges)) for panel in pattern.panels] for pattern in (one, other)]
    return shape[0] == shape[1]


@cache
def _reals() -> Mapping[str, Real]:
    found = ((leaf.path, leaf.space) for leaf in leaves(GarmentDesign, added=True))
    return {path: space for path, space in found if isinstance(space, Real) and space.kind == "float"}


def value_at(tree: Mapping[str, Any], path: str) -> Any:
    """The value at a path of a design's tree; ``None`` where it has none."""
    node: Any = tree
    for key in path.split("."):
        if not isinstance(node, Mapping) or key not in node:
            return None
        node = node[key]
    return node
