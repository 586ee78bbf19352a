"""The published GarmentCodeData as a list of garments: what is there, what the split asks for, what failed."""

import functools
import hashlib
import json
import logging
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from gcd_dataset.errors import ConfigError, ShardError
from gcd_dataset.release.folder import Store, open_store
from gcd_dataset.release.garment import PublishedGarment
from gcd_dataset.release.layout import (
    BODY_FOLDERS,
    REMEDY,
    SPLIT_FILE,
    SPLIT_NAMES,
    batch_order,
    body_folders,
    properties_name,
)
from gcd_dataset.release.properties import Facts, Properties, read_properties
from gcd_dataset.shards.access import reading

__all__ = ["ALL", "Entry", "PublishedGarments"]

logger = logging.getLogger("gcd_dataset")

ALL = "all"
"""The split of every garment that is on disk."""


@dataclass(frozen=True, slots=True)
class Entry:
    """One garment of a split."""

    index: int
    """Twice the place of its design in the split, and 1 more on a random body: whatever else is on disk."""
    batch: str
    body_folder: str
    name: str

    def __str__(self) -> str:
        return f"{self.batch}/{self.body_folder}/{self.name}"


class PublishedGarments:
    """The garments of one split that are on disk and have not failed, in the order of the split.

    ``root``: the folder with ``garments_5000_0`` and its like, or the one that holds it. ``split``: ``train``,
    ``validation``, ``test``, or ``all`` for whatever is on disk. ``cache_dir``: where the indices of archives and the
    digests of properties are kept; by default beside the files. May be pickled and forked.

    Raises ``ConfigError`` for a split or a choice of bodies that there is not, ``ShardError`` for a folder without the
    layout or a damaged archive, ``OutputError`` where indices cannot be kept.
    """

    def __init__(
        self, root: Path | str, split: str = "train", *, bodies: str = "both", cache_dir: Path | str | None = None
    ) -> None:
        folders = body_folders(bodies)
        self.root, self._cache_dir = _root(Path(root)), None if cache_dir is None else Path(cache_dir)
        self.split = _split_name(split)
        self.split_file = None if self.split == ALL else _split_file(self.root)
        self._stores: dict[tuple[str, str], Store] = {}
        self._properties: dict[tuple[str, str], Properties] = {}
        with reading(self.root):
            for batch in sorted((path for path in self.root.iterdir() if _is_batch(path)), key=_order):
                for folder in folders:
                    if (batch / folder).is_dir():
                        self._open(batch / folder)
        self.entries = tuple(self._present(self._listed(), folders))

    def __len__(self) -> int:
        return len(self.entries)

    def garment(self, position: int) -> PublishedGarment:
        """One garment; nothing is read yet."""
        entry = self.entries[position]
        place = (entry.batch, entry.body_folder)
        store = self._stores[place]
        return PublishedGarment(
            name=entry.name,
            place=store.where(entry.name),
            read=functools.partial(store.read, entry.name),
            facts=self._properties[place].facts.get(entry.name, Facts()),
            default_body=entry.body_folder == BODY_FOLDERS["default"],
        )

    def require_any(self) -> None:
        """Raise ``ShardError`` if there is no garment."""
        if not self.entries:
            raise ShardError(
                f"{self.root}: no garment of split {self.split} on the bodies asked for: there is "
                f"{', '.join('/'.join(place) for place in self._stores) or 'none'}: download the batches that it lists"
            )

    @functools.cached_property
    def release(self) -> str:
        """What the release calls itself in the name of its split file: ``GarmentCodeData_v2``, …"""
        found = _split_files(self.root)
        return found[0].name.partition("_official")[0] if found else self.root.name

    @functools.cached_property
    def split_sha256(self) -> str | None:
        """Of the split file: what numbers the garments; ``None`` for all."""
        if self.split_file is None:
            return None
        with reading(self.split_file):
            return hashlib.sha256(self.split_file.read_bytes()).hexdigest()

    def _open(self, folder: Path) -> None:
        place, properties = (folder.parent.name, folder.name), folder / properties_name(folder.name)
        self._stores[place] = open_store(folder, self._cache_dir)
        if properties.exists():
            self._properties[place] = read_properties(properties, self._cache_dir)
        else:
            logger.warning("%s: missing, so failed garments are not known: download it too", properties)
            self._properties[place] = Properties()

    def _listed(self) -> Iterator[tuple[int, str, str]]:
        """Number, batch and name of every design of the split."""
        if self.split_file is not None:
            yield from ((number, *design) for number, design in enumerate(_designs(self.split_file, self.split)))
            return
        designs = dict.fromkeys((batch, name) for (batch, _), store in self._stores.items() for name in store.names)
        yield from ((number, *design) for number, design in enumerate(designs))

    def _present(self, listed: Iterator[tuple[int, str, str]], folders: tuple[str, ...]) -> Iterator[Entry]:
        names = {place: frozenset(store.names) for place, store in self._stores.items()}
        absent = 0
        missing: list[Entry] = []
        for number, batch, name in listed:
            for folder in folders:
                place = (batch, folder)
                entry = Entry(2 * number + (folder == BODY_FOLDERS["random"]), batch, folder, name)
                if place not in names:
                    absent += 1
                elif name in self._properties[place].fails:
                    continue
                elif name in names[place]:
                    yield entry
                elif self.split_file is not None:
                    missing.append(entry)
        if absent:
            logger.info("%s: %d garments of the split are in batches that are not there", self.root, absent)
        if missing:
            # The official lists name designs that came out well on the default body: on another some have failed.
            logger.warning(
                "%s: %d garments of the split are neither there nor noted as failed, such as %s; they are left out",
                self.root,
                len(missing),
                missing[0],
            )


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


def _split_name(split: str) -> str:
    """Our name for a split; theirs is known too. Raises ``ConfigError``."""
    for name, others in SPLIT_NAMES.items():
        if split == name or split in others:
            return name
    if split != ALL:
        raise ConfigError(f"split={split!r}: there is {', '.join(SPLIT_NAMES)}, and {ALL}")
    return ALL


def _split_files(root: Path) -> list[Path]:
    with reading(root):
        return sorted(root.glob(SPLIT_FILE))


def _split_file(root: Path) -> Path:
    found = _split_files(root)
    if not found:
        raise ShardError(
            f"{root}: no official split ({SPLIT_FILE}): download it into this folder, or give split='{ALL}'"
        )
    return found[0]


def _designs(path: Path, split: str) -> list[tuple[str, str]]:
    """Batch and name of the designs that a split file lists. Raises ``ShardError``."""
    with reading(path):
        text = path.read_bytes()
    try:
        lists: Mapping[str, Any] = json.loads(text)
        (key,) = (name for name in SPLIT_NAMES[split] if name in lists)
        # On disk a level named data may lie between.
        parts = [[part for part in entry.strip("/").split("/") if part != "data"] for entry in lists[key]]
        return [(batch, name) for batch, _, name in parts]
    except (ValueError, TypeError, AttributeError, RecursionError) as error:
        wanted = f"a list named {SPLIT_NAMES[split][0]} of garments_5000_0/default_body/rand_… "
        raise ShardError(f"{path}: without {wanted}({error}): {REMEDY}") from error
