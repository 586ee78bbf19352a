"""Search by draping: a design whose drape lies on a scan, or in the silhouettes of pictures.

Proposed designs are draped at once. The nearest to the target are refined: ``drape_jacobian`` gives a linear map from
their real parameters to their drape, which Gauss-Newton steps bring onto the target, and the next map is made at the
nearest of these. Choices, such as the kind of a sleeve, stay those of the proposal. Patterns that differ by
millimetres fold in different ways, and their drapes lie some millimetres apart: so the choices of the first proposal,
the likeliest, give way to others only for a clearly nearer drape, real parameters that a drape hardly shows stay near
those proposed, and neighbours that happen to fold as the target does count in the last rounds alone, where they differ
little. A step keeps the rules of the sampler that its start keeps, such as that no heavy skirt hangs from a loose
waist: on the true wearer, who may differ by centimetres, it would slide off.
"""

from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import nullcontext
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from typing import Any, NamedTuple, Protocol

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial import cKDTree

from gcd_dataset.bodies import Wearer
from gcd_dataset.errors import DrapeError, PatternError
from gcd_dataset.generator.drape import drape_batch
from gcd_dataset.generator.garments import GarmentDesign
from gcd_dataset.generator.garments.rules import DrawnGarment, check_design
from gcd_dataset.generator.jacobian import (
    Draped,
    DrapeJacobian,
    Fitting,
    Worn,
    choices_of,
    drape_jacobian,
    moved,
    moves_between,
    nearest_on,
    real_parameters,
)
from gcd_dataset.records import Outcome
from gcd_dataset.workers import Pool, parallel_map, process_pool

SAMPLES = 1024  # points of the scan that are compared
ROUNDS = ((2, 0.06), (1, 0.04), (1, 0.02), (1, 0.01))
"""Designs that a round refines, the nearest of different choices, and the change of their parameters [of a range]."""
FINE = 0.01  # of a range: in rounds of such steps, the nearest neighbour may be the answer
CLEARLY = 0.75  # other choices replace the likeliest ones at this share of their distance
PAIRS = 32  # pairs of drapes of a design in a round
SHARES = (1.0, 0.5, 0.25)  # of the change that brings the linear map onto the scan: all are draped
REACH = 2.0  # steps that a parameter may move in a round
INNER = 12  # Gauss-Newton steps on a linear map
SURE = 1.0  # cm: distances beyond count with their square root, since other folds lie there
FOLDS = 0.4  # cm: how far drapes of nearly the same pattern lie apart
PROPOSED = 0.03  # of a range: standard deviation of proposed parameters
INDEPENDENT = 15  # independent distances among those of a drape, since whole folds differ
PLANE = 1.5  # spacings of the scan's points within which it is a plane
AT_ONCE = 8  # designs or drapes of a task of a worker

Mapped = Callable[[Callable[[Sequence[Any]], list[Any]], Sequence[Any]], list[Any]]
"""A function of parts of a sequence, over the whole sequence, in the workers."""
Residuals = tuple[Float[np.ndarray, " n"], Float[np.ndarray, "d n"], float]
"""Distances [cm], their derivatives by the parameters, and their weight."""


class Target(Protocol):
    """What a drape is to be like."""

    def distances(self, drapes: "Sequence[Draped]", mapped: Mapped) -> list[float]:
        """How far each drape is from it."""

    def change(self, jacobian: DrapeJacobian, step: float, offset: Float[np.ndarray, " d"]) -> Float[np.ndarray, " d"]:
        """The change of the parameters, in shares of their ranges, that brings the linear map onto it.

        ``offset``: how far they are from the proposal already.
        """


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

    def distances(self, drapes: Sequence[Draped], mapped: Mapped) -> list[float]:
        """Mean distances of scan and drapes [cm], both ways unless the scan is a part."""
        return mapped(self._means, [(each.drape.vertices, each.worn.job.box_mesh.faces) for each in drapes])

    def _means(self, meshes: Sequence[tuple[Float[np.ndarray, "v 3"], Int[np.ndarray, "f 3"]]]) -> list[float]:
        return [self._mean(*mesh) for mesh in meshes]

    def _mean(self, vertices: Float[np.ndarray, "v 3"], faces: Int[np.ndarray, "f 3"]) -> float:
        some = self.points[:SAMPLES]
        closest, *_ = nearest_on(vertices[faces], some)
        ways = [np.linalg.norm(closest - some, axis=1).mean()]
        if not self.partial:
            ways.append(np.linalg.norm(self._apart(vertices)[0], axis=1).mean())
        return float(np.mean(ways))

    def change(self, jacobian: DrapeJacobian, step: float, offset: Float[np.ndarray, " d"]) -> Float[np.ndarray, " d"]:
        """The change of the parameters, in shares of their ranges, that brings the linear map onto the scan."""
        faces, derivatives, some = jacobian.worn.job.box_mesh.faces, jacobian.derivatives, self.points[:SAMPLES]

        def rows(change: Float[np.ndarray, " d"]) -> Iterator[Residuals]:
            place = jacobian.positions + np.tensordot(change, derivatives, 1)
            closest, face, shares = nearest_on(place[faces], some)
            normals = np.cross(*(place[faces[face, k]] - place[faces[face, 0]] for k in (1, 2)))
            residuals, ways = _directed(closest - some, normals)
            moves = np.einsum("dnci,nc->dni", derivatives[:, faces[face]], shares)
            yield residuals, np.einsum("dni,ni->dn", moves, ways), 1.0
            if not self.partial:
                apart, near = self._apart(place)
                residuals, ways = _directed(apart, self.normals[near])
                yield residuals, np.einsum("dni,ni->dn", derivatives, ways), len(some) / len(place)

        return gauss_newton(rows, step, offset)

    def _apart(self, places: Float[np.ndarray, "n 3"]) -> tuple[np.ndarray, np.ndarray]:
        """From the surface to each place, and the scan's nearest point; the surface is a plane near its points."""
        _, near = self.tree.query(places)
        apart = places - self.points[near]
        normals = self.normals[near]
        above = np.einsum("ni,ni->n", apart, normals)[:, None] * normals
        beside = np.linalg.norm(apart - above, axis=1) > PLANE * self.spacing
        return np.where(beside[:, None], apart, above), near


class Found(NamedTuple):
    """A design, its drape, and how far that is from the target."""

    drape: Draped
    distance: float


def search(
    target: Target,
    proposals: Iterable[GarmentDesign],
    wearer: Wearer,
    *,
    ranked: bool = True,
    rounds: Sequence[tuple[int, float]] = ROUNDS,
    pairs: int = PAIRS,
    resolution: float = 2.0,
    device: str = "auto",
    workers: int | Pool = 1,
) -> Found:
    """The design whose drape is nearest to the target: of the proposals, and of those that the rounds find near these.

    ``ranked``: the first proposal is the likeliest. ``rounds``: see ``ROUNDS``. ``pairs``: of drapes for each design of
    a round. ``resolution``: edges of the meshes [cm]. ``workers``: processes beside the device, or their pool. Raises
    ``DrapeError`` if no proposal can be draped.
    """
    designs = list(proposals)
    likeliest = choices_of(designs[0]) if designs and ranked else ""
    with nullcontext(workers) if isinstance(workers, Pool) or workers < 2 else process_pool(workers) as pool:
        work = _Search(target, wearer, pairs, resolution, device, pool)
        best = _of_each_choice(work.draped(designs), likeliest)
        work.proposed |= {choices_of(design): design for design in reversed(designs)} if ranked else {}
        if not best:
            raise DrapeError("none of the proposed designs can be drawn, meshed and draped on this body")
        for number, (count, step) in enumerate(rounds):
            refined = [near for each in best[:count] for near in work.refined(each, step, number)]
            best = _of_each_choice(refined, likeliest)
    return best[0]


@dataclass
class _Search:
    """Drapes designs, and compares them with the target."""

    target: Target
    wearer: Wearer
    pairs: int
    resolution: float
    device: str
    pool: int | Pool
    names: dict[str, tuple[str, ...]] = field(default_factory=dict)
    """The real parameters of designs with the same choices."""
    proposed: dict[str, GarmentDesign] = field(default_factory=dict)
    """The first proposal of each set of choices."""

    @cached_property
    def fittings(self) -> tuple[Fitting, Fitting]:
        """With straight legs, and with legs apart."""
        straight, apart = (Fitting(*self.wearer(are_apart), self.resolution) for are_apart in (False, True))
        return straight, apart

    def draped(self, designs: Iterable[GarmentDesign]) -> list[Found]:
        """The designs that can be drawn, and whose drapes settle, with their distances."""
        every = list(designs)
        worn = self._mapped(partial(_worn, self.fittings), every)
        drawn = [(design, each) for design, each in zip(every, worn, strict=True) if each is not None]
        jobs = []
        for design, each in drawn:  # workers return copies of the body
            own = _fitting(self.fittings, design)
            jobs.append(replace(each.job, body=own.body, measurements=own.size))
        drapes = drape_batch(jobs, device=self.device)
        return self.compared(Draped(*pair, drape) for pair, drape in zip(drawn, drapes, strict=True))

    def compared(self, drapes: Iterable[Draped]) -> list[Found]:
        """The settled drapes with their distances from the target."""
        settled = [each for each in drapes if each.drape.outcome is Outcome.SETTLED]
        apart = self.target.distances(settled, self._mapped)
        return [Found(*pair) for pair in zip(settled, apart, strict=True)]

    def refined(self, start: Found, step: float, seed: int) -> list[Found]:
        """The start, near neighbours, and the designs that the linear map brings onto the target."""
        design = start.drape.design
        fitting, choices = _fitting(self.fittings, design), choices_of(design)
        if choices not in self.names:
            self.names[choices] = real_parameters(design, fitting.size, workers=self.pool)
        names = self.names[choices]
        try:
            found = drape_jacobian(
                design, fitting, names, step=step, pairs=max(self.pairs, len(names)), seed=seed, device=self.device,
                workers=self.pool,
            )  # fmt: skip
        except DrapeError:
            return [start]
        offset = moves_between(self.proposed.get(choices, design), design, names)
        change = dict(zip(names, self.target.change(found, step, offset).tolist(), strict=True))
        steps = [moved(design, {name: share * by for name, by in change.items()}) for share in SHARES]
        broken = _broken(fitting, design)
        tried = [each for each in steps if _broken(fitting, each) <= broken]
        neighbours = self.compared(found.fitted) if step <= FINE else []
        return [start, *neighbours, *self.draped(tried)]

    def _mapped(self, work: Callable[[Sequence[Any]], list[Any]], items: Sequence[Any]) -> list[Any]:
        parts = [items[first : first + AT_ONCE] for first in range(0, len(items), AT_ONCE)]
        return [one for part in parallel_map(work, parts, self.pool) for one in part]


def _fitting(fittings: tuple[Fitting, Fitting], design: GarmentDesign) -> Fitting:
    return fittings[design.meta.bottom is not None and design.meta.bottom.garment.legs]


def _broken(fitting: Fitting, design: GarmentDesign) -> set[str]:
    """The rules of the sampler that a design breaks on its wearer."""
    try:
        return {reject.rule for reject in check_design(DrawnGarment.of(fitting.size, design))}
    except PatternError as error:
        return {str(error)}


def _worn(fittings: tuple[Fitting, Fitting], part: Sequence[GarmentDesign]) -> list[Worn | None]:
    return [_fitting(fittings, design).worn(design) for design in part]


def _of_each_choice(found: Iterable[Found], likeliest: str) -> list[Found]:
    """The nearest of each set of choices, in the order in which they may be the answer."""
    nearest: dict[str, Found] = {}
    for each in sorted(found, key=lambda each: each.distance):
        nearest.setdefault(choices_of(each.drape.design), each)
    shares = {choices: CLEARLY if choices == likeliest else 1.0 for choices in nearest}
    return sorted(nearest.values(), key=lambda each: each.distance * shares[choices_of(each.drape.design)])


def gauss_newton(
    rows: Callable[[Float[np.ndarray, " d"]], Iterable[Residuals]], step: float, offset: Float[np.ndarray, " d"]
) -> Float[np.ndarray, " d"]:
    """The likeliest change of parameters, at most ``REACH * step``: residuals are small, and proposals nearly right.

    ``offset``: how far the parameters are from the proposal. Deviations are normal: of parameters by ``PROPOSED``, of
    ``INDEPENDENT`` residuals by ``FOLDS``.
    """
    change, count = np.zeros(len(offset)), len(offset)
    for _ in range(INNER):
        curvature, slope, total = np.zeros((count, count)), np.zeros(count), 0.0
        for residuals, jac, share in rows(change):
            weights = share / np.maximum(np.abs(residuals), SURE)
            curvature += (jac * weights) @ jac.T
            slope += (jac * weights) @ residuals
            total += share * len(residuals)
        prior = max(total, 1.0) / INDEPENDENT * (FOLDS / PROPOSED) ** 2
        shift = np.linalg.solve(curvature + prior * np.eye(count), -slope - prior * (offset + change))
        change = np.clip(change + shift, -REACH * step, REACH * step)
    return change


def _directed(apart: Float[np.ndarray, "n 3"], normals: Float[np.ndarray, "n 3"]) -> tuple[np.ndarray, np.ndarray]:
    """Distances and their directions; of points that touch, along the normal."""
    length = np.linalg.norm(apart, axis=1)
    unit = normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)
    ways = np.where((length < 0.05)[:, None], unit, apart / np.maximum(length, 1e-12)[:, None])
    return np.einsum("ni,ni->n", apart, ways), ways
