"""A network from two pictures of a garment to the set of its panels.

Convolutions turn each picture into a grid of tokens (Xiao et al., Early Convolutions Help Transformers See Better,
NeurIPS 2021); a transformer relates the tokens of all pictures; the decoder and the loss are those of the network for
points (``models/panel_set``). The network knows which picture shows the front, but no camera.

Besides, each token says what the pixels of its cell show, and where one panel borders on another: without this loss a
network in front of which everything changes at each reading predicts the same panels for every picture.
"""

import torch
from jaxtyping import Float, Int, UInt8
from torch import Tensor, nn
from torch.nn import functional

from benchmarks.reconstruction.panel_net import NetConfig, PanelDecoder
from benchmarks.reconstruction.picture_inputs import FIRST_PANEL, SHOWN_CLASSES
from benchmarks.reconstruction.point_net import encoder
from gcd_dataset.tensors import PANEL_LABELS

__all__ = ["STRIDE", "PictureNet"]

STRIDE = 8  # pixels along each side of a token's cell
PARTS = 2  # parts of a cell along each side, about which its token says something
SHOWN_WEIGHT, BORDER_WEIGHT = 2.0, 4.0
"""Weights of the losses of what pixels show and of borders, relative to the losses of panels."""


class PictureNet(nn.Module):
    """Pictures to tokens, and a decoder of tokens."""

    def __init__(self, config: NetConfig, *, views: int, size: int) -> None:
        super().__init__()
        self.config = config
        width, side = config.width, size // STRIDE
        self.cells = nn.Sequential(
            *_halved(3, width // 4),
            *_halved(width // 4, width // 2),
            *_halved(width // 2, width),
            nn.Conv2d(width, width, 1),
        )
        self.place = nn.Parameter(0.02 * torch.randn(side, side, width))
        self.view = nn.Parameter(0.02 * torch.randn(views, width))
        self.encoder = encoder(config)
        self.decoder = PanelDecoder(config)
        self.shown = nn.Linear(width, PARTS * PARTS * (SHOWN_CLASSES + 1))

    def forward(self, pictures: UInt8[Tensor, "b n h w 3"]) -> Float[Tensor, "b t w"]:
        """Tokens of all cells, related to each other."""
        tokens: Tensor = self.encoder(self._tokens(pictures))
        return tokens

    def pixel_losses(self, tokens: Float[Tensor, "b t w"], labels: UInt8[Tensor, "b n h w"]) -> dict[str, Tensor]:
        """Losses of what the parts of all cells show; ``labels`` as ``Rendered.labels``."""
        labels = labels.flatten(0, 1).long()
        panels = (labels - FIRST_PANEL) // len(PANEL_LABELS)
        shown = torch.where(labels < FIRST_PANEL, labels, FIRST_PANEL + (labels - FIRST_PANEL) % len(PANEL_LABELS))
        classes = functional.one_hot(shown, SHOWN_CLASSES).permute(0, 3, 1, 2).float()
        truth = torch.cat([classes, _borders(torch.where(labels < FIRST_PANEL, -1, panels))], dim=1)
        truth = functional.avg_pool2d(truth, STRIDE // PARTS)
        side = labels.shape[-1] // STRIDE
        said = self.shown(tokens).float().unflatten(1, (-1, side, side)).flatten(0, 1).permute(0, 3, 1, 2)
        said = functional.pixel_shuffle(said, PARTS)
        return {
            "shown": SHOWN_WEIGHT * functional.cross_entropy(said[:, :-1], truth[:, :-1]),
            "borders": BORDER_WEIGHT * functional.binary_cross_entropy_with_logits(said[:, -1], truth[:, -1]),
        }

    def _tokens(self, pictures: UInt8[Tensor, "b n h w 3"]) -> Float[Tensor, "b t w"]:
        """A token for each cell of each picture."""
        pixels = pictures.flatten(0, 1).permute(0, 3, 1, 2).float() / 127.5 - 1.0
        cells = self.cells(pixels).permute(0, 2, 3, 1).unflatten(0, pictures.shape[:2])
        return (cells + self.place + self.view[:, None, None]).flatten(1, 3)


def _borders(panels: Int[Tensor, "b h w"]) -> Float[Tensor, "b 1 h w"]:
    """1 for pixels of a panel (others are -1) whose right or lower neighbour shows another panel."""
    right = functional.pad(panels, (0, 1), value=-1)[:, :, 1:]
    lower = functional.pad(panels, (0, 0, 0, 1), value=-1)[:, 1:]
    borders = [(panels >= 0) & (other >= 0) & (panels != other) for other in (right, lower)]
    return (borders[0] | borders[1])[:, None].float()


def _halved(channels: int, width: int) -> list[nn.Module]:
    """A layer that halves the picture."""
    return [nn.Conv2d(channels, width, 3, stride=2, padding=1, bias=False), nn.GroupNorm(8, width), nn.GELU()]
