"""Converting the published GarmentCodeData to shards."""

import functools
from collections.abc import Iterator, Mapping, Sequence
from functools import partial
from itertools import chain, groupby
from pathlib import Path
from typing import NamedTuple

from gcd_dataset.errors import PatternError, ShardError
from gcd_dataset.loaders.published import PublishedGarmentCodeData
from gcd_dataset.making.progress import Progress, ProgressCallback, ignore_progress
from gcd_dataset.making.run import Made, Wanted, run
from gcd_dataset.making.store import place_for
from gcd_dataset.making.tasks import Work
from gcd_dataset.release.batches import PublishedBatches
from gcd_dataset.release.garment_list import PublishedGarments
from gcd_dataset.release.published_names import SPLIT_NAMES
from gcd_dataset.shards import encode_sample
from gcd_dataset.shards.layout import GARMENTS
from gcd_dataset.shards.manifest import Plan
from gcd_dataset.shards.notes import note_name, read_note, shards_named
from gcd_dataset.workers import parallel_map_chunks

CHUNK = 8  # garments per task of a worker: a second of work, 12 MB of results
SEED = 0  # published garments have no seed


class _Source(NamedTuple):
    """A published data set."""

    root: Path
    bodies: str
    cache_dir: Path | None


def convert(
    root: Path | str,
    out: Path | str,
    *,
    bodies: str = "both",
    cache_dir: Path | str | None = None,
    workers: int = 0,
    on_progress: ProgressCallback = ignore_progress,
) -> Progress:
    """Convert the published garments under ``root`` to shards in ``out``; with their official splits.

    Garments that cannot be read are skipped, with the reason in ``Progress.skipped``; a repeated call tries them again.
    Raises ``ShardError`` for a folder that is not in the published layout or has no garment of any split,
    ``ConfigError`` if ``out`` holds another data set, ``OutputError`` if it cannot be written.
    """
    _batches.cache_clear()  # further batches may have been downloaded
    _dataset.cache_clear()
    source = _Source(Path(root), bodies, None if cache_dir is None else Path(cache_dir))
    garments = [PublishedGarments(_batches(source), split) for split in SPLIT_NAMES]
    if not any(map(len, garments)):
        garments[0].require_any()
    positions = {
        found.split: {entry.index: position for position, entry in enumerate(found.entries)}
        for found in garments
        if len(found)
    }
    origin = _dataset(source, next(iter(positions))).origin
    plan = Plan(GARMENTS.kind, SEED, origin, sum(map(len, positions.values())), 1)
    work = Work(place_for(out), plan, {split: sorted(numbers) for split, numbers in positions.items()})
    _retry_skipped(work)
    return run(work, partial(_make, source, positions, workers), on_progress=on_progress)


def _retry_skipped(work: Work) -> None:
    """Remove the shards that lack garments, so that they are made again."""
    names = work.place.names()
    for split, number in shards_named(names):
        if note_name(split, number) in names and (note := read_note(work.place, split, number)).skipped:
            note.plan.require_same(work.plan, work.place.location(note_name(split, number)))
            work.place.remove(note.record.name(split))


def _make(source: _Source, positions: Mapping[str, Mapping[int, int]], workers: int, wanted: Wanted) -> Iterator[Made]:
    runs = []
    for split, tasks in groupby(wanted, key=lambda entry: entry[0].split):
        of_split = [positions[split][index] for _, left in tasks for index in left]
        runs.append(parallel_map_chunks(partial(_convert, source, split), of_split, workers, chunk=CHUNK))
    return chain.from_iterable(runs)


@functools.lru_cache(maxsize=1)
def _batches(source: _Source) -> PublishedBatches:
    """The published batches; cached, since each worker process needs them once."""
    return PublishedBatches(source.root, bodies=source.bodies, cache_dir=source.cache_dir)


@functools.lru_cache(maxsize=len(SPLIT_NAMES))
def _dataset(source: _Source, split: str) -> PublishedGarmentCodeData:
    """A published split; cached, since each worker process needs it once."""
    return PublishedGarmentCodeData(_batches(source), split)


def _convert(source: _Source, split: str, positions: Sequence[int]) -> list[Made]:
    published, made = _dataset(source, split), []
    for position in positions:
        index = published.number(position)
        try:
            made.append(Made(index, encode_sample(published.sample(position))))
        except (ShardError, PatternError) as error:
            made.append(Made(index, None, f"{published.name(position)}: {error}"))
    return made
