"""Predictions draped on the bodies of their garments by our own solver, and their distance to the true drape or input.

A prediction gets the order, the local origins, the names and the labels of the true panels: they number the mesh and
tell the solver which edges to hold, and few models predict them. So a prediction that differs from the true pattern
only in these, or by the rounding of a file, drapes to the same bytes. ``strict_unaided`` gives it none of these, nor
the body: it is draped as it is written, on its own body or the neutral one.
"""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import chain, islice

import numpy as np
from jaxtyping import Float

from gcd_dataset.curves import mirrored, sample_curve
from gcd_dataset.errors import BodyError, GcdError
from gcd_dataset.generator.device import to_host
from gcd_dataset.generator.drape import DrapeConfig, DrapeJob, drape_all, resolve_device
from gcd_dataset.generator.drape.model import build_model
from gcd_dataset.generator.drape.moving import Motion
from gcd_dataset.generator.drape.slots import CoarseEnd, Slots
from gcd_dataset.generator.drape.solver import Solver
from gcd_dataset.generator.dressing import dress, has_legs
from gcd_dataset.generator.dressing.sewing_start import sewing_start
from gcd_dataset.generator.mesh import coarse_start
from gcd_dataset.generator.quality import grade_of
from gcd_dataset.metrics import PanelPair, match_panels, matched_edges
from gcd_dataset.metrics.scores import SAME_OUTLINE
from gcd_dataset.records import (
    Body,
    BoxMesh,
    Drape,
    Edge,
    EdgeRef,
    Grade,
    Measurements,
    Panel,
    Pattern,
    Placement,
    Seam,
)
from gcd_dataset.scoring.bodies import Wearers
from gcd_dataset.scoring.distances import (
    WORST,
    MeshShape,
    Shape,
    mean_and_p95,
    openings_apart,
    openings_of,
)
from gcd_dataset.scoring.garments import Scored, mesh_of
from gcd_dataset.spec import euler_angles
from gcd_dataset.workers import parallel_map

WITHIN, MOST_WITHIN = 1.0, 2.0  # cm: the largest mean distance of a right drape, and of 95 % of its points
OPENINGS_WITHIN = 1.5  # cm: the largest distance of a hem, a sleeve end, a neckline or another opening
ROUNDING = 1e-3  # cm: a panel drawn and placed this close to the true one is the true one
TURN = 1e-5  # rad: likewise
AT_ONCE = 32  # garments whose crossings are counted together
TRUE, AIDED, UNAIDED = range(3)
"""Drapes of a garment: the true pattern; the answer as ``arranged``, on the true body; the answer as written."""


@dataclass(frozen=True, eq=False)
class _Job:
    """A pattern to drape, or the reason why it cannot be."""

    row: int
    """Row of the test garment."""
    way: int
    """``TRUE``, ``AIDED`` or ``UNAIDED``."""
    job: DrapeJob | None
    reason: str = ""
    worn_by: tuple[str, bool] = ("", False)
    """File or name of the body, and whether its legs are apart: the same for the same body."""


@dataclass(frozen=True, eq=False)
class _Draped:
    reason: str
    passed: bool = False
    surface: MeshShape | None = None
    openings: Sequence[np.ndarray] = ()
    """Points of each opening [cm]."""


def with_drapes(
    garments: Sequence[Scored],
    wearers: Wearers,
    *,
    own: Wearers,
    inputs: Mapping[str, Shape | None] | None = None,
    partial: bool = False,
    spacing: float,
    device: str,
    workers: int = 1,
) -> Iterator[Scored]:
    """The garments with the scores ``table.DRAPED``, in order.

    ``own``: the bodies that come with the answers, on which they are draped without help. ``inputs``: the surfaces from
    which garments were predicted, where any answer to ``None`` is wrong; without them, distances are to the drapes of
    the true patterns. ``partial``: inputs are parts of their garments, so only distances from the input to the drape
    count. ``spacing``: edge length of the meshes [cm]. ``workers``: processes that dress and mesh. Raises ``BodyError``
    for a body that cannot be read, ``ConfigError`` for a missing device.
    """
    waiting: list[_Job] = []
    draped: dict[tuple[int, int], _Draped] = {}
    worn: dict[tuple[str, bool], tuple[Body, Measurements]] = {}
    prepare = _Preparation(wearers, own, spacing)

    def to_drape() -> Iterator[DrapeJob]:
        for job in chain.from_iterable(parallel_map(prepare, enumerate(garments), workers)):
            if job.job is None:
                draped[job.row, job.way] = _Draped(job.reason)
                continue
            body, size = worn.setdefault(job.worn_by, (job.job.body, job.job.measurements))
            shared = replace(job.job, body=body, measurements=size)
            waiting.append(replace(job, job=shared))
            yield shared

    done, row = drape_all(to_drape(), device=device), 0
    for number, drape in enumerate(done):
        job = waiting[number]
        assert job.job is not None
        draped[job.row, job.way] = _judged(drape, job.job.box_mesh)
        waiting[number] = replace(job, job=None)  # frees the mesh
        while row < len(garments) and all((row, way) in draped for way in (TRUE, AIDED, UNAIDED)):
            yield _scored(garments[row], row, draped, inputs, partial)
            row += 1
    yield from (_scored(garments[rest], rest, draped, inputs, partial) for rest in range(row, len(garments)))


def crossings_of(
    jobs: Iterable[DrapeJob], drapes: Iterable[Float[np.ndarray, "v 3"]], *, device: str = "auto"
) -> Iterator[tuple[int, int, int]]:
    """Crossing edges of given positions, as the solver counts them: cloth and cloth, cloth and skin, skin and cloth."""
    config, pairs = DrapeConfig(), zip(jobs, drapes, strict=True)
    while batch := list(islice(pairs, AT_ONCE)):
        solver = Solver(build_model([job for job, _ in batch], config, resolve_device(device)), config)
        solver.state.x.assign(np.concatenate([vertices for _, vertices in batch]).astype(np.float32))
        for row in zip(solver.self_crossings(), solver.body_crossings(), solver.body_through(), strict=True):
            yield int(row[0]), int(row[1]), int(row[2])


def motion_crossings(
    job: DrapeJob, bodies: Iterable[Body], frames: Iterable[Float[np.ndarray, "v 3"]], *, device: str = "auto"
) -> Iterator[tuple[int, int, int]]:
    """``crossings_of`` a garment in frames of a motion: ``bodies``, of the mesh of the job's, as it moves.

    The solver is built once, for the body of ``job``, whose skin then moves.
    """
    config, device = DrapeConfig(), resolve_device(device)
    start = CoarseEnd.at_rest(job.box_mesh.vertices, config.sewing_time, device)
    slots = Slots.of(build_model([job], config, device), config, [start])
    slots.move(0, Motion.of([job.body, job.body]), ends=False)
    solver = slots.solver
    for body, vertices in zip(bodies, frames, strict=True):
        slots.move_on(0, Motion.of([body, body], job.body), 1.0)
        solver.moving[0].arrive()
        places = to_host(solver.state.x)
        places[solver.model.vertices[0]] = vertices
        solver.state.x.assign(places)
        solver.refresh_bvh()
        counts = solver.self_crossings(), solver.body_crossings(), solver.body_through()
        yield int(counts[0][0]), int(counts[1][0]), int(counts[2][0])


@dataclass(frozen=True)
class _Preparation:
    """Dresses and meshes the patterns of a garment."""

    wearers: Wearers
    own: Wearers
    spacing: float

    def __call__(self, numbered: tuple[int, Scored]) -> list[_Job]:
        row, garment = numbered
        name, answer, true = garment.name, garment.predicted, garment.true
        legs_apart = _has_legs(true, self.wearers, name)
        jobs = [self._job(row, TRUE, true, self.wearers, name, legs_apart)]
        if answer is None or not garment.values["valid"]:
            return jobs + [_Job(row, way, None, garment.failure or "not valid") for way in (AIDED, UNAIDED)]
        jobs.append(self._job(row, AIDED, arranged(answer, true), self.wearers, name, legs_apart))
        try:
            return [*jobs, self._job(row, UNAIDED, answer, self.own, name, _has_legs(answer, self.own, name))]
        except BodyError as error:
            return [*jobs, _Job(row, UNAIDED, None, str(error))]

    def _job(self, row: int, way: int, pattern: Pattern, wearers: Wearers, name: str, legs_apart: bool) -> _Job:
        body, size = wearers.wearer(name, legs_apart=legs_apart)
        try:
            mesh = mesh_of(dress(pattern, body, size).pattern, self.spacing)
            if not len(mesh.faces):
                return _Job(row, way, None, "its mesh has no faces")
            coarse = coarse_start(mesh)
            start = sewing_start(coarse.mesh if coarse else mesh, body)
        except GcdError as error:
            return _Job(row, way, None, str(error))
        job = DrapeJob(mesh, body, size, coarse=coarse, start=start)
        return _Job(row, way, job, worn_by=(wearers.body_of(name), legs_apart))


def _has_legs(pattern: Pattern, wearers: Wearers, name: str) -> bool:
    """Whether a garment has legs, so that its wearer stands with the legs apart."""
    if has_legs(pattern):
        return True
    try:
        body = wearers.wearer(name, legs_apart=False)
        return has_legs(dress(pattern, *body).pattern)  # openings show legs once the panels are placed
    except BodyError:
        raise
    except GcdError:
        return False


def _judged(drape: Drape, mesh: BoxMesh) -> _Draped:
    passed = grade_of(drape, None) is not Grade.FAILED
    reason = "" if passed else drape.outcome.value
    if not np.isfinite(drape.vertices).all():
        return _Draped(reason)
    surface, openings = MeshShape.of(drape.vertices, mesh.faces), openings_of(drape.vertices, mesh.faces)
    return _Draped(reason, passed, surface, openings)


def _scored(
    garment: Scored,
    row: int,
    draped: dict[tuple[int, int], _Draped],
    inputs: Mapping[str, Shape | None] | None,
    partial: bool,
) -> Scored:
    true, aided, unaided = (draped.pop((row, way)) for way in (TRUE, AIDED, UNAIDED))
    target: Shape | None = true.surface if inputs is None else inputs[garment.name]
    remarks = [f"drape of the prediction: {aided.reason}"] if aided.reason and not garment.failure else []
    remarks += [f"drape of the true pattern: {true.reason}"] if true.reason else []
    remarks += [f"drape without help: {unaided.reason}"] if unaided.reason and not aided.reason else []
    remarks += ["input: too few finite points for a surface"] if inputs is not None and target is None else []
    alike = garment.predicted is not None and panels_alike(garment.predicted, garment.true)

    def compared(drape: _Draped) -> tuple[float, float, bool]:
        """Mean distance and distance of the openings [cm], and whether the answer is right."""
        if target is None or drape.surface is None:
            return WORST, WORST, False
        mean, p95 = mean_and_p95(target, drape.surface, both_ways=not partial)
        openings = openings_apart(true.openings, drape.openings)
        return mean, openings, alike and mean <= WITHIN and p95 <= MOST_WITHIN and openings <= OPENINGS_WITHIN

    mean, openings, right = compared(aided)
    scores = {"sim_ok": float(aided.passed), "redrape_cd_cm": mean, "openings_cm": openings}
    scores |= {"strict_within_1cm": float(right), "strict_unaided": float(compared(unaided)[2])}
    return replace(garment, values={**garment.values, **scores}, remarks=(*garment.remarks, *remarks))


def panels_alike(predicted: Pattern, true: Pattern) -> bool:
    """Whether all panels of both patterns match with an IoU of ``SAME_OUTLINE`` or more, right side to right side."""
    pairs = match_panels(predicted, true)
    counts = {len(pairs), len(predicted.panels), len(true.panels)}
    outside = all(pair.predicted.matrix[:, 2] @ pair.true.matrix[:, 2] > 0 for pair in pairs)
    return len(counts) == 1 and outside and all(pair.iou >= SAME_OUTLINE for pair in pairs)


# ------------------------------------------------------------------------------------------------------ arranged panels


def arranged(predicted: Pattern, true: Pattern) -> Pattern:
    """A prediction with order, local origins, names and labels of the true panels, where panels match.

    Loops start at the true first edge, and seams have the true order, as far as edges and seams agree. A prediction
    that is the true garment within ``ROUNDING`` becomes the true pattern.
    """
    pairs = {id(pair.true.panel): pair for pair in match_panels(predicted, true)}
    matched = [(pairs[id(panel)], panel) for panel in true.panels if id(panel) in pairs]
    taken = {panel.name for _, panel in matched}
    refs: dict[EdgeRef, EdgeRef] = {}
    panels: list[Panel] = []
    for pair, true_panel in matched:
        first = _first_edge(pair)
        panels.append(_redrawn(pair, first))
        refs |= _renumbered(pair.predicted.panel, true_panel.name, first)
    for panel in predicted.panels:
        if any(pair.predicted.panel is panel for pair, _ in matched):
            continue
        name = next(n for n in (panel.name, *(f"extra {i}" for i in range(len(predicted.panels)))) if n not in taken)
        taken.add(name)
        panels.append(replace(panel, name=name))
        refs |= _renumbered(panel, name, 0)
    seams = [replace(seam, left=refs[seam.left], right=refs[seam.right]) for seam in predicted.seams]
    return Pattern(true.name, tuple(panels), _ordered(seams, true.seams))


def _first_edge(pair: PanelPair) -> int:
    """The predicted edge that is the true first edge; 0 if the numbers of edges differ."""
    if len(pair.predicted.panel.edges) != len(pair.true.panel.edges):
        return 0
    return next(mine.edge for mine, other in matched_edges(pair).items() if other.edge == 0)


def _renumbered(panel: Panel, name: str, first: int) -> dict[EdgeRef, EdgeRef]:
    count = len(panel.edges)
    edges = {EdgeRef(panel.name, edge): EdgeRef(name, (edge - first) % count) for edge in range(count)}
    return edges | {EdgeRef(panel.name, count + i): EdgeRef(name, count + i) for i in range(len(panel.lines))}


def _ordered(seams: Sequence[Seam], true: Sequence[Seam]) -> tuple[Seam, ...]:
    """The seams in the order of the true ones, their sides as there; then the others."""
    place = {frozenset((seam.left, seam.right)): number for number, seam in enumerate(true)}
    numbered = []
    for seam in seams:
        number = place.get(frozenset((seam.left, seam.right)), len(true))
        like = true[number] if number < len(true) else seam
        numbered.append((number, replace(like, right_wrong=seam.right_wrong)))
    return tuple(seam for _, seam in sorted(numbered, key=lambda item: item[0]))


def _redrawn(pair: PanelPair, first: int) -> Panel:
    """The predicted panel about the true local origin, its loop from edge ``first``, with the true name and labels.

    Edges keep their own labels if their number is not the true one.
    """
    shape, true, own = pair.predicted, pair.true, pair.predicted.panel
    turned = own.edges[first:] + own.edges[:first]
    labelled = true.panel.edges if len(turned) == len(true.panel.edges) else turned
    flipped = shape.side * true.side < 0
    edges = tuple(
        Edge(row, (row + 1) % len(turned), mirrored(edge.curve) if flipped else edge.curve, like.label)
        for row, (edge, like) in enumerate(zip(turned, labelled, strict=True))
    )
    starts, ends = [edge.start for edge in turned], [end for line in own.lines for end in (line.start, line.end)]
    kept = starts + [end for end in dict.fromkeys(ends) if end not in starts]
    lines = tuple(
        replace(line, start=kept.index(line.start), end=kept.index(line.end),
                curve=mirrored(line.curve) if flipped else line.curve)
        for line in own.lines
    )  # fmt: skip
    vertices = shape.seen(own.vertices[kept]) * [true.side, 1.0] + true.centroid
    matrix = shape.matrix @ np.diag([true.side, 1.0, true.side])
    placement = Placement(shape.centre - matrix[:, :2] @ true.centroid, euler_angles(matrix))
    panel = Panel(true.panel.name, vertices, edges, placement, true.panel.label, lines)
    return true.panel if _is_same(panel, true.panel) else panel


def _is_same(panel: Panel, true: Panel) -> bool:
    """Whether two panels with loops that start alike differ by rounding errors only."""
    if (len(panel.edges), len(panel.lines)) != (len(true.edges), len(true.lines)):
        return False
    corners = np.array([true.vertices[edge.start] for edge in true.edges])
    return bool(
        np.allclose(panel.vertices[: len(corners)], corners, rtol=0, atol=ROUNDING)
        and np.allclose(panel.placement.translation, true.placement.translation, rtol=0, atol=ROUNDING)
        and np.allclose(panel.placement.matrix, true.placement.matrix, rtol=0, atol=TURN)
        and all(_is_same_curve(panel, true, row) for row in range(len(true.edges) + len(true.lines)))
    )


def _is_same_curve(panel: Panel, true: Panel, row: int) -> bool:
    one, other = panel.edge(row).curve, true.edge(row).curve
    ours, theirs = (sample_curve(*p.edge_ends(row), p.edge(row).curve, 9) for p in (panel, true))
    return one.kind == other.kind and np.allclose(ours, theirs, rtol=0, atol=ROUNDING)
