"""From surface points of a garment to the set of its panels, sewn.

``point_net`` makes tokens of the points, ``panel_net`` panels, edges and seams of the tokens. Panels are a set: the
loss matches queries to panels at least cost, and a loop may start at any corner.
"""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor
from torch.nn import functional

from benchmarks.reconstruction.learners import least_cost, mean_of, sizes_from, squared_distances
from benchmarks.reconstruction.panel_answers import LEAST_EDGES, answers_of
from benchmarks.reconstruction.panel_net import Edges, NetConfig, PanelDecoder, Predicted, Sewn, axes_of
from benchmarks.reconstruction.panel_targets import PanelTargets
from benchmarks.reconstruction.point_net import PointLearner

TASKS = ("T0", "T1", "T1-scan")
WEIGHTS = {
    "exists": 2.0, "corners": 5.0, "bends": 5.0, "areas": 0.5, "extents": 0.5, "centres": 5.0, "rotations": 1.0,
    "edges": 0.5, "labels": 0.2, "partners": 1.0, "turned": 0.2, "kinds": 0.5, "edge_labels": 0.2,
}  # fmt: skip
REFINED = 2.0  # weight of the moved loops, relative to those of all layers of the decoder
LEAST = {"seen": 0, "edge_layers": 0, "slots": LEAST_EDGES}
HEADS = {"width": "heads", "edge_width": "edge_heads"}
"""Least sizes, and widths with the heads that share them."""
LEAST_EXTENT = 1e-3  # UNIT
TINY = 1e-12  # keeps the slope of square roots finite
USUAL: Mapping[str, Any] = {"batch": 256, "lr": 5e-4}
"""Options of a training on a GPU."""
SMOKE: Mapping[str, Any] = {
    "steps": 300, "batch": 8, "lr": 3e-3, "weight_decay": 0.0, "ema": 0.9, "log_every": 10, "checks": 2,
}  # fmt: skip
SMALL: Mapping[str, Any] = {
    "queries": 12, "slots": 24, "edges": 96, "tokens": 32, "width": 64, "heads": 4, "layers": 1,
    "region_width": 32, "edge_width": 64, "edge_heads": 4, "edge_layers": 1, "seam_layers": 1, "points": 256,
    "stored_points": 1024,
}  # fmt: skip
"""Options of the smallest training, for two CPU cores, and the sizes of its network."""


# ---------------------------------------------------------------------------------------------------------- the learner


class PanelSet(PointLearner):
    """Points and normals to a pattern, by queries for panels."""

    def __init__(self, config: NetConfig | None = None, *, points: int = 4096, stored_points: int = 8192) -> None:
        """See ``PointLearner``."""
        config = config or NetConfig()
        super().__init__(config, points=points, stored_points=stored_points)
        self.decoder = PanelDecoder(config)

    def compile_parts(self) -> None:
        # Layer by layer: equal layers share their code. The number of edges differs between batches.
        for part in (self.tokens.features, *self.tokens.encoder.layers, *self.decoder.layers):
            part.compile()
        for layer in (*self.decoder.mover.layers, *self.decoder.seams.layers.layers):
            layer.compile(dynamic=True)

    def loss(self, batch: PanelTargets) -> dict[str, Tensor]:
        return set_loss(self.decoder, self.tokens(batch.points), batch)

    def decoded(self, tokens: Float[Tensor, "b t w"]) -> PanelTargets:
        return answers_of(self.decoder, tokens)


def build(config: Mapping[str, Any]) -> PanelSet:
    """The learner; ``config``: fields of ``NetConfig``, ``points`` and ``stored_points``.

    Raises ``ConfigError`` for others.
    """
    own = ("points", "stored_points")
    sizes, arguments = sizes_from("panel_set", NetConfig, config, own=own, least=LEAST, heads=HEADS)
    return PanelSet(sizes, **arguments)


# ------------------------------------------------------------------------------------------------------------- the loss


def set_loss(decoder: PanelDecoder, tokens: Float[Tensor, "b t w"], true: PanelTargets) -> dict[str, Tensor]:
    """Weighted loss terms by name, of panels, moved edges and seams.

    Invariant to the order of the true panels and to the start of their loops.
    """
    layers, panels = decoder(tokens)
    with torch.autocast(tokens.device.type, enabled=False):
        parts, queries, shifts = panel_losses(layers, true)
    edges = _true_edges(true, queries, shifts)
    # Detached: moves and seams teach the tokens, not the first loops.
    moved, features = decoder.mover(edges, panels, layers[-1].detach(), tokens)
    fixed = replace(moved, corners=moved.corners.detach(), bends=moved.bends.detach())
    sewn = decoder.seams(edges, features, fixed)
    with torch.autocast(tokens.device.type, enabled=False):
        refined = _loop_losses(moved[None].of_queries(queries), true, shifts[None])
        parts |= {name: parts[name] + REFINED * part for name, part in refined.items()}
        parts |= _seam_losses(sewn, true, edges.exists)
    return {name: WEIGHTS[name] * part for name, part in parts.items()}


def panel_losses(
    layers: Predicted, true: PanelTargets
) -> tuple[dict[str, Tensor], Int[Tensor, "b p"], Int[Tensor, "b p"]]:
    """Mean losses of the layers, the query of each true panel, and the corner of its loop at which the query's starts.

    The last layer's match of queries and panels holds for all. Rows beyond the panels of a garment hold no meaning.
    """
    queries = match_panels(layers[-1], true)
    said = layers.of_queries(queries)
    shifts = _shifts(said.corners, true)
    count = len(layers.exists)
    slots, kinds = said.edges.shape[-1], said.labels.shape[-1]
    numbers, labels = (column.expand(count, -1, -1).flatten() for column in (true.edge_counts, true.labels))
    of_panels = {
        "extents": (said.extents.log() - true.extents.clamp(min=LEAST_EXTENT).log()).abs().mean(dim=-1),
        "centres": (said.centres - true.centres).abs().mean(dim=-1),
        # Of the columns as they are: rotations half a turn away from the truth would be a local minimum.
        "rotations": (said.axes - axes_of(true.rotations)).abs().mean(dim=-1),
        "edges": functional.cross_entropy(said.edges.reshape(-1, slots), numbers, reduction="none"),
        "labels": functional.cross_entropy(said.labels.reshape(-1, kinds), labels, reduction="none"),
    }
    existing = true.exists.expand(count, -1, -1)
    parts = {name: mean_of(values.view(existing.shape), existing) for name, values in of_panels.items()}
    parts["exists"] = _existence_loss(layers.exists, queries, true.exists)
    return {**parts, **_loop_losses(said, true, shifts)}, queries, shifts[-1]


def match_panels(predicted: Predicted, true: PanelTargets) -> Int[Tensor, "b p"]:
    """The query of each true panel, at least total cost (``least_cost``); 0 beyond the panels of a garment."""
    with torch.no_grad():
        likelihood = predicted.edges.log_softmax(dim=-1).clamp(min=-10.0)
        counts = true.edge_counts[:, None].expand(-1, likelihood.shape[1], -1)
        cost = (
            2.0 * squared_distances(predicted.centres, true.centres).sqrt()
            + 0.5 * squared_distances(predicted.axes, axes_of(true.rotations)).sqrt()
            + 1.0 * torch.cdist(predicted.extents.log(), true.extents.clamp(min=LEAST_EXTENT).log(), p=1.0)
            - 0.1 * likelihood.gather(2, counts)
            - predicted.exists.sigmoid()[..., None]
        )
        return least_cost(cost.transpose(1, 2), true.exists)


def _existence_loss(logits: Float[Tensor, "l b q"], queries: Int[Tensor, "b p"], exists: Bool[Tensor, "b p"]) -> Tensor:
    """Loss of the panels' existence, over the garments that fit into the network's sizes; the others have no panels."""
    chosen = torch.zeros_like(logits[0]).scatter_add(1, queries, exists.to(logits.dtype)).expand_as(logits)
    losses = functional.binary_cross_entropy_with_logits(logits, chosen, reduction="none")
    return mean_of(losses, exists.any(dim=1)[:, None].expand_as(losses))


def _shifts(corners: Float[Tensor, "l b p n 2"], true: PanelTargets) -> Int[Tensor, "l b p"]:
    """The corner of each true loop that, as its start, has the least mean square distance to the predicted loop."""
    with torch.no_grad():
        counts = true.edge_counts.clamp(min=1)[..., None]
        slot = torch.arange(true.corners.shape[2], device=counts.device)
        starts = slot[:, None].expand(*counts.shape[:2], -1, 1)[..., 0]
        rolled = _rolled(true.corners, starts.movedim(-1, 0), counts[..., 0])  # shift, garment, panel, slot
        rolled = torch.where((slot < counts)[..., None], rolled, 0.0).flatten(-2)
        # The distance is least where the product is largest: the squares do not depend on the shift.
        products = torch.einsum("lbpk,sbpk->lbps", corners.flatten(-2), rolled)
        return torch.where(slot < counts, products, -torch.inf).argmax(dim=-1)


def _rolled(
    values: Float[Tensor, "b p n *d"], shifts: Int[Tensor, "l b p"], counts: Int[Tensor, "b p"]
) -> Float[Tensor, "l b p n *d"]:
    """Values of loops that start at the corners ``shifts``."""
    slot = torch.arange(values.shape[2], device=values.device)
    turned = (slot + shifts[..., None]) % counts[..., None]
    garments, panels = (torch.arange(size, device=values.device) for size in values.shape[:2])
    return values[garments[:, None, None], panels[:, None], turned]


def _loop_losses(said: Predicted, true: PanelTargets, shifts: Int[Tensor, "l b p"]) -> dict[str, Tensor]:
    """Losses of corners and bends of the true panels' loops, which start at the corners ``shifts`` of the true ones.

    ``areas``: log(1 + d · perimeter / area), where d is the mean distance of corners and bends: for small d about the
    share of the area that differs, so that a centimetre counts more for a cuff than for a skirt.
    """
    counts = true.edge_counts.clamp(min=1)
    within = torch.arange(true.corners.shape[2], device=counts.device) < counts[..., None]
    corners = said.corners - _rolled(true.corners, shifts, counts)
    bends = said.bends - _rolled(true.bends, shifts, counts)
    distances = (corners.square().sum(dim=-1) + TINY).sqrt() + (bends.square().sum(dim=-1) + TINY).sqrt().mean(dim=-1)
    existing = true.exists.expand_as(shifts)
    values = {
        "corners": _mean_of_rows(corners.abs().mean(dim=-1), within),
        "bends": _mean_of_rows(bends.abs().mean(dim=(-2, -1)), within),
        "areas": torch.log1p(_mean_of_rows(distances, within) * true.slimness),
    }
    return {name: mean_of(value, existing) for name, value in values.items()}


def _mean_of_rows(values: Float[Tensor, "*m n"], within: Bool[Tensor, "*k n"]) -> Float[Tensor, " *m"]:
    return torch.where(within, values, 0.0).sum(dim=-1) / within.sum(dim=-1)


def _true_edges(true: PanelTargets, queries: Int[Tensor, "b p"], shifts: Int[Tensor, "b p"]) -> Edges:
    """The true edges, as slots of the queries that are matched to their panels."""
    panels = true.edge_panels.long().clamp(min=0)
    counts = true.edge_counts.gather(1, panels).clamp(min=1)
    slots = (true.edge_slots.long() - shifts.gather(1, panels)) % counts
    return Edges(queries.gather(1, panels), slots, (slots + 1) % counts, true.edge_panels >= 0)


def _seam_losses(sewn: Sewn, true: PanelTargets, exists: Bool[Tensor, "b e"]) -> dict[str, Tensor]:
    count = exists.shape[1]
    partners = true.partners.long()
    chosen = torch.where(partners < 0, count, partners)
    of_edges = {
        "partners": functional.cross_entropy(sewn.partners.flatten(0, 1), chosen.flatten(), reduction="none"),
        "kinds": functional.binary_cross_entropy_with_logits(
            sewn.kinds.flatten(), true.edge_kinds.float().flatten(), reduction="none"
        ),
        "edge_labels": functional.cross_entropy(
            sewn.labels.flatten(0, 1), true.edge_labels.long().flatten(), reduction="none"
        ),
    }
    is_sewn = exists & (partners >= 0)
    turned = sewn.turned.gather(2, partners.clamp(min=0)[..., None])[..., 0]
    of_seams = functional.binary_cross_entropy_with_logits(turned, true.turned.float(), reduction="none")
    means = {name: mean_of(values.view_as(exists), exists) for name, values in of_edges.items()}
    return {**means, "turned": mean_of(of_seams, is_sewn)}
