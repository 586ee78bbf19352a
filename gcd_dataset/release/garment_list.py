"""The garments of a split of the published GarmentCodeData that are on disk and have not failed."""

import functools
import hashlib
import json
import logging
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from gcd_dataset.errors import ConfigError, ShardError, did_you_mean, shown
from gcd_dataset.filekinds import BODY_FOLDERS
from gcd_dataset.release.batches import Facts, PublishedBatches
from gcd_dataset.release.published_names import REMEDY, SPLIT_FILE, SPLIT_NAMES
from gcd_dataset.release.read_garment import PublishedGarment
from gcd_dataset.shards.access import read_file

logger = logging.getLogger("gcd_dataset")

ALL = "all"
"""The split of all garments on disk."""


@dataclass(frozen=True, slots=True)
class GarmentEntry:
    """One garment of a split."""

    index: int
    """2 · position of its design in the split, + 1 on a random body; independent of the other garments on disk."""
    batch: str
    body_folder: str
    name: str

    def __str__(self) -> str:
        return f"{self.batch}/{self.body_folder}/{self.name}"


class PublishedGarments:
    """The garments of one split that are on disk and have not failed, in the order of the split.

    ``split``: ``train``, ``validation``, ``test``, or ``all`` for all garments on disk. May be pickled and forked.
    Raises ``ConfigError`` for an unknown split, ``ShardError`` for a missing or broken split file.
    """

    def __init__(self, batches: PublishedBatches, split: str = "train") -> None:
        self.batches, self.split = batches, _split_name(split)
        self.split_file = None if self.split == ALL else batches.split_file
        if self.split_file is None and self.split != ALL:
            raise ShardError(
                f"{batches.root}: no official split ({SPLIT_FILE}): download it into this folder; "
                f"split={ALL!r} does not need it"
            )
        missing: list[str] = []
        self.entries = tuple(self._present(self._listed(), missing))
        self.missing = tuple(missing)
        """Garments of the split that are neither on disk nor listed as failed, of the batches on disk."""

    def __len__(self) -> int:
        return len(self.entries)

    def garment(self, position: int) -> PublishedGarment:
        """One garment; its files are read on demand."""
        entry = self.entries[position]
        key = (entry.batch, entry.body_folder)
        files = self.batches.files[key]
        return PublishedGarment(
            name=entry.name,
            location=files.location(entry.name),
            read=functools.partial(files.read, entry.name),
            facts=self.batches.properties[key].facts.get(entry.name, Facts()),
            default_body=entry.body_folder == BODY_FOLDERS["default"],
        )

    def require_any(self) -> None:
        """Raise ``ShardError`` if there is no garment."""
        if not self.entries:
            found = ", ".join("/".join(key) for key in self.batches.files) or "none"
            raise ShardError(
                f"{self.batches.root}: no garment of split {self.split} on these bodies; batches on disk: {found}: "
                "download the batches that the split lists"
            )

    @functools.cached_property
    def split_sha256(self) -> str | None:
        """Hash of the split file, which determines the indices; ``None`` for split ``all``."""
        if self.split_file is None:
            return None
        return hashlib.sha256(read_file(self.split_file)).hexdigest()

    def _listed(self) -> Iterator[tuple[int, str, str]]:
        """Position, batch and name of every design of the split."""
        if self.split_file is not None:
            yield from ((number, *design) for number, design in enumerate(_designs(self.split_file, self.split)))
            return
        designs = dict.fromkeys(
            (batch, name) for (batch, _), files in self.batches.files.items() for name in files.names
        )
        yield from ((number, *design) for number, design in enumerate(designs))

    def _present(self, listed: Iterator[tuple[int, str, str]], missing: list[str]) -> Iterator[GarmentEntry]:
        """The garments on disk; names of those that should be there are added to ``missing``."""
        names = {key: frozenset(files.names) for key, files in self.batches.files.items()}
        absent = 0
        for number, batch, name in listed:
            for folder in self.batches.body_folders:
                key = (batch, folder)
                entry = GarmentEntry(2 * number + (folder == BODY_FOLDERS["random"]), batch, folder, name)
                if key not in names:
                    absent += 1
                elif name in self.batches.properties[key].fails:
                    continue
                elif name in names[key]:
                    yield entry
                elif self.split_file is not None:
                    missing.append(str(entry))
        if absent:
            logger.info("%s: %d garments of the split are in batches that are not on disk", self.batches.root, absent)
        if missing:
            # The official split lists designs that succeeded on the default body; some failed on random bodies.
            logger.warning(
                "%s: %d garments of the split are neither on disk nor listed as failed, such as %s; they are left out",
                self.batches.root,
                len(missing),
                shown(missing[0]),
            )


def _split_name(split: str) -> str:
    """This package's name of a split, from its own or the authors' name. Raises ``ConfigError``."""
    for name, others in SPLIT_NAMES.items():
        if split == name or split in others:
            return name
    if split != ALL:
        nearest = did_you_mean(split, [*SPLIT_NAMES, ALL])
        raise ConfigError(f"split={split!r}: choose from {', '.join(SPLIT_NAMES)}, and {ALL}{nearest}")
    return ALL


def _designs(path: Path, split: str) -> list[tuple[str, str]]:
    """Batch and name of the designs that a split file lists. Raises ``ShardError``."""
    text = read_file(path)
    try:
        lists: Mapping[str, Any] = json.loads(text)
        (key,) = (name for name in SPLIT_NAMES[split] if name in lists)
        # Version 2 has an extra level named data.
        parts = [[part for part in entry.strip("/").split("/") if part != "data"] for entry in lists[key]]
        return [(batch, name) for batch, _, name in parts]
    except (ValueError, TypeError, AttributeError, RecursionError) as error:
        wanted = f"a list named {SPLIT_NAMES[split][0]} of garments_5000_0/default_body/rand_… "
        raise ShardError(f"{path}: lacks {wanted}({error}): {REMEDY}") from error
