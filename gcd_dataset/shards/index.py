"""``train.index``: number, position, grade and outcome of each sample of a split, in about 4 bytes each.

The file is a container of ``gcd_dataset.shards.sections`` with the sections ``number``, ``start`` and ``views_start``
(i4, as differences; in blocks of a tar, 512 bytes; the last one is empty without pictures), ``grade`` and ``outcome``
(u1, rows of ``GRADES`` and ``OUTCOMES``). The samples are in the order of the shards. A sample ends where the next one
of its shard begins, the last one 1,024 bytes before the end of the shard.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import Any, Self

import numpy as np
from jaxtyping import Bool, Int, UInt8

from gcd_dataset.errors import ShardError
from gcd_dataset.files import require_name
from gcd_dataset.records import Grade, Outcome
from gcd_dataset.shards.layout import LARGEST_SAMPLE
from gcd_dataset.shards.manifest import SplitRecord
from gcd_dataset.shards.sections import Coding, pack, unpack
from gcd_dataset.shards.tar import BLOCK, END

GRADES = ("", *(grade.value for grade in (Grade.FAILED, Grade.PAPER, Grade.CLEAN)))
"""Grades by their number in the index: in ascending order, the first for samples without a grade."""
OUTCOMES = ("", *Outcome.__members__)
"""Outcomes by their number in the index; the first for samples without a drape."""
SETTLED = OUTCOMES.index(Outcome.SETTLED.name)
REMEDY = "run gcd index"
BYTES = 15  # of a sample, unpacked: 14, and padding
HEADS = 1 << 10  # bytes of the heads of all sections
SECTIONS = {"number": "i4", "start": "i4", "views_start": "i4", "grade": "u1", "outcome": "u1"}
"""Section of the file to its type."""
DIFFERENCES = {name: Coding(1) for name, kind in SECTIONS.items() if kind == "i4"}


def index_name(split: str) -> str:
    """The file name of a split's index. Raises ``ShardError`` for an unsafe name of a split."""
    return f"{require_name(split, 'split')}.index"


@dataclass(frozen=True, eq=False)
class SplitIndex:
    """The samples of a split. Pickles as the content of its file."""

    record: SplitRecord
    number: Int[np.ndarray, " n"]
    """Index of each sample."""
    blocks: Int[np.ndarray, " n"]
    """Start in its shard [512 bytes]."""
    views_blocks: Int[np.ndarray, " n"]
    """Start in the tar of the pictures of its shard [512 bytes]; empty without pictures."""
    grade: UInt8[np.ndarray, " n"]
    outcome: UInt8[np.ndarray, " n"]

    def __len__(self) -> int:
        return len(self.number)

    @property
    def settled(self) -> Bool[np.ndarray, " n"]:
        """Whether the drape has settled; false without a drape."""
        return self.outcome == SETTLED

    @cached_property
    def first(self) -> Int[np.ndarray, " k1"]:
        """Row of the first sample of each shard, and the number of samples."""
        return np.cumsum([0, *(shard.count for shard in self.record.shards)])

    @property
    def shard(self) -> Int[np.ndarray, " n"]:
        """Position of each sample's shard in ``record.shards``."""
        return np.repeat(np.arange(len(self.record.shards), dtype=np.int32), [s.count for s in self.record.shards])

    @property
    def start(self) -> Int[np.ndarray, " n"]:
        """Start in the shard [bytes]."""
        return self.blocks.astype(np.int64) * BLOCK

    @property
    def end(self) -> Int[np.ndarray, " n"]:
        """End in the shard [bytes]."""
        return self._end_blocks(views=False).astype(np.int64) * BLOCK

    @property
    def views_start(self) -> Int[np.ndarray, " n"]:
        """Start in the tar of the pictures [bytes]; empty without pictures."""
        return self.views_blocks.astype(np.int64) * BLOCK

    @property
    def views_end(self) -> Int[np.ndarray, " n"]:
        """End in the tar of the pictures [bytes]; empty without pictures."""
        return self._end_blocks(views=True).astype(np.int64) * BLOCK

    def _end_blocks(self, *, views: bool) -> Int[np.ndarray, " n"]:
        """The ends of the samples, which lie one after the other in each shard [512 bytes]."""
        blocks, first = self.views_blocks if views else self.blocks, self.first
        if not len(blocks):
            return blocks
        sizes = np.array([shard.views_size if views else shard.size for shard in self.record.shards])
        ends, filled = np.empty_like(blocks), np.diff(first) > 0
        ends[:-1] = blocks[1:]
        ends[first[1:][filled] - 1] = (sizes[filled] - END) // BLOCK
        return ends

    @property
    def has_views(self) -> bool:
        """Whether the samples have pictures."""
        return any(shard.views_size for shard in self.record.shards)

    @property
    def _arrays(self) -> tuple[np.ndarray, ...]:
        return self.number, self.blocks, self.views_blocks, self.grade, self.outcome

    def to_bytes(self) -> bytes:
        """The content of the index file."""
        return pack(dict(zip(SECTIONS, self._arrays, strict=True)), DIFFERENCES)

    @classmethod
    def from_bytes(cls, content: bytes, record: SplitRecord, path: str, remedy: str = REMEDY) -> Self:
        """The index in a file's content; ``path`` and ``remedy`` for messages.

        Raises ``ShardError`` for content that does not fit ``record``: damaged, or of another data set.
        """
        try:
            arrays = unpack(content, limit=record.count * BYTES + HEADS)
            if missing := [name for name in SECTIONS if name not in arrays]:
                raise ShardError(f"section {missing[0]} is missing")
            index = cls(record, *map(arrays.__getitem__, SECTIONS))
            index.require_consistent()
            return index
        except ShardError as error:
            raise ShardError(f"{path}: not the index of these shards ({error}): {remedy}") from error

    def require_consistent(self) -> None:
        """Raise ``ShardError`` unless all samples lie inside their shards, one after the other."""
        count, of_views = self.record.count, self.record.count if self.has_views else 0
        lengths = (count, count, of_views, count, count)
        for name, array, length in zip(SECTIONS, self._arrays, lengths, strict=True):
            if array.shape != (length,) or array.dtype != SECTIONS[name]:
                raise ShardError(f"section {name} of shape {array.shape} and type {array.dtype} for {count} samples")
        if not count:
            return
        beyond = self.grade.max() >= len(GRADES) or self.outcome.max() >= len(OUTCOMES)
        if beyond or self.number.min() < 0:
            raise ShardError("a value is out of range")
        # Numbers usually ascend, and sorting them takes a third of the time of opening a data set.
        if (np.diff(self.number) <= 0).any() and len(np.unique(self.number)) < count:
            raise ShardError("a sample occurs twice")
        for views in (False, True):
            start, end = self.views_blocks if views else self.blocks, self._end_blocks(views=views)
            if (start < 0).any() or (end <= start).any():
                raise ShardError("a sample beyond the end of its shard")
            if (longest := BLOCK * int((end - start).max(initial=0))) > LARGEST_SAMPLE:
                raise ShardError(f"a sample of {longest} bytes, over the limit of {LARGEST_SAMPLE}")

    def __reduce__(self) -> tuple[Any, ...]:
        return SplitIndex.from_bytes, (self.to_bytes(), self.record, "an index")
