"""Where the files of a data set lie: what a reader asks of a folder, and of a server."""

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
    """Where one member of a sample lies in its shard."""

    column: int
    """Place among the members of the layout."""
    offset: int
    size: int
    crc: int

    @property
    def end(self) -> int:
        return self.offset + self.size


class Store(ABC):
    """The files of a data set. May be pickled, forked, and read from several threads."""

    source: str | None = None
    """Where the data come from, and which revision of them; ``None`` where nobody has said."""

    remedy: str = REMEDY
    """What to do about damage in it."""

    @abstractmethod
    def place(self, name: str = "") -> str:
        """A file, or all of them, as messages name it."""

    @abstractmethod
    def manifest(self) -> Manifest | None:
        """What the data set is made of, if that is written down. Raises ``ShardError``."""

    @abstractmethod
    def index(self, split: str, layout: Layout) -> ShardIndex:
        """The contents of a split; its layout holds the members that are there, ``layout``'s at most.

        Raises ``ShardError`` for one that is broken, foreign, incomplete, or without samples.
        """

    @abstractmethod
    def read(self, shard: str, number: int, parts: Sequence[MemberLocation]) -> dict[int, memoryview]:
        """Column to content of some members of sample ``number`` of a shard, in the order of the file.

        Writable, and the caller's own. Raises ``ShardError``.
        """

    def read_many(self, wanted: Sequence[tuple[str, int, Sequence[MemberLocation]]]) -> Iterable[dict[int, memoryview]]:
        """As ``read``, for several samples: shard, number and members of each. Raises ``ShardError``."""
        # One by one, so that what is read is looked at while it is in the processor's cache.
        return (self.read(*sample) for sample in wanted)

    def mend(self, shard: str, number: int, part: MemberLocation) -> memoryview | None:
        """A member that was found damaged, got anew; ``None`` where there is nowhere to get it."""
        return None

    @abstractmethod
    def stream(self, shard: str) -> BinaryIO:
        """A shard from its first byte on. Raises ``ShardError``, when it is read too."""


def runs(parts: Sequence[MemberLocation], gap: int) -> list[list[MemberLocation]]:
    """Members in runs with no more than ``gap`` bytes between neighbours."""
    found: list[list[MemberLocation]] = []
    end = -math.inf
    for part in parts:
        _, offset, size, _ = part
        if offset - end > gap:
            found.append([])
        found[-1].append(part)
        end = offset + size
    return found
