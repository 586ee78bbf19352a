"""From pictures of a garment on its wearer to its size relative to the wearer's, and its ease at three rings (task T7).

``picture_model`` makes tokens of the pictures; the numbers come from the mean and the largest features of all tokens.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, cast

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor, nn

from benchmarks.reconstruction.derived import FIT
from benchmarks.reconstruction.garments import GarmentSet
from benchmarks.reconstruction.learners import Learner, TensorExamples, mean_of, sizes_from
from benchmarks.reconstruction.models import picture_parameters
from benchmarks.reconstruction.picture_model import DrawnPictures, PicturedExamples, PictureTokens, pictures_of
from benchmarks.reconstruction.point_net import EncoderConfig
from benchmarks.reconstruction.surface_net import mlp
from gcd_dataset.scoring.inputs import PICTURE_SIZE, PICTURES

TASKS = ("T7",)
USUAL, SMOKE, SMALL = picture_parameters.USUAL, picture_parameters.SMOKE, picture_parameters.SMALL
LEAST_DEVIATION = 0.1  # sizes, cm


@dataclass(frozen=True)
class PictureFits(PicturedExamples):
    """Pictures of garments with size and ease."""

    fit: Float[Tensor, "b 4"]
    """``FIT``; NaN for a ring without cloth."""


class FitNet(Learner[PictureFits, np.ndarray]):
    """Pictures to size and ease."""

    is_recordable = True
    mean: Tensor
    deviation: Tensor

    def __init__(self, config: EncoderConfig, *, views: int = PICTURES) -> None:
        """``views``: pictures that are seen. Raises ``ConfigError`` as ``PictureTokens``."""
        super().__init__()
        self.views = views
        self.tokens = PictureTokens(config, views=views, size=PICTURE_SIZE, seen=config.seen)
        self.head = nn.Sequential(*mlp(2 * config.width, config.width, len(FIT)))
        self.register_buffer("mean", torch.zeros(len(FIT)))
        self.register_buffer("deviation", torch.zeros(len(FIT)))

    def prepare(self, garments: GarmentSet, *, device: torch.device, workers: int = 0) -> DrawnPictures[PictureFits]:
        """Pictures and targets. The first set prepared, the training set, gives mean and deviation of the targets."""
        if not self.deviation.any():
            known = np.ma.masked_invalid(garments.ragged["fit"].rows)
            self.mean.copy_(torch.from_numpy(known.mean(axis=0).filled(0.0)))
            self.deviation.copy_(torch.from_numpy(known.std(axis=0).filled(0.0)).clamp(min=LEAST_DEVIATION))
        return self.drawn_from(encoded(garments).to(device))

    def drawn_from(self, encoded: TensorExamples) -> DrawnPictures[PictureFits]:
        return DrawnPictures(cast(PictureFits, encoded), self.views)

    def encoder(self) -> Callable[[GarmentSet], PictureFits]:
        return encoded

    def compile_parts(self) -> None:
        for layer in self.tokens.encoder.layers:
            layer.compile()

    def loss(self, batch: PictureFits) -> dict[str, Tensor]:
        tokens, rows = self.tokens.seen_cells(batch.pictures)
        errors = (self._standard(tokens).float() - (batch.fit.nan_to_num() - self.mean) / self.deviation).abs()
        return {"fit": mean_of(errors, batch.fit.isfinite()), **self.tokens.pixel_losses(tokens, batch.shown, rows)}

    def predict(self, batch: PictureFits) -> list[np.ndarray]:
        with torch.no_grad():
            said = self._standard(self.tokens(batch.pictures)).float() * self.deviation + self.mean
        return list(said.double().cpu().numpy())

    def _standard(self, tokens: Float[Tensor, "b t w"]) -> Float[Tensor, "b 4"]:
        """Size and ease in deviations from the mean."""
        said: Tensor = self.head(torch.cat([tokens.mean(dim=1), tokens.amax(dim=1)], dim=-1))
        return said


def encoded(garments: GarmentSet) -> PictureFits:
    """Pictures and targets of garments with the fields ``pictures``, ``shown`` and ``fit``, on a CPU."""
    return PictureFits(**pictures_of(garments), fit=torch.from_numpy(garments.ragged["fit"].rows).float())


def build(config: Mapping[str, Any]) -> FitNet:
    """The learner; ``config``: fields of ``EncoderConfig``, and ``views``. Raises ``ConfigError`` for others."""
    sizes, own = sizes_from(
        "fit", EncoderConfig, {**picture_parameters.LARGE, **config},
        own=("views",), without=("tokens", "region_width"), least={"seen": 0}, heads={"width": "heads"},
    )  # fmt: skip
    return FitNet(sizes, **own)
