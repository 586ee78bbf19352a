"""The recipe of a data set in its manifest.

``claim`` writes the recipe's name before the first sample; ``seal`` adds the hash of all patterns after the last.
"""

import logging
from collections.abc import Mapping
from pathlib import Path
from typing import Protocol

from gcd_dataset.errors import ConfigError
from gcd_dataset.files import make_folder, user_path
from gcd_dataset.generator.recipes import Recipe
from gcd_dataset.patternhash import PatternHash
from gcd_dataset.shards.access import reading
from gcd_dataset.shards.folder import FolderStore
from gcd_dataset.shards.manifest import MANIFEST, RecipeRecord, keep_recipe, read_manifest
from gcd_dataset.shards.pattern_arrays import stored_patterns
from gcd_dataset.shards.reader import ShardReader

__all__ = ["claim", "hash_of", "is_sealed", "require_claimable", "seal"]

DIGITS = 12  # shown digits of a hash, in messages

log = logging.getLogger(__name__)


def claim(folder: Path, recipe: Recipe | None) -> None:
    """Write the recipe's name to the manifest of a folder before it is filled; called after all other checks.

    Raises as ``require_claimable`` does, and ``OutputError`` for a folder that cannot be written.
    """
    if require_claimable(folder, recipe) is None and recipe is not None:
        keep_recipe(make_folder(user_path(folder)), RecipeRecord(recipe.name, recipe.sha256))


def require_claimable(folder: Path, recipe: Recipe | None) -> RecipeRecord | None:
    """The recipe in the manifest of a folder, if any, provided that samples of ``recipe`` may be added to the folder.

    Raises ``ConfigError`` for a folder with the data set of another recipe, or of none; with ``recipe=None``, for a
    folder with the data set of a recipe.
    """
    folder = user_path(folder)
    with reading(folder):
        manifest = read_manifest(folder) if folder.is_dir() else None
    stored = None if manifest is None else manifest.recipe
    if recipe is None:
        if stored is not None:
            raise ConfigError(
                f"{folder / MANIFEST}: the data set of recipe {stored.name}: continue with --recipe, or choose "
                "another folder"
            )
        return None
    asked = RecipeRecord(recipe.name, recipe.sha256)
    if stored is None and manifest is not None and manifest.splits:
        raise ConfigError(f"{folder / MANIFEST}: made without a recipe, asked for {recipe.name}: choose another folder")
    if stored is not None and (stored.name, stored.sha256) != (asked.name, asked.sha256):
        raise ConfigError(
            f"{folder / MANIFEST}: made by recipe {_brief(stored)}, asked for {_brief(asked)}: use the same or another "
            "folder"
        )
    return stored


class NamedRecipe(Protocol):
    """A ``Recipe``, or its record in the plan of a data set made in parts."""

    @property
    def name(self) -> str: ...
    @property
    def sha256(self) -> str: ...
    @property
    def splits(self) -> Mapping[str, float]: ...
    @property
    def patterns(self) -> str: ...


def seal(folder: Path, recipe: NamedRecipe) -> None:
    """Write the hash of all patterns to the manifest of a complete data set, unless the manifest has it.

    If the hash agrees with the recipe's (``PatternHash.agrees``), the recipe's is written, so that all machines write
    the same one; if not, a warning is logged. Raises ``ShardError`` for damaged samples, ``OutputError``.
    """
    folder = user_path(folder)
    if is_sealed(folder, recipe):
        return
    found = hash_of(folder, recipe)
    agrees = found.agrees(recipe.patterns)
    if recipe.patterns and not agrees:
        log.warning(
            "%s: its patterns differ from the patterns of %s: this version of the package, of NumPy, SciPy or Shapely, "
            "draws different patterns; the data set can be used, but not under that name",
            folder,
            recipe.name,
        )
    keep_recipe(folder, RecipeRecord(recipe.name, recipe.sha256, recipe.patterns if agrees else found.text))


def is_sealed(folder: Path, recipe: NamedRecipe) -> bool:
    """Whether the manifest of a folder names the recipe and has the hash of its patterns: the data set is complete."""
    with reading(folder):
        manifest = read_manifest(folder) if folder.is_dir() else None
    stored = None if manifest is None else manifest.recipe
    return stored is not None and (stored.name, stored.sha256) == (recipe.name, recipe.sha256) and bool(stored.patterns)


def hash_of(folder: Path, recipe: NamedRecipe) -> PatternHash:
    """The hash of the patterns of all splits. Raises ``ShardError``."""
    store = FolderStore(folder)
    return sum((PatternHash.of(stored_patterns(ShardReader(store, split))) for split in recipe.splits), PatternHash())


def _brief(record: RecipeRecord) -> str:
    return f"{record.name} ({record.sha256[:DIGITS]})"
