"""The source ``recipe:NAME``: a data set that is made on first use."""

from collections.abc import Sequence
from pathlib import Path

from gcd_dataset.errors import ConfigError, ShardError, did_you_mean
from gcd_dataset.files import user_path
from gcd_dataset.hub.site import Remote

__all__ = ["RECIPE", "recipe_folder"]

RECIPE = "recipe:"
SERVER = ("revision", "endpoint", "token", "max_cache_size", "patience")
"""Options of remote sources."""


def recipe_folder(source: str, remote: Remote, root: str | Path | None, splits: Sequence[str]) -> Path:
    """The folder of the data set of ``recipe:NAME`` or ``recipe:FILE.toml``; makes the data set if it is missing.

    The folder is ``root``/NAME, by default in the cache; no server is asked. Raises ``ConfigError`` for an unknown
    recipe or split, and for options of remote sources; ``ShardError`` for a missing data set with ``download=False``.
    """
    # Imported here: other sources do not need the generator.
    from gcd_dataset.generator.recipes import find_recipe
    from gcd_dataset.verbs.recipes import ensure_recipe
    from gcd_dataset.verbs.seal import is_sealed

    if given := [name for name in SERVER if getattr(remote, name) is not None]:
        raise ConfigError(f"{given[0]} is for URLs and the Hub, but {source} is made here: leave it out")
    recipe = find_recipe(source.removeprefix(RECIPE))
    for split in splits:
        if split not in recipe.splits:
            known = list(recipe.splits)
            raise ConfigError(
                f"{recipe.name} has no split {split}: there are {', '.join(known)}{did_you_mean(split, known)}"
            )
    base = remote.folder / "recipes" if root is None else user_path(root)
    folder = base / recipe.name
    if not remote.allowed and not is_sealed(folder, recipe):
        raise ShardError(f"{folder}: {recipe.name} is not there, and download=False: leave that out to make it")
    ensure_recipe(recipe, folder)
    return folder
