"""A data set made at the URL of a store: shards fill in folders here, and go up as they become whole.

The spool holds a folder for each range of samples that is not in the store yet: a data set of that range alone, with
one shard of each split, which a writer goes on with after a kill. A range that is in the store leaves the spool.
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
    """The writer of a folder that holds one range."""

    @property
    def done(self) -> frozenset[int]:
        """Indices of the samples that are whole on disk."""

    def add(self, index: int, *sample: Any) -> None:
        """Add a sample."""

    def close(self) -> None:
        """Make whole what was added."""


@dataclass(frozen=True)
class StoreTarget:
    """A data set at the URL of a store.

    Raises ``RemoteError`` for a store that does not answer, or refuses; ``ConfigError`` where it holds a data set made
    otherwise; ``OutputError`` where another run writes there, or the spool cannot be written.
    """

    place: Url
    asked: dict[str, SplitRecord]
    """Split to how its samples are made."""
    spools: Path
    """Folder for the spools of all URLs."""
    open_writer: Callable[[Path], RangeWriter]
    """Opens the writer of a folder in the spool."""
    layout: Layout = GARMENTS
    patience: float | None = None

    def done(self, count: int) -> frozenset[int]:
        """Samples that need not be made again: those in the store, and in the spool. Puts the spool in order."""
        uploaded = self._uploaded()
        with self._alone():
            require_free(uploaded.files, self._lease)
            spool, ranges = self._spool(uploaded.is_begun), uploaded.ranges(count)
            there = (its.samples for its in ranges.values())
            return frozenset[int]().union(*there, *(spool.done(number) for number in spool.numbers()))

    @contextlib.contextmanager
    def filling(self, count: int) -> Iterator["StoreWriter | FinishedWriter"]:
        """A writer of what is missing of ``count`` samples; the data set shows when the block has ended well.

        Broken off, what is in the store and in the spool stays, and the same call goes on with it. Nothing is written
        where nothing is missing.
        """
        uploaded = self._uploaded()
        if self._is_finished(uploaded, count):
            yield FinishedWriter(self.place)
            return
        with self._alone(), leased(uploaded.files, self._lease):
            is_begun = uploaded.is_begun
            spool = self._spool(is_begun)
            if not is_begun:
                uploaded.begin()
            with StoreWriter(uploaded, spool, count) as writer:
                yield writer
            spool.remove()

    def _is_finished(self, uploaded: UploadedDataset, count: int) -> bool:
        """Whether readers see ``count`` samples, and no run has begun since."""
        if uploaded.is_begun:
            return False
        there = frozenset[int]().union(*(its.samples for its in uploaded.ranges(count).values()))
        return there.issuperset(range(count))

    def _uploaded(self) -> UploadedDataset:
        return UploadedDataset(Objects(self.place.url, patience=self.patience), self.asked, self.layout)

    def _spool(self, is_begun: bool) -> "Spool":
        """The spool, without what is left of a run whose objects are gone, or which has finished."""
        spool = Spool(self.spools / self.place.slug, self.open_writer)
        if not is_begun:
            spool.remove()
        return spool

    @property
    def _lease(self) -> Path:
        return self.spools / f"{self.place.slug}.lease"

    def _alone(self) -> contextlib.AbstractContextManager[None]:
        return locked(make_folder(self.spools) / f".{self.place.slug}.lock", f"writing {self.place}")


@dataclass(frozen=True)
class FinishedWriter:
    """The writer of a data set that is all there."""

    place: Url

    def add(self, index: int, *sample: Any) -> None:
        """Raises ``ConfigError``."""
        raise ConfigError(f"{self.place}: {key_of(index)} is there already: write what is missing")


@dataclass(frozen=True)
class Spool:
    """Ranges on their way to a store, each in a folder of its own. Raises ``OutputError``."""

    folder: Path
    open_writer: Callable[[Path], RangeWriter]

    def numbers(self) -> list[int]:
        """The ranges of which something is here."""
        with reading(self.folder):
            names = [path.name for path in self.folder.iterdir()] if self.folder.is_dir() else []
        return sorted(int(name) for name in names if name.isascii() and name.isdecimal())

    def of(self, number: int) -> Path:
        """The folder of a range."""
        return self.folder / f"{number:05d}"

    def writer(self, number: int) -> RangeWriter:
        """The writer of a range, which goes on with what is here."""
        return self.open_writer(self.of(number))

    def done(self, number: int) -> frozenset[int]:
        """The samples of a range that are whole here."""
        with contextlib.closing(self.writer(number)) as writer:
            return writer.done

    def drop(self, number: int) -> None:
        """Remove what is here of a range."""
        _remove(self.of(number))

    def remove(self) -> None:
        """Remove everything."""
        _remove(self.folder)


class StoreWriter:
    """Writes samples into the spool, and sends each range when all samples of it that are wanted are there.

    One range is sent at a time, while the next one fills: no more than three wait in the spool. To be used as a
    context; where that ends well, all is sent and shown to readers.
    """

    def __init__(self, uploaded: UploadedDataset, spool: Spool, count: int) -> None:
        self._uploaded, self._spool, self._count = uploaded, spool, count
        self._stopped = threading.Event()
        self._sender = uploaded.sleeping_by(self._stopped.wait)
        self._open: dict[int, tuple[RangeWriter, set[int]]] = {}
        self._pool = ThreadPoolExecutor(1, "upload")
        self._going: tuple[int, Future[UploadedRange]] | None = None
        self._there = uploaded.ranges(count)

    def add(self, index: int, *sample: Any) -> None:
        """Add a sample, as the spool's writers take it. Raises ``RemoteError`` where a range cannot be sent."""
        if self._going is not None and self._going[1].done():
            self._arrive()
        number = index // self._uploaded.range_size
        writer, missing = self._range(number)
        writer.add(index, *sample)
        missing.discard(index)
        if not missing:
            self._send(number)

    def __enter__(self) -> "StoreWriter":
        with contextlib.ExitStack() as on_error:
            on_error.callback(self._stop)
            for number in self._spool.numbers():
                if self._is_there(number):
                    self._spool.drop(number)
                elif self._wanted(number) and not self._range(number)[1]:
                    self._send(number)  # an earlier run was stopped before it was sent
            on_error.pop_all()
        return self

    def __exit__(self, kind: type[BaseException] | None, *error: object) -> None:
        try:
            if kind is None:
                self._arrive()
                self._require_all()
                self._uploaded.publish(self._there)
        finally:
            self._stop()

    # ---------------------------------------------------------------------------------------------------------- ranges

    def _range(self, number: int) -> tuple[RangeWriter, set[int]]:
        """The writer of a range, and the samples that it lacks."""
        if number not in self._open:
            writer = self._begun(number)
            self._open[number] = writer, set(self._wanted(number)) - writer.done
        return self._open[number]

    def _begun(self, number: int) -> RangeWriter:
        """The writer of a range, which goes on with what is in the store where that is more than is here."""
        there = self._there.get(number)
        writer = self._spool.writer(number)
        if there is None or writer.done >= there.samples:
            return writer
        writer.close()
        self._spool.drop(number)
        self._bring(number, there)
        writer = self._spool.writer(number)
        if writer.done >= there.samples:
            return writer
        writer.close()
        names = ", ".join(shard.record.name for shard in there.shards.values())
        raise RemoteError(
            f"{self._uploaded.files.base}: damaged: remove {names} there, and start again to have it made anew"
        )

    def _bring(self, number: int, there: UploadedRange) -> None:
        """Get shards from the store, as those whose writing was broken off: what is not whole of them is left out."""
        folder, files = make_folder(self._spool.of(number)), self._uploaded.files
        write_whole(folder / REJECTS, there.rejects or self._uploaded.rejects())
        for shard in there.shards.values():
            with open_whole(part_path(folder / shard.record.name)) as file:
                for piece in files.pieces(shard.record.name, 0, shard.record.size):
                    file.write(piece)

    def _wanted(self, number: int) -> range:
        return self._uploaded.wanted(number, self._count)

    def _is_there(self, number: int) -> bool:
        return number in self._there and self._there[number].samples.issuperset(self._wanted(number))

    # ---------------------------------------------------------------------------------------------------------- upload

    def _send(self, number: int) -> None:
        """Send a range, once the one before has arrived."""
        self._open.pop(number)[0].close()
        self._arrive()
        self._going = number, self._pool.submit(self._sender.add, number, self._spool.of(number))

    def _arrive(self) -> None:
        """Wait for the range that is sent; then it leaves the spool. Raises what kept it from arriving."""
        if self._going is not None:
            number, going = self._going
            self._there[number] = going.result()
            self._going = None
            self._spool.drop(number)

    def _require_all(self) -> None:
        """Raise ``RemoteError`` unless all samples are in the store."""
        if lacking := [number for number in self._uploaded.numbers(self._count) if not self._is_there(number)]:
            first = self._wanted(lacking[0])[0]
            raise RemoteError(
                f"{self._uploaded.files.base}: {key_of(first)} is not there as it was written: start again to have it "
                "made anew"
            )

    def _stop(self) -> None:
        """Make whole what is in the spool; an upload is waited for, but not tried again."""
        self._stopped.set()
        self._pool.shutdown()
        for writer, _ in self._open.values():
            with contextlib.suppress(GcdError):  # the first error says what is wrong
                writer.close()
        self._open.clear()


def _remove(folder: Path) -> None:
    with writing(folder):
        if folder.exists():
            shutil.rmtree(folder)
