"""A network from two pictures of a garment to the set of its panels.

Convolutions turn each picture into a grid of tokens (Xiao et al., Early Convolutions Help Transformers See Better,
NeurIPS 2021); a transformer relates the tokens of all pictures; the decoder and the loss are those of the network for
points (``models/panel_set``). The network knows which picture shows the front, but no camera.
"""

import torch
from jaxtyping import Float, UInt8
from torch import Tensor, nn

from benchmarks.reconstruction.models.panel_set import NetConfig, PanelDecoder, encoder

__all__ = ["STRIDE", "PictureNet"]

STRIDE = 8  # pixels along each side of a token's cell


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

    def forward(self, pictures: UInt8[Tensor, "b n h w 3"]) -> Float[Tensor, "b t w"]:
        """Tokens of all cells, related to each other."""
        tokens: Tensor = self.encoder(self._tokens(pictures))
        return tokens

    def _tokens(self, pictures: UInt8[Tensor, "b n h w 3"]) -> Float[Tensor, "b t w"]:
        """A token for each cell of each picture."""
        pixels = pictures.flatten(0, 1).permute(0, 3, 1, 2).float() / 127.5 - 1.0
        cells = self.cells(pixels).permute(0, 2, 3, 1).unflatten(0, pictures.shape[:2])
        return (cells + self.place + self.view[:, None, None]).flatten(1, 3)


def _halved(channels: int, width: int) -> list[nn.Module]:
    """A layer that halves the picture."""
    return [nn.Conv2d(channels, width, 3, stride=2, padding=1, bias=False), nn.GroupNorm(8, width), nn.GELU()]
