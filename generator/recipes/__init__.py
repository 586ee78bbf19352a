"""Recipes: named, citable descriptions of data sets, complete enough to make them again.

A recipe is a TOML file, in this package or a user's own::

    name = "hoodies-2k"
    about = "1,000 hoodies on two bodies"      # one sentence
    designs = 1000
    seed = 0
    first_ten = "09c2…"                        # hash of the patterns of the first ten samples, if known
    patterns = "a41f…"                         # hash of all patterns, if known

    [options]                                  # options of ``MakeConfig`` other than ``FREE``
    bodies = "both"
    [options.design.collar.component]
    style = "Hood2Panels"

    [splits]                                   # shares of the designs
    test = 0.1
    train = 0.9

The split of a design is a function of the recipe's seed and the design's number. All garments of a design are in one
split, and so are its random bodies, since each is drawn for one design. Splits cover the interval from 0 to 1 in the
order listed: recipes with the same seed and the same leading shares put the same designs into those splits. Failed
drapes stay in the data set with their outcome: the set of failures differs between machines, the set of patterns must
not.

>>> recipe = find_recipe("smoke-64")
>>> recipe.count, recipe.split_of(5), recipe.sizes()
(64, 'train', {'test': 2, 'validation': 4, 'train': 58})
"""

import re
from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Int

from gcd_dataset.errors import ConfigError, ShardError, did_you_mean, shown
from gcd_dataset.files import require_name, user_path
from gcd_dataset.generator.garments.overlay import Overlay
from gcd_dataset.generator.recipe import MakeConfig, recipe_of
from gcd_dataset.jsonfile import read_toml
from gcd_dataset.options import require_options
from gcd_dataset.seeding import Stage, rng
from gcd_dataset.shards.layout import recipe_hash

__all__ = ["FREE", "Recipe", "find_recipe", "read_recipe", "recipe_names"]

FREE = ("device", "on_fail")
"""Options of ``MakeConfig`` not allowed in a recipe: any device will do, and failed drapes are always kept."""

MAX_DESIGNS = 5_000_000
TYPES: Mapping[str, tuple[type, str]] = {
    "name": (str, "a text"),
    "about": (str, "a text"),
    "designs": (int, "a whole number"),
    "seed": (int, "a whole number"),
    "first_ten": (str, "64 hexadecimal digits"),
    "patterns": (str, "64 hexadecimal digits"),
    "options": (dict, "a table [options]"),
    "splits": (dict, "a table [splits]"),
}


@dataclass(frozen=True)
class Recipe:
    """All that decides the content of a data set, except the device."""

    name: str
    about: str
    """Its purpose, in a sentence."""
    designs: int
    seed: int
    config: MakeConfig
    splits: Mapping[str, float]
    """Share of the designs in each split; the shares add up to 1."""
    first_ten: str = ""
    """``PatternHash.text`` of the patterns of the first ten samples; empty if they have never been made."""
    patterns: str = ""
    """``PatternHash.text`` of all patterns; empty if they have never all been made."""

    @property
    def count(self) -> int:
        """Number of samples in all splits."""
        return self.designs * self.config.wearers

    @property
    def sha256(self) -> str:
        """SHA-256 of designs, seed, options and splits; name, comments and device do not count."""
        options = recipe_of(self.config)
        del options["device"]
        splits = [[name, share] for name, share in self.splits.items()]
        return recipe_hash({"designs": self.designs, "seed": self.seed, "options": options, "splits": splits})

    def split_of(self, index: int) -> str:
        """The split of sample ``index``."""
        return tuple(self.splits)[self._split_numbers[index // self.config.wearers]]

    def indices_in(self, split: str) -> Int[np.ndarray, " n"]:
        """Indices of the samples of a split, ascending."""
        designs = np.flatnonzero(self._split_numbers == tuple(self.splits).index(split))
        return (designs[:, None] * self.config.wearers + np.arange(self.config.wearers)).ravel()

    def sizes(self) -> dict[str, int]:
        """Number of samples in each split."""
        counts = np.bincount(self._split_numbers, minlength=len(self.splits)) * self.config.wearers
        return dict(zip(self.splits, counts.tolist(), strict=True))

    @property
    def _split_numbers(self) -> Int[np.ndarray, " n"]:
        return _draw_splits(self.seed, self.designs, tuple(self.splits.values()))


def find_recipe(name: str | Path) -> Recipe:
    """The recipe of this name, or in the TOML file at this path.

    Raises ``ConfigError`` with the known names, and for an invalid file.
    """
    text = str(name)
    if text.endswith(".toml") or "/" in text:
        return read_recipe(user_path(text))
    known = recipe_names()
    if text not in known:
        raise ConfigError(
            f"no recipe {shown(text)}: there are {', '.join(known)}; or give the path of a FILE.toml"
            f"{did_you_mean(text, known)}"
        )
    return read_recipe(Path(str(files(__name__) / f"{text}.toml")))


def recipe_names() -> tuple[str, ...]:
    """Names of the recipes in this package, the smallest data set first."""
    names = [entry.name.removesuffix(".toml") for entry in files(__name__).iterdir() if entry.name.endswith(".toml")]
    sizes = {name: read_recipe(Path(str(files(__name__) / f"{name}.toml"))).designs for name in names}
    return tuple(sorted(names, key=lambda name: (sizes[name], name)))


def read_recipe(path: Path) -> Recipe:
    """The recipe in a TOML file. Raises ``ConfigError`` with the file and the invalid entry."""
    values = read_toml(path)
    try:
        return _recipe(values)
    except (ConfigError, ShardError) as error:  # ShardError: an invalid name
        raise ConfigError(f"{path}: {error}") from error


def _recipe(values: Mapping[str, Any]) -> Recipe:
    for name, value in values.items():
        if name not in TYPES:
            raise ConfigError(f"no entry {shown(name)}: there are {', '.join(TYPES)}{did_you_mean(name, TYPES)}")
        kind, wanted = TYPES[name]
        if not isinstance(value, kind) or isinstance(value, bool):
            raise ConfigError(f"{name} is {value!r:.99}: give {wanted}")
    for name in TYPES:
        if name not in values and name not in ("first_ten", "patterns", "options"):
            raise ConfigError(f"no {name}: give {TYPES[name][1]}")
    recipe = Recipe(
        name=require_name(values["name"], "recipe"),
        about=values["about"],
        designs=values["designs"],
        seed=values["seed"],
        config=_config(values.get("options", {})),
        splits=_splits(values["splits"]),
        first_ten=values.get("first_ten", ""),
        patterns=values.get("patterns", ""),
    )
    _require_sound(recipe)
    return recipe


def _config(values: Mapping[str, Any]) -> MakeConfig:
    options = {name.replace("-", "_"): value for name, value in values.items()}
    if free := [name for name in FREE if name in options]:
        raise ConfigError(f"options: {free[0]} is not part of a recipe: leave it out")
    require_options(options, MakeConfig)
    if isinstance(options.get("design"), Mapping):
        options["design"] = Overlay.from_dict(options["design"])
    return MakeConfig(**options, on_fail="keep")


def _splits(values: Mapping[str, Any]) -> dict[str, float]:
    for name, share in values.items():
        require_name(name, "split")
        if isinstance(share, bool) or not isinstance(share, int | float) or not 0 < share <= 1:
            raise ConfigError(f"splits: {name} is {share!r:.99}: give its share of the designs, such as 0.05")
    if abs(sum(values.values()) - 1) > 1e-9:
        raise ConfigError(f"splits: shares add up to {sum(values.values()):g}: they must add up to 1")
    return {name: float(share) for name, share in values.items()}


def _require_sound(recipe: Recipe) -> None:
    if not 1 <= recipe.designs <= MAX_DESIGNS:
        raise ConfigError(f"designs is {recipe.designs}: give 1 to {MAX_DESIGNS}")
    if recipe.seed < 0:
        raise ConfigError(f"seed is {recipe.seed}: give 0 or more")
    for name in ("first_ten", "patterns"):
        if not re.fullmatch(r"([0-9a-f]{64})?", text := getattr(recipe, name)):
            raise ConfigError(f"{name} is {text!r:.99}: give 64 hexadecimal digits, or leave it out")
    if empty := [name for name, size in recipe.sizes().items() if not size]:
        raise ConfigError(f"splits: {empty[0]} gets none of {recipe.designs} designs: give it a larger share")


@lru_cache(maxsize=8)
def _draw_splits(seed: int, designs: int, shares: tuple[float, ...]) -> Int[np.ndarray, " n"]:
    """The index of each design's split; a longer list of designs begins with the same splits."""
    uniform = rng(seed, 0, Stage.SPLIT).random(designs)
    ends = np.cumsum(shares)
    splits = np.minimum(np.searchsorted(ends, uniform, side="right"), len(ends) - 1)
    splits.flags.writeable = False  # cached: recipes with the same shares share the array
    return splits
