"""The parts of a data set joined: whole shards are renamed, those at the border of parts are copied together."""

import shutil
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from gcd_dataset.errors import ConfigError, GcdError, ShardError
from gcd_dataset.files import user_path, write_whole
from gcd_dataset.shards.access import locked, reading, writing
from gcd_dataset.shards.contents import splits_in
from gcd_dataset.shards.growing import GrowingShard, shard_record, sync_folder
from gcd_dataset.shards.index import ShardIndex, ShardTable, empty_table, read_stored_index, scan_shard, whole_samples
from gcd_dataset.shards.job_parts import (
    MERGED,
    PARTS,
    FinishedPart,
    PartsPlan,
    finished_path,
    has_plan,
    is_merging,
    merging_path,
    part_folder,
    parts_lock,
    read_finished,
    read_plan,
    require_version,
)
from gcd_dataset.shards.layout import GARMENTS, TRAIN, Layout, index_name, lock_name
from gcd_dataset.shards.manifest import Manifest, RecipeRecord, ShardRecord, SplitRecord, read_manifest
from gcd_dataset.shards.rejects import REJECTS, joined_rejects
from gcd_dataset.verbs.array_jobs import command_of
from gcd_dataset.verbs.progress import Progress, Told, unheard
from gcd_dataset.verbs.seal import seal

__all__ = ["merge"]

NAMED = 5  # parts that a message lists


@dataclass(frozen=True)
class _Source:
    """A shard of a part."""

    part: int
    path: Path
    record: ShardRecord
    layout: Layout
    table: ShardTable | None
    """Its contents by the index of its part, if that tells."""


def merge(out: Path | str, *, told: Told = unheard) -> dict[str, int]:
    """Join the parts that wait in ``out``; the number of samples of each split.

    It holds the shards, index, manifest and rejects of one run then, byte for byte, and nothing else.
    ``told`` is called with how many samples are in their place. Stopped at any moment and called again it goes on.
    Raises ``ShardError`` for a part that is missing, not finished or damaged, and a folder without parts;
    ``ConfigError`` for parts that do not belong together; ``OutputError`` where ``out`` cannot be written, or another
    merge is at work.
    """
    out = user_path(out)
    with reading(out):
        waiting, rest = (out / PARTS).is_dir(), (out / MERGED).is_dir()
    if not waiting and not rest:
        raise ShardError(f"{out}: no parts to be merged: {_way_out(out)}")
    with locked(out / lock_name(TRAIN), "merging its parts"):
        if waiting:
            _merge(out, told)
        _complete(out)
        manifest = read_manifest(out)
    return {} if manifest is None else manifest.counts


def _complete(out: Path) -> None:
    """Put the hash of the patterns of a data set that has a name into its manifest; remove what is left of the parts.

    In this order: a kill between the two leaves what it takes to go on.
    """
    if has_plan(out / MERGED) and (named := read_plan(out / MERGED).named) is not None:
        seal(out, named)
    _remove(out / MERGED)


def _merge(out: Path, told: Told) -> None:
    plan = read_plan(out / PARTS)
    require_version(out, plan)
    _begin(out)
    try:
        parts = _finished_parts(out, plan)
        sources = _sources(out, plan, parts)
    except GcdError:
        if not splits_in(out):  # nothing has been moved: parts may be made again
            _end(out)
        raise
    total = sum(record.record.count for found in sources.values() for record in found)
    progress = Progress(total, 0)
    told(progress)
    layouts = {split: found[0].layout for (split, _), found in sources.items()}
    records: dict[str, list[ShardRecord]] = {split: [] for split in {**dict.fromkeys(plan.splits), **layouts}}
    tables: dict[str, dict[str, ShardTable]] = {split: {} for split in records}
    for (split, name), found in sorted(sources.items()):
        record, table = _join(out / name, found)
        records[split].append(record)
        tables[split][name] = table
        progress = replace(progress, made=progress.made + record.count)
        told(progress)
    for split in records:
        ShardIndex.of(out, tables[split], layouts.get(split, GARMENTS)).write(out / index_name(split))
    _describe(out, plan, records)
    with parts_lock(out), writing(out / PARTS):
        _remove(out / MERGED)
        (out / PARTS).rename(out / MERGED)
        sync_folder(out)


# ------------------------------------------------------------------------------------------------------- what is there


def _begin(out: Path) -> None:
    """Keep parts from being made while they are merged. Raises ``ConfigError`` for a data set beside the parts."""
    with parts_lock(out):
        if is_merging(out):
            return
        if there := sorted(path.name for pattern in ("*.tar", "*.tar.part") for path in out.glob(pattern)):
            raise ConfigError(f"{out}: holds {there[0]}, which is of none of its parts: move it elsewhere, then merge")
        write_whole(merging_path(out), b"")


def _end(out: Path) -> None:
    with parts_lock(out), writing(merging_path(out)):
        merging_path(out).unlink()


def _finished_parts(out: Path, plan: PartsPlan) -> list[FinishedPart]:
    """What the parts have left, in their order. Raises ``ShardError`` where one is missing, or at work."""
    folders = [part_folder(out, part, plan.of) for part in range(plan.of)]
    with reading(out / PARTS):
        others = sorted({path.name for path in (out / PARTS).glob("*-of-*")} - {path.name for path in folders})
        missing = [part for part, folder in enumerate(folders) if not folder.is_dir()]
    if others:
        raise ConfigError(f"{out / PARTS / others[0]}: none of {plan.of} parts: move it elsewhere, then merge")
    _require_none(missing, "missing", out, plan)
    found = [_finished(folder, plan) for folder in folders]
    _require_none([part for part, finished in enumerate(found) if finished is None], "not finished", out, plan)
    parts = [finished for finished in found if finished is not None]
    for part, (finished, folder) in enumerate(zip(parts, folders, strict=True)):
        remedy = f"delete {folder} and run {command_of(out, plan, part)}"
        finished.require_of(plan, part, finished_path(folder), remedy)
        if others := sorted(finished.splits.keys() - plan.shard_sizes.keys()):
            raise ConfigError(f"{finished_path(folder)}: tells of split {others[0]}, as no other part: {remedy}")
    return parts


def _finished(folder: Path, plan: PartsPlan) -> FinishedPart | None:
    """What a part has left. Raises ``OutputError`` while it is made."""
    with locked(folder / lock_name(plan.splits[0]), "making this part"):
        return read_finished(folder)


def _require_none(parts: Sequence[int], what: str, out: Path, plan: PartsPlan) -> None:
    """Raise ``ShardError`` if parts are missing, or not finished."""
    if not parts:
        return
    names = ", ".join(f"{part}/{plan.of}" for part in parts[:NAMED])
    more = f" and {len(parts) - NAMED} more" if len(parts) > NAMED else ""
    verb = "is" if len(parts) == 1 else "are"
    raise ShardError(f"{out}: part {names}{more} {verb} {what}: run {command_of(out, plan, parts[0])}")


def _sources(out: Path, plan: PartsPlan, parts: Sequence[FinishedPart]) -> dict[tuple[str, str], list[_Source]]:
    """Split and name of each shard of the data set to the shards of parts that it is made of, in their order.

    Raises ``ShardError`` for one that is missing or damaged.
    """
    sources: dict[tuple[str, str], list[_Source]] = {}
    for part in parts:
        folder = part_folder(out, part.part, part.of)
        for split, records in part.splits.items():
            index = read_stored_index(folder, split, partial=True)
            layout, tables = (GARMENTS, {}) if index is None else (index.layout, index.tables())
            for record in records:
                source = _Source(part.part, folder / record.name, record, layout, tables.get(record.name))
                sources.setdefault((split, record.name), []).append(source)
    for (_, name), found in sources.items():
        for source in found if not (out / name).exists() else ():
            if (fault := _fault(source, is_shared=len(found) > 1)) is not None:
                again = command_of(out, plan, source.part)
                raise ShardError(f"{source.path}: {fault}: delete it and run {again}")
    return sources


def _fault(source: _Source, *, is_shared: bool) -> str | None:
    """What is wrong with a shard of a part; of one that is renamed its length alone is looked at."""
    with reading(source.path):
        size = source.path.stat().st_size if source.path.exists() else 0
    if size != source.record.size:
        return f"{size} of its {source.record.size} bytes are there"
    if is_shared and (whole := len(whole_samples(source.path, source.layout))) != source.record.count:
        return f"{whole} of its {source.record.count} samples are whole"
    return None


# ------------------------------------------------------------------------------------------------------------- joining


def _join(target: Path, sources: Sequence[_Source]) -> tuple[ShardRecord, ShardTable]:
    """A shard of the data set, made of those of its parts, which are gone then."""
    count = sum(source.record.count for source in sources)
    with reading(target):
        is_there = target.exists()
    if is_there:
        table = scan_shard(target, sources[0].layout)
        record = sources[0].record if len(sources) == 1 else shard_record(target, table)
    elif len(sources) == 1:
        table = _table(sources[0])
        record = sources[0].record
        with writing(target):
            sources[0].path.rename(target)
    else:
        record, table = _copied(target, sources)
    if len(table) != count:
        raise ShardError(f"{target}: {len(table)} samples, where its parts have {count}: move it elsewhere, then merge")
    for source in sources:
        with writing(source.path):
            source.path.unlink(missing_ok=True)
    return record, table


def _table(source: _Source) -> ShardTable:
    """The contents of a whole shard of a part."""
    if source.table is not None and len(source.table) == source.record.count:
        return source.table
    return scan_shard(source.path, source.layout)


def _copied(target: Path, sources: Sequence[_Source]) -> tuple[ShardRecord, ShardTable]:
    """The samples of several shards as one; gone on with where a merge was stopped."""
    layout = sources[0].layout
    shard = GrowingShard(target, empty_table(layout), layout)
    try:
        for source in sources:
            shard.copy(source.path, whole_samples(source.path, layout))
        return shard.finish(), shard.table()
    finally:
        shard.close()


def _describe(out: Path, plan: PartsPlan, records: Mapping[str, Sequence[ShardRecord]]) -> None:
    """Write manifest and rejects."""
    named = plan.named
    manifest = Manifest(recipe=None if named is None else RecipeRecord(named.name, named.sha256))
    for split, shards in records.items():
        record = SplitRecord(plan.seed, plan.recipe, plan.shard_sizes[split], tuple(shards))
        manifest = manifest.with_split(split, record)
    manifest.write(out)
    write_whole(out / REJECTS, joined_rejects(part_folder(out, part, plan.of) for part in range(plan.of)))


def _remove(folder: Path) -> None:
    with writing(folder):
        if folder.is_dir():
            shutil.rmtree(folder)


def _way_out(out: Path) -> str:
    """What to do about a folder without parts."""
    if splits_in(out):
        return "it holds a data set that is whole: read it as it is"
    return "give a folder in which gcd generate --shard I/N has made some"
