"""From pictures of a garment to tokens.

Convolutions turn each picture into a grid of tokens (Xiao et al., Early Convolutions Help Transformers See Better,
NeurIPS 2021); a transformer relates the tokens of all pictures. No camera is known.

Besides, each token says what the pixels of its cell show, and where one panel borders on another. Without this loss a
network to which all pictures were new predicted the same panels for every picture.
"""

from dataclasses import dataclass, replace
from typing import Generic, TypeVar

import torch
from jaxtyping import Float, Int, UInt8
from torch import Tensor, nn
from torch.nn import functional

from benchmarks.reconstruction.derived import FIRST_PANEL, SHOWN_CLASSES
from benchmarks.reconstruction.garments import GarmentSet
from benchmarks.reconstruction.learners import TensorExamples, uploaded
from benchmarks.reconstruction.point_net import EncoderConfig, encoder, some_of
from gcd_dataset.errors import ConfigError
from gcd_dataset.scoring.inputs import PICTURES
from gcd_dataset.tensors import PANEL_LABELS

STRIDE = 16  # pixels along each side of a token's cell
NUMBERS = 6  # of a distortion
MOST_TURN, MOST_GROWTH, MOST_SHIFT, MOST_WEIGHT = 0.1, 0.1, 0.1, 0.3
"""Limits of ``distorted``: turn [rad], log scale, shift [half sides of the picture], log weight of a channel."""
GROUPS = 8  # of channels that are normalised together
PARTS = 2  # parts of a cell along each side, about which its token says something
SHOWN_WEIGHT, BORDER_WEIGHT = 2.0, 4.0
"""Weights of the losses of what pixels show and of borders, relative to the losses of panels."""


Pictured = TypeVar("Pictured", bound="PicturedExamples")


class PictureTokens(nn.Module):
    """Pictures to tokens of their cells, related to each other."""

    def __init__(self, config: EncoderConfig, *, views: int, size: int, seen: int = 0) -> None:
        """``seen``: cells of a garment in a training step, others in each step; 0: all, as in an answer.

        Raises ``ConfigError`` for a width whose quarter has no ``GROUPS`` equal parts, and for more pictures than
        garments have.
        """
        super().__init__()
        if not 1 <= views <= PICTURES:
            raise ConfigError(f"views {views}: give 1 to {PICTURES}")
        width, side = config.width, size // STRIDE
        if width % (4 * GROUPS):
            raise ConfigError(f"width {width}: give a multiple of {4 * GROUPS}")
        self.seen = seen
        self.cells = nn.Sequential(
            *_halved(3, width // 4),
            *_halved(width // 4, width // 4),
            *_halved(width // 4, width // 2),
            *_halved(width // 2, width),
            nn.Conv2d(width, width, 1),
        )
        self.place = nn.Parameter(0.02 * torch.randn(side, side, width))
        self.view = nn.Parameter(0.02 * torch.randn(views, width))
        self.encoder = encoder(config)

        self.of_pixels = nn.Linear(width, PARTS * PARTS * (SHOWN_CLASSES + 1))

    def forward(self, pictures: UInt8[Tensor, "b n h w 3"]) -> Float[Tensor, "b t w"]:
        """Tokens of the cells, related to each other."""
        return self.seen_cells(pictures)[0]

    def seen_cells(self, pictures: UInt8[Tensor, "b n h w 3"]) -> tuple[Float[Tensor, "b t w"], Int[Tensor, "b t"]]:
        """Tokens of the cells that are seen, and their rows among all: picture by picture, line by line."""
        cells = self._cells(pictures)
        rows = torch.arange(cells.shape[1], device=cells.device).expand(len(cells), -1)
        if self.training and self.seen:
            rows = some_of(rows, self.seen)
            cells = cells.gather(1, rows[..., None].expand(-1, -1, cells.shape[-1]))
        return self.encoder(cells), rows

    def pixel_losses(
        self,
        tokens: Float[Tensor, "b t w"],
        labels: UInt8[Tensor, "b n h w"],
        rows: Int[Tensor, "b t"] | None = None,
    ) -> dict[str, Tensor]:
        """Losses of what the parts of cells show; ``labels`` as ``pixel_labels``; ``rows``: of the cells, all without.

        The truth of a part is the share of its pixels that show a class, and that lie at a border.
        """
        labels = labels.long()
        panels = torch.where(labels < FIRST_PANEL, -1, (labels - FIRST_PANEL) // len(PANEL_LABELS))
        classes = torch.where(labels < FIRST_PANEL, labels, FIRST_PANEL + (labels - FIRST_PANEL) % len(PANEL_LABELS))
        classes, borders = (_by_part(pixels, rows) for pixels in (classes, _borders(panels)))
        shares = torch.zeros(*classes.shape[:-1], SHOWN_CLASSES, device=labels.device)
        shares.scatter_add_(-1, classes, torch.full_like(classes, 1 / classes.shape[-1], dtype=shares.dtype))
        said = self.of_pixels(tokens).float().unflatten(-1, (PARTS * PARTS, SHOWN_CLASSES + 1))
        shown = functional.cross_entropy(said[..., :-1].flatten(0, -2), shares.flatten(0, -2))
        at_border = functional.binary_cross_entropy_with_logits(said[..., -1], borders.float().mean(dim=-1))
        return {"shown": SHOWN_WEIGHT * shown, "borders": BORDER_WEIGHT * at_border}

    def _cells(self, pictures: UInt8[Tensor, "b n h w 3"]) -> Float[Tensor, "b t w"]:
        """A token for each cell of each picture."""
        pixels = pictures.flatten(0, 1).permute(0, 3, 1, 2).float() / 127.5 - 1.0
        cells = self.cells(pixels).permute(0, 2, 3, 1).unflatten(0, pictures.shape[:2])
        return (cells + self.place + self.view[:, None, None]).flatten(1, 3)


@dataclass(frozen=True)
class PicturedExamples(TensorExamples):
    """Pictures of garments."""

    pictures: UInt8[Tensor, "b n h w 3"]
    """sRGB"""
    shown: UInt8[Tensor, "b n h w"]
    """``pixel_labels`` of the pictures."""


def pictures_of(garments: GarmentSet) -> dict[str, Tensor]:
    """The columns of ``PicturedExamples``, on a CPU; they share the memory of the garments."""
    rows = {name: torch.from_numpy(garments.ragged[name].rows) for name in ("pictures", "shown")}
    return {name: pictures.view(len(garments), PICTURES, *pictures.shape[1:]) for name, pictures in rows.items()}


@dataclass(frozen=True)
class DrawnPictures(Generic[Pictured]):
    """Examples with a new choice, order and distortion of their pictures in each step."""

    whole: Pictured
    views: int

    def __len__(self) -> int:
        return len(self.whole)

    def batch(self, rows: Int[Tensor, " b"], chance: torch.Generator | None = None) -> Pictured:
        found = self.whole.batch(rows)
        if chance is None:
            return replace(found, pictures=found.pictures[:, : self.views], shown=found.shown[:, : self.views])
        chosen = torch.randperm(found.pictures.shape[1], generator=chance)[: self.views]
        numbers = 2 * torch.rand(len(self), len(chosen), NUMBERS, generator=chance)[rows] - 1
        chosen = uploaded(chosen, found.device)
        pictures, shown = distorted(found.pictures[:, chosen], found.shown[:, chosen], numbers)
        return replace(found, pictures=pictures, shown=shown)


def _by_part(pixels: Int[Tensor, "b n h w"], rows: Int[Tensor, "b t"] | None) -> Int[Tensor, "b t p c"]:
    """The pixels of each part of the cells ``rows``."""
    side = STRIDE // PARTS
    lines, columns = pixels.shape[2] // STRIDE, pixels.shape[3] // STRIDE
    parts = pixels.view(*pixels.shape[:2], lines, PARTS, side, columns, PARTS, side)
    cells = parts.permute(0, 1, 2, 5, 3, 6, 4, 7).reshape(len(pixels), -1, PARTS * PARTS, side * side)
    return cells if rows is None else cells.gather(1, rows[..., None, None].expand(-1, -1, *cells.shape[2:]))


def _borders(panels: Int[Tensor, "b n h w"]) -> Int[Tensor, "b n h w"]:
    """1 on pixels with another panel to the right or below, else 0; ``panels``: -1 off the garment."""
    right = functional.pad(panels, (0, 1), value=-1)[..., 1:]
    lower = functional.pad(panels, (0, 0, 0, 1), value=-1)[..., 1:, :]
    borders = [(panels >= 0) & (other >= 0) & (panels != other) for other in (right, lower)]
    return (borders[0] | borders[1]).long()


def _halved(channels: int, width: int) -> list[nn.Module]:
    """A layer that halves the picture."""
    return [nn.Conv2d(channels, width, 3, stride=2, padding=1, bias=False), nn.GroupNorm(GROUPS, width), nn.GELU()]


def distorted(
    pictures: UInt8[Tensor, "b n h w 3"], shown: UInt8[Tensor, "b n h w"], numbers: Float[Tensor, "b n 6"]
) -> tuple[UInt8[Tensor, "b n h w 3"], UInt8[Tensor, "b n h w"]]:
    """The pictures turned, enlarged and shifted, their channels weighted; at the border its pixels are repeated.

    ``shown``: labels of the pixels, which move alike. ``numbers``: turn, growth, two shifts, two weights of each
    picture in [-1, 1], on the CPU.
    """
    turn, growth, right, down, red, blue = uploaded(numbers.flatten(0, 1), pictures.device).unbind(-1)
    scale = torch.exp(MOST_GROWTH * growth)
    cosine, sine = scale * torch.cos(MOST_TURN * turn), scale * torch.sin(MOST_TURN * turn)
    rows = [cosine, -sine, MOST_SHIFT * right, sine, cosine, MOST_SHIFT * down]
    seen = pictures.flatten(0, 1).permute(0, 3, 1, 2).float()
    grid = functional.affine_grid(torch.stack(rows, dim=-1).view(-1, 2, 3), list(seen.shape), align_corners=False)
    moved = functional.grid_sample(seen, grid, padding_mode="border", align_corners=False)
    weights = torch.exp(MOST_WEIGHT * torch.stack([red, -0.5 * (red + blue), blue], dim=-1))
    found = (moved * weights[:, :, None, None]).clamp(0, 255).round().to(torch.uint8)
    labels = functional.grid_sample(
        shown.flatten(0, 1)[:, None].float(), grid, mode="nearest", padding_mode="border", align_corners=False
    )
    return found.permute(0, 2, 3, 1).reshape(pictures.shape), labels.to(torch.uint8).reshape(shown.shape)
