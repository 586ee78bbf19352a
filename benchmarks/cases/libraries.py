"""Libraries beside our own caches and locks: CPU time, bytes, limits, behaviour after a kill, verdict.

Caches: six shards of 64 samples; a sample has ten members, of which three are read, 28 % of the bytes. ``hit`` and
``miss``: CPU time of a member with one process. ``sent``: ratio of bytes fetched to bytes requested. ``again``: that
ratio for a process that reads after two others have filled the cache together. ``wrong``: samples that differ from the
server's, or raise an error. ``peak``: ratio of bytes on disk, in blocks of 4 KiB, to the cache's limit, a quarter of
the bytes read; ``killed``: that ratio after eight readers were killed (SIGKILL).

Locks, the median of five rounds: ``alone``: CPU time of taking and releasing a lock. ``wait``: the longest wait while
two processes take turns of 2 ms. ``freed``: from the kill of the holder to the acquisition by a waiter. ``left``: files
left in the folder.
"""

import argparse
import tempfile
from collections.abc import Iterator, Mapping
from importlib.metadata import version
from pathlib import Path
from typing import Any

from benchmarks.cases.figures import Figure, Measured
from benchmarks.libraries.caches import CACHES, write_shards
from benchmarks.libraries.locks import LOCKS, lock_cost
from benchmarks.libraries.trials import cost, killed, limited, shared

__all__ = ["add_arguments", "run"]

UNITS = {
    "hit": "µs", "miss": "µs", "sent": "of asked", "wrong": "samples", "again": "of asked", "peak": "of the limit",
    "killed": "of the limit", "alone": "µs", "wait": "ms", "freed": "ms", "left": "files",
}  # fmt: skip
VERDICTS: Mapping[str, str] = {
    "hub.cache": "kept: a quarter of diskcache's CPU time for a hit, two thirds for a miss; fetches only what is "
    "requested; peak 1.1 times its limit",
    "diskcache": "no: four times the CPU time for a hit, 1.5 times for a miss; peak 1.7 times its limit",
    "fsspec blockcache": "no: no limit, and blocks of 5 MiB eventually fetch the whole shard",
    "fsspec blockcache 64 KiB": "no: no limit, and every close rewrites the whole list of blocks",
    "fsspec filecache": "no: no limit, whole shards, and fetching a shard truncates the file under another reader",
    "shards.access": "kept: the kernel wakes a waiter, and no lock file stays in a published folder",
    "filelock": "no: waiters poll every 50 ms and starve, and the lock file stays",
}
DECIDED: tuple[Mapping[str, str], ...] = (
    {
        "piece": "the card's YAML",
        "by": "huggingface_hub.DatasetCardData",
        "figures": "the same keys and values",
        "verdict": "adopted: the Hub's own library writes the format that the Hub reads",
    },
    {
        "piece": "Croissant",
        "by": "mlcroissant (tests/extras/test_croissant.py)",
        "figures": "metadata valid before and after; reading the records raised IsADirectoryError before, "
        "yields all files after",
        "verdict": "adopted in a test: it found two properties missing from the context, and that the pattern `*` "
        "matched a folder",
    },
    {
        "piece": "nearest point of a triangle",
        "by": "trimesh.triangles.closest_point",
        "figures": "80 000 pairs: 24.5 ms of CPU time, our function 30.2 ms; results equal to 3e-14 cm",
        "verdict": "adopted; our function removed",
    },
    {
        "piece": "nearest point of a mesh",
        "by": "trimesh.proximity.closest_point (needs rtree)",
        "figures": "10 000 points: 940 ms of CPU time, body/surface.py 70 ms; distances differ by 3e-5 cm "
        "on average, by 0.11 cm at most",
        "verdict": "no: 13 times the CPU time",
    },
)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The case has no options."""


def run(options: argparse.Namespace) -> Measured:
    """Measure locks and caches; add a row for each earlier decision, with the figures recorded then."""
    figures, rows = [], []
    for piece, name, measured in _measured():
        slug = name.replace(" ", "_")
        figures += [Figure(f"{slug}.{metric}", value, UNITS[metric]) for metric, value in measured.items()]
        summary = ", ".join(f"{metric} {value:.3g} {UNITS[metric]}" for metric, value in measured.items())
        rows.append({"piece": piece, "by": _versioned(name), "figures": summary, "verdict": VERDICTS[name]})
    return Measured(figures, [*rows, *DECIDED])


def _versioned(name: str) -> str:
    """The name of a library with its version; the name of a module of ours unchanged."""
    package, _, part = name.partition(" ")
    return name if "." in package else " ".join([package, version(package), part]).rstrip()


def _measured() -> Iterator[tuple[str, str, dict[str, Any]]]:
    """Piece, library and figures, in the order of the report."""
    for name, lock in LOCKS.items():  # before the caches, whose pending disk writes would delay the locks
        yield "lock of a writer", name, lock_cost(lock)._asdict()
    with tempfile.TemporaryDirectory() as folder:
        served = write_shards(Path(folder))
        for name, make in CACHES.items():
            alone, together = cost(make, served), shared(make, served)
            peak, left = limited(make, served), killed(make, served)
            figures = {**alone._asdict(), "wrong": together.wrong + left.wrong, "again": together.again}
            yield "cache of a server", name, figures | {"peak": peak, "killed": left.left}
