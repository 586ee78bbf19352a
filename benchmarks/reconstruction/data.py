"""Targets of the reconstruction task from patterns, and patterns from predictions.

A panel becomes a fixed number of outline points, relative to its centroid and seen from its right side; a flag for
points that are corners; the position of the centroid; the panel's rotation; and its number of edges. Lengths are in
``UNIT``. Every corner is an outline point, and edges get points in proportion to their length: equidistant points over
the whole outline would cut corners, and 4 % of the area with them.
"""

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from itertools import pairwise
from typing import Any, TypeAlias

import numpy as np
import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from gcd_dataset.curves import LINE, Arc, Cubic, Curve, curve_length, sample_curve, to_frame
from gcd_dataset.errors import ConfigError
from gcd_dataset.metrics import PanelShape
from gcd_dataset.records import Edge, Panel, Pattern, Placement
from gcd_dataset.spec import euler_angles
from gcd_dataset.tensors import EdgeColumn, PanelColumn, PatternTensor, decode_pattern

__all__ = [
    "FIELDS",
    "MAX_EDGES",
    "UNIT",
    "Arrays",
    "GarmentBatch",
    "ToTargets",
    "collate",
    "pattern_of",
    "patterns_from",
]

FIELDS = ("points", "panels", "edges", "stitches")
"""Item fields that the task reads."""
Arrays: TypeAlias = tuple[np.ndarray, np.ndarray, np.ndarray]
"""``panels``, ``edges`` and ``stitches`` of a ``PatternTensor``: the pattern as stored with a training set."""

UNIT = 50.0  # cm, roughly a garment's extent from its centre
CENTRE = (0.0, 100.0, 0.0)  # cm, roughly the centre of garments
MAX_EDGES = 64
LARGEST_RADIUS = 1000.0  # cm; a flatter arc becomes a cubic
STRAIGHT = 0.2  # cm; an edge is straight if its points are this close to the chord


@dataclass(frozen=True)
class GarmentBatch:
    """Garments stacked to an equal number of panels; rows beyond a garment's own are zeros."""

    points: Float[Tensor, "b n 6"]
    """Surface points relative to ``CENTRE`` [UNIT], and normals."""
    exists: Bool[Tensor, "b q"]
    contours: Float[Tensor, "b q c 2"]
    """Outline points relative to the centroid [UNIT]."""
    corners: Float[Tensor, "b q c"]
    """Targets: 1 for corners, else 0. Predictions: scores, larger for likelier corners."""
    centres: Float[Tensor, "b q 3"]
    """Centroids of the placed panels, relative to ``CENTRE`` [UNIT]."""
    rotations: Float[Tensor, "b q 3 3"]
    """Rotations of the panels."""
    edge_counts: Int[Tensor, "b q"]

    def __len__(self) -> int:
        return len(self.points)

    def to(self, device: torch.device) -> "GarmentBatch":
        return GarmentBatch(*(getattr(self, field.name).to(device) for field in fields(self)))

    def __getitem__(self, rows: Tensor | slice) -> "GarmentBatch":
        return GarmentBatch(*(getattr(self, field.name)[rows] for field in fields(self)))

    def with_points(self, count: int, generator: torch.Generator) -> "GarmentBatch":
        """The garments with ``count`` of their points, drawn at random."""
        chosen = torch.randperm(self.points.shape[1], generator=generator, device=generator.device)[:count]
        return replace(self, points=self.points[:, chosen.to(self.points.device)])

    @staticmethod
    def join(parts: Sequence["GarmentBatch"]) -> "GarmentBatch":
        return GarmentBatch(
            *(torch.cat([getattr(part, field.name) for part in parts]) for field in fields(GarmentBatch))
        )


@dataclass(frozen=True)
class ToTargets:
    """Transform of a data set: item to ``(GarmentBatch of one, Arrays)``."""

    queries: int
    contour_points: int
    points: int

    def __call__(self, item: dict[str, Any]) -> tuple[GarmentBatch, Arrays]:
        """The targets of an item. Raises ``ConfigError`` for more panels or edges than the network supports."""
        arrays = (item["panels"].numpy(), item["edges"].numpy(), item["stitches"].numpy())
        points = item["points"][: self.points].float()
        points = torch.cat([(points[:, :3] - torch.tensor(CENTRE)) / UNIT, points[:, 3:]], dim=1)
        return replace(self.of(pattern_of(arrays)), points=points[None].half()), arrays

    def of(self, pattern: Pattern) -> GarmentBatch:
        """The targets of a pattern, without surface points."""
        shapes = [PanelShape.of(panel) for panel in pattern.panels]
        if any(len(panel.edges) > MAX_EDGES for panel in pattern.panels):
            raise ConfigError(f"a panel has over {MAX_EDGES} edges: raise MAX_EDGES")
        if len(shapes) > self.queries:
            raise ConfigError(
                f"a garment has {len(shapes)} panels, the network {self.queries} queries: raise --queries"
            )
        outlines = [self._outline(shape) for shape in shapes]
        return GarmentBatch(
            points=torch.zeros(1, 0, 6),
            exists=self._padded([np.array(True) for _ in shapes], ()).bool(),
            contours=self._padded([contour / UNIT for contour, _ in outlines], (self.contour_points, 2)),
            corners=self._padded([corners for _, corners in outlines], (self.contour_points,)),
            centres=self._padded([(s.centre - CENTRE) / UNIT for s in shapes], (3,)),
            rotations=self._padded([s.matrix for s in shapes], (3, 3)),
            edge_counts=self._padded([np.array(len(s.panel.edges)) for s in shapes], ()).long(),
        )

    def _outline(self, shape: PanelShape) -> tuple[Float[np.ndarray, "c 2"], Float[np.ndarray, " c"]]:
        """Outline points [cm], and 1 for those that are corners."""
        panel = shape.panel
        lengths = np.array([curve_length(*panel.edge_ends(i), edge.curve) for i, edge in enumerate(panel.edges)])
        counts = shares(lengths, self.contour_points)
        pieces = [
            sample_curve(*panel.edge_ends(i), edge.curve, count + 1)[:-1]
            for i, (edge, count) in enumerate(zip(panel.edges, counts, strict=True))
        ]
        corners = np.concatenate([np.arange(count) == 0 for count in counts])
        return shape.seen(np.concatenate(pieces)), corners

    def _padded(self, rows: Sequence[np.ndarray], shape: tuple[int, ...]) -> Tensor:
        padded = torch.zeros(1, self.queries, *shape)
        padded[0, : len(rows)] = torch.from_numpy(np.array(rows, np.float32).reshape(len(rows), *shape))
        return padded


def shares(lengths: Float[np.ndarray, " e"], count: int) -> list[int]:
    """``count`` divided in proportion to lengths, at least one each (largest remainders). Raises ``ConfigError``."""
    spare = count - len(lengths)
    if spare < 0:
        raise ConfigError(
            f"a panel has {len(lengths)} edges, but its contour only {count} points: raise --contour-points"
        )
    exact = spare * lengths / lengths.sum()
    whole = np.floor(exact).astype(int)
    whole[np.argsort(whole - exact, kind="stable")[: spare - whole.sum()]] += 1
    return [int(n) + 1 for n in whole]


def collate(items: Sequence[tuple[GarmentBatch, Arrays]]) -> tuple[GarmentBatch, list[Arrays]]:
    """The ``collate_fn``: one batch from several transformed items."""
    targets, arrays = zip(*items, strict=True)
    return GarmentBatch.join(targets), list(arrays)


def pattern_of(arrays: Arrays) -> Pattern:
    """The pattern of an item's arrays; panels are named by number, without labels."""
    panels, edges, stitches = arrays
    panels, edges = panels.copy(), edges.copy()
    panels[:, PanelColumn.LABEL], edges[:, EdgeColumn.LABEL] = 0, 0
    names = tuple(str(row) for row in range(len(panels)))
    return decode_pattern(PatternTensor(panels, edges, stitches, names))


def patterns_from(garments: GarmentBatch) -> list[Pattern]:
    """The patterns of targets, or of predictions in the same form; without seams."""
    names = ("exists", "contours", "corners", "centres", "rotations", "edge_counts")
    arrays = [getattr(garments, name).detach().cpu().numpy() for name in names]
    patterns = []
    for exists, *panels in zip(*arrays, strict=True):
        rows = zip(*(column[exists] for column in panels), strict=True)
        patterns.append(Pattern("", tuple(_panel(str(number), *row) for number, row in enumerate(rows)), ()))
    return patterns


# --------------------------------------------------------------------------------------------------- contours to panels


def _panel(
    name: str, contour: np.ndarray, corners: np.ndarray, centre: np.ndarray, turn: np.ndarray, edge_count: int
) -> Panel:
    """A panel with ``edge_count`` edges between the likeliest corners of the contour."""
    chosen = np.sort(np.argsort(-corners, kind="stable")[: max(edge_count, 2)])
    loop = UNIT * np.roll(contour, -chosen[0], axis=0).astype(float)
    bounds = np.append(chosen - chosen[0], len(loop)).tolist()
    closed = np.concatenate([loop, loop[:1]])
    edges = tuple(
        Edge(i, (i + 1) % len(chosen), fitted_curve(closed[first : last + 1]))
        for i, (first, last) in enumerate(pairwise(bounds))
    )
    placement = Placement(UNIT * centre.astype(float) + CENTRE, euler_angles(turn.astype(float)))
    return Panel(name, loop[bounds[:-1]], edges, placement)


def fitted_curve(points: Float[np.ndarray, "n 2"]) -> Curve:
    """The curve through points: a line if within ``STRAIGHT``, else the closer of cubic and arc; ends are kept."""
    start, end = points[0], points[-1]
    t = np.linspace(0, 1, len(points))[:, None]
    straight = (1 - t) * start + t * end
    if np.linalg.norm(points - straight, axis=1).max() < STRAIGHT or np.hypot(*(end - start)) == 0.0:
        return LINE
    cubic, cubic_miss = _fitted_cubic(points, straight, t)
    arc, arc_miss = _fitted_arc(points)
    return arc if arc is not None and arc_miss < cubic_miss else cubic


def _fitted_cubic(points: np.ndarray, straight: np.ndarray, t: np.ndarray) -> tuple[Cubic, float]:
    """A cubic by least squares over equal parameter steps, and its largest error at a point [cm]."""
    basis = np.concatenate([3 * t * (1 - t) ** 2, 3 * t**2 * (1 - t)], axis=1)
    bend = np.linalg.lstsq(basis, points - straight, rcond=None)[
        0
    ]  # offset of the control points from the thirds of the chord
    start, end = points[0], points[-1]
    ends = (start[0], start[1]), (end[0], end[1])
    controls = start + np.array([[1.0], [2.0]]) / 3 * (end - start) + bend
    miss = np.linalg.norm(points - straight - basis @ bend, axis=1).max()
    return Cubic(*(to_frame(*ends, (x, y)) for x, y in controls.tolist())), float(miss)


def _fitted_arc(points: np.ndarray) -> tuple[Arc | None, float]:
    """A circular arc by algebraic least squares (Kåsa 1976), and its largest error at a point [cm]."""
    system = np.concatenate([2 * points, np.ones((len(points), 1))], axis=1)
    x, y, rest = np.linalg.lstsq(system, np.sum(points**2, axis=1), rcond=None)[0]
    radius = float(np.sqrt(max(rest + x * x + y * y, 0.0)))
    spokes = points - [x, y]
    miss = float(np.abs(np.linalg.norm(spokes, axis=1) - radius).max())
    before, after = spokes[:-1], spokes[1:]
    turns = np.arctan2(before[:, 0] * after[:, 1] - before[:, 1] * after[:, 0], np.sum(before * after, axis=1)).sum()
    if not np.hypot(*(points[-1] - points[0])) / 2 < radius < LARGEST_RADIUS:
        return None, miss
    return Arc(radius, large=bool(abs(turns) > np.pi), right=bool(turns > 0)), miss
