"""A data set in a folder of this machine."""

import os
import weakref
from collections.abc import Sequence
from pathlib import Path
from typing import Any, BinaryIO, NamedTuple

from gcd_dataset.errors import ShardError, did_you_mean
from gcd_dataset.files import user_path
from gcd_dataset.shards.access import REMEDY, reading
from gcd_dataset.shards.contents import read_index, remedy, splits_in
from gcd_dataset.shards.download_file import read_fetched
from gcd_dataset.shards.index import ShardIndex
from gcd_dataset.shards.job_parts import require_merged
from gcd_dataset.shards.layout import FOREIGN, Layout, member_name, shard_number
from gcd_dataset.shards.manifest import MANIFEST, Manifest, read_manifest
from gcd_dataset.shards.room import room_for
from gcd_dataset.shards.store import MemberLocation, Store, runs
from gcd_dataset.shards.tar import BLOCK

__all__ = ["FolderStore", "OpenFiles", "read_members"]

GAP = 1 << 16  # bytes: reading over a gap this long costs less than a second call
OPEN_FILES = 256  # of the 1024 that most systems give a process


class FolderStore(Store):
    """The shards in a folder. Raises ``ShardError`` for a download that was not finished."""

    def __init__(self, folder: Path | str) -> None:
        self.folder = user_path(folder)
        fetched = read_fetched(self.folder)
        self.source = None if fetched is None else fetched.source
        self.remedy = REMEDY if fetched is None else "delete it, and run gcd download again"
        self._files = OpenFiles()
        self._last: dict[str, _LastSample] = {}
        self._paths: dict[str, Path] = {}  # to join a path anew for every sample costs as much as to read a small one

    def place(self, name: str = "") -> str:
        return str(self.folder / name)

    def manifest(self) -> Manifest | None:
        return read_manifest(self.folder)

    def index(self, split: str, layout: Layout) -> ShardIndex:
        self._require_whole(split)
        index = read_index(self.folder, split, layout)
        if not len(index):
            raise ShardError(f"{self.folder}: no samples of split {split}: {self._way_out(split)}")
        self._last |= _last_samples(index)
        return index

    def read(self, shard: str, number: int, parts: Sequence[MemberLocation]) -> dict[int, memoryview]:
        path = self._path(shard)
        with reading(path):
            # Held, so that no other thread closes it meanwhile.
            file = self._files.get(path) or self._opened(shard, path)
            content, end = read_members(file.fd, parts)
        if end is not None:
            raise ShardError(f"{path}: ends at byte {end}, in a sample: {self.remedy}")
        return content

    def _path(self, shard: str) -> Path:
        path = self._paths.get(shard)
        if path is None:
            path = self._paths[shard] = self.folder / shard
        return path

    def _opened(self, shard: str, path: Path) -> "_OpenFile":
        """The shard, open. Raises ``ShardError`` for one whose samples lie elsewhere than the index told."""
        file = _OpenFile(os.open(path, os.O_RDONLY))
        last = self._last.get(shard)
        if last is not None and last.has_moved(file.fd):
            raise ShardError(
                f"{path}: samples were added between others since it was looked at: open the data set again"
            )
        self._files.keep(path, file)
        return file

    def stream(self, shard: str) -> BinaryIO:
        with reading(self.folder / shard):
            return (self.folder / shard).open("rb")

    def _require_whole(self, split: str) -> None:
        """Raise ``ShardError`` if a download of the split has not ended, parts are not merged, or a shard is missing
        or cut off."""
        require_merged(self.folder)
        fetched = read_fetched(self.folder)
        if fetched is not None and split in fetched.unfinished:
            raise ShardError(f"{self.folder}: the download of split {split} has not ended: run gcd download again")
        manifest = self.manifest()
        record = manifest.splits.get(split) if manifest else None
        for shard in record.shards if record else ():
            path = self.folder / shard.name
            with reading(path):
                size = path.stat().st_size if path.exists() else 0
            if size < shard.size:  # longer is no fault: a shard may have grown since
                raise ShardError(f"{path}: {size} of the {shard.size} bytes in {MANIFEST}: {self.remedy}")

    def _way_out(self, split: str) -> str:
        """What to do in a folder without samples of the split."""
        names = [path.name for path in self.folder.iterdir()]
        if any(shard_number(name.removesuffix(".part"), split) is not None for name in names):
            return "a run has not finished its first shard: run gcd generate again to finish it"
        whole = splits_in(self.folder)
        return f"there is {', '.join(whole)}{did_you_mean(split, whole)}" if whole else remedy(self.folder)


class _LastSample(NamedTuple):
    """Where the last sample of a shard stood when it was looked at."""

    length: int
    """Bytes of the shard."""
    header: int
    """First byte of the sample's first header."""
    name: bytes
    """What that begins with."""

    def has_moved(self, fd: int) -> bool:
        """Whether a shard that has grown has samples between those that were there."""
        grown = os.fstat(fd).st_size > self.length
        return grown and os.pread(fd, len(self.name), self.header) != self.name


def _last_samples(index: ShardIndex) -> dict[str, _LastSample]:
    """The last sample of each shard; nothing of foreign ones, which do not grow."""
    if index.layout.kind == FOREIGN:
        return {}
    length = dict(zip(index.shards, index.length.tolist(), strict=True))
    return {
        shard: _LastSample(
            length[shard],
            int(table.offset[-1, 0]) - BLOCK,
            member_name(int(table.sample[-1]), index.layout.members[0]).encode(),
        )
        for shard, table in index.tables().items()
        if len(table)
    }


def read_members(fd: int, parts: Sequence[MemberLocation]) -> tuple[dict[int, memoryview], int | None]:
    """Column to content, by one call a run; and where the file ends, if that is before the last part."""
    content: dict[int, memoryview] = {}
    for run in runs(parts, GAP):
        start, end = run[0].offset, run[-1].end
        buffer = room_for(end - start).data
        read = os.preadv(fd, [buffer], start)
        while read < len(buffer):  # the system gives no more than 2 GiB at once, and network file systems less at times
            more = os.preadv(fd, [buffer[read:]], start + read)
            if not more:
                return {}, start + read
            read += more
        for column, offset, size, _ in run:
            content[column] = buffer[offset - start : offset - start + size]
    return content, None


class OpenFiles:
    """Descriptors of files that are read again and again, no more than a process may have."""

    def __init__(self) -> None:
        self._files: dict[Path, _OpenFile] = {}

    def get(self, path: Path) -> "_OpenFile | None":
        """The file, if it is open."""
        return self._files.get(path)

    def keep(self, path: Path, file: "_OpenFile") -> None:
        """Hold a file open, and let go of another where there are too many."""
        if len(self._files) >= OPEN_FILES:
            self._files.pop(next(iter(list(self._files))), None)
        self._files[path] = file

    def __getstate__(self) -> dict[str, Any]:
        return {"_files": {}}


class _OpenFile:
    """A descriptor that is closed when the last thread lets go of it."""

    def __init__(self, fd: int) -> None:
        self.fd = fd
        # No __del__: at the end of the program the module that closes may be gone before the last file.
        weakref.finalize(self, os.close, fd)
