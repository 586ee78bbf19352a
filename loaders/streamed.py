"""``GarmentDataset(..., streaming=True)``: garments in the order of the shards, whose tars webdataset reads."""

import sys
import tarfile
from collections.abc import Container, Iterable, Iterator
from dataclasses import dataclass
from functools import partial
from itertools import repeat
from pathlib import Path
from types import FrameType
from typing import Any

import numpy as np
from torch.utils.data import ChainDataset, DataLoader, IterableDataset, get_worker_info
from torch.utils.data._utils.fetch import _IterableDatasetFetcher

from gcd_dataset.errors import ConfigError, ShardError
from gcd_dataset.files import open_regular
from gcd_dataset.loaders.base import Garments
from gcd_dataset.loaders.ranks import accelerate_processes, current_rank, in_process_group
from gcd_dataset.loaders.shards import GarmentDataset
from gcd_dataset.shards.access import reading
from gcd_dataset.shards.layout import META, Bytes, is_picture, key_of
from gcd_dataset.shards.meta import checked_meta
from gcd_dataset.shards.reader import ShardReader, Verify, naming_sample
from gcd_dataset.shards.tar import CheckedTar

LENGTHS = (DataLoader.__len__.__code__, ChainDataset.__len__.__code__)


@dataclass(frozen=True)
class StreamedTar:
    """Samples of a tar in the order of the file."""

    path: Path
    name: str
    """Path or URL, for messages."""
    spans: list[tuple[str, int, int]]
    """Key, first and last byte of each sample."""
    remedy: str

    @classmethod
    def of(cls, reader: ShardReader, shard: int, rows: list[int], views: bool) -> "StreamedTar":
        """The samples of ``rows`` of the index, or their pictures; a server's tar is fetched whole, and verified."""
        index, record, store = reader.index, reader.record.shards[shard], reader.store
        starts, ends = (index.views_start, index.views_end) if views else (index.start, index.end)
        keys = map(key_of, index.number[rows].tolist())
        return cls(
            store.path(reader.split, record, views=views),
            store.location(record.name(reader.split, views=views)),
            [*zip(keys, starts[rows].tolist(), ends[rows].tolist(), strict=True)],
            store.remedy,
        )

    def samples(self, wanted: Container[str]) -> Iterator[dict[str, Bytes]]:
        """The wanted members of each sample. Raises ``ShardError`` for a damaged tar, and where a sample is missing."""
        from webdataset.tariterators import group_by_keys, tar_file_expander

        count = 0
        # Opened here: webdataset has its own ways to open URLs, and with WDS_SECURE=1 opens nothing.
        with reading(self.path), open_regular(self.path) as file:
            source = {"url": self.name, "stream": CheckedTar(file, self.spans)}
            try:
                for sample in group_by_keys(tar_file_expander([source]), suffixes=wanted):
                    if sample["__key__"] != self.spans[count][0]:  # a name with a folder
                        break
                    yield {member: data for member, data in sample.items() if not member.startswith("__")}
                    if (count := count + 1) == len(self.spans):
                        return
            except (tarfile.TarError, ShardError, ValueError) as error:  # ValueError: a name occurs twice
                fault = str(error.args[0]).partition(" @ ")[0]  # webdataset appends the file object
                raise ShardError(f"{self.name}: a damaged archive ({fault}): {self.remedy}") from error
        # tarfile takes a damaged header for the end of the archive.
        raise ShardError(f"{self.name}: {count} samples of {len(self.spans)} read: {self.remedy}")


class StreamedGarments(GarmentDataset, IterableDataset):
    """The items in the order of the shards; each rank and worker reads one contiguous part.

    Every garment comes once. The parts of ranks differ by one garment at most. The workers of a ``DataLoader`` get
    whole batches, all but the last one: ``len(loader)`` is the number of batches on this rank, and ``drop_last`` leaves
    out less than one batch. A server's shard is fetched whole before its first garment; no columns are made.
    """

    _ranks: tuple[int, int] | None = None
    """Rank and world size of the process that spawned this worker."""

    def __init__(self, *source: Any, verify: Verify = "lazy", **options: Any) -> None:
        super().__init__(*source, verify=verify, **options)
        self._checks = verify != "off"

    def select(self, indices: Iterable[int]) -> Garments:
        raise ConfigError("a stream has no indices: leave out streaming=True, or slice the split")

    def __getitem__(self, index: Any) -> Any:
        raise ConfigError("a stream has no indices: leave out streaming=True")

    def __len__(self) -> int:
        # A DataLoader counts the batches of this rank; all others ask for the whole data set.
        return len(self._rank_share()) if sys._getframe(1).f_code in LENGTHS else super().__len__()

    def __iter__(self) -> Iterator[Any]:
        share, begin = self._share(), 0
        for reader, positions in self._parts:
            rows = reader.rows(positions)[max(share.start - begin, 0) : max(share.stop - begin, 0)]
            position, begin = max(share.start, begin), begin + len(positions)
            for shard in np.unique(reader.index.shard[rows]).tolist():
                of_shard = rows[reader.index.shard[rows] == shard].tolist()
                yield from self._of_shard(reader, shard, of_shard, position)
                position += len(of_shard)

    def _of_shard(self, reader: ShardReader, shard: int, rows: list[int], position: int) -> Iterator[Any]:
        """The items of some samples of a shard; the first is at ``position`` of the data set."""
        names = {META, *self._member_names}
        pictures = {name for name in names if is_picture(name)}
        tar = StreamedTar.of(reader, shard, rows, False)
        views = StreamedTar.of(reader, shard, rows, True).samples(pictures) if pictures else repeat({}, len(rows))
        for place, (main, of_views) in enumerate(zip(tar.samples(names - pictures), views, strict=True)):
            members = {**main, **of_views}
            with naming_sample(partial("{}: sample {}".format, tar.name, tar.spans[place][0])):
                try:
                    if missing := sorted(names - members.keys()):
                        raise ShardError(f"member {missing[0]} is missing")
                    if self._checks:
                        checked_meta(members, int(reader.index.number[rows[place]]))
                except ShardError as error:
                    raise ShardError(f"{error}: {tar.remedy}") from error
                item = self._item(members, position + place)
            yield item

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
