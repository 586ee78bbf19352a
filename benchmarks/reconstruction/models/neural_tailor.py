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
from torch import Tensor
from torch.nn import functional

from benchmarks.reconstruction.derived import PANEL_NAMES
from benchmarks.reconstruction.garments import GarmentSet
from benchmarks.reconstruction.learners import Examples, Learner, TensorExamples, mean_of
from benchmarks.reconstruction.models.panel_set import LEAST_EDGES, best_pairs, edges_of
from benchmarks.reconstruction.panel_net import Edges, Predicted, edge_numbers
from benchmarks.reconstruction.panel_targets import BENDS, PanelTargets, ToTargets, patterns_from, scaled_points
from benchmarks.reconstruction.point_net import CHUNK, TOGETHER, DrawnPoints
from benchmarks.reconstruction.sizes import sizes_from
from benchmarks.reconstruction.tailor_net import LoopDecoder, PairNet, PointFeatures, SlotEncodings, TailorConfig, mlp
from gcd_dataset.records import Pattern
from gcd_dataset.tensors import EDGE_LABELS, PANEL_LABELS
from gcd_dataset.workers import parallel_map

TASKS = ("T0", "T1", "T1-scan")
OF_PANELS = ("exists", "extents", "centres", "rotations", "edge_counts", "labels", "slimness", "names", "quaternions")
LEAST_DEVIATION = 1e-3  # UNIT
LEAST_AREA = 1e-5  # UNIT²; smaller panels are centred at the mean of their corners
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
        self.placement = mlp(config.loop_width, config.loop_width, 4 + 3 + len(PANEL_LABELS))
        self.pairs = PairNet(config)
        self.register_buffer("edge_deviation", torch.zeros(2))
        self.register_buffer("bend_deviation", torch.ones(BENDS, 2))
        self.register_buffer("centre_mean", torch.zeros(3))
        self.register_buffer("centre_deviation", torch.ones(3))
        self.register_buffer("finer", torch.from_numpy(_finer()), persistent=False)

    def prepare(self, garments: GarmentSet, *, device: torch.device, workers: int = 0) -> DrawnPanels:
        """Targets of the garments. The first set prepared, the training set, gives means and deviations."""
        bare = garments.without_points()
        parts = (bare.select(range(k, min(k + CHUNK, len(bare)))) for k in range(0, len(bare), CHUNK))
        targets = NamedPanels.join(list(parallel_map(self.encoder(), parts, workers)))
        if not self.edge_deviation.any():
            self._standardise(targets)
        edges, panels = (targets.edge_panels >= 0).sum(dim=1), targets.exists.sum(dim=1)
        loops = targets.edge_counts.amax(dim=1)
        points = scaled_points(garments.points[:, : self.config.stored_points], device)
        whole = replace(targets.to(device), points=points)
        return DrawnPanels(DrawnPoints(whole, self.config.points, edges), panels, loops)

    def drawn_from(self, encoded: TensorExamples) -> DrawnPanels:
        return DrawnPanels(DrawnPoints(cast(NamedPanels, encoded), self.config.points))

    def encoder(self) -> ToNamedPanels:
        config = self.config
        return ToNamedPanels(ToTargets(config.panels, config.loop, config.edges, config.stored_points))

    def compile_parts(self) -> None:
        for layer in self.points.layers:
            layer.compile()
        self.pairs.compile(dynamic=True)  # batches differ in their number of edges

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
        encodings, logits = self.slots(self.points(batch.points))
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
    """The learner; ``options``: fields of ``TailorConfig``. Raises ``ConfigError`` for others."""
    given, least = {**(SMALL if smoke else {}), **options}, {"loop": LEAST_EDGES, "named": 0}
    sizes, _ = sizes_from("neural_tailor", TailorConfig, given, least=least)
    return NeuralTailor(sizes)


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
