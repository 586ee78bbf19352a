"""A cache of single samples, each a tar of its own, which any number of processes may fill and read.

00012/gcd_000012345.tar     all members of sample 12345, pictures included
"""

import contextlib
import zlib
from collections.abc import Iterable, Mapping
from pathlib import Path

from gcd_dataset.errors import ShardError
from gcd_dataset.files import make_folder, write_whole
from gcd_dataset.shards.access import read_file
from gcd_dataset.shards.layout import Bytes, key_of, member_name
from gcd_dataset.shards.meta import read_meta
from gcd_dataset.shards.notes import META
from gcd_dataset.shards.tar import END, samples_in, tar_entry

__all__ = ["SampleCache"]

EACH = 1000  # samples of a folder


class SampleCache:
    """The samples of one seed, recipe and version in a folder."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder

    def keep(self, index: int, members: Mapping[str, Bytes]) -> None:
        """Store the members of a sample, unless it is there. Raises ``OutputError``."""
        path = self._path(index)
        if not path.exists():
            entries = [tar_entry(member_name(index, member), data) for member, data in members.items()]
            write_whole(make_folder(path.parent) / path.name, b"".join([*entries, bytes(END)]))

    def read(self, index: int, members: Iterable[str] | None = None) -> dict[str, memoryview] | None:
        """The members of a sample, by default all, checked; ``None`` if it is not there.

        A damaged sample is removed; then raises ``ShardError``.
        """
        path = self._path(index)
        if not path.exists():
            return None
        try:
            [(_, found)] = samples_in(memoryview(bytearray(read_file(path))))
            crc = read_meta(found[META])["crc32"]
            wanted = list(found if members is None else members)
            if any(zlib.crc32(found[member]) != crc[member] for member in wanted if member != META):
                raise ShardError("bytes differ from the written ones")
            return {member: found[member] for member in wanted}
        except (ShardError, ValueError, KeyError) as error:
            with contextlib.suppress(OSError):
                path.unlink()
            raise ShardError(f"{path}: damaged ({error})") from error

    def _path(self, index: int) -> Path:
        return self.folder / f"{index // EACH:05d}" / f"{key_of(index)}.tar"
