"""Patterns as sequences of tokens, for ``models/edge_tokens``.

For each panel one token opens it, then one token for each edge of its loop follows; the last edge closes the loop, and
a token ends the pattern. Panels and edges have an order that depends on the pattern alone.
"""

from dataclasses import dataclass, replace

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from benchmarks.reconstruction.garments import GarmentSet
from benchmarks.reconstruction.panel_net import axes_of
from benchmarks.reconstruction.panel_targets import UNIT, PanelTargets, ToTargets
from gcd_dataset.tensors import PANEL_LABELS

LINE = len(PANEL_LABELS)  # kinds below: a new panel, with the row of its label
CURVE, CLOSING_LINE, CLOSING_CURVE, END, START = range(LINE + 1, LINE + 6)
KINDS = START  # kinds that are predicted
EDGE_KINDS = 2  # straight and curved
CENTIMETRE = 1 / UNIT
FAR = 500  # cm: places are sorted within ± FAR


# ------------------------------------------------------------------------------------------------------------ the order


@dataclass(frozen=True)
class ToCanonical(ToTargets):
    """Encodes garments as targets in canonical order."""

    def __call__(self, garments: GarmentSet) -> PanelTargets:
        """See ``ToTargets``."""
        return canonical(super().__call__(garments))


def canonical(true: PanelTargets) -> PanelTargets:
    """The same garments with panels and edges in an order that does not depend on their order before.

    Panels are sorted by label, the back before the front, then by height and from right to left of the wearer, to the
    centimetre. Loops start at the corner of least x + 2 y.
    """
    queries, slots = true.corners.shape[1:3]
    counts = true.edge_counts.clamp(min=1)
    slot = torch.arange(slots, device=counts.device)
    low = true.corners[..., 0] + 2.0 * true.corners[..., 1]
    starts = low.masked_fill(slot >= counts[..., None], torch.inf).argmin(dim=-1)

    x, y, z = (true.centres / CENTIMETRE).round().long().clamp(-FAR, FAR).unbind(dim=-1)
    place = ((true.labels * 2 + (z >= 0)) * 2 * FAR + y) * 2 * FAR + x
    order = place.masked_fill(~true.exists, torch.iinfo(torch.int64).max).argsort(dim=1, stable=True)
    columns = ("exists", "corners", "bends", "extents", "centres", "rotations", "edge_counts", "labels", "slimness")
    panels = {name: rows_of(getattr(true, name), order) for name in columns}
    at = torch.where(slot < counts[..., None], (slot + starts[..., None]) % counts[..., None], slot)
    at = rows_of(at, order)
    panels |= {name: _of_slots(panels[name], at) for name in ("corners", "bends")}

    is_edge = true.edge_panels >= 0
    old = true.edge_panels.long().clamp(min=0)
    new_panels = order.argsort(dim=1).gather(1, old)
    new_slots = (true.edge_slots.long() - starts.gather(1, old)) % counts.gather(1, old)
    number = (new_panels * slots + new_slots).masked_fill(~is_edge, queries * slots)
    edges = number.argsort(dim=1, stable=True)
    partners = true.partners.long()
    moved = edges.argsort(dim=1).gather(1, partners.clamp(min=0))
    table = {
        "edge_panels": torch.where(is_edge, new_panels, -1),
        "edge_slots": torch.where(is_edge, new_slots, 0),
        "partners": torch.where(partners >= 0, moved, -1),
        **{name: getattr(true, name) for name in ("edge_kinds", "edge_labels", "turned")},
    }
    table = {name: rows_of(column, edges).to(getattr(true, name).dtype) for name, column in table.items()}
    return replace(true, **panels, **table)


def rows_of(values: Float[Tensor, "b n *d"], rows: Int[Tensor, "b m"]) -> Float[Tensor, "b m *d"]:
    """Rows of each garment."""
    flat = values.flatten(2) if values.ndim > 2 else values[..., None]
    return flat.gather(1, rows[..., None].expand(-1, -1, flat.shape[-1])).view(*rows.shape, *values.shape[2:])


def _of_slots(values: Float[Tensor, "b q n *d"], slots: Int[Tensor, "b q m"]) -> Float[Tensor, "b q m *d"]:
    """Slots of each panel."""
    return rows_of(values.flatten(0, 1), slots.flatten(0, 1)).view(*slots.shape, *values.shape[3:])


# --------------------------------------------------------------------------------------------------------- the sequence


@dataclass(frozen=True)
class Sequence:
    """The kinds of the tokens of garments, and where their panels and edges stand; padded to one length."""

    kinds: Int[Tensor, "b t"]
    """``START``, then rows of ``PANEL_LABELS`` or kinds of edges, then ``END``, which also pads."""
    panels: Int[Tensor, "b t"]
    """The panel of a token; 0 for ``START`` and ``END``."""
    slots: Int[Tensor, "b t"]
    """0 for a panel, 1 + its number in the loop for an edge."""
    known: Bool[Tensor, "b t"]
    """Mask of the tokens up to the first ``END``; False for all tokens of a garment without panels."""
    at_panels: Int[Tensor, "b q"]
    """Position of each panel; 1 where there is none."""
    at_edges: Int[Tensor, "b e"]
    """Position of each edge; 1 where there is none."""


def sequence_of(true: PanelTargets) -> Sequence:
    """Write the panels and edges of garments as tokens, in the order of their rows."""
    device, (batch, queries) = true.exists.device, true.exists.shape
    edges = true.edge_panels.shape[1]
    length = 2 + queries + edges
    is_edge, of_edges = true.edge_panels >= 0, true.edge_panels.long().clamp(min=0)
    counts = torch.where(true.exists, true.edge_counts, 0)
    before = torch.arange(1, queries + 1, device=device) + counts.cumsum(dim=1) - counts
    at_panels = torch.where(true.exists, before, length)  # position ``length`` is cut off
    at_edges = torch.where(is_edge, torch.arange(2, edges + 2, device=device) + of_edges, length)
    slots = true.edge_slots.long()
    closing = slots == counts.gather(1, of_edges) - 1
    edge_kinds = LINE + true.edge_kinds.long() + EDGE_KINDS * closing

    kinds = torch.full((batch, length + 1), END, device=device)
    kinds[:, 0] = START
    kinds = kinds.scatter(1, at_panels, true.labels).scatter(1, at_edges, edge_kinds)
    zeros = torch.zeros_like(kinds)
    panels = torch.arange(queries, device=device).expand(batch, -1)
    ends = true.exists.sum(dim=1) + is_edge.sum(dim=1) + 1
    ends = torch.where(true.exists.any(dim=1), ends, -1)
    return Sequence(
        kinds=kinds[:, :-1],
        panels=zeros.scatter(1, at_panels, panels).scatter(1, at_edges, of_edges)[:, :-1],
        slots=zeros.scatter(1, at_edges, slots + 1)[:, :-1],
        known=torch.arange(length, device=device) <= ends[:, None],
        at_panels=torch.where(true.exists, at_panels, 1),
        at_edges=torch.where(is_edge, at_edges, 1),
    )


@dataclass(frozen=True)
class Tokens:
    """Tokens as the decoder reads them; lengths in ``UNIT``. ``START`` and ``END`` have zeros for numbers."""

    kinds: Int[Tensor, "b t"]
    panels: Int[Tensor, "b t"]
    slots: Int[Tensor, "b t"]
    start: Float[Tensor, "b t 2"]
    """Start of an edge; the first corner of a panel."""
    bends: Float[Tensor, "b t k 2"]
    end: Float[Tensor, "b t 2"]
    """End of an edge; the first corner of a panel."""
    centres: Float[Tensor, "b t 3"]
    """Centre of the token's panel."""
    axes: Float[Tensor, "b t 6"]
    """First two columns of the rotation of the token's panel."""


def tokens_of(shown: PanelTargets, sequence: Sequence) -> Tokens:
    """The tokens of a sequence, with the numbers of ``shown``."""
    of_edge = sequence.slots > 0
    has_numbers = of_edge | (sequence.kinds < LINE)
    count = rows_of(shown.edge_counts, sequence.panels).clamp(min=1)
    slot = (sequence.slots - 1).clamp(min=0)
    following = torch.where(of_edge, (slot + 1) % count, 0)
    slots = shown.corners.shape[2]
    loops, bends = shown.corners.flatten(1, 2), shown.bends.flatten(1, 2)
    row = sequence.panels * slots

    def numbers(values: Tensor, chosen: Bool[Tensor, "b t"]) -> Tensor:
        return values * chosen.view(*chosen.shape, *[1] * (values.ndim - 2))

    return Tokens(
        kinds=sequence.kinds,
        panels=sequence.panels,
        slots=sequence.slots,
        start=numbers(rows_of(loops, row + slot), has_numbers),
        bends=numbers(rows_of(bends, row + slot), of_edge),
        end=numbers(rows_of(loops, row + following), has_numbers),
        centres=numbers(rows_of(shown.centres, sequence.panels), has_numbers),
        axes=numbers(rows_of(axes_of(shown.rotations), sequence.panels), has_numbers),
    )
