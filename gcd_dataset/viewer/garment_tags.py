"""Tags and outcomes of the garments of a split, read from ``meta.json`` in the background and kept in the cache."""

import contextlib
import hashlib
import json
import threading
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Int

from gcd_dataset.errors import OutputError, RemoteError, ShardError
from gcd_dataset.files import make_folder, write_whole
from gcd_dataset.shards import ShardReader
from gcd_dataset.shards.sections import Coding, pack, unpack

CHUNK = 64  # samples whose metadata are read at once; ``close`` waits for a chunk
KEPT_FILES = 64  # data sets in the cache, the latest ones
FOLDER = "tags"
META = "meta.json"
TAG, OUTCOME = "tag", "outcome"
SECTIONS = {"words": "u1", "counts": "i4", "positions": "i4", "known": "i4"}
"""Section of a cached file to its type; words are a JSON list."""


class GarmentTags:
    """Tags and outcomes of the first ``known`` garments of a split; ``read`` reads more. Methods are thread-safe.

    ``cache``: folder that keeps them between runs, keyed by the checksums of all ``meta.json``; ``None`` for none.
    """

    def __init__(self, reader: ShardReader, cache: Path | None = None) -> None:
        self._reader, self._count = reader, len(reader)
        self._file = None if cache is None else cache / FOLDER / f"{_identity(reader)}.z"
        self._positions: dict[tuple[str, str], list[Int[np.ndarray, " m"]]] = {}
        self._lock, self._reading, self._closed = threading.Lock(), threading.Lock(), threading.Event()
        self.problem = ""
        """The message of the server that ended the last ``read`` early; empty if none did."""
        self.known = 0 if META in reader.layout.members else self._count
        if self._file is not None and not self.known:
            self._load(self._file)

    def counts(self, field: str) -> dict[str, int]:
        """Word to the number of known garments with it, in alphabetical order; ``field``: ``TAG`` or ``OUTCOME``."""
        with self._lock:
            found = {word: sum(map(len, rows)) for (name, word), rows in self._positions.items() if name == field}
        return dict(sorted(found.items()))

    def positions(self, field: str, word: str) -> Int[np.ndarray, " m"]:
        """Positions of the known garments with a word, ascending."""
        with self._lock:
            rows = self._positions.get((field, word), [])
            if len(rows) > 1:
                rows[:] = [np.concatenate(rows)]
        return rows[0] if rows else np.zeros(0, np.int64)

    def read(self, limit: int | None = None, between: Callable[[], None] | None = None) -> None:
        """Read the next ``limit`` garments, by default all, until ``close``; damaged ones have no tags.

        ``between``: called before each part, to wait for more urgent work.

        Ends early if a server does not answer, and keeps the message in ``problem``. What was read is written to the
        cache; one thread reads at a time.
        """
        with self._reading:
            self.problem = ""
            before = self.known
            last = self._count if limit is None else min(self.known + limit, self._count)
            while self.known < last and not self._closed.is_set():
                if between is not None:
                    between()
                chunk = range(self.known, min(self.known + CHUNK, last))
                try:
                    self._add(chunk, self._metas(chunk))
                except RemoteError as error:
                    self.problem = str(error)
                    break
            if self.known > before and self._file is not None:
                self._save(self._file)

    def close(self) -> None:
        """Stop ``read``."""
        self._closed.set()

    def _metas(self, chunk: Sequence[int]) -> list[Mapping[str, Any]]:
        try:
            return [_parsed(members[META]) for members in self._reader.read_many(chunk, [META])]
        except ShardError:  # ``gcd check`` reports damage; the garment's own page does too
            return self._readable(chunk)

    def _readable(self, chunk: Sequence[int]) -> list[Mapping[str, Any]]:
        """Read one by one, an empty mapping for a damaged garment. Raises ``RemoteError`` if a server fails twice."""
        metas: list[Mapping[str, Any]] = []
        has_failed = False
        for position in chunk:
            try:
                metas.append(_parsed(self._reader.read(position, [META])[META]))
                has_failed = False
            except ShardError as error:
                if has_failed and isinstance(error, RemoteError):
                    raise
                metas.append({})
                has_failed = isinstance(error, RemoteError)
        return metas

    def _add(self, chunk: Sequence[int], metas: Sequence[Mapping[str, Any]]) -> None:
        found: dict[tuple[str, str], list[int]] = {}
        for position, meta in zip(chunk, metas, strict=True):
            for word in _words(meta):
                found.setdefault(word, []).append(position)
        with self._lock:
            for word, rows in found.items():
                self._positions.setdefault(word, []).append(np.array(rows, np.int64))
            self.known = chunk[-1] + 1

    # ---------------------------------------------------------------------------------------------------------- cache

    def _load(self, path: Path) -> None:
        """Take over a cached file; one that is missing, unreadable or damaged is left out."""
        try:
            stored = unpack(path.read_bytes())
            words, counts, positions, known = (stored[name] for name in SECTIONS)
            named = [(field, word) for field, word in json.loads(words.tobytes())]
        except (OSError, ShardError, KeyError, ValueError, TypeError):
            return
        are_typed = all(stored[name].dtype == kind and stored[name].ndim == 1 for name, kind in SECTIONS.items())
        ends = np.cumsum(counts)
        is_whole = are_typed and len(named) == len(counts) and len(known) == 1 and ends[-1:].sum() == len(positions)
        if not is_whole or not 0 <= known[0] <= self._count or not ((positions >= 0) & (positions < known)).all():
            return
        parts = np.split(positions.astype(np.int64), ends[:-1]) if len(ends) else []
        self._positions.update({word: [rows] for word, rows in zip(named, parts, strict=True)})
        self.known = int(known[0])

    def _save(self, path: Path) -> None:
        """Write to the cache; without room or permission there is none."""
        words = list(self._positions)
        parts = [self.positions(*word) for word in words]
        content: dict[str, np.ndarray] = {
            "words": np.frombuffer(json.dumps(words).encode(), np.uint8),
            "counts": np.array([len(rows) for rows in parts], np.int32),
            "positions": np.concatenate([np.zeros(0, np.int64), *parts]).astype(np.int32),
            "known": np.array([self.known], np.int32),
        }
        with contextlib.suppress(OSError, OutputError):
            make_folder(path.parent)
            write_whole(path, pack(content, {"positions": Coding(1)}))
            _evict(path.parent.glob("*.z"))


def _identity(reader: ShardReader) -> str:
    """A hash of the samples of a split, and of their ``meta.json``, in order."""
    rows = reader.rows(range(len(reader)))
    digest = hashlib.sha256(np.ascontiguousarray(reader.index.number[rows]).tobytes())
    digest.update("".join(shard.sha256 for shard in reader.record.shards).encode())
    return digest.hexdigest()[:32]


def _evict(files: Iterable[Path]) -> None:
    """Delete all but the latest files of the cache."""
    for path in sorted(files, key=lambda path: path.stat().st_mtime)[:-KEPT_FILES]:
        path.unlink(missing_ok=True)


def _parsed(content: memoryview) -> Mapping[str, Any]:
    try:
        meta = json.loads(bytes(content))
    except (ValueError, RecursionError):
        return {}
    return meta if isinstance(meta, Mapping) else {}


def _words(meta: Mapping[str, Any]) -> list[tuple[str, str]]:
    """Tags and outcome of a garment, each once."""
    tags, drape = meta.get("tags"), meta.get("drape")
    found = dict.fromkeys((TAG, tag) for tag in tags if isinstance(tag, str) and tag) if isinstance(tags, list) else {}
    outcome = drape.get("outcome") if isinstance(drape, Mapping) else None
    if isinstance(outcome, str) and outcome:
        found[OUTCOME, outcome.lower().replace("_", " ")] = None
    return list(found)
