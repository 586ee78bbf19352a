"""Ragged garments in one batch: every row number still means what it meant alone."""

from typing import Any

import pytest
import torch
from torch.utils.data import DataLoader

from gcd_dataset.errors import ConfigError
from gcd_dataset.loaders import FakeGarments, collate_packed
from gcd_dataset.tensors import EdgeColumn

B = 5


@pytest.fixture(scope="module")
def items() -> list[dict[str, Any]]:
    ds = FakeGarments(B, seed=3)
    return [ds[i] for i in range(B)]


@pytest.fixture(scope="module")
def batch(items: list[dict[str, Any]]) -> dict[str, Any]:
    return collate_packed(items)


def of(batch: dict[str, Any], field: str, k: int) -> torch.Tensor:
    """Garment k's rows."""
    first, last = batch[f"{field}_ptr"][k : k + 2].tolist()
    rows: torch.Tensor = batch[field][first:last]
    return rows


def test_garments_differ_in_size(items: list[dict[str, Any]]) -> None:
    assert len({len(item["verts"]) for item in items}) > 1


def test_arrays_are_those_of_the_garments(items: list[dict[str, Any]], batch: dict[str, Any]) -> None:
    assert batch["batch_size"] == B
    for k, item in enumerate(items):
        for field in ("verts", "box", "uv", "panels"):
            assert torch.equal(of(batch, field, k), item[field])


def test_faces_still_point_at_their_vertices(items: list[dict[str, Any]], batch: dict[str, Any]) -> None:
    for k, item in enumerate(items):
        for positions in ("verts", "box"):
            assert torch.equal(batch[positions][of(batch, "faces", k)], item[positions][item["faces"]])
        assert torch.equal(batch["uv"][of(batch, "corners", k)], item["uv"][item["corners"]])
    assert torch.equal(batch["uv_vertex"][batch["corners"]], batch["faces"])


def test_seams_and_labels_still_point_at_vertices_and_stitches(
    items: list[dict[str, Any]], batch: dict[str, Any]
) -> None:
    for k, item in enumerate(items):
        seams, labels = of(batch, "seams", k), of(batch, "labels", k)
        assert torch.equal(batch["verts"][seams[:, 0]], item["verts"][item["seams"][:, 0]])
        start = batch["stitches_ptr"][k]
        assert torch.equal(seams[:, 1] - start, item["seams"][:, 1])
        assert torch.equal(batch["verts"][labels[:, 0]], item["verts"][item["labels"][:, 0]])
        assert torch.equal(labels[:, 1], item["labels"][:, 1])


def test_the_pattern_still_hangs_together(items: list[dict[str, Any]], batch: dict[str, Any]) -> None:
    for k, item in enumerate(items):
        stitches, edges, panels = of(batch, "stitches", k), of(batch, "edges", k), of(batch, "panel_id", k)
        assert torch.equal(
            batch["edges"][stitches[:, :2]][..., 1:], item["edges"][item["stitches"][:, :2].long()][..., 1:]
        )
        assert torch.equal(stitches[:, 2], item["stitches"][:, 2])
        own = edges[:, EdgeColumn.PANEL].long()
        assert torch.equal(batch["panels"][own], item["panels"][item["edges"][:, EdgeColumn.PANEL].long()])
        assert torch.equal(batch["panels"][panels], item["panels"][item["panel_id"]])


def test_items_are_left_as_they_were(items: list[dict[str, Any]]) -> None:
    before = [item["faces"].clone() for item in items]
    collate_packed(items)
    assert all(torch.equal(item["faces"], kept) for item, kept in zip(items, before, strict=True))


def test_one_shape_is_stacked_and_json_listed(items: list[dict[str, Any]], batch: dict[str, Any]) -> None:
    assert batch["body"].shape == (B, *items[0]["body"].shape)
    assert batch["front"].shape == (B, 3, 16, 16)
    assert [meta["index"] for meta in batch["meta"]] == list(range(B))


def test_a_field_pointed_to_must_be_there(items: list[dict[str, Any]]) -> None:
    def only(*fields: str) -> list[dict[str, Any]]:
        return [{field: item[field] for field in fields} for item in items]

    assert set(collate_packed(only("verts", "faces"))) == {"batch_size", "verts", "verts_ptr", "faces", "faces_ptr"}
    for fields, missing in ((("faces",), "verts or box"), (("panel_id", "box"), "panels"), (("corners",), "uv")):
        with pytest.raises(ConfigError, match=f"{fields[0]} holds rows of .*load the field {missing}"):
            collate_packed(only(*fields))


def test_what_does_not_go_together_is_refused(items: list[dict[str, Any]]) -> None:
    with pytest.raises(ConfigError, match="a batch of no garments"):
        collate_packed([])
    with pytest.raises(ConfigError, match="only some garments of the batch have verts"):
        collate_packed([items[0], {key: value for key, value in items[1].items() if key != "verts"}])
    undraped = {**items[1], "verts": torch.zeros(0, 3)}
    with pytest.raises(ConfigError, match="draped and undraped"):
        collate_packed([items[0], undraped])


def test_garments_without_a_mesh_make_a_batch(items: list[dict[str, Any]]) -> None:
    mesh = ("faces", "uv", "panel_id", "labels", "seams", "corners", "uv_vertex", "box", "verts")
    bare = [{**item, **{field: item[field][:0] for field in mesh}} for item in items]
    assert collate_packed(bare)["faces"].shape == (0, 3)


def test_a_batch_can_be_pinned(batch: dict[str, Any]) -> None:
    ds = FakeGarments(4)
    loader = DataLoader(ds, batch_size=2, collate_fn=collate_packed, pin_memory=torch.cuda.is_available())
    assert all(loaded["verts"].is_pinned() == torch.cuda.is_available() for loaded in loader)
    moved = {name: value.to("cpu") for name, value in batch.items() if isinstance(value, torch.Tensor)}
    assert {"verts", "verts_ptr", "faces", "front"} <= moved.keys()
