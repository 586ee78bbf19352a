"""Search by draping: designs whose drape lies on a scan.

    python -m benchmarks.reconstruction.search --count 3 --resolution 4 --pairs 24

Of proposed designs, all draped at once, the nearest to the scan is refined: ``drape_jacobian`` gives a linear map from
its real parameters to its drape, which Gauss-Newton steps bring onto the scan; the design found is draped, and the
next map is made there, for smaller steps. Choices, such as the kind of a sleeve, stay those of the proposal.

The command starts from drawn designs whose parameters are moved by ``--noise`` of their ranges, and prints scores of
start and end against the true pattern and drape.
"""

import argparse
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial import cKDTree
from trimesh.triangles import closest_point, points_to_barycentric

from gcd_dataset.errors import DrapeError, GcdError
from gcd_dataset.generator.body import build_body, draw_shape, measure
from gcd_dataset.generator.drape import drape_batch
from gcd_dataset.generator.garments import GarmentDesign
from gcd_dataset.generator.garments.sampling import attempted_design
from gcd_dataset.generator.jacobian import (
    NEAR,
    DrapeJacobian,
    Fitting,
    Worn,
    drape_jacobian,
    moved,
    real_parameters,
)
from gcd_dataset.generator.quality import sample_surface
from gcd_dataset.metrics import score_pattern
from gcd_dataset.records import Drape
from gcd_dataset.scoring.distances import MeshShape, mean_and_p95
from gcd_dataset.workers import parallel_map

SAMPLES = 1024  # points of the scan that are compared
STEPS = (0.08, 0.05, 0.03)  # of a range: steps of the rounds
REACH = 2.0  # steps that a parameter may move in a round
INNER = 12  # Gauss-Newton steps on a linear map
SURE = 1.0  # cm: distances beyond count with their square root, since other folds lie there
PRIOR = 0.02  # weight of a parameter's step beside the mean of its curvatures
PLANE = 1.5  # spacings of the scan's points within which it is a plane


@dataclass(frozen=True, eq=False)
class ScanPoints:
    """Points of a garment's surface [cm] with normals; those of a part of it if ``partial``."""

    points: Float[np.ndarray, "n 3"]
    normals: Float[np.ndarray, "n 3"]
    tree: cKDTree
    spacing: float
    partial: bool = False

    @staticmethod
    def of(points: Float[np.ndarray, "n 6"], *, partial: bool = False) -> "ScanPoints":
        """Points and unit normals, in rows."""
        tree = cKDTree(points[:, :3])
        apart, _ = tree.query(points[:, :3], k=4)
        return ScanPoints(points[:, :3], points[:, 3:], tree, float(np.median(apart[:, 1:])), partial)


@dataclass(frozen=True, eq=False)
class Found:
    """A design, its drape, and the mean distance of scan and drape [cm], both ways unless the scan is a part."""

    design: GarmentDesign
    worn: Worn
    drape: Drape
    distance: float


def nearest(
    designs: Sequence[GarmentDesign], fitting: Fitting, scan: ScanPoints, *, device: str = "auto", workers: int = 1
) -> list[Found]:
    """The designs, nearest drape first, without those that cannot be drawn or draped."""
    worn = list(parallel_map(fitting.worn, designs, workers))
    drawn = [(design, each) for design, each in zip(designs, worn, strict=True) if each is not None]
    jobs = [replace(each.job, body=fitting.body, measurements=fitting.size) for _, each in drawn]
    found = [
        Found(design, each, drape, distance_to(scan, drape.vertices, each))
        for (design, each), drape in zip(drawn, drape_batch(jobs, device=device), strict=True)
        if np.isfinite(drape.vertices).all()
    ]
    return sorted(found, key=lambda each: each.distance)


def refine(
    start: Found,
    fitting: Fitting,
    scan: ScanPoints,
    *,
    steps: Sequence[float] = STEPS,
    pairs: int | None = None,
    device: str = "auto",
    workers: int = 1,
) -> Found:
    """The design with its real parameters moved so that its drape lies on the scan; never farther than ``start``."""
    best = start
    for number, step in enumerate(steps):
        try:
            jacobian = drape_jacobian(
                best.design, fitting, step=step, pairs=pairs, seed=number, device=device, workers=workers
            )
        except DrapeError:
            break
        change = dict(zip(jacobian.parameters, on_scan(jacobian, scan, step).tolist(), strict=True))
        ways = ({name: share * by for name, by in change.items()} for share in (1.0, 0.5))
        tried = [moved(best.design, by) for by in ways]
        best = min([best, *nearest(tried, fitting, scan, device=device)], key=lambda each: each.distance)
    return best


def distance_to(scan: ScanPoints, vertices: Float[np.ndarray, "v 3"], worn: Worn) -> float:
    """The mean distance of scan and drape [cm]."""
    some = scan.points[:SAMPLES]
    closest, *_ = _closest(vertices[worn.job.box_mesh.faces], some)
    ways = [np.linalg.norm(closest - some, axis=1).mean()]
    if not scan.partial:
        ways.append(np.linalg.norm(_to_scan(scan, vertices)[0], axis=1).mean())
    return float(np.mean(ways))


def on_scan(jacobian: DrapeJacobian, scan: ScanPoints, step: float) -> Float[np.ndarray, " d"]:
    """The change of the parameters, in shares of their ranges, that brings the linear map onto the scan."""
    faces, derivatives = jacobian.worn.job.box_mesh.faces, jacobian.derivatives
    some = scan.points[:SAMPLES]
    change = np.zeros(len(derivatives))
    for _ in range(INNER):
        place = jacobian.positions + np.tensordot(change, derivatives, 1)
        closest, face, shares = _closest(place[faces], some)
        normals = np.cross(place[faces[face, 1]] - place[faces[face, 0]], place[faces[face, 2]] - place[faces[face, 0]])
        residuals, ways = _directed(closest - some, normals)
        moves = np.einsum("dnci,nc->dni", derivatives[:, faces[face]], shares)
        rows = [(residuals, np.einsum("dni,ni->dn", moves, ways), 1.0)]
        if not scan.partial:
            apart, near = _to_scan(scan, place)
            residuals, ways = _directed(apart, scan.normals[near])
            rows.append((residuals, np.einsum("dni,ni->dn", derivatives, ways), len(some) / len(place)))
        curvature, slope = np.zeros((len(change), len(change))), np.zeros(len(change))
        for residuals, jac, share in rows:
            weights = share / np.maximum(np.abs(residuals), SURE)
            curvature += (jac * weights) @ jac.T
            slope += (jac * weights) @ residuals
        prior = PRIOR * np.trace(curvature) / len(change)
        shift = np.linalg.solve(curvature + prior * np.eye(len(change)), -slope - prior * change)
        change = np.clip(change + shift, -REACH * step, REACH * step)
    return change


def _directed(apart: Float[np.ndarray, "n 3"], normals: Float[np.ndarray, "n 3"]) -> tuple[np.ndarray, np.ndarray]:
    """Distances and their directions; of points that touch, along the normal."""
    length = np.linalg.norm(apart, axis=1)
    unit = normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)
    ways = np.where((length < 0.05)[:, None], unit, apart / np.maximum(length, 1e-12)[:, None])
    return np.einsum("ni,ni->n", apart, ways), ways


def _to_scan(scan: ScanPoints, places: Float[np.ndarray, "n 3"]) -> tuple[np.ndarray, np.ndarray]:
    """From the scan's surface to each place, and the scan's nearest point; the surface is a plane near its points."""
    _, near = scan.tree.query(places)
    apart = places - scan.points[near]
    normals = scan.normals[near]
    above = np.einsum("ni,ni->n", apart, normals)[:, None] * normals
    beside = np.linalg.norm(apart - above, axis=1) > PLANE * scan.spacing
    return np.where(beside[:, None], apart, above), near


def _closest(
    triangles: Float[np.ndarray, "f 3 3"], points: Float[np.ndarray, "n 3"]
) -> tuple[Float[np.ndarray, "n 3"], Int[np.ndarray, " n"], Float[np.ndarray, "n 3"]]:
    """Nearest point, its triangle and its barycentric coordinates."""
    _, near = cKDTree(triangles.mean(axis=1)).query(points, k=NEAR)
    found = closest_point(triangles[near.ravel()], np.repeat(points, NEAR, axis=0)).reshape(*near.shape, 3)
    best = np.linalg.norm(found - points[:, None], axis=2).argmin(axis=1)
    row = np.arange(len(points))
    face, place = near[row, best], found[row, best]
    return place, face, points_to_barycentric(triangles[face], place)


# -------------------------------------------------------------------------------------------------------------- command


def main(arguments: Sequence[str] | None = None) -> int:
    """Print what search makes of moved designs. Returns the exit code, 1 if nothing is draped."""
    parser = argparse.ArgumentParser(prog="benchmarks.reconstruction.search", description=main.__doc__)
    parser.add_argument("--count", type=int, default=10, help="designs")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--noise", type=float, default=0.08, help="standard deviation of the moves, of a range")
    parser.add_argument("--steps", type=float, nargs="+", default=STEPS, help="of the rounds")
    parser.add_argument("--pairs", type=int, help="pairs of drapes in a round (default: two for each parameter)")
    parser.add_argument("--resolution", type=float, default=2.0, metavar="CM")
    parser.add_argument("--device", default="auto")
    parser.add_argument("--workers", type=int, default=1)
    options = parser.parse_args(arguments)
    try:
        rows = [row for number in range(options.count) if (row := _trial(number, options)) is not None]
        if not rows:
            raise DrapeError(f"none of {options.count} designs can be draped: give --count or another --seed")
    except GcdError as error:
        print(f"search: {error}", file=sys.stderr)
        return 1
    for name, before, after in zip(("iou", "mean_cm", "p95_cm"), *np.mean(rows, axis=0), strict=True):
        print(f"search.{name} {after:.3f} from {before:.3f} of {len(rows)} designs")
    return 0


def _trial(number: int, options: argparse.Namespace) -> tuple[list[float], list[float]] | None:
    """IoU, mean distance and 95th percentile [cm] at start and end; ``None`` where one cannot be draped."""
    rng = np.random.default_rng((options.seed, number))
    shape = draw_shape(rng)
    size = measure(build_body(shape))
    design = attempted_design(options.seed, number, 0, (size,)).design
    legs = design.meta.bottom is not None and design.meta.bottom.garment.legs
    fitting = Fitting(build_body(replace(shape, legs_apart=legs)), size, options.resolution)
    true = fitting.worn(design)
    if true is None:
        return None
    [drape] = drape_batch([true.job], device=options.device)
    faces = true.job.box_mesh.faces
    scan = ScanPoints.of(sample_surface(drape.vertices, faces, 8192, rng))
    names = real_parameters(design, size)
    noise = dict(zip(names, (options.noise * rng.standard_normal(len(names))).tolist(), strict=True))
    began = time.perf_counter()
    first = nearest([moved(design, noise)], fitting, scan, device=options.device)
    if not first:
        return None
    more = {"steps": options.steps, "pairs": options.pairs, "device": options.device, "workers": options.workers}
    last = refine(first[0], fitting, scan, **more)
    target = MeshShape.of(drape.vertices, faces)

    def scores(found: Found) -> list[float]:
        surface = MeshShape.of(found.drape.vertices, found.worn.job.box_mesh.faces)
        return [score_pattern(found.worn.pattern, true.pattern).iou, *mean_and_p95(target, surface)]

    row = scores(first[0]), scores(last)
    took = f"{len(names)} parameters, {time.perf_counter() - began:.1f} s"
    print(number, *(" ".join(f"{value:.3f}" for value in part) for part in row), took, sep="; ", flush=True)
    return row


if __name__ == "__main__":
    sys.exit(main())
