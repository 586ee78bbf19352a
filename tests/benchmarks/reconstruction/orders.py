"""The same garments in other orders of panels and corners."""

from dataclasses import replace

import torch

from benchmarks.reconstruction.panel_targets import PanelTargets


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
