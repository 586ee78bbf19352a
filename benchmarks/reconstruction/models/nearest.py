"""The nearest neighbour, which a network has to beat: the pattern of the garment at the least chamfer distance."""

import torch
from jaxtyping import Float, Int
from torch import Tensor

from benchmarks.reconstruction.garments import GarmentSet
from gcd_dataset.records import Pattern

TASKS = ("T0", "T1", "T1-scan")
POINTS = 512  # of each garment
PAIRS_AT_ONCE = 2**26  # point pairs at once: 0.3 GB of distances


def answers(known: GarmentSet, unseen: GarmentSet, *, device: torch.device, workers: int = 0) -> list[Pattern]:
    """The pattern of the nearest known garment, for each unseen one."""
    rows = nearest_garments(positions(unseen, POINTS, device), positions(known, POINTS, device))
    return [known.pattern(row) for row in rows.tolist()]


def positions(garments: GarmentSet, count: int, device: torch.device) -> Float[Tensor, "g n 3"]:
    """Positions of the first points of garments [cm]."""
    return torch.from_numpy(garments.points[:, :count, :3]).to(device).float()


def nearest_garments(points: Float[Tensor, "b n 3"], others: Float[Tensor, "t n 3"]) -> Int[Tensor, " b"]:
    """The row of the nearest other garment, for each garment."""
    return torch.stack([chamfer_distances(garment, others).argmin() for garment in points])


def chamfer_distances(garment: Float[Tensor, "n 3"], others: Float[Tensor, "t m 3"]) -> Float[Tensor, " t"]:
    """Chamfer distance: the mean distance to the nearest point, added over both directions."""
    distances = []
    step = max(1, PAIRS_AT_ONCE // (len(garment) * others.shape[1]))
    for first in range(0, len(others), step):
        part = others[first : first + step]
        apart = torch.cdist(garment.expand(len(part), -1, -1), part)
        distances.append(apart.amin(dim=2).mean(dim=1) + apart.amin(dim=1).mean(dim=1))
    return torch.cat(distances)
