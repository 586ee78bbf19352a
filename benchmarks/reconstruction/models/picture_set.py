"""From pictures of a garment to the set of its panels, sewn.

Convolutions and attention turn the pictures into tokens (``picture_model``); panels, edges and seams follow as in
``panel_set``. The cameras are unknown, so the order of the pictures says nothing: each step draws another.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any, cast

import torch
from jaxtyping import UInt8
from torch import Tensor

from benchmarks.reconstruction.derived import PICTURE_SIZE, PICTURES
from benchmarks.reconstruction.garments import GarmentSet
from benchmarks.reconstruction.learners import Examples, Learner, TensorExamples, encoded_by, sizes_from
from benchmarks.reconstruction.models.panel_set import HEADS, LEAST, answers_of, set_loss
from benchmarks.reconstruction.panel_net import NetConfig
from benchmarks.reconstruction.panel_targets import PanelTargets, ToTargets, patterns_by, patterns_from
from benchmarks.reconstruction.picture_model import DrawnPictures, PictureNet, pictures_of, require_views
from gcd_dataset.records import Pattern

TASKS = ("T2",)
USUAL: Mapping[str, Any] = {"batch": 128, "lr": 5e-4}
SMOKE: Mapping[str, Any] = {
    "steps": 60, "batch": 4, "lr": 2e-3, "weight_decay": 0.0, "ema": 0.9, "log_every": 10, "checks": 2,
}  # fmt: skip
LARGE: Mapping[str, Any] = {
    "width": 256, "heads": 8, "layers": 4, "edge_width": 256, "edge_heads": 8, "edge_layers": 2, "seam_layers": 2,
    "seen": 512,
}  # fmt: skip
SMALL: Mapping[str, Any] = {
    "queries": 12, "slots": 24, "edges": 96, "width": 64, "heads": 4, "layers": 1, "edge_width": 64, "edge_heads": 4,
    "edge_layers": 1, "seam_layers": 1, "views": 2, "seen": 0,
}  # fmt: skip
"""Sizes of the usual and of the smallest network."""


@dataclass(frozen=True)
class PictureTargets(PanelTargets):
    """Pictures of garments and their targets."""

    pictures: UInt8[Tensor, "b n h w 3"]
    """sRGB"""
    shown: UInt8[Tensor, "b n h w"]
    """``pixel_labels`` of the pictures."""


class PictureSet(Learner[PictureTargets, Pattern]):
    """Pictures to a pattern."""

    def __init__(self, config: NetConfig, *, views: int = PICTURES, size: int = PICTURE_SIZE) -> None:
        """``views``: pictures that are seen; ``config.seen``: cells of them that a training step sees.

        ``size``: width and height of the pictures [pixels].

        Raises ``ConfigError`` for a number of pictures that garments do not have.
        """
        super().__init__()
        self.views = require_views(views)
        self.net = PictureNet(config, views=views, size=size, seen=config.seen)

    def prepare(self, garments: GarmentSet, *, device: torch.device, workers: int = 0) -> DrawnPictures[PictureTargets]:
        """Pictures and targets of the garments."""
        return self.drawn_from(encoded_by(self.encoder(), garments, workers).to(device))

    def drawn_from(self, encoded: TensorExamples) -> DrawnPictures[PictureTargets]:
        return DrawnPictures(cast(PictureTargets, encoded), self.views)

    def encoder(self) -> "ToPictureTargets":
        config = self.net.config
        return ToPictureTargets(ToTargets(config.queries, config.slots, config.edges, points=0))

    def compile_parts(self) -> None:
        for layer in (*self.net.encoder.layers, *self.net.decoder.layers):
            layer.compile()

    def loss(self, batch: PictureTargets) -> dict[str, Tensor]:
        tokens, rows = self.net.seen_cells(batch.pictures)
        return {**set_loss(self.net.decoder, tokens, batch), **self.net.pixel_losses(tokens, batch.shown, rows)}

    def predict(self, batch: PictureTargets) -> list[Pattern]:
        return patterns_from(self._said(batch))

    def answers(
        self, examples: Examples[PictureTargets], count: int, *, batch: int, workers: int = 0
    ) -> Iterator[Pattern]:
        return patterns_by(self._said, examples, count, batch=batch, workers=workers)

    def _said(self, batch: PictureTargets) -> PanelTargets:
        with torch.no_grad():
            return answers_of(self.net.decoder, self.net(batch.pictures))


@dataclass(frozen=True)
class ToPictureTargets:
    """Encodes garments as ``PictureTargets``, on the CPU."""

    to_targets: ToTargets

    def __call__(self, garments: GarmentSet) -> PictureTargets:
        """Pictures and targets of all garments."""
        targets = self.to_targets(garments)
        return PictureTargets(**vars(targets), **pictures_of(garments))


def build(config: Mapping[str, Any]) -> PictureSet:
    """The learner; ``config``: fields of ``NetConfig``, and ``views``. Raises ``ConfigError`` for others."""
    given, points = {**LARGE, **config}, ("tokens", "region_width")
    sizes, own = sizes_from("picture_set", NetConfig, given, own=("views",), without=points, least=LEAST, heads=HEADS)
    return PictureSet(sizes, **own)
