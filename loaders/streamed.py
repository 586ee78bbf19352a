"""``GarmentDataset(..., streaming=True)``: garments in the order of the shards."""

import sys
from collections.abc import Iterable, Iterator
from itertools import groupby
from operator import itemgetter
from types import FrameType
from typing import Any

import numpy as np
from torch.utils.data import ChainDataset, DataLoader, IterableDataset, get_worker_info
from torch.utils.data._utils.fetch import _IterableDatasetFetcher

from gcd_dataset.errors import ConfigError
from gcd_dataset.loaders.base import Garments
from gcd_dataset.loaders.ranks import accelerate_processes, current_rank, in_process_group
from gcd_dataset.loaders.shards import GarmentDataset
from gcd_dataset.shards.layout import is_picture

LENGTHS = (DataLoader.__len__.__code__, ChainDataset.__len__.__code__)


class StreamedGarments(GarmentDataset, IterableDataset):
    """The items in the order of the shards; each rank and worker reads one contiguous part.

    Every garment comes once. The parts of ranks differ by one garment at most. The workers of a ``DataLoader`` get
    whole batches, all but the last one: ``len(loader)`` is the number of batches on this rank, and ``drop_last`` leaves
    out less than one batch. A server's shard is fetched whole before its first garment; no columns are made.
    """

    _ranks: tuple[int, int] | None = None
    """Rank and world size of the process that spawned this worker."""

    def select(self, indices: Iterable[int]) -> Garments:
        raise ConfigError("a stream has no indices: leave out streaming=True, or slice the split")

    def __getitem__(self, index: Any) -> Any:
        raise ConfigError("a stream has no indices: leave out streaming=True")

    def __len__(self) -> int:
        # A DataLoader counts the batches of this rank; all others ask for the whole data set.
        return len(self._rank_share()) if sys._getframe(1).f_code in LENGTHS else super().__len__()

    def __iter__(self) -> Iterator[Any]:
        share, begin = self._share(), 0
        pictures = {is_picture(member) for member in self._member_names}
        for reader, positions in self._parts:
            own = positions[max(share.start - begin, 0) : max(share.stop - begin, 0)]
            position, begin = max(share.start, begin), begin + len(positions)
            shards = np.searchsorted(reader.index.first, reader.rows(own), "right") - 1
            for shard, group in groupby(zip(shards.tolist(), own, strict=True), itemgetter(0)):
                rows = [row for _, row in group]
                for views in {False} | pictures:  # the main tar holds the checksums
                    reader.store.path(reader.split, reader.record.shards[shard], views=views)
                for row, members in zip(rows, reader.read_many(rows, self._member_names), strict=True):
                    with reader.naming(row):
                        item = self._item(members, position)
                    yield item
                    position += 1

    def __getstate__(self) -> dict[str, Any]:
        # A spawned worker has no process group, and may lack the rank's environment variables.
        return {**self.__dict__, "_ranks": current_rank() if in_process_group() else self._ranks}

    def _share(self) -> range:
        """The positions of the garments of this process."""
        worker, share = get_worker_info(), self._rank_share()
        if worker is None:
            return share
        size = _requested_batch()
        batches = -(-len(share) // size)
        begin, end = (edge * batches // worker.num_workers * size for edge in (worker.id, worker.id + 1))
        return share[begin:end]

    def _rank_share(self) -> range:
        """The positions of the garments of this rank. Raises ``ConfigError`` with several processes of accelerate."""
        if (count := accelerate_processes()) > 1:
            raise ConfigError(
                f"streaming=True with {count} processes of accelerate, which may split the garments too: leave it out, "
                "or load with a GarmentLoader"
            )
        rank, ranks = self._ranks or current_rank()
        return range(*(edge * len(self) // ranks for edge in (rank, rank + 1)))


def _requested_batch() -> int:
    """Size of the batch that a ``DataLoader`` is reading from a stream in this thread; 1 for single items."""
    # torch tells a stream neither the batch size nor drop_last.
    frame: FrameType | None = sys._getframe(1)
    while frame is not None:
        if frame.f_code is _IterableDatasetFetcher.fetch.__code__:
            return len(frame.f_locals["possibly_batched_index"] or [None])
        frame = frame.f_back
    return 1
