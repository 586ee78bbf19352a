"""Captions in generated data sets: stored, made on demand, and chosen by level."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from torch.utils.data import DataLoader

from gcd_dataset import generate
from gcd_dataset.captions import LEVELS, read_captions
from gcd_dataset.errors import ConfigError
from gcd_dataset.generator.maker import make
from gcd_dataset.generator.recipe import MakeConfig, recipe_of
from gcd_dataset.loaders import Augmented, FreshGarments, GarmentDataset, GeneratedGarments, PickCaption
from gcd_dataset.shards import encode_sample
from gcd_dataset.shards.layout import recipe_hash

COUNT, SEED = 4, 5
FLAT = MakeConfig(stage="pattern", captions=True)


def garments(**options: Any) -> GeneratedGarments:
    return GeneratedGarments(COUNT, seed=SEED, stage="pattern", drape=None, captions=True, **options)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("captions")
    generate(folder, COUNT, seed=SEED, config=FLAT)
    return folder


def test_captions_change_no_other_member_and_no_recipe_without_them() -> None:
    with_captions, without = (
        encode_sample(make(SEED, 0, MakeConfig(stage="pattern", captions=on))) for on in (True, False)
    )
    assert with_captions.keys() - without.keys() == {"caption.txt"}
    assert all(with_captions[member] == data for member, data in without.items() if member != "meta.json")
    assert "captions" not in recipe_of(MakeConfig())
    assert recipe_hash(recipe_of(FLAT)) != recipe_hash(recipe_of(MakeConfig(stage="pattern")))


def test_stored_captions_equal_those_made_on_demand(folder: Path, tmp_path: Path) -> None:
    stored = [item["caption"] for item in GarmentDataset(folder)]
    assert [item["caption"] for item in garments()] == stored
    assert [list(read_captions(text)) for text in stored] == [list(LEVELS)] * COUNT
    assert sorted(item["caption"] for item in FreshGarments(garments(fields=["caption"]))) == sorted(stored)
    cached = garments(cache_dir=tmp_path, fields=["caption"])
    assert [item["caption"] for item in cached] == stored
    assert [item["caption"] for item in cached] == stored


def test_a_stopped_run_with_captions_goes_on(folder: Path, tmp_path: Path) -> None:
    generate(tmp_path, 2, seed=SEED, config=FLAT)
    generate(tmp_path, COUNT, seed=SEED, config=FLAT)
    assert (tmp_path / "train-00000.tar").read_bytes() == (folder / "train-00000.tar").read_bytes()


def test_captions_of_one_level_make_a_batch(folder: Path) -> None:
    ds = GarmentDataset(folder, fields=["caption"], transform=PickCaption("short"))
    (batch,) = DataLoader(ds, batch_size=COUNT)
    assert batch["caption"] == [read_captions(text)["short"] for text in texts(folder)]


def test_a_level_may_be_drawn_at_each_use(folder: Path) -> None:
    ds = Augmented(GarmentDataset(folder, fields=["caption"]), PickCaption(), seed=3)
    drawn = set()
    for epoch in range(12):
        ds.set_epoch(epoch)
        drawn.add(ds[0]["caption"])
    assert drawn == set(read_captions(texts(folder)[0]).values())


def test_unusable_levels_are_refused(folder: Path) -> None:
    with pytest.raises(ConfigError, match="there are short, medium, full"):
        PickCaption("long")
    with pytest.raises(ConfigError, match="give it as augment="):
        PickCaption("short", "full")({"caption": "a\nb\nc"})
    assert PickCaption("short")({"points": np.zeros(3)}).keys() == {"points"}
    with pytest.raises(ConfigError, match="no field caption"):
        GeneratedGarments(1, stage="pattern", drape=None, fields=["caption"])


def texts(folder: Path) -> list[str]:
    return [item["caption"] for item in GarmentDataset(folder, fields=["caption"])]
