"""Batches of ragged garments: row numbers keep their meaning."""

import multiprocessing
import random
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from torch.utils._pytree import tree_map
from torch.utils.data import DataLoader

from gcd_dataset.errors import ConfigError
from gcd_dataset.loaders import (
    FakeGarments,
    GarmentDataset,
    PackedBatch,
    PaddedBatch,
    collate_packed,
    collate_padded,
    mesh_edges,
    seam_graph,
)
from gcd_dataset.loaders.batches import RAGGED, buffer_of, copy_tensor
from gcd_dataset.tensors import LineColumn
from tests.loaders.test_shards import same
from tests.shards.folders import fill

B = 5


@pytest.fixture(scope="module")
def items() -> list[Any]:
    return list(FakeGarments(B, seed=3))


@pytest.fixture(scope="module")
def batch(items: list[dict[str, Any]]) -> PackedBatch:
    return collate_packed(items)


POINTERS = (
    *(("faces", slice(0, 3), target) for target in ("verts", "box")),
    *((field, slice(0, 1), target) for field in ("labels", "seams") for target in ("verts", "box")),
    *(("seams", slice(1, 2), "stitches"), ("corners", slice(0, 3), "uv"), ("stitches", slice(0, 2), "edges")),
    *(("uv_vertex", None, "verts"), ("panel_id", None, "panels"), ("edges", slice(0, 1), "panels")),
)
"""Field, its columns of row numbers, and the field that these index."""


def test_seams_of_lines_keep_their_lines_in_a_batch(items: list[Any]) -> None:
    """Garments 1 and 3 have two lines each; their last stitch joins an edge to the second line."""
    lined = [dict(item) for item in items]
    for item in (lined[1], lined[3]):
        item["lines"] = torch.zeros(2, 17)
        item["lines"][:, LineColumn.START_X] = torch.tensor([1.0, 2.0]) + len(item["edges"])
        item["stitches"] = item["stitches"].clone()
        item["stitches"][-1, 1] = len(item["edges"]) + 1
    batch = collate_packed(lined)
    for number in (1, 3):
        last = batch["stitches"][batch["stitches_ptr"][number + 1] - 1, 1] - len(batch["edges"])
        assert batch["lines"][last, LineColumn.START_X] == 2.0 + len(lined[number]["edges"])
    for number, item in enumerate(lined):
        assert torch.equal(batch.garment(number)["stitches"], item["stitches"])
    assert seam_graph(lined[1]).sewn_edges.shape[1] == 2 * len(lined[1]["stitches"]) - 2
    without = [{field: value for field, value in item.items() if field != "lines"} for item in lined]
    with pytest.raises(ConfigError, match="stitches holds rows of lines: load the field lines too"):
        collate_packed(without)


@pytest.mark.parametrize("dtype", [torch.float32, torch.bfloat16])
def test_row_numbers_index_the_arrays_of_the_batch(dtype: torch.dtype, tmp_path: Path) -> None:
    """Of garments made on demand, and of the columns of stored ones, also in a type that NumPy lacks."""
    stored = GarmentDataset(fill(tmp_path, range(B)), dtype=dtype)
    items: list[Any] = list(stored.__getitems__(range(B)))
    assert len({len(item["verts"]) for item in items}) > 1
    for given in (items, stored.__getitems__(range(B))):
        before = [item["faces"].clone() for item in items]
        batch = collate_packed(given)
        assert all(torch.equal(item["faces"], kept) for item, kept in zip(items, before, strict=True))
        assert batch.body.shape == (B, *items[0]["body"].shape)
        assert batch.front.shape == (B, 3, 16, 16)
        assert batch.meta == [item["meta"] for item in items]
        for k, item in enumerate(items):
            own = {f: batch[f][slice(*batch[f"{f}_ptr"][k : k + 2].tolist())] for f in item if f"{f}_ptr" in batch}
            assert {*own} == {*RAGGED} & {*item}
            pointing = {field for field, _, _ in POINTERS}
            assert all(same(own[field], item[field]) for field in own if field not in pointing)
            for field, columns, target in POINTERS:
                ours, theirs = (rows[field] if columns is None else rows[field][:, columns] for rows in (own, item))
                assert same(ours - batch[f"{target}_ptr"][k].to(ours.dtype), theirs), field
            assert same(own["edges"][:, 1:], item["edges"][:, 1:])
            assert same(own["stitches"][:, 2], item["stitches"][:, 2])
            assert same(own["labels"][:, 1], item["labels"][:, 1])


def test_the_field_that_row_numbers_index_is_required(items: list[dict[str, Any]]) -> None:
    def only(*fields: str) -> list[dict[str, Any]]:
        return [{field: item[field] for field in fields} for item in items]

    assert set(collate_packed(only("verts", "faces"))) == {"batch_size", "verts", "verts_ptr", "faces", "faces_ptr"}
    for fields, missing in ((("faces",), "verts or box"), (("panel_id", "box"), "panels"), (("corners",), "uv")):
        with pytest.raises(ConfigError, match=f"{fields[0]} holds rows of .*load the field {missing}"):
            collate_packed(only(*fields))


def test_items_that_do_not_fit_together_are_refused(items: list[dict[str, Any]]) -> None:
    with pytest.raises(ConfigError, match="an empty batch"):
        collate_packed([])
    with pytest.raises(ConfigError, match="only some garments of the batch have verts"):
        collate_packed([items[0], {key: value for key, value in items[1].items() if key != "verts"}])
    undraped = {**items[1], "verts": torch.zeros(0, 3)}
    with pytest.raises(ConfigError, match="draped and undraped"):
        collate_packed([items[0], undraped])


def test_garments_without_a_mesh_or_a_picture_make_a_batch(items: list[dict[str, Any]]) -> None:
    """A picture without pixels is black among others."""
    mesh = ("faces", "uv", "panel_id", "labels", "seams", "corners", "uv_vertex", "box", "verts")
    bare = [{**item, **{field: item[field][:0] for field in mesh}} for item in items]
    assert collate_packed(bare)["faces"].shape == (0, 3)
    undraped = {**items[0], "front": torch.zeros((3, 0, 0), dtype=torch.uint8)}
    for collate in (collate_packed, collate_padded):
        front = collate([undraped, items[1]])["front"]
        assert torch.equal(front, torch.stack([torch.zeros_like(items[1]["front"]), items[1]["front"]]))
    assert collate_packed([undraped, undraped])["front"].shape == (2, 3, 0, 0)


def test_garment_k_of_a_packed_batch_is_item_k(items: list[dict[str, Any]], batch: PackedBatch) -> None:
    for k, item in enumerate(items):
        garment = batch.garment(k)
        assert garment.keys() == item.keys()
        assert all(same(garment[field], item[field]) for field in item)
    assert batch.batch_size == B
    with pytest.raises(IndexError):
        batch.garment(B)
    with pytest.raises(AttributeError, match="the batch has no repeated: load the fields"):
        _ = batch.repeated


def test_moved_and_pinned_batches_keep_their_class(items: list[dict[str, Any]], batch: PackedBatch) -> None:
    padded = collate_padded(items)
    for one in (batch, padded):
        moved = one.to("meta")
        assert type(moved) is type(one)
        assert moved["verts"].device.type == "meta"
        assert moved["meta"] == one["meta"]
        assert one["verts"].device.type == "cpu"
    loader = DataLoader(FakeGarments(4, fields=["verts"]), 2, collate_fn=collate_padded, num_workers=1)
    assert all(isinstance(loaded, PaddedBatch) for loaded in loader)


def test_nested_tensors_share_the_rows(items: list[dict[str, Any]], batch: PackedBatch) -> None:
    nested = batch.nested("verts")
    assert nested.values().data_ptr() == batch.verts.data_ptr()
    assert all(torch.equal(one, item["verts"]) for one, item in zip(nested.unbind(), items, strict=True))
    assert torch.equal(batch.owners("verts").bincount(), batch.verts_ptr.diff())
    for give, field in ((batch.nested, "body"), (batch.varlen, "points"), (batch.varlen, "sleeves")):
        with pytest.raises(ConfigError, match=rf"{field} is not a ragged field .* choose among panels"):
            give(field)


def test_padded_rows_are_those_of_the_garments(items: list[dict[str, Any]]) -> None:
    batch = collate_padded(items)
    for field in ("verts", "faces", "panels", "edges", "stitches", "labels", "panel_id"):
        longest = max(len(item[field]) for item in items)
        assert batch[field].shape[:2] == batch[f"{field}_mask"].shape == (B, longest)
        for k, item in enumerate(items):
            assert same(batch[field][k][batch[f"{field}_mask"][k]], item[field])
            assert (batch[field][k][~batch[f"{field}_mask"][k]] == (0 if item[field].is_floating_point() else -1)).all()
    assert batch.body.shape == (B, 8)
    assert batch["meta"] == [item["meta"] for item in items]


def test_rows_fixes_the_shape_of_padded_batches(items: list[dict[str, Any]]) -> None:
    batch = collate_padded(items, rows={"panels": 40, "edges": 200})
    assert batch.panels.shape == (B, 40, 14)
    assert batch.panels_mask.sum(1).tolist() == [len(item["panels"]) for item in items]
    with pytest.raises(ConfigError, match="a garment has 8 rows of edges, more than rows=4"):
        collate_padded(items, rows={"edges": 4})
    with pytest.raises(ConfigError, match="an empty batch"):
        collate_padded([])


def test_entries_that_a_transform_adds_are_listed() -> None:
    def add(item: dict[str, Any]) -> dict[str, Any]:
        return {"name": "x", "weight": torch.tensor(2.0), "mask": item["verts"][:, 0] > 0, "verts": item["verts"]}

    items: list[Any] = list(FakeGarments(B, fields=["verts"], transform=add))
    for batch in (collate_packed(items), collate_padded(items)):
        assert batch["name"] == B * ["x"]
        assert batch["weight"].tolist() == B * [2.0]
        assert [len(mask) for mask in batch["mask"]] == [len(item["verts"]) for item in items]


def test_copies_share_no_memory() -> None:
    """Also of types that NumPy lacks: a transform may add such a tensor."""
    lacking = (torch.rand(3).bfloat16(), torch.ones(3).to(torch.float8_e4m3fn), torch.tensor([1 + 2j, 3 - 1j]).conj())
    for value in (torch.rand(3, 4), torch.rand(3, 4).T, torch.zeros(0, 3, dtype=torch.int32), *lacking):
        copy = copy_tensor(value)
        assert copy.dtype == value.dtype
        assert copy.to(torch.complex64).tolist() == value.to(torch.complex64).tolist()
        assert not len(value) or copy.data_ptr() != value.data_ptr()


@pytest.mark.filterwarnings("ignore:The PyTorch API of nested tensors is in prototype")
@pytest.mark.parametrize("field", ["panels", "edges", "labels"])
def test_varlen_attention_equals_attention_per_garment(
    batch: PackedBatch, items: list[dict[str, Any]], field: str
) -> None:
    """``varlen`` attention over the batch equals attention within each garment."""
    values, cu_seqlens, max_seqlen = batch.varlen(field)
    assert cu_seqlens.dtype == torch.int32
    assert cu_seqlens.tolist()[0] == 0
    assert cu_seqlens.diff().tolist() == [len(item[field]) for item in items]
    assert max_seqlen == max(len(item[field]) for item in items)
    torch.manual_seed(0)
    heads = torch.nn.Linear(values.shape[1], 24)(values.float() / 100).unflatten(1, (2, 12))
    nested = torch.nested.nested_tensor_from_jagged(heads, cu_seqlens, max_seqlen=max_seqlen).transpose(1, 2)
    attended = torch.nn.functional.scaled_dot_product_attention(nested, nested, nested).transpose(1, 2)
    for k, part in enumerate(attended.unbind()):
        own = heads[cu_seqlens[k] : cu_seqlens[k + 1]].transpose(0, 1)
        alone = torch.nn.functional.scaled_dot_product_attention(own, own, own).transpose(0, 1)
        assert torch.allclose(part, alone, atol=1e-6)


@pytest.mark.parametrize("collate", [collate_packed, collate_padded])
def test_tree_map_returns_a_batch(items: list[dict[str, Any]], collate: Any) -> None:
    batch = collate(items)
    twice = tree_map(
        lambda leaf: 2 * leaf if isinstance(leaf, torch.Tensor) and leaf.is_floating_point() else leaf, batch
    )
    assert type(twice) is type(batch)
    assert list(twice) == list(batch)
    assert torch.equal(twice.verts, 2 * batch.verts)
    assert same(twice["meta"], batch["meta"])
    item = tree_map(lambda leaf: leaf, items[0])
    assert type(item) is type(items[0])
    assert same(item, items[0])


@pytest.mark.parametrize("collate", [collate_packed, collate_padded])
def test_a_batch_can_be_cast(items: list[dict[str, Any]], collate: Any) -> None:
    batch = collate(items)
    for half in (batch.to(torch.bfloat16), batch.to("cpu", torch.bfloat16), batch.to(dtype=torch.bfloat16)):
        assert type(half) is type(batch)
        for name, value in batch.items():
            if isinstance(value, torch.Tensor):
                wanted = torch.bfloat16 if value.is_floating_point() else value.dtype
                assert torch.equal(half[name], value.to(wanted)), name
                assert half[name].dtype == wanted
    with pytest.raises(ConfigError, match="give a floating type"):
        batch.to(dtype=torch.int32)


def test_a_missing_device_is_named(batch: PackedBatch) -> None:
    for device in (f"cuda:{torch.cuda.device_count()}", torch.device("cuda", torch.cuda.device_count())):
        with pytest.raises(ConfigError, match=r"device cuda:\d+: torch sees .*: give another, such as 'cuda' if"):
            batch.to(device)
    with pytest.raises(ConfigError, match="device 'gpu': give cpu, or a GPU as cuda:0"):
        batch.to("gpu")
    if not torch.cuda.is_available():
        with pytest.raises(ConfigError, match="torch sees no GPU"):
            batch.to("cuda")
        with pytest.raises(ConfigError, match="leave out pin_memory"):
            batch.pin_memory()


@pytest.mark.parametrize("collate", [collate_packed, collate_padded])
@pytest.mark.parametrize("item", [(torch.ones(2), 1), None, (), torch.ones(2), 7])
def test_an_item_that_is_no_dict_is_refused(collate: Any, item: Any) -> None:
    with pytest.raises(
        ConfigError, match=rf"a {type(item).__name__}, not a dict .* the transform return .* collate_fn="
    ):
        collate([item, item])


def test_a_tube_is_two_panels_sewn_twice(items: list[dict[str, Any]]) -> None:
    graph = seam_graph(items[0])
    assert graph.next_edge.tolist() == [[0, 1, 2, 3, 4, 5, 6, 7], [1, 2, 3, 0, 5, 6, 7, 4]]
    assert graph.edge_panel[1].tolist() == 4 * [0] + 4 * [1]
    assert set(zip(*graph.sewn_edges.tolist(), strict=True)) == {(1, 7), (7, 1), (3, 5), (5, 3)}
    assert torch.equal(graph.edge_panel[1][graph.sewn_edges], graph.sewn_panels)


def test_a_batch_is_the_disjoint_union_of_its_garments(items: list[dict[str, Any]], batch: PackedBatch) -> None:
    whole = seam_graph(batch)
    assert batch.owners("panels").tolist() == [number for number in range(B) for _ in range(2)]
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


def test_missing_fields_and_padded_batches_are_refused(items: list[dict[str, Any]]) -> None:
    with pytest.raises(ConfigError, match="the garment has no stitches: load that field too"):
        seam_graph({"edges": items[0]["edges"]})
    with pytest.raises(ConfigError, match="give an item or a packed batch"):
        seam_graph(collate_padded(items))


LARGE = 100_000


def marked(number: int, size: int) -> np.ndarray:
    memory = buffer_of(size)
    memory[:] = number % 251
    return memory


def test_buffers_and_views_in_use_are_not_shared() -> None:
    tensor = torch.from_numpy(buffer_of(LARGE)).view(torch.float32)[5:9]
    tensor.fill_(7.0)
    chance, held = random.Random(0), dict[int, np.ndarray]()
    for number in range(2000):
        held[number] = marked(number, chance.choice([100, LARGE, 3 * LARGE]))
        if len(held) > 20:
            del held[chance.choice(list(held))]
        assert all((memory == number % 251).all() for number, memory in list(held.items())[-3:])
    assert all((memory == number % 251).all() for number, memory in held.items())
    assert tensor.tolist() == 4 * [7.0]


def _sums(sizes: Sequence[int]) -> list[int]:
    return [int(marked(number, size).sum(dtype=np.int64)) for number, size in enumerate(sizes)]


def test_threads_and_forked_processes_do_not_share_buffers() -> None:
    sizes = [LARGE + number for number in range(60)]
    expected = [number % 251 * size for number, size in enumerate(sizes)]
    with ThreadPoolExecutor(4) as threads:
        assert all(sums == expected for sums in threads.map(_sums, 8 * [sizes]))
    held = marked(9, LARGE)
    with multiprocessing.get_context("fork").Pool(2) as processes:
        assert all(sums == expected for sums in processes.map(_sums, 4 * [sizes]))
    assert (held == 9).all()
