"""A network's features of edges and of pairs of edges: lengths, curves, corners and neighbours.

No number depends on where a panel is drawn or how it is turned, nor on the order of the edges.
"""

from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor
from torch.nn import functional

from benchmarks.reconstruction.stitching.graphs import SAMPLES, EdgeBatch

USUAL_LENGTH = 20.0  # cm
LOOP_STEPS = 3  # neighbours in the loop that are told apart, each way
SAME_LOOP = 1 + 2 * LOOP_STEPS  # relations by panel and loop, which come before those by known seams
WIDTHS = (0.003, 0.01, 0.03, 0.1, 0.3)  # scales on which differences are compared
WAVES = 4
SEAMS_AT_CORNER = 4  # most seams that end in a corner of the partly sewn garment


@dataclass(frozen=True)
class EdgeInputs:
    """Features of the edges of a batch, and of their pairs, that do not depend on the known seams."""

    valid: Bool[Tensor, "b e"]
    """Rows that are edges."""
    following: Int[Tensor, "b e"]
    edges: Float[Tensor, "b e f"]
    pairs: Float[Tensor, "b e e r"]
    """All relations but those by known seams."""

    @staticmethod
    @torch.no_grad()
    def of(batch: EdgeBatch) -> "EdgeInputs":
        """The features of a batch."""
        shapes = _EdgeShapes.of(batch)
        return EdgeInputs(batch.valid, batch.following, shapes.features(), shapes.pairs())

    def first(self, count: int) -> "EdgeInputs":
        """The inputs of the first ``count`` garments."""
        return EdgeInputs(
            valid=self.valid[:count],
            following=self.following[:count],
            edges=self.edges[:count],
            pairs=self.pairs[:count],
        )

    @torch.no_grad()
    def relations(self, known: Int[Tensor, "b e"]) -> Float[Tensor, "b e e r"]:
        """Features of each pair; ``known``: partners of the sewn edges, -1 for the others."""
        found = _is_row(torch.stack([next_on_boundary(self.following, known), known], dim=-1))
        meeting, sewn = found[..., :1], found[..., 1:]
        before, after = self.pairs[..., :SAME_LOOP], self.pairs[..., SAME_LOOP:]
        return torch.cat([before, meeting, meeting.transpose(1, 2), sewn, after], dim=-1)


@dataclass(frozen=True)
class _EdgeShapes:
    """Measures of the edges that do not change when a panel is moved or turned, or the edges reordered."""

    batch: EdgeBatch
    before: Int[Tensor, "b e"]
    """Row of the edge before."""
    log_length: Float[Tensor, "b e"]
    forward: Float[Tensor, "b e k"]
    """Points along the edge, in the frame of its chord, by length."""
    backward: Float[Tensor, "b e k"]
    """The same points for the reversed edge."""
    bend: Float[Tensor, "b e"]
    """Total turn between the ends [rad]."""
    corners: Float[Tensor, "b e 2"]
    """Turn of the outline at start and end [rad]."""

    @staticmethod
    def of(batch: EdgeBatch) -> "_EdgeShapes":
        points, lengths, before = batch.points, batch.lengths.clamp(min=1e-2), edges_before(batch.following)
        steps = points.diff(dim=2)
        turns = _turn(steps[:, :, :-1], steps[:, :, 1:])
        first = -3 * points[:, :, 0] + 4 * points[:, :, 1] - points[:, :, 2]
        last = 3 * points[:, :, -1] - 4 * points[:, :, -2] + points[:, :, -3]
        at_end = _turn(last, rows_at(first, batch.following))
        return _EdgeShapes(
            batch=batch,
            before=before,
            log_length=(lengths / USUAL_LENGTH).log(),
            forward=_profile(points, lengths),
            backward=_profile(points.flip(2), lengths),
            bend=turns.sum(dim=-1),
            corners=torch.stack([at_end.gather(1, before), at_end], dim=-1),
        )

    def features(self) -> Float[Tensor, "b e f"]:
        """Features of each edge."""
        batch = self.batch
        x, y = batch.points.unbind(-1)
        areas = 0.5 * (x[..., :-1] * y[..., 1:] - x[..., 1:] * y[..., :-1]).sum(-1)
        sums = self._of_panel(torch.stack([areas, batch.lengths, torch.ones_like(areas)], dim=-1))
        area, perimeter = sums[..., :2].abs().clamp(min=1e-2).unbind(-1)
        middle, chord = batch.points[:, :, SAMPLES // 2], batch.points[:, :, -1] - batch.points[:, :, 0]
        size = area.sqrt()
        around = torch.stack([self.log_length, self.bend], dim=-1)
        neighbours = [rows_at(around, rows) for rows in (batch.following, self.before)]
        waves = self.log_length[..., None] * 2.0 ** torch.arange(WAVES, device=x.device)
        inputs = [
            torch.stack([self.log_length, self.bend, (size / USUAL_LENGTH).log(), (perimeter / USUAL_LENGTH).log(),
                         sums[..., 2] / 8, size / perimeter, batch.lengths / perimeter, middle.norm(dim=-1) / size,
                         _cross(middle, chord) / size / batch.lengths.clamp(min=1e-2)], dim=-1),
            self.corners.sin(), self.corners.cos(), waves.sin(), waves.cos(), self.forward, *neighbours,
        ]  # fmt: skip
        return torch.cat(inputs, dim=-1)

    def pairs(self) -> Float[Tensor, "b e e r"]:
        """The relations of each pair, apart from those by known seams."""
        batch, rows = self.batch, [self.batch.following]
        same = batch.panels[:, :, None] == batch.panels[:, None]
        for _ in range(LOOP_STEPS - 1):
            rows.append(batch.following.gather(1, rows[-1]))
        hops = _is_row(torch.stack(rows, dim=-1))
        difference = self.log_length[:, :, None] - self.log_length[:, None]
        flip = 1.0 - 2.0 * (torch.arange(self.forward.shape[-1], device=difference.device) % 2)
        others = torch.stack([self.backward, self.backward * flip], dim=1)
        alike = torch.cdist(self.forward[:, None].expand_as(others), others)
        start, end = self.corners.unbind(-1)
        meet = (start[:, :, None] + end[:, None])[..., None]
        sine, cosine = meet.sin(), meet.cos()
        parts = [
            same.float()[..., None], hops, hops.transpose(1, 2), difference.clamp(-3, 3)[..., None],
            _near(torch.stack([difference, *alike.unbind(1)], dim=-1)),
            sine, sine.transpose(1, 2), cosine, cosine.transpose(1, 2),
        ]  # fmt: skip
        return torch.cat(parts, dim=-1)

    def _of_panel(self, values: Float[Tensor, "b e k"]) -> Float[Tensor, "b e k"]:
        """Sums over the panel of each edge."""
        panels = self.batch.panels.clamp(min=0)[..., None].expand_as(values)
        values = torch.where(self.batch.valid[..., None], values, 0.0)
        return torch.zeros_like(values).scatter_add_(1, panels, values).gather(1, panels)


def feature_counts() -> tuple[int, int]:
    """Number of features of an edge, and of a pair."""
    profile = 2 * ((SAMPLES - 1) // 2)
    return 9 + 4 + 2 * WAVES + profile + 4, 1 + 2 * LOOP_STEPS + 3 + 1 + 3 * len(WIDTHS) + 4


def _profile(points: Float[Tensor, "b e n 2"], lengths: Float[Tensor, "b e"]) -> Float[Tensor, "b e k"]:
    chord = points[:, :, -1] - points[:, :, 0]
    along = functional.normalize(chord, dim=-1)[:, :, None]
    across = torch.stack([-along[..., 1], along[..., 0]], dim=-1)
    offsets = (points[:, :, 1::2] - points[:, :, :1]) / lengths[..., None, None]
    return torch.stack([(offsets * along).sum(-1), (offsets * across).sum(-1)], dim=-1).flatten(2)


def _turn(before: Tensor, after: Tensor) -> Tensor:
    """Angle from one direction to another [rad]."""
    return torch.atan2(_cross(before, after), (before * after).sum(-1))


def _cross(a: Tensor, b: Tensor) -> Tensor:
    return a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]


def _near(differences: Float[Tensor, "b e e k"]) -> Float[Tensor, "b e e n"]:
    """Likeness on each scale, from 0 to 1, of each of the differences in turn."""
    return torch.stack([differences / width for width in WIDTHS], dim=-1).square_().neg_().exp_().flatten(-2)


def rows_at(values: Float[Tensor, "b e k"], rows: Int[Tensor, "b e"]) -> Float[Tensor, "b e k"]:
    return values.gather(1, rows[..., None].expand(*rows.shape, values.shape[-1]))


def _is_row(rows: Int[Tensor, "b e k"]) -> Float[Tensor, "b e e k"]:
    """One-hot codes of ``rows`` over the rows of the garment; zeros for -1."""
    columns = torch.arange(rows.shape[1], device=rows.device)
    return (rows[:, :, None] == columns[:, None]).float()


def edges_before(following: Int[Tensor, "b e"]) -> Int[Tensor, "b e"]:
    """Row of the edge before."""
    rows = torch.arange(following.shape[1], device=following.device).expand_as(following)
    return torch.empty_like(following).scatter_(1, following, rows)


def next_on_boundary(following: Int[Tensor, "b e"], known: Int[Tensor, "b e"]) -> Int[Tensor, "b e"]:
    """The unsewn edge that starts where each edge ends, once the known seams are sewn (start meets end)."""
    rows = torch.arange(following.shape[1], device=following.device)
    across = torch.where(known >= 0, following.gather(1, known.clamp(min=0)), rows)
    row = following
    for _ in range(SEAMS_AT_CORNER):
        row = across.gather(1, row)
    return row
