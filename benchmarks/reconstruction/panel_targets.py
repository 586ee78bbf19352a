"""Targets of networks that answer with a set of panels, and patterns from their predictions.

A panel becomes its corners, in the order of the loop, relative to its centroid and seen from its right side; the bend
of the edge that begins at each corner, the distance of ``BENDS`` points of the edge from its chord; the position of the
centroid; and the panel's rotation. Lengths are in ``UNIT``. A table of all edges of the garment holds their kinds,
labels and seams.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from itertools import chain

import numpy as np
import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from benchmarks.reconstruction.derived import CENTRE
from benchmarks.reconstruction.garments import GarmentSet
from benchmarks.reconstruction.learners import Batch, Examples, TensorExamples, uploaded
from gcd_dataset.curves import LINE, fitted_curve, sample_curve
from gcd_dataset.errors import ConfigError
from gcd_dataset.faults import Severity, check_pattern
from gcd_dataset.metrics import PanelShape
from gcd_dataset.records import Edge, EdgeRef, EdgeRole, Panel, PanelRole, Pattern, Placement, Seam, role_of
from gcd_dataset.spec import euler_angles
from gcd_dataset.tensors import EDGE_LABELS, PANEL_LABELS
from gcd_dataset.workers import parallel_map

UNIT = 50.0  # cm, roughly a garment's extent from its centre
BENDS = 5  # inner points of an edge, at equal shares of its length
TOGETHER = 8  # garments that a process draws at once


@dataclass(frozen=True)
class PanelTargets(TensorExamples):
    """Garments stacked to an equal number of panels ``q`` and edges ``e``; rows beyond a garment's own are empty."""

    points: Float[Tensor, "b n 6"]
    """Surface points relative to ``CENTRE`` [UNIT], and normals; f16."""
    exists: Bool[Tensor, "b q"]
    corners: Float[Tensor, "b q n 2"]
    """Corners relative to the centroid [UNIT], in the order of the loop."""
    bends: Float[Tensor, "b q n k 2"]
    """Offsets of each edge from its chord, at equal shares of the length; row: the corner where the edge begins."""
    extents: Float[Tensor, "b q 2"]
    """Half of the panel's width and height [UNIT]."""
    centres: Float[Tensor, "b q 3"]
    """Centroids of the placed panels, relative to ``CENTRE`` [UNIT]."""
    rotations: Float[Tensor, "b q 3 3"]
    """Rotations of the panels."""
    edge_counts: Int[Tensor, "b q"]
    labels: Int[Tensor, "b q"]
    """Rows of ``PANEL_LABELS``."""
    slimness: Float[Tensor, "b q"]
    """Perimeter / area [1/UNIT]: an outline moved by d changes about the share d · slimness of the area."""
    edge_panels: Int[Tensor, "b e"]
    """Row of the panel of each edge, i16; -1 beyond the garment's edges. Edges are in the order of panels and loops."""
    edge_slots: Int[Tensor, "b e"]
    """Number of the edge in its loop, i16."""
    edge_kinds: Int[Tensor, "b e"]
    """1 for a curve, 0 for a straight edge, i16."""
    edge_labels: Int[Tensor, "b e"]
    """Rows of ``EDGE_LABELS``, i16."""
    partners: Int[Tensor, "b e"]
    """Row of the edge that the edge is sewn to, i16; -1 for none."""
    turned: Bool[Tensor, "b e"]
    """Whether the starts of the two edges meet (``Seam.right_wrong``)."""

    def with_points(self, count: int, generator: torch.Generator) -> "PanelTargets":
        """The garments with ``count`` of their points, drawn at random."""
        chosen = torch.randperm(self.points.shape[1], generator=generator, device=generator.device)[:count]
        return replace(self, points=self.points[:, uploaded(chosen, self.points.device)])


@dataclass(frozen=True)
class ToTargets:
    """Encodes garments as ``PanelTargets``, on the CPU."""

    queries: int
    slots: int
    """Most edges of a panel."""
    edges: int
    """Most edges of a garment."""
    points: int

    def __call__(self, garments: GarmentSet) -> PanelTargets:
        """Targets of all garments; one beyond the sizes gets no panels, so that it can be answered for, not learned."""
        patterns = [garments.pattern(k) for k in range(len(garments))]
        found = PanelTargets.join([self.of(p if self.has_room(p) else Pattern("", (), ())) for p in patterns])
        return replace(found, points=scaled_points(garments.points[:, : self.points]))

    def has_room(self, pattern: Pattern) -> bool:
        """Whether the pattern is within the sizes."""
        counts = [len(panel.edges) for panel in pattern.panels]
        return len(counts) <= self.queries and sum(counts) <= self.edges and max(counts, default=0) <= self.slots

    def of(self, pattern: Pattern) -> PanelTargets:
        """The targets of a pattern, without surface points. Raises ``ConfigError`` for one beyond the sizes."""
        panels = pattern.panels
        shapes = [PanelShape.of(panel) for panel in panels]
        counts = [len(panel.edges) for panel in panels]
        if not self.has_room(pattern):
            raise ConfigError(
                f"{pattern.name}: {len(shapes)} panels, {sum(counts)} edges, up to {max(counts)} of a panel; the "
                f"network has room for {self.queries}, {self.edges} and {self.slots}: raise queries, edges or slots"
            )
        outlines = [_outline(shape) for shape in shapes]
        loops = [corners.reshape(-1, 2) for corners, _ in outlines]
        return PanelTargets(
            points=torch.zeros(1, 0, 6, dtype=torch.float16),
            exists=self._padded([np.array(True) for _ in shapes], ()).bool(),
            corners=self._padded([self._slots(corners) for corners in loops], (self.slots, 2)),
            bends=self._padded([self._slots(bends) for _, bends in outlines], (self.slots, BENDS, 2)),
            extents=self._padded([np.ptp(s.loop, axis=0) / 2 / UNIT for s in shapes], (2,)),
            centres=self._padded([(s.centre - CENTRE) / UNIT for s in shapes], (3,)),
            rotations=self._padded([s.matrix for s in shapes], (3, 3)),
            edge_counts=self._padded([np.array(count) for count in counts], ()).long(),
            labels=self._padded([np.array(_number(panel.label, PANEL_LABELS)) for panel in panels], ()).long(),
            slimness=self._padded([np.array(UNIT * s.polygon.length / s.polygon.area) for s in shapes], ()),
            **self._edges(pattern, counts),
        )

    def _slots(self, rows: np.ndarray) -> np.ndarray:
        return np.concatenate([rows, np.zeros((self.slots - len(rows), *rows.shape[1:]))])

    def _edges(self, pattern: Pattern, counts: Sequence[int]) -> dict[str, Tensor]:
        """The table of edges; ``counts``: edges of each panel."""
        refs = [EdgeRef(panel.name, i) for panel in pattern.panels for i in range(len(panel.edges))]
        row_of = {ref: row for row, ref in enumerate(refs)}
        edges = [edge for panel in pattern.panels for edge in panel.edges]
        columns = {
            "edge_panels": np.full(self.edges, -1),
            "edge_slots": np.zeros(self.edges),
            "edge_kinds": np.zeros(self.edges),
            "edge_labels": np.zeros(self.edges),
            "partners": np.full(self.edges, -1),
            "turned": np.zeros(self.edges),
        }
        columns["edge_panels"][: len(refs)] = np.repeat(np.arange(len(counts)), counts)
        columns["edge_slots"][: len(refs)] = [ref.edge for ref in refs]
        columns["edge_kinds"][: len(refs)] = [edge.curve != LINE for edge in edges]
        columns["edge_labels"][: len(refs)] = [_number(edge.label, EDGE_LABELS) for edge in edges]
        for seam in pattern.seams:
            left, right = row_of[seam.left], row_of[seam.right]
            columns["partners"][[left, right]] = right, left
            columns["turned"][[left, right]] = seam.right_wrong
        found = {name: torch.from_numpy(column.astype(np.int16))[None] for name, column in columns.items()}
        return {**found, "turned": found["turned"].bool()}

    def _padded(self, rows: Sequence[np.ndarray], shape: tuple[int, ...]) -> Tensor:
        padded = torch.zeros(1, self.queries, *shape)
        padded[0, : len(rows)] = torch.from_numpy(np.array(rows, np.float32).reshape(len(rows), *shape))
        return padded


def scaled_points(points: Float[np.ndarray, "g n 6"], device: torch.device | None = None) -> Float[Tensor, "g n 6"]:
    """Points [cm] and normals of garments as networks read them, on a device, the CPU by default."""
    found = torch.from_numpy(points).to(device)
    return torch.cat([found[..., :3] / UNIT, found[..., 3:]], dim=-1)


def _number(label: str, table: Sequence[str]) -> int:
    return table.index(label) if label in table else 0


def _outline(shape: PanelShape) -> tuple[Float[np.ndarray, "n 2"], Float[np.ndarray, "n k 2"]]:
    """Corners and bends [UNIT]; the loop runs counter-clockwise as seen from the right side."""
    panel = shape.panel
    pieces = [
        shape.seen(sample_curve(*panel.edge_ends(i), edge.curve, BENDS + 2)) / UNIT
        for i, edge in enumerate(panel.edges)
    ]
    return np.array([piece[0] for piece in pieces]), np.array([piece[1:-1] - _chord(piece) for piece in pieces])


def _chord(piece: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, "k 2"]:
    """Points at equal shares of the chord between the first and the last."""
    t = np.linspace(0, 1, BENDS + 2)[1:-1, None]
    return (1 - t) * piece[0] + t * piece[-1]


def patterns_by(
    predict: Callable[[Batch], PanelTargets], examples: Examples[Batch], count: int, *, batch: int, workers: int
) -> Iterator[Pattern]:
    """The patterns predicted for the first ``count`` examples, drawn by ``workers`` processes."""
    rows = torch.split(torch.arange(count), batch)
    said = PanelTargets.join([predict(examples.batch(part)).to(torch.device("cpu")) for part in rows])
    parts = (said[k : k + TOGETHER] for k in range(0, count, TOGETHER))
    return chain.from_iterable(parallel_map(patterns_from, parts, workers))


def patterns_from(garments: PanelTargets) -> list[Pattern]:
    """The patterns of targets, or of predictions in the same form.

    Outlines that cross themselves are untangled (``simple_panel``), and panels without edges left out, so that the
    patterns can be sewn.
    """
    columns = {field.name: getattr(garments, field.name).detach().cpu() for field in fields(garments)}
    arrays = {name: column.numpy() for name, column in columns.items() if name != "points"}
    return [_pattern({name: column[k] for name, column in arrays.items()}) for k in range(len(garments))]


def _pattern(row: Mapping[str, np.ndarray]) -> Pattern:
    panels: list[Panel] = []
    refs: dict[int, EdgeRef] = {}
    for number, query in enumerate(np.flatnonzero(row["exists"]).tolist()):
        edges = np.flatnonzero(row["edge_panels"] == query)
        if not len(edges):
            continue
        refs |= {edge: EdgeRef(str(number), i) for i, edge in enumerate(edges.tolist())}
        panels.append(_panel(str(number), row, query, edges))
    sewn = [(edge, int(row["partners"][edge])) for edge in refs]
    seams = [Seam(refs[a], refs[b], bool(row["turned"][a])) for a, b in sewn if a < b and b in refs]
    return Pattern("", tuple(panels), tuple(seams))


# ----------------------------------------------------------------------------------------------------------- the curves


def _panel(name: str, row: Mapping[str, np.ndarray], query: int, edges: np.ndarray) -> Panel:
    """The panel of a query; ``edges``: its rows in the table of edges, in the order of the loop."""
    slots, count = row["edge_slots"][edges].astype(int), len(edges)
    corners = UNIT * row["corners"][query, slots].astype(float)
    bends = UNIT * row["bends"][query, slots].astype(float)
    placement = Placement(UNIT * row["centres"][query].astype(float) + CENTRE, euler_angles(row["rotations"][query]))
    drawn = []
    for i, kind in enumerate(row["edge_kinds"][edges].tolist()):
        ends = np.stack([corners[i], corners[(i + 1) % count]])
        curve = fitted_curve(np.concatenate([ends[:1], _chord(ends) + bends[i], ends[1:]])) if kind else LINE
        label = role_of(EdgeRole, EDGE_LABELS[int(row["edge_labels"][edges[i]])])
        drawn.append(Edge(i, (i + 1) % count, curve, label))
    label = role_of(PanelRole, PANEL_LABELS[int(row["labels"][query])])
    return simple_panel(Panel(name, corners, tuple(drawn), placement, label))


def simple_panel(panel: Panel) -> Panel:
    """The panel with an outline that does not cross itself.

    Tried in order: the panel as it is; with straight edges; its corners in the order of their angle about the middle,
    which is simple for any corners in general position.
    """
    straight = replace(panel, edges=tuple(replace(edge, curve=LINE) for edge in panel.edges))
    middle = panel.vertices.mean(axis=0)
    spokes = panel.vertices - middle
    order = np.argsort(np.arctan2(spokes[:, 1], spokes[:, 0]), kind="stable")
    shift = int(np.flatnonzero(order == 0)[0])
    star = replace(straight, vertices=panel.vertices[np.roll(order, -shift)])
    return next((tried for tried in (panel, straight) if _is_simple(tried)), star)


def _is_simple(panel: Panel) -> bool:
    alone = Pattern("", (panel,), ())
    return not any(fault.severity is Severity.ERROR for fault in check_pattern(alone))
