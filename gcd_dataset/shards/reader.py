"""Samples of a data set folder by number: a few ``preadv`` calls each, for the members asked for and no others."""

import os
import zlib
from collections.abc import Iterable, Iterator, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any, Literal, get_args

import numpy as np
from jaxtyping import Bool

from gcd_dataset.errors import ConfigError, ShardError
from gcd_dataset.shards.access import REMEDY, reading
from gcd_dataset.shards.index import read_index
from gcd_dataset.shards.layout import GARMENTS, Layout, key_of, shard_number
from gcd_dataset.shards.manifest import MANIFEST, Manifest, read_manifest

__all__ = ["ShardReader", "Verify"]

Verify = Literal["lazy", "full", "off"]

GAP = 1 << 16  # bytes: reading over a gap this long costs less than a second call
OPEN_FILES = 256  # of the 1024 that most systems give a process


class ShardReader:
    """The samples of one split, of one ``layout``, in the order of their indices.

    ``verify``: ``lazy`` checks a member's CRC-32 the first time that this process reads it, ``full`` checks all of them
    at once, ``off`` none. ``settled_only`` leaves out samples that are not draped, or did not settle. May be pickled,
    forked, and read from several threads.

    Raises ``ShardError`` for a folder without the split, or with a broken, foreign or incomplete one.
    """

    def __init__(
        self,
        folder: Path | str,
        split: str = "train",
        *,
        layout: Layout = GARMENTS,
        verify: Verify = "lazy",
        settled_only: bool = False,
    ) -> None:
        if verify not in get_args(Verify):
            raise ConfigError(f"verify={verify!r}: there is {', '.join(get_args(Verify))}")
        self.folder, self.split, self._verify = Path(folder), split, verify
        self._members = layout.members
        self.manifest = read_manifest(self.folder)
        _require_listed_shards(self.folder, split, self.manifest)
        self.index = read_index(self.folder, split, layout)
        if not len(self.index):
            raise ShardError(f"{self.folder}: no samples of split {split}: {_way_out(self.folder, split)}")
        # A shard that was filled out of order, or a foreign one, need not be in the order of its numbers.
        order = np.argsort(self.index.table.sample, kind="stable")
        self._row = order[self.index.table.settled[order]] if settled_only else order
        if not len(self._row):
            there = f"none of the {len(order)} samples of split {split} has settled"
            raise ShardError(f"{self.folder}: {there}: leave out settled_only, or make garments that are draped")
        self._files: dict[int, _OpenFile] = {}
        self._unchecked = self._all_unchecked()
        if verify == "full":
            for position in range(len(self)):
                self.read(position, self._members)

    def __len__(self) -> int:
        return len(self._row)

    def read(self, position: int, members: Iterable[str]) -> dict[str, memoryview]:
        """The content of some members of a sample, writable and the caller's own.

        Raises ``ShardError`` with shard, key and member for a byte that is not what was written.
        """
        row = int(self._row[position])
        wanted = sorted(self._members.index(member) for member in members)
        table, shard = self.index.table, int(self.index.shard[row])
        places = list(zip(wanted, table.offset[row, wanted].tolist(), table.size[row, wanted].tolist(), strict=True))
        content = {column: data for run in _runs(places) for column, data in self._read_run(shard, run)}
        for column, data in content.items():
            if self._unchecked[row, column]:
                self._check(row, column, data)
        return {self._members[column]: data for column, data in content.items()}

    def check(self, position: int) -> None:
        """Raise ``ShardError`` if any byte of a sample is not what was written."""
        row = int(self._row[position])
        for member, data in self.read(position, self._members).items():
            self._check(row, self._members.index(member), data)

    def _read_run(self, shard: int, run: Sequence["_Place"]) -> Iterator[tuple[int, memoryview]]:
        """Members that lie close together, by one call."""
        start, end = run[0][1], run[-1][1] + run[-1][2]
        buffer = np.empty(end - start, np.uint8).data
        path = self.folder / self.index.shards[shard]
        with reading(path):
            file = self._file(shard, path)  # held, so that no other thread closes it meanwhile
            read = os.preadv(file.fd, [buffer], start)
        if read < len(buffer):
            raise ShardError(f"{path}: ends at byte {start + read}, in a sample: {REMEDY}")
        for column, offset, size in run:
            yield column, buffer[offset - start : offset - start + size]

    def _check(self, row: int, column: int, data: memoryview) -> None:
        if zlib.crc32(data) != self.index.table.crc[row, column]:
            shard, key = self.index.shards[self.index.shard[row]], key_of(int(self.index.table.sample[row]))
            raise ShardError(
                f"{self.folder / shard}: sample {key}, member {self._members[column]}: bytes differ from those that "
                f"were written: {REMEDY}"
            )
        self._unchecked[row, column] = False

    def _file(self, shard: int, path: Path) -> "_OpenFile":
        file = self._files.get(shard)
        if file is None:
            if len(self._files) >= OPEN_FILES:
                self._files.pop(next(iter(list(self._files))), None)
            file = self._files[shard] = _OpenFile(os.open(path, os.O_RDONLY))
        return file

    def _all_unchecked(self) -> Bool[np.ndarray, "n m"]:
        return np.full(self.index.table.crc.shape, self._verify != "off")

    def __getstate__(self) -> dict[str, Any]:
        return {**self.__dict__, "_files": {}, "_unchecked": None}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state)
        self._unchecked = self._all_unchecked()


_Place = tuple[int, int, int]  # column of the layout's members, offset, size


class _OpenFile:
    """A descriptor that is closed when the last thread lets go of it."""

    def __init__(self, fd: int) -> None:
        self.fd = fd

    def __del__(self) -> None:
        os.close(self.fd)


def _runs(places: Sequence[_Place]) -> list[Sequence[_Place]]:
    """Members in runs with no more than ``GAP`` bytes between neighbours."""
    cuts = [i + 1 for i, (a, b) in enumerate(pairwise(places)) if b[1] - (a[1] + a[2]) > GAP]
    return [places[i:j] for i, j in pairwise([0, *cuts, len(places)]) if i < j]


def _require_listed_shards(folder: Path, split: str, manifest: Manifest | None) -> None:
    """Raise ``ShardError`` if a shard in the manifest is missing or cut off."""
    record = manifest.splits.get(split) if manifest else None
    for shard in record.shards if record else ():
        path = folder / shard.name
        with reading(path):
            size = path.stat().st_size if path.exists() else 0
        if size < shard.size:  # longer is no fault: a shard may have grown since
            raise ShardError(f"{path}: {size} of the {shard.size} bytes in {MANIFEST}: {REMEDY}")


def _way_out(folder: Path, split: str) -> str:
    """What to do in a folder without samples of the split."""
    names = [path.name for path in folder.iterdir()]
    if any(shard_number(name.removesuffix(".part"), split) is not None for name in names):
        return "a run has not finished its first shard: run gcd generate again to finish it"
    begun = {name.rpartition("-")[0] for name in names if name.endswith(".tar")}
    whole = sorted(there for there in begun if any(shard_number(name, there) is not None for name in names))
    return f"there is {', '.join(whole)}" if whole else "give a folder that gcd generate has made"
