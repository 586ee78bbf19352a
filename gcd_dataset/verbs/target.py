"""Where samples go: a folder of shards, or a store at a URL."""

import contextlib
from collections.abc import Iterator, Mapping
from contextlib import AbstractContextManager
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

from gcd_dataset.errors import ConfigError
from gcd_dataset.files import user_path
from gcd_dataset.generator.recipe import MakeConfig, recipe_of
from gcd_dataset.generator.recipes import Recipe
from gcd_dataset.hub.place import Folder, Url, place_to_write
from gcd_dataset.hub.site import Remote
from gcd_dataset.hub.uploading import StoreTarget
from gcd_dataset.shards.layout import Bytes
from gcd_dataset.shards.manifest import SplitRecord
from gcd_dataset.shards.unfinished import filling
from gcd_dataset.shards.writer import SHARD_SIZE, ShardWriter
from gcd_dataset.verbs.seal import claim
from gcd_dataset.verbs.splits import DividedWriter, divided_writer, filling_splits

__all__ = ["FolderTarget", "Target", "Writer", "require_folder", "target_of"]


class Writer(Protocol):
    """Takes samples."""

    def add(self, index: int, members: Mapping[str, Bytes]) -> None:
        """Add a sample as the files of the data set's layout."""


class Target(Protocol):
    """A split that is made. Its methods raise ``ConfigError`` where something else is there."""

    def done(self, count: int) -> frozenset[int]:
        """The samples that need not be made again; what a killed run left half-written is put in order."""

    def filling(self, count: int) -> AbstractContextManager[Writer]:
        """The only writer of the split, which is whole once the block has ended well."""


@dataclass(frozen=True)
class FolderTarget:
    """A folder of shards. Raises ``OutputError`` where it cannot be written."""

    folder: Path
    seed: int
    config: MakeConfig
    recipe: Recipe | None = None
    """Divides the samples into splits; without one all go into ``train``."""

    def done(self, count: int) -> frozenset[int]:
        claim(self.folder, self.recipe)
        with self._writer() as writer:
            return writer.done

    @contextlib.contextmanager
    def filling(self, count: int) -> Iterator[Writer]:
        note = filling(self.folder, count) if self.recipe is None else filling_splits(self.folder, self.recipe)
        with note, self._writer() as writer:
            yield writer

    def _writer(self) -> AbstractContextManager[ShardWriter | DividedWriter]:
        if self.recipe is None:
            return ShardWriter(self.folder, seed=self.seed, recipe=recipe_of(self.config), shard_size=SHARD_SIZE)
        return divided_writer(self.folder, self.recipe, self.config)


def target_of(
    out: Path | str,
    *,
    seed: int,
    config: MakeConfig,
    recipe: Recipe | None = None,
    spool: Path | str | None = None,
    patience: float | None = None,
) -> Target:
    """Garments of a seed and a config in a folder, or at the URL of a store.

    ``spool``: folder in which shards wait for their upload, by default in ``~/.cache/gcd_dataset``; ``patience`` as
    ``GarmentDataset`` takes it. Raises ``ConfigError`` for anything else, and for options that a folder has no use for.
    """
    place = place_to_write(out)
    if isinstance(place, Folder):
        for name, value in (("spool", spool), ("patience", patience)):
            if value is not None:
                raise ConfigError(f"{name}={value} is for URLs, and {place} is a folder: leave it out")
        return FolderTarget(place.path, seed, config, recipe)
    if recipe is not None:
        raise _only_here(place, "data sets of recipes")
    remote, asked = Remote(patience=patience), SplitRecord(seed, recipe_of(config), SHARD_SIZE)
    spools = remote.folder / "spool" if spool is None else user_path(spool)
    return StoreTarget(place, asked, spools, patience=remote.patience)


def require_folder(out: Path | str, what: str) -> Path:
    """The folder, if ``out`` is one. Raises ``ConfigError`` for the URL of a store."""
    place = place_to_write(out)
    if not isinstance(place, Folder):
        raise _only_here(place, what)
    return place.path


def _only_here(place: Url, what: str) -> ConfigError:
    return ConfigError(f"{place}: {what} are made in a folder: give one, and copy it there")
