"""Garments for the tests of the reconstruction benchmark."""

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import pytest
import torch

from benchmarks.reconstruction.garments import GarmentSet, generated
from benchmarks.reconstruction.panel_targets import PanelTargets
from benchmarks.reconstruction.tasks import NAMED, SURFACES

SKIRTS: dict[str, Any] = {"meta": {"upper": "none", "bottom": {"options": ["SkirtCircle", "Skirt2"]}}}


@pytest.fixture(scope="session")
def six() -> GarmentSet:
    """Six skirts with coarse box meshes."""
    extra = (*NAMED, "box_labels")
    return generated(6, 0, points=512, extra=extra, drape=None, resolution=5.0, design=SKIRTS)


@pytest.fixture(scope="session")
def draped() -> GarmentSet:
    """Two skirts, draped, with all arrays of the tasks T4 to T6."""
    return generated(3, 0, points=64, extra=(*SURFACES, "person"), resolution=6.0, design=SKIRTS).select([0, 1])


@pytest.fixture(autouse=True)
def one_thread() -> Iterator[None]:
    """Tiny networks are fastest on one thread."""
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(threads)


def shuffled(true: PanelTargets) -> PanelTargets:
    """The same garments with their panels in another order."""
    order = torch.randperm(true.exists.shape[1], generator=torch.Generator().manual_seed(1))
    names = ("exists", "corners", "bends", "extents", "centres", "rotations", "edge_counts", "labels", "slimness")
    place = order.argsort()[true.edge_panels.long().clamp(min=0)].to(true.edge_panels.dtype)
    panels = {name: getattr(true, name)[:, order] for name in names}
    return replace(true, **panels, edge_panels=torch.where(true.edge_panels < 0, true.edge_panels, place))


def started_elsewhere(true: PanelTargets) -> PanelTargets:
    """The same garments with every loop started two corners later."""
    counts = true.edge_counts.clamp(min=1)[..., None]
    slot = torch.arange(true.corners.shape[2])
    at = torch.where(slot < counts, (slot + 2) % counts, slot)
    garment, query = torch.arange(len(at))[:, None, None], torch.arange(at.shape[1])[:, None]
    count = counts[..., 0].gather(1, true.edge_panels.long().clamp(min=0))
    slots = torch.where(true.edge_panels < 0, 0, (true.edge_slots.long() - 2) % count).to(true.edge_slots.dtype)
    return replace(
        true, corners=true.corners[garment, query, at], bends=true.bends[garment, query, at], edge_slots=slots
    )
