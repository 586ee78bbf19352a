"""A data set in a local folder: reads members of samples by offset."""

import os
import weakref
from collections.abc import Sequence
from pathlib import Path
from typing import Any, BinaryIO, NamedTuple

from gcd_dataset.errors import ShardError, did_you_mean
from gcd_dataset.files import open_regular, user_path
from gcd_dataset.shards.access import REMEDY, reading
from gcd_dataset.shards.buffers import read_buffer
from gcd_dataset.shards.contents import no_shards_remedy, read_index, splits_in
from gcd_dataset.shards.download_file import read_download_record
from gcd_dataset.shards.index import ShardIndex
from gcd_dataset.shards.job_parts import require_merged
from gcd_dataset.shards.layout import FOREIGN, Layout, member_name, shard_number
from gcd_dataset.shards.manifest import MANIFEST, Manifest, read_manifest
from gcd_dataset.shards.store import MemberLocation, Store, runs
from gcd_dataset.shards.tar import BLOCK
from gcd_dataset.shards.unfinished import unfinished

__all__ = ["FolderStore", "OpenFiles", "read_members"]

GAP = 1 << 16  # bytes: reading across a gap this long costs less than a second call
OPEN_FILES = 256  # most open files, out of the 1024 descriptors that most systems allow a process


class FolderStore(Store):
    """The shards in a folder. Reading a split raises ``ShardError`` where its download is incomplete."""

    def __init__(self, folder: Path | str) -> None:
        self.folder = user_path(folder)
        record = read_download_record(self.folder)
        self.source = None if record is None else record.source
        self.remedy = REMEDY if record is None else "delete it, and run gcd download again"
        self._files = OpenFiles()
        self._last: dict[str, _LastSample] = {}
        self._paths: dict[str, Path] = {}  # cached: joining a path costs as much as reading a small sample

    def location(self, name: str = "") -> str:
        return str(self.folder / name)

    def manifest(self) -> Manifest | None:
        return read_manifest(self.folder)

    def index(self, split: str, layout: Layout) -> ShardIndex:
        self._require_whole(split)
        index = read_index(self.folder, split, layout)
        if not len(index):
            raise ShardError(f"{self.folder}: no samples of split {split}: {self._missing_remedy(split)}")
        self._last |= _last_samples(index)
        return index

    def unfinished(self, split: str) -> str | None:
        return unfinished(self.folder, split)

    def read(self, shard: str, number: int, parts: Sequence[MemberLocation]) -> dict[int, memoryview]:
        path = self._path(shard)
        with reading(path):
            # This reference keeps the descriptor open while another thread evicts it.
            file = self._files.get(path) or self._opened(shard, path)
            content, end = read_members(file.fd, parts)
        if end is not None:
            raise ShardError(f"{path}: ends at byte {end}, inside a sample: {self.remedy}")
        return content

    def _path(self, shard: str) -> Path:
        path = self._paths.get(shard)
        if path is None:
            path = self._paths[shard] = self.folder / shard
        return path

    def _opened(self, shard: str, path: Path) -> "_OpenFile":
        """Open a shard. Raises ``ShardError`` where its samples have moved since the index was read."""
        file = _OpenFile(os.open(path, os.O_RDONLY | os.O_NONBLOCK))  # a pipe fails when it is read
        last = self._last.get(shard)
        if last is not None and last.has_moved(file.fd):
            raise ShardError(f"{path}: samples were inserted since its index was read: open the data set again")
        self._files.keep(path, file)
        return file

    def stream(self, shard: str) -> BinaryIO:
        with reading(self.folder / shard):
            return open_regular(self.folder / shard)

    def _require_whole(self, split: str) -> None:
        """Raise ``ShardError`` for an incomplete download, unmerged parts, and a missing or truncated shard."""
        require_merged(self.folder)
        download = read_download_record(self.folder)
        if download is not None and split in download.unfinished:
            raise ShardError(f"{self.folder}: the download of split {split} is incomplete: run gcd download again")
        manifest = self.manifest()
        record = manifest.splits.get(split) if manifest else None
        for shard in record.shards if record else ():
            path = self.folder / shard.name
            with reading(path):
                size = path.stat().st_size if path.exists() else 0
            if size < shard.size:  # a longer file is fine: the shard has grown since
                raise ShardError(f"{path}: {size} of the {shard.size} bytes in {MANIFEST}: {self.remedy}")

    def _missing_remedy(self, split: str) -> str:
        """The remedy in the message about a folder without samples of the split."""
        names = [path.name for path in self.folder.iterdir()]
        if any(shard_number(name.removesuffix(".part"), split) is not None for name in names):
            return "a run has not finished its first shard: run gcd generate again to finish it"
        splits = splits_in(self.folder)
        return (
            f"choose from {', '.join(splits)}{did_you_mean(split, splits)}" if splits else no_shards_remedy(self.folder)
        )


class _LastSample(NamedTuple):
    """Position of the last sample of a shard when its index was read."""

    length: int
    """Bytes of the shard."""
    header: int
    """Offset of the sample's first tar header."""
    name: bytes
    """Start of that header: the name of the first member."""

    def has_moved(self, fd: int) -> bool:
        """Whether the shard has grown with samples inserted before this one."""
        grown = os.fstat(fd).st_size > self.length
        return grown and os.pread(fd, len(self.name), self.header) != self.name


def _last_samples(index: ShardIndex) -> dict[str, _LastSample]:
    """Shard to its last sample; empty for foreign archives, which do not grow."""
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
    """Column to content, by one system call per run; and the file's length if it ends before the last part."""
    content: dict[int, memoryview] = {}
    for run in runs(parts, GAP):
        start, end = run[0].offset, run[-1].end
        buffer = read_buffer(end - start).data
        read = os.preadv(fd, [buffer], start)
        while read < len(buffer):  # one call reads at most 2 GiB, less on network file systems
            more = os.preadv(fd, [buffer[read:]], start + read)
            if not more:
                return {}, start + read
            read += more
        for column, offset, size, _ in run:
            content[column] = buffer[offset - start : offset - start + size]
    return content, None


class OpenFiles:
    """A cache of open descriptors, at most ``OPEN_FILES``."""

    def __init__(self) -> None:
        self._files: dict[Path, _OpenFile] = {}

    def get(self, path: Path) -> "_OpenFile | None":
        """The file, if it is open."""
        return self._files.get(path)

    def keep(self, path: Path, file: "_OpenFile") -> None:
        """Add a file, evicting the oldest entry of a full cache."""
        if len(self._files) >= OPEN_FILES:
            self._files.pop(next(iter(list(self._files))), None)
        self._files[path] = file

    def __getstate__(self) -> dict[str, Any]:
        return {"_files": {}}


class _OpenFile:
    """A descriptor, closed with the last reference to it."""

    def __init__(self, fd: int) -> None:
        self.fd = fd
        # Not __del__: at interpreter exit the os module may be gone before the last file.
        weakref.finalize(self, os.close, fd)
