"""A baseline after NeuralTailor (Korosteleva and Lee, Reconstructing Sewing Pattern Structures from 3D Point Clouds
with Garment Panels, ACM Transactions on Graphics 41(4), 2022), written from the paper and trained on our garments.

As published: EdgeConv features of the points (Wang et al., Dynamic Graph CNN, 2019) with skip connections; a fixed slot
for each name of a panel; each point is shared out among the slots by sparsemax attention, and a slot's encoding is the
weighted mean of its points' features; an LSTM draws the panel's edges as vectors and curvatures; rotations are
quaternions; losses are mean square errors of standardised edges, of the loop's gap, of rotations and translations; and
a second network classifies pairs of placed edges as sewn or not, after free edges are left out.

What differs, and why:

- 75 slots, the names that the generator draws, and loops of up to 40 edges: the paper's 12 garment types have 23 panel
  classes and 14 edges. Whether a slot is filled and whether a loop goes on are logits; the paper reads both from edges
  near zero, which here cannot be told from true edges of millimetres. Losses leave out empty slots and steps.
- An edge is a vector and ``BENDS`` points, and a logit for straight edges: the paper's has one control point, which
  cannot express cubics. Snapping to lines, arcs and cubics is that of ``panel_set``, as are untangling, the points
  given with normals, augmentation, optimiser and training time.
- The encoding of a slot is told which slot it is; the paper's decoder must infer it. A quaternion counts as its
  negative. The remaining gap of a loop is spread over its edges; the paper closes it at the last one. The position of
  a panel is that of its centroid. Labels of edges and panels are predicted, since drapes need them. All this helps.
- The second network learns together with the first, from the panels that it predicts, without gradients into them; the
  paper trains it afterwards. The 3-D stitch tags of the paper's first stage, which its second replaces, are left out.
"""

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from itertools import chain
from typing import Any, cast

import numpy as np
import torch
from jaxtyping import Bool, Float, Int
from scipy.spatial.transform import Rotation
from torch import Tensor, nn
from torch.nn import functional

from benchmarks.reconstruction.derived import PANEL_NAMES
from benchmarks.reconstruction.garments import GarmentSet
from benchmarks.reconstruction.learners import Examples, Learner, TensorExamples, squared_distances
from benchmarks.reconstruction.models.panel_set import LEAST_EDGES, best_pairs, edges_of, mean_of
from benchmarks.reconstruction.panel_net import NEVER, Edges, Predicted, edge_numbers
from benchmarks.reconstruction.panel_targets import BENDS, PanelTargets, ToTargets, patterns_from
from benchmarks.reconstruction.point_net import CHUNK, TOGETHER, DrawnPoints
from gcd_dataset.errors import ConfigError
from gcd_dataset.records import Pattern
from gcd_dataset.tensors import EDGE_LABELS, PANEL_LABELS
from gcd_dataset.workers import parallel_map

__all__ = [
    "SMOKE",
    "TASKS",
    "USUAL",
    "NamedPanels",
    "NeuralTailor",
    "TailorConfig",
    "ToNamedPanels",
    "build",
    "sparsemax",
]

TASKS = ("T0", "T1", "T1-scan")
EDGE_NUMBERS = 3 * 2 + 3 * 3 + 1 + 2  # of ``edge_numbers``
OF_PANELS = ("exists", "extents", "centres", "rotations", "edge_counts", "labels", "slimness", "names", "quaternions")
LEAST_DEVIATION = 1e-3  # UNIT
LEAST_AREA = 1e-5  # UNIT²; smaller panels are centred at the mean of their corners
RARE = -2.0  # first logit of what is rare: filled slots, sewn pairs
FINER = 4  # chords between two known points of an edge, for centroids
ROOM = 4  # panels, and edges of a loop: a batch has room for a multiple of this number
WEIGHTS = {
    "edges": 4.0, "bends": 1.0, "gaps": 1.0, "rotations": 4.0, "centres": 2.0, "exists": 0.5, "steps": 1.0,
    "kinds": 0.5, "free": 0.5, "labels": 0.2, "edge_labels": 0.2, "sewn": 1.0, "turned": 0.2,
}  # fmt: skip
"""Those of vectors and places are ours to choose, and favour the outlines; the square errors of rotations are the only
ones not standardised, and components of quaternions deviate by about 1/2."""
USUAL: Mapping[str, Any] = {"batch": 64, "lr": 1e-3}
"""Options of a training on a GPU."""
SMOKE: Mapping[str, Any] = {
    "steps": 250, "batch": 8, "lr": 4e-3, "weight_decay": 0.0, "ema": 0.9, "log_every": 10, "checks": 2,
}  # fmt: skip
SMALL: Mapping[str, Any] = {
    "panels": 12, "edges": 96, "loop": 24, "width": 64, "loop_width": 96, "loop_layers": 1, "pair_width": 64,
    "neighbours": 4, "points": 192, "stored_points": 1024,
}  # fmt: skip
"""Options of the smallest training, for two CPU cores, and the sizes of its network."""


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


# ---------------------------------------------------------------------------------------------------------- the targets


@dataclass(frozen=True)
class NamedPanels(PanelTargets):
    """Panels with the slots that their names give them."""

    names: Int[Tensor, "b q"]
    """Row of ``PANEL_NAMES``, i16; -1 for a panel of another name, which has no slot and teaches nothing."""
    quaternions: Float[Tensor, "b q 4"]
    """Of the rotations, scalar last."""


@dataclass(frozen=True)
class ToNamedPanels:
    """From garments to their ``NamedPanels``, on a CPU; the garments have the field ``panel_names``."""

    targets: ToTargets

    def __call__(self, garments: GarmentSet) -> NamedPanels:
        found = self.targets(garments)
        names = torch.full(found.exists.shape, -1, dtype=torch.int16)
        for k in range(len(garments)):
            if found.exists[k].any():
                rows = torch.from_numpy(garments.ragged["panel_names"][k])
                names[k, : len(rows)] = rows.to(names.dtype)
        turns = torch.eye(3).expand_as(found.rotations).clone()
        turns[found.exists] = found.rotations[found.exists]
        quaternions = Rotation.from_matrix(turns.reshape(-1, 3, 3).double().numpy()).as_quat().astype(np.float32)
        return NamedPanels(**vars(found), names=names, quaternions=torch.from_numpy(quaternions).view(*names.shape, 4))


@dataclass(frozen=True)
class DrawnPanels:
    """Batches with some of the stored points, without rows that are empty in all garments of a batch."""

    drawn: DrawnPoints
    panels: Int[Tensor, " g"] | None = None
    """Panels of each garment, on the CPU, if they do not change."""
    loops: Int[Tensor, " g"] | None = None
    """Edges of the longest loop of each garment."""

    def __len__(self) -> int:
        return len(self.drawn)

    def batch(self, rows: Int[Tensor, " b"], chance: torch.Generator | None = None) -> NamedPanels:
        found = cast(NamedPanels, self.drawn.batch(rows, chance))
        if self.panels is None or self.loops is None or not len(rows):
            return found
        panels, loop = (
            ROOM * math.ceil(max(1, int(counts[rows].max())) / ROOM) for counts in (self.panels, self.loops)
        )
        cut = {name: getattr(found, name)[:, :panels] for name in OF_PANELS}
        return replace(found, **cut, corners=found.corners[:, :panels, :loop], bends=found.bends[:, :panels, :loop])


# ---------------------------------------------------------------------------------------------------------- the learner


@dataclass(frozen=True)
class Drawn:
    """What the network says about panels and the edges of their loops; lengths in ``UNIT``."""

    edges: Float[Tensor, "b q n 2"]
    """Vectors from start to end."""
    bends: Float[Tensor, "b q n k 2"]
    steps: Float[Tensor, "b q n"]
    """Logits that the loop has this edge."""
    kinds: Float[Tensor, "b q n"]
    """Logits of a curve."""
    free: Float[Tensor, "b q n"]
    """Logits that the edge is not sewn."""
    edge_labels: Float[Tensor, "b q n l"]
    quaternions: Float[Tensor, "b q 4"]
    centres: Float[Tensor, "b q 3"]
    labels: Float[Tensor, "b q l"]


class NeuralTailor(Learner[NamedPanels, Pattern]):
    """Points and normals to a pattern."""

    edge_deviation: Tensor
    bend_deviation: Tensor
    centre_mean: Tensor
    centre_deviation: Tensor
    finer: Tensor

    def __init__(self, config: TailorConfig | None = None) -> None:
        super().__init__()
        self.config = config or TailorConfig()
        config = self.config
        self.points = PointFeatures(config)
        self.slots = SlotEncodings(config)
        self.loops = LoopDecoder(config)
        self.placement = _mlp(config.loop_width, config.loop_width, 4 + 3 + len(PANEL_LABELS))
        self.pairs = PairNet(config)
        self.register_buffer("edge_deviation", torch.zeros(2))
        self.register_buffer("bend_deviation", torch.ones(BENDS, 2))
        self.register_buffer("centre_mean", torch.zeros(3))
        self.register_buffer("centre_deviation", torch.ones(3))
        self.register_buffer("finer", torch.from_numpy(_finer()), persistent=False)

    def prepare(self, garments: GarmentSet, *, device: torch.device, workers: int = 0) -> DrawnPanels:
        """Targets of the garments. The first set prepared, the training set, gives means and deviations."""
        bare = replace(garments, points=garments.points[:, :0])
        parts = (bare.select(range(k, min(k + CHUNK, len(bare)))) for k in range(0, len(bare), CHUNK))
        targets = NamedPanels.join(list(parallel_map(self.encoder(), parts, workers)))
        if not self.edge_deviation.any():
            self._standardise(targets)
        edges, panels = (targets.edge_panels >= 0).sum(dim=1), targets.exists.sum(dim=1)
        loops = targets.edge_counts.amax(dim=1)
        whole = replace(targets, points=self.encoder().targets.scaled(garments.points)).to(device)
        return DrawnPanels(DrawnPoints(whole, self.config.points, edges), panels, loops)

    def drawn_from(self, encoded: TensorExamples) -> DrawnPanels:
        return DrawnPanels(DrawnPoints(cast(NamedPanels, encoded), self.config.points))

    def encoder(self) -> ToNamedPanels:
        config = self.config
        return ToNamedPanels(ToTargets(config.panels, config.loop, config.edges, config.stored_points))

    def compile_parts(self) -> None:
        for part in (*self.points.layers, self.pairs):
            part.compile()

    def _standardise(self, targets: NamedPanels) -> None:
        within = torch.arange(targets.corners.shape[2]) < targets.edge_counts[..., None]
        if not within.any():
            return
        for buffer, values in (
            (self.edge_deviation, _edges_of_loops(targets)[within]),
            (self.bend_deviation, targets.bends[within]),
            (self.centre_deviation, targets.centres[targets.exists]),
        ):
            buffer.copy_(values.std(dim=0, correction=0).clamp(min=LEAST_DEVIATION))
        self.centre_mean.copy_(targets.centres[targets.exists].mean(dim=0))

    # ------------------------------------------------------------------------------------------------------- the loss

    def loss(self, batch: NamedPanels) -> dict[str, Tensor]:
        encodings, exists = self.slots(self.points(batch.points))
        known = batch.exists & (batch.names >= 0)
        names = batch.names.long().clamp(min=0)
        drawn = self._drawn(encodings, names, batch.corners.shape[2])
        with torch.autocast(batch.points.device.type, enabled=False):
            parts = {"exists": _existence_loss(exists.float(), names, known, batch.exists)}
            parts |= self._panel_losses(drawn, batch, known)
            # Without gradients: the paper trains its second stage for the first one's panels, and not through them.
            edges = _true_edges(batch)
            numbers = edge_numbers(edges, _placed(_detached(drawn), batch.edge_counts, self.finer))
        sewn, turned = self.pairs(numbers)
        with torch.autocast(batch.points.device.type, enabled=False):
            parts |= _pair_losses(sewn.float(), turned.float(), batch, edges.exists)
        return {name: WEIGHTS[name] * part for name, part in parts.items()}

    def _panel_losses(self, drawn: Drawn, true: NamedPanels, known: Bool[Tensor, "b q"]) -> dict[str, Tensor]:
        slot = torch.arange(true.corners.shape[2], device=known.device)
        within = known[..., None] & (slot < true.edge_counts[..., None])
        going_on = (slot < true.edge_counts[..., None]).float()
        edges = (drawn.edges - _edges_of_loops(true)) / self.edge_deviation
        bends = (drawn.bends - true.bends) / self.bend_deviation
        gaps = torch.where(within[..., None], drawn.edges, 0.0).sum(dim=2) / self.edge_deviation
        centres = (drawn.centres - true.centres) / self.centre_deviation
        turns = [(drawn.quaternions - sign * true.quaternions).square().mean(dim=-1) for sign in (1.0, -1.0)]
        kinds, free, labels = (
            _in_loops(values, true) for values in (true.edge_kinds, true.partners < 0, true.edge_labels)
        )
        binary = functional.binary_cross_entropy_with_logits
        return {
            "edges": mean_of(edges.square().mean(dim=-1), within),
            "bends": mean_of(bends.square().mean(dim=(-2, -1)), within),
            "gaps": mean_of(gaps.square().mean(dim=-1), known),
            "rotations": mean_of(torch.minimum(*turns), known),
            "centres": mean_of(centres.square().mean(dim=-1), known),
            "labels": mean_of(_cross_entropy(drawn.labels, true.labels), known),
            "steps": mean_of(binary(drawn.steps, going_on, reduction="none").mean(dim=-1), known),
            "kinds": mean_of(binary(drawn.kinds, kinds.float(), reduction="none"), within),
            "free": mean_of(binary(drawn.free, free.float(), reduction="none"), within),
            "edge_labels": mean_of(_cross_entropy(drawn.edge_labels, labels), within),
        }

    def _drawn(self, encodings: Float[Tensor, "b s w"], names: Int[Tensor, "b q"], steps: int) -> Drawn:
        """The panels of some slots, with loops of ``steps`` edges."""
        # A product, whose gradient is faster than that of an index.
        panels = functional.one_hot(names, len(PANEL_NAMES)).to(encodings.dtype) @ encodings
        loops, placed = self.loops(panels, steps), self.placement(panels)
        with torch.autocast(panels.device.type, enabled=False):
            loops, placed = loops.float(), placed.float()
            edges, bends, logits, labels = loops.split([2, 2 * BENDS, 3, len(EDGE_LABELS)], dim=-1)
            quaternions, centres, of_panels = placed.split([4, 3, len(PANEL_LABELS)], dim=-1)
            steps_, kinds, free = logits.unbind(dim=-1)
            return Drawn(
                edges=edges * self.edge_deviation,
                bends=bends.unflatten(-1, (BENDS, 2)) * self.bend_deviation,
                steps=steps_,
                kinds=kinds,
                free=free,
                edge_labels=labels,
                quaternions=quaternions,
                centres=centres * self.centre_deviation + self.centre_mean,
                labels=of_panels,
            )

    # ---------------------------------------------------------------------------------------------------- the answers

    def predict(self, batch: NamedPanels) -> list[Pattern]:
        return patterns_from(self._said(batch))

    def answers(
        self, examples: Examples[NamedPanels], count: int, *, batch: int, workers: int = 0
    ) -> Iterator[Pattern]:
        rows = torch.split(torch.arange(count), batch)
        said = PanelTargets.join([self._said(examples.batch(part)).to(torch.device("cpu")) for part in rows])
        parts = (said[k : k + TOGETHER] for k in range(0, count, TOGETHER))
        return chain.from_iterable(parallel_map(patterns_from, parts, workers))

    @torch.no_grad()
    def _said(self, batch: NamedPanels) -> PanelTargets:
        """The panels of the slots that are likely filled, at least one."""
        encodings, logits = self.slots(self.points(batch.points[:, : self.config.points]))
        exists, names = logits.float().topk(min(self.config.panels, len(PANEL_NAMES)), dim=1)
        exists = (exists > 0) | (torch.arange(exists.shape[1], device=exists.device) == 0)
        drawn = self._drawn(encodings, names, self.config.loop)
        counts = _counts(drawn.steps)
        edges = edges_of(exists, counts, self.config.edges)
        placed = _placed(drawn, counts, self.finer)
        sewn, turned = (values.float() for values in self.pairs(edge_numbers(edges, placed)))
        free = edges.of(drawn.free, edges.slots) > 0
        partners = best_pairs(sewn, edges.exists & ~free)
        mutual = partners.clamp(min=0)[..., None]
        labels = edges.of(drawn.edge_labels, edges.slots)
        # Of both edges: sewn edges with different labels are a fault.
        other = labels.gather(1, mutual.expand_as(labels))
        labels = labels + torch.where((partners >= 0)[..., None], other, 0.0)
        return PanelTargets(
            points=batch.points.new_zeros(len(exists), 0, 6),
            exists=exists,
            corners=placed.corners,
            bends=placed.bends,
            extents=placed.extents,
            centres=placed.centres,
            rotations=placed.rotations,
            edge_counts=counts,
            labels=drawn.labels.argmax(dim=-1),
            slimness=torch.zeros_like(exists, dtype=torch.float32),
            edge_panels=torch.where(edges.exists, edges.queries, -1),
            edge_slots=edges.slots,
            edge_kinds=(edges.of(drawn.kinds, edges.slots) > 0).long(),
            edge_labels=labels.argmax(dim=-1),
            partners=partners,
            turned=turned.gather(2, mutual)[..., 0] > 0,
        )


def build(*, smoke: bool, options: Mapping[str, Any]) -> NeuralTailor:
    """The learner; ``options``: fields of ``TailorConfig``."""
    given = {**(SMALL if smoke else {}), **options}
    unknown = set(given) - set(TailorConfig.__dataclass_fields__)
    if unknown:
        known = ", ".join(TailorConfig.__dataclass_fields__)
        raise ConfigError(f"no size {min(unknown)} of a neural_tailor network: choose of {known}")
    return NeuralTailor(TailorConfig(**given))


# ---------------------------------------------------------------------------------------------------------- the network


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
        count, near = features.shape[1], _nearest(places, self.neighbours)
        rows = near + count * torch.arange(len(features), device=features.device)[:, None, None]
        others = self.other(features).flatten(0, 1).index_select(0, rows.flatten())
        found: Tensor = self.mlp(self.own(features)[:, :, None] + others.view(*near.shape, -1))
        return found.amax(dim=2)


@torch.no_grad()
def _nearest(places: Float[Tensor, "b n d"], count: int) -> Int[Tensor, "b n k"]:
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
        self.whole = _mlp(2 * given, config.loop_width, config.loop_width)
        self.scores = nn.Sequential(nn.Linear(given, config.loop_width), nn.ReLU(), nn.Linear(config.loop_width, slots))
        self.context = nn.Linear(config.loop_width, config.loop_width)
        self.encode = nn.Linear(given + 1 + config.loop_width, config.loop_width)
        self.name = nn.Parameter(0.1 * torch.randn(slots, config.loop_width)) if config.named else None
        self.norm = nn.LayerNorm(config.loop_width)
        self.exists = _mlp(config.loop_width, config.loop_width, 1)
        nn.init.constant_(cast(nn.Linear, self.exists[-1]).bias, RARE)

    def forward(self, features: Float[Tensor, "b n f"]) -> tuple[Float[Tensor, "b s w"], Float[Tensor, "b s"]]:
        whole = self.whole(torch.cat([features.mean(dim=1), features.amax(dim=1)], dim=-1))
        first, *rest = self.scores
        hidden = first(features) + self.context(whole)[:, None]
        for layer in rest:
            hidden = layer(hidden)
        with torch.autocast(features.device.type, enabled=False):
            shares = sparsemax(hidden.float())
            mass = shares.sum(dim=1)[..., None]
            pooled = shares.transpose(1, 2) @ features.float() / mass.clamp(min=1e-6)
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


def _mlp(given: int, width: int, said: int) -> nn.Sequential:
    return nn.Sequential(nn.Linear(given, width), nn.ReLU(), nn.Linear(width, said))


# ------------------------------------------------------------------------------------------------------ loops and seams


def _edges_of_loops(true: PanelTargets) -> Float[Tensor, "b q n 2"]:
    """Vectors of the edges, from corner to corner."""
    slot = torch.arange(true.corners.shape[2], device=true.corners.device)
    following = (slot + 1) % true.edge_counts.clamp(min=1)[..., None]
    return true.corners.gather(2, following[..., None].expand_as(true.corners)) - true.corners


def _in_loops(values: Tensor, true: PanelTargets) -> Int[Tensor, "b q n"]:
    """Values of the table of edges at their panels and slots."""
    batch, panels, slots = true.corners.shape[:3]
    at = torch.where(true.edge_panels < 0, panels * slots, true.edge_panels.long() * slots + true.edge_slots.long())
    grid = torch.zeros(batch, panels * slots + 1, dtype=torch.long, device=at.device)
    return grid.scatter(1, at, values.long())[:, :-1].view(batch, panels, slots)


def _cross_entropy(logits: Float[Tensor, "*b l"], rows: Int[Tensor, "*b"]) -> Float[Tensor, "*b"]:
    flat = functional.cross_entropy(logits.flatten(0, -2), rows.flatten(), reduction="none")
    return flat.view(rows.shape)


def _existence_loss(
    logits: Float[Tensor, "b s"], names: Int[Tensor, "b q"], known: Bool[Tensor, "b q"], exists: Bool[Tensor, "b q"]
) -> Tensor:
    """Of garments with panels; one beyond the network's sizes has none, and teaches nothing."""
    filled = torch.zeros_like(logits).scatter_add(1, names, known.to(logits.dtype))
    losses = functional.binary_cross_entropy_with_logits(logits, filled, reduction="none")
    return mean_of(losses.sum(dim=1), exists.any(dim=1))


def _pair_losses(
    sewn: Float[Tensor, "b e e"], turned: Float[Tensor, "b e e"], true: PanelTargets, exists: Bool[Tensor, "b e"]
) -> dict[str, Tensor]:
    """Losses of each edge, summed over its pairs: few of them are sewn."""
    partners = true.partners.long()
    is_sewn = exists & (partners >= 0)
    truth = torch.zeros_like(sewn).scatter_add(2, partners.clamp(min=0)[..., None], is_sewn[..., None].to(sewn.dtype))
    binary = functional.binary_cross_entropy_with_logits
    losses = torch.where(exists[:, None, :], binary(sewn, truth, reduction="none"), 0.0).sum(dim=-1)
    of_seams = turned.gather(2, partners.clamp(min=0)[..., None])[..., 0]
    turns = binary(of_seams, true.turned.float(), reduction="none")
    return {"sewn": mean_of(losses, exists), "turned": mean_of(turns, is_sewn)}


def _true_edges(true: PanelTargets) -> Edges:
    panels = true.edge_panels.long().clamp(min=0)
    counts = true.edge_counts.gather(1, panels).clamp(min=1)
    slots = true.edge_slots.long()
    return Edges(panels, slots, (slots + 1) % counts, true.edge_panels >= 0)


def _detached(drawn: Drawn) -> Drawn:
    return Drawn(**{name: value.detach() for name, value in vars(drawn).items()})


def _counts(steps: Float[Tensor, "b q n"]) -> Int[Tensor, "b q"]:
    """The likeliest number of edges of each loop, at least ``LEAST_EDGES``."""
    going, ending = functional.logsigmoid(steps), functional.logsigmoid(-steps)
    before = functional.pad(going.cumsum(dim=-1), (1, 0))
    after = functional.pad(ending.flip(-1).cumsum(dim=-1).flip(-1), (0, 1))
    return LEAST_EDGES + (before + after)[..., LEAST_EDGES:].argmax(dim=-1)


def _placed(drawn: Drawn, counts: Int[Tensor, "b q"], finer: Float[Tensor, "m n"]) -> Predicted:
    """Closed loops of ``counts`` edges round the centroids of their areas, placed; ``finer``: as ``_finer``."""
    slot = torch.arange(drawn.edges.shape[2], device=counts.device)
    within = slot < counts[..., None]
    edges = torch.where(within[..., None], drawn.edges, 0.0)
    bends = torch.where(within[..., None, None], drawn.bends, 0.0)
    edges = torch.where(
        within[..., None], edges - edges.sum(dim=2, keepdim=True) / counts.clamp(min=1)[..., None, None], 0.0
    )
    corners = edges.cumsum(dim=2) - edges
    corners = corners - _centroids(corners, edges, bends, counts, finer)[:, :, None]
    x, y, z, w = functional.normalize(drawn.quaternions, dim=-1).unbind(dim=-1)
    first = torch.stack([1 - 2 * (y * y + z * z), 2 * (x * y + z * w), 2 * (x * z - y * w)], dim=-1)
    second = torch.stack([2 * (x * y - z * w), 1 - 2 * (x * x + z * z), 2 * (y * z + x * w)], dim=-1)
    return Predicted(
        exists=drawn.steps[..., 0],
        corners=corners,
        bends=bends,
        extents=torch.ones_like(drawn.centres[..., :2]),
        centres=drawn.centres,
        axes=torch.cat([first, second], dim=-1),
        edges=drawn.steps,
        labels=drawn.labels,
    )


def _finer() -> Float[np.ndarray, "m n"]:
    """Weights of an edge's ``BENDS + 2`` points in ``FINER`` times as many, at equal shares, without the last."""
    degrees = np.arange(BENDS + 2)
    coarse, fine = (np.arange(count) / (BENDS + 1) for count in (BENDS + 2, BENDS + 1))
    fine = (fine[:, None] + np.arange(FINER) / (FINER * (BENDS + 1))).ravel()
    return np.asarray(fine[:, None] ** degrees @ np.linalg.inv(coarse[:, None] ** degrees), np.float32)


def _centroids(
    corners: Float[Tensor, "b q n 2"],
    edges: Float[Tensor, "b q n 2"],
    bends: Float[Tensor, "b q n k 2"],
    counts: Int[Tensor, "b q"],
    finer: Float[Tensor, "m n"],
) -> Float[Tensor, "b q 2"]:
    """Centroids of the areas within loops (shoelace formula); of nearly no area, the mean of the corners.

    Edges are polynomials through their points: a polygon would miss 2 mm of a circle skirt's centroid.
    """
    share = torch.arange(BENDS + 2, device=corners.device)[:, None] / (BENDS + 1)
    known = corners[..., None, :] + share * edges[..., None, :] + functional.pad(bends, (0, 0, 1, 1))
    path = (finer @ known).flatten(2, 3)
    following = path.roll(-1, dims=2)
    cross = path[..., 0] * following[..., 1] - path[..., 1] * following[..., 0]
    area = cross.sum(dim=-1, keepdim=True) / 2
    centroid = ((path + following) * cross[..., None]).sum(dim=2) / torch.where(area.abs() > LEAST_AREA, 6 * area, 1.0)
    slot = torch.arange(corners.shape[2], device=corners.device)
    mean = torch.where((slot < counts[..., None])[..., None], corners, 0.0).sum(dim=2) / counts.clamp(min=1)[..., None]
    return torch.where(area.abs() > LEAST_AREA, centroid, mean)
