"""The network of stitches: edges of all panels, and the seams known so far, to scores of pairs."""

import math
from dataclasses import dataclass

import torch
from jaxtyping import Float, Int
from torch import Tensor, nn
from torch.nn import functional

from benchmarks.reconstruction.stitching.edge_shapes import EdgeInputs, feature_counts
from benchmarks.reconstruction.stitching.graphs import CUT_BINS, EdgeBatch
from gcd_dataset.errors import ConfigError

NEVER = -1e4  # logit of an impossible pair; finite, since rows of padding have no possible pair
RARE = -8.0  # logit of a cut at first: one bin in some thousands has one
MOST_FOREIGN = 0.25  # largest share of the fourth variant, which takes the place of the third


@dataclass(frozen=True, slots=True)
class StitchConfig:
    """Sizes and parts of a ``StitchNet``."""

    width: int = 256
    heads: int = 8
    layers: int = 8
    pair_width: int = 48
    rounds: int = 24
    """Most rounds of a prediction; 1 predicts all seams at once, and trains without given seams."""
    confident: float = 0.7
    """Probability of the seams that are fixed together in a round."""
    foreign: float = 0.0
    """Share of the training garments that are subdivided as another source might, at most 0.25."""

    def __post_init__(self) -> None:
        if not 0.0 <= self.foreign <= MOST_FOREIGN:
            raise ConfigError(f"foreign is {self.foreign}: give a share between 0 and {MOST_FOREIGN}")

    @property
    def variety(self) -> int:
        """Variants of a training garment."""
        return 4 if self.foreign else 3


@dataclass(frozen=True)
class StitchLogits:
    """Logits of a round."""

    pairs: Float[Tensor, "b e e"]
    """Symmetric."""
    free: Float[Tensor, "b e"]
    right_wrong: Float[Tensor, "b e e"]
    cuts: Float[Tensor, "b e bins"]
    """Logits: does a bin of the edge contain a point of subdivision?"""
    cut_offsets: Float[Tensor, "b e bins"]
    """Position within the bin, in [0, 1]."""

    def log_probabilities(self) -> Float[Tensor, "b e e+1"]:
        """Log-probability of each partner of each edge; the last column: no partner."""
        return torch.cat([self.pairs.float(), self.free.float()[..., None]], dim=-1).log_softmax(dim=-1)


class StitchNet(nn.Module):
    """Edges, and the seams known so far, to ``StitchLogits``."""

    def __init__(self, config: StitchConfig) -> None:
        super().__init__()
        self.config, width = config, config.width
        n_features, n_relations = feature_counts()
        self.enter = _mlp(n_features, width, width)
        self.sewn = nn.Embedding(2, width)
        self.blocks = nn.ModuleList(_Block(width, config.heads) for _ in range(config.layers))
        self.relate = nn.Sequential(*_mlp(n_relations, config.pair_width, config.pair_width), nn.GELU())
        self.bias = nn.Linear(config.pair_width, config.heads * config.layers)
        self.norm = nn.LayerNorm(width)
        self.key = nn.Linear(width, 128)
        self.free = nn.Linear(width, 1)
        self.cut = _mlp(width, width, 2 * CUT_BINS)
        nn.init.constant_(self.cut[2].bias[:CUT_BINS], RARE)  # type: ignore[index]
        self.side = nn.Linear(width, config.pair_width)
        self.judge = _mlp(config.pair_width, config.pair_width, 2)

    def forward(self, batch: EdgeBatch, known: Int[Tensor, "b e"]) -> StitchLogits:
        """``known``: partners of the edges that are already sewn, -1 for the others."""
        return self.scores(self.inputs(batch), known)

    def inputs(self, batch: EdgeBatch) -> EdgeInputs:
        """The network's inputs that do not depend on the known seams."""
        return EdgeInputs.of(batch)

    def scores(self, seen: EdgeInputs, known: Int[Tensor, "b e"]) -> StitchLogits:
        """The scores of a batch, given its ``inputs``."""
        config, valid = self.config, seen.valid
        # A lookup in a table of two rows; its gradient needs no sort.
        edges = self.enter(seen.edges) + torch.where((known >= 0)[..., None], *self.sewn.weight.flip(0))
        related = self.relate(seen.relations(known))
        biases = self.bias(related).unflatten(-1, (config.layers, config.heads)).permute(3, 0, 4, 1, 2)
        biases = (biases + torch.where(valid, 0.0, NEVER)[None, :, None, None, :].to(biases)).contiguous()
        for block, bias in zip(self.blocks, biases, strict=True):
            edges = block(edges, bias)
        return self._scores(self.norm(edges), related, valid, known)

    def _scores(self, edges: Tensor, related: Tensor, valid: Tensor, known: Tensor) -> StitchLogits:
        with torch.autocast(edges.device.type, enabled=False):  # bfloat16 would round logits to steps of 0.1
            keys = self.key(edges.float())
            pairs = keys @ keys.transpose(1, 2) / math.sqrt(keys.shape[-1])
        sides = self.side(edges)
        judged = self.judge(functional.gelu(sides[:, :, None] + sides[:, None] + related))
        judged = judged + judged.transpose(1, 2)
        pairs, wrong = pairs + judged[..., 0], judged[..., 1]
        possible = valid & (known < 0)
        itself = torch.eye(pairs.shape[1], dtype=torch.bool, device=pairs.device)
        allowed = possible[:, :, None] & possible[:, None] & ~itself
        cuts, offsets = self.cut(edges).chunk(2, dim=-1)
        return StitchLogits(
            pairs=torch.where(allowed, pairs.float(), NEVER),
            free=self.free(edges)[..., 0].float(),
            right_wrong=wrong.float(),
            cuts=cuts.float(),
            cut_offsets=offsets.float().sigmoid(),
        )


class _Block(nn.Module):
    """A transformer layer with an attention bias for each pair."""

    def __init__(self, width: int, heads: int) -> None:
        super().__init__()
        self.heads = heads
        self.norms = nn.ModuleList([nn.LayerNorm(width), nn.LayerNorm(width)])
        self.project = nn.Linear(width, 3 * width)
        self.merge = nn.Linear(width, width)
        self.feed = _mlp(width, 4 * width, width)

    def forward(self, edges: Tensor, bias: Tensor) -> Tensor:
        parts = self.project(self.norms[0](edges)).unflatten(-1, (3, self.heads, -1)).permute(2, 0, 3, 1, 4)
        query, key, value = parts.unbind(0)
        seen = functional.scaled_dot_product_attention(query, key, value, attn_mask=bias.to(query.dtype))
        edges = edges + self.merge(seen.transpose(1, 2).flatten(2))
        return edges + self.feed(self.norms[1](edges))


def _mlp(inputs: int, hidden: int, outputs: int) -> nn.Sequential:
    return nn.Sequential(nn.Linear(inputs, hidden), nn.GELU(), nn.Linear(hidden, outputs))
