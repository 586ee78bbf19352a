"""From surface points of a garment to design parameters and body measures, from which our own programs draw the answer.

The tokens of the points are those of ``panel_set``; ``design_net`` reads designs from them. Answers are confined to
what the programs can draw, so this model answers garments of other origin by the most similar ones of ours.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, cast

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from benchmarks.reconstruction.derived import CENTRE
from benchmarks.reconstruction.design_augmentation import DesignAugmentation
from benchmarks.reconstruction.design_net import Answer, DesignDecoder, DesignTargets, drawn
from benchmarks.reconstruction.garments import GarmentSet
from benchmarks.reconstruction.learners import Examples, Learner, TensorExamples, uploaded
from benchmarks.reconstruction.panel_targets import UNIT, scaled_points
from benchmarks.reconstruction.point_net import CHUNK, EncoderConfig, PointTokens, require_tokens
from benchmarks.reconstruction.sizes import sizes_from
from gcd_dataset.records import Pattern
from gcd_dataset.workers import parallel_map

__all__ = ["SMOKE", "TASKS", "USUAL", "Designs", "ParameterNet", "ParametersConfig", "ToDesigns", "build"]

TASKS = ("T0", "T1", "T1-scan")
MOST_GROWTH = 0.1  # share, of the augmentation
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


@dataclass(frozen=True)
class Designs(DesignTargets):
    """Points of garments with the parameters and measures that they were drawn from."""

    points: Float[Tensor, "b n 6"]
    """Surface points relative to ``CENTRE`` [UNIT], and normals; f16."""


@dataclass(frozen=True)
class ToDesigns:
    """From garments with the field ``design`` to their ``Designs``, on a CPU."""

    points: int

    def __call__(self, garments: GarmentSet) -> Designs:
        points = scaled_points(garments.points[:, : self.points])
        return Designs(**vars(DesignTargets.of(garments)), points=points)


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
            chosen = torch.arange(min(self.points, found.points.shape[1]))
        else:
            chosen = torch.randperm(found.points.shape[1], generator=chance)[: self.points]
        found = replace(found, points=found.points[:, uploaded(chosen, found.device)])
        if chance is None or not self.augmented:
            return found
        draws = uploaded(torch.rand(len(self), 2, generator=chance)[rows], found.device)
        mirrored = (draws[:, 0] < 0.5) & self._augmentation.can_mirror(found)
        scales = 1 + MOST_GROWTH * (2 * draws[:, 1] - 1)
        targets = self._augmentation.scaled(self._augmentation.mirrored(found, mirrored), scales)
        return replace(targets, points=_augmented(found.points, mirrored, scales))

    @cached_property
    def _augmentation(self) -> DesignAugmentation:
        return DesignAugmentation(self.whole.device)


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

    def prepare(self, garments: GarmentSet, *, device: torch.device, workers: int = 0) -> DrawnDesigns:
        """Targets of the garments. The first set prepared, the training set, gives the range of the measures.

        Raises ``ConfigError`` for garments of fewer points than tokens.
        """
        require_tokens(self.config, self.config.points, garments.points.shape[1])
        self.decoder.learn_range(garments)
        bare = replace(garments, points=garments.points[:, :0], ragged={"design": garments.ragged["design"]})
        parts = (bare.select(range(k, min(k + CHUNK, len(bare)))) for k in range(0, len(bare), CHUNK))
        whole = Designs.join(list(parallel_map(self.encoder(), parts, workers))).to(device)
        whole = replace(whole, points=scaled_points(garments.points[:, : self.config.stored_points], device))
        return DrawnDesigns(whole, self.config.points, bool(self.config.augmented))

    def drawn_from(self, encoded: TensorExamples) -> DrawnDesigns:
        return DrawnDesigns(cast(Designs, encoded), self.config.points, bool(self.config.augmented))

    def encoder(self) -> ToDesigns:
        return ToDesigns(self.config.stored_points)

    def compile_parts(self) -> None:
        for part in (self.tokens.features, *self.tokens.encoder.layers, *self.decoder.all_layers):
            part.compile()

    def loss(self, batch: Designs) -> dict[str, Tensor]:
        return self.decoder.losses(self.decoder(self.tokens(batch.points), batch), batch)

    def predict(self, batch: Designs) -> list[Pattern]:
        return [drawn(one) for one in self._said(batch)]

    def answers(self, examples: Examples[Designs], count: int, *, batch: int, workers: int = 0) -> Iterator[Pattern]:
        rows = torch.split(torch.arange(count), batch)
        return parallel_map(drawn, [one for part in rows for one in self._said(examples.batch(part))], workers)

    @torch.no_grad()
    def _said(self, batch: Designs) -> list[Answer]:
        """What is said about all stored points, as many at once as in a step."""
        several = torch.split(batch.points, self.config.points, dim=1)
        return self.decoder.answers(*(self.tokens(part) for part in several if part.shape == several[0].shape))


def build(*, smoke: bool, options: Mapping[str, Any]) -> ParameterNet:
    """The learner; ``options``: fields of ``ParametersConfig``. Raises ``ConfigError`` for others."""
    given, heads = {**(SMALL if smoke else {}), **options}, {"width": "heads"}
    sizes, _ = sizes_from("parameters", ParametersConfig, given, least={"seen": 0, "augmented": 0}, heads=heads)
    return ParameterNet(sizes)
