"""Recipes for ``gcd info`` and ``gcd check``: listing them, and comparing a folder with one."""

import logging
from collections.abc import Iterable, Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

from gcd_dataset.check.sets import evenly_spaced
from gcd_dataset.errors import ConfigError, GcdError
from gcd_dataset.generator.recipe import recipe_of
from gcd_dataset.generator.recipes import Recipe, find_recipe, recipe_names
from gcd_dataset.generator.recipes.hashing import made_patterns
from gcd_dataset.patternhash import PatternHash, hash_pattern
from gcd_dataset.shards.layout import key_of
from gcd_dataset.shards.manifest import MANIFEST, Manifest, RecipeRecord
from gcd_dataset.shards.reader import ShardReader, stored_patterns
from gcd_dataset.shards.store import FolderStore

SAMPLED = 32  # designs generated again to check a recipe that has no hash of all its patterns

log = logging.getLogger(__name__)


def recipe_lines(name: str = "") -> Iterator[str]:
    """One line for each recipe of the package; with a ``name``, the details of that recipe. Raises ``ConfigError``."""
    if not name:
        recipes = [find_recipe(name) for name in recipe_names()]
        width = max(len(recipe.name) for recipe in recipes)
        yield from (f"{recipe.name:<{width}}  {recipe.about}" for recipe in recipes)
        return
    recipe = find_recipe(name)
    yield f"{recipe.name}: {recipe.about}"
    yield f"  {recipe.designs} designs, {recipe.count} garments, seed {recipe.seed}; sha256 {recipe.sha256}"
    yield f"  splits: {', '.join(f'{split} {size}' for split, size in recipe.sizes().items())}"
    made = {option: value for option, value in recipe_of(recipe.config).items() if option != "device"}
    yield f"  options: {', '.join(f'{option} {value}' for option, value in made.items() if value != {})}"
    yield f"  patterns: {recipe.patterns or 'no hash: some were never generated'}"
    yield f"  first ten: {recipe.first_ten or 'no hash'}"


def recipe_faults(folder: Path, recipe: Recipe) -> Iterator[str]:
    """The differences between a folder and the data set of a recipe, one line each.

    Checked: the manifest names the recipe; each split holds the samples that the recipe assigns to it, made with its
    seed and options on any device; the patterns have the recipe's hash. For a recipe without a hash, some patterns are
    made again and compared. Raises ``ShardError`` for a folder that cannot be read.
    """
    manifest = FolderStore(folder).manifest()
    stored = manifest.recipe or RecipeRecord("", "")
    if (stored.name, stored.sha256) != (recipe.name, recipe.sha256):
        named = f"{stored.name} ({stored.sha256})" if stored.name else "none"
        yield f"{folder / MANIFEST}: names recipe {named}, asked for {recipe.name} ({recipe.sha256})"
        return
    if faults := [*_split_faults(folder, manifest, recipe)]:
        yield from faults
        return
    readers = [ShardReader(FolderStore(folder), split) for split in recipe.splits]
    try:
        found = sum((PatternHash.of(stored_patterns(reader)) for reader in readers), PatternHash())
    except GcdError as error:
        yield str(error)
        return
    if not stored.patterns:
        yield f"{folder / MANIFEST}: no hash of the patterns yet: run gcd generate --recipe {recipe.name} again"
    elif not found.agrees(stored.patterns):
        yield f"{folder}: its patterns have hash {found.text}, but {MANIFEST} lists {stored.patterns}"
    if not recipe.patterns:
        yield from _sampled_faults(folder, readers, recipe)
    elif not found.agrees(recipe.patterns):
        yield f"{folder}: its patterns have hash {found.text}, but recipe {recipe.name} has {recipe.patterns}"


def _split_faults(folder: Path, manifest: Manifest, recipe: Recipe) -> Iterator[str]:
    """Samples that are missing or in the wrong split, and splits made with another seed or other options."""
    for split in sorted(set(manifest.splits) - set(recipe.splits)):
        yield f"{folder}: split {split} does not belong to {recipe.name}: remove it"
    asked = recipe_of(recipe.config)
    for split in recipe.splits:
        if split not in manifest.splits:
            yield f"{folder}: no split {split}: run gcd generate --recipe {recipe.name} again"
            continue
        plan = manifest.splits[split].plan
        same = replace(plan, seed=recipe.seed, recipe={**asked, "device": plan.recipe.get("device")})
        try:
            plan.require_same(same, f"{folder / MANIFEST}, split {split}")
        except ConfigError as error:
            yield str(error)
        stored = ShardReader(FolderStore(folder), split).index.number
        wanted = recipe.indices_in(split)
        if missing := len(np.setdiff1d(wanted, stored)):
            yield f"{folder}: split {split} lacks {missing} of {len(wanted)} samples: run gcd generate again"
        if foreign := len(np.setdiff1d(stored, wanted)):
            yield f"{folder}: split {split} holds {foreign} samples of other splits: delete it, and make it again"


def _sampled_faults(folder: Path, readers: Iterable[ShardReader], recipe: Recipe) -> Iterator[str]:
    """Make the patterns of some designs again and compare them with the stored ones; one line for each difference."""
    designs = evenly_spaced(recipe.designs, SAMPLED)
    log.info("%s has no hash of all its patterns: %d designs are made again", recipe.name, len(designs))
    made = {index: garments for index, *garments in made_patterns(recipe, designs)}
    for reader in readers:
        for index, *garments in stored_patterns(reader, of=made.keys()):
            if not hash_pattern(index, *made[index]).agrees(hash_pattern(index, *garments).text):
                yield f"{folder}: {key_of(index)} has another pattern when made again: generate the data set anew"
