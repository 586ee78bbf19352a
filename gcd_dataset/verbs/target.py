"""Targets of generated samples: a folder of shards, a part of one, or a store at a URL."""

import contextlib
from collections.abc import Iterator, Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Protocol

from gcd_dataset.errors import ConfigError
from gcd_dataset.files import user_path
from gcd_dataset.generator.recipe import MakeConfig, layout_of_samples, recipe_of
from gcd_dataset.generator.recipes import Recipe
from gcd_dataset.hub.site import Remote
from gcd_dataset.hub.source import Folder, Url, parse_target
from gcd_dataset.hub.uploading import StoreTarget
from gcd_dataset.records import Outcome, Rejected
from gcd_dataset.shards.job_parts import require_merged
from gcd_dataset.shards.layout import Bytes
from gcd_dataset.shards.manifest import SplitRecord
from gcd_dataset.shards.rejects import RejectLog, has_rejects
from gcd_dataset.verbs.array_jobs import JobPart, PartFolder, begin_part
from gcd_dataset.verbs.seal import claim, require_claimable
from gcd_dataset.verbs.storing import GarmentWriter, SplitRule, marked_unfinished, split_rule

__all__ = ["FolderTarget", "Target", "Writer", "require_folder", "target_of"]


class Writer(Protocol):
    """Stores samples, one by one."""

    def add(
        self, index: int, members: Mapping[str, Bytes], outcome: Outcome | None, turned_down: Sequence[Rejected]
    ) -> None:
        """Store a sample, given as members, and the attempts rejected before it."""


class Target(Protocol):
    """The destination of a data set. Its methods raise ``ConfigError`` if another data set is there."""

    @property
    def indices(self) -> range:
        """Indices of the samples of this target."""

    def done(self) -> frozenset[int]:
        """Indices of the stored samples; repairs shards that a killed run left unfinished."""

    def writing(self, *, is_missing: bool) -> AbstractContextManager[Writer]:
        """The single writer of the missing samples; the data set is complete when the block succeeds.

        ``is_missing``: whether any sample is missing.
        """


@dataclass(frozen=True)
class FolderTarget:
    """A folder of shards. Methods raise ``OutputError`` if it cannot be written."""

    folder: Path
    """Folder of the data set, or of the part."""
    indices: range
    seed: int
    config: MakeConfig
    rule: SplitRule
    part: PartFolder | None = None
    """The part, if the data set is made in parts."""

    def done(self) -> frozenset[int]:
        if self.part is not None and self.part.is_merged:
            return frozenset(self.indices)
        with self._writer() as writer:
            return writer.done

    @contextlib.contextmanager
    def writing(self, *, is_missing: bool) -> Iterator[Writer]:
        if self.part is not None and not is_missing and self.part.is_finished:
            yield _CompleteWriter(self.folder)
            return
        with marked_unfinished(self.folder, len(self.indices), self.rule):
            if is_missing or not has_rejects(self.folder):
                with self._writer() as writer, self._reject_log(writer) as rejects:
                    if self.part is not None:
                        self.part.begin()
                    yield _FolderWriter(writer, rejects)
            else:
                yield _CompleteWriter(self.folder)
        if self.part is not None:
            self.part.finish()

    def open(self) -> "_OpenWriter":
        """An open writer of the folder; the caller closes it."""
        with contextlib.ExitStack() as stack:
            writer = stack.enter_context(self._writer())
            return _OpenWriter(writer, stack.enter_context(self._reject_log(writer)), stack.pop_all())

    def _writer(self) -> GarmentWriter:
        return GarmentWriter(self.folder, self.seed, self.config, self.rule)

    def _reject_log(self, writer: GarmentWriter) -> RejectLog:
        return RejectLog(self.folder, seed=self.seed, wearers=self.config.wearers, done=lambda: writer.done)


@dataclass(frozen=True)
class _FolderWriter:
    """Writes samples into their splits, and rejected attempts into the reject log."""

    writer: GarmentWriter
    rejects: RejectLog

    def add(
        self, index: int, members: Mapping[str, Bytes], outcome: Outcome | None, turned_down: Sequence[Rejected]
    ) -> None:
        self.rejects.add(turned_down)
        self.writer.add(index, members, outcome)


@dataclass(frozen=True)
class _OpenWriter(_FolderWriter):
    """A folder writer with ``close``: its caller keeps it open without a ``with`` block."""

    stack: contextlib.ExitStack

    @property
    def done(self) -> frozenset[int]:
        """Indices of the samples that are complete on disk."""
        return self.writer.done

    def close(self) -> None:
        """Finish the shards and release the locks."""
        self.stack.close()


@dataclass(frozen=True)
class _CompleteWriter:
    """The writer of a complete data set: rejects every sample."""

    folder: Path

    def add(
        self, index: int, members: Mapping[str, Bytes], outcome: Outcome | None, turned_down: Sequence[Rejected]
    ) -> None:
        raise ConfigError(f"{self.folder}: sample {index} is there already: write missing samples only")


@dataclass(frozen=True)
class _UrlTarget:
    """A data set at a URL."""

    store: StoreTarget
    indices: range

    def done(self) -> frozenset[int]:
        return self.store.done(len(self.indices))

    def writing(self, *, is_missing: bool) -> AbstractContextManager[Writer]:
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
    """The target for samples 0 … ``count`` - 1 of a seed and a config, or for a part, in a folder or at a URL.

    ``spool``: folder in which shards wait for their upload, by default in ``~/.cache/gcd_dataset``; ``patience`` as for
    ``GarmentDataset``. Raises ``ConfigError`` for options that do not fit a folder, or a URL; for a folder with the
    data set of another recipe, with parts of another plan, or, without ``part``, with parts that are not merged.
    """
    target, rule = parse_target(out), split_rule(config, recipe)
    if isinstance(target, Folder):
        for name, value in (("spool", spool), ("patience", patience)):
            if value is not None:
                raise ConfigError(f"{name}={value} is for URLs, and {target} is a folder: leave it out")
        folder = user_path(target.path)
        require_claimable(folder, recipe)  # fails before the plan of the parts is written
        folder_target = _folder_target(folder, count, seed, config, rule, part)
        claim(folder, recipe)
        return folder_target
    for data, is_asked in (("data sets of recipes", recipe is not None), ("parts", part is not None)):
        if is_asked:
            raise _folder_needed(target, data)
    remote = Remote(patience=patience)
    spools = remote.folder / "spool" if spool is None else user_path(spool)
    asked = {split: SplitRecord(seed, recipe_of(config), size) for split, size in rule.shard_sizes.items()}
    open_writer = partial(_open_writer, seed, config, rule)
    return _UrlTarget(
        StoreTarget(target, asked, spools, open_writer, layout=layout_of_samples(config), patience=remote.patience),
        range(count),
    )


def _open_writer(seed: int, config: MakeConfig, rule: SplitRule, folder: Path) -> _OpenWriter:
    return FolderTarget(folder, range(0), seed, config, rule).open()


def _folder_target(
    folder: Path, count: int, seed: int, config: MakeConfig, rule: SplitRule, part: JobPart | None
) -> FolderTarget:
    if part is None:
        require_merged(folder, ConfigError)
        return FolderTarget(folder, range(count), seed, config, rule)
    part_folder = begin_part(folder, part, count, seed, config, rule)
    return FolderTarget(part_folder.path, part_folder.indices, seed, config, rule, part_folder)


def require_folder(out: Path | str, data: str) -> Path:
    """The folder that ``out`` names. Raises ``ConfigError`` for the URL of a store; ``data`` is named in the error."""
    target = parse_target(out)
    if not isinstance(target, Folder):
        raise _folder_needed(target, data)
    return target.path


def _folder_needed(url: Url, data: str) -> ConfigError:
    return ConfigError(f"{url}: {data} are made in a folder: give a folder, then copy it to the URL")
