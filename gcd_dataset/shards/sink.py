"""A file for a library that does not survive a failed write."""

import io
from pathlib import Path

from gcd_dataset.shards.layout import Bytes

__all__ = ["Sink"]


class Sink(io.RawIOBase):
    """The file at ``path``, open for writing; a write that fails is told by ``check``, and those after it go nowhere.

    libhdf5 ends the process where the disk is full: it fails to close what it failed to write.
    """

    def __init__(self, path: Path) -> None:
        self._file = path.open("r+b", buffering=0)
        self._error: OSError | None = None

    def check(self) -> None:
        """Raise the ``OSError`` of the first write that failed, if one has."""
        if self._error is not None:
            raise self._error

    def readable(self) -> bool:
        return True

    def writable(self) -> bool:
        return True

    def seekable(self) -> bool:
        return True

    def seek(self, offset: int, whence: int = io.SEEK_SET) -> int:
        return self._file.seek(offset, whence)

    def tell(self) -> int:
        return self._file.tell()

    def readinto(self, buffer: memoryview) -> int:  # type: ignore[override]
        return self._file.readinto(buffer)

    def write(self, data: Bytes) -> int:  # type: ignore[override]
        rest = memoryview(data).cast("B")
        count = len(rest)
        try:
            while rest and self._error is None:
                rest = rest[self._file.write(rest) :]
        except OSError as error:
            self._error = error
        return count

    def truncate(self, size: int | None = None) -> int:
        try:
            if self._error is None:
                return self._file.truncate(size)
        except OSError as error:
            self._error = error
        return size or 0

    def close(self) -> None:
        self._file.close()
        super().close()
