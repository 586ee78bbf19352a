"""Predictions draped on the bodies of their garments by our own solver, and their distance to the true drape or input.

A prediction gets the order, the local origins, the names and the labels of the true panels: they number the mesh and
tell the solver which edges to hold, and few models predict them. So a prediction that differs from the true pattern
only in these, or by the rounding of a file, drapes to the same bytes.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import chain

import numpy as np

from gcd_dataset.scoring.bodies import Wearers
from gcd_dataset.scoring.distances import WORST, MeshShape, Shape, distance
from gcd_dataset.scoring.garments import Scored, mesh_of
from gcd_dataset.curves import mirrored, sample_curve
from gcd_dataset.errors import GcdError
from gcd_dataset.generator.drape import DrapeJob, drape_all
from gcd_dataset.generator.dressing import dress, has_legs
from gcd_dataset.generator.dressing.sewing_start import sewing_start
from gcd_dataset.generator.mesh import coarse_start
from gcd_dataset.generator.quality import grade_of
from gcd_dataset.metrics import PanelPair, match_panels, matched_edges
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
from gcd_dataset.spec import euler_angles
from gcd_dataset.workers import parallel_map

WITHIN = 1.0  # cm: the largest distance to the input of a right reconstruction
ROUNDING = 1e-3  # cm: a panel drawn and placed this close to the true one is the true one
TURN = 1e-5  # rad: likewise


@dataclass(frozen=True, eq=False)
class _Job:
    """A pattern to drape, or the reason why it cannot be."""

    row: int
    """Row of the test garment."""
    predicted: bool
    job: DrapeJob | None
    reason: str = ""
    worn_by: tuple[str, bool] = ("", False)
    """File or name of the body, and whether its legs are apart: the same for the same body."""


@dataclass(frozen=True, eq=False)
class _Draped:
    surface: MeshShape | None
    passed: bool
    reason: str


def with_drapes(
    garments: Sequence[Scored],
    wearers: Wearers,
    *,
    inputs: Mapping[str, Shape] | None = None,
    partial: bool = False,
    spacing: float,
    device: str,
    workers: int = 1,
) -> Iterator[Scored]:
    """The garments with the scores ``table.DRAPED``, in order.

    ``inputs``: the surfaces from which garments were predicted; without them, the true patterns are draped, too.
    ``partial``: inputs are parts of their garments, so only distances from the input to the drape count.
    ``spacing``: edge length of the meshes [cm]. ``workers``: processes that dress and mesh. Raises ``BodyError`` for a
    body that cannot be read, ``ConfigError`` for a missing device.
    """
    waiting: list[_Job] = []
    draped: dict[tuple[int, bool], _Draped] = {}
    worn: dict[tuple[str, bool], tuple[Body, Measurements]] = {}
    prepare = _Preparation(wearers, spacing, with_true=inputs is None)

    def to_drape() -> Iterator[DrapeJob]:
        for job in chain.from_iterable(parallel_map(prepare, enumerate(garments), workers)):
            if job.job is None:
                draped[job.row, job.predicted] = _Draped(None, False, job.reason)
                continue
            body, size = worn.setdefault(job.worn_by, (job.job.body, job.job.measurements))
            shared = replace(job.job, body=body, measurements=size)
            waiting.append(replace(job, job=shared))
            yield shared

    done, row = drape_all(to_drape(), device=device), 0
    needed = (True,) if inputs is not None else (False, True)
    for number, drape in enumerate(done):
        job = waiting[number]
        assert job.job is not None
        draped[job.row, job.predicted] = _judged(drape, job.job.box_mesh)
        waiting[number] = replace(job, job=None)  # frees the mesh
        while row < len(garments) and all((row, predicted) in draped for predicted in needed):
            yield _scored(garments[row], row, draped, inputs, partial)
            row += 1
    while row < len(garments):
        yield _scored(garments[row], row, draped, inputs, partial)
        row += 1


@dataclass(frozen=True)
class _Preparation:
    """Dresses and meshes the patterns of a garment."""

    wearers: Wearers
    spacing: float
    with_true: bool
    """Whether the true pattern is draped, too."""

    def __call__(self, numbered: tuple[int, Scored]) -> list[_Job]:
        row, garment = numbered
        legs_apart = self._has_legs(garment)
        jobs = [self._job(row, False, garment.true, garment.name, legs_apart)] if self.with_true else []
        if garment.predicted is None:
            jobs.append(_Job(row, True, None, garment.failure))
        elif not garment.values["valid"]:
            jobs.append(_Job(row, True, None, "not valid"))
        else:
            jobs.append(self._job(row, True, arranged(garment.predicted, garment.true), garment.name, legs_apart))
        return jobs

    def _has_legs(self, garment: Scored) -> bool:
        """Whether the true garment has legs, so that its wearer stands with the legs apart."""
        if has_legs(garment.true):
            return True
        wearer = self.wearers.wearer(garment.name, legs_apart=False)
        try:
            return has_legs(dress(garment.true, *wearer).pattern)  # openings show legs once the panels are placed
        except GcdError:
            return False

    def _job(self, row: int, predicted: bool, pattern: Pattern, name: str, legs_apart: bool) -> _Job:
        body, size = self.wearers.wearer(name, legs_apart=legs_apart)
        try:
            mesh = mesh_of(dress(pattern, body, size).pattern, self.spacing)
            if not len(mesh.faces):
                return _Job(row, predicted, None, "its mesh has no faces")
            coarse = coarse_start(mesh)
            start = sewing_start(coarse.mesh if coarse else mesh, body)
        except GcdError as error:
            return _Job(row, predicted, None, str(error))
        job = DrapeJob(mesh, body, size, coarse=coarse, start=start)
        return _Job(row, predicted, job, worn_by=(self.wearers.body_of(name), legs_apart))


def _judged(drape: Drape, mesh: BoxMesh) -> _Draped:
    passed = grade_of(drape, None) is not Grade.FAILED
    reason = "" if passed else drape.outcome.value
    if not np.isfinite(drape.vertices).all():
        return _Draped(None, False, reason)
    return _Draped(MeshShape.of(drape.vertices, mesh.faces), passed, reason)


def _scored(
    garment: Scored,
    row: int,
    draped: dict[tuple[int, bool], _Draped],
    inputs: Mapping[str, Shape] | None,
    partial: bool,
) -> Scored:
    predicted = draped.pop((row, True))
    remarks = [f"drape of the prediction: {predicted.reason}"] if predicted.reason and not garment.failure else []
    if inputs is None:
        true = draped.pop((row, False))
        target: Shape | None = true.surface
        remarks += [f"drape of the true pattern: {true.reason}"] if true.reason else []
    else:
        target = inputs[garment.name]
    apart = WORST
    if target is not None and predicted.surface is not None:
        apart = distance(target, predicted.surface, both_ways=not partial)
    right = bool(garment.values["topology_exact"]) and apart <= WITHIN
    scores = {"sim_ok": float(predicted.passed), "redrape_cd_cm": apart, "within_1cm": float(right)}
    return replace(garment, values={**garment.values, **scores}, remarks=(*garment.remarks, *remarks))


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
    return Pattern(true.name, tuple(panels), _ordered([_moved(seam, refs) for seam in predicted.seams], true.seams))


def _first_edge(pair: PanelPair) -> int:
    """The predicted edge that is the true first edge; 0 if the numbers of edges differ."""
    if len(pair.predicted.panel.edges) != len(pair.true.panel.edges):
        return 0
    return next(mine.edge for mine, other in matched_edges(pair).items() if other.edge == 0)


def _renumbered(panel: Panel, name: str, first: int) -> dict[EdgeRef, EdgeRef]:
    count = len(panel.edges)
    return {EdgeRef(panel.name, edge): EdgeRef(name, (edge - first) % count) for edge in range(count)}


def _moved(seam: Seam, refs: Mapping[EdgeRef, EdgeRef]) -> Seam:
    return Seam(refs[seam.left], refs[seam.right], seam.right_wrong)


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
    corners = shape.seen(own.vertices[[edge.start for edge in turned]]) * [true.side, 1.0] + true.centroid
    matrix = shape.matrix @ np.diag([true.side, 1.0, true.side])
    placement = Placement(shape.centre - matrix[:, :2] @ true.centroid, euler_angles(matrix))
    panel = Panel(true.panel.name, corners, edges, placement, true.panel.label)
    return true.panel if _is_same(panel, true.panel) else panel


def _is_same(panel: Panel, true: Panel) -> bool:
    """Whether two panels with loops that start alike differ by rounding errors only."""
    if len(panel.edges) != len(true.edges):
        return False
    corners = np.array([true.vertices[edge.start] for edge in true.edges])
    return bool(
        np.allclose(panel.vertices, corners, rtol=0, atol=ROUNDING)
        and np.allclose(panel.placement.translation, true.placement.translation, rtol=0, atol=ROUNDING)
        and np.allclose(panel.placement.matrix, true.placement.matrix, rtol=0, atol=TURN)
        and all(_is_same_curve(panel, true, row) for row in range(len(true.edges)))
    )


def _is_same_curve(panel: Panel, true: Panel, row: int) -> bool:
    one, other = panel.edges[row].curve, true.edges[row].curve
    ours, theirs = (sample_curve(*p.edge_ends(row), p.edges[row].curve, 9) for p in (panel, true))
    return one.kind == other.kind and np.allclose(ours, theirs, rtol=0, atol=ROUNDING)
