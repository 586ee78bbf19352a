"""Writes a data set to an object store: ranges are filled in local folders, and uploaded when complete.

The spool is a local folder with a subfolder for each range that is not uploaded yet: a data set of that range alone,
with one shard per split. After a kill, the next writer continues in it. An uploaded range is removed from the spool.
"""

import contextlib
import shutil
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

from gcd_dataset.errors import ConfigError, GcdError, RemoteError
from gcd_dataset.files import make_folder, open_whole, write_whole
from gcd_dataset.hub.lease import leased, require_free
from gcd_dataset.hub.objects import Objects
from gcd_dataset.hub.source import Url
from gcd_dataset.hub.uploaded import UploadedDataset, UploadedRange
from gcd_dataset.shards.access import locked, reading, writing
from gcd_dataset.shards.layout import GARMENTS, Layout, key_of, part_path
from gcd_dataset.shards.manifest import SplitRecord
from gcd_dataset.shards.rejects import REJECTS

__all__ = ["FinishedWriter", "RangeWriter", "Spool", "StoreTarget", "StoreWriter"]


class RangeWriter(Protocol):
    """A writer of the folder of one range."""

    @property
    def done(self) -> frozenset[int]:
        """Indices of the samples on disk."""

    def add(self, index: int, *sample: Any) -> None:
        """Add a sample."""

    def close(self) -> None:
        """Finish the shards."""


@dataclass(frozen=True)
class StoreTarget:
    """A data set to be written at the URL of an object store.

    Methods raise ``RemoteError`` for a store that does not answer, or refuses; ``ConfigError`` where it holds a data
    set of another seed or recipe; ``OutputError`` where another run holds the lease, or the spool cannot be written.
    """

    url: Url
    requested: dict[str, SplitRecord]
    """Split to its record."""
    spools: Path
    """Parent folder of the spools of all URLs."""
    open_writer: Callable[[Path], RangeWriter]
    """Opens a writer of a range's folder."""
    layout: Layout = GARMENTS
    patience: float | None = None

    def done(self, count: int) -> frozenset[int]:
        """Indices of the samples in the store and in the spool. Repairs the spool."""
        uploaded = self._uploaded()
        with self._lock():
            require_free(uploaded.files, self._lease)
            spool, ranges = self._spool(uploaded.is_begun), uploaded.ranges(count)
            stored = (uploaded_range.samples for uploaded_range in ranges.values())
            return frozenset[int]().union(*stored, *(spool.done(number) for number in spool.numbers()))

    @contextlib.contextmanager
    def filling(self, count: int) -> Iterator["StoreWriter | FinishedWriter"]:
        """A writer of the missing samples below ``count``. The data set becomes visible at the end of the block.

        After an error the same call continues with the samples in store and spool. A complete data set is not written
        again.
        """
        uploaded = self._uploaded()
        if self._is_finished(uploaded, count):
            yield FinishedWriter(self.url)
            return
        with self._lock(), leased(uploaded.files, self._lease):
            is_begun = uploaded.is_begun
            spool = self._spool(is_begun)
            if not is_begun:
                uploaded.begin()
            with StoreWriter(uploaded, spool, count) as writer:
                yield writer
            spool.remove()

    def _is_finished(self, uploaded: UploadedDataset, count: int) -> bool:
        """Whether ``count`` samples are published, and no upload has begun since."""
        if uploaded.is_begun:
            return False
        published = frozenset[int]().union(*(found.samples for found in uploaded.ranges(count).values()))
        return published.issuperset(range(count))

    def _uploaded(self) -> UploadedDataset:
        return UploadedDataset(Objects(self.url.url, patience=self.patience), self.requested, self.layout)

    def _spool(self, is_begun: bool) -> "Spool":
        """The spool. Emptied if no upload has begun: its folders are of a complete or removed upload."""
        spool = Spool(self.spools / self.url.slug, self.open_writer)
        if not is_begun:
            spool.remove()
        return spool

    @property
    def _lease(self) -> Path:
        return self.spools / f"{self.url.slug}.lease"

    def _lock(self) -> contextlib.AbstractContextManager[None]:
        return locked(make_folder(self.spools) / f".{self.url.slug}.lock", f"writing {self.url}")


@dataclass(frozen=True)
class FinishedWriter:
    """The writer of a complete data set: it accepts no samples."""

    url: Url

    def add(self, index: int, *sample: Any) -> None:
        """Raises ``ConfigError``."""
        raise ConfigError(f"{self.url}: {key_of(index)} is there already: write missing samples only")


@dataclass(frozen=True)
class Spool:
    """The local folders of ranges that are not uploaded yet. Methods raise ``OutputError``."""

    folder: Path
    open_writer: Callable[[Path], RangeWriter]

    def numbers(self) -> list[int]:
        """Numbers of the ranges with a folder."""
        with reading(self.folder):
            names = [path.name for path in self.folder.iterdir()] if self.folder.is_dir() else []
        return sorted(int(name) for name in names if name.isascii() and name.isdecimal())

    def of(self, number: int) -> Path:
        """The folder of a range."""
        return self.folder / f"{number:05d}"

    def writer(self, number: int) -> RangeWriter:
        """A writer of a range, which continues its folder."""
        return self.open_writer(self.of(number))

    def done(self, number: int) -> frozenset[int]:
        """Indices of the samples in a range's folder."""
        with contextlib.closing(self.writer(number)) as writer:
            return writer.done

    def drop(self, number: int) -> None:
        """Remove the folder of a range."""
        _remove(self.of(number))

    def remove(self) -> None:
        """Remove the spool."""
        _remove(self.folder)


class StoreWriter:
    """Writes samples to the spool, and uploads each range when its samples below ``count`` are complete.

    One range is uploaded while the next one is filled, so the spool holds at most three ranges. At the end of the
    ``with`` block all ranges are uploaded and the data set is published.
    """

    def __init__(self, uploaded: UploadedDataset, spool: Spool, count: int) -> None:
        self._uploaded, self._spool, self._count = uploaded, spool, count
        self._stopped = threading.Event()
        self._sender = uploaded.with_sleep(self._stopped.wait)
        self._open: dict[int, tuple[RangeWriter, set[int]]] = {}
        self._pool = ThreadPoolExecutor(1, "upload")
        self._upload: tuple[int, Future[UploadedRange]] | None = None
        self._stored = uploaded.ranges(count)

    def add(self, index: int, *sample: Any) -> None:
        """Add a sample, as ``RangeWriter.add`` does. Raises ``RemoteError`` where a range cannot be uploaded."""
        if self._upload is not None and self._upload[1].done():
            self._finish_upload()
        number = index // self._uploaded.range_size
        writer, missing = self._range(number)
        writer.add(index, *sample)
        missing.discard(index)
        if not missing:
            self._start_upload(number)

    def __enter__(self) -> "StoreWriter":
        with contextlib.ExitStack() as on_error:
            on_error.callback(self._stop)
            for number in self._spool.numbers():
                if self._is_stored(number):
                    self._spool.drop(number)
                elif self._wanted(number) and not self._range(number)[1]:
                    self._start_upload(number)  # an earlier run was stopped before the upload
            on_error.pop_all()
        return self

    def __exit__(self, kind: type[BaseException] | None, *error: object) -> None:
        try:
            if kind is None:
                self._finish_upload()
                self._require_all()
                self._uploaded.publish(self._stored)
        finally:
            self._stop()

    # ---------------------------------------------------------------------------------------------------------- ranges

    def _range(self, number: int) -> tuple[RangeWriter, set[int]]:
        """The writer of a range, and the indices of its missing samples."""
        if number not in self._open:
            writer = self._open_range(number)
            self._open[number] = writer, set(self._wanted(number)) - writer.done
        return self._open[number]

    def _open_range(self, number: int) -> RangeWriter:
        """A writer of a range; continues the spool, or the stored shards if the spool lacks some of their samples."""
        stored = self._stored.get(number)
        writer = self._spool.writer(number)
        if stored is None or writer.done >= stored.samples:
            return writer
        writer.close()
        self._spool.drop(number)
        self._download(number, stored)
        writer = self._spool.writer(number)
        if writer.done >= stored.samples:
            return writer
        writer.close()
        names = ", ".join(shard.record.name for shard in stored.shards.values())
        raise RemoteError(
            f"{self._uploaded.files.base}: damaged: remove {names} there, and start again to generate it anew"
        )

    def _download(self, number: int, stored: UploadedRange) -> None:
        """Download the shards of a range as ``.part`` files, from which a writer recovers the undamaged samples."""
        folder, files = make_folder(self._spool.of(number)), self._uploaded.files
        write_whole(folder / REJECTS, stored.rejects or self._uploaded.rejects())
        for shard in stored.shards.values():
            with open_whole(part_path(folder / shard.record.name)) as file:
                for piece in files.pieces(shard.record.name, 0, shard.record.size):
                    file.write(piece)

    def _wanted(self, number: int) -> range:
        return self._uploaded.wanted(number, self._count)

    def _is_stored(self, number: int) -> bool:
        return number in self._stored and self._stored[number].samples.issuperset(self._wanted(number))

    # ---------------------------------------------------------------------------------------------------------- upload

    def _start_upload(self, number: int) -> None:
        """Upload a range in the background, after the one before."""
        self._open.pop(number)[0].close()
        self._finish_upload()
        self._upload = number, self._pool.submit(self._sender.add, number, self._spool.of(number))

    def _finish_upload(self) -> None:
        """Wait for the running upload, then remove its range from the spool. Raises the upload's error."""
        if self._upload is not None:
            number, upload = self._upload
            self._stored[number] = upload.result()
            self._upload = None
            self._spool.drop(number)

    def _require_all(self) -> None:
        """Raise ``RemoteError`` unless all samples are in the store."""
        if lacking := [number for number in self._uploaded.numbers(self._count) if not self._is_stored(number)]:
            first = self._wanted(lacking[0])[0]
            raise RemoteError(
                f"{self._uploaded.files.base}: {key_of(first)} is missing or damaged there: start again to generate it "
                "anew"
            )

    def _stop(self) -> None:
        """Close all writers; wait for a running upload, without retries."""
        self._stopped.set()
        self._pool.shutdown()
        for writer, _ in self._open.values():
            with contextlib.suppress(GcdError):  # the first error is raised
                writer.close()
        self._open.clear()


def _remove(folder: Path) -> None:
    with writing(folder):
        if folder.exists():
            shutil.rmtree(folder)
