"""The files of one batch on one kind of body: extracted, or in the downloaded archive."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

from gcd_dataset.errors import ShardError
from gcd_dataset.release.archive import Archive
from gcd_dataset.release.published_names import ENDINGS, REMEDY
from gcd_dataset.shards.access import read_file, reading

ARCHIVES = (".tar.gz", ".tgz", ".tar")
NO_GARMENTS = frozenset({"renders", "patterns_vis"})  # folders of the authors' tools beside the garments


class GarmentFiles(Protocol):
    """The files of the garments of one batch on one kind of body."""

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the garments."""

    def location(self, name: str) -> str:
        """Path of a garment, for messages."""

    def read(self, name: str, kinds: Sequence[str]) -> dict[str, bytes]:
        """Kind to content of a garment's files, without missing ones. Raises ``ShardError``."""


@dataclass(frozen=True)
class Extracted:
    """Extracted garments, each in its folder."""

    path: Path
    names: tuple[str, ...]

    def location(self, name: str) -> str:
        return str(self.path / name)

    def read(self, name: str, kinds: Sequence[str]) -> dict[str, bytes]:
        content = {}
        for kind in kinds:
            path = self.path / name / f"{name}{ENDINGS[kind]}"
            with reading(path):
                if path.exists():
                    content[kind] = read_file(path)
        return content


def open_batch(folder: Path, cache_dir: Path | None) -> GarmentFiles:
    """The garments in a folder such as ``garments_5000_0/default_body``: the extracted garments, or else the archive.

    Raises ``ShardError`` for a folder without garments and for a damaged archive, ``OutputError`` where the index of an
    archive cannot be written.
    """
    with reading(folder):
        data = folder / "data" if (folder / "data").is_dir() else folder
        names = tuple(sorted(path.name for path in data.iterdir() if path.is_dir() and path.name not in NO_GARMENTS))
        archives = sorted(path for path in folder.iterdir() if path.name.endswith(ARCHIVES))
    if names:
        return Extracted(data, names)
    if len(archives) == 1:
        return Archive.opened(archives[0], cache_dir)
    found = f"{len(archives)} archives" if archives else "neither garments nor data.tar.gz"
    raise ShardError(f"{folder}: {found}: {REMEDY}")
