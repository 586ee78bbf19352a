"""Garments as graphs: seams become edges, and a batch is a disjoint union."""

import sys
from types import ModuleType, SimpleNamespace
from typing import Any

import pytest
import torch

from gcd_dataset.errors import ConfigError
from gcd_dataset.loaders import (
    FakeGarments,
    PackedBatch,
    collate_packed,
    collate_padded,
    mesh_edges,
    seam_graph,
    to_pyg,
)

B = 3


@pytest.fixture(scope="module")
def items() -> list[Any]:
    return [FakeGarments(B)[i] for i in range(B)]


@pytest.fixture(scope="module")
def batch(items: list[dict[str, Any]]) -> PackedBatch:
    return collate_packed(items)


class Hetero(dict[Any, SimpleNamespace]):
    """The part of ``HeteroData`` that is used."""

    def __missing__(self, key: Any) -> SimpleNamespace:
        return self.setdefault(key, SimpleNamespace())


@pytest.fixture
def pyg(monkeypatch: pytest.MonkeyPatch) -> None:
    """A stand-in for PyTorch Geometric that records its arguments."""
    package, data = ModuleType("torch_geometric"), ModuleType("torch_geometric.data")
    vars(data).update(Data=SimpleNamespace, HeteroData=Hetero)
    monkeypatch.setitem(sys.modules, "torch_geometric", package)
    monkeypatch.setitem(sys.modules, "torch_geometric.data", data)


def test_a_tube_is_two_panels_sewn_twice(items: list[dict[str, Any]]) -> None:
    graph = seam_graph(items[0])
    assert graph.next_edge.tolist() == [[0, 1, 2, 3, 4, 5, 6, 7], [1, 2, 3, 0, 5, 6, 7, 4]]
    assert graph.edge_panel[1].tolist() == 4 * [0] + 4 * [1]
    pairs = set(zip(*graph.sewn_edges.tolist(), strict=True))
    assert pairs == {(1, 7), (7, 1), (3, 5), (5, 3)}
    assert torch.equal(graph.edge_panel[1][graph.sewn_edges], graph.sewn_panels)


def test_a_batch_is_the_disjoint_union_of_its_garments(items: list[dict[str, Any]], batch: PackedBatch) -> None:
    whole = seam_graph(batch)
    for name, first in (("next_edge", "edges"), ("sewn_edges", "edges"), ("sewn_panels", "panels")):
        moved = [getattr(seam_graph(item), name) + batch[f"{first}_ptr"][k] for k, item in enumerate(items)]
        ours, theirs = (sorted(pairs.T.tolist()) for pairs in (getattr(whole, name), torch.cat(moved, dim=1)))
        assert ours == theirs


def test_mesh_edges_satisfy_eulers_formula(items: list[dict[str, Any]]) -> None:
    """For a tube open at both ends: vertices + faces = edges."""
    for item in items:
        pairs = mesh_edges(item["faces"])
        assert len(item["verts"]) + len(item["faces"]) == pairs.shape[1] / 2
        assert torch.equal(torch.unique(pairs.flip(0), dim=1), pairs)
        assert (pairs[0] != pairs[1]).all()


@pytest.mark.usefixtures("pyg")
def test_meshes_for_pyg(items: list[dict[str, Any]], batch: PackedBatch) -> None:
    one, all_ = to_pyg(items[0]), to_pyg(batch)
    assert torch.equal(one.pos[one.face], items[0]["verts"][items[0]["faces"].T])
    assert not hasattr(one, "batch")
    assert torch.equal(all_.ptr, batch.verts_ptr)
    assert torch.equal(all_.batch[all_.edge_index[0]], all_.batch[all_.edge_index[1]])
    assert all_.face.dtype == all_.edge_index.dtype == torch.int64
    undraped = {**items[0], "verts": items[0]["verts"][:0]}
    assert torch.equal(to_pyg(undraped).pos, items[0]["box"])


@pytest.mark.usefixtures("pyg")
def test_patterns_for_pyg(items: list[dict[str, Any]], batch: PackedBatch) -> None:
    data = to_pyg(batch, "pattern")
    assert data["panel"].x.shape == (2 * B, 14)
    alone = to_pyg(items[2], "pattern")["edge"].x
    assert alone.dtype == torch.float32
    assert torch.equal(data["edge"].x[-len(alone) :], alone)  # features do not depend on the batch
    assert data["panel"].batch.tolist() == [0, 0, 1, 1, 2, 2]
    of = data["edge", "of", "panel"].edge_index
    assert torch.equal(data["panel"].batch[of[1]], data["edge"].batch[of[0]])
    assert data["edge", "sewn", "edge"].edge_index.shape == (2, 4 * B)
    assert to_pyg(items[0], "pattern")["edge", "next", "edge"].edge_index.shape == (2, 8)


def test_unknown_graphs_and_missing_fields_are_refused(
    monkeypatch: pytest.MonkeyPatch, items: list[dict[str, Any]]
) -> None:
    monkeypatch.setitem(sys.modules, "torch_geometric", None)
    with pytest.raises(ConfigError, match="torch_geometric, which is not installed"):
        to_pyg(items[0])
    with pytest.raises(ConfigError, match="choose mesh or pattern"):
        to_pyg(items[0], "points")  # type: ignore[arg-type]
    with pytest.raises(ConfigError, match="the garment has no stitches: load that field too"):
        seam_graph({"edges": items[0]["edges"]})
    with pytest.raises(ConfigError, match="give an item or a packed batch"):
        seam_graph(collate_padded(items))


@pytest.mark.usefixtures("pyg")
def test_a_mesh_needs_vertices(items: list[dict[str, Any]]) -> None:
    with pytest.raises(ConfigError, match="the garment has faces but no vertices"):
        to_pyg({"faces": items[0]["faces"]})
