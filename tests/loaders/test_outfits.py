"""Items and batches of outfits: several garments on one body."""

from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from gcd_dataset.errors import ConfigError
from gcd_dataset.generator.body import build_body, neutral_shape
from gcd_dataset.generator.render import draw_appearance, scene_of_sample
from gcd_dataset.generator.render.materials import looks_of
from gcd_dataset.loaders import (
    FakeGarments,
    GarmentDataset,
    GarmentLoader,
    MixedDataset,
    OutfitCloth,
    Scan,
    Sketch,
    Views,
    Yaw,
    collate_packed,
    collate_padded,
)
from gcd_dataset.outfits import joined
from gcd_dataset.shards.layout import of_garment
from gcd_dataset.tensors import EdgeColumn, LineColumn
from tests.shards.folders import fake_outfit, fill_outfits

COUNTS = (1, 2, 3, 2)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return fill_outfits(tmp_path_factory.mktemp("outfits"), COUNTS)


def items_of(folder: Path, **options: Any) -> list[dict[str, Any]]:
    return [*map(dict, GarmentDataset(folder, cache_dir=folder / "cache", **options))]


def triangles(garment: Any) -> torch.Tensor:
    corners: torch.Tensor = garment["verts"][garment["faces"].long()]
    return corners


def test_row_numbers_of_each_garment_index_its_own_rows_of_the_batch(folder: Path) -> None:
    whole = GarmentDataset(folder, cache_dir=folder / "cache")
    items = items_of(folder)
    for batch in (collate_packed(items), collate_packed(whole.__getitems__(range(4)))):
        for number in range(3):
            apart = torch.cat([triangles(of_garment(number, item)) for item in items])
            assert torch.equal(triangles(of_garment(number, batch)), apart)
        for number, item in enumerate(items):
            again = batch.garment(number)
            assert all(torch.equal(again[name], item[name]) for name in item if isinstance(item[name], torch.Tensor))
        assert batch.varlen("g2_verts").cu_seqlens.diff().tolist() == [len(item["g2_verts"]) for item in items]
    padded = collate_padded(items)
    assert (padded["g1_faces"][1, : len(items[1]["g1_faces"])] == items[1]["g1_faces"]).all()
    assert padded["g1_faces_mask"].sum(dim=1).tolist() == [len(item["g1_faces"]) for item in items]


def test_outfits_are_joined_to_one_cloth(folder: Path) -> None:
    """The joined triangles are those of the garments in order; seams join edges of one garment."""
    apart, joined = items_of(folder), items_of(folder, transform=OutfitCloth())
    for item, whole, count in zip(apart, joined, COUNTS, strict=True):
        garments = [of_garment(number, item) for number in range(3)]
        assert torch.equal(triangles(whole), torch.cat([triangles(garment) for garment in garments]))
        assert torch.equal(whole["garment_id"].bincount(), torch.tensor([len(g["verts"]) for g in garments[:count]]))
        assert whole["panel_garment"].tolist() == [number for number in range(count) for _ in range(2)]
        assert len(whole["meta"]["panel_names"]) == len(whole["panels"]) == 2 * count
        assert whole["meta"]["panel_names"][2 * (count - 1)] == ("g2_front", "g1_front", "front")[3 - count]
        of_edge = whole["panel_garment"][whole["edges"][:, EdgeColumn.PANEL].long()]
        left, right = of_edge[whole["stitches"][:, :2].long()].T
        assert torch.equal(left, right)
        assert torch.equal(whole["points"], item["points"])
        assert not any(name.startswith("g1_") for name in whole)


def test_fake_outfits_have_the_fields_of_a_set_of_outfits(folder: Path) -> None:
    """Also the types and row shapes of each; a fifth outfit has two garments, the next three."""
    outfits, stored = FakeGarments(6, garments=3), GarmentDataset(folder, cache_dir=folder / "cache")
    assert outfits.fields == stored.fields
    for fake, real in zip(outfits, stored, strict=False):
        assert fake.keys() == real.keys() and fake["meta"].keys() == real["meta"].keys()
        for name, value in dict[str, Any](real).items():
            if isinstance(value, torch.Tensor):
                assert (fake[name].dtype, fake[name].shape[1:]) == (value.dtype, value.shape[1:]), name  # type: ignore[literal-required]
    whole = OutfitCloth()(collate_packed([*map(dict, outfits)]).garment(5))
    assert [len(outfits[k]["meta"]["outfit"]) for k in (4, 5)] == [2, 3]
    assert whole["garment_id"].unique().tolist() == [0, 1, 2]
    assert [len(garment.outfit.garments) for k in (0, 1) if (garment := outfits.sample(k)).outfit] == [2, 3]
    with pytest.raises(ConfigError, match="garments=9: give 8 or less"):
        FakeGarments(1, garments=9)


def test_lines_of_joined_garments_keep_their_seams() -> None:
    """The last stitch of the second garment joins an edge to its second line."""
    first = dict[str, Any](FakeGarments(1, fields=("edges", "stitches", "panels", "lines"))[0])
    second = {name: value.clone() for name, value in first.items()}
    second["lines"] = torch.zeros(2, 17)
    second["lines"][:, LineColumn.START_X] = torch.tensor([1.0, 2.0])
    second["stitches"][-1, 1] = len(second["edges"]) + 1
    item = first | {f"g1_{name}": value for name, value in second.items()}
    whole = OutfitCloth()(item)
    row = int(whole["stitches"][-1, 1]) - len(whole["edges"])
    assert whole["lines"][row, LineColumn.START_X] == 2.0
    batch = collate_packed([item, item])
    for number in (0, 1):
        assert torch.equal(batch.garment(number)["g1_stitches"], second["stitches"])
    with pytest.raises(ConfigError, match="g1_stitches holds rows of lines: load the field g1_lines too"):
        collate_packed([{name: value for name, value in item.items() if name != "g1_lines"}])


def test_a_loader_packs_joined_outfits(folder: Path) -> None:
    """A batch of outfits has the garment of each vertex beside it; a garment alone is garment 0."""
    ds = GarmentDataset(folder, cache_dir=folder / "cache", transform=OutfitCloth())
    (batch,) = GarmentLoader(ds, 4, shuffle=False)
    values, starts, _ = batch.varlen("garment_id")
    assert torch.equal(starts, batch.varlen("verts").cu_seqlens)
    assert [int(values[a:b].max()) + 1 for a, b in pairwise(starts.tolist())] == [*COUNTS]
    assert OutfitCloth()(FakeGarments(1)[0])["garment_id"].unique().tolist() == [0]
    with pytest.raises(ConfigError, match="only some garments of the batch have verts"):
        OutfitCloth()({"g1_verts": torch.zeros(3, 3)})


def test_outfits_are_mixed_with_single_garments(folder: Path) -> None:
    """Joined, in batches of both."""
    sets = GarmentDataset(folder, cache_dir=folder / "cache"), FakeGarments(4, seed=3)
    batch = next(iter(GarmentLoader(MixedDataset(sets, [1, 1], transform=OutfitCloth()), 8)))
    counts = sorted(
        int(ids.max()) + 1 for ids in batch["garment_id"].split(batch.varlen("verts").cu_seqlens.diff().tolist())
    )
    assert counts == sorted([*COUNTS, 1, 1, 1, 1])
    with pytest.raises(ConfigError, match=r"have g1_box, .*: choose the same fields, or OutfitCloth"):
        next(iter(GarmentLoader(MixedDataset(sets, [1, 1]), 8)))


def test_all_garments_turn_together(folder: Path) -> None:
    item = items_of(folder)[1]
    turned = Yaw()(item, np.random.default_rng(0))
    before, after = (torch.cat([one["verts"], one["g1_verts"]]) for one in (item, turned))
    assert not torch.allclose(before, after)
    assert torch.allclose(torch.cdist(before, before), torch.cdist(after, after), atol=0.1)


def test_fields_of_a_stage_that_was_not_made_are_named(tmp_path: Path) -> None:
    fill_outfits(tmp_path / "set", (2, 1), drape=None, front=None, back=None)
    ds = GarmentDataset(tmp_path / "set")
    assert "g1_verts" not in ds.fields and "g1_box" in ds.fields
    with pytest.raises(ConfigError, match=r"no field g1_verts: these garments end with stage mesh, and verts come"):
        GarmentDataset(tmp_path / "set", fields=["g1_verts"])


def test_pictures_show_all_garments_each_in_its_cloth(folder: Path) -> None:
    """Of the item alone as in a batch of any kind; the panels of both garments are in the map."""
    body = build_body(neutral_shape())
    items = items_of(folder, fields=None)[1:2]
    views = Views(n=1, size=48, seed=0, device="cpu", maps=("panel_id",), bodies=lambda name: body)
    item = dict[str, Any](views(items[0]))
    assert set(item["panel_id_map"].unique().tolist()) - {-1} == {0, 2}  # the fronts
    for collate in (collate_packed, collate_padded):
        [batch] = views.batches([collate(items)])
        assert torch.equal(batch["views"][0], item["views"])
    whole = joined(fake_outfit(1, 2))
    assert whole.box_mesh is not None and whole.drape is not None
    scene = scene_of_sample(fake_outfit(1, 2), body)
    assert np.array_equal(scene.vertices, whole.drape.vertices)
    looks = [
        draw_appearance(np.random.default_rng(k), scene, fabric=("silk", "silk", "denim", "denim")) for k in range(9)
    ]
    for look in looks:
        inner, outer = ({look.cloths[k].look for k in look.cloth_of_panel[panels]} for panels in ([0, 1], [2, 3]))
        assert inner <= {*looks_of("silk")} and outer <= {*looks_of("denim")}
    with pytest.raises(ConfigError, match=r"an outfit of 2 garments, and Views needs g1_spec, .*: give the data set"):
        views({name: value for name, value in items[0].items() if not name.startswith("g1_")})
    for other in (Scan(points=64, size=32, bodies=lambda name: body), Sketch(size=32, bodies=lambda name: body)):
        assert other(items[0]).keys() > items[0].keys()
