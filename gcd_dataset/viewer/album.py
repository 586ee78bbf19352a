"""The garments that a viewer turns over: of a data set, as published, or specification files beside the truth."""

import json
import threading
from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Bool, Int

from gcd_dataset.errors import ConfigError, ShardError
from gcd_dataset.shards import ShardReader
from gcd_dataset.shards.index import GRADES
from gcd_dataset.spec import read_pattern
from gcd_dataset.viewer.content import content_of
from gcd_dataset.viewer.page import page_of

if TYPE_CHECKING:
    from gcd_dataset.loaders import PublishedGarmentCodeData

__all__ = ["Album", "Found", "PublishedAlbum", "ShardAlbum", "SpecAlbum", "spec_album"]

CHUNK = 256  # samples whose metadata are read at once
KEPT_MATCHES = 32  # filters whose matches are kept
SUFFIX = "_specification"
META = "meta.json"


@dataclass(frozen=True)
class Found:
    """A garment among those that a filter admits."""

    position: int
    """In the album; -1 if the filter admits none."""
    rank: int
    count: int
    """Garments that the filter admits, of those known so far."""


class Album(ABC):
    """Garments in a fixed order, with tags and grades to filter by. All methods may be called from several threads."""

    title: str
    beside: tuple[str, ...] = ("",)
    """Headings of the pages of a garment, from left to right."""

    @abstractmethod
    def __len__(self) -> int: ...

    @abstractmethod
    def key(self, position: int) -> str:
        """The name of a garment."""

    @abstractmethod
    def page(self, position: int, side: int = 0) -> str:
        """The HTML page of a garment. Raises ``GcdError`` for a damaged one."""

    def grades(self) -> dict[str, int]:
        """Grade to the number of its garments; empty without grades."""
        return {}

    def tags(self) -> dict[str, int]:
        """Tag to the number of its garments, of those read so far."""
        return {}

    @property
    def read(self) -> int:
        """Garments whose tags are known."""
        return len(self)

    def matches(self, grade: str = "", tag: str = "") -> Int[np.ndarray, " m"]:
        """Positions of the garments of a grade and with a tag; an empty word admits all."""
        return np.arange(len(self))

    def found(self, rank: int, *, grade: str = "", tag: str = "") -> Found:
        """The garment at ``rank`` of those that a filter admits, counted round."""
        matches = self.matches(grade, tag)
        if not len(matches):
            return Found(-1, 0, 0)
        rank %= len(matches)
        return Found(int(matches[rank]), rank, len(matches))

    def nearest(self, position: int, *, grade: str = "", tag: str = "") -> Found:
        """The admitted garment at ``position`` or after it, or else the last one."""
        matches = self.matches(grade, tag)
        rank = int(np.searchsorted(matches, position))
        return self.found(min(rank, max(len(matches) - 1, 0)), grade=grade, tag=tag)

    def position_of(self, text: str) -> int:
        """The position of a garment by its index or key. Raises ``ConfigError`` for an unknown one."""
        if text.strip().isdecimal() and int(text) < len(self):
            return int(text)
        raise ConfigError(f"no garment {text.strip()!r:.80}: give a number from 0 to {len(self) - 1}")


class ShardAlbum(Album):
    """A split of a data set. Grades come from the index; a thread reads the tags, so that opening takes no longer."""

    def __init__(self, reader: ShardReader, title: str) -> None:
        self.title = title
        self._reader = reader
        rows = reader.rows(range(len(reader)))
        self._grade = reader.index.table.grade[rows]
        self._number = reader.index.table.sample[rows]
        self._tags: dict[str, list[int]] = {}
        self._read, self._lock, self._closed = 0, threading.Lock(), threading.Event()

    def __len__(self) -> int:
        return len(self._reader)

    def key(self, position: int) -> str:
        return self._reader.index.key(int(self._reader.rows([position])[0]))

    def page(self, position: int, side: int = 0) -> str:
        return page_of(content_of(self._reader.sample(position)))

    def grades(self) -> dict[str, int]:
        counts = np.bincount(self._grade, minlength=len(GRADES)).tolist()
        return {name: count for name, count in zip(GRADES, counts, strict=True) if name and count}

    def tags(self) -> dict[str, int]:
        with self._lock:
            return {tag: len(rows) for tag, rows in sorted(self._tags.items())}

    @property
    def read(self) -> int:
        return self._read

    def matches(self, grade: str = "", tag: str = "") -> Int[np.ndarray, " m"]:
        admitted: Bool[np.ndarray, " n"] = np.ones(len(self), bool)
        if grade:
            admitted = self._grade == (GRADES.index(grade) if grade in GRADES else len(GRADES))
        if tag:
            with self._lock:
                rows = np.array(self._tags.get(tag, []), int)
            admitted = admitted & np.isin(np.arange(len(self)), rows)
        return np.flatnonzero(admitted)

    def position_of(self, text: str) -> int:
        digits = text.strip().rsplit("_", 1)[-1]
        if digits.isdecimal():
            position = int(np.searchsorted(self._number, int(digits)))
            if position < len(self) and self._number[position] == int(digits):
                return position
        raise ConfigError(
            f"{self.title} has no sample {text.strip()!r:.80}: give an index from {self._number[0]} to "
            f"{self._number[-1]}, or a key"
        )

    def read_tags(self) -> None:
        """Read the tags of all garments, until ``close``; damaged ones have none."""
        for first in range(0, len(self), CHUNK):
            if self._closed.is_set():
                return
            chunk = range(first, min(first + CHUNK, len(self)))
            found = [self._tags_of(position) for position in chunk]
            with self._lock:
                for position, tags in zip(chunk, found, strict=True):
                    for tag in tags:
                        self._tags.setdefault(tag, []).append(position)
                self._read = chunk[-1] + 1

    def close(self) -> None:
        """Stop ``read_tags``."""
        self._closed.set()

    def _tags_of(self, position: int) -> list[str]:
        try:
            meta = json.loads(bytes(self._reader.read(position, [META])[META]))
        except (ShardError, ValueError):  # ``gcd verify`` reports damage; the garment's own page does too
            return []
        outcome = str((meta.get("drape") or {}).get("outcome") or "").lower().replace("_", " ")
        tags = [tag for tag in meta.get("tags") or () if isinstance(tag, str)]
        return [*tags, *([f"outcome: {outcome}"] if outcome else [])]


class SpecAlbum(Album):
    """Specification files; with ``truth``, each beside the file of the same name there."""

    def __init__(self, paths: Sequence[Path], title: str, truth: Path | None = None) -> None:
        self.title, self._paths = title, list(paths)
        self._truth = {} if truth is None else _by_key(truth)
        self.beside = ("",) if truth is None else ("predicted", "true")

    def __len__(self) -> int:
        return len(self._paths)

    def key(self, position: int) -> str:
        return _key(self._paths[position])

    def page(self, position: int, side: int = 0) -> str:
        path = self._paths[position]
        if side:
            key = _key(path)
            if key not in self._truth:
                raise ConfigError(f"{path}: no file of this name in the folder of the truth")
            path = self._truth[key]
        return page_of(content_of(read_pattern(path)))

    def position_of(self, text: str) -> int:
        keys = _positions(tuple(map(_key, self._paths)))
        wanted = _key(Path(text.strip()))
        return keys[wanted] if wanted in keys else super().position_of(text)


class PublishedAlbum(Album):
    """GarmentCodeData as published."""

    def __init__(self, published: "PublishedGarmentCodeData", title: str) -> None:
        self.title, self._published = title, published

    def __len__(self) -> int:
        return len(self._published)

    def key(self, position: int) -> str:
        return self._published.name(position)

    def page(self, position: int, side: int = 0) -> str:
        return page_of(content_of(self._published.sample(position)))

    def position_of(self, text: str) -> int:
        names = _positions(self._published.names)
        return names[text.strip()] if text.strip() in names else super().position_of(text)


def spec_album(source: Path, truth: Path | None = None) -> SpecAlbum:
    """A specification file, or all of a folder. Raises ``ConfigError`` for a folder without any."""
    paths = [source] if source.is_file() else list(_by_key(source).values())
    if not paths:
        raise ConfigError(f"{source}: no specification file (.json): give a data set or a folder of specifications")
    if truth is not None and not truth.is_dir():
        raise ConfigError(f"--truth {truth}: not a folder: give the folder of the true specification files")
    return SpecAlbum(paths, str(source), truth)


def _by_key(folder: Path) -> dict[str, Path]:
    return {_key(path): path for path in sorted(folder.glob("*.json"))}


def _key(path: Path) -> str:
    return path.stem.removesuffix(SUFFIX) if path.suffix in (".json", "") else path.name


@lru_cache(KEPT_MATCHES)
def _positions(keys: tuple[str, ...]) -> dict[str, int]:
    return {key: position for position, key in enumerate(keys)}
