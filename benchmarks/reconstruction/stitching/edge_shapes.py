"""What a network sees of the edges of a pattern and of their pairs: lengths, curves, corners and neighbours.

No number depends on where a panel is drawn or how it is turned, nor on the order of the edges.
"""

from dataclasses import dataclass

import torch
from jaxtyping import Float, Int
from torch import Tensor
from torch.nn import functional

from benchmarks.reconstruction.stitching.graphs import SAMPLES, EdgeBatch

__all__ = ["EdgeShapes", "edges_before", "feature_counts", "next_on_boundary", "rows_at"]

USUAL_LENGTH = 20.0  # cm
PLACED_UNIT = 50.0  # cm
LOOP_STEPS = 3  # neighbours in the loop that are told apart, each way
WIDTHS = (0.003, 0.01, 0.03, 0.1, 0.3)  # scales on which differences are compared
WAVES = 4
SEAMS_AT_CORNER = 4  # most seams that end in a corner of the partly sewn garment


@dataclass(frozen=True)
class EdgeShapes:
    """Measures of the edges that do not change when a panel is moved or turned, or the edges reordered."""

    batch: EdgeBatch
    log_length: Float[Tensor, "b e"]
    forward: Float[Tensor, "b e k"]
    """Points along the edge, in the frame of its chord, by length."""
    backward: Float[Tensor, "b e k"]
    """The same of the reversed edge."""
    bend: Float[Tensor, "b e"]
    """Total turn between the ends [rad]."""
    corners: Float[Tensor, "b e 2"]
    """Turn of the outline at start and end [rad]."""

    @staticmethod
    def of(batch: EdgeBatch) -> "EdgeShapes":
        points, lengths = batch.points, batch.lengths.clamp(min=1e-2)
        steps = points.diff(dim=2)
        turns = _turn(steps[:, :, :-1], steps[:, :, 1:])
        first = -3 * points[:, :, 0] + 4 * points[:, :, 1] - points[:, :, 2]
        last = 3 * points[:, :, -1] - 4 * points[:, :, -2] + points[:, :, -3]
        at_end = _turn(last, rows_at(first, batch.following))
        at_start = rows_at(at_end[..., None], edges_before(batch.following))[..., 0]
        return EdgeShapes(
            batch=batch,
            log_length=(lengths / USUAL_LENGTH).log(),
            forward=_profile(points, lengths),
            backward=_profile(points.flip(2), lengths),
            bend=turns.sum(dim=-1),
            corners=torch.stack([at_start, at_end], dim=-1),
        )

    def features(self, *, placed: bool) -> Float[Tensor, "b e f"]:
        """What a network sees of each edge; ``placed``: of its place in space, too."""
        batch = self.batch
        x, y = batch.points.unbind(-1)
        area = self._of_panel(0.5 * (x[..., :-1] * y[..., 1:] - x[..., 1:] * y[..., :-1]).sum(-1)).abs().clamp(min=1e-2)
        perimeter = self._of_panel(batch.lengths).clamp(min=1e-2)
        count = self._of_panel(torch.ones_like(batch.lengths))
        middle, chord = batch.points[:, :, SAMPLES // 2], batch.points[:, :, -1] - batch.points[:, :, 0]
        size = area.sqrt()
        around = torch.stack([self.log_length, self.bend], dim=-1)
        neighbours = [rows_at(around, rows) for rows in (batch.following, edges_before(batch.following))]
        waves = self.log_length[..., None] * 2.0 ** torch.arange(WAVES, device=x.device)
        inputs = [
            torch.stack([self.log_length, self.bend, (size / USUAL_LENGTH).log(), (perimeter / USUAL_LENGTH).log(),
                         count / 8, size / perimeter, batch.lengths / perimeter, middle.norm(dim=-1) / size,
                         _cross(middle, chord) / size / batch.lengths.clamp(min=1e-2)], dim=-1),
            self.corners.sin(), self.corners.cos(), waves.sin(), waves.cos(), self.forward, *neighbours,
        ]  # fmt: skip
        if placed:
            inputs.append(_waves(batch.placed.flatten(2) / PLACED_UNIT))
        return torch.cat(inputs, dim=-1)

    def relations(self, known: Int[Tensor, "b e"], *, placed: bool) -> Float[Tensor, "b e e r"]:
        """What a network sees of each pair; ``known``: partners of the edges that are sewn, -1 for the others."""
        batch = self.batch
        same = batch.panels[:, :, None] == batch.panels[:, None]
        hops, row = [], torch.arange(same.shape[1], device=same.device).expand_as(known)
        for _ in range(LOOP_STEPS):
            row = batch.following.gather(1, row)
            hops.append(_one_hot(row))
        meeting = _one_hot(next_on_boundary(batch.following, known))
        sewn = _one_hot(known.clamp(min=0)) * (known >= 0)[..., None]
        difference = self.log_length[:, :, None] - self.log_length[:, None]
        alike = torch.cdist(self.forward, self.backward)
        flip = 1.0 - 2.0 * (torch.arange(self.forward.shape[-1], device=alike.device) % 2)
        mirrored_alike = torch.cdist(self.forward, self.backward * flip)
        start, end = self.corners.unbind(-1)
        meet = [start[:, :, None] + end[:, None], end[:, :, None] + start[:, None]]
        parts = [
            same.float(), *hops, *(hop.transpose(1, 2) for hop in hops), meeting, meeting.transpose(1, 2), sewn,
            difference.clamp(-3, 3), *_near(difference), *_near(alike), *_near(mirrored_alike),
            *(angle.sin() for angle in meet), *(angle.cos() for angle in meet),
        ]  # fmt: skip
        if placed:
            first, middle, last = (batch.placed[:, :, k] / PLACED_UNIT for k in range(3))
            gaps = [torch.cdist(first, last), torch.cdist(last, first), torch.cdist(middle, middle)]
            gaps.append(torch.cdist(first, first) + torch.cdist(last, last))
            parts += [*gaps, *(near for gap in gaps for near in _near(gap))]
        return torch.stack(parts, dim=-1)

    def _of_panel(self, values: Float[Tensor, "b e"]) -> Float[Tensor, "b e"]:
        """The sum over each edge's panel."""
        panels = self.batch.panels.clamp(min=0)
        values = torch.where(self.batch.valid, values, 0.0)
        return torch.zeros_like(values).scatter_add_(1, panels, values).gather(1, panels)


def feature_counts(*, placed: bool) -> tuple[int, int]:
    """Number of features of an edge, and of a pair."""
    profile = 2 * ((SAMPLES - 1) // 2)
    places = 9 * (2 * WAVES + 1) if placed else 0
    gaps = 4 * (1 + len(WIDTHS)) if placed else 0
    return 9 + 4 + 2 * WAVES + profile + 4 + places, 1 + 2 * LOOP_STEPS + 3 + 1 + 3 * len(WIDTHS) + 4 + gaps


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


def _near(difference: Tensor) -> list[Tensor]:
    return [torch.exp(-((difference / width) ** 2)) for width in WIDTHS]


def _waves(values: Tensor) -> Tensor:
    octaves = (values[..., None] * 2.0 ** torch.arange(WAVES, device=values.device)).flatten(-2)
    return torch.cat([values, octaves.sin(), octaves.cos()], dim=-1)


def rows_at(values: Float[Tensor, "b e k"], rows: Int[Tensor, "b e"]) -> Float[Tensor, "b e k"]:
    return values.gather(1, rows[..., None].expand(*rows.shape, values.shape[-1]))


def _one_hot(rows: Int[Tensor, "b e"]) -> Float[Tensor, "b e e"]:
    return functional.one_hot(rows, rows.shape[1]).float()


def edges_before(following: Int[Tensor, "b e"]) -> Int[Tensor, "b e"]:
    """Row of the edge before."""
    rows = torch.arange(following.shape[1], device=following.device).expand_as(following)
    return torch.empty_like(following).scatter_(1, following, rows)


def next_on_boundary(following: Int[Tensor, "b e"], known: Int[Tensor, "b e"]) -> Int[Tensor, "b e"]:
    """The unsewn edge that starts where each edge ends, once the known seams are sewn (start meets end)."""
    row = following
    for _ in range(SEAMS_AT_CORNER):
        partner = known.gather(1, row)
        row = torch.where(partner >= 0, following.gather(1, partner.clamp(min=0)), row)
    return row
