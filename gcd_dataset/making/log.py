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
import sys
import time
from collections.abc import Iterator, Mapping, Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from gcd_dataset.files import make_folder, user_path, writing_to
from gcd_dataset.generator.recipe import versions
from gcd_dataset.making.progress import Progress, ProgressCallback
from gcd_dataset.shards.layout import recipe_hash

EVERY = 100  # samples between two progress lines …
EVERY_S = 10.0  # … or seconds

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

    Without ``path`` it yields ``on_progress``. Each line is one write, so that runs may share a log. Raises
    ``OutputError`` for a file that cannot be opened; if a write fails, one warning is logged and the run continues.
    """
    if path is None:
        yield on_progress
        return
    from gcd_dataset.generator.device import cores, device_names

    path = user_path(path)
    make_folder(path.parent)
    with writing_to(path):
        opened = path.open("ab", buffering=0)
    with opened as file:
        is_whole = True

        def write(event: str, entry: Mapping[str, Any]) -> None:
            nonlocal is_whole
            now = datetime.now(UTC).isoformat(timespec="milliseconds")
            line = (json.dumps({"event": event, "time": now, **entry}, default=str) + "\n").encode()
            try:
                if is_whole and file.write(line) < len(line):
                    raise OSError(0, "no room for a whole line")
            except OSError as error:
                is_whole = False
                logger.warning("%s: cannot be written (%s): the run goes on without its log", path, error.strerror)

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
