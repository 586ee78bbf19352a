"""The log of a run: a JSON Lines file for programs that monitor many runs.

Every line has ``event`` and ``time`` (UTC, ISO 8601). The other keys, by event:

begin
    ``options`` (of the call), ``versions`` (of the packages that determine the samples), ``recipe`` (its SHA-256),
    ``machine`` (``host``, ``pid``, ``cores``, ``gpus``: device to name).
progress
    Every 100 samples, and at the first sample 10 s after the last line or later: ``count`` (samples in the finished
    data set), ``there`` (from earlier runs), ``made`` (by this run), ``rate`` (samples a second over the last minute,
    or null), ``left_s`` (seconds left at that rate, or null), ``outcomes`` and ``rejects`` (of this run, by name and by
    rule), ``rss_mb`` (resident memory of this process, MB).
end, stopped, failed
    The keys of ``progress``, and ``seconds`` (since ``begin``). ``stopped``: by Ctrl-C; ``failed``: also ``error``, the
    error message. A killed run logs none of these events.
"""

import contextlib
import json
import logging
import os
import platform
import resource
import stat
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from gcd_dataset.errors import OutputError
from gcd_dataset.files import make_folder, user_path, writing_to
from gcd_dataset.generator.recipe import versions
from gcd_dataset.making.progress import Progress, ProgressCallback
from gcd_dataset.shards.layout import recipe_hash

EVERY = 100  # samples between two progress lines …
EVERY_S = 10.0  # … or seconds
BEGIN = b'{"event": "'
TAIL = 1 << 20  # bytes read to find the last line; longer than any line

logger = logging.getLogger("gcd_dataset")


@contextlib.contextmanager
def run_log(
    path: Path | str | None,
    on_progress: ProgressCallback,
    *,
    options: Mapping[str, Any],
    recipe: Mapping[str, Any],
    devices: Sequence[str] = (),
) -> Iterator[ProgressCallback]:
    """Log the block as a run: yields a callback that calls ``on_progress`` and appends to the log in ``path``.

    Without ``path`` it yields ``on_progress``. A line is written completely or not at all. Raises ``OutputError`` for a
    file that cannot be opened; if a later write fails, one warning is logged and the run continues.
    """
    if path is None:
        yield on_progress
        return
    from gcd_dataset.generator.drape.device import cores, device_names

    with _appended(user_path(path)) as write:
        last = logged = Progress(0, 0)
        begun = written = time.monotonic()
        gpus = device_names([device for device in devices if device != "cpu"])
        machine = {"host": platform.node(), "pid": os.getpid(), "cores": cores(), "gpus": gpus}
        write("begin", {"options": options, "versions": versions(), "recipe": recipe_hash(recipe), "machine": machine})

        def report(progress: Progress) -> None:
            nonlocal last, logged, written
            last, now = progress, time.monotonic()
            if progress.made - logged.made >= EVERY or (now - written >= EVERY_S and progress.made):
                logged, written = progress, now
                write("progress", _figures(progress))
            on_progress(progress)

        def end(event: str, **more: str) -> None:
            write(event, {**_figures(last), "seconds": round(time.monotonic() - begun, 3), **more})

        try:
            yield report
        except KeyboardInterrupt:
            end("stopped")
            raise
        except BaseException as error:
            end("failed", error=" ".join(str(error).split()) or type(error).__name__)
            raise
        end("end")


def _figures(progress: Progress) -> dict[str, Any]:
    return {
        "count": progress.count,
        "there": progress.existing,
        "made": progress.made,
        "rate": None if progress.rate is None else round(progress.rate, 4),
        "left_s": None if progress.left_s is None else round(progress.left_s, 1),
        "outcomes": dict(progress.outcomes.most_common()),
        "rejects": dict(progress.rejects.most_common()),
        "rss_mb": round(_resident() / 1e6, 1),
    }


def _resident() -> float:
    """Resident memory of this process [bytes]; its peak on systems without ``/proc``."""
    try:
        return int(Path("/proc/self/statm").read_text().split()[1]) * resource.getpagesize()
    except (OSError, ValueError, IndexError):
        peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
        return peak if sys.platform == "darwin" else peak * 1024


# ------------------------------------------------------------------------------------------------------------ the file


@contextlib.contextmanager
def _appended(path: Path) -> Iterator[Callable[[str, Mapping[str, Any]], None]]:
    """The function that appends a line to a log file: its event and its other keys. Raises ``OutputError``."""
    make_folder(path.parent)
    with contextlib.ExitStack() as opened:
        with writing_to(path):
            # With O_NONBLOCK, opening a pipe without a reader fails instead of blocking.
            file = os.open(path, os.O_WRONLY | os.O_APPEND | os.O_CREAT | os.O_NONBLOCK | os.O_CLOEXEC, 0o644)
            opened.callback(os.close, file)
            _drop_partial_line(file, path)
        failed = False

        def write(event: str, entry: Mapping[str, Any]) -> None:
            nonlocal failed
            now = datetime.now(UTC).isoformat(timespec="milliseconds")
            try:
                _append(file, (json.dumps({"event": event, "time": now, **entry}, default=str) + "\n").encode())
            except OSError as error:
                if not failed:
                    logger.warning("%s: cannot be written (%s): the run goes on without its log", path, error.strerror)
                failed = True

        yield write


def _drop_partial_line(file: int, path: Path) -> None:
    """Truncate a partial last line, left by a power cut. Raises ``OutputError`` for a file that is not a log."""
    status = os.fstat(file)
    if not stat.S_ISREG(status.st_mode):
        return
    with path.open("rb") as content:
        content.seek(max(status.st_size - TAIL, 0))
        before, _, partial = content.read().rpartition(b"\n")
    last = before.rpartition(b"\n")[2]
    is_foreign = last and not last.startswith(BEGIN)
    if is_foreign or (partial and not (partial.startswith(BEGIN) or BEGIN.startswith(partial))):
        raise OutputError(f"{path}: its last line is not a line of a run log: choose another file")
    os.ftruncate(file, status.st_size - len(partial))


def _append(file: int, line: bytes) -> None:
    """Append a whole line, or nothing. Raises ``OSError``."""
    written = os.write(file, line)
    if written == len(line):
        return
    end = os.lseek(file, 0, os.SEEK_CUR)
    if os.fstat(file).st_size == end:  # no other process has appended meanwhile
        os.ftruncate(file, end - written)
    raise OSError(0, "no room for a whole line")
