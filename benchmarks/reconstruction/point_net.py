"""From surface points of a garment to tokens, and the base of the networks that read them.

A balanced tree divides the points into regions of equal numbers, and each region becomes a token (Point-MAE, Pang et
al., ECCV 2022; Kd-Networks, Klokov and Lempitsky, ICCV 2017). A training step sees some of the regions.
"""

import math
from abc import abstractmethod
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import cast

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor, nn
from torch.nn import functional

from benchmarks.reconstruction.garments import GarmentSet
from benchmarks.reconstruction.learners import Examples, Learner, TensorExamples, encoded_by
from benchmarks.reconstruction.panel_targets import PanelTargets, ToTargets, patterns_by, patterns_from, scaled_points
from gcd_dataset.errors import ConfigError
from gcd_dataset.records import Pattern

FREQUENCIES = 8  # octaves of the positional encoding
REGION_SCALE = 10.0  # scales offsets within a region to about 1
OF_EDGES = ("edge_panels", "edge_slots", "edge_kinds", "edge_labels", "partners", "turned")
ROOM = 32  # edges: a batch has room for a multiple of this number


@dataclass(frozen=True, slots=True)
class EncoderConfig:
    """Sizes of the point encoder."""

    tokens: int = 256
    """Regions of the points; a power of 2."""
    seen: int = 128
    """Regions of a garment in a training step, others in each step; 0: all, as in an answer."""
    region_width: int = 128
    """Features of a point."""
    width: int = 384
    heads: int = 6
    layers: int = 6
    """Layers of the encoder; of a ``PanelDecoder``, too."""


@dataclass(frozen=True, slots=True)
class PointConfig(EncoderConfig):
    """Sizes of the point encoder and of answers that are sets of panels."""

    queries: int = 40
    """Most panels of a garment."""
    slots: int = 40
    """Most edges of a panel."""
    edges: int = 320
    """Most edges of a garment."""


class PointLearner(Learner[PanelTargets, Pattern]):
    """Base of networks from points and normals to a pattern."""

    def __init__(self, config: PointConfig, *, points: int = 4096, stored_points: int = 8192) -> None:
        """``points``: points of a garment in a step, drawn from the first ``stored_points``.

        Raises ``ConfigError`` unless the number of tokens is a power of 2, at most either number of points.
        """
        super().__init__()
        self.config = config
        require_tokens(config, points, stored_points)
        self.points, self.stored_points = points, stored_points
        self.tokens = PointTokens(config)

    def prepare(self, garments: GarmentSet, *, device: torch.device, workers: int = 0) -> "DrawnPoints":
        """Targets of the garments. Raises ``ConfigError`` for garments of fewer points than tokens."""
        require_tokens(self.config, self.points, garments.points.shape[1])
        targets = encoded_by(self.encoder(), garments.without_points(), workers)
        edges = (targets.edge_panels >= 0).sum(dim=1)
        points = scaled_points(garments.points[:, : self.stored_points], device)
        whole = replace(targets.to(device), points=points)
        return DrawnPoints(whole, self.points, edges)

    def drawn_from(self, encoded: TensorExamples) -> "DrawnPoints":
        return DrawnPoints(cast(PanelTargets, encoded), self.points)

    def encoder(self) -> ToTargets:
        config = self.config
        return ToTargets(config.queries, config.slots, config.edges, self.stored_points)

    def predict(self, batch: PanelTargets) -> list[Pattern]:
        return patterns_from(self._predicted(batch))

    def answers(
        self, examples: Examples[PanelTargets], count: int, *, batch: int, workers: int = 0
    ) -> Iterator[Pattern]:
        return patterns_by(self._predicted, examples, count, batch=batch, workers=workers)

    def _predicted(self, batch: PanelTargets) -> PanelTargets:
        with torch.no_grad():
            return self.decoded(self.tokens(batch.points))

    @abstractmethod
    def decoded(self, tokens: Float[Tensor, "b t w"]) -> PanelTargets:
        """The predictions in the form of the targets, from the tokens of the points."""


def require_tokens(config: EncoderConfig, points: int, stored_points: int) -> None:
    """Raise ``ConfigError`` unless the number of tokens is a power of 2, at most either number of points."""
    least = min(points, stored_points)
    if not 1 <= config.tokens <= least or config.tokens & (config.tokens - 1):
        raise ConfigError(f"{config.tokens} tokens of {least} points: give a power of 2, at most the points")


@dataclass(frozen=True)
class DrawnPoints:
    """Targets whose batches have some of the stored points, others in each step."""

    whole: PanelTargets
    points: int
    edges: Int[Tensor, " g"] | None = None
    """Edges of each garment, on the CPU, if they do not change: batches then leave out rows that are empty in all."""

    def __len__(self) -> int:
        return len(self.whole)

    def batch(self, rows: Int[Tensor, " b"], chance: torch.Generator | None = None) -> PanelTargets:
        found = self.whole.batch(rows)
        if self.edges is not None and len(rows):
            room = ROOM * math.ceil(max(1, int(self.edges[rows].max())) / ROOM)
            found = replace(found, **{name: getattr(found, name)[:, :room] for name in OF_EDGES})
        if chance is None:
            return replace(found, points=found.points[:, : self.points])
        return found.with_points(self.points, chance)


# ---------------------------------------------------------------------------------------------------------- the network


class PointTokens(nn.Module):
    """Points and normals to tokens of regions, related to each other."""

    def __init__(self, config: EncoderConfig) -> None:
        super().__init__()
        self.config = config
        width = config.width
        self.features = RegionFeatures(config.region_width, width)
        self.position = nn.Linear(6 * FREQUENCIES + 6, width)
        self.merge = nn.Sequential(nn.GELU(), nn.Linear(width, width))
        self.encoder = encoder(config)

    def forward(self, points: Float[Tensor, "b n 6"]) -> Float[Tensor, "b t w"]:
        """Tokens of the regions."""
        return self.with_regions(points)[0]

    def with_regions(self, points: Float[Tensor, "b n k"]) -> tuple[Float[Tensor, "b t w"], Float[Tensor, "b t m k"]]:
        """Tokens of the regions, and their points; columns of ``points`` beyond the sixth have no effect on tokens."""
        with torch.autocast(points.device.type, enabled=False), torch.no_grad():
            regions = regions_of(points.float(), self.config.tokens)
            if self.training and self.config.seen:
                regions = some_of(regions, self.config.seen)
            middles = regions.mean(dim=2)
            offsets = (regions[..., :3] - middles[:, :, None, :3]) * REGION_SCALE
            inputs = torch.cat([offsets, regions[..., 3:6]], dim=-1)
            places = torch.cat([waves(middles[..., :3]), middles[..., :6]], dim=-1)
        tokens: Tensor = self.encoder(self.merge(self.features(inputs) + self.position(places)).float())
        return tokens, regions


class RegionFeatures(nn.Module):
    """A feature vector of the points in each region."""

    def __init__(self, inner: int, width: int) -> None:
        """``inner``: features of a point."""
        super().__init__()
        self.point = nn.Sequential(nn.Linear(6, inner), nn.GELU(), nn.Linear(inner, inner))
        self.own, self.shared = nn.Linear(inner, 2 * inner), nn.Linear(inner, 2 * inner, bias=False)
        self.region = nn.Sequential(nn.GELU(), nn.Linear(2 * inner, 2 * inner))
        self.form = nn.Linear(2 * inner, width)

    def forward(self, points: Float[Tensor, "b t m 6"]) -> Float[Tensor, "b t w"]:
        features = self.point(points)
        features = self.own(features) + self.shared(features.amax(dim=2))[:, :, None]
        found: Tensor = self.form(self.region(features).amax(dim=2))
        return found


def regions_of(points: Float[Tensor, "b n k"], count: int) -> Float[Tensor, "b t m k"]:
    """The points in ``count`` regions of equal numbers; some points are left out unless ``count`` divides their number.

    Each region is halved at the median of its longest side until there are enough; ``count`` is a power of 2.
    """
    batch, total = len(points), points.shape[1] // count * count
    places = points[:, :total, :3]
    order = torch.arange(total, device=points.device).expand(batch, -1)
    parts = 1
    while parts < count:
        places, order = places.reshape(batch * parts, -1, 3), order.reshape(batch * parts, -1)
        side = (places.amax(dim=1) - places.amin(dim=1)).argmax(dim=1)
        along = places.gather(2, side[:, None, None].expand(-1, places.shape[1], 1))[..., 0]
        rank = along.argsort(dim=1)
        places, order = places.gather(1, rank[..., None].expand(-1, -1, 3)), order.gather(1, rank)
        parts *= 2
    order = order.reshape(batch, total, 1).expand(-1, -1, points.shape[2])
    return points.gather(1, order).view(batch, count, -1, points.shape[2])


def some_of(regions: Float[Tensor, "b t *m"], count: int) -> Float[Tensor, "b c *m"]:
    """``count`` regions of each garment, drawn from torch's generator of the device; all if there are not as many.

    Half of the regions cost half of the time, and few garments are not learned by heart as easily (PatchDropout, Liu et
    al., WACV 2023).
    """
    rows = torch.rand(regions.shape[:2], device=regions.device).argsort(dim=1)[:, :count]
    rows = rows.view(*rows.shape, *(1 for _ in regions.shape[2:]))
    return regions.gather(1, rows.expand(-1, -1, *regions.shape[2:]))


def encoder(config: EncoderConfig) -> nn.TransformerEncoder:
    """Attention among the tokens of an input."""
    layer = EncoderLayer(config.width, config.heads, 4 * config.width)
    return nn.TransformerEncoder(layer, config.layers, nn.LayerNorm(config.width), enable_nested_tensor=False)


def waves(numbers: Float[Tensor, "*b n"]) -> Float[Tensor, "*b m"]:
    """Sines and cosines of numbers in ``FREQUENCIES`` octaves."""
    octaves = numbers[..., None] * 2.0 ** torch.arange(FREQUENCIES, device=numbers.device)
    return torch.cat([octaves.sin(), octaves.cos()], dim=-1).flatten(-2)


# ------------------------------------------------------------------------------------------------------------ attention


def hiding(hidden: Bool[Tensor, "b t"]) -> Float[Tensor, "b t"]:
    """The mask of tokens that others do not attend to: -inf for these, else 0."""
    return torch.zeros_like(hidden, dtype=torch.float32).masked_fill(hidden, -torch.inf)


class EncoderLayer(nn.TransformerEncoderLayer):
    """``nn.TransformerEncoderLayer``, batch and norm first."""

    def __init__(self, width: int, heads: int, inner: int) -> None:
        """``inner``: features between the two linear maps."""
        super().__init__(width, heads, inner, dropout=0.0, activation="gelu", batch_first=True, norm_first=True)

    def forward(
        self,
        src: Float[Tensor, "b t w"],
        src_mask: Tensor | None = None,
        src_key_padding_mask: Tensor | None = None,
        is_causal: bool = False,
    ) -> Float[Tensor, "b t w"]:
        """``src_key_padding_mask``: as ``hiding`` returns it; ``src_mask`` and ``is_causal`` have no effect."""
        src = src + _among(self.self_attn, self.norm1(src), src_key_padding_mask)
        return src + self.linear2(functional.gelu(self.linear1(self.norm2(src))))


class DecoderLayer(nn.TransformerDecoderLayer):
    """``nn.TransformerDecoderLayer``, batch and norm first."""

    def __init__(self, width: int, heads: int, inner: int) -> None:
        """``inner``: features between the two linear maps."""
        super().__init__(width, heads, inner, dropout=0.0, activation="gelu", batch_first=True, norm_first=True)

    def forward(  # type: ignore[override]
        self,
        tgt: Float[Tensor, "b q w"],
        memory: Float[Tensor, "b t w"],
        tgt_key_padding_mask: Float[Tensor, "b q"] | None = None,
    ) -> Float[Tensor, "b q w"]:
        """``tgt_key_padding_mask``: as ``hiding`` returns it."""
        tgt = tgt + _among(self.self_attn, self.norm1(tgt), tgt_key_padding_mask)
        tgt = tgt + _across(self.multihead_attn, self.norm2(tgt), memory)
        return tgt + self.linear2(functional.gelu(self.linear1(self.norm3(tgt))))


def _among(
    attention: nn.MultiheadAttention, tokens: Float[Tensor, "b t w"], hidden: Float[Tensor, "b t"] | None
) -> Float[Tensor, "b t w"]:
    """Attention of tokens to each other."""
    query, key, value = _heads(attention, tokens, attention.in_proj_weight, attention.in_proj_bias)
    return _attended(attention, query, key, value, hidden)


def _across(
    attention: nn.MultiheadAttention, tokens: Float[Tensor, "b q w"], others: Float[Tensor, "b t w"]
) -> Float[Tensor, "b q w"]:
    """Attention of tokens to others."""
    sizes = [tokens.shape[-1], 2 * tokens.shape[-1]]
    weights = torch.split_with_sizes(attention.in_proj_weight, sizes)
    biases = torch.split_with_sizes(attention.in_proj_bias, sizes)
    (query,) = _heads(attention, tokens, weights[0], biases[0])
    key, value = _heads(attention, others, weights[1], biases[1])
    return _attended(attention, query, key, value, None)


def _heads(
    attention: nn.MultiheadAttention, tokens: Float[Tensor, "b t w"], weight: Tensor, bias: Tensor
) -> tuple[Float[Tensor, "b h t d"], ...]:
    """Views of one product: its parts, such as queries or keys, by head."""
    width = tokens.shape[-1]
    parts = functional.linear(tokens, weight, bias)
    shape = (len(weight) // width, attention.num_heads, width // attention.num_heads)
    return parts.view(*parts.shape[:2], *shape).permute(2, 0, 3, 1, 4).unbind(0)


def _attended(
    attention: nn.MultiheadAttention,
    query: Float[Tensor, "b h q d"],
    key: Float[Tensor, "b h t d"],
    value: Float[Tensor, "b h t d"],
    hidden: Float[Tensor, "b t"] | None,
) -> Float[Tensor, "b q w"]:
    mask = None if hidden is None else hidden.to(query.dtype)[:, None, None].expand(-1, -1, query.shape[2], -1)
    seen = functional.scaled_dot_product_attention(query, key, value, attn_mask=mask)
    return attention.out_proj(seen.transpose(1, 2).flatten(2))
