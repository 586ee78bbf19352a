"""The garments of an outfit as one garment, and each alone."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from gcd_dataset.loaders import GarmentDataset, OutfitCloth
from gcd_dataset.loaders.fake import fake_sample
from gcd_dataset.outfits import apart, joined
from gcd_dataset.records import Layer, Outcome
from tests.shards.folders import fake_outfit, fill_outfits


def test_a_joined_sample_is_the_joined_item(tmp_path: Path) -> None:
    """Arrays of records and of tensors are joined in one order, with the same names of panels."""
    ds = GarmentDataset(fill_outfits(tmp_path / "set", (1, 2, 3)), cache_dir=tmp_path, transform=OutfitCloth())
    for index, count in enumerate((1, 2, 3)):
        sample, item = joined(ds.sample(index)), dict[str, Any](ds[index])
        mesh, drape = sample.box_mesh, sample.drape
        assert mesh is not None and drape is not None
        assert [panel.name for panel in sample.pattern.panels] == list(mesh.panel_names) == item["meta"]["panel_names"]
        for name in ("faces", "uv", "corners", "uv_vertex", "panel_id", "seams"):
            assert np.array_equal(getattr(mesh, name), item[name]), name
        assert np.allclose(drape.vertices, item["verts"]) and np.allclose(mesh.vertices, item["box"], atol=1e-4)
        assert len(sample.pattern.seams) == len(item["stitches"]) == 2 * count
        for ids in mesh.labels.values():
            assert set(item["garment_id"][ids].tolist()) == {*range(count)}


def test_a_crossing_of_two_garments_counts_once() -> None:
    """An outer garment counts its crossings with those under it as crossings with the body, which it lies on."""
    sample = fake_outfit(0, 2)
    assert sample.outfit is not None and sample.drape is not None
    inner, outer = sample.outfit.garments
    assert outer.drape is not None
    outer = replace(outer, drape=replace(outer.drape, self_crossings=3, body_crossings=2, body_through=4))
    outfit = replace(sample.outfit, garments=(inner, outer), layers=(Layer(0, 1, 6, 20, 0.0),))
    whole = joined(replace(sample, outfit=outfit)).drape
    assert whole is not None and whole.outcome is Outcome.SETTLED
    assert (whole.self_crossings, whole.body_crossings, whole.body_through) == (3, 2, 4)


def test_each_garment_alone_is_a_sample_of_the_same_wearer() -> None:
    sample = fake_outfit(4, 2)
    inner, outer = apart(sample)
    assert inner == fake_sample(0, 4)
    assert (outer.pattern, outer.box_mesh) == (fake_sample(1, 41).pattern, fake_sample(1, 41).box_mesh)
    assert (outer.key, outer.measurements, outer.outfit) == (sample.key, sample.measurements, None)
    assert apart(inner) == [inner]
    assert joined(inner) is inner
