"""The network of ``models/neural_tailor``: features of points, encodings of slots, loops of edges, pairs of edges."""

from dataclasses import dataclass
from typing import cast

import torch
from jaxtyping import Float, Int
from torch import Tensor, nn

from benchmarks.reconstruction.derived import PANEL_NAMES
from benchmarks.reconstruction.learners import squared_distances
from benchmarks.reconstruction.panel_net import NEVER
from benchmarks.reconstruction.panel_targets import BENDS
from gcd_dataset.tensors import EDGE_LABELS

EDGE_NUMBERS = 3 * 2 + 3 * 3 + 1 + 2  # of ``edge_numbers``
RARE = -2.0  # first logit of what is rare: filled slots, sewn pairs


@dataclass(frozen=True, slots=True)
class TailorConfig:
    """Sizes of a network."""

    panels: int = 40
    """Most panels of a garment."""
    loop: int = 40
    """Most edges of a panel."""
    edges: int = 320
    """Most edges of a garment."""
    neighbours: int = 8
    """Points that each point is compared with."""
    width: int = 128
    """Features of a point after each EdgeConv."""
    loop_width: int = 256
    """Encoding of a panel, and state of the LSTM."""
    loop_layers: int = 3
    pair_width: int = 128
    """Hidden features of a pair of edges."""
    points: int = 4096
    """Points of a garment in a step."""
    stored_points: int = 8192
    """Points that they are drawn from."""
    named: int = 1
    """1: the encoding of a slot is told which slot it is; 0: as in the paper."""


class PointFeatures(nn.Module):
    """Two EdgeConv layers; the features of a point are its numbers and the outputs of both."""

    def __init__(self, config: TailorConfig) -> None:
        super().__init__()
        self.layers = nn.ModuleList(EdgeConv(given, config) for given in (6, config.width))

    def forward(self, points: Float[Tensor, "b n 6"]) -> Float[Tensor, "b n f"]:
        first, second = self.layers
        with torch.autocast(points.device.type, enabled=False):
            points = points.float()
            near = first(points, points[..., :3])
        far = second(near, near)
        return torch.cat([points.to(far.dtype), near.to(far.dtype), far], dim=-1)


class EdgeConv(nn.Module):
    """The largest of the features of each point beside its nearest ones: max over j of MLP(x_i, x_j - x_i)."""

    def __init__(self, given: int, config: TailorConfig) -> None:
        super().__init__()
        self.neighbours = config.neighbours
        # The MLP's first layer, W (x_i, x_j - x_i), is the sum of a linear layer of x_i and one of x_j.
        self.own, self.other = nn.Linear(given, config.width), nn.Linear(given, config.width, bias=False)
        self.mlp = nn.Sequential(nn.ReLU(), nn.Linear(config.width, config.width), nn.ReLU())

    def forward(self, features: Float[Tensor, "b n f"], places: Float[Tensor, "b n d"]) -> Float[Tensor, "b n w"]:
        """``places``: numbers in which the nearest points are looked for."""
        count, near = features.shape[1], nearest(places, self.neighbours)
        rows = near + count * torch.arange(len(features), device=features.device)[:, None, None]
        others = self.other(features).flatten(0, 1).index_select(0, rows.flatten())
        found: Tensor = self.mlp(self.own(features)[:, :, None] + others.view(*near.shape, -1))
        return found.amax(dim=2)


@torch.no_grad()
def nearest(places: Float[Tensor, "b n d"], count: int) -> Int[Tensor, "b n k"]:
    """The nearest points of each point, itself among them."""
    with torch.autocast(places.device.type, enabled=False):
        places = places.float()
        if places.shape[-1] <= 3:
            distances = squared_distances(places, places)
        else:
            distances = torch.cdist(places, places, compute_mode="use_mm_for_euclid_dist")
        return distances.topk(min(count, places.shape[1]), largest=False, sorted=False).indices


class SlotEncodings(nn.Module):
    """The points shared out among the slots: an encoding of each, and the logit that it is filled."""

    def __init__(self, config: TailorConfig) -> None:
        super().__init__()
        given, slots = 6 + 2 * config.width, len(PANEL_NAMES)
        self.whole = mlp(2 * given, config.loop_width, config.loop_width)
        self.scores = nn.Sequential(nn.Linear(given, config.loop_width), nn.ReLU(), nn.Linear(config.loop_width, slots))
        self.context = nn.Linear(config.loop_width, config.loop_width)
        self.encode = nn.Linear(given + 1 + config.loop_width, config.loop_width)
        self.name = nn.Parameter(0.1 * torch.randn(slots, config.loop_width)) if config.named else None
        self.norm = nn.LayerNorm(config.loop_width)
        self.exists = mlp(config.loop_width, config.loop_width, 1)
        nn.init.constant_(cast(nn.Linear, self.exists[-1]).bias, RARE)

    def forward(self, features: Float[Tensor, "b n f"]) -> tuple[Float[Tensor, "b s w"], Float[Tensor, "b s"]]:
        whole = self.whole(torch.cat([features.mean(dim=1), features.amax(dim=1)], dim=-1))
        first, *rest = self.scores
        hidden = first(features) + self.context(whole)[:, None]
        for layer in rest:
            hidden = layer(hidden)
        with torch.autocast(features.device.type, enabled=False):
            shares = sparsemax(hidden.float())
            # Of less than one point a mean and a root would have gradients without bound.
            mass = shares.sum(dim=1)[..., None].clamp(min=1.0)
            pooled = shares.transpose(1, 2) @ features.float() / mass
            pooled = torch.cat([pooled, (mass / features.shape[1]).sqrt()], dim=-1)
        context = whole[:, None].expand(-1, pooled.shape[1], -1)
        encodings = self.encode(torch.cat([pooled.to(context.dtype), context], dim=-1))
        if self.name is not None:
            encodings = encodings + self.name
        encodings = self.norm(encodings)
        return encodings, self.exists(encodings)[..., 0]


def sparsemax(scores: Float[Tensor, "*b n"]) -> Float[Tensor, "*b n"]:
    """The nearest probabilities to the scores, most of them 0 (Martins and Astudillo, From Softmax to Sparsemax, 2016).

    >>> sparsemax(torch.tensor([2.0, 1.5, 0.0])).tolist()
    [0.75, 0.25, 0.0]
    """
    falling = scores.sort(dim=-1, descending=True).values
    rank = torch.arange(1, scores.shape[-1] + 1, device=scores.device, dtype=scores.dtype)
    sums = falling.cumsum(dim=-1) - 1
    support = (rank * falling > sums).sum(dim=-1, keepdim=True)
    threshold = sums.gather(-1, support - 1) / support
    return (scores - threshold).clamp(min=0)


class LoopDecoder(nn.Module):
    """An LSTM that is given the encoding of a panel at each step, and says an edge."""

    def __init__(self, config: TailorConfig) -> None:
        super().__init__()
        width = config.loop_width
        self.lstm = nn.LSTM(width, width, config.loop_layers, batch_first=True)
        self.head = nn.Linear(width, 2 + 2 * BENDS + 3 + len(EDGE_LABELS))

    def forward(self, panels: Float[Tensor, "b q w"], steps: int) -> Float[Tensor, "b q n o"]:
        repeated = panels.flatten(0, 1)[:, None].expand(-1, steps, -1)
        with torch.autocast(panels.device.type, enabled=False):  # cuDNN would compute in float16, without scaled losses
            states, _ = self.lstm(repeated.float())
        found: Tensor = self.head(states)
        return found.view(*panels.shape[:2], steps, -1)


class PairNet(nn.Module):
    """The paper's second stage: from two edges as placed, the logit that they are sewn, and of ``Seam.right_wrong``."""

    def __init__(self, config: TailorConfig) -> None:
        super().__init__()
        width = config.pair_width
        self.one, self.other = nn.Linear(EDGE_NUMBERS, width), nn.Linear(EDGE_NUMBERS, width, bias=False)
        self.mlp = nn.Sequential(nn.ReLU(), nn.Linear(width, width), nn.ReLU(), nn.Linear(width, 2))
        nn.init.constant_(cast(nn.Linear, self.mlp[-1]).bias[:1], RARE)

    def forward(self, edges: Float[Tensor, "b e n"]) -> tuple[Float[Tensor, "b e e"], Float[Tensor, "b e e"]]:
        """Logits of all pairs; an edge is never its own partner."""
        with torch.autocast(edges.device.type, enabled=False):  # bfloat16 would round positions to half a centimetre
            first = self.one(edges.float())[:, :, None] + self.other(edges.float())[:, None]
        pairs = self.mlp(first).float()
        sewn, turned = (pairs + pairs.transpose(1, 2)).unbind(dim=-1)
        own = torch.eye(edges.shape[1], dtype=torch.bool, device=edges.device)
        return sewn.masked_fill(own, NEVER), turned


def mlp(given: int, width: int, said: int) -> nn.Sequential:
    return nn.Sequential(nn.Linear(given, width), nn.ReLU(), nn.Linear(width, said))
