"""``gcd generate``, ``info`` and ``verify`` with recipes."""

import shutil
from dataclasses import replace
from pathlib import Path

import pytest

from gcd_dataset import generate, generate_recipe
from gcd_dataset.check.recipes import recipe_faults
from gcd_dataset.cli import main
from gcd_dataset.generator.recipes import Recipe, find_recipe
from gcd_dataset.generator.recipes.hashing import made_patterns
from gcd_dataset.patternhash import PatternHash
from gcd_dataset.shards import read_manifest
from gcd_dataset.shards.manifest import RecipeRecord
from tests.generator.test_recipes import TINY, written
from tests.helpers import flip
from tests.making import conftest

made, recipe, toml = conftest.made, conftest.recipe, conftest.toml


@pytest.fixture
def copy(made: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(made, tmp_path / "copy"))


def manifest_with(folder: Path, seed: int | None = None, **entries: str) -> None:
    """Set entries of ``recipe``, and the seed of all splits, in a folder's ``manifest.json``."""
    manifest = read_manifest(folder) or pytest.fail("no manifest")
    recipe = replace(manifest.recipe or RecipeRecord("tiny", ""), **entries)
    splits = {
        name: split if seed is None else replace(split, plan=replace(split.plan, seed=seed))
        for name, split in manifest.splits.items()
    }
    (folder / "manifest.json").write_bytes(replace(manifest, recipe=recipe, splits=splits).to_bytes())


def test_other_patterns_are_reported(copy: Path, recipe: Recipe, tmp_path: Path) -> None:
    """The same indices of another seed, with a manifest that names the recipe."""
    other = find_recipe(written(tmp_path, TINY.replace("seed = 3", "seed = 4")))
    renamed = tmp_path / "other"
    generate_recipe(renamed, other, workers=0)
    manifest_with(renamed, sha256=recipe.sha256)
    message = list(recipe_faults(renamed, recipe))
    assert any("split test: made with seed=4, asked for seed=3" in line for line in message)
    # The right patterns with a wrong hash in the manifest are reported too.
    manifest_with(copy, patterns="0" * 64)
    assert "manifest.json lists 0000" in next(recipe_faults(copy, recipe))


def test_patterns_are_made_again_where_their_hash_is_not_known(tmp_path: Path) -> None:
    """Ten patterns of another seed, with a manifest that names the recipe."""
    other = find_recipe(written(tmp_path, TINY.replace("seed = 3", "seed = 4")))
    same = written(tmp_path, TINY.replace("test = 0.2\ntrain = 0.8", "train = 1.0"))
    asked, folder = find_recipe(same), tmp_path / "other"
    generate(folder, 20, seed=4, config=other.config)
    manifest_with(folder, seed=3, sha256=asked.sha256)
    message = list(recipe_faults(folder, asked))
    assert "no hash of the patterns yet" in message[0]
    assert len(message) == 21
    assert all("has another pattern when made again" in line for line in message[1:])


def test_patterns_of_a_recipe_with_maps_and_views_are_made_without_draping(tmp_path: Path) -> None:
    plain, rich = (
        find_recipe(written(tmp_path, TINY.replace('stage = "pattern"', "resolution = 6.0" + more)))
        for more in ("", "\nmaps = true\nviews = 1")
    )
    assert PatternHash.of(made_patterns(rich, [0])).text == PatternHash.of(made_patterns(plain, [0])).text


@pytest.mark.long
def test_outfits_that_differ_in_an_outer_garment_are_reported(tmp_path: Path) -> None:
    """The outfits of two recipes have the same innermost garments; the patterns of all are those that were made."""
    hashes = []
    for skirt in ("0.3", "0.6"):
        (tmp_path / f"{skirt}.toml").write_text(OUTFITS.replace("0.3", skirt))
        options = f'stage = "pattern"\nmax_attempts = 99\noutfits = "{tmp_path}/{skirt}.toml"'
        recipe = find_recipe(written(tmp_path, TINY.replace('stage = "pattern"', options)))
        generate_recipe(tmp_path / skirt, recipe, workers=0)
        assert not list(recipe_faults(tmp_path / skirt, recipe))
        record = (read_manifest(tmp_path / skirt) or pytest.fail("no manifest")).recipe or pytest.fail("no recipe")
        hashes.append(record.patterns)
        assert PatternHash.of(made_patterns(recipe, range(10))).agrees(record.patterns)
    assert hashes[0] != hashes[1]


OUTFITS = """
[designs.shirt]
meta = { upper = "Shirt", wb = "none", bottom = "none" }
left.enable_asym = false
shirt = { length = 1.2, strapless = false }
[designs.skirt]
meta = { upper = "none", bottom = "PencilSkirt" }
pencil-skirt = { length = 0.3, flare = 1.1, style_side_cut = "none" }
[[outfits]]
worn = [{ design = "shirt" }, { design = "skirt" }]
"""


def test_a_split_that_is_missing_or_another_is_reported(copy: Path, recipe: Recipe) -> None:
    manifest = read_manifest(copy) or pytest.fail("no manifest")
    splits = {name.replace("test", "tset"): split for name, split in manifest.splits.items()}
    (copy / "manifest.json").write_bytes(replace(manifest, splits=splits).to_bytes())
    for path in copy.rglob("*test*"):
        path.rename(path.with_name(path.name.replace("test", "tset")))
    message = list(recipe_faults(copy, recipe))
    assert any("split tset does not belong to tiny" in line for line in message)
    assert any("no split test: run gcd generate --recipe tiny again" in line for line in message)


def test_samples_in_the_wrong_split_are_reported(made: Path, recipe: Recipe, tmp_path: Path) -> None:
    """Splits with other shares, with a manifest that names the recipe."""
    other = find_recipe(written(tmp_path, TINY.replace("test = 0.2\ntrain = 0.8", "train = 0.2\ntest = 0.8")))
    folder = tmp_path / "other"
    generate_recipe(folder, other, workers=0)
    manifest_with(folder, sha256=recipe.sha256)
    message = list(recipe_faults(folder, recipe))
    assert any("samples of other splits" in line for line in message)
    assert any("split train lacks" in line for line in message)


def test_a_damaged_pattern_is_reported(copy: Path, recipe: Recipe) -> None:
    flip(copy / "test-00000.tar", 600, after=b".pattern.z\0")
    (message,) = recipe_faults(copy, recipe)
    assert "test-00000.tar" in message
    assert "pattern.z" in message


def test_the_command_line_makes_describes_and_verifies(
    toml: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = str(tmp_path / "tiny")
    assert main(["generate", folder, "--recipe", str(toml), "--quiet", "--workers", "0"]) == 0
    assert "20 garments, 20 of them made now" in capsys.readouterr().out
    assert main(["info", folder]) == 0
    assert "  recipe tiny, sha256 " in capsys.readouterr().out
    assert main(["check", folder, "--recipe", str(toml)]) == 0
    assert ": this is tiny\n" in capsys.readouterr().out
    namesake = written(tmp_path, TINY.replace("seed = 3", "seed = 4"))
    for other in ("smoke-64", str(namesake)):
        assert main(["check", folder, "--recipe", other]) == 1
        assert "names recipe tiny" in capsys.readouterr().out


def test_recipes_are_listed_and_described(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["info", "recipe:"]) == 0
    listed = capsys.readouterr().out.splitlines()
    assert [line.split()[0] for line in listed][:2] == ["smoke-64", "standard-1k"]
    assert main(["info", "recipe:standard-1k"]) == 0
    assert "splits: test 50, validation 52, train 898" in capsys.readouterr().out
