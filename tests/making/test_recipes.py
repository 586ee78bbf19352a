"""Data sets of recipes: splits, manifest and making on demand."""

import shutil
from functools import partial
from pathlib import Path
from typing import Any
from unittest.mock import Mock

import pytest

from gcd_dataset import Job, generate, generate_recipe
from gcd_dataset.check.recipes import recipe_faults
from gcd_dataset.errors import ConfigError, ShardError
from gcd_dataset.generator.recipes import Recipe, find_recipe
from gcd_dataset.hub.partition import leaks
from gcd_dataset.hub.publish import stage
from gcd_dataset.loaders import GarmentDataset, GeneratedGarments
from gcd_dataset.patternhash import PatternHash
from gcd_dataset.shards import ShardReader, read_manifest
from gcd_dataset.shards.reader import stored_patterns
from tests.generator.test_recipes import TINY, written
from tests.making.conftest import stopped
from tests.shards.folders import contents


def test_a_sample_is_the_same_with_and_without_splits(made: Path, recipe: Recipe) -> None:
    whole: Any = GeneratedGarments(20, 3, bodies="both", stage="pattern", on_fail="keep", fields=["panels", "edges"])
    for split, count in recipe.sizes().items():
        ds: Any = GarmentDataset(made, split, fields=["panels", "edges"])
        assert len(ds) == count
        for item, index in zip(ds, recipe.indices_in(split).tolist(), strict=True):
            assert all(item[name].equal(whole[index][name]) for name in item)


def test_no_design_and_no_body_but_the_neutral_one_is_in_two_splits(made: Path, recipe: Recipe) -> None:
    readers = {split: ShardReader(made, split) for split in recipe.splits}
    assert not leaks(readers)
    worn: dict[str, set[bytes]] = {}
    for split, reader in readers.items():
        samples = [reader.sample(position) for position in range(len(reader))]
        shapes = {sample.provenance.body_name: sample.shape for sample in samples}
        worn[split] = {shape.weights.tobytes() for name, shape in shapes.items() if name != "neutral" and shape}
        assert len(worn[split]) == len(samples) / 2
    assert not set.intersection(*worn.values())


def test_the_manifest_names_recipe_and_hash_of_the_patterns(made: Path, recipe: Recipe) -> None:
    record = (read_manifest(made) or pytest.fail("no manifest")).recipe or pytest.fail("no recipe")
    assert (record.name, record.sha256, len(record.patterns)) == ("tiny", recipe.sha256, 64)
    stored = (PatternHash.of(stored_patterns(ShardReader(made, split))) for split in recipe.splits)
    whole = sum(stored, PatternHash())
    assert (record.patterns, whole.count) == (whole.text, 20)


def test_a_stopped_run_and_jobs_make_the_same_bytes(made: Path, recipe: Recipe, tmp_path: Path) -> None:
    """The pattern hashes of the shards add up, whoever made them."""
    stopped(partial(generate_recipe, tmp_path, recipe, workers=0), after=7)
    assert any(
        "no split train: run gcd generate --recipe tiny again" in fault for fault in recipe_faults(tmp_path, recipe)
    )
    assert sum(generate_recipe(tmp_path, recipe, workers=0, job=Job(number, 3)).made for number in (1, 0, 2)) == 13
    assert generate_recipe(tmp_path, recipe).made == 0  # it is complete
    assert contents(tmp_path) == contents(made)


def test_a_folder_of_one_recipe_takes_no_other_and_none(made: Path, recipe: Recipe, tmp_path: Path) -> None:
    copy = shutil.copytree(made, tmp_path / "copy")
    other = find_recipe(written(tmp_path, TINY.replace("designs = 10", "designs = 12")))
    with pytest.raises(ConfigError, match=r"made with recipe='tiny \(\w{12}\)', asked for recipe='tiny \(\w{12}\)'"):
        generate_recipe(copy, other)
    with pytest.raises(ConfigError, match=r"made with recipe='tiny \(\w{12}\)', asked for recipe=None"):
        generate(copy, 20, seed=3, config=recipe.config)
    generate(tmp_path / "plain", 1, seed=3, config=recipe.config)
    with pytest.raises(ConfigError, match="made with recipe=None, asked for recipe='tiny"):
        generate_recipe(tmp_path / "plain", recipe)


def test_a_recipe_is_published_with_its_splits_and_its_name(made: Path, recipe: Recipe, tmp_path: Path) -> None:
    staged = stage(made, "org/tiny", tmp_path / "up", endpoint="https://hub.example")
    assert {split: sum(shard.count for shard in record.shards) for split, record in staged.manifest.splits.items()} == (
        recipe.sizes()
    )
    assert not list(recipe_faults(staged.folder, recipe))
    card = (staged.folder / "README.md").read_text()
    assert "No design, and no body but the neutral one, is in two splits." in card
    assert f"- recipe `tiny` of sha256 `{recipe.sha256}`" in card


def test_a_missing_data_set_is_made_on_demand_and_an_interrupted_making_goes_on(
    toml: Path, made: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], caplog: pytest.LogCaptureFixture
) -> None:
    opened = partial(GarmentDataset, f"recipe:{toml}", "test", cache_dir=tmp_path, fields=["panels"])
    with pytest.MonkeyPatch.context() as patched, pytest.raises(KeyboardInterrupt):
        patched.setattr("gcd_dataset.making.run.gather", Mock(side_effect=KeyboardInterrupt))
        opened()
    folder = tmp_path / "recipes" / "tiny"
    assert len(opened()) == 6
    assert contents(folder) == contents(made)
    assert f"tiny: making 20 garments in {folder}; the next call resumes" in caplog.text
    assert "20/20" in capsys.readouterr().err
    caplog.clear()
    again = GarmentDataset(f"recipe:{toml}", "train+test", root=folder.parent, fields=["panels"], download=False)
    assert len(again) == 20
    assert not caplog.text


def test_impossible_options_are_reported_before_anything_is_made(toml: Path, tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"tiny has no split tset: there are test, train: did you mean test\?"):
        GarmentDataset(f"recipe:{toml}", "tset", root=tmp_path)
    with pytest.raises(ConfigError, match="revision is for URLs and the Hub"):
        GarmentDataset(f"recipe:{toml}", "test", root=tmp_path, revision="main")
    with pytest.raises(ShardError, match="tiny is not there, and download=False"):
        GarmentDataset(f"recipe:{toml}", "test", root=tmp_path, download=False)
    with pytest.raises(ConfigError, match="no recipe nothing"):
        GarmentDataset("recipe:nothing")
    assert not list(tmp_path.iterdir())


def test_the_data_set_of_another_version_is_not_taken_for_it(made: Path, tmp_path: Path) -> None:
    """The recipe's hash differs from the hash of the stored patterns."""
    shutil.copytree(made, tmp_path / "tiny")
    newer = written(tmp_path, TINY.replace("seed = 3", f'seed = 3\npatterns = "{"ab" * 32}"'))
    with pytest.raises(ConfigError, match="patterns drawn by another version of the package: delete the folder"):
        GarmentDataset(f"recipe:{newer}", "test", root=tmp_path)
