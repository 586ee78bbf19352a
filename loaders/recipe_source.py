"""Data sets by name: ``recipe:standard-1k`` is made where it is not there."""

from collections.abc import Sequence
from pathlib import Path

from gcd_dataset.errors import ConfigError, ShardError, did_you_mean
from gcd_dataset.files import user_path
from gcd_dataset.hub.site import Remote

__all__ = ["RECIPE", "recipe_folder"]

RECIPE = "recipe:"
SERVER = ("revision", "endpoint", "token", "max_cache_size", "patience")
"""Options for servers alone."""


def recipe_folder(source: str, remote: Remote, root: str | Path | None, splits: Sequence[str]) -> Path:
    """The folder of the data set that ``recipe:NAME`` or ``recipe:FILE.toml`` names, made now if it is not there.

    It is ``root``/NAME, by default in the cache. No server is asked. Raises ``ConfigError`` for an unknown recipe or
    split, and options for servers; ``ShardError`` where it is not there and nothing is to be fetched or made.
    """
    # Late: nobody else needs the generator and all it stands on.
    from gcd_dataset.generator.recipes import find_recipe
    from gcd_dataset.verbs.recipes import ensure_recipe
    from gcd_dataset.verbs.seal import is_sealed

    if given := [name for name in SERVER if getattr(remote, name) is not None]:
        raise ConfigError(f"{given[0]} is for URLs and the Hub, and {source} is made here: leave it out")
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
        raise ShardError(f"{folder}: {recipe.name} is not there, and download=False: leave that out, and it is made")
    ensure_recipe(recipe, folder)
    return folder
