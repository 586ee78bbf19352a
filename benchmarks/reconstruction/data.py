"""Garments as targets of the reconstruction task, and predictions as patterns.

A panel becomes a fixed number of points along its outline, about its centroid and seen from its right side; which of
them are corners; where the centroid hangs; how the panel is turned; and its number of edges. Lengths are in ``UNIT``.
Every corner is one of the points, and edges have points by their length: at equal distances all along, corners would be
cut off, and with them 4 % of the area.
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
"""Fields of a loaded sample that the task reads."""
Arrays: TypeAlias = tuple[np.ndarray, np.ndarray, np.ndarray]
"""A pattern as the ``panels``, ``edges`` and ``stitches`` of a ``PatternTensor``: what a training set keeps of it."""

UNIT = 50.0  # cm: what a garment reaches from its middle, about
MIDDLE = (0.0, 100.0, 0.0)  # cm
MAX_EDGES = 64
LARGEST_RADIUS = 1000.0  # cm: beyond it an arc is better a cubic
STRAIGHT = 0.2  # cm: an edge is straight if its points lie as near to its chord


@dataclass(frozen=True)
class GarmentBatch:
    """Garments side by side; rows of panels beyond a garment's own are zeros."""

    points: Float[Tensor, "b n 6"]
    """Points of the surface about ``MIDDLE`` [UNIT], and normals."""
    exists: Bool[Tensor, "b q"]
    contours: Float[Tensor, "b q c 2"]
    """[UNIT]"""
    corners: Float[Tensor, "b q c"]
    """1 for points of the contour that are corners; a prediction's are any numbers, larger for likelier corners."""
    centres: Float[Tensor, "b q 3"]
    """Centroids in space, about ``MIDDLE`` [UNIT]."""
    turns: Float[Tensor, "b q 3 3"]
    """Rotations of the panels' planes."""
    edge_counts: Int[Tensor, "b q"]

    def __len__(self) -> int:
        return len(self.points)

    def to(self, device: torch.device) -> "GarmentBatch":
        return GarmentBatch(*(getattr(self, field.name).to(device) for field in fields(self)))

    def __getitem__(self, rows: Tensor | slice) -> "GarmentBatch":
        return GarmentBatch(*(getattr(self, field.name)[rows] for field in fields(self)))

    def with_points(self, count: int, generator: torch.Generator) -> "GarmentBatch":
        """The same with ``count`` of the points, drawn anew and in a random order."""
        chosen = torch.randperm(self.points.shape[1], generator=generator, device=generator.device)[:count]
        return replace(self, points=self.points[:, chosen.to(self.points.device)])

    @staticmethod
    def join(parts: Sequence["GarmentBatch"]) -> "GarmentBatch":
        return GarmentBatch(
            *(torch.cat([getattr(part, field.name) for part in parts]) for field in fields(GarmentBatch))
        )


@dataclass(frozen=True)
class ToTargets:
    """A loaded sample to ``(Garments of one row, Arrays)``: the transform of a data set."""

    queries: int
    contour_points: int
    points: int

    def __call__(self, item: dict[str, Any]) -> tuple[GarmentBatch, Arrays]:
        """Raises ``ConfigError`` for more panels or edges than the network can say."""
        arrays = (item["panels"].numpy(), item["edges"].numpy(), item["stitches"].numpy())
        points = item["points"][: self.points].float()
        points = torch.cat([(points[:, :3] - torch.tensor(MIDDLE)) / UNIT, points[:, 3:]], dim=1)
        return replace(self.of(pattern_of(arrays)), points=points[None].half()), arrays

    def of(self, pattern: Pattern) -> GarmentBatch:
        """The pattern as targets, without points."""
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
            centres=self._padded([(s.centre - MIDDLE) / UNIT for s in shapes], (3,)),
            turns=self._padded([s.matrix for s in shapes], (3, 3)),
            edge_counts=self._padded([np.array(len(s.panel.edges)) for s in shapes], ()).long(),
        )

    def _outline(self, shape: PanelShape) -> tuple[Float[np.ndarray, "c 2"], Float[np.ndarray, " c"]]:
        """Points along the outline [cm], and which of them are corners."""
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
    """``count`` split by length, one at least for each (largest remainders). Raises ``ConfigError`` for too many."""
    spare = count - len(lengths)
    if spare < 0:
        raise ConfigError(f"a panel has {len(lengths)} edges, its contour {count} points: raise --contour-points")
    exact = spare * lengths / lengths.sum()
    whole = np.floor(exact).astype(int)
    whole[np.argsort(whole - exact, kind="stable")[: spare - whole.sum()]] += 1
    return [int(n) + 1 for n in whole]


def collate(items: Sequence[tuple[GarmentBatch, Arrays]]) -> tuple[GarmentBatch, list[Arrays]]:
    """Several samples as one batch, for a ``DataLoader``."""
    targets, arrays = zip(*items, strict=True)
    return GarmentBatch.join(targets), list(arrays)


def pattern_of(arrays: Arrays) -> Pattern:
    """The pattern of a loaded sample's arrays; panels are called by their numbers, and labels left out."""
    panels, edges, stitches = arrays
    panels, edges = panels.copy(), edges.copy()
    panels[:, PanelColumn.LABEL], edges[:, EdgeColumn.LABEL] = 0, 0
    names = tuple(str(row) for row in range(len(panels)))
    return decode_pattern(PatternTensor(panels, edges, stitches, names))


def patterns_from(garments: GarmentBatch) -> list[Pattern]:
    """The patterns that targets, or predictions in their form, stand for; without seams."""
    names = ("exists", "contours", "corners", "centres", "turns", "edge_counts")
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
    """A panel of ``edge_count`` edges between the likeliest corners of the contour."""
    chosen = np.sort(np.argsort(-corners, kind="stable")[: max(edge_count, 2)])
    loop = UNIT * np.roll(contour, -chosen[0], axis=0).astype(float)
    bounds = np.append(chosen - chosen[0], len(loop)).tolist()
    closed = np.concatenate([loop, loop[:1]])
    edges = tuple(
        Edge(i, (i + 1) % len(chosen), fitted_curve(closed[first : last + 1]))
        for i, (first, last) in enumerate(pairwise(bounds))
    )
    placement = Placement(UNIT * centre.astype(float) + MIDDLE, euler_angles(turn.astype(float)))
    return Panel(name, loop[bounds[:-1]], edges, placement)


def fitted_curve(points: Float[np.ndarray, "n 2"]) -> Curve:
    """The line if it is as near as ``STRAIGHT``, else the nearer of cubic and arc, from the first point to the last."""
    start, end = points[0], points[-1]
    t = np.linspace(0, 1, len(points))[:, None]
    straight = (1 - t) * start + t * end
    if np.linalg.norm(points - straight, axis=1).max() < STRAIGHT or np.hypot(*(end - start)) == 0.0:
        return LINE
    cubic, cubic_miss = _fitted_cubic(points, straight, t)
    arc, arc_miss = _fitted_arc(points)
    return arc if arc is not None and arc_miss < cubic_miss else cubic


def _fitted_cubic(points: np.ndarray, straight: np.ndarray, t: np.ndarray) -> tuple[Cubic, float]:
    """Least squares over equal steps of the parameter, and by how much it misses a point at most [cm]."""
    basis = np.concatenate([3 * t * (1 - t) ** 2, 3 * t**2 * (1 - t)], axis=1)
    bend = np.linalg.lstsq(basis, points - straight, rcond=None)[0]  # of the controls, off the thirds of the chord
    start, end = points[0], points[-1]
    ends = (start[0], start[1]), (end[0], end[1])
    controls = start + np.array([[1.0], [2.0]]) / 3 * (end - start) + bend
    miss = np.linalg.norm(points - straight - basis @ bend, axis=1).max()
    return Cubic(*(to_frame(*ends, (x, y)) for x, y in controls.tolist())), float(miss)


def _fitted_arc(points: np.ndarray) -> tuple[Arc | None, float]:
    """The circle by algebraic least squares (Kåsa 1976), and by how much it misses a point at most [cm]."""
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
