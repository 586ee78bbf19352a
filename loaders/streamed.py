"""``GarmentDataset(..., streaming=True)``: garments in the order of the shards, read from end to end by webdataset."""

import sys
import tarfile
from collections.abc import Callable, Container, Iterable, Iterator
from dataclasses import dataclass, replace
from functools import partial
from types import FrameType
from typing import Any, BinaryIO

import numpy as np
from jaxtyping import Int
from torch.utils.data import ChainDataset, DataLoader, IterableDataset, get_worker_info
from torch.utils.data._utils.fetch import _IterableDatasetFetcher

from gcd_dataset.errors import ConfigError, RemoteError, ShardError
from gcd_dataset.files import open_regular
from gcd_dataset.loaders.base import Garments
from gcd_dataset.loaders.ranks import accelerate_processes, current_rank, in_process_group
from gcd_dataset.loaders.shards import GarmentDataset
from gcd_dataset.shards.access import reading
from gcd_dataset.shards.layout import MEMBERS, is_picture, key_of
from gcd_dataset.shards.manifest import ShardRecord
from gcd_dataset.shards.notes import checked_meta
from gcd_dataset.shards.reader import ShardReader, Verify, naming_sample
from gcd_dataset.shards.store import Store
from gcd_dataset.shards.tar import CheckedTar

META = MEMBERS[0]
LENGTHS = (DataLoader.__len__.__code__, ChainDataset.__len__.__code__)


@dataclass(frozen=True)
class StreamedTar:
    """The samples to read from a shard, in the order of the file, and the tar of its pictures."""

    name: str
    """Path or URL, for messages."""
    open: Callable[[], BinaryIO]
    number: Int[np.ndarray, " n"]
    """Indices of the samples."""
    start: Int[np.ndarray, " n"]
    """Their first bytes."""
    remedy: str
    views: "StreamedTar | None" = None

    def __len__(self) -> int:
        return len(self.number)

    def within(self, first: int, count: int) -> "StreamedTar":
        """Samples ``first`` to ``first + count``; the range may extend beyond the tar on both sides."""
        part = slice(max(first, 0), max(first + count, 0))
        views = self.views and self.views.within(first, count)
        return replace(self, number=self.number[part], start=self.start[part], views=views)

    def samples(self, wanted: Container[str]) -> Iterator[dict[str, bytes]]:
        """The wanted members of each sample. Raises ``ShardError`` for a damaged tar, or a sample that is not there."""
        expected = iter(self.number.tolist())
        number, count = next(expected, None), 0
        for key, members in self._members(wanted) if len(self) else ():
            if number is None or key != key_of(number):
                continue  # a sample that was not asked for
            yield members
            number, count = next(expected, None), count + 1
            if number is None:
                return
        # tarfile takes a damaged header for the end of the archive.
        if number is not None:
            raise ShardError(f"{self.name}: {count} samples of {len(self)} read: {self.remedy}")

    def _members(self, wanted: Container[str]) -> Iterator[tuple[str, dict[str, bytes]]]:
        """Key and wanted members of each sample of the file, from the first sample on."""
        from webdataset.tariterators import group_by_keys, tar_file_expander

        try:
            # Opened here: webdataset has its own ways to open URLs, and with WDS_SECURE=1 opens nothing.
            with self.open() as file:
                file.seek(int(self.start[0]))
                source = {"url": self.name, "stream": CheckedTar(file)}
                for sample in group_by_keys(tar_file_expander([source]), suffixes=wanted):
                    key = sample.pop("__key__")
                    yield key, {member: data for member, data in sample.items() if not member.startswith("__")}
        except (tarfile.TarError, ShardError, ValueError) as error:  # ValueError: a name occurs twice
            if isinstance(error, RemoteError) or str(error.args[0]).startswith(self.name):
                raise
            fault = str(error.args[0]).partition(" @ ")[0]  # webdataset appends the file object
            raise ShardError(f"{self.name}: a damaged archive ({fault}): {self.remedy}") from error


class StreamedGarments(GarmentDataset, IterableDataset):
    """The items in the order of the shards; each rank and worker reads one contiguous part.

    Every garment comes once. The parts of ranks differ by one garment at most. The workers of a ``DataLoader`` get
    whole batches, all but the last one: ``len(loader)`` is the number of batches on this rank, and ``drop_last`` leaves
    out less than one batch. A process reads each shard from the start of its part.
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
        share = self._share()
        position, begin = share.start, 0
        for tar in self._tars():
            part = tar.within(share.start - begin, len(share))
            begin += len(tar)
            for number, members in zip(part.number.tolist(), self._samples(part), strict=True):
                with naming_sample(partial(_label, tar.name, number)):
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

    def _tars(self) -> Iterator[StreamedTar]:
        """All garments, shard by shard, in their order."""
        for part in self._parts:
            reader, index = part.reader, part.reader.index
            rows = reader.rows(part.positions)
            for row in np.unique(index.shard[rows]).tolist():
                own = rows[index.shard[rows] == row]
                main, views = (_tar(reader, reader.record.shards[row], own, views) for views in (False, True))
                yield replace(main, views=views) if index.has_views else main

    def _samples(self, tar: StreamedTar) -> Iterator[dict[str, bytes]]:
        """The members of each sample of a tar that the fields need, checked."""
        names = {META, *self._member_names}
        pictures = {name for name in names if is_picture(name)}
        views = tar.views.samples(pictures) if tar.views is not None and pictures else ({} for _ in range(len(tar)))
        for number, main, of_views in zip(tar.number.tolist(), tar.samples(names - pictures), views, strict=True):
            members = {**main, **of_views}
            if missing := sorted(names - members.keys()):
                raise ShardError(f"{_label(tar.name, number)} has no {missing[0]}: {tar.remedy}")
            if self._checks:
                try:
                    checked_meta(members, number)
                except ShardError as error:
                    raise ShardError(f"{_label(tar.name, number)}, {error}: {tar.remedy}") from error
            yield members


def _tar(reader: ShardReader, shard: ShardRecord, rows: Int[np.ndarray, " n"], views: bool) -> StreamedTar:
    """Some samples of a shard, or their pictures; ``rows``: of the index."""
    name = reader.store.location(shard.name(reader.split, views=views))
    start = reader.index.views_start if views else reader.index.start
    opens = partial(_open, reader.store, reader.split, shard, views)
    return StreamedTar(name, opens, reader.index.number[rows], start[rows] if len(start) else rows, reader.store.remedy)


def _open(store: Store, split: str, shard: ShardRecord, views: bool) -> BinaryIO:
    """The tar of a shard, or of its pictures; a server's is fetched whole, and verified."""
    path = store.path(split, shard, views=views)
    with reading(path):
        return open_regular(path)


def _requested_batch() -> int:
    """Size of the batch that a ``DataLoader`` is reading from a stream in this thread; 1 for single items."""
    # torch tells a stream neither the batch size nor drop_last.
    frame: FrameType | None = sys._getframe(1)
    while frame is not None:
        if frame.f_code is _IterableDatasetFetcher.fetch.__code__:
            return len(frame.f_locals["possibly_batched_index"] or [None])
        frame = frame.f_back
    return 1


def _label(tar: str, number: int) -> str:
    return f"{tar}: sample {key_of(number)}"
