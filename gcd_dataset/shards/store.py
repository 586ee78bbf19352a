"""The interface between ``ShardReader`` and the files of a data set: a folder, or a server."""

import logging
from abc import ABC, abstractmethod
from collections.abc import Iterable, Sequence
from pathlib import Path

from gcd_dataset.errors import ShardError, did_you_mean
from gcd_dataset.shards.access import REMEDY
from gcd_dataset.shards.index import SplitIndex
from gcd_dataset.shards.layout import Bytes
from gcd_dataset.shards.manifest import Manifest, ShardRecord, SplitRecord


class Store(ABC):
    """The files of a data set. May be pickled, forked, and read from several threads."""

    source: str | None = None
    """Origin and revision of the data; ``None`` where unknown."""

    remedy: str = REMEDY
    """The remedy in messages about damaged samples."""

    @abstractmethod
    def location(self, name: str = "") -> str:
        """The path or URL of a file, by default of the whole data set, for messages."""

    @abstractmethod
    def manifest(self) -> Manifest:
        """The manifest; gathered from the notes of the shards where there is none. Raises ``ShardError``."""

    def record(self, split: str) -> SplitRecord:
        """The record of a split. Raises ``ShardError`` where it is missing or empty."""
        splits = self.manifest().splits
        if split in splits and splits[split].count:
            return splits[split]
        choice = f"choose from {', '.join(splits)}{did_you_mean(split, splits)}"
        fault = "none is finished" if split in splits else choice
        raise ShardError(f"{self.location()}: no samples of split {split}: {fault}")

    @abstractmethod
    def index(self, split: str) -> SplitIndex:
        """The index of a split. Raises ``ShardError`` where the split is missing, empty or broken."""

    @abstractmethod
    def path(self, split: str, shard: ShardRecord, *, views: bool = False) -> Path:
        """The whole tar of a shard, or of its pictures, on this machine. Raises ``ShardError``."""

    @abstractmethod
    def part(self, split: str, shard: ShardRecord, start: int, end: int, *, views: bool = False) -> Bytes:
        """Bytes ``start`` to ``end`` of a shard, or of the tar of its pictures. Raises ``ShardError``."""

    def parts(self, split: str, wanted: Sequence[tuple[ShardRecord, int, int, bool]]) -> Iterable[Bytes]:
        """As ``part``, for several samples: shard, start, end and whether of the pictures. Raises ``ShardError``."""
        # One by one: each sample is checked while it is in the CPU cache.
        return (self.part(split, shard, start, end, views=views) for shard, start, end, views in wanted)

    def ensure(self, split: str, shards: Iterable[ShardRecord], *, views: bool = False) -> None:  # noqa: B027
        """Bring whole tars of several shards onto this machine, at once; a folder has them. Raises ``ShardError``."""

    @property
    @abstractmethod
    def cache(self) -> Path:
        """The folder with one folder for each shard, named by its SHA-256, for data derived from it."""

    def unfinished(self, split: str) -> str | None:
        """A message that not all samples of the data set are made, with a remedy; ``None`` if all are."""
        manifest = self.manifest()
        if split not in manifest.splits or (missing := manifest.missing(split)) is None:
            return None
        return f"{missing[0]} of {missing[1]} samples are made: {self._continuation(split)}"

    def _continuation(self, split: str) -> str:
        return "ask its publisher to finish it"

    def warn_unfinished(self, splits: Iterable[str]) -> None:
        """Log a warning for the first split that is unfinished."""
        for split in splits:
            if (fault := self.unfinished(split)) is not None:
                message = "%s: the data set is unfinished: %s; partial=True opens it without this warning"
                logging.getLogger("gcd_dataset").warning(message, self.location(), fault)
                return
