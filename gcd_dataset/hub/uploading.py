"""A data set made at the URL of a store: shards fill in folders here, and go up as they become whole.

The spool holds a folder for each shard that is not up yet: a data set of that shard alone, which ``ShardWriter`` goes
on with after a kill. A shard that is up leaves it.
"""

import contextlib
import shutil
import threading
from collections.abc import Iterator, Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

from gcd_dataset.errors import ConfigError, GcdError, RemoteError
from gcd_dataset.files import make_folder, open_whole
from gcd_dataset.hub.lease import leased, require_free
from gcd_dataset.hub.objects import Objects
from gcd_dataset.hub.place import Url
from gcd_dataset.hub.uploaded import Uploaded, UploadedShard
from gcd_dataset.shards.access import locked, reading, writing
from gcd_dataset.shards.layout import GARMENTS, Bytes, Layout, key_of, part_path, shard_name
from gcd_dataset.shards.manifest import SplitRecord
from gcd_dataset.shards.writer import ShardWriter

__all__ = ["Finished", "ObjectWriter", "Spool", "StoreTarget"]


@dataclass(frozen=True)
class StoreTarget:
    """One split of a data set at the URL of a store.

    Raises ``RemoteError`` for a store that does not answer, or refuses; ``ConfigError`` where it holds a data set made
    otherwise; ``OutputError`` where another run writes there, or the spool cannot be written.
    """

    place: Url
    asked: SplitRecord
    """How its samples are made."""
    spools: Path
    """Folder for the spools of all URLs."""
    split: str = "train"
    layout: Layout = GARMENTS
    patience: float | None = None

    def done(self, count: int) -> frozenset[int]:
        """Samples that need not be made again: those in the store, and in the spool. Puts the spool in order."""
        uploaded = self._uploaded()
        with self._alone():
            require_free(uploaded.files, self.split, self._lease)
            spool = self._spool(uploaded, uploaded.is_begun)
            there = [sample for shard in uploaded.shards(count).values() for sample in shard.table.sample.tolist()]
            return frozenset(there).union(*(spool.done(number) for number in spool.numbers()))

    @contextlib.contextmanager
    def filling(self, count: int) -> Iterator["ObjectWriter | Finished"]:
        """A writer of what is missing of ``count`` samples; the data set shows when the block has ended well.

        Broken off, what is up and what is in the spool stay, and the same call goes on with them. Nothing is written
        where nothing is missing.
        """
        uploaded = self._uploaded()
        if self._is_finished(uploaded, count):
            yield Finished(self.place)
            return
        with self._alone(), leased(uploaded.files, self.split, self._lease):
            is_begun = uploaded.is_begun
            spool = self._spool(uploaded, is_begun)
            if not is_begun:
                uploaded.begin()
            with ObjectWriter(uploaded, spool, count, patience=self.patience) as writer:
                yield writer
            spool.remove()

    def _is_finished(self, uploaded: Uploaded, count: int) -> bool:
        """Whether readers see ``count`` samples, and no run has begun since."""
        if uploaded.is_begun:
            return False
        there = {sample for shard in uploaded.shards(count).values() for sample in shard.table.sample.tolist()}
        return there.issuperset(range(count))

    def _uploaded(self) -> Uploaded:
        return Uploaded(Objects(self.place.url, patience=self.patience), self.split, self.layout, self.asked)

    def _spool(self, uploaded: Uploaded, is_begun: bool) -> "Spool":
        """The spool, without what is left of a run whose objects are gone, or which has finished."""
        spool = Spool(self.spools / f"{self.place.slug}-{self.split}", self.asked, self.split, self.layout)
        if not is_begun:
            spool.remove()
        return spool

    @property
    def _lease(self) -> Path:
        return self.spools / f"{self.place.slug}-{self.split}.lease"

    def _alone(self) -> contextlib.AbstractContextManager[None]:
        lock = make_folder(self.spools) / f".{self.place.slug}-{self.split}.lock"
        return locked(lock, f"writing split {self.split} of {self.place}")


@dataclass(frozen=True)
class Finished:
    """The writer of a data set that is all there."""

    place: Url

    def add(self, index: int, members: Mapping[str, Bytes]) -> None:
        """Raises ``ConfigError``."""
        raise ConfigError(f"{self.place}: {key_of(index)} is there already: write what is missing")


@dataclass(frozen=True)
class Spool:
    """Shards on their way to a store, each in a folder of its own. Raises ``OutputError``."""

    folder: Path
    asked: SplitRecord
    split: str
    layout: Layout

    def numbers(self) -> list[int]:
        """The shards of which something is here."""
        with reading(self.folder):
            names = [path.name for path in self.folder.iterdir()] if self.folder.is_dir() else []
        return sorted(int(name) for name in names if name.isascii() and name.isdecimal())

    def of(self, number: int) -> Path:
        """The folder of a shard."""
        return self.folder / f"{number:05d}"

    def writer(self, number: int) -> ShardWriter:
        """The writer of a shard, which goes on with what is here."""
        asked = self.asked
        return ShardWriter(
            self.of(number),
            split=self.split,
            seed=asked.seed,
            recipe=asked.recipe,
            shard_size=asked.shard_size,
            layout=self.layout,
        )

    def done(self, number: int) -> frozenset[int]:
        """The samples of a shard that are whole here."""
        with self.writer(number) as writer:
            return writer.done

    def drop(self, number: int) -> None:
        """Remove what is here of a shard."""
        _remove(self.of(number))

    def remove(self) -> None:
        """Remove everything."""
        _remove(self.folder)


class ObjectWriter:
    """Writes samples into the spool, and brings each shard up when all samples of it that are wanted are there.

    One shard goes up at a time, while the next one fills: no more than three wait in the spool. To be used as a
    context; where that ends well, all is brought up and shown to readers.
    """

    def __init__(self, uploaded: Uploaded, spool: Spool, count: int, *, patience: float | None) -> None:
        self._uploaded, self._spool, self._count = uploaded, spool, count
        self._stopped = threading.Event()
        files = Objects(uploaded.files.base, patience=patience, sleep=self._stopped.wait)
        self._sender = Uploaded(files, spool.split, spool.layout, spool.asked)
        self._open: dict[int, tuple[ShardWriter, set[int]]] = {}
        self._pool = ThreadPoolExecutor(1, "upload")
        self._going: tuple[int, Future[UploadedShard]] | None = None
        self._there = uploaded.shards(count)

    def add(self, index: int, members: Mapping[str, Bytes]) -> None:
        """Add a sample. Raises as ``ShardWriter.add`` does, and ``RemoteError`` where an earlier shard cannot go up."""
        if self._going is not None and self._going[1].done():
            self._arrive()
        number = index // self._spool.asked.shard_size
        writer, missing = self._shard(number)
        writer.add(index, members)
        missing.discard(index)
        if not missing:
            self._send(number)

    def __enter__(self) -> "ObjectWriter":
        with contextlib.ExitStack() as on_error:
            on_error.callback(self._stop)
            for number in self._spool.numbers():
                if self._is_there(number):
                    self._spool.drop(number)
                elif self._wanted(number) and not self._shard(number)[1]:
                    self._send(number)  # an earlier run was stopped before it was up
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

    # ---------------------------------------------------------------------------------------------------------- shards

    def _shard(self, number: int) -> tuple[ShardWriter, set[int]]:
        """The writer of a shard, and the samples that it lacks."""
        if number not in self._open:
            writer = self._begun(number)
            self._open[number] = writer, set(self._wanted(number)) - writer.done
        return self._open[number]

    def _begun(self, number: int) -> ShardWriter:
        """The writer of a shard, which goes on with what is in the store where that is more than is here."""
        there = self._there.get(number)
        writer = self._spool.writer(number)
        if there is None or writer.done.issuperset(there.table.sample.tolist()):
            return writer
        writer.close()
        self._spool.drop(number)
        self._bring(number, there)
        writer = self._spool.writer(number)
        if writer.done.issuperset(there.table.sample.tolist()):
            return writer
        writer.close()
        raise RemoteError(
            f"{self._uploaded.files.address(there.record.name)}: damaged: remove it, and start again to have it made "
            "anew"
        )

    def _bring(self, number: int, there: UploadedShard) -> None:
        """Get a shard from the store, as one whose writing was broken off: what is not whole of it is left out."""
        folder = make_folder(self._spool.of(number))
        with open_whole(part_path(folder / there.record.name)) as file:
            for piece in self._uploaded.files.pieces(there.record.name, 0, there.record.size):
                file.write(piece)

    def _wanted(self, number: int) -> range:
        return self._uploaded.wanted(number, self._count)

    def _is_there(self, number: int) -> bool:
        return number in self._there and self._there[number].holds(self._wanted(number))

    # ---------------------------------------------------------------------------------------------------------- upload

    def _send(self, number: int) -> None:
        """Bring a shard up, once the one before is."""
        self._open.pop(number)[0].close()
        self._arrive()
        self._going = number, self._pool.submit(self._sender.add, number, self._spool.of(number))

    def _arrive(self) -> None:
        """Wait for the shard that goes up; then it leaves the spool. Raises what kept it from arriving."""
        if self._going is not None:
            number, going = self._going
            self._there[number] = going.result()
            self._going = None
            self._spool.drop(number)

    def _require_all(self) -> None:
        """Raise ``RemoteError`` unless all samples are in the store."""
        numbers = range(-(-self._count // self._spool.asked.shard_size))
        if lacking := [number for number in numbers if not self._is_there(number)]:
            name = self._uploaded.files.address(shard_name(self._spool.split, lacking[0]))
            raise RemoteError(f"{name}: not there as it was written: start again to have it made anew")

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
