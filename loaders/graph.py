"""Patterns and meshes as graphs of index pairs, also for PyTorch Geometric."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal, get_args

import torch
from jaxtyping import Float, Int
from torch import Tensor

from gcd_dataset.errors import ConfigError
from gcd_dataset.loaders.base import Item
from gcd_dataset.loaders.batches import PackedBatch
from gcd_dataset.tensors import EdgeColumn, StitchColumn

Kind = Literal["mesh", "pattern"]


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
    """The seams of a garment, or of all garments of a batch, as a graph of edges and panels.

    Raises ``ConfigError`` without the fields ``edges`` and ``stitches``, or for a padded batch.
    """
    edges, stitches = _rows(garment, "edges"), _rows(garment, "stitches")
    joined = stitches[:, [StitchColumn.LEFT, StitchColumn.RIGHT]].long().T
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


def to_pyg(garment: Item | PackedBatch, graph: Kind = "mesh") -> Any:
    """The garment as a graph of PyTorch Geometric; a packed batch becomes one graph with ``batch`` and ``ptr``.

    - ``mesh``: ``Data`` with ``pos`` (``verts``, or ``box`` of an undraped garment) [cm], ``face`` [3, f] and
      ``edge_index``. PyTorch Geometric's own ``Batch`` accepts lists of these.
    - ``pattern``: ``HeteroData`` with nodes ``panel`` and ``edge``, whose ``x``, f32, are the rows of the pattern's
      arrays, edges without the column ``PANEL``; relations (edge, ``sewn``, edge), (panel, ``sewn``, panel), (edge,
      ``next``, edge), (edge, ``of``, panel).

    Raises ``ConfigError`` if ``torch_geometric`` is not installed, or a field that the graph needs is missing.
    """
    if graph not in get_args(Kind):
        raise ConfigError(f"graph={graph!r}: choose {' or '.join(get_args(Kind))}")
    try:
        from torch_geometric.data import Data, HeteroData
    except ImportError as error:
        raise ConfigError(
            "to_pyg needs torch_geometric, which is not installed: pip install torch_geometric"
        ) from error
    if graph == "mesh":
        field, faces = _vertices(garment), _rows(garment, "faces")
        return Data(
            pos=garment[field], face=faces.long().T, edge_index=mesh_edges(faces), **_membership(garment, field)
        )
    return _hetero(garment, HeteroData())


def _hetero(garment: Item | PackedBatch, data: Any) -> Any:
    seams = seam_graph(garment)
    # Not the first column of edges: a panel's row number, which depends on the batch, is no feature.
    features = {"panels": _rows(garment, "panels"), "edges": _rows(garment, "edges")[:, EdgeColumn.PANEL + 1 :]}
    for node, field in (("panel", "panels"), ("edge", "edges")):
        data[node].x = features[field].float()
        for name, value in _membership(garment, field).items():
            setattr(data[node], name, value)
    data["edge", "sewn", "edge"].edge_index = seams.sewn_edges
    data["panel", "sewn", "panel"].edge_index = seams.sewn_panels
    data["edge", "next", "edge"].edge_index = seams.next_edge
    data["edge", "of", "panel"].edge_index = seams.edge_panel
    return data


def _membership(garment: Item | PackedBatch, field: str) -> dict[str, Tensor]:
    """For a batch: ``batch``, the garment of each row, and ``ptr``, the start of each garment; for an item nothing."""
    if not isinstance(garment, PackedBatch):
        return {}
    return {"batch": garment.owners(field), "ptr": garment[f"{field}_ptr"]}


def _vertices(garment: Mapping[str, Any]) -> str:
    """The field that ``faces`` index: ``verts``, or ``box`` of an undraped garment."""
    for field in ("verts", "box"):
        if field in garment and len(garment[field]):
            return field
    raise ConfigError("the garment has faces but no vertices: load the field verts or box too")


def _rows(garment: Mapping[str, Any], field: str) -> Float[Tensor, "n *c"]:
    if field not in garment:
        raise ConfigError(f"the garment has no {field}: load that field too")
    if garment[field].ndim != 2:
        raise ConfigError(
            f"{field} of shape {tuple(garment[field].shape)}: give an item or a packed batch, not a padded one"
        )
    return garment[field]
