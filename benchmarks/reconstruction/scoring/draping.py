"""Predictions draped on the bodies of their garments by our own solver, and their distance to the true drape or input.

Both drapes get panels in the same order, about the same local origins, with the names and labels of the true pattern:
they number the mesh and tell the solver which edges to hold, and few models predict them. So a prediction that differs
from the true pattern only in these drapes to the same shape.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from benchmarks.reconstruction.scoring.bodies import Wearers
from benchmarks.reconstruction.scoring.distances import WORST, Shape, Surface, distance
from benchmarks.reconstruction.scoring.garments import Scored, mesh_of
from gcd_dataset.curves import mirrored
from gcd_dataset.errors import GcdError
from gcd_dataset.generator.drape import DrapeJob, drape_all
from gcd_dataset.generator.dressing import dress, has_legs
from gcd_dataset.generator.quality import grade_of
from gcd_dataset.metrics import PanelShape, match_panels, matched_edges
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

__all__ = ["DRAPED", "WITHIN", "arranged", "canonical", "with_drapes"]

WITHIN = 1.0  # cm: the largest distance to the input of a right reconstruction
DIGITS = 9  # decimals of positions [cm, rad]: drops rounding errors of a change of coordinates
DRAPED = ("sim_ok", "redrape_cd_cm", "within_1cm")
"""Names of the scores of drapes."""


@dataclass(frozen=True, eq=False)
class _Job:
    """A pattern to drape, or the reason why it cannot be."""

    row: int
    """Of the test garment."""
    predicted: bool
    job: DrapeJob | None
    reason: str = ""


@dataclass(frozen=True, eq=False)
class _Draped:
    surface: Surface | None
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
) -> Iterator[Scored]:
    """The garments with the scores ``DRAPED``, in order.

    ``inputs``: the surfaces from which garments were predicted; without them, the true patterns are draped, too.
    ``partial``: inputs are parts of their garments, so only distances from the input to the drape count.
    ``spacing``: edge length of the meshes [cm]. Raises ``BodyError`` for a body that cannot be read, ``ConfigError``
    for a missing device.
    """
    waiting: list[_Job] = []
    draped: dict[tuple[int, bool], _Draped] = {}
    jobs = _jobs(garments, wearers, spacing, with_true=inputs is None)

    def to_drape() -> Iterator[DrapeJob]:
        for job in jobs:
            if job.job is None:
                draped[job.row, job.predicted] = _Draped(None, False, job.reason)
            else:
                waiting.append(job)
                yield job.job

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


def _jobs(garments: Sequence[Scored], wearers: Wearers, spacing: float, *, with_true: bool) -> Iterator[_Job]:
    for row, garment in enumerate(garments):
        wearer = _wearer(garment, wearers)
        if with_true:
            yield _job(row, False, canonical(garment.true), wearer, spacing)
        if garment.predicted is None:
            yield _Job(row, True, None, garment.failure)
        elif not garment.values["valid"]:
            yield _Job(row, True, None, "not valid")
        else:
            yield _job(row, True, arranged(garment.predicted, garment.true), wearer, spacing)


def _wearer(garment: Scored, wearers: Wearers) -> tuple[Body, Measurements]:
    """The body of a garment and its measures; with the legs apart if the true garment has legs."""
    if has_legs(garment.true):
        return wearers.wearer(garment.name, legs_apart=True)
    straight = wearers.wearer(garment.name, legs_apart=False)
    try:
        legs = has_legs(dress(garment.true, *straight).pattern)  # openings show legs once the panels are placed
    except GcdError:
        return straight
    return wearers.wearer(garment.name, legs_apart=True) if legs else straight


def _job(row: int, predicted: bool, pattern: Pattern, wearer: tuple[Body, Measurements], spacing: float) -> _Job:
    try:
        mesh = mesh_of(dress(pattern, *wearer).pattern, spacing)
        if not len(mesh.faces):
            return _Job(row, predicted, None, "its mesh has no faces")
    except GcdError as error:
        return _Job(row, predicted, None, str(error))
    return _Job(row, predicted, DrapeJob(mesh, *wearer))


def _judged(drape: Drape, mesh: BoxMesh) -> _Draped:
    passed = grade_of(drape, None) is not Grade.FAILED
    reason = "" if passed else drape.outcome.value
    if not np.isfinite(drape.vertices).all():
        return _Draped(None, False, reason)
    return _Draped(Surface.of(drape.vertices, mesh.faces), passed, reason)


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


def canonical(pattern: Pattern) -> Pattern:
    """The same garment with every panel about its centroid, seen from its right side."""
    panels = tuple(_redrawn(PanelShape.of(panel), panel, 0, panel) for panel in pattern.panels)
    return Pattern(pattern.name, panels, pattern.seams)


def arranged(predicted: Pattern, true: Pattern) -> Pattern:
    """A prediction with order, names and labels of the true pattern, where panels match; redrawn as by ``canonical``.

    Loops start at the true first edge, and seams have the true order, as far as edges and seams agree.
    """
    pairs = {id(pair.true.panel): pair for pair in match_panels(predicted, true)}
    matched = [(pairs[id(panel)], panel) for panel in true.panels if id(panel) in pairs]
    rest = [p for p in predicted.panels if all(pair.predicted.panel is not p for pair, _ in matched)]
    taken = {panel.name for _, panel in matched}
    refs: dict[EdgeRef, EdgeRef] = {}
    panels: list[Panel] = []
    for pair, true_panel in matched:
        own, first = pair.predicted.panel, 0
        alike = len(own.edges) == len(true_panel.edges)
        if alike:
            edge_of = {mine.edge: other.edge for mine, other in matched_edges(pair).items()}
            first = next(mine for mine, other in edge_of.items() if other == 0)
        panels.append(_redrawn(pair.predicted, true_panel, first, true_panel if alike else own))
        refs |= _renumbered(own, true_panel.name, first)
    for panel in rest:
        name = next(n for n in (panel.name, *(f"extra {i}" for i in range(len(predicted.panels)))) if n not in taken)
        taken.add(name)
        panels.append(_redrawn(PanelShape.of(panel), replace(panel, name=name), 0, panel))
        refs |= _renumbered(panel, name, 0)
    order = {frozenset((seam.left, seam.right)): (number, seam) for number, seam in enumerate(true.seams)}
    seams = []
    for seam in predicted.seams:
        moved = Seam(refs[seam.left], refs[seam.right], seam.right_wrong)
        number, like = order.get(frozenset((moved.left, moved.right)), (len(order), moved))
        seams.append((number, replace(like, right_wrong=seam.right_wrong)))
    return Pattern(true.name, tuple(panels), tuple(seam for _, seam in sorted(seams, key=lambda item: item[0])))


def _renumbered(panel: Panel, name: str, first: int) -> dict[EdgeRef, EdgeRef]:
    count = len(panel.edges)
    return {EdgeRef(panel.name, edge): EdgeRef(name, (edge - first) % count) for edge in range(count)}


def _redrawn(shape: PanelShape, named: Panel, first: int, labelled: Panel) -> Panel:
    """A panel about its centroid, its loop from edge ``first``; name and label of ``named``, edge labels of another."""
    own = shape.panel
    turned = own.edges[first:] + own.edges[:first]
    labels = [edge.label for edge in labelled.edges]
    if labelled is own:
        labels = labels[first:] + labels[:first]
    edges = tuple(
        Edge(row, (row + 1) % len(turned), edge.curve if shape.side > 0 else mirrored(edge.curve), label)
        for row, (edge, label) in enumerate(zip(turned, labels, strict=True))
    )
    corners = np.round(shape.seen(own.vertices[[edge.start for edge in turned]]), DIGITS)
    placement = Placement(np.round(shape.centre, DIGITS), np.round(euler_angles(shape.matrix), DIGITS))
    return Panel(named.name, corners, edges, placement, named.label)
