"""The batches of a release that are on disk: their garments, and what is known of each."""

import functools
import logging
from pathlib import Path

from gcd_dataset.errors import ShardError
from gcd_dataset.files import user_path
from gcd_dataset.release.garment_folder import GarmentFiles, open_batch
from gcd_dataset.release.properties import Properties, read_properties
from gcd_dataset.release.published_names import BODY_FOLDERS, SPLIT_FILE, batch_order, body_folders, properties_name
from gcd_dataset.shards.access import reading

__all__ = ["PublishedBatches", "is_published"]

logger = logging.getLogger("gcd_dataset")


class PublishedBatches:
    """The batches of a release, each with its garments on the default body, on random ones, or both.

    ``root``: the folder with ``garments_5000_0`` and its like, or the one that holds it. ``bodies``: ``default``,
    ``random`` or ``both``. ``cache_dir``: where the indices of archives and the digests of properties are kept; by
    default beside the files. May be pickled and forked.

    Raises ``ConfigError`` for a choice of bodies that there is not, ``ShardError`` for a folder without the layout or a
    damaged archive, ``OutputError`` where indices cannot be kept.
    """

    def __init__(self, root: Path | str, *, bodies: str = "both", cache_dir: Path | str | None = None) -> None:
        self.body_folders = body_folders(bodies)
        self.root, self._cache_dir = _root(user_path(root)), None if cache_dir is None else user_path(cache_dir)
        self.files: dict[tuple[str, str], GarmentFiles] = {}
        """Batch and body folder to the files of the garments there."""
        self.properties: dict[tuple[str, str], Properties] = {}
        """The same to what is known of them."""
        with reading(self.root):
            for batch in sorted((path for path in self.root.iterdir() if _is_batch(path)), key=_order):
                for folder in self.body_folders:
                    if (batch / folder).is_dir():
                        self._open(batch / folder)

    @functools.cached_property
    def split_file(self) -> Path | None:
        """The official split, if it is there."""
        with reading(self.root):
            return next(iter(sorted(self.root.glob(SPLIT_FILE))), None)

    @property
    def release(self) -> str:
        """What the release calls itself in the name of its split file: ``GarmentCodeData_v2``, …"""
        return self.root.name if self.split_file is None else self.split_file.name.partition("_official")[0]

    def _open(self, folder: Path) -> None:
        place, properties = (folder.parent.name, folder.name), folder / properties_name(folder.name)
        self.files[place] = open_batch(folder, self._cache_dir)
        if properties.exists():
            self.properties[place] = read_properties(properties, self._cache_dir)
        else:
            logger.warning("%s: missing, so failed garments are not known: download it too", properties)
            self.properties[place] = Properties()


def is_published(folder: Path) -> bool:
    """Whether a folder is a release, or one of its batches."""
    if _is_batch(folder) or folder.name in BODY_FOLDERS.values():
        return True
    try:
        _root(folder)
    except ShardError:
        return False
    return True


def _root(path: Path) -> Path:
    """The folder of the batches. Raises ``ShardError`` where there is none."""
    with reading(path):
        if not path.is_dir():
            there = "a file" if path.exists() else "no such folder"
            raise ShardError(f"{path}: {there}: give the folder that holds garments_5000_0 and its like")
        for folder in (path, *sorted(inner for inner in path.iterdir() if inner.is_dir())):
            if any(_is_batch(inner) for inner in folder.iterdir()):
                return folder
    raise ShardError(f"{path}: no folder such as garments_5000_0/default_body: give where GarmentCodeData lies")


def _is_batch(path: Path) -> bool:
    return path.is_dir() and any((path / folder).is_dir() for folder in BODY_FOLDERS.values())


def _order(path: Path) -> tuple[object, ...]:
    return batch_order(path.name)
