"""Our solver on the meshes of task T6: its time, and the error that another machine's rounding makes."""

import torch

from benchmarks.reconstruction.drapes import DrapedVertices, redraped
from benchmarks.reconstruction.garments import GarmentSet

TASKS = ("T6",)


def answers(known: GarmentSet, unseen: GarmentSet, *, device: torch.device, workers: int = 0) -> list[DrapedVertices]:
    """Each unseen garment, draped again at the resolution of its recipe."""
    resolution = float(unseen.recipe["recipe"]["resolution"])
    return redraped(unseen, spacing=resolution, device=device)
