"""The interface between ``ShardReader`` and the storage of a data set: a folder, or a server."""

import logging
import math
from abc import ABC, abstractmethod
from collections.abc import Iterable, Sequence
from typing import BinaryIO, NamedTuple

from gcd_dataset.shards.access import REMEDY
from gcd_dataset.shards.index import ShardIndex
from gcd_dataset.shards.layout import Layout
from gcd_dataset.shards.manifest import Manifest

__all__ = ["MemberLocation", "Store", "runs"]


class MemberLocation(NamedTuple):
    """Offset, size and CRC-32 of one member of a sample in its shard."""

    column: int
    """Position of the member in ``Layout.members``."""
    offset: int
    size: int
    crc: int

    @property
    def end(self) -> int:
        return self.offset + self.size


class Store(ABC):
    """The files of a data set. May be pickled, forked, and read from several threads."""

    source: str | None = None
    """Origin and revision of the data; ``None`` where unknown."""

    remedy: str = REMEDY
    """The remedy in messages about damaged members."""

    @abstractmethod
    def location(self, name: str = "") -> str:
        """The path or URL of a file, by default of the whole data set, for messages."""

    @abstractmethod
    def manifest(self) -> Manifest | None:
        """The manifest; ``None`` without one. Raises ``ShardError``."""

    @abstractmethod
    def index(self, split: str, layout: Layout) -> ShardIndex:
        """The index of a split; its layout is ``layout``, reduced to the members present.

        Raises ``ShardError`` where the split is broken, incomplete, empty, or of another layout.
        """

    @abstractmethod
    def unfinished(self, split: str) -> str | None:
        """A message that the run that writes a split has not finished, with a remedy; ``None`` if it has."""

    def warn_unfinished(self, splits: Iterable[str]) -> None:
        """Log a warning for each split whose run has not finished."""
        for split in splits:
            if (fault := self.unfinished(split)) is not None:
                message = "%s: split %s is unfinished: %s; partial=True opens it without this warning"
                logging.getLogger("gcd_dataset").warning(message, self.location(), split, fault)

    @abstractmethod
    def read(self, shard: str, number: int, parts: Sequence[MemberLocation]) -> dict[int, memoryview]:
        """Column to content of members of sample ``number`` of a shard; ``parts`` in file order.

        The caller owns the buffers and may write to them. Raises ``ShardError``.
        """

    def read_many(self, wanted: Sequence[tuple[str, int, Sequence[MemberLocation]]]) -> Iterable[dict[int, memoryview]]:
        """As ``read``, for several samples: shard, number and members of each. Raises ``ShardError``."""
        # One by one: each sample is checked while it is in the CPU cache.
        return (self.read(*sample) for sample in wanted)

    def refetch(self, shard: str, number: int, part: MemberLocation) -> memoryview | None:
        """Fetch a damaged member again; ``None`` where the store has no other copy."""
        return None

    @abstractmethod
    def stream(self, shard: str) -> BinaryIO:
        """A shard as a file, from its first byte on. Raises ``ShardError``, also on reading."""


def runs(parts: Sequence[MemberLocation], gap: int) -> list[list[MemberLocation]]:
    """Group members, given in file order, into runs with at most ``gap`` bytes between neighbours."""
    found: list[list[MemberLocation]] = []
    end = -math.inf
    for part in parts:
        _, offset, size, _ = part
        if offset - end > gap:
            found.append([])
        found[-1].append(part)
        end = offset + size
    return found
