"""Libraries beside our own locks: CPU time, behaviour after a kill, verdict.

The median of five rounds: ``alone``: CPU time of taking and releasing a lock. ``wait``: the longest wait while two
processes take turns of 2 ms. ``freed``: from the kill of the holder to the acquisition by a waiter. ``left``: files
left in the folder.
"""

import argparse
from collections.abc import Iterator, Mapping
from importlib.metadata import version
from typing import Any

from benchmarks.cases.figures import Figure, Measured
from benchmarks.libraries.locks import LOCKS, lock_cost

UNITS = {"alone": "µs", "wait": "ms", "freed": "ms", "left": "files"}
VERDICTS: Mapping[str, str] = {
    "shards.access": "kept: the kernel wakes a waiter, and no lock file stays in a published folder",
    "filelock": "no: waiters poll every 50 ms and starve, and the lock file stays",
}
DECIDED: tuple[Mapping[str, str], ...] = (
    {
        "piece": "cache of a server",
        "by": "fsspec filecache, blockcache; diskcache",
        "figures": "no hash, no limit, twice the requests; diskcache: peak 1.7 times its limit",
        "verdict": "no: whole shards, verified and evicted by shard (hub.fetch, shards.cache)",
    },
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
    """Measure locks; add a row for each earlier decision, with the figures recorded then."""
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
    for name, lock in LOCKS.items():
        yield "lock of a writer", name, lock_cost(lock)._asdict()
