"""Converting the published GarmentCodeData to shards."""

import functools
from collections.abc import Iterator, Sequence
from functools import partial
from itertools import chain, groupby
from pathlib import Path
from typing import NamedTuple

from gcd_dataset.errors import PatternError, ShardError
from gcd_dataset.loaders.published import PublishedGarmentCodeData
from gcd_dataset.making.progress import Progress, ProgressCallback, ignore_progress
from gcd_dataset.making.run import Made, Wanted, make_shards, place_for, run
from gcd_dataset.making.tasks import Work
from gcd_dataset.release.batch_index import PublishedBatches
from gcd_dataset.release.garment_list import PublishedGarments
from gcd_dataset.release.published_names import SPLIT_NAMES
from gcd_dataset.shards import encode_sample
from gcd_dataset.shards.layout import GARMENTS
from gcd_dataset.shards.manifest import Plan
from gcd_dataset.shards.notes import note_name, read_note, shards_named
from gcd_dataset.workers import parallel_map_chunks

__all__ = ["convert"]

CHUNK = 8  # garments per task of a worker: a second of work, 12 MB of results
SEED = 0  # published garments have no seed


class _Source(NamedTuple):
    """One split of a published data set."""

    root: Path
    split: str
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
    After further batches are downloaded, a repeated call adds their garments. Raises ``ShardError`` for a folder that
    is not in the published layout or has no garment of any split, ``ConfigError`` if ``out`` holds another data set,
    ``OutputError`` if it cannot be written.
    """
    _batches.cache_clear()  # further batches may have been downloaded
    _dataset.cache_clear()
    cache = None if cache_dir is None else Path(cache_dir)
    sources = {split: _Source(Path(root), split, bodies, cache) for split in SPLIT_NAMES}
    garments = {
        split: PublishedGarments(_batches(root_, body, folder), split)
        for root_, split, body, folder in sources.values()
    }
    positions = {
        split: {entry.index: k for k, entry in enumerate(found.entries)}
        for split, found in garments.items()
        if len(found)
    }
    if not positions:
        next(iter(garments.values())).require_any()
    origin = _dataset(sources[next(iter(positions))]).origin
    plan = Plan(GARMENTS.kind, SEED, origin, sum(map(len, positions.values())), 1)
    work = Work(place_for(out), plan, {split: sorted(numbers) for split, numbers in positions.items()})

    def make(wanted: Wanted) -> Iterator[Made]:
        runs = []
        for split, tasks in groupby(wanted, key=lambda entry: entry[0].split):
            of_split = [positions[split][index] for _, left in tasks for index in left]
            runs.append(parallel_map_chunks(partial(_convert, sources[split]), of_split, workers, chunk=CHUNK))
        return chain.from_iterable(runs)

    _retry_skipped(work)
    return run(work, partial(make_shards, maker=make), on_progress=on_progress)


def _retry_skipped(work: Work) -> None:
    """Remove the shards that lack garments, so that they are made again."""
    names = work.place.names()
    for split, number in shards_named(names):
        if note_name(split, number) in names and (note := read_note(work.place, split, number)).skipped:
            note.plan.require_same(work.plan, work.place.location(note_name(split, number)))
            work.place.remove(note.record.name(split))


@functools.lru_cache(maxsize=1)
def _batches(root: Path, bodies: str, cache_dir: Path | None) -> PublishedBatches:
    """The published batches; cached, since each worker process needs them once."""
    return PublishedBatches(root, bodies=bodies, cache_dir=cache_dir)


@functools.lru_cache(maxsize=len(SPLIT_NAMES))
def _dataset(source: _Source) -> PublishedGarmentCodeData:
    """A published split; cached, since each worker process needs it once."""
    return PublishedGarmentCodeData(_batches(source.root, source.bodies, source.cache_dir), source.split)


def _convert(source: _Source, positions: Sequence[int]) -> list[Made]:
    return [_convert_one(_dataset(source), position) for position in positions]


def _convert_one(published: PublishedGarmentCodeData, position: int) -> Made:
    index = published.number(position)
    try:
        return Made(index, encode_sample(published.sample(position)))
    except (ShardError, PatternError) as error:
        return Made(index, None, f"{published.name(position)}: {error}")
