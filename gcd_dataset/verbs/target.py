"""Where samples go: a folder of shards, a part of one, or a store at a URL."""

import contextlib
from collections.abc import Iterator, Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Protocol

from gcd_dataset.errors import ConfigError
from gcd_dataset.files import user_path
from gcd_dataset.generator.recipe import MakeConfig, recipe_of
from gcd_dataset.generator.recipes import Recipe
from gcd_dataset.hub.site import Remote
from gcd_dataset.hub.source import Folder, Url, parse_target
from gcd_dataset.hub.uploading import StoreTarget
from gcd_dataset.records import Outcome, Rejected
from gcd_dataset.shards.job_parts import require_merged
from gcd_dataset.shards.layout import Bytes
from gcd_dataset.shards.manifest import SplitRecord
from gcd_dataset.shards.rejects import RejectLog, has_rejects
from gcd_dataset.verbs.array_jobs import JobPart, PartPlace, begin_part
from gcd_dataset.verbs.seal import claim, require_claimable
from gcd_dataset.verbs.storing import GarmentWriter, SplitRule, division_of, filling_all

__all__ = ["FolderTarget", "Target", "Writer", "require_folder", "target_of"]


class Writer(Protocol):
    """Takes samples."""

    def add(
        self, index: int, members: Mapping[str, Bytes], outcome: Outcome | None, turned_down: Sequence[Rejected]
    ) -> None:
        """Add a sample as the files of the data set's layout, and the attempts turned down before it."""


class Target(Protocol):
    """A data set that is made. Its methods raise ``ConfigError`` where something else is there."""

    @property
    def indices(self) -> range:
        """Its samples."""

    def done(self) -> frozenset[int]:
        """The samples that need not be made again; what a killed run left half-written is put in order."""

    def filling(self, *, is_missing: bool) -> AbstractContextManager[Writer]:
        """The only writer, of samples that are missing if any; the data set is whole once the block has ended well."""


@dataclass(frozen=True)
class FolderTarget:
    """A folder of shards. Raises ``OutputError`` where it cannot be written."""

    folder: Path
    """Of the data set, or of the part."""
    indices: range
    seed: int
    config: MakeConfig
    division: SplitRule
    """Into splits."""
    place: PartPlace | None = None
    """Of a part."""

    def done(self) -> frozenset[int]:
        if self.place is not None and self.place.is_merged:
            return frozenset(self.indices)
        with self._writer() as writer:
            return writer.done

    @contextlib.contextmanager
    def filling(self, *, is_missing: bool) -> Iterator[Writer]:
        if self.place is not None and not is_missing and self.place.is_finished:
            yield _Full(self.folder)
            return
        with filling_all(self.folder, len(self.indices), self.division):
            if is_missing or not has_rejects(self.folder):
                with self._writer() as writer, self._reject_log(writer) as rejects:
                    if self.place is not None:
                        self.place.begin()
                    yield _FolderWriter(writer, rejects)
            else:
                yield _Full(self.folder)
        if self.place is not None:
            self.place.finish()

    def opened(self) -> "_OpenWriter":
        """The writer of the folder, to be closed."""
        with contextlib.ExitStack() as opened:
            writer = opened.enter_context(self._writer())
            return _OpenWriter(writer, opened.enter_context(self._reject_log(writer)), opened.pop_all())

    def _writer(self) -> GarmentWriter:
        return GarmentWriter(self.folder, self.seed, self.config, self.division)

    def _reject_log(self, writer: GarmentWriter) -> RejectLog:
        return RejectLog(self.folder, seed=self.seed, wearers=self.config.wearers, done=lambda: writer.done)


@dataclass(frozen=True)
class _FolderWriter:
    """Writes samples into their splits, and what was turned down before them."""

    writer: GarmentWriter
    rejects: RejectLog

    def add(
        self, index: int, members: Mapping[str, Bytes], outcome: Outcome | None, turned_down: Sequence[Rejected]
    ) -> None:
        self.rejects.add(turned_down)
        self.writer.add(index, members, outcome)


@dataclass(frozen=True)
class _OpenWriter(_FolderWriter):
    """The same, until it is closed."""

    held: contextlib.ExitStack

    @property
    def done(self) -> frozenset[int]:
        """The samples that are whole on disk."""
        return self.writer.done

    def close(self) -> None:
        """Make whole what was added."""
        self.held.close()


@dataclass(frozen=True)
class _Full:
    """The writer of a data set in which nothing is missing."""

    folder: Path

    def add(
        self, index: int, members: Mapping[str, Bytes], outcome: Outcome | None, turned_down: Sequence[Rejected]
    ) -> None:
        raise ConfigError(f"{self.folder}: sample {index} is there already: write what is missing")


@dataclass(frozen=True)
class _UrlTarget:
    """A data set at a URL."""

    store: StoreTarget
    indices: range

    def done(self) -> frozenset[int]:
        return self.store.done(len(self.indices))

    def filling(self, *, is_missing: bool) -> AbstractContextManager[Writer]:
        return self.store.filling(len(self.indices))


def target_of(
    out: Path | str,
    count: int,
    *,
    seed: int,
    config: MakeConfig,
    recipe: Recipe | None = None,
    part: JobPart | None = None,
    spool: Path | str | None = None,
    patience: float | None = None,
) -> Target:
    """Samples 0 … ``count`` - 1 of a seed and a config, or those of a part, in a folder or at the URL of a store.

    ``spool``: folder in which shards wait for their upload, by default in ``~/.cache/gcd_dataset``; ``patience`` as
    ``GarmentDataset`` takes it. Raises ``ConfigError`` for options that do not fit the place, for a folder that holds
    the data set of another recipe, and parts of another plan or not merged.
    """
    place, division = parse_target(out), division_of(config, recipe)
    if isinstance(place, Folder):
        for name, value in (("spool", spool), ("patience", patience)):
            if value is not None:
                raise ConfigError(f"{name}={value} is for URLs, and {place} is a folder: leave it out")
        folder = user_path(place.path)
        require_claimable(folder, recipe)  # before the plan of parts is written
        target = _folder_target(folder, count, seed, config, division, part)
        claim(folder, recipe)
        return target
    for what, is_asked in (("data sets of recipes", recipe is not None), ("parts", part is not None)):
        if is_asked:
            raise _only_here(place, what)
    remote = Remote(patience=patience)
    spools = remote.folder / "spool" if spool is None else user_path(spool)
    asked = {split: SplitRecord(seed, recipe_of(config), size) for split, size in division.shard_sizes.items()}
    opened = partial(_opened, seed, config, division)
    return _UrlTarget(StoreTarget(place, asked, spools, opened, patience=remote.patience), range(count))


def _opened(seed: int, config: MakeConfig, division: SplitRule, folder: Path) -> _OpenWriter:
    return FolderTarget(folder, range(0), seed, config, division).opened()


def _folder_target(
    folder: Path, count: int, seed: int, config: MakeConfig, division: SplitRule, part: JobPart | None
) -> FolderTarget:
    if part is None:
        require_merged(folder, ConfigError)
        return FolderTarget(folder, range(count), seed, config, division)
    place = begin_part(folder, part, count, seed, config, division)
    return FolderTarget(place.folder, place.indices, seed, config, division, place)


def require_folder(out: Path | str, what: str) -> Path:
    """The folder, if ``out`` is one. Raises ``ConfigError`` for the URL of a store."""
    place = parse_target(out)
    if not isinstance(place, Folder):
        raise _only_here(place, what)
    return place.path


def _only_here(place: Url, what: str) -> ConfigError:
    return ConfigError(f"{place}: {what} are made in a folder: give one, and copy it there")
