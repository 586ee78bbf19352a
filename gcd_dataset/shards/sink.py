"""A file object that hides failed writes from libhdf5, which would abort the process."""

import io
from pathlib import Path

from gcd_dataset.shards.layout import Bytes

__all__ = ["Sink"]


class Sink(io.RawIOBase):
    """The file at ``path``, open for writing. After a failed write it discards later ones; ``check`` raises the error.

    On a full disk libhdf5 aborts the process: it cannot close a file that it failed to write.
    """

    def __init__(self, path: Path) -> None:
        self._file = path.open("r+b", buffering=0)
        self._error: OSError | None = None

    def check(self) -> None:
        """Raise the ``OSError`` of the first failed write, if any."""
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
