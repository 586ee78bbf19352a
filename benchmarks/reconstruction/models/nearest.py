"""Nearest-neighbour references, which a network has to beat."""

import torch
from jaxtyping import Float, Int
from torch import Tensor

__all__ = ["chamfer_distances", "most_typical", "nearest_garments"]

PAIRS_AT_ONCE = 2**26  # point pairs at once: 0.3 GB of distances


def nearest_garments(points: Float[Tensor, "b n 3"], others: Float[Tensor, "t n 3"]) -> Int[Tensor, " b"]:
    """The row of the nearest other garment, for each garment."""
    return torch.stack([chamfer_distances(garment, others).argmin() for garment in points])


def most_typical(points: Float[Tensor, "b n 3"]) -> int:
    """The row of the garment with the least mean distance to the rest: an answer that ignores the input."""
    return int(torch.stack([chamfer_distances(garment, points) for garment in points]).mean(dim=0).argmin())


def chamfer_distances(garment: Float[Tensor, "n 3"], others: Float[Tensor, "t m 3"]) -> Float[Tensor, " t"]:
    """Chamfer distance: the mean distance to the nearest point, added over both directions."""
    distances = []
    step = max(1, PAIRS_AT_ONCE // (len(garment) * others.shape[1]))
    for first in range(0, len(others), step):
        part = others[first : first + step]
        apart = torch.cdist(garment.expand(len(part), -1, -1), part)
        distances.append(apart.amin(dim=2).mean(dim=1) + apart.amin(dim=1).mean(dim=1))
    return torch.cat(distances)
