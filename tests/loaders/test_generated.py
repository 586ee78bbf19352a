"""``GeneratedGarments``: the bytes of a generated data set; caching and repair."""

import os
from pathlib import Path
from typing import Any
from unittest.mock import Mock

import numpy as np
import pytest
import torch

from gcd_dataset import generate
from gcd_dataset.captions import LEVELS, read_captions
from gcd_dataset.errors import ConfigError, ShardError
from gcd_dataset.faults import check_pattern
from gcd_dataset.generator.maker import make, produce
from gcd_dataset.generator.recipe import MakeConfig, recipe_of
from gcd_dataset.loaders import Augmented, FakeGarments, FreshGarments, GarmentDataset, GeneratedGarments, PickCaption
from gcd_dataset.loaders.fake import fake_sample
from gcd_dataset.shards import encode_sample
from gcd_dataset.shards.layout import recipe_hash
from tests.loaders.test_shards import assert_all_same, same
from tests.shards.folders import write_samples

COUNT = 3


def garments(**options: Any) -> GeneratedGarments:
    """Box meshes at 5 cm: quick, made by the same steps as any other."""
    return GeneratedGarments(COUNT, seed=5, drape=None, resolution=5.0, **options)


@pytest.fixture(scope="module")
def items() -> list[Any]:
    return [garments()[i] for i in range(COUNT)]


def test_items_equal_those_of_a_shard(items: list[dict[str, Any]], tmp_path: Path) -> None:
    config = garments().config
    stored = GarmentDataset(write_samples(tmp_path, produce(5, range(COUNT), config), seed=5, recipe=recipe_of(config)))
    assert_all_same(items, [stored[i] for i in range(COUNT)])
    assert garments().recipe(1) == stored.recipe(1)


def test_a_batch_holds_the_same_items(items: list[dict[str, Any]]) -> None:
    torch.manual_seed(123)  # the global random state changes nothing
    ds = garments()
    assert len(ds) == COUNT
    assert_all_same(ds.__getitems__([2, 0, -1]), [items[2], items[0], items[2]])
    with pytest.raises(IndexError):
        ds.__getitems__([0, COUNT])


def test_unneeded_pictures_are_not_rendered(monkeypatch: pytest.MonkeyPatch) -> None:
    """The other fields stay the same."""
    options: dict[str, Any] = {"seed": 5, "resolution": 8.0, "picture": 32, "device": "cpu"}
    whole: Any = GeneratedGarments(1, **options)[0]
    refuse = Mock(side_effect=AssertionError("a picture was taken"))
    monkeypatch.setattr("gcd_dataset.generator.render.render_garment", refuse)
    fields = [field for field in whole if field not in ("front", "back", "meta")]
    assert_all_same([GeneratedGarments(1, fields=fields, **options)[0]], [{name: whole[name] for name in fields}])
    with pytest.raises(AssertionError, match="a picture was taken"):
        GeneratedGarments(1, fields=["points", "back"], **options)[0]


def test_cached_garments_are_not_made_again(
    items: list[dict[str, Any]], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    ds = garments(cache_dir=tmp_path)
    assert same(ds[1], items[1])
    assert_all_same(ds.__getitems__([0, 1]), items[:2])
    monkeypatch.setattr("gcd_dataset.generator.maker.prepare", Mock(side_effect=AssertionError("made again")))
    assert same(garments(cache_dir=tmp_path)[1], items[1])


def test_damage_in_the_cache_is_logged_and_repaired(
    items: list[dict[str, Any]], tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    ds = garments(cache_dir=tmp_path)
    ds[0]
    ds.verify(0)
    (path,) = tmp_path.glob("*/*/*.tar")
    whole = path.read_bytes()
    content = bytearray(whole)
    content[-1100 - len(content) // 3] ^= 1
    for damaged in (bytes(content), whole[:3000], b""):
        path.write_bytes(damaged)
        with pytest.raises(ShardError, match=r"gcd_000000000\.tar"):
            ds.verify(0)
        path.write_bytes(damaged)
        caplog.clear()
        assert same(ds[0], items[0])
        assert "gcd_000000000.tar" in caplog.text
        assert "made again" in caplog.text
        assert path.read_bytes() == whole


def test_another_recipe_or_version_has_another_cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def fill(resolution: float) -> None:
        options: dict[str, Any] = {"resolution": resolution, "cache_dir": tmp_path, "fields": ["panels"]}
        GeneratedGarments(1, seed=5, stage="pattern", drape=None, **options)[0]

    fill(5.0)
    fill(8.0)
    monkeypatch.setattr("gcd_dataset.loaders.generated.__version__", "99.1")
    fill(5.0)
    assert len(list(tmp_path.iterdir())) == 3


def test_the_recipe_is_known_before_the_garment_is_made(monkeypatch: pytest.MonkeyPatch) -> None:
    ds = garments()
    monkeypatch.setattr("gcd_dataset.generator.maker.prepare", Mock(side_effect=AssertionError("made")))
    assert ds.recipe(-1)["index"] == COUNT - 1
    with pytest.raises(IndexError):
        ds.recipe(COUNT)


def test_verify_finds_a_garment_that_is_not_reproducible(monkeypatch: pytest.MonkeyPatch) -> None:
    ds = garments()
    ds.verify(1)
    made = ds._made
    monkeypatch.setattr(ds, "_made", lambda position: {**made(position), "design.json": os.urandom(8)})
    with pytest.raises(ShardError, match=r"gcd_000000001, member design\.json"):
        ds.verify(1)


@pytest.mark.parametrize("bodies", [{"bodies": "both"}, {"bodies_each": 2}])
def test_consecutive_bodies_of_a_design_share_its_making(bodies: dict[str, Any], designed: list[int]) -> None:
    together = garments(**bodies).__getitems__([0, 1, 2])
    designed.clear()
    ds = garments(**bodies)
    assert_all_same([ds[0], ds[1], ds[2]], together)
    assert designed == [0, 1]
    assert_all_same([ds[1], ds[0]], [together[1], together[0]])
    assert designed == [0, 1, 0]
    assert_all_same(garments(**bodies).stream(range(3)), together)
    assert designed == [0, 1, 0, 0, 1]
    ds.verify(1)  # makes the design again
    assert designed[5:] == [0, 0]


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"n": -1}, "n=-1"),
        ({"n": 2.5}, "n=2.5"),
        ({"seed": -1}, "seed=-1"),
        ({"resolution": "1"}, "resolution is '1'"),
        ({"device": "nope"}, "device='nope'"),
        ({"device": "nope", "drape": None}, "device='nope'"),
        ({"device": 0}, "device"),
        ({"drape": "newton"}, "drape='newton'"),
        ({"bodies": "dolls"}, "bodies"),
        ({"stage": "pattern", "drape": None, "fields": ["caption"]}, "no field caption"),
    ],
)
def test_arguments_are_checked_at_once(options: dict[str, Any], message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        GeneratedGarments(**{"n": 1, **options})


CAPTIONED, SEED = 4, 5
FLAT = MakeConfig(stage="pattern", captions=True)


def captioned(**options: Any) -> GeneratedGarments:
    return GeneratedGarments(CAPTIONED, seed=SEED, stage="pattern", drape=None, captions=True, **options)


@pytest.fixture(scope="module")
def caption_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("captions")
    generate(folder, CAPTIONED, seed=SEED, config=FLAT)
    return folder


def test_captions_change_no_other_member_and_no_recipe_without_them() -> None:
    with_captions, without = (
        encode_sample(make(SEED, 0, MakeConfig(stage="pattern", captions=on))) for on in (True, False)
    )
    assert with_captions.keys() - without.keys() == {"caption.txt"}
    assert all(with_captions[member] == data for member, data in without.items() if member != "meta.json")
    assert "captions" not in recipe_of(MakeConfig())
    assert recipe_hash(recipe_of(FLAT)) != recipe_hash(recipe_of(MakeConfig(stage="pattern")))


def test_stored_captions_equal_those_made_on_demand(caption_folder: Path, tmp_path: Path) -> None:
    stored = [item["caption"] for item in GarmentDataset(caption_folder)]
    assert [item["caption"] for item in captioned()] == stored
    assert [list(read_captions(text)) for text in stored] == [list(LEVELS)] * CAPTIONED
    assert sorted(item["caption"] for item in FreshGarments(captioned(fields=["caption"]))) == sorted(stored)
    cached = captioned(cache_dir=tmp_path, fields=["caption"])
    assert [item["caption"] for item in cached] == stored
    assert [item["caption"] for item in cached] == stored


def test_a_level_may_be_drawn_at_each_use(caption_folder: Path) -> None:
    captions = GarmentDataset(caption_folder, fields=["caption"])
    ds, drawn = Augmented(captions, PickCaption(), seed=3), set()
    for epoch in range(12):
        ds.set_epoch(epoch)
        drawn.add(ds[0]["caption"])
    assert drawn == set(read_captions(captions[0]["caption"]).values())


def test_unusable_levels_are_refused() -> None:
    with pytest.raises(ConfigError, match="there are short, medium, full"):
        PickCaption("long")
    with pytest.raises(ConfigError, match="give it as augment="):
        PickCaption("short", "full")({"caption": "a\nb\nc"})
    assert PickCaption("short")({"points": np.zeros(3)}).keys() == {"points"}


def test_fake_garments_can_be_sewn_differ_and_are_reproducible() -> None:
    assert not any(check_pattern(fake_sample(0, index).pattern) for index in range(5))
    ds = FakeGarments(4, seed=1)
    assert len({ds[i]["measures"]["waist"] for i in range(4)}) == 4
    ds.verify(2)
