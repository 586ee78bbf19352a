"""Patterns and meshes as graphs of index pairs, as PyTorch Geometric takes them."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import torch
from jaxtyping import Float, Int
from torch import Tensor

from gcd_dataset.errors import ConfigError
from gcd_dataset.loaders.base import Item
from gcd_dataset.loaders.batches import PackedBatch
from gcd_dataset.tensors import EdgeColumn, StitchColumn


@dataclass(frozen=True)
class SeamGraph:
    """The seams of a pattern as directed index pairs [2, n], int64, of rows of ``panels`` and ``edges``.

    >>> from gcd_dataset.loaders import FakeGarments
    >>> graph = seam_graph(FakeGarments(1)[0])  # a front and a back, sewn together at both sides
    >>> graph.sewn_panels.tolist(), graph.sewn_edges.tolist()
    ([[0, 0, 1, 1], [1, 1, 0, 0]], [[1, 3, 7, 5], [7, 5, 1, 3]])
    """

    sewn_panels: Int[Tensor, "2 2*s"]
    """Pairs of panels joined by a seam, seam by seam, then the same pairs reversed."""
    sewn_edges: Int[Tensor, "2 2*s"]
    """Pairs of edges joined by a seam, seam by seam, then the same pairs reversed."""
    next_edge: Int[Tensor, "2 e"]
    """Each edge and its successor in the panel's outline."""
    edge_panel: Int[Tensor, "2 e"]
    """Each edge and its panel."""


def seam_graph(garment: Item | PackedBatch) -> SeamGraph:
    """The seams of a garment, or of all garments of a batch, as a graph of edges and panels; without those of lines.

    Raises ``ConfigError`` without the fields ``edges`` and ``stitches``, or for a padded batch.
    """
    edges, stitches = _rows(garment, "edges"), _rows(garment, "stitches")
    joined = stitches[:, [StitchColumn.LEFT, StitchColumn.RIGHT]].long().T
    joined = joined[:, (joined < len(edges)).all(dim=0)]
    sewn = torch.cat([joined, joined.flip(0)], dim=1)
    panel = edges[:, EdgeColumn.PANEL].long().contiguous()
    row = torch.arange(len(edges), device=edges.device)
    first = torch.searchsorted(panel, panel)  # edges are sorted by panel
    is_last = torch.cat([panel[1:] != panel[:-1], panel.new_ones(min(1, len(panel)), dtype=torch.bool)])
    successor = torch.where(is_last, first, row + 1)
    return SeamGraph(panel[sewn], sewn, torch.stack([row, successor]), torch.stack([row, panel]))


def mesh_edges(faces: Int[Tensor, "f 3"]) -> Int[Tensor, "2 n"]:
    """The edges of triangles as index pairs, each in both directions, unique and sorted.

    >>> mesh_edges(torch.tensor([[0, 1, 2]])).tolist()
    [[0, 0, 1, 1, 2, 2], [1, 2, 0, 2, 0, 1]]
    """
    corners = faces.long()
    pairs = torch.cat([corners[:, [0, 1]], corners[:, [1, 2]], corners[:, [2, 0]]])
    return torch.unique(torch.cat([pairs, pairs.flip(1)]), dim=0).T.contiguous()


def _rows(garment: Mapping[str, Any], field: str) -> Float[Tensor, "n *c"]:
    if field not in garment:
        raise ConfigError(f"the garment has no {field}: load that field too")
    if garment[field].ndim != 2:
        raise ConfigError(
            f"{field} of shape {tuple(garment[field].shape)}: give an item or a packed batch, not a padded one"
        )
    return garment[field]
