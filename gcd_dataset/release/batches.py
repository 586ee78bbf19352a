"""The batches of a publication: folders or archives of garments, and the properties of these.

``dataset_properties_default_body.yaml`` holds failures and simulation counts of the garments of a batch.
``PublishedGarments`` leaves failed garments out, even if their folders exist. Parsing a file of 5,000 garments takes
seconds, so an extract is cached.
"""

import functools
import json
import logging
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Protocol

import yaml

from gcd_dataset.errors import ShardError
from gcd_dataset.filekinds import find_batches, is_batch
from gcd_dataset.files import user_path
from gcd_dataset.release.archive import Archive, cache_path, file_stamp, write_cache
from gcd_dataset.release.published_names import ENDINGS, REMEDY, SPLIT_FILE, batch_order, body_folders, properties_name
from gcd_dataset.shards.access import read_file, reading
from gcd_dataset.yamlfile import PlainLoader, require_shallow

SCHEMA = 1
COUNTS = {"frames": "fin_frame", "self_crossings": "self_collisions", "body_crossings": "body_collisions"}


@dataclass(frozen=True)
class Facts:
    """Simulation counts of one garment; -1 for a missing count."""

    frames: int = -1
    self_crossings: int = -1
    body_crossings: int = -1


@dataclass(frozen=True)
class Properties:
    """The extract of a properties file."""

    fails: Mapping[str, str] = field(default_factory=dict)
    """Failed garment to the class of its failure."""
    facts: Mapping[str, Facts] = field(default_factory=dict)
    """Simulated garment to its counts."""


def read_properties(path: Path, cache_dir: Path | None) -> Properties:
    """The properties of a batch. Raises ``ShardError`` for a broken file, ``OutputError`` for an unwritable cache."""
    stamp, cache = [SCHEMA, *file_stamp(path)], cache_path(path, cache_dir, ".json")
    cached = _read_cache(cache, stamp)
    if cached is not None:
        return cached
    properties = _parsed(path)
    write_cache(cache, json.dumps({"stamp": stamp} | asdict(properties), separators=(",", ":")).encode())
    return properties


def _read_cache(path: Path, stamp: list[int]) -> Properties | None:
    """The cached extract; ``None`` if it is missing or broken, or describes another file."""
    try:
        entry = json.loads(path.read_bytes())
        if entry["stamp"] != stamp:
            return None
        fails = {name: str(kind) for name, kind in entry["fails"].items()}
        facts = {name: Facts(**{key: int(count) for key, count in f.items()}) for name, f in entry["facts"].items()}
    except (OSError, ValueError, KeyError, TypeError, AttributeError, OverflowError, RecursionError):
        return None
    return Properties(fails, facts)


def _parsed(path: Path) -> Properties:
    text = read_file(path)
    try:
        require_shallow(text)
        table = yaml.load(text, Loader=_Loader)
        stats = table["sim"]["stats"]
        fails = {str(name): kind for kind, names in stats["fails"].items() for name in names or ()}
        counts = {key: stats.get(name) or {} for key, name in COUNTS.items()}
        names = dict.fromkeys(name for values in counts.values() for name in values)
        facts = {n: Facts(**{key: int(values.get(n, -1)) for key, values in counts.items()}) for n in names}
        return Properties(fails, facts)
    except (yaml.YAMLError, ValueError, KeyError, TypeError, AttributeError, OverflowError, RecursionError) as error:
        found = " ".join(str(error).split()) or type(error).__name__
        raise ShardError(f"{path}: not the properties of a batch ({found}): {REMEDY}") from error


class _Loader(PlainLoader):
    """Reads plain values, and skips Python objects in the file."""


_Loader.add_multi_constructor("tag:yaml.org,2002:python/", lambda loader, suffix, node: None)


ARCHIVES = (".tar.gz", ".tgz")
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


logger = logging.getLogger("gcd_dataset")


class PublishedBatches:
    """The batches of a release, each with its garments on the default body, on random bodies, or both.

    ``root``: the folder with ``garments_5000_0`` and further batches, or its parent. ``bodies``: ``default``,
    ``random`` or ``both``. ``cache_dir``: folder for unpacked archives and the extracts of properties files; by
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
            for batch in sorted(
                (path for path in self.root.iterdir() if is_batch(path)), key=lambda path: batch_order(path.name)
            ):
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
