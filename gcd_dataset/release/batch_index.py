"""The batches of a release on disk: the files and the properties of their garments."""

import functools
import logging
from pathlib import Path

from gcd_dataset.errors import ShardError
from gcd_dataset.filekinds import find_batches, is_batch
from gcd_dataset.files import user_path
from gcd_dataset.release.garment_folder import GarmentFiles, open_batch
from gcd_dataset.release.properties import Properties, read_properties
from gcd_dataset.release.published_names import SPLIT_FILE, batch_order, body_folders, properties_name
from gcd_dataset.shards.access import reading

logger = logging.getLogger("gcd_dataset")


class PublishedBatches:
    """The batches of a release, each with its garments on the default body, on random bodies, or both.

    ``root``: the folder with ``garments_5000_0`` and further batches, or its parent. ``bodies``: ``default``,
    ``random`` or ``both``. ``cache_dir``: folder for the indices of archives and the extracts of properties files; by
    default beside the files. May be pickled and forked.

    Raises ``ConfigError`` for an unknown choice of bodies, ``ShardError`` for a folder without the layout or a damaged
    archive, ``OutputError`` where an index cannot be written.
    """

    def __init__(self, root: Path | str, *, bodies: str = "both", cache_dir: Path | str | None = None) -> None:
        self.body_folders = body_folders(bodies)
        self.root, self._cache_dir = _root(user_path(root)), None if cache_dir is None else user_path(cache_dir)
        self.files: dict[tuple[str, str], GarmentFiles] = {}
        """Batch and body folder to the files of the garments there."""
        self.properties: dict[tuple[str, str], Properties] = {}
        """Batch and body folder to the properties of the garments there."""
        with reading(self.root):
            for batch in sorted((path for path in self.root.iterdir() if is_batch(path)), key=_order):
                for folder in self.body_folders:
                    if (batch / folder).is_dir():
                        self._open(batch / folder)

    @functools.cached_property
    def split_file(self) -> Path | None:
        """The official split file; ``None`` where it is missing."""
        with reading(self.root):
            return next(iter(sorted(self.root.glob(SPLIT_FILE))), None)

    @property
    def release(self) -> str:
        """Name of the release, from the name of its split file: ``GarmentCodeData_v2``, …"""
        return self.root.name if self.split_file is None else self.split_file.name.partition("_official")[0]

    def _open(self, folder: Path) -> None:
        key, path = (folder.parent.name, folder.name), folder / properties_name(folder.name)
        self.files[key] = open_batch(folder, self._cache_dir)
        if path.exists():
            self.properties[key] = read_properties(path, self._cache_dir)
        else:
            logger.warning("%s: missing, so failed garments are not left out: download it too", path)
            self.properties[key] = Properties()


def _root(path: Path) -> Path:
    """The folder of the batches. Raises ``ShardError`` where there is none."""
    with reading(path):
        if not path.is_dir():
            problem = "a file" if path.exists() else "no such folder"
            raise ShardError(f"{path}: {problem}: give the folder that holds garments_5000_0 and further batches")
        folder = find_batches(path)
    if folder is None:
        raise ShardError(f"{path}: no folder such as garments_5000_0/default_body: give the folder of GarmentCodeData")
    return folder


def _order(path: Path) -> tuple[object, ...]:
    return batch_order(path.name)
