"""A small published recipe, and its data set."""

from pathlib import Path

import pytest

from gcd_dataset import generate_recipe
from gcd_dataset.generator.recipes import Recipe, find_recipe
from tests.generator.test_recipes import written


@pytest.fixture(scope="module")
def toml(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return written(tmp_path_factory.mktemp("recipe"))


@pytest.fixture(scope="module")
def recipe(toml: Path) -> Recipe:
    return find_recipe(toml)


@pytest.fixture(scope="module")
def made(recipe: Recipe, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Ten designs as patterns, in two splits."""
    folder = tmp_path_factory.mktemp("made") / "tiny"
    assert generate_recipe(folder, recipe, workers=0).made == 20
    return folder
