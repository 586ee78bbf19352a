"""A recipe determines the content of a data set and, permanently, the split of each design."""

from itertools import islice
from pathlib import Path

import numpy as np
import pytest

from gcd_dataset.errors import ConfigError
from gcd_dataset.generator.recipe import MakeConfig
from gcd_dataset.generator.recipes import find_recipe, read_recipe, recipe_names
from gcd_dataset.generator.recipes.hashing import made_patterns
from gcd_dataset.patternhash import PatternHash

TINY = """
name = "tiny"
about = "ten designs as patterns"
designs = 10
seed = 3
[options]
bodies = "both"
stage = "pattern"
[splits]
test = 0.2
train = 0.8
"""


def written(folder: Path, text: str = TINY) -> Path:
    path = folder / "tiny.toml"
    path.write_text(text)
    return path


def test_the_recipes_of_the_package() -> None:
    recipes = [find_recipe(name) for name in recipe_names()]
    assert [recipe.name for recipe in recipes] == list(recipe_names())
    counts = {recipe.name: recipe.count for recipe in recipes}
    of_two = {"smoke-64": 64, "standard-1k": 1000, "standard-24k": 24_000, "full-230k": 230_000}
    assert counts == of_two | {"fits": 1_200_000, "outfits": 1000, "poses": 1000}
    for recipe in recipes:
        assert recipe.config.on_fail == "keep"
        assert sum(recipe.sizes().values()) == recipe.count
        assert min(recipe.sizes().values()) > 0


def test_all_garments_of_a_design_are_in_one_split_and_every_garment_in_one() -> None:
    recipe = find_recipe("standard-1k")
    indices = {split: recipe.indices_in(split) for split in recipe.splits}
    assert sorted(np.concatenate(list(indices.values())).tolist()) == list(range(1000))
    designs = {split: set((rows // 2).tolist()) for split, rows in indices.items()}
    assert sum(map(len, designs.values())) == 500
    assert all(recipe.split_of(int(index)) == split for split, rows in indices.items() for index in rows)


def test_a_design_of_a_small_data_set_is_in_the_same_split_of_a_large_one() -> None:
    small, large = find_recipe("standard-1k"), find_recipe("full-230k")
    assert all(small.split_of(index) == large.split_of(index) for index in range(small.count))


def test_the_split_of_a_design_never_changes() -> None:
    """Recorded figures: a change in how splits are drawn would change data sets that others have cited."""
    recipe = find_recipe("full-230k")
    held_out = [(recipe.indices_in(split)[::2][:4] // 2).tolist() for split in ("test", "validation")]
    assert held_out == [[11, 51, 54, 55], [1, 28, 32, 62]]
    assert recipe.sizes() == {"test": 11634, "validation": 11438, "train": 206928}


@pytest.mark.parametrize("name", ["standard-1k", "fits", "outfits", "poses"])
def test_the_first_ten_patterns_never_change(name: str) -> None:
    """A change of the sampler would change data sets that others have cited: it needs recipes with new names."""
    recipe = find_recipe(name)
    made = made_patterns(recipe, range(recipe.designs))
    assert PatternHash.of(islice(made, 10)).agrees(recipe.first_ten)


def test_data_sets_of_two_bodies_begin_with_the_same_patterns() -> None:
    names = ("smoke-64", "standard-1k", "standard-24k", "full-230k")
    assert len({find_recipe(name).first_ten for name in names}) == 1


@pytest.mark.parametrize("name", ["smok-64", "smoke-64-draft"])
def test_an_unknown_name_lists_the_known_ones(name: str) -> None:
    with pytest.raises(ConfigError, match=rf"no recipe {name}: there are smoke-64, .*: did you mean smoke-64\?"):
        find_recipe(name)
    with pytest.raises(ConfigError, match=r"gone\.toml: no such file"):
        find_recipe("gone.toml")


def test_a_recipe_file_of_the_user(tmp_path: Path) -> None:
    recipe = find_recipe(written(tmp_path))
    assert (recipe.name, recipe.count, recipe.patterns) == ("tiny", 20, "")
    assert recipe.config == MakeConfig(bodies="both", stage="pattern", on_fail="keep")
    overlaid = TINY.replace("[splits]", '[options.design.meta]\nbottom = "none"\n[splits]')
    design = read_recipe(written(tmp_path, overlaid)).config.design.to_dict()
    assert design["meta"]["bottom"]["options"] == ["none"]


def test_comments_and_names_do_not_change_the_hash_of_a_recipe(tmp_path: Path) -> None:
    first = read_recipe(written(tmp_path)).sha256
    same = TINY.replace('"tiny"', '"small"').replace("0.2", "0.20  # of the designs")
    assert read_recipe(written(tmp_path, same)).sha256 == first
    for other in (
        TINY.replace("seed = 3", "seed = 4"),
        TINY.replace("test = 0.2\ntrain = 0.8", "train = 0.8\ntest = 0.2"),
    ):
        assert read_recipe(written(tmp_path, other)).sha256 != first


@pytest.mark.parametrize(
    ("change", "to", "message"),
    [
        ("seed = 3", "sead = 3", r"no entry sead: .* did you mean seed\?"),
        ("seed = 3", "", "no seed: give a whole number"),
        ("designs = 10", "designs = 1e3", "designs is 1000.0: give a whole number"),
        ("designs = 10", "designs = 1000000000000", "designs is 1000000000000: give 1 to"),
        ('"tiny"', '"../tiny"', "cannot be a file's name"),
        ("test = 0.2", "test = 0.3", "shares add up to 1.1"),
        ("test = 0.2", 'test = "20%"', "test is '20%': give its share"),
        ("test = 0.2\ntrain = 0.8", "test = 0.001\ntrain = 0.999", "test gets none of 10 designs"),
        ('stage = "pattern"', 'stage = "drap"', "unknown stage 'drap': choose one of pattern, mesh, drape"),
        ('stage = "pattern"', 'device = "cpu"', "options: device is not part of a recipe"),
        ('stage = "pattern"', 'design = "hoodie"', "design is 'hoodie'"),
        ("[options]", "options = 3\n[splits.other]", "options is 3: give a table"),
        ("seed = 3", 'seed = 3\npatterns = "abc"', "patterns is 'abc': give 64 hexadecimal digits"),
    ],
)
def test_an_error_in_a_recipe_names_file_and_entry(tmp_path: Path, change: str, to: str, message: str) -> None:
    assert change in TINY
    with pytest.raises(ConfigError, match=message) as caught:
        read_recipe(written(tmp_path, TINY.replace(change, to)))
    assert str(caught.value).startswith(str(tmp_path / "tiny.toml"))
