"""``GeneratedGarments``: the bytes of a generated data set; caching and repair."""

import os
from pathlib import Path
from typing import Any

import pytest
import torch

from gcd_dataset.errors import ConfigError, ShardError
from gcd_dataset.generator.maker import produce
from gcd_dataset.generator.pipeline import DressedDesign, prepare
from gcd_dataset.generator.recipe import recipe_of
from gcd_dataset.loaders import GarmentDataset, GeneratedGarments
from gcd_dataset.shards import ShardWriter
from tests.loaders.test_shards import assert_all_same, same

COUNT = 3


def garments(**options: Any) -> GeneratedGarments:
    """Box meshes at 5 cm: quick, made by the same steps as any other."""
    return GeneratedGarments(COUNT, seed=5, drape=None, resolution=5.0, **options)


@pytest.fixture(scope="module")
def items() -> list[Any]:
    return [garments()[i] for i in range(COUNT)]


def test_items_equal_those_of_a_shard(items: list[dict[str, Any]], tmp_path: Path) -> None:
    config = garments().config
    with ShardWriter(tmp_path, seed=5, recipe=recipe_of(config)) as writer:
        for sample in produce(5, range(COUNT), config):
            writer.write(sample)
    stored = GarmentDataset(tmp_path)
    assert_all_same(items, [stored[i] for i in range(COUNT)])
    assert garments().recipe(1) == stored.recipe(1)


def test_a_batch_holds_the_same_items(items: list[dict[str, Any]]) -> None:
    ds = garments()
    assert len(ds) == COUNT
    assert_all_same(ds.__getitems__([2, 0, -1]), [items[2], items[0], items[2]])
    with pytest.raises(IndexError):
        ds.__getitems__([0, COUNT])


def test_global_random_state_changes_nothing(items: list[dict[str, Any]]) -> None:
    torch.manual_seed(123)
    assert same(garments()[1], items[1])


def test_an_item_holds_the_selected_fields_only() -> None:
    assert set(garments(fields=("panels", "box"))[0]) == {"panels", "box"}


def test_unneeded_pictures_are_not_rendered(monkeypatch: pytest.MonkeyPatch) -> None:
    """The other fields stay the same."""
    options: dict[str, Any] = {"seed": 5, "resolution": 8.0, "picture": 32, "device": "cpu"}
    whole: Any = GeneratedGarments(1, **options)[0]

    def refuse(*_: Any, **__: Any) -> None:
        raise AssertionError("a picture was taken")

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
    monkeypatch.setattr("gcd_dataset.generator.maker.prepare", no_more)
    assert same(garments(cache_dir=tmp_path)[1], items[1])


def no_more(*_: Any) -> list[Any]:
    raise AssertionError("made again")


def test_another_recipe_has_another_cache(tmp_path: Path) -> None:
    coarse = GeneratedGarments(COUNT, seed=5, drape=None, resolution=8.0, cache_dir=tmp_path, fields=["box"])
    fine = garments(cache_dir=tmp_path, fields=["box"])
    assert len(coarse[0]["box"]) < len(fine[0]["box"])
    assert len(list(tmp_path.iterdir())) == 2


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


def test_another_version_has_another_cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    garments(cache_dir=tmp_path, fields=["box"])[0]
    monkeypatch.setattr("gcd_dataset.loaders.generated.__version__", "99.1")
    garments(cache_dir=tmp_path, fields=["box"])[0]
    assert len(list(tmp_path.iterdir())) == 2


def test_the_recipe_is_known_before_the_garment_is_made(monkeypatch: pytest.MonkeyPatch) -> None:
    ds = garments()
    monkeypatch.setattr("gcd_dataset.generator.maker.prepare", no_more)
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


@pytest.fixture
def designed(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """Records the numbers of the designs made in this process."""
    numbers = []

    def recorded(seed: int, number: int, *options: Any) -> DressedDesign:
        numbers.append(number)
        return prepare(seed, number, *options)

    monkeypatch.setattr("gcd_dataset.generator.maker.prepare", recorded)
    return numbers


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


def test_verify_makes_the_design_again(designed: list[int]) -> None:
    ds = garments(bodies="both")
    ds[0]
    designed.clear()
    ds.verify(1)
    assert designed == [0, 0]


def test_options_that_do_not_exist_are_refused() -> None:
    with pytest.raises(ConfigError, match="drape='newton'"):
        GeneratedGarments(1, drape="newton")  # type: ignore[arg-type]
    with pytest.raises(ConfigError, match="bodies"):
        GeneratedGarments(1, bodies="dolls")  # type: ignore[arg-type]


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
    ],
)
def test_arguments_are_checked_at_once(options: dict[str, Any], message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        GeneratedGarments(**{"n": 1, **options})


def test_a_wearer_of_few_garments_does_not_stop_a_data_set() -> None:
    """No fitted shirt suits her, and by chance her first twenty designs are all fitted shirts."""
    item = GeneratedGarments(33_546, seed=0, stage="pattern", drape=None, fields=("meta", "panels"))[33_545]
    assert item["meta"]["attempts"] > 20
    assert len(item["panels"])
