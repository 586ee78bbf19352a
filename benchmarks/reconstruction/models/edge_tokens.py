"""From surface points of a garment to its pattern, written edge by edge.

A garment is a sequence: for each panel one token that opens it, then one token for each edge of its loop; the last
edge closes the loop, and a token ends the pattern. The kind of a token is a class; corners, bends and placements are
regressed from the state of the token before, and fed back as numbers (AIpparel, Nakayama et al., CVPR 2025, without the
language model; DressCode, He et al., SIGGRAPH 2024, quantises them). The decoder is a causal transformer (Vaswani et
al., NeurIPS 2017) that attends to the tokens of the points, the encoder of ``panel_set``. The state of an edge points
to the earlier edge that it is sewn to, or to none (pointer networks, Vinyals et al., NeurIPS 2015).

Training reads whole sequences in one pass (teacher forcing), with noise on the numbers fed back, since answers feed
back their own errors. Answers are decoded greedily, all garments of a batch at once, with cached keys and values; kinds
that would leave a loop open, with less than three edges, or beyond the sizes of the network are masked. A seam joins
two edges, as in the targets: an edge that is sewn to several others is several edges there.

Nothing in a training step waits for the device: sizes do not depend on values there.
"""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor
from torch.nn import functional

from benchmarks.reconstruction.edge_decoder import EdgeDecoder, TokenConfig, decode
from benchmarks.reconstruction.edge_sequence import (
    CENTIMETRE,
    Sequence,
    ToCanonical,
    rows_of,
    sequence_of,
    tokens_of,
)
from benchmarks.reconstruction.learners import mean_of, sizes_from
from benchmarks.reconstruction.models.panel_set import SMALL as SMALL_PANEL_SET
from benchmarks.reconstruction.models.panel_set import TINY
from benchmarks.reconstruction.panel_answers import LEAST_EDGES
from benchmarks.reconstruction.panel_net import axes_of
from benchmarks.reconstruction.panel_targets import PanelTargets, ToTargets
from benchmarks.reconstruction.point_net import PointLearner
from gcd_dataset.errors import ConfigError

TASKS = ("T0", "T1", "T1-scan")
WEIGHTS = {
    "kinds": 1.0, "firsts": 5.0, "centres": 5.0, "rotations": 1.0, "corners": 5.0, "bends": 5.0, "areas": 0.5,
    "edge_labels": 0.2, "partners": 1.0, "turned": 0.2,
}  # fmt: skip
USUAL: Mapping[str, Any] = {"batch": 256, "lr": 5e-4}
"""Options of a training on a GPU."""
SMOKE: Mapping[str, Any] = {
    "steps": 300, "batch": 8, "lr": 2e-3, "weight_decay": 0.0, "ema": 0.9, "log_every": 10, "checks": 2,
}  # fmt: skip
"""Options of the smallest training, for two CPU cores."""
SMALL: Mapping[str, Any] = {
    **{name: SMALL_PANEL_SET[name] for name in ("queries", "slots", "edges", "points", "stored_points")},
    "tokens": 32, "region_width": 32, "width": 64, "heads": 4, "layers": 1, "decoder_layers": 2,
}  # fmt: skip
"""Sizes of its network."""


# ---------------------------------------------------------------------------------------------------------- the learner


class EdgeTokens(PointLearner):
    """Points and normals to a pattern, by a sequence of panels and edges."""

    def __init__(self, config: TokenConfig | None = None, *, points: int = 4096, stored_points: int = 8192) -> None:
        """See ``PointLearner``. Raises ``ConfigError`` for sizes without room for a triangle."""
        config = config or TokenConfig()
        super().__init__(config, points=points, stored_points=stored_points)
        if config.queries < 1 or min(config.slots, config.edges) < LEAST_EDGES:
            raise ConfigError(
                f"queries {config.queries}, slots {config.slots}, edges {config.edges}: give room for one panel of "
                f"{LEAST_EDGES} edges"
            )
        self.noise = 0.1 * CENTIMETRE * config.noise_mm
        self.decoder = EdgeDecoder(config)

    def encoder(self) -> ToTargets:
        config = self.config
        return ToCanonical(config.queries, config.slots, config.edges, self.stored_points)

    def compile_parts(self) -> None:
        for part in (self.tokens.features, *self.tokens.encoder.layers):
            part.compile()
        for layer in self.decoder.layers:
            layer.compile(dynamic=True)

    def loss(self, batch: PanelTargets) -> dict[str, Tensor]:
        return token_loss(self.decoder, self.tokens(batch.points), batch, noise=self.noise if self.training else 0.0)

    def decoded(self, tokens: Float[Tensor, "b m w"]) -> PanelTargets:
        return decode(self.decoder, tokens)


def build(config: Mapping[str, Any]) -> EdgeTokens:
    """The learner; ``config``: fields of ``TokenConfig``, ``points`` and ``stored_points``.

    Raises ``ConfigError`` for others.
    """
    own, least = ("points", "stored_points"), {"seen": 0, "noise_mm": 0}
    sizes, arguments = sizes_from("edge_tokens", TokenConfig, config, own=own, least=least, heads={"width": "heads"})
    return EdgeTokens(sizes, **arguments)


def _with_noise(true: PanelTargets, deviation: float) -> PanelTargets:
    """Targets with Gaussian noise on corners, bends and centres [UNIT], and twice as much on entries of rotations."""
    names = {"corners": 1.0, "bends": 0.5, "centres": 1.0, "rotations": 2.0}
    columns = {name: getattr(true, name) for name in names}
    return replace(true, **{k: v + names[k] * deviation * torch.randn_like(v) for k, v in columns.items()})


# ------------------------------------------------------------------------------------------------------------- the loss


def token_loss(
    decoder: EdgeDecoder, points: Float[Tensor, "b m w"], true: PanelTargets, *, noise: float = 0.0
) -> dict[str, Tensor]:
    """Weighted loss terms by name, for targets in canonical order; ``noise`` on the tokens fed back [UNIT]."""
    sequence = sequence_of(true)
    states = decoder(tokens_of(_with_noise(true, noise) if noise else true, sequence), points)
    with torch.autocast(points.device.type, enabled=False):
        parts = _kind_loss(decoder, states, sequence)
        parts |= _panel_losses(decoder, rows_of(states, sequence.at_panels - 1), true)
        parts |= _edge_losses(decoder, rows_of(states, sequence.at_edges - 1), true)
        parts |= _seam_losses(decoder, rows_of(states, sequence.at_edges), true)
    return {name: WEIGHTS[name] * part for name, part in parts.items()}


def _kind_loss(decoder: EdgeDecoder, states: Float[Tensor, "b t w"], sequence: Sequence) -> dict[str, Tensor]:
    logits = decoder.next_kind(states[:, :-1])
    losses = functional.cross_entropy(logits.flatten(0, 1), sequence.kinds[:, 1:].flatten(), reduction="none")
    known = sequence.known[:, 1:]
    return {"kinds": mean_of(losses.view_as(known), known)}


def _panel_losses(decoder: EdgeDecoder, before: Float[Tensor, "b q w"], true: PanelTargets) -> dict[str, Tensor]:
    """``before``: the states of the tokens before the panels."""
    corners, centres, axes = decoder.first_corner(before)
    misses = {
        "firsts": corners - true.corners[:, :, 0],
        "centres": centres - true.centres,
        "rotations": axes - axes_of(true.rotations),
    }
    return {name: mean_of(miss.abs().mean(dim=-1), true.exists) for name, miss in misses.items()}


def _edge_losses(decoder: EdgeDecoder, before: Float[Tensor, "b e w"], true: PanelTargets) -> dict[str, Tensor]:
    """``areas``: as in ``panel_set``, of each edge: a centimetre counts more for a cuff than for a skirt."""
    exists, panels, slot = true.edge_panels >= 0, true.edge_panels.long().clamp(min=0), true.edge_slots.long()
    following = (slot + 1) % true.edge_counts.gather(1, panels).clamp(min=1)
    row = panels * true.corners.shape[2]
    ends, bends = decoder.edge(before)
    ends = ends - rows_of(true.corners.flatten(1, 2), row + following)
    bends = bends - rows_of(true.bends.flatten(1, 2), row + slot)
    distances = (ends.square().sum(dim=-1) + TINY).sqrt() + (bends.square().sum(dim=-1) + TINY).sqrt().mean(dim=-1)
    losses = {
        "corners": ends.abs().mean(dim=-1),
        "bends": bends.abs().mean(dim=(-2, -1)),
        "areas": torch.log1p(distances * true.slimness.gather(1, panels)),
    }
    return {name: mean_of(values, exists) for name, values in losses.items()}


def _seam_losses(decoder: EdgeDecoder, edges: Float[Tensor, "b e w"], true: PanelTargets) -> dict[str, Tensor]:
    """``edges``: the states of the edges."""
    exists, partners = true.edge_panels >= 0, true.partners.long()
    count = exists.shape[1]
    earlier = (partners >= 0) & (partners < torch.arange(count, device=partners.device))
    chosen = torch.where(earlier, partners, count)
    turned = decoder.turned(edges, partners.clamp(min=0))
    losses = {
        "edge_labels": functional.cross_entropy(
            decoder.label(edges).flatten(0, 1), true.edge_labels.long().flatten(), reduction="none"
        ),
        "partners": functional.cross_entropy(decoder.partners(edges).flatten(0, 1), chosen.flatten(), reduction="none"),
    }
    of_seams = functional.binary_cross_entropy_with_logits(turned, true.turned.float(), reduction="none")
    means = {name: mean_of(values.view_as(exists), exists) for name, values in losses.items()}
    return {**means, "turned": mean_of(of_seams, earlier & exists)}
