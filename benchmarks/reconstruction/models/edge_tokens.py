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

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor, nn
from torch.nn import functional

from benchmarks.reconstruction.edge_sequence import (
    CENTIMETRE,
    CLOSING_CURVE,
    CLOSING_LINE,
    CURVE,
    EDGE_KINDS,
    END,
    KINDS,
    LINE,
    START,
    Sequence,
    ToCanonical,
    Tokens,
    rows_of,
    sequence_of,
    tokens_of,
)
from benchmarks.reconstruction.learners import mean_of, sizes_from
from benchmarks.reconstruction.models.panel_set import LEAST_EDGES, TINY, best_pairs, common_labels
from benchmarks.reconstruction.models.panel_set import SMALL as SMALL_PANEL_SET
from benchmarks.reconstruction.panel_net import NEVER, axes_of, rotation_of
from benchmarks.reconstruction.panel_targets import BENDS, PanelTargets, ToTargets
from benchmarks.reconstruction.point_net import FREQUENCIES, PointConfig, PointLearner, waves
from gcd_dataset.errors import ConfigError
from gcd_dataset.tensors import EDGE_LABELS, PANEL_LABELS

TASKS = ("T0", "T1", "T1-scan")
NUMBERS = 3 * 2 + 3 * 3 + 1 + 3 + 6  # that describe a token
ENDED_EVERY = 16  # tokens between checks whether all garments of a batch have ended
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


@dataclass(frozen=True, slots=True)
class TokenConfig(PointConfig):
    """Sizes of ``EdgeTokens``."""

    decoder_layers: int = 8
    noise_mm: int = 5
    """Standard deviation of the noise on corners and centres that are fed back in training [mm]."""


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


# ---------------------------------------------------------------------------------------------------------- the network


class EdgeDecoder(nn.Module):
    """Sequences of panels and edges, given tokens of points."""

    def __init__(self, config: TokenConfig) -> None:
        super().__init__()
        self.config = config
        width = config.width
        self.kind = nn.Embedding(KINDS + 1, width)
        self.panel, self.slot = nn.Embedding(config.queries, width), nn.Embedding(config.slots + 1, width)
        self.numbers = nn.Sequential(
            nn.Linear(NUMBERS * (2 * FREQUENCIES + 1), 2 * width), nn.GELU(), nn.Linear(2 * width, width)
        )
        self.layers = nn.ModuleList(Block(width, config.heads) for _ in range(config.decoder_layers))
        self.norm = nn.LayerNorm(width)
        self.next_kind, self.next_panel, self.next_edge = (
            nn.Sequential(nn.Linear(width, width), nn.GELU(), nn.Linear(width, size))
            for size in (KINDS, 2 + 3 + 6, 2 * (1 + BENDS))
        )
        self.queries, self.keys, self.no_partner = nn.Linear(width, width), nn.Linear(width, width), nn.Linear(width, 1)
        self.meeting, self.label = nn.Linear(width, width), nn.Linear(width, len(EDGE_LABELS))

    def forward(self, tokens: Tokens, points: Float[Tensor, "b m w"]) -> Float[Tensor, "b t w"]:
        """The states of tokens, each computed from itself and those before it."""
        features = self._features(tokens)
        for layer in self.layers:
            features = layer(features, points)
        return self._state(features)

    def step(self, token: Tokens, caches: "list[Cache]", at: int) -> Float[Tensor, "b w"]:
        """The state of one token per garment at position ``at``; the caches hold those before it."""
        features = self._features(token)
        for layer, cache in zip(self.layers, caches, strict=True):
            assert isinstance(layer, Block)
            features = layer.step(features, cache, at)
        return self._state(features)[:, 0]

    def caches(self, points: Float[Tensor, "b m w"]) -> "list[Cache]":
        """Empty caches for the longest sequence."""
        length = 1 + self.config.queries + self.config.edges
        return [layer.cache(points, length) for layer in self.layers if isinstance(layer, Block)]

    def first_corner(self, state: Float[Tensor, "*b w"]) -> tuple[Tensor, Tensor, Tensor]:
        """First corner, centre and axes of the next panel [UNIT]."""
        corner, centre, axes = self.next_panel(state).split([2, 3, 6], dim=-1)
        return corner, centre, axes

    def edge(self, state: Float[Tensor, "*b w"]) -> tuple[Float[Tensor, "*b 2"], Float[Tensor, "*b k 2"]]:
        """End and bends of the next edge [UNIT]."""
        found = self.next_edge(state).unflatten(-1, (1 + BENDS, 2))
        return found[..., 0, :], found[..., 1:, :]

    def partners(self, edges: Float[Tensor, "b e w"]) -> Float[Tensor, "b e f"]:
        """Logits of the earlier edge that each edge is sewn to; the last column stands for none."""
        scores = self.queries(edges) @ self.keys(edges).transpose(1, 2) / math.sqrt(edges.shape[-1])
        earlier = torch.ones(scores.shape[1:], dtype=torch.bool, device=scores.device).tril(-1)
        return torch.cat([scores.masked_fill(~earlier, NEVER), self.no_partner(edges)], dim=-1)

    def turned(self, edges: Float[Tensor, "b e w"], partners: Int[Tensor, "b e"]) -> Float[Tensor, "b e"]:
        """Logits of ``Seam.right_wrong`` of the seams of edges and their partners."""
        others = rows_of(edges, partners)
        return ((self.meeting(edges) * others).sum(dim=-1) + (self.meeting(others) * edges).sum(dim=-1)) / math.sqrt(
            edges.shape[-1]
        )

    def _features(self, tokens: Tokens) -> Float[Tensor, "b t w"]:
        # In float32: bfloat16 would round places before the waves of high frequency are taken.
        with torch.autocast(tokens.start.device.type, enabled=False):
            known = _numbers_of(tokens)
            known = torch.cat([waves(known), known], dim=-1)
        found: Tensor = self.numbers(known)
        return found + self.kind(tokens.kinds) + self.panel(tokens.panels) + self.slot(tokens.slots)

    def _state(self, features: Float[Tensor, "b t w"]) -> Float[Tensor, "b t w"]:
        with torch.autocast(features.device.type, enabled=False):
            found: Tensor = self.norm(features.float())
        return found


def _numbers_of(tokens: Tokens) -> Float[Tensor, "b t n"]:
    """Start, middle and end in the panel and in space, the length of the edge, centre and axes of the panel."""
    share = torch.arange(1, BENDS + 1, device=tokens.start.device)[:, None] / (BENDS + 1)
    start, end = tokens.start[..., None, :], tokens.end[..., None, :]
    path = torch.cat([start, (1 - share) * start + share * end + tokens.bends, end], dim=-2)
    length = path.diff(dim=-2).norm(dim=-1).sum(dim=-1, keepdim=True)
    shown = path[..., :: (BENDS + 1) // 2, :]
    placed = shown @ rotation_of(tokens.axes)[..., :2].transpose(-1, -2) + tokens.centres[..., None, :]
    return torch.cat([shown.flatten(-2), placed.flatten(-2), length, tokens.centres, tokens.axes], dim=-1)


@dataclass(frozen=True)
class Cache:
    """Keys and values of a layer: of the tokens so far, filled in place, and of the points."""

    keys: Float[Tensor, "b h t d"]
    values: Float[Tensor, "b h t d"]
    point_keys: Float[Tensor, "b h m d"]
    point_values: Float[Tensor, "b h m d"]


class Block(nn.Module):
    """A layer: causal attention among tokens, attention to points, and a network for each token; pre-norm."""

    def __init__(self, width: int, heads: int) -> None:
        super().__init__()
        self.heads = heads
        self.norms = nn.ModuleList(nn.LayerNorm(width) for _ in range(3))
        self.own, self.own_out = nn.Linear(width, 3 * width), nn.Linear(width, width)
        self.query, self.points, self.points_out = (nn.Linear(width, n * width) for n in (1, 2, 1))
        self.mlp = nn.Sequential(nn.Linear(width, 4 * width), nn.GELU(), nn.Linear(4 * width, width))

    def forward(self, features: Float[Tensor, "b t w"], points: Float[Tensor, "b m w"]) -> Float[Tensor, "b t w"]:
        """All tokens at once."""
        query, key, value = self._split(self.own(self.norms[0](features)), 3)
        attended = functional.scaled_dot_product_attention(query, key, value, is_causal=True)
        return self._rest(features, attended, *self._split(self.points(points), 2))

    def step(self, features: Float[Tensor, "b 1 w"], cache: Cache, at: int) -> Float[Tensor, "b 1 w"]:
        """One token of each garment, at position ``at``."""
        query, cache.keys[:, :, at : at + 1], cache.values[:, :, at : at + 1] = self._split(
            self.own(self.norms[0](features)), 3
        )
        known = cache.keys[:, :, : at + 1], cache.values[:, :, : at + 1]
        attended = functional.scaled_dot_product_attention(query, *known)
        return self._rest(features, attended, cache.point_keys, cache.point_values)

    def cache(self, points: Float[Tensor, "b m w"], length: int) -> Cache:
        """An empty cache for ``length`` tokens."""
        keys, values = self._split(self.points(points), 2)
        shape = (*keys.shape[:2], length, keys.shape[-1])
        return Cache(keys.new_zeros(shape), keys.new_zeros(shape), keys, values)

    def _rest(self, features: Tensor, attended: Tensor, keys: Tensor, values: Tensor) -> Tensor:
        features = features + self.own_out(_merged(attended))
        (query,) = self._split(self.query(self.norms[1](features)), 1)
        features = features + self.points_out(_merged(functional.scaled_dot_product_attention(query, keys, values)))
        moved: Tensor = features + self.mlp(self.norms[2](features))
        return moved

    def _split(self, values: Float[Tensor, "b t w"], parts: int) -> tuple[Tensor, ...]:
        """Parts of the features, each as heads × tokens × features of a head."""
        return values.view(*values.shape[:2], parts, self.heads, -1).permute(2, 0, 3, 1, 4).unbind()


def _merged(heads: Float[Tensor, "b h t d"]) -> Float[Tensor, "b t w"]:
    return heads.transpose(1, 2).flatten(2)


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


# ---------------------------------------------------------------------------------------------------------- the answers


def decode(decoder: EdgeDecoder, points: Float[Tensor, "b m w"]) -> PanelTargets:
    """The likeliest next token, one after the other, in the form of the targets: closed loops, at least one panel."""
    draft = _Draft(decoder.config, points)
    caches = decoder.caches(points)
    token = draft.start()
    for at in range(1 + decoder.config.queries + decoder.config.edges):
        state = decoder.step(token, caches, at)
        draft.keep(state)
        logits = decoder.next_kind(state).masked_fill(~draft.allowed(), -torch.inf)
        token = draft.add(logits.argmax(dim=-1), *decoder.first_corner(state), *decoder.edge(state))
        if at % ENDED_EVERY == 0 and bool(draft.ended.all()):
            break
    return draft.sewn(decoder)


class _Draft:
    """Patterns that grow by a token at a time. Tables have one row more than the answer, for what does not exist."""

    def __init__(self, config: TokenConfig, points: Float[Tensor, "b m w"]) -> None:
        self.config = config
        batch, device = len(points), points.device
        queries, slots, edges = config.queries + 1, config.slots, config.edges + 1
        self._garments = torch.arange(batch, device=device)
        self._points = points.new_zeros(batch, 0, 6)
        self._corners, self._bends = (points.new_zeros(batch, queries, slots, *d, 2) for d in ((), (BENDS,)))
        self._centres, self._axes = points.new_zeros(batch, queries, 3), points.new_zeros(batch, queries, 6)
        self._labels = torch.zeros(batch, queries, dtype=torch.long, device=device)
        self._counts = torch.zeros_like(self._labels)
        self._edge_panels = torch.full((batch, edges), -1, device=device)
        self._edge_slots, self._edge_kinds = (torch.zeros_like(self._edge_panels) for _ in range(2))
        self._states = points.new_zeros(batch, edges, points.shape[-1])
        self._first, self._end = (points.new_zeros(batch, 2) for _ in range(2))
        self._panels, self._edges, self._slots = (torch.zeros_like(self._garments) for _ in range(3))
        self._open = torch.zeros(batch, dtype=torch.bool, device=device)
        self._is_edge = self._open
        self.ended = self._open
        """Garments whose pattern is complete."""

    def start(self) -> Tokens:
        """The token that begins every sequence."""
        zeros = torch.zeros_like(self._garments)[:, None]
        numbers = [self._points.new_zeros(len(zeros), 1, *shape) for shape in ((2,), (BENDS, 2), (2,), (3,), (6,))]
        return Tokens(zeros + START, zeros, zeros, *numbers)

    def keep(self, state: Float[Tensor, "b w"]) -> None:
        """Keep the state of the last token if it is an edge."""
        row = torch.where(self._is_edge, self._edges - 1, self.config.edges)
        self._states[self._garments, row] = state

    def allowed(self) -> Bool[Tensor, "b k"]:
        """Kinds of the next token after which the pattern can still become complete within the sizes."""
        config = self.config
        has_room = (self._panels < config.queries) & (self._edges + LEAST_EDGES <= config.edges)
        begin = ~self._open & has_room
        go_on = self._open & (self._slots < config.slots - 1) & (self._edges < config.edges - 1)
        close = self._open & (self._slots >= LEAST_EDGES - 1)
        end = ~self._open & (self._panels > 0)
        kinds = [begin] * len(PANEL_LABELS) + [go_on] * EDGE_KINDS + [close] * EDGE_KINDS + [end]
        return torch.stack(kinds, dim=-1)

    def add(
        self,
        kinds: Int[Tensor, " b"],
        corner: Float[Tensor, "b 2"],
        centre: Float[Tensor, "b 3"],
        axes: Float[Tensor, "b 6"],
        end: Float[Tensor, "b 2"],
        bends: Float[Tensor, "b k 2"],
    ) -> Tokens:
        """Add a token to each pattern that has not ended; the tokens."""
        kinds = torch.where(self.ended, END, kinds)
        self.ended = kinds == END
        is_panel, is_edge = kinds < LINE, (kinds >= LINE) & (kinds < END)
        closing, curved = is_edge & (kinds >= CLOSING_LINE), (kinds == CURVE) | (kinds == CLOSING_CURVE)
        self._panels = self._panels + is_panel
        panel = (self._panels - 1).clamp(min=0)
        garments, none = self._garments, self.config.queries

        self._first = torch.where(is_panel[:, None], corner, self._first)
        start = torch.where(is_panel[:, None], corner, self._end)
        finish = torch.where((is_panel | closing)[:, None], self._first, end)
        bends = torch.where(curved[:, None, None], bends, 0.0)
        slot = torch.where(is_edge, self._slots, 0)

        new = torch.where(is_panel, panel, none)
        self._labels[garments, new], self._centres[garments, new] = kinds, centre
        self._axes[garments, new] = axes_of(rotation_of(axes))
        drawn = torch.where(is_edge, panel, none)
        self._corners[garments, drawn, slot], self._bends[garments, drawn, slot] = start, bends
        self._counts[garments, drawn] = slot + 1
        row = torch.where(is_edge, self._edges, self.config.edges)
        self._edge_panels[garments, row], self._edge_slots[garments, row] = panel, slot
        self._edge_kinds[garments, row] = curved.long()

        self._edges, self._is_edge = self._edges + is_edge, is_edge
        self._slots = torch.where(is_edge, slot + 1, 0)
        self._open = ~self.ended & ~closing
        self._end = finish
        there = (~self.ended)[:, None]
        columns = (
            kinds,
            torch.where(self.ended, 0, panel),
            self._slots,
            start * there,
            bends * there[..., None],
            finish * there,
            self._centres[garments, panel] * there,
            self._axes[garments, panel] * there,
        )
        return Tokens(*(column[:, None] for column in columns))

    def sewn(self, decoder: EdgeDecoder) -> PanelTargets:
        """The finished patterns with seams and labels of edges."""
        states = self._states[:, :-1]
        queries = torch.arange(self.config.queries, device=states.device)
        exists = torch.arange(self.config.edges, device=states.device) < self._edges[:, None]
        log = decoder.partners(states).log_softmax(dim=-1)
        partners = best_pairs((log[..., :-1] - log[..., -1:]).transpose(1, 2), exists)
        return PanelTargets(
            points=self._points,
            exists=queries < self._panels[:, None],
            corners=self._corners[:, :-1],
            bends=self._bends[:, :-1],
            extents=torch.zeros_like(self._centres[:, :-1, :2]),
            centres=self._centres[:, :-1],
            rotations=rotation_of(self._axes[:, :-1]),
            edge_counts=self._counts[:, :-1],
            labels=self._labels[:, :-1],
            slimness=torch.zeros_like(self._centres[:, :-1, 0]),
            edge_panels=torch.where(exists, self._edge_panels[:, :-1], -1),
            edge_slots=self._edge_slots[:, :-1],
            edge_kinds=self._edge_kinds[:, :-1],
            edge_labels=common_labels(decoder.label(states), partners),
            partners=partners,
            turned=decoder.turned(states, partners.clamp(min=0)) > 0,
        )
