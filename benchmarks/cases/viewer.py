"""The viewer of a large data set: time to the first picture, to the next garment, and to a filter's answer.

The set holds ``--count`` small garments of five kinds and, in its middle, 32 garments of 14 500 vertices on a body,
which are shown. Each round starts ``gcd show SET --index`` anew; the cheapest of three rounds counts. ``first_page``:
from the command to the last byte of the first garment's page. ``first_picture``: to the drawn garment in headless
Chromium, which runs and has drawn before (software rendering; left out where Playwright or Chromium is missing).
``next``: the median of requests for the following garment, 0.3 s apart. ``next_picture``: in the browser, 2 s apart; it
has drawn the garment unseen by then; ``hurried``: 0.3 s apart. ``jump``: the median of requests for garments that were
not made ahead. ``reading``: the same while tags are read in the background, which begins after the first page; a second
start takes them from the cache. ``filter``: garments of a kind and an outcome. ``load``: processes that want to run,
per core, during a round, ours included; times grow with it, CPU times hardly. In the browser most of the time is the
start of the software renderer for each page: the page's own scripts take 0.07 CPU-s.
"""

import argparse
import os
import tempfile
from collections.abc import Iterable, Mapping
from pathlib import Path

from benchmarks.cases.figures import Figure, Measured
from benchmarks.viewing.browser import Pictures, pictures_of
from benchmarks.viewing.server import shown
from benchmarks.viewing.workload import FULL, full_range, write_set
from gcd_dataset.errors import ConfigError

ROUNDS = 3
NEXT, JUMPS = 12, 6  # garments after the first; garments jumped to, not adjacent, so that none is made ahead


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--count", type=int, default=100_000, help="garments of the set; 25 kB each")
    parser.add_argument("--folder", type=Path, help="folder that keeps the set; by default temporary")


def run(options: argparse.Namespace) -> Measured:
    """Write the set, then time the viewer. Raises ``ConfigError`` for a count that is too small."""
    if options.count < 4 * FULL:
        raise ConfigError(f"--count {options.count}: give {4 * FULL} or more")
    with tempfile.TemporaryDirectory() as own:
        folder = write_set(options.folder or Path(own) / "set", options.count)
        rounds = [_round(folder, options.count, Path(own) / f"home{number}") for number in range(ROUNDS)]
    best = {name: min(found[name] for found in rounds) for name in rounds[0]}
    rows = [{"figure": name, **{f"round {i}": found[name] for i, found in enumerate(rounds, 1)}} for name in best]
    return Measured(_figures(best, options.count), rows)


def _round(folder: Path, count: int, home: Path) -> dict[str, float]:
    """The times of one start without cached tags, one with them, and one in the browser; seconds."""
    first = full_range(count).start
    environment = {**os.environ, "HOME": str(home)}
    times: dict[str, float] = {}
    with shown(folder, first, environment) as site:
        times["first_page"], times["first_page_cpu"] = site.since_start, site.cpu_since_start
        times["jump_reading"] = _median(site.timed_jump(position).wall for position in _jumps(count))
        times["next_reading"] = _median(site.timed_next().wall for _ in range(NEXT))
        times["tags"] = site.wait_for_tags()
        times["peak_memory"] = site.peak_memory
    with shown(folder, first, environment) as site:
        times["first_page_again"] = site.since_start
        times["tags_again"] = site.wait_for_tags()
        times["next"] = _median(site.timed_next().wall for _ in range(NEXT))
        jumps = [site.timed_jump(position) for position in _jumps(count)]
        times["jump"], times["jump_cpu"] = (_median(column) for column in zip(*jumps, strict=True))
        times["filter"] = _median(site.timed_filter(rank) for rank in range(NEXT))
    pictures: Pictures | None = pictures_of(folder, first, environment, NEXT)
    if pictures is not None:
        times["first_picture"], times["next_picture"] = pictures.first, _median(pictures.following)
        times["next_picture_hurried"] = _median(pictures.hurried)
    times["load"] = os.getloadavg()[0] / (os.cpu_count() or 1)
    return times


def _jumps(count: int) -> Iterable[int]:
    """Full garments that have not been made, nor made ahead."""
    return full_range(count)[NEXT + 2 :: 3][:JUMPS]


def _median(times: Iterable[float]) -> float:
    ordered = sorted(times)
    return ordered[len(ordered) // 2]


def _figures(best: Mapping[str, float], count: int) -> list[Figure]:
    seconds = [
        ("first_page", f"s from the command to the page of the first garment, of {count:,}"),
        ("first_page_cpu", "CPU-s of the server until then"),
        ("first_page_again", "s, with tags in the cache"),
        ("first_picture", "s from the command to the drawn garment in Chromium"),
        ("tags", "s from the first page until all tags are read"),
        ("tags_again", "s, with tags in the cache"),
    ]
    milliseconds = [
        ("next", "ms to the page of the next garment"),
        ("next_reading", "ms, while tags are read"),
        ("next_picture", "ms to the next garment drawn in Chromium, after a look of 2 s"),
        ("next_picture_hurried", "ms, after 0.3 s"),
        ("jump", "ms to the page of any garment"),
        ("jump_cpu", "CPU-ms of the server for it"),
        ("jump_reading", "ms, while tags are read"),
        ("filter", "ms to the answer of a filter by kind and outcome"),
    ]
    figures: list[Figure] = []
    figures += [Figure(f"{name}_s", best[name], unit) for name, unit in seconds if name in best]
    figures += [Figure(f"{name}_ms", 1e3 * best[name], unit) for name, unit in milliseconds if name in best]
    others = [
        Figure("peak_memory_mb", best["peak_memory"], "MB of the server"),
        Figure("load", best["load"], "processes that want to run, per core"),
    ]
    return [*figures, *others]
