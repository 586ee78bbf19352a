"""Box meshes or coarse drapes with their bodies and drapes, as batches on a device (task T6)."""

from dataclasses import dataclass
from functools import partial

import numpy as np
import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from benchmarks.reconstruction.derived import CENTRE, MIRRORED_EDGES
from benchmarks.reconstruction.drapes import DrapedVertices, redraped
from benchmarks.reconstruction.garments import GarmentSet
from benchmarks.reconstruction.surfaces import METRE, SurfaceArrays, SurfaceBatch, SurfaceStore, drawn_turn, surface_of
from benchmarks.reconstruction.wearers import body_points
from gcd_dataset.tensors import EDGE_LABELS, PANEL_LABELS, PanelColumn
from gcd_dataset.workers import parallel_map

GIVEN = len(EDGE_LABELS) + len(PANEL_LABELS) + 1  # numbers of a vertex: edge labels, panel labels, whether on a seam


@dataclass(frozen=True)
class DrapeBatch:
    """Box meshes, or coarse drapes, with their bodies and drapes."""

    surface: SurfaceBatch
    given: Float[Tensor, "v g"]
    """Edge labels, panel labels, whether on a seam."""
    body: Float[Tensor, "b n 6"]
    """Points of the skin [m] and normals, spread evenly: any first part is, too."""
    draped: Float[Tensor, "v 3"]
    """[m]"""
    ms: Float[Tensor, " b"]
    """Time of each coarse drape [ms], or 0."""


class DrapedSurfaces:
    """Box meshes, bodies and drapes on a device; batches are turned and mirrored at random.

    ``coarse``: edges of a drape [cm] that takes the place of the box mesh; 0: none.
    """

    def __init__(
        self, garments: GarmentSet, *, tokens: int, body: int, coarse: int, device: torch.device, workers: int = 0
    ) -> None:
        if coarse:
            begun = redraped(garments, spacing=float(coarse), device=device, workers=workers)
        else:
            begun = [DrapedVertices(garments.ragged["box"][k], 0.0) for k in range(len(garments))]
        self._ms = torch.tensor([one.ms for one in begun], device=device)
        meshes = (mesh_of(garments, k, one.vertices) for k, one in enumerate(begun))
        surfaces = list(parallel_map(partial(prepared, tokens), meshes, workers))
        self.store = SurfaceStore(surfaces, tokens=tokens, device=device)
        labels = np.concatenate([labels_of(garments, k) for k in range(len(garments))])
        self._given = torch.from_numpy(labels).to(device)
        drapes = [(garments.ragged["verts"][k] - CENTRE) / METRE for k in range(len(garments))]
        self._draped = torch.from_numpy(np.concatenate(drapes).astype(np.float32)).to(device)
        self._body = torch.from_numpy(np.stack(body_points(garments, body, workers=workers))).to(device)

    def __len__(self) -> int:
        return len(self.store)

    def batch(self, rows: Int[Tensor, " b"], chance: torch.Generator | None = None) -> DrapeBatch:
        """The garments ``rows``."""
        surface, chosen = self.store.batch(rows)
        own = rows.to(chosen.device)
        batch = DrapeBatch(surface, self._given[chosen].float(), self._body[own], self._draped[chosen], self._ms[own])
        if chance is None:
            return batch
        turn = drawn_turn(rows, len(self), chance, chosen.device, growth=0.0, jitter=0.0)
        given = batch.given.clone()
        labels = given[:, : len(EDGE_LABELS)]
        swapped = turn.mirrored[surface.garments, None]
        given[:, : len(EDGE_LABELS)] = torch.where(swapped, labels[:, MIRRORED_EDGES], labels)
        body = torch.cat([part @ turn.matrices.transpose(1, 2) for part in torch.split(batch.body, 3, dim=-1)], dim=-1)
        draped = (turn.matrices[surface.garments] @ batch.draped[..., None])[..., 0]
        return DrapeBatch(turn.of(surface), given, body, draped, batch.ms)


def mesh_of(garments: GarmentSet, k: int, vertices: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Vertices, faces, and the flat length of the edge after each corner of each face [cm]."""
    ragged = garments.ragged
    flat = ragged["uv"][k].astype(float)[ragged["corners"][k]]
    lengths = np.linalg.norm(flat[:, [1, 2, 0]] - flat, axis=-1)
    return vertices, ragged["faces"][k], lengths


def prepared(tokens: int, mesh: tuple[np.ndarray, np.ndarray, np.ndarray]) -> SurfaceArrays:
    """A result of ``mesh_of``, with so many clusters."""
    vertices, faces, lengths = mesh
    return surface_of(vertices, faces, clusters=tokens, lengths=lengths)


def labels_of(garments: GarmentSet, k: int) -> Bool[np.ndarray, "v g"]:
    """Edge labels, labels of the panels, and whether on a seam, for each vertex."""
    ragged = garments.ragged
    found = np.zeros((len(ragged["box"][k]), GIVEN), bool)
    labels = ragged["labels"][k]
    labels = labels[labels[:, 1] < len(EDGE_LABELS)]
    found[labels[:, 0], labels[:, 1]] = True
    roles = ragged["panels"][k][:, PanelColumn.LABEL].astype(int)
    roles = np.where(roles < len(PANEL_LABELS), roles, 0)
    found[ragged["faces"][k].ravel(), len(EDGE_LABELS) + np.repeat(roles[ragged["panel_id"][k]], 3)] = True
    found[ragged["seams"][k][:, 0], -1] = True
    return found
