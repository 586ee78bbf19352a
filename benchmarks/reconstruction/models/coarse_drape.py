"""A peer of task T6: our solver at 3 cm, interpolated to the mesh of the task."""

import torch

from benchmarks.reconstruction.drapes import DrapedVertices, redraped
from benchmarks.reconstruction.garments import GarmentSet

TASKS = ("T6",)
SPACING = 3.0  # cm


def answers(known: GarmentSet, unseen: GarmentSet, *, device: torch.device, workers: int = 0) -> list[DrapedVertices]:
    """Each unseen garment, draped coarsely."""
    return redraped(unseen, spacing=SPACING, device=device)
