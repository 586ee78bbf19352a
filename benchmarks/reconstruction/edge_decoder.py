"""The decoder of ``edge_tokens``: a causal transformer that writes a pattern edge by edge, and its greedy answers."""

import math
from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor, nn
from torch.nn import functional

from benchmarks.reconstruction.edge_sequence import (
    CLOSING_CURVE,
    CLOSING_LINE,
    CURVE,
    EDGE_KINDS,
    END,
    KINDS,
    LINE,
    START,
    Tokens,
    rows_of,
)
from benchmarks.reconstruction.panel_answers import LEAST_EDGES, best_pairs, common_labels
from benchmarks.reconstruction.panel_net import NEVER, axes_of, rotation_of
from benchmarks.reconstruction.panel_targets import BENDS, PanelTargets
from benchmarks.reconstruction.point_net import FREQUENCIES, PointConfig, waves
from gcd_dataset.tensors import EDGE_LABELS, PANEL_LABELS

NUMBERS = 3 * 2 + 3 * 3 + 1 + 3 + 6  # that describe a token
ENDED_EVERY = 16  # tokens between checks whether all garments of a batch have ended


@dataclass(frozen=True, slots=True)
class TokenConfig(PointConfig):
    """Sizes of ``EdgeTokens``."""

    decoder_layers: int = 8
    noise_mm: int = 5
    """Standard deviation of the noise on corners and centres that are fed back in training [mm]."""


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
        """Mask of the garments with a complete pattern."""

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
