"""The loss of the network of stitches, the changes of its garments in training, and the seams that are given."""

from dataclasses import replace

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor
from torch.nn import functional

from benchmarks.reconstruction.stitching.edge_shapes import edges_before
from benchmarks.reconstruction.stitching.graphs import CUT_BINS, EdgeBatch
from benchmarks.reconstruction.stitching.net import StitchLogits

SPREAD = 0.5  # range of the random numbers that vary the order in which seams are given


def mirrored(batch: EdgeBatch, chosen: Bool[Tensor, " b"]) -> EdgeBatch:
    """The chosen garments as their mirror images: points, loops and cuts run the other way."""
    one, two = chosen[:, None], chosen[:, None, None]
    flipped = _mirrored(batch.points.flip(2))
    turned = torch.where(batch.cuts >= 0, 1 - batch.cuts, batch.cuts)
    return replace(
        batch,
        points=torch.where(two[..., None], flipped, batch.points),
        following=torch.where(one, edges_before(batch.following), batch.following),
        cuts=torch.where(two, turned, batch.cuts),
    )


def scaled(batch: EdgeBatch, factors: Float[Tensor, " b"]) -> EdgeBatch:
    """The garments in other sizes."""
    wide = factors[:, None, None, None]
    return replace(batch, points=batch.points * wide, lengths=batch.lengths * factors[:, None])


def revealed(
    batch: EdgeBatch, shares: Float[Tensor, " b"], sure: Float[Tensor, "b e"], draw: Float[Tensor, "b e"]
) -> Int[Tensor, "b e"]:
    """Partners of a share of the true seams of each garment, -1 for the others.

    Seams of a high probability ``sure`` come first, as in a prediction; ``draw``, from [0, 1), varies their order.
    """
    partners = batch.partners
    sewn, partner = partners >= 0, partners.clamp(min=0)
    sure = 0.5 * (sure + sure.gather(1, partner))
    varied = SPREAD * torch.minimum(draw, draw.gather(1, partner))
    place = torch.where(sewn, varied - sure, torch.inf).argsort(dim=1).argsort(dim=1)
    shown = sewn & (place < shares[:, None] * sewn.sum(dim=1, keepdim=True))
    return torch.where(shown & shown.gather(1, partner), partners, -1)


def edge_noise(seeds: Int[Tensor, " r"], count: int) -> Float[Tensor, "r e"]:
    """Random numbers in [0, 1) for each of the seeds, which are below 2**31; a hash, the same on every device."""
    mixed = seeds[:, None] + 0x9E3779B1 * torch.arange(1, count + 1, device=seeds.device) & 0xFFFFFFFF
    for _ in range(2):  # https://nullprogram.com/blog/2018/07/31
        mixed = ((mixed >> 16) ^ mixed) * 0x45D9F3B & 0xFFFFFFFF
    return (((mixed >> 16) ^ mixed) >> 8).float() / 2**24


def stitch_loss(scores: StitchLogits, batch: EdgeBatch, known: Int[Tensor, "b e"]) -> dict[str, tuple[Tensor, Tensor]]:
    """Sums and counts of the loss terms by name.

    An edge without a partner in a garment with joined edges may be sewn to several: its choice is not counted.
    """
    valid, partners = batch.valid, batch.partners
    whole = (batch.cuts >= 0).flatten(1).any(dim=1)
    asked = valid & (known < 0) & (~whole[:, None] | (partners >= 0))
    choices = scores.log_probabilities()
    target = torch.where(partners >= 0, partners, choices.shape[-1] - 1)
    chosen = -choices.gather(2, target[..., None])[..., 0]
    logits = scores.right_wrong.gather(2, partners.clamp(min=0)[..., None])[..., 0]
    turned = functional.binary_cross_entropy_with_logits(logits, batch.right_wrong.float(), reduction="none")
    bins, there = _cut_bins(batch.cuts)
    heat = torch.zeros_like(scores.cuts).scatter_reduce_(2, bins, there.float(), "amax")
    cut = functional.binary_cross_entropy_with_logits(scores.cuts, heat, reduction="none").sum(-1)
    missed = (scores.cut_offsets.gather(2, bins) - (batch.cuts * CUT_BINS - bins)).abs()
    return {
        "pairs": _sum(chosen, asked),
        "right_wrong": _sum(turned, asked & (partners >= 0)),
        "cuts": (torch.where(valid, cut, 0.0).sum(), there.sum()),  # few edges have cuts: a mean over all would vanish
        "cut_offsets": _sum(missed, there & valid[..., None]),
    }


def _mirrored(points: Float[Tensor, "*b d"]) -> Float[Tensor, "*b d"]:
    """The points with negative x."""
    return torch.cat([-points[..., :1], points[..., 1:]], dim=-1)


def _cut_bins(cuts: Float[Tensor, "b e c"]) -> tuple[Int[Tensor, "b e c"], Bool[Tensor, "b e c"]]:
    return (cuts * CUT_BINS).long().clamp(0, CUT_BINS - 1), cuts >= 0


def _sum(values: Tensor, where: Tensor) -> tuple[Tensor, Tensor]:
    return torch.where(where, values, 0.0).sum(), where.sum()
