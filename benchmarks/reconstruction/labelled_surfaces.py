"""Draped meshes with the labels of their vertices, as batches on a device (task T4)."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
import torch
from jaxtyping import Bool, Int
from torch import Tensor

from benchmarks.reconstruction.derived import MIRRORED, MIRRORED_EDGES
from benchmarks.reconstruction.garments import GarmentSet
from benchmarks.reconstruction.surfaces import (
    SurfaceArrays,
    SurfaceBatch,
    SurfaceStore,
    drawn_turn,
    packed_rows,
    surface_of,
)
from gcd_dataset import metrics
from gcd_dataset.workers import parallel_map


@dataclass(frozen=True)
class LabelBatch:
    """Meshes with the labels of their vertices."""

    surface: SurfaceBatch
    panels: Bool[Tensor, "b n p"]
    """Whether a vertex belongs to a panel."""
    seams: Bool[Tensor, "b n s"]
    classes: Bool[Tensor, "b n c"]
    edges: Bool[Tensor, "b n l"]


def true_labels(garments: GarmentSet, k: int) -> metrics.TrueLabels:
    """The labels of garment ``k``, from its mesh."""
    ragged = garments.ragged
    mesh = {name: ragged[name][k] for name in ("faces", "panel_id", "seams", "labels")}
    stitches, classes = len(ragged["stitches"][k]), ragged["panel_classes"][k]
    return metrics.true_labels(len(ragged["verts"][k]), **mesh, classes=classes, stitches=stitches)


class LabelledSurfaces:
    """Meshes with labels on a device; batches are turned, mirrored and scaled at random."""

    def __init__(self, garments: GarmentSet, *, tokens: int, device: torch.device, workers: int = 0) -> None:
        ragged = garments.ragged
        meshes = ((ragged["verts"][k], ragged["faces"][k]) for k in range(len(garments)))
        surfaces = list(parallel_map(partial(_prepared, tokens), meshes, workers))
        self.store = SurfaceStore(surfaces, tokens=tokens, device=device)
        truths = [true_labels(garments, k) for k in range(len(garments))]
        self._labels = {
            name: _Members([getattr(truth, name) for truth in truths], device)
            for name in ("panels", "seams", "classes", "edges")
        }

    def __len__(self) -> int:
        return len(self.store)

    def batch(self, rows: Int[Tensor, " b"], chance: torch.Generator | None = None) -> LabelBatch:
        """The meshes ``rows``; mirror images have the labels of the other side."""
        surface, _ = self.store.batch(rows)
        room = int(surface.counts.max())
        labels = {name: labels.of(rows, room) for name, labels in self._labels.items()}
        if chance is not None:
            turn = drawn_turn(rows, len(self), chance, surface.positions.device)
            surface, mirrored = turn.of(surface), turn.mirrored[:, None, None]
            labels["classes"] = torch.where(mirrored, labels["classes"][..., MIRRORED], labels["classes"])
            labels["edges"] = torch.where(mirrored, labels["edges"][..., MIRRORED_EDGES], labels["edges"])
        return LabelBatch(surface, **labels)


def _prepared(tokens: int, mesh: tuple[np.ndarray, np.ndarray]) -> SurfaceArrays:
    return surface_of(*mesh, clusters=tokens)


class _Members:
    """Pairs of vertex and label, on a device."""

    def __init__(self, tables: Sequence[Bool[np.ndarray, "v n"]], device: torch.device) -> None:
        pairs = [np.argwhere(table) for table in tables]
        starts = np.concatenate([[0], np.cumsum([len(rows) for rows in pairs])])
        self._starts = torch.from_numpy(starts).to(device)
        self._pairs = torch.from_numpy(np.concatenate(pairs).astype(np.int32)).to(device)
        self._columns = max(1, *(table.shape[1] for table in tables))

    def of(self, rows: Int[Tensor, " b"], room: int) -> Bool[Tensor, "b n c"]:
        chosen, owners, _ = packed_rows(self._starts, rows.to(self._starts.device))
        pairs = self._pairs[chosen].long()
        found = torch.zeros(len(rows), room, self._columns, dtype=torch.bool, device=pairs.device)
        found[owners, pairs[:, 0], pairs[:, 1]] = True
        return found
