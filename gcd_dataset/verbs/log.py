"""The log of a run: a file of JSON objects, one a line, for programs that watch many runs.

Every line has ``event`` and ``time`` (UTC, ISO 8601). What else stands there, by event:

begin
    ``options`` (of the call), ``versions`` (of what decides the samples), ``recipe`` (its SHA-256), ``machine``
    (``host``, ``pid``, ``cores``, ``gpus``: device to name).
progress
    After every 100 samples, and with the first sample after 10 s: ``count`` (samples in the end), ``there`` (found at
    the beginning), ``made`` (by this run), ``rate`` (samples a second over the last minute, or null), ``left_s``
    (seconds left at that rate, or null), ``outcomes`` and ``rejects`` (of this run, by name and by rule), ``waits``
    (share of the last minute that each GPU's draping processes waited for orders, ``makers`` for the writer and
    ``writer`` for samples), ``rss_mb`` (memory of this process, MB).
end, stopped, failed
    As ``progress``, with ``seconds`` (since ``begin``); ``stopped``: by Ctrl-C; ``failed``: with
    ``error``, the line that the user is told. The log of a killed run has none of them.
"""

import json
import logging
import os
import platform
import resource
import stat
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from gcd_dataset.errors import OutputError
from gcd_dataset.files import make_folder, user_path, writing_to
from gcd_dataset.generator.recipe import versions
from gcd_dataset.shards.layout import recipe_hash
from gcd_dataset.verbs.progress import Progress, Told

__all__ = ["logged"]

EVERY = 100  # samples
EVERY_S = 10.0
BEGIN = b'{"event": "'
TAIL = 1 << 20  # bytes, more than a line has

logger = logging.getLogger("gcd_dataset")


@contextmanager
def logged(
    path: Path | str | None,
    told: Told,
    *,
    options: Mapping[str, Any],
    recipe: Mapping[str, Any],
    devices: Sequence[str] = (),
    clock: Callable[[], float] = time.monotonic,
) -> Iterator[Told]:
    """``told``, which also appends to the log in ``path``, if one is asked for; it is ended with the block.

    A line is written whole or not at all. Raises ``OutputError`` for a file that cannot be opened; where it cannot be
    written later, a warning says so once and the run goes on.
    """
    if path is None:
        yield told
        return
    lines = _Lines(user_path(path))
    try:
        machine = {"host": platform.node(), "pid": os.getpid(), **_hardware(devices)}
        begin = {"options": options, "versions": versions(), "recipe": recipe_hash(recipe), "machine": machine}
        lines.write("begin", begin)
        run = _Run(lines, told, clock)
        try:
            yield run.told
        except BaseException as error:
            run.end("stopped" if isinstance(error, KeyboardInterrupt) else "failed", error)
            raise
        run.end("end")
    finally:
        lines.close()


class _Run:
    """Tells of progress, and writes some of it down."""

    def __init__(self, lines: "_Lines", told: Told, clock: Callable[[], float]) -> None:
        self._lines, self._told, self._clock = lines, told, clock
        self._begun = self._written = clock()
        self._made, self._last = 0, Progress(0, 0)

    def told(self, progress: Progress) -> None:
        self._last = progress
        if progress.made - self._made >= EVERY or (self._clock() - self._written >= EVERY_S and progress.made):
            self._written, self._made = self._clock(), progress.made
            self._lines.write("progress", _figures(progress))
        self._told(progress)

    def end(self, event: str, error: BaseException | None = None) -> None:
        ended: dict[str, Any] = {**_figures(self._last), "seconds": round(self._clock() - self._begun, 3)}
        if event == "failed":
            ended["error"] = " ".join(str(error).split()) or type(error).__name__
        self._lines.write(event, ended)


def _figures(progress: Progress) -> dict[str, Any]:
    return {
        "count": progress.count,
        "there": progress.there,
        "made": progress.made,
        "rate": None if progress.rate is None else round(progress.rate, 4),
        "left_s": None if progress.left_s is None else round(progress.left_s, 1),
        "outcomes": dict(progress.outcomes.most_common()),
        "rejects": dict(progress.rejects.most_common()),
        "waits": {name: round(share, 4) for name, share in progress.waits.items()},
        "rss_mb": round(_resident() / 1e6, 1),
    }


def _hardware(devices: Sequence[str]) -> dict[str, Any]:
    from gcd_dataset.generator.drape.device import cores, device_names

    return {"cores": cores(), "gpus": device_names([device for device in devices if device != "cpu"])}


def _resident() -> float:
    """Bytes of memory of this process; at their most where the system tells no more."""
    try:
        return int(Path("/proc/self/statm").read_text().split()[1]) * resource.getpagesize()
    except (OSError, ValueError, IndexError):
        most = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
        return most if sys.platform == "darwin" else most * 1024


class _Lines:
    """A file to which lines are appended. Raises ``OutputError`` where it cannot be opened."""

    def __init__(self, path: Path) -> None:
        self._path, self._failed = path, False
        make_folder(path.parent)
        with writing_to(path):
            flags = os.O_APPEND | os.O_CREAT | os.O_NONBLOCK | os.O_CLOEXEC  # a pipe without a reader is an error
            self._file = os.open(path, os.O_WRONLY | flags, 0o644)
            try:
                self._drop_torn_line()
            except BaseException:
                self.close()
                raise

    def write(self, event: str, entry: Mapping[str, Any]) -> None:
        """Append a line, or warn once that it cannot be."""
        now = datetime.now(UTC).isoformat(timespec="milliseconds")
        line = json.dumps({"event": event, "time": now, **entry}, default=str) + "\n"
        try:
            _append(self._file, line.encode())
        except OSError as error:
            if not self._failed:
                logger.warning(
                    "%s: cannot be written (%s): the run goes on without its log", self._path, error.strerror
                )
            self._failed = True

    def close(self) -> None:
        os.close(self._file)

    def _drop_torn_line(self) -> None:
        """Cut off the last line if a power cut left half of it. Raises ``OutputError`` for a file that is no log."""
        about = os.fstat(self._file)
        if not stat.S_ISREG(about.st_mode):
            return
        with self._path.open("rb") as file:
            file.seek(max(about.st_size - TAIL, 0))
            before, _, torn = file.read().rpartition(b"\n")
        whole = before.rpartition(b"\n")[2]
        is_none = whole and not whole.startswith(BEGIN)
        if is_none or (torn and not (torn.startswith(BEGIN) or BEGIN.startswith(torn))):
            raise OutputError(f"{self._path}: its last line is none of a log: choose another file")
        os.ftruncate(self._file, about.st_size - len(torn))


def _append(file: int, line: bytes) -> None:
    """Write a line, or nothing. Raises ``OSError``."""
    written = os.write(file, line)
    if written == len(line):
        return
    end = os.lseek(file, 0, os.SEEK_CUR)
    if os.fstat(file).st_size == end:  # no other process has appended to it since
        os.ftruncate(file, end - written)
    raise OSError(0, "no room for a whole line")
