"""From surface points of a garment to design parameters and body measures, from which our own programs draw the answer.

The tokens of the points are those of ``panel_set``; ``design_net`` reads designs from them. Answers are confined to
what the programs can draw, so this model answers garments of other origin by the most similar ones of ours.

With ``labelled``, each token also predicts the labels of its points in training: the shares of the points on each
panel, on seams and on labelled edges, as the tokens of pictures do (``picture_model``).
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, cast

import numpy as np
import torch
from jaxtyping import Bool, Float, Int, UInt8
from torch import Tensor, nn
from torch.nn import functional

from benchmarks.reconstruction.derived import CENTRE, MIRRORED, MIRRORED_EDGES, POINT_LABELS
from benchmarks.reconstruction.design_net import Answer, DesignAugmentation, DesignDecoder, DesignTargets, drawn
from benchmarks.reconstruction.garments import GarmentSet
from benchmarks.reconstruction.learners import Examples, Learner, TensorExamples, encoded_by, sizes_from, uploaded
from benchmarks.reconstruction.panel_targets import UNIT, scaled_points
from benchmarks.reconstruction.point_net import EncoderConfig, PointTokens, require_tokens
from gcd_dataset.errors import ConfigError
from gcd_dataset.metrics.answers import PANEL_CLASSES
from gcd_dataset.records import Pattern
from gcd_dataset.tensors import EDGE_LABELS
from gcd_dataset.workers import parallel_map

TASKS = ("T0", "T1", "T1-scan")
MOST_GROWTH = 0.1  # share, of the augmentation
UNLABELLED = "--set labelled=1: the points of these garments have no labels: leave it out"
PANEL_WEIGHT, BORDER_WEIGHT = 1.0, 4.0
"""Weights of the losses of predicted labels: of panels, and of seams and labelled edges."""
USUAL: Mapping[str, Any] = {"batch": 256, "lr": 5e-4}
"""Options of a training on a GPU."""
SMOKE: Mapping[str, Any] = {
    "steps": 250, "batch": 8, "lr": 3e-3, "weight_decay": 0.0, "ema": 0.9, "log_every": 10, "checks": 2,
}  # fmt: skip
SMALL: Mapping[str, Any] = {
    "tokens": 32, "width": 64, "heads": 4, "layers": 1, "region_width": 32, "points": 256, "stored_points": 1024,
}  # fmt: skip
"""Options of the smallest training, for two CPU cores, and the sizes of its network."""


@dataclass(frozen=True, slots=True)
class ParametersConfig(EncoderConfig):
    """Sizes of a network; half as many layers as the encoder's, rounded up, relate the queries to its tokens."""

    points: int = 4096
    """Points of a garment in a step."""
    stored_points: int = 8192
    """Points that they are drawn from."""
    augmented: int = 0
    """1: garments are mirrored and scaled in a training."""
    labelled: int = 0
    """1: tokens predict the labels of their points in training."""


@dataclass(frozen=True)
class Designs(DesignTargets):
    """Points of garments with the parameters and measures that they were drawn from."""

    points: Float[Tensor, "b n 6"]
    """Surface points relative to ``CENTRE`` [UNIT], and normals; f16."""
    labels: UInt8[Tensor, "b m 3"]
    """Labels of the points (``POINT_LABELS``); m is n, or 0 if they are unknown or not used."""


@dataclass(frozen=True)
class ToDesigns:
    """Encodes garments that have the field ``design`` as ``Designs``, on the CPU."""

    points: int
    labelled: bool

    def __call__(self, garments: GarmentSet) -> Designs:
        points, targets = scaled_points(garments.points[:, : self.points]), DesignTargets.of(garments)
        return Designs(**vars(targets), points=points, labels=self.labels(garments))

    def labels(self, garments: GarmentSet) -> UInt8[Tensor, "g m 3"]:
        """The labels of the points; m is 0 without ``labelled``, and for garments without labels."""
        found = [garments.ragged[name] for name in POINT_LABELS if self.labelled and name in garments.ragged]
        if not found:
            return torch.zeros(len(garments), 0, 3, dtype=torch.uint8)
        count = min(self.points, garments.points.shape[1])
        return torch.from_numpy(np.stack([found[0][k][:count] for k in range(len(garments))]))


@dataclass(frozen=True)
class DrawnDesigns:
    """Designs whose batches have some of the stored points, others in each step.

    With ``augmented``, training batches also mirror a random half of the garments, where the mirror image is a garment
    of the same programs, and scale all with their bodies, against overfitting on small sets.
    """

    whole: Designs
    points: int
    augmented: bool = False

    def __len__(self) -> int:
        return len(self.whole)

    def batch(self, rows: Int[Tensor, " b"], chance: torch.Generator | None = None) -> Designs:
        found = self.whole.batch(rows)
        if chance is None:
            return found
        chosen = uploaded(torch.randperm(found.points.shape[1], generator=chance)[: self.points], found.device)
        labels = found.labels[:, chosen] if found.labels.shape[1] else found.labels
        found = replace(found, points=found.points[:, chosen], labels=labels)
        if not self.augmented:
            return found
        draws = uploaded(torch.rand(len(self), 2, generator=chance)[rows], found.device)
        mirrored = (draws[:, 0] < 0.5) & self._augmentation.can_mirror(found)
        scales = 1 + MOST_GROWTH * (2 * draws[:, 1] - 1)
        targets = self._augmentation.scaled(self._augmentation.mirrored(found, mirrored), scales)
        labels = torch.where(mirrored[:, None, None], self._mirrored_labels(found.labels), found.labels)
        return replace(targets, points=_augmented(found.points, mirrored, scales), labels=labels)

    def _mirrored_labels(self, labels: UInt8[Tensor, "b m 3"]) -> UInt8[Tensor, "b m 3"]:
        rows = labels[..., :2].int()
        return torch.stack([self._classes[rows[..., 0]], self._edges[rows[..., 1]], labels[..., 2]], dim=-1)

    @cached_property
    def _augmentation(self) -> DesignAugmentation:
        return DesignAugmentation(self.whole.device)

    @cached_property
    def _classes(self) -> UInt8[Tensor, " c"]:
        return torch.tensor(MIRRORED, dtype=torch.uint8, device=self.whole.device)

    @cached_property
    def _edges(self) -> UInt8[Tensor, " l"]:
        return torch.tensor(MIRRORED_EDGES, dtype=torch.uint8, device=self.whole.device)


def _augmented(
    points: Float[Tensor, "b n 6"], mirrored: Bool[Tensor, " b"], scales: Float[Tensor, " b"]
) -> Float[Tensor, "b n 6"]:
    """Points mirrored at the plane x = 0, and scaled about the ground between the feet."""
    sign, one = torch.where(mirrored, -1.0, 1.0), torch.ones_like(scales)
    factors = torch.stack([sign * scales, scales, scales, sign, one, one], dim=1)
    found = points.float() * factors[:, None]
    found[..., 1] += (scales[:, None] - 1) * (float(CENTRE[1]) / UNIT)
    return found.to(points.dtype)


class ParameterNet(Learner[Designs, Pattern]):
    """Points and normals to a design and measures, and so to a pattern."""

    is_recordable = True

    def __init__(self, config: ParametersConfig | None = None) -> None:
        super().__init__()
        self.config = config = config or ParametersConfig()
        require_tokens(config, config.points, config.stored_points)
        self.tokens = PointTokens(config)
        self.decoder = DesignDecoder(config.width, heads=config.heads, layers=(config.layers + 1) // 2)
        self.of_points = nn.Linear(config.width, len(PANEL_CLASSES) + len(EDGE_LABELS)) if config.labelled else None

    def prepare(self, garments: GarmentSet, *, device: torch.device, workers: int = 0) -> DrawnDesigns:
        """Targets of the garments. The first set prepared, the training set, gives the range of the measures.

        Raises ``ConfigError`` for garments of fewer points than tokens.
        """
        require_tokens(self.config, self.config.points, garments.points.shape[1])
        self.decoder.learn_range(garments)
        bare = replace(garments, points=garments.points[:, :0], ragged={"design": garments.ragged["design"]})
        targets = replace(self.encoder(), labelled=False)  # labels are joined below, not sent between processes
        whole = encoded_by(targets, bare, workers).to(device)
        points = scaled_points(garments.points[:, : self.config.stored_points], device)
        whole = replace(whole, points=points, labels=self.encoder().labels(garments).to(device))
        return DrawnDesigns(whole, self.config.points, bool(self.config.augmented))

    def drawn_from(self, encoded: TensorExamples) -> DrawnDesigns:
        return DrawnDesigns(cast(Designs, encoded), self.config.points, bool(self.config.augmented))

    def encoder(self) -> ToDesigns:
        return ToDesigns(self.config.stored_points, bool(self.config.labelled))

    def compile_parts(self) -> None:
        for part in (self.tokens.features, *self.tokens.encoder.layers, *self.decoder.all_layers):
            part.compile()

    def loss(self, batch: Designs) -> dict[str, Tensor]:
        points = batch.points[:, : self.config.points]
        if self.of_points is None or (not self.training and not batch.labels.shape[1]):
            return self.decoder.losses(self.decoder(self.tokens(points), batch), batch)
        if not batch.labels.shape[1]:
            raise ConfigError(UNLABELLED)
        labels = batch.labels[:, : self.config.points]
        tokens, regions = self.tokens.with_regions(torch.cat([points.float(), labels.float()], dim=-1))
        told = self.decoder.losses(self.decoder(tokens, batch), batch)
        return {**told, **label_losses(self.of_points(tokens).float(), regions[..., 6:])}

    def predict(self, batch: Designs) -> list[Pattern]:
        return [drawn(one) for one in self._said(batch)]

    def answers(self, examples: Examples[Designs], count: int, *, batch: int, workers: int = 0) -> Iterator[Pattern]:
        rows = torch.split(torch.arange(count), batch)
        return parallel_map(drawn, [one for part in rows for one in self._said(examples.batch(part))], workers)

    @torch.no_grad()
    def _said(self, batch: Designs) -> list[Answer]:
        """Predictions from the stored points, in parts of as many as a step sees; a remainder is left out."""
        return self.decoder.answers(*self._tokens(batch.points))

    def _tokens(self, points: Float[Tensor, "b n 6"]) -> list[Float[Tensor, "b t w"]]:
        several = torch.split(points, self.config.points, dim=1)
        return [self.tokens(part) for part in several if part.shape == several[0].shape]

    @torch.no_grad()
    def proposals(self, points: Float[Tensor, "1 n 6"], count: int, chance: torch.Generator) -> list[Answer]:
        """``DesignDecoder.proposals`` for points as ``Designs`` has them."""
        return self.decoder.proposals(self._tokens(points), count, chance)


def label_losses(said: Float[Tensor, "b t o"], labels: Float[Tensor, "b t m 3"]) -> dict[str, Tensor]:
    """Losses of the labels that tokens predict for the points of their regions.

    ``said``: logits of the classes of panels, of the edge labels but the first, which means none, and of a seam. The
    targets are the shares of the points.
    """
    classes = labels[..., 0].long()
    shares = said.new_zeros(*classes.shape[:2], len(PANEL_CLASSES))
    shares.scatter_add_(-1, classes, torch.full_like(labels[..., 0], 1 / classes.shape[-1], dtype=said.dtype))
    rows = torch.arange(1, len(EDGE_LABELS), device=said.device)
    on_edges = (labels[..., 1, None] == rows).to(said.dtype).mean(dim=2)
    borders = torch.cat([on_edges, labels[..., 2].mean(dim=2, keepdim=True)], dim=-1)
    panels, edges = torch.split(said, [len(PANEL_CLASSES), len(EDGE_LABELS)], dim=-1)
    return {
        "panels": PANEL_WEIGHT * functional.cross_entropy(panels.flatten(0, 1), shares.flatten(0, 1)),
        "borders": BORDER_WEIGHT * functional.binary_cross_entropy_with_logits(edges, borders),
    }


def build(config: Mapping[str, Any]) -> ParameterNet:
    """The learner; ``config``: fields of ``ParametersConfig``. Raises ``ConfigError`` for others."""
    least = dict.fromkeys(("seen", "augmented", "labelled"), 0)
    sizes, _ = sizes_from("parameters", ParametersConfig, config, least=least, heads={"width": "heads"})
    return ParameterNet(sizes)
