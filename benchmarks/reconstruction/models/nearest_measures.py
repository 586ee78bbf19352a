"""The nearest neighbour of task T5: the measures of the known body at the least chamfer distance of the scans."""

import numpy as np
import torch

from benchmarks.reconstruction.garments import GarmentSet
from benchmarks.reconstruction.models.measures import scans_of
from benchmarks.reconstruction.models.nearest import POINTS, nearest_garments

TASKS = ("T5",)


def answers(known: GarmentSet, unseen: GarmentSet, *, device: torch.device, workers: int = 0) -> list[np.ndarray]:
    """The measures of the nearest known body, for each unseen one."""
    scans = (scans_of(garments, workers=workers) for garments in (unseen, known))
    ours, theirs = (scan[:, :POINTS, :3].to(device) for scan in scans)
    return [known.measures[row].astype(float) for row in nearest_garments(ours, theirs).tolist()]
