"""From pictures of a garment to design parameters and body measures, from which our own programs draw the answer.

``picture_model`` makes tokens of the pictures; ``design_net`` reads designs from them, as in ``parameters``.
"""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, cast

import torch
from jaxtyping import Bool, Int, UInt8
from torch import Tensor

from benchmarks.reconstruction.derived import MIRRORED_PIXELS
from benchmarks.reconstruction.design_net import Answer, DesignAugmentation, DesignDecoder, DesignTargets, drawn
from benchmarks.reconstruction.garments import GarmentSet
from benchmarks.reconstruction.learners import Examples, Learner, TensorExamples, encoded_by, sizes_from, uploaded
from benchmarks.reconstruction.picture_model import DrawnPictures, PicturedExamples, PictureTokens, pictures_of
from benchmarks.reconstruction.point_net import EncoderConfig
from gcd_dataset.records import Pattern
from gcd_dataset.scoring.inputs import PICTURE_SIZE, PICTURES
from gcd_dataset.workers import parallel_map

TASKS = ("T2",)
USUAL: Mapping[str, Any] = {"batch": 128, "lr": 5e-4}
SMOKE: Mapping[str, Any] = {
    "steps": 120, "batch": 4, "lr": 2e-3, "weight_decay": 0.0, "ema": 0.9, "log_every": 10, "checks": 2,
}  # fmt: skip
LARGE: Mapping[str, Any] = {"width": 256, "heads": 8, "layers": 6, "seen": 512}
SMALL: Mapping[str, Any] = {"width": 64, "heads": 4, "layers": 1, "seen": 0, "views": 2}
"""Sizes of the usual and of the smallest network."""


@dataclass(frozen=True)
class PictureDesigns(DesignTargets, PicturedExamples):
    """Pictures of garments with the parameters and measures that they were drawn from."""


@dataclass(frozen=True)
class MirroredPictures(DrawnPictures[PictureDesigns]):
    """Training batches also mirror all pictures of a random half of the garments, where the mirror image is a garment
    of the same programs."""

    def batch(self, rows: Int[Tensor, " b"], chance: torch.Generator | None = None) -> PictureDesigns:
        found = super().batch(rows, chance)
        return found if chance is None else self._mirrored(found, torch.rand(len(self), generator=chance)[rows] < 0.5)

    def _mirrored(self, found: PictureDesigns, drawn_rows: Bool[Tensor, " b"]) -> PictureDesigns:
        chosen = uploaded(drawn_rows, found.device) & self._augmentation.can_mirror(found)
        found = self._augmentation.mirrored(found, chosen)
        pictures = torch.where(chosen[:, None, None, None, None], found.pictures.flip(3), found.pictures)
        labels = self._labels[found.shown.flip(3).long()]
        return replace(found, pictures=pictures, shown=torch.where(chosen[:, None, None, None], labels, found.shown))

    @cached_property
    def _augmentation(self) -> DesignAugmentation:
        return DesignAugmentation(self.whole.device)

    @cached_property
    def _labels(self) -> UInt8[Tensor, "256"]:
        return torch.tensor(MIRRORED_PIXELS, dtype=torch.uint8, device=self.whole.device)


class PictureParameters(Learner[PictureDesigns, Pattern]):
    """Pictures to a design and measures, and so to a pattern."""

    is_recordable = True

    def __init__(self, config: EncoderConfig, *, views: int = PICTURES, augmented: int = 0) -> None:
        """``views``: pictures that are seen; ``config.seen``: cells of them that a training step sees. ``augmented``: 1
        for mirror images in a training. Raises ``ConfigError`` as ``PictureTokens``.
        """
        super().__init__()
        self.views, self.augmented = views, bool(augmented)
        self.tokens = PictureTokens(config, views=views, size=PICTURE_SIZE, seen=config.seen)
        self.decoder = DesignDecoder(config.width, heads=config.heads, layers=(config.layers + 1) // 2)

    def prepare(self, garments: GarmentSet, *, device: torch.device, workers: int = 0) -> DrawnPictures[PictureDesigns]:
        """Pictures and targets. The first set prepared, the training set, gives the range of the measures."""
        self.decoder.learn_range(garments)
        return self.drawn_from(encoded(garments, workers).to(device))

    def drawn_from(self, encoded: TensorExamples) -> DrawnPictures[PictureDesigns]:
        kind = MirroredPictures if self.augmented else DrawnPictures
        return kind(cast(PictureDesigns, encoded), self.views)

    def encoder(self) -> Callable[[GarmentSet], PictureDesigns]:
        return encoded

    def compile_parts(self) -> None:
        for layer in (*self.tokens.encoder.layers, *self.decoder.all_layers):
            layer.compile()

    def loss(self, batch: PictureDesigns) -> dict[str, Tensor]:
        tokens, rows = self.tokens.seen_cells(batch.pictures)
        told = self.decoder.losses(self.decoder(tokens, batch), batch)
        return {**told, **self.tokens.pixel_losses(tokens, batch.shown, rows)}

    def predict(self, batch: PictureDesigns) -> list[Pattern]:
        return [drawn(one) for one in self._said(batch)]

    def answers(
        self, examples: Examples[PictureDesigns], count: int, *, batch: int, workers: int = 0
    ) -> Iterator[Pattern]:
        rows = torch.split(torch.arange(count), batch)
        return parallel_map(drawn, [one for part in rows for one in self._said(examples.batch(part))], workers)

    @torch.no_grad()
    def _said(self, batch: PictureDesigns) -> list[Answer]:
        return self.decoder.answers(self.tokens(batch.pictures))

    @torch.no_grad()
    def proposals(self, pictures: UInt8[Tensor, "1 n h w 3"], count: int, chance: torch.Generator) -> list[Answer]:
        """``DesignDecoder.proposals`` for ``views`` pictures."""
        return self.decoder.proposals([self.tokens(pictures)], count, chance)


def encoded(garments: GarmentSet, workers: int = 0) -> PictureDesigns:
    """Pictures and targets of garments with the fields ``design``, ``pictures`` and ``shown``, on a CPU."""
    bare = replace(garments, ragged={"design": garments.ragged["design"]})  # no picture is sent between processes
    return PictureDesigns(**vars(encoded_by(DesignTargets.of, bare, workers)), **pictures_of(garments))


def build(config: Mapping[str, Any]) -> PictureParameters:
    """The learner; ``config``: fields of ``EncoderConfig``, ``views`` and ``augmented``.

    Raises ``ConfigError`` for others.
    """
    sizes, own = sizes_from(
        "picture_parameters", EncoderConfig, {**LARGE, **config}, own=("views", "augmented"),
        without=("tokens", "region_width"), least={"seen": 0}, heads={"width": "heads"},
    )  # fmt: skip
    return PictureParameters(sizes, **own)
