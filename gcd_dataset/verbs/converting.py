"""Converting the published GarmentCodeData to shards, with resumption of a stopped run."""

import functools
from collections.abc import Generator, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from gcd_dataset.errors import ConfigError, PatternError, ShardError
from gcd_dataset.files import user_path
from gcd_dataset.loaders.published import PublishedGarmentCodeData
from gcd_dataset.release.batch_index import PublishedBatches
from gcd_dataset.release.garment_list import PublishedGarments
from gcd_dataset.release.published_names import SPLIT_NAMES
from gcd_dataset.shards import ShardReader, ShardWriter, encode_sample
from gcd_dataset.shards.contents import warn_of_others
from gcd_dataset.shards.job_parts import require_merged
from gcd_dataset.shards.unfinished import filling
from gcd_dataset.verbs.making_plan import MakingPlan
from gcd_dataset.verbs.progress import Progress, ProgressCallback, ignore_progress
from gcd_dataset.workers import parallel_map_chunks

__all__ = ["ConversionPlan", "ConvertedGarment", "convert", "convert_missing", "plan_conversion"]

CHUNK = 8  # garments per task: a second of work, 12 MB of results
SEED = 0  # published garments have no seed


@dataclass(frozen=True)
class Source:
    """One split of a published data set."""

    root: Path
    split: str
    bodies: str
    cache_dir: Path | None


@dataclass(frozen=True)
class ConversionPlan(MakingPlan):
    """The garments of one split to convert; ``missing`` holds their positions in the published split."""

    out: Path
    source: Source


@dataclass(frozen=True)
class ConvertedGarment:
    """One garment: its members, or the fault for which it was skipped."""

    index: int
    members: dict[str, bytes]
    fault: str = ""
    """Empty for a garment that was converted."""


def plan_conversion(
    root: Path | str, out: Path | str, *, bodies: str = "both", cache_dir: Path | str | None = None
) -> tuple[ConversionPlan, ...]:
    """Plan the conversion of the published garments under ``root`` to shards in ``out``, one plan for each split.

    A garment's number does not depend on the other garments on disk, so a later call adds batches downloaded since, or
    garments on the other bodies, to the same shards. Raises ``ShardError`` for a folder that is not in the published
    layout or has no garment of any split, ``ConfigError`` if ``out`` holds another data set, ``OutputError`` if it
    cannot be written.
    """
    require_merged(user_path(out), ConfigError)
    cache = None if cache_dir is None else Path(cache_dir)
    sources = [Source(Path(root), split, bodies, cache) for split in SPLIT_NAMES]
    _batches.cache_clear()  # further batches may have been downloaded
    _dataset.cache_clear()
    present = [source for source in sources if len(_garments(source))]
    if not present:
        _garments(sources[0]).require_any()
    warn_of_others(user_path(out))
    return tuple(_plan(source, Path(out)) for source in present)


def convert(
    root: Path | str,
    out: Path | str,
    *,
    bodies: str = "both",
    cache_dir: Path | str | None = None,
    workers: int = 0,
    on_progress: ProgressCallback = ignore_progress,
) -> tuple[Progress, ...]:
    """Convert the published garments under ``root`` to shards in the folder ``out``; returns each split's progress.

    Garments that cannot be read are skipped, with the reason in ``Progress.skipped``. A stopped call can be repeated:
    garments that ``out`` already holds are not converted again. Raises as ``plan_conversion`` and ``convert_missing``
    do.
    """
    done = []
    for plan in plan_conversion(root, out, bodies=bodies, cache_dir=cache_dir):
        progress = Progress(plan.count, plan.existing, split=plan.source.split)
        on_progress(progress)
        for garment in convert_missing(plan, workers=workers):
            progress = progress.with_skipped(garment.fault) if garment.fault else progress.with_sample()
            on_progress(progress)
        done.append(progress)
    return tuple(done)


def convert_missing(plan: ConversionPlan, *, workers: int = 0) -> Generator[ConvertedGarment, None, None]:
    """Convert and store the missing garments, yielding each one after it is stored; garments with a fault are skipped.

    At the end all stored garments are read back. The bytes of the shards depend neither on ``workers`` nor on
    interruptions. Raises ``OutputError`` if the shards cannot be written, ``ShardError`` if a stored garment reads back
    differently, ``GcdError`` if a worker is killed.
    """
    stored = set()
    with filling(plan.out, plan.count, plan.source.split), _writer(plan.source, plan.out) as writer:
        for garment in _convert_all(plan, workers):
            if not garment.fault:
                writer.add(garment.index, garment.members)
                stored.add(garment.index)
            yield garment
    if stored:
        reader = ShardReader(plan.out, plan.source.split)
        for position in range(len(reader)):
            if reader.number(position) in stored:
                reader.check(position)


def _garments(source: Source) -> PublishedGarments:
    return PublishedGarments(_batches(source.root, source.bodies, source.cache_dir), source.split)


def _plan(source: Source, out: Path) -> ConversionPlan:
    with _writer(source, out) as writer:
        done = writer.done
    published = _dataset(source)
    missing = tuple(position for position in range(len(published)) if published.number(position) not in done)
    return ConversionPlan(len(published), missing, out, source)


def _writer(source: Source, out: Path) -> ShardWriter:
    return ShardWriter(out, split=source.split, seed=SEED, recipe=_dataset(source).origin)


@functools.lru_cache(maxsize=1)
def _batches(root: Path, bodies: str, cache_dir: Path | None) -> PublishedBatches:
    """The published batches; cached, since each worker process needs them once."""
    return PublishedBatches(root, bodies=bodies, cache_dir=cache_dir)


@functools.lru_cache(maxsize=len(SPLIT_NAMES))
def _dataset(source: Source) -> PublishedGarmentCodeData:
    """A published split; cached, since each worker process needs it once."""
    return PublishedGarmentCodeData(_batches(source.root, source.bodies, source.cache_dir), source.split)


def _convert_all(plan: ConversionPlan, workers: int) -> Iterator[ConvertedGarment]:
    return parallel_map_chunks(functools.partial(_convert, plan.source), plan.missing, workers, chunk=CHUNK)


def _convert(source: Source, positions: Sequence[int]) -> list[ConvertedGarment]:
    return [_convert_one(_dataset(source), position) for position in positions]


def _convert_one(published: PublishedGarmentCodeData, position: int) -> ConvertedGarment:
    index = published.number(position)
    try:
        return ConvertedGarment(index, encode_sample(published.sample(position)))
    except (ShardError, PatternError) as error:
        return ConvertedGarment(index, {}, f"{published.name(position)}: {error}")
