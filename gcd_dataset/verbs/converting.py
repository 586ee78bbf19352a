"""The published GarmentCodeData into shards of ours, going on where an earlier run was stopped."""

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
from gcd_dataset.shards.job_parts import require_merged
from gcd_dataset.shards.unfinished import filling
from gcd_dataset.verbs.making_plan import MakingPlan
from gcd_dataset.verbs.progress import Progress, Told, unheard
from gcd_dataset.workers import parallel_map_chunks

__all__ = ["ConvertPlan", "Converted", "convert", "converted", "plan_convert"]

CHUNK = 8  # garments a task: a second of work, 12 MB to be sent back
SEED = 0  # of what nobody drew here


@dataclass(frozen=True)
class Source:
    """One split of a published data set."""

    root: Path
    split: str
    bodies: str
    cache_dir: Path | None


@dataclass(frozen=True)
class ConvertPlan(MakingPlan):
    """Garments to be converted; those missing by their positions among the published ones."""

    out: Path
    source: Source


@dataclass(frozen=True)
class Converted:
    """One garment: its members, or why it has none."""

    index: int
    members: dict[str, bytes]
    fault: str = ""


def plan_convert(
    root: Path | str, out: Path | str, *, bodies: str = "both", cache_dir: Path | str | None = None
) -> tuple[ConvertPlan, ...]:
    """What it takes to have the published garments in ``out``, for each split of which there is any.

    Garments keep their numbers whatever else is on disk, so that batches downloaded later, or the other bodies, are
    added to the same shards. Raises ``ShardError`` for a folder that is not of the published layout or holds nothing of
    any split, ``ConfigError`` where ``out`` holds another data set, ``OutputError`` where it cannot be written.
    """
    require_merged(user_path(out), ConfigError)
    cache = None if cache_dir is None else Path(cache_dir)
    sources = [Source(Path(root), split, bodies, cache) for split in SPLIT_NAMES]
    _batches.cache_clear()  # more may have been downloaded since
    _dataset.cache_clear()
    there = [source for source in sources if len(_listed(source))]
    if not there:
        _listed(sources[0]).require_any()
    return tuple(_plan(source, Path(out)) for source in there)


def convert(
    root: Path | str,
    out: Path | str,
    *,
    bodies: str = "both",
    cache_dir: Path | str | None = None,
    workers: int = 0,
    told: Told = unheard,
) -> tuple[Progress, ...]:
    """Have the published garments under ``root`` in shards in the folder ``out``; for each split how far it has come.

    ``told`` is called with the same; garments that cannot be read are left out, with the reason. Stopped and called
    again it goes on. Raises as ``plan_convert`` and ``converted`` do.
    """
    done = []
    for plan in plan_convert(root, out, bodies=bodies, cache_dir=cache_dir):
        progress = Progress(plan.count, plan.there, split=plan.source.split)
        told(progress)
        for garment in converted(plan, workers=workers):
            progress = progress.without_sample(garment.fault) if garment.fault else progress.with_sample()
            told(progress)
        done.append(progress)
    return tuple(done)


def converted(plan: ConvertPlan, *, workers: int = 0) -> Generator[Converted, None, None]:
    """Convert and store what is missing, yielding each garment as it is stored; those with a fault are left out.

    All that was stored is read back in the end. Stopped at any moment and planned again it goes on; the shards come out
    as the same bytes, for any ``workers``. Raises ``OutputError`` where shards cannot be written, ``ShardError`` where
    they do not read as they were written, ``GcdError`` where a process is killed.
    """
    stored = set()
    with filling(plan.out, plan.count, plan.source.split), _writer(plan.source, plan.out) as writer:
        for garment in _converted(plan, workers):
            if not garment.fault:
                writer.add(garment.index, garment.members)
                stored.add(garment.index)
            yield garment
    if stored:
        reader = ShardReader(plan.out, plan.source.split)
        for position in range(len(reader)):
            if reader.number(position) in stored:
                reader.check(position)


def _listed(source: Source) -> PublishedGarments:
    return PublishedGarments(_batches(source.root, source.bodies, source.cache_dir), source.split)


def _plan(source: Source, out: Path) -> ConvertPlan:
    with _writer(source, out) as writer:
        done = writer.done
    published = _dataset(source)
    missing = tuple(position for position in range(len(published)) if published.number(position) not in done)
    return ConvertPlan(len(published), missing, out, source)


def _writer(source: Source, out: Path) -> ShardWriter:
    return ShardWriter(out, split=source.split, seed=SEED, recipe=_dataset(source).origin)


@functools.lru_cache(maxsize=1)
def _batches(root: Path, bodies: str, cache_dir: Path | None) -> PublishedBatches:
    """The batches, opened once a process."""
    return PublishedBatches(root, bodies=bodies, cache_dir=cache_dir)


@functools.lru_cache(maxsize=len(SPLIT_NAMES))
def _dataset(source: Source) -> PublishedGarmentCodeData:
    """A split, listed once a process."""
    return PublishedGarmentCodeData(_batches(source.root, source.bodies, source.cache_dir), source.split)


def _converted(plan: ConvertPlan, workers: int) -> Iterator[Converted]:
    return parallel_map_chunks(functools.partial(_convert, plan.source), plan.missing, workers, chunk=CHUNK)


def _convert(source: Source, positions: Sequence[int]) -> list[Converted]:
    return [_convert_one(_dataset(source), position) for position in positions]


def _convert_one(published: PublishedGarmentCodeData, position: int) -> Converted:
    index = published.number(position)
    try:
        return Converted(index, encode_sample(published.sample(position)))
    except (ShardError, PatternError) as error:
        return Converted(index, {}, f"{published.name(position)}: {error}")
