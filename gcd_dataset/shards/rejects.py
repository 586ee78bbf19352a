"""``rejects.jsonl``: the rejected attempts of a data set.

One JSON object per line, in the order of designs and attempts:

==============  ====================================================================================================
``seed``        of the data set
``design``      number of the design: index of its first sample // wearers per design
``attempt``     0 for the first attempt at this design
``index``       the sample for which the attempt failed: the design did not fit its wearer, or its drape failed
``rule``        the rule that rejected it, as counted in ``manifest.json``; ``drape`` for a failed drape
``reason``      a sentence; for a drape its outcome
``figures``     the numbers behind the rule; names end in their units: ``{"cuff_cm": 29.9, "limb_cm": 35.5}``
==============  ====================================================================================================

The file does not depend on the number of workers, interruptions or parts: it holds the lines of all designs that have a
sample in the data set. During a run, lines go to a journal, before the sample of the same design is written, so a
killed process loses none. Where neither file has the lines of a sample (an earlier version made it, the file was
deleted, the power failed), rule and reason are taken from its ``meta.json``, and ``figures`` are empty.
"""

import contextlib
import json
import logging
import os
from collections import Counter
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from pathlib import Path
from types import TracebackType
from typing import Any, Self

from gcd_dataset.errors import OutputError, ShardError
from gcd_dataset.files import write_whole
from gcd_dataset.records import Rejected
from gcd_dataset.shards.access import reading, writing
from gcd_dataset.shards.contents import read_index
from gcd_dataset.shards.index import ShardTable
from gcd_dataset.shards.manifest import read_manifest
from gcd_dataset.shards.meta import decode_json, json_bytes, read_meta

__all__ = ["REJECTS", "RejectLog", "has_rejects", "joined_rejects", "merged_rejects"]

REJECTS = "rejects.jsonl"
JOURNAL = ".rejects.jsonl.part"
DIGITS = 4  # decimals of a figure
LONGEST_LINE = 1 << 16  # bytes
META = 0  # column of meta.json

logger = logging.getLogger("gcd_dataset")

Lines = dict[int, dict[int, bytes]]
"""Design to attempt to line."""


class RejectLog:
    """Writes ``rejects.jsonl`` of a folder while its ``ShardWriter`` adds samples.

    ``wearers``: samples of one design. ``done``: returns the indices of the samples on disk. The file is written at the
    end of the ``with`` block, also after an error. Raises ``ShardError`` for a broken shard, ``OutputError`` where the
    folder cannot be written.
    """

    def __init__(self, folder: Path, *, seed: int, wearers: int, done: Callable[[], Collection[int]]) -> None:
        self._folder, self._seed, self._wearers, self._done = folder, seed, wearers, done
        self._lines = self._stored_lines()
        self._add_missing()
        self._journal: int | None = None

    def add(self, attempts: Iterable[Rejected]) -> None:
        """Record the rejected attempts of a design. Call it before the sample is written."""
        lines = {
            (reject.index // self._wearers, attempt): self._line(attempt, reject)
            for attempt, reject in enumerate(attempts)
        }
        new = {key: line for key, line in lines.items() if self._lines.get(key[0], {}).get(key[1]) != line}
        if not new:
            return
        with writing(self._folder / JOURNAL):
            if self._journal is None:
                flags = os.O_WRONLY | os.O_CREAT | os.O_APPEND | os.O_NOFOLLOW
                self._journal = os.open(self._folder / JOURNAL, flags, 0o644)
                os.write(self._journal, b"\n")  # ends a line that a killed run may have truncated
            rest = memoryview(b"".join(new.values()))
            while rest:
                rest = rest[os.write(self._journal, rest) :]
        for (design, attempt), line in new.items():
            self._lines.setdefault(design, {})[attempt] = line

    def close(self) -> None:
        """Write ``rejects.jsonl`` and remove the journal. After an ``OutputError`` the journal still exists."""
        if self._journal is not None:
            os.close(self._journal)
            self._journal = None
        designs = sorted({index // self._wearers for index in self._done()} & self._lines.keys())
        content = b"".join(line for design in designs for _, line in sorted(self._lines[design].items()))
        if not _holds(self._folder / REJECTS, content):
            write_whole(self._folder / REJECTS, content)
        with writing(self._folder / JOURNAL):
            (self._folder / JOURNAL).unlink(missing_ok=True)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        try:
            self.close()
        except OutputError:
            if kind is None:
                raise
            # Raise the first error; the next writer reads the journal.

    def _line(self, attempt: int, reject: Rejected) -> bytes:
        entry = {
            "seed": self._seed,
            "design": reject.index // self._wearers,
            "attempt": attempt,
            "index": reject.index,
            "rule": reject.rule,
            "reason": reject.reason,
            "figures": {name: _rounded(value) for name, value in reject.figures.items()},
        }
        return json_bytes(entry) + b"\n"

    def _stored_lines(self) -> Lines:
        """The lines of earlier runs, from ``rejects.jsonl`` and from the journal of a killed run."""
        lines: Lines = {}
        for path in (self._folder / REJECTS, self._folder / JOURNAL):
            for line in _lines_in(path):
                entry = _parsed(line)
                if entry is not None and entry["seed"] == self._seed:
                    lines.setdefault(entry["design"], {})[entry["attempt"]] = line
        return lines

    def _add_missing(self) -> None:
        """Add lines from the samples of each shard for which manifest and lines disagree on the counts of rejects."""
        manifest = read_manifest(self._folder)
        for split, record in manifest.splits.items() if manifest is not None else ():
            counted = {shard.name: shard.rejects for shard in record.shards}
            for name, table in read_index(self._folder, split).tables().items():
                if self._counts(table) != Counter(counted.get(name, {})):
                    self._add_from(self._folder / name, table)

    def _counts(self, table: ShardTable) -> Counter[str]:
        """Rule to count, as in ``manifest.json``: a line counts once for each sample of its design in the shard."""
        designs = Counter(index // self._wearers for index in table.sample.tolist())
        counts: Counter[str] = Counter()
        for design in designs.keys() & self._lines.keys():
            for line in self._lines[design].values():
                counts[json.loads(line)["rule"]] += designs[design]
        return counts

    def _add_from(self, path: Path, table: ShardTable) -> None:
        metas = zip(table.sample.tolist(), table.offset[:, META].tolist(), table.size[:, META].tolist(), strict=True)
        with reading(path), path.open("rb") as file:
            for index, offset, size in metas:
                design = index // self._wearers
                rejects = [_split(text) for text in read_meta(os.pread(file.fileno(), size, offset))["rejects"]]
                known = [json.loads(line) for _, line in sorted(self._lines.get(design, {}).items())]
                if [(entry["rule"], entry["reason"]) for entry in known] != rejects:
                    self._lines[design] = {
                        attempt: self._line(attempt, Rejected(design * self._wearers, rule, reason))
                        for attempt, (rule, reason) in enumerate(rejects)
                    }


def has_rejects(folder: Path) -> bool:
    """Whether ``rejects.jsonl`` exists and is complete: no journal is left. Raises ``ShardError``."""
    with reading(folder):
        return (folder / REJECTS).exists() and not (folder / JOURNAL).exists()


def joined_rejects(folders: Iterable[Path]) -> bytes:
    """The concatenation of ``rejects.jsonl`` of the parts of a data set. Raises ``ShardError``."""
    return b"".join(line for folder in folders for line in _lines_in(folder / REJECTS))


def merged_rejects(contents: Iterable[bytes]) -> bytes:
    """The sorted lines of several files; for two lines of one attempt, the later one."""
    lines: Lines = {}
    for content in contents:
        for line in content.splitlines(keepends=True):
            if (entry := _parsed(line)) is not None:
                lines.setdefault(entry["design"], {})[entry["attempt"]] = line
    return b"".join(line for _, attempts in sorted(lines.items()) for _, line in sorted(attempts.items()))


def _lines_in(path: Path) -> Iterator[bytes]:
    """The lines of a file, newlines included; none for a missing file. Raises ``ShardError``."""
    with reading(path), contextlib.suppress(FileNotFoundError), path.open("rb") as file:
        yield from iter(lambda: file.readline(LONGEST_LINE), b"")


def _parsed(line: bytes) -> dict[str, Any] | None:
    """The entry of a line; ``None`` for a truncated or invalid one."""
    with contextlib.suppress(ShardError):
        entry = decode_json(line) if line.endswith(b"\n") else None
        if isinstance(entry, Mapping) and all(_is_count(entry.get(name)) for name in ("seed", "design", "attempt")):
            return dict(entry) if all(isinstance(entry.get(name), str) for name in ("rule", "reason")) else None
    return None


def _is_count(value: Any) -> bool:
    return isinstance(value, int) and not isinstance(value, bool) and value >= 0


def _split(reject: str) -> tuple[str, str]:
    rule, _, reason = reject.partition(": ")
    return rule, reason


def _rounded(value: float) -> float:
    return value if isinstance(value, int) else round(float(value), DIGITS)


def _holds(path: Path, content: bytes) -> bool:
    with reading(path):
        return path.exists() and path.read_bytes() == content
