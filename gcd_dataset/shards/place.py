"""Where a data set is written: a folder, or another place such as a store (``gcd_dataset.making.store``)."""

import os
from collections.abc import Iterable, Iterator
from pathlib import Path

from gcd_dataset.files import make_folder, user_path, write_whole
from gcd_dataset.shards.access import read_file, reading, writing

VIEWS = "views"


class Place:
    """The files of a data set by their names, ``train-00012.tar`` or ``views/train-00012.tar``: those in a folder.

    A file appears whole under its name or not at all. Methods raise ``OutputError`` and ``ShardError``.
    """

    is_folder = True
    work: Path
    """Folder of the drafts on this machine: of a folder itself, where they are hidden files."""

    def __init__(self, folder: Path | str) -> None:
        self.folder = self.work = user_path(folder)

    def location(self, name: str = "") -> str:
        """The path or URL of a file, for messages."""
        return str(self.folder / name)

    def names(self) -> frozenset[str]:
        """The names of all files."""
        return frozenset(_listed(self.folder)) | {f"{VIEWS}/{name}" for name in _listed(self.folder / VIEWS)}

    def exists(self, name: str) -> bool:
        """Whether there is a file of this name."""
        with reading(self.folder / name):
            return (self.folder / name).exists()

    def read(self, names: Iterable[str]) -> Iterator[bytes]:
        """The contents of files, in order."""
        return (read_file(self.folder / name) for name in names)

    def fetch(self, name: str) -> Path:
        """A file on this machine with the content of ``name``."""
        return self.folder / name

    def remove_fetched(self) -> None:
        """Remove the copies that ``fetch`` has made; a folder makes none."""

    def write(self, name: str, content: bytes) -> None:
        """Write or replace a small file."""
        write_whole(self.folder / name, content)

    def put(self, draft: Path, name: str) -> None:
        """Move a finished draft, synchronised with the disk, to its name; an existing file is replaced."""
        path = self.folder / name
        if path.parent != self.folder:
            make_folder(path.parent)
        with writing(path):
            draft.replace(path)
            folder = os.open(path.parent, os.O_RDONLY)
            try:
                os.fsync(folder)  # writes its entries to the disk
            finally:
                os.close(folder)

    def remove(self, name: str) -> None:
        """Remove a file if it exists."""
        with writing(self.folder / name):
            (self.folder / name).unlink(missing_ok=True)


def _listed(folder: Path) -> list[str]:
    with reading(folder):
        try:
            return os.listdir(folder)  # noqa: PTH208 -- objects of thousands of paths take three times as long
        except FileNotFoundError:
            return []
