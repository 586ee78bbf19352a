"""The name of a data set in its manifest: there before the first sample, the hash of its patterns after the last."""

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

DIGITS = 12  # of a hash, in messages

log = logging.getLogger(__name__)


def claim(folder: Path, recipe: Recipe | None) -> None:
    """Name the recipe in the manifest of a folder that is to be filled, after all other checks.

    Raises as ``require_claimable`` does, and ``OutputError`` for a folder that cannot be written.
    """
    if require_claimable(folder, recipe) is None and recipe is not None:
        keep_recipe(make_folder(user_path(folder)), RecipeRecord(recipe.name, recipe.sha256))


def require_claimable(folder: Path, recipe: Recipe | None) -> RecipeRecord | None:
    """The recipe that the manifest of a folder names, if any.

    Raises ``ConfigError`` for a folder that holds the data set of another recipe, or of none, and for ``None`` one of a
    recipe.
    """
    folder = user_path(folder)
    with reading(folder):
        manifest = read_manifest(folder) if folder.is_dir() else None
    there = None if manifest is None else manifest.recipe
    if recipe is None:
        if there is not None:
            raise ConfigError(
                f"{folder / MANIFEST}: the data set {there.name}: go on with --recipe, or choose another folder"
            )
        return None
    asked = RecipeRecord(recipe.name, recipe.sha256)
    if there is None and manifest is not None and manifest.splits:
        raise ConfigError(f"{folder / MANIFEST}: made without a recipe, asked for {recipe.name}: choose another folder")
    if there is not None and (there.name, there.sha256) != (asked.name, asked.sha256):
        raise ConfigError(
            f"{folder / MANIFEST}: made by recipe {_told(there)}, asked for {_told(asked)}: use the same or another "
            "folder"
        )
    return there


class Named(Protocol):
    """A recipe, or what the parts of its data set have noted of it."""

    @property
    def name(self) -> str: ...
    @property
    def sha256(self) -> str: ...
    @property
    def splits(self) -> Mapping[str, float]: ...
    @property
    def patterns(self) -> str: ...


def seal(folder: Path, recipe: Named) -> None:
    """Put the hash of all patterns into the manifest of a whole data set; nothing where it is.

    Where the recipe tells it, and numbers on the boundary between two steps alone are rounded otherwise, the recipe's
    is put there: the same from every machine. Warns of patterns that are others. Raises ``ShardError`` for damaged
    samples, ``OutputError``.
    """
    folder = user_path(folder)
    if is_sealed(folder, recipe):
        return
    found = hash_of(folder, recipe)
    agrees = found.agrees(recipe.patterns)
    if recipe.patterns and not agrees:
        log.warning(
            "%s: its patterns are not those of %s: this version of the package, or of NumPy, SciPy or Shapely, draws "
            "others; it is a data set all the same, but not the one of that name",
            folder,
            recipe.name,
        )
    keep_recipe(folder, RecipeRecord(recipe.name, recipe.sha256, recipe.patterns if agrees else found.text))


def is_sealed(folder: Path, recipe: Named) -> bool:
    """Whether all of the recipe's data set has been put into a folder, by what its manifest says."""
    with reading(folder):
        manifest = read_manifest(folder) if folder.is_dir() else None
    there = None if manifest is None else manifest.recipe
    return there is not None and (there.name, there.sha256) == (recipe.name, recipe.sha256) and bool(there.patterns)


def hash_of(folder: Path, recipe: Named) -> PatternHash:
    """The hash of the patterns of all splits. Raises ``ShardError``."""
    store = FolderStore(folder)
    return sum((PatternHash.of(stored_patterns(ShardReader(store, split))) for split in recipe.splits), PatternHash())


def _told(record: RecipeRecord) -> str:
    return f"{record.name} ({record.sha256[:DIGITS]})"
