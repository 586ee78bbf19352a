"""The published GarmentCodeData as a list of garments: what is there, what the split asks for, what failed."""

import functools
import hashlib
import json
import logging
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from gcd_dataset.errors import ConfigError, ShardError, did_you_mean, shown
from gcd_dataset.release.batch_index import PublishedBatches
from gcd_dataset.release.properties import Facts
from gcd_dataset.release.published_names import BODY_FOLDERS, REMEDY, SPLIT_FILE, SPLIT_NAMES
from gcd_dataset.release.read_garment import PublishedGarment
from gcd_dataset.shards.access import reading

__all__ = ["ALL", "GarmentEntry", "PublishedGarments"]

logger = logging.getLogger("gcd_dataset")

ALL = "all"
"""The split of every garment that is on disk."""


@dataclass(frozen=True, slots=True)
class GarmentEntry:
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

    ``split``: ``train``, ``validation``, ``test``, or ``all`` for whatever is on disk. May be pickled and forked.
    Raises ``ConfigError`` for a split that there is not, ``ShardError`` for a split file that is missing or broken.
    """

    def __init__(self, batches: PublishedBatches, split: str = "train") -> None:
        self.batches, self.split = batches, _split_name(split)
        self.split_file = None if self.split == ALL else _split_file(batches)
        self.entries = tuple(self._present(self._listed()))

    def __len__(self) -> int:
        return len(self.entries)

    def garment(self, position: int) -> PublishedGarment:
        """One garment; nothing is read yet."""
        entry = self.entries[position]
        place = (entry.batch, entry.body_folder)
        files = self.batches.files[place]
        return PublishedGarment(
            name=entry.name,
            place=files.where(entry.name),
            read=functools.partial(files.read, entry.name),
            facts=self.batches.properties[place].facts.get(entry.name, Facts()),
            default_body=entry.body_folder == BODY_FOLDERS["default"],
        )

    def require_any(self) -> None:
        """Raise ``ShardError`` if there is no garment."""
        if not self.entries:
            there = ", ".join("/".join(place) for place in self.batches.files) or "none"
            raise ShardError(
                f"{self.batches.root}: no garment of split {self.split} on the bodies asked for: there is {there}: "
                "download the batches that it lists"
            )

    @functools.cached_property
    def split_sha256(self) -> str | None:
        """Of the split file: what numbers the garments; ``None`` for all."""
        if self.split_file is None:
            return None
        with reading(self.split_file):
            return hashlib.sha256(self.split_file.read_bytes()).hexdigest()

    def _listed(self) -> Iterator[tuple[int, str, str]]:
        """Number, batch and name of every design of the split."""
        if self.split_file is not None:
            yield from ((number, *design) for number, design in enumerate(_designs(self.split_file, self.split)))
            return
        designs = dict.fromkeys(
            (batch, name) for (batch, _), files in self.batches.files.items() for name in files.names
        )
        yield from ((number, *design) for number, design in enumerate(designs))

    def _present(self, listed: Iterator[tuple[int, str, str]]) -> Iterator[GarmentEntry]:
        names = {place: frozenset(files.names) for place, files in self.batches.files.items()}
        absent = 0
        missing: list[GarmentEntry] = []
        for number, batch, name in listed:
            for folder in self.batches.body_folders:
                place = (batch, folder)
                entry = GarmentEntry(2 * number + (folder == BODY_FOLDERS["random"]), batch, folder, name)
                if place not in names:
                    absent += 1
                elif name in self.batches.properties[place].fails:
                    continue
                elif name in names[place]:
                    yield entry
                elif self.split_file is not None:
                    missing.append(entry)
        if absent:
            logger.info("%s: %d garments of the split are in batches that are not there", self.batches.root, absent)
        if missing:
            # The official lists name designs that came out well on the default body: on another some have failed.
            logger.warning(
                "%s: %d garments of the split are neither there nor noted as failed, such as %s; they are left out",
                self.batches.root,
                len(missing),
                shown(str(missing[0])),
            )


def _split_name(split: str) -> str:
    """Our name for a split; theirs is known too. Raises ``ConfigError``."""
    for name, others in SPLIT_NAMES.items():
        if split == name or split in others:
            return name
    if split != ALL:
        nearest = did_you_mean(split, [*SPLIT_NAMES, ALL])
        raise ConfigError(f"split={split!r}: there is {', '.join(SPLIT_NAMES)}, and {ALL}{nearest}")
    return ALL


def _split_file(batches: PublishedBatches) -> Path:
    if batches.split_file is None:
        raise ShardError(
            f"{batches.root}: no official split ({SPLIT_FILE}): download it into this folder; "
            f"PublishedGarmentCodeData does without for {ALL!r}"
        )
    return batches.split_file


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
