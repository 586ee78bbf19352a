"""Merging the parts of a data set: most shards are renamed; shards that span two parts or more are concatenated."""

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
from gcd_dataset.verbs.progress import Progress, ProgressCallback, ignore_progress
from gcd_dataset.verbs.seal import seal

__all__ = ["merge"]

NAMED = 5  # parts listed in a message


@dataclass(frozen=True)
class _Source:
    """A shard of a part."""

    part: int
    path: Path
    record: ShardRecord
    layout: Layout
    table: ShardTable | None
    """Its contents, if they are in the index of its part."""


def merge(out: Path | str, *, on_progress: ProgressCallback = ignore_progress) -> dict[str, int]:
    """Merge the parts in ``out``; returns the number of samples of each split.

    ``out`` then holds the shards, index, manifest and rejects of a single run, byte for byte, and nothing else.
    ``on_progress`` is called with the number of merged samples. A stopped call can be repeated. Raises ``ShardError``
    for a part that is missing, unfinished or damaged, and for a folder without parts; ``ConfigError`` for parts that do
    not belong together; ``OutputError`` if ``out`` cannot be written, or another merge is running.
    """
    out = user_path(out)
    with reading(out):
        has_parts, has_rest = (out / PARTS).is_dir(), (out / MERGED).is_dir()
    if not has_parts and not has_rest:
        raise ShardError(f"{out}: no parts to be merged: {_remedy(out)}")
    with locked(out / lock_name(TRAIN), "merging its parts"):
        if has_parts:
            _merge(out, on_progress)
        _complete(out)
        manifest = read_manifest(out)
    return {} if manifest is None else manifest.counts


def _complete(out: Path) -> None:
    """Seal the data set of a recipe, then remove ``.parts-merged``.

    In this order: after a kill in between, the next call finds the folder and resumes here.
    """
    if has_plan(out / MERGED) and (named := read_plan(out / MERGED).named) is not None:
        seal(out, named)
    _remove(out / MERGED)


def _merge(out: Path, on_progress: ProgressCallback) -> None:
    plan = read_plan(out / PARTS)
    require_version(out, plan)
    _begin(out)
    try:
        parts = _finished_parts(out, plan)
        sources = _sources(out, plan, parts)
    except GcdError:
        if not splits_in(out):  # no shard was moved yet: allow parts to be made again
            _end(out)
        raise
    total = sum(source.record.count for shards in sources.values() for source in shards)
    progress = Progress(total, 0)
    on_progress(progress)
    layouts = {split: shards[0].layout for (split, _), shards in sources.items()}
    records: dict[str, list[ShardRecord]] = {split: [] for split in {**dict.fromkeys(plan.splits), **layouts}}
    tables: dict[str, dict[str, ShardTable]] = {split: {} for split in records}
    for (split, name), shards in sorted(sources.items()):
        record, table = _join(out / name, shards)
        records[split].append(record)
        tables[split][name] = table
        progress = replace(progress, made=progress.made + record.count)
        on_progress(progress)
    for split in records:
        ShardIndex.of(out, tables[split], layouts.get(split, GARMENTS)).write(out / index_name(split))
    _write_manifest(out, plan, records)
    with parts_lock(out), writing(out / PARTS):
        _remove(out / MERGED)
        (out / PARTS).rename(out / MERGED)
        sync_folder(out)


# --------------------------------------------------------------------------------------------------------------- parts


def _begin(out: Path) -> None:
    """Mark the parts as being merged, so that no process makes one meanwhile.

    Raises ``ConfigError`` for shards beside the parts.
    """
    with parts_lock(out):
        if is_merging(out):
            return
        if extra := sorted(path.name for pattern in ("*.tar", "*.tar.part") for path in out.glob(pattern)):
            raise ConfigError(
                f"{out}: holds {extra[0]}, which belongs to none of its parts: move it elsewhere, then merge"
            )
        write_whole(merging_path(out), b"")


def _end(out: Path) -> None:
    with parts_lock(out), writing(merging_path(out)):
        merging_path(out).unlink()


def _finished_parts(out: Path, plan: PartsPlan) -> list[FinishedPart]:
    """The completion records of all parts, in order. Raises ``ShardError`` if a part is missing or unfinished."""
    folders = [part_folder(out, part, plan.of) for part in range(plan.of)]
    with reading(out / PARTS):
        others = sorted({path.name for path in (out / PARTS).glob("*-of-*")} - {path.name for path in folders})
        missing = [part for part, folder in enumerate(folders) if not folder.is_dir()]
    if others:
        raise ConfigError(f"{out / PARTS / others[0]}: not one of the {plan.of} parts: move it elsewhere, then merge")
    _require_none(missing, "missing", out, plan)
    found = [_finished(folder, plan) for folder in folders]
    _require_none([part for part, finished in enumerate(found) if finished is None], "not finished", out, plan)
    parts = [finished for finished in found if finished is not None]
    for part, (finished, folder) in enumerate(zip(parts, folders, strict=True)):
        remedy = f"delete {folder} and run {command_of(out, plan, part)}"
        finished.require_of(plan, part, finished_path(folder), remedy)
        if others := sorted(finished.splits.keys() - plan.shard_sizes.keys()):
            raise ConfigError(f"{finished_path(folder)}: has split {others[0]}, which the plan lacks: {remedy}")
    return parts


def _finished(folder: Path, plan: PartsPlan) -> FinishedPart | None:
    """The completion record of a part. Raises ``OutputError`` while another process makes the part."""
    with locked(folder / lock_name(plan.splits[0]), "making this part"):
        return read_finished(folder)


def _require_none(parts: Sequence[int], fault: str, out: Path, plan: PartsPlan) -> None:
    """Raise ``ShardError`` if there are any ``parts``; ``fault`` completes ``part 1/4 is …``."""
    if not parts:
        return
    names = ", ".join(f"{part}/{plan.of}" for part in parts[:NAMED])
    more = f" and {len(parts) - NAMED} more" if len(parts) > NAMED else ""
    verb = "is" if len(parts) == 1 else "are"
    raise ShardError(f"{out}: part {names}{more} {verb} {fault}: run {command_of(out, plan, parts[0])}")


def _sources(out: Path, plan: PartsPlan, parts: Sequence[FinishedPart]) -> dict[tuple[str, str], list[_Source]]:
    """(split, file name) of each merged shard to the shards of parts that it joins, in order.

    Raises ``ShardError`` if one of them is missing or damaged.
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
    """The fault of a part's shard, if any. The samples are checked only where the shard will be concatenated."""
    with reading(source.path):
        size = source.path.stat().st_size if source.path.exists() else 0
    if size != source.record.size:
        return f"only {size} of its {source.record.size} bytes are present"
    if is_shared and (whole := len(whole_samples(source.path, source.layout))) != source.record.count:
        return f"only {whole} of its {source.record.count} samples are undamaged"
    return None


# ------------------------------------------------------------------------------------------------------------- joining


def _join(target: Path, sources: Sequence[_Source]) -> tuple[ShardRecord, ShardTable]:
    """Rename or concatenate shards of parts to the merged shard ``target``, and remove them; its record and table."""
    count = sum(source.record.count for source in sources)
    with reading(target):
        exists = target.exists()
    if exists:
        table = scan_shard(target, sources[0].layout)
        record = sources[0].record if len(sources) == 1 else shard_record(target, table)
    elif len(sources) == 1:
        table = _table(sources[0])
        record = sources[0].record
        with writing(target):
            sources[0].path.rename(target)
    else:
        record, table = _concatenate(target, sources)
    if len(table) != count:
        raise ShardError(f"{target}: {len(table)} samples, but its parts have {count}: move it elsewhere, then merge")
    for source in sources:
        with writing(source.path):
            source.path.unlink(missing_ok=True)
    return record, table


def _table(source: _Source) -> ShardTable:
    """The contents of a part's shard."""
    if source.table is not None and len(source.table) == source.record.count:
        return source.table
    return scan_shard(source.path, source.layout)


def _concatenate(target: Path, sources: Sequence[_Source]) -> tuple[ShardRecord, ShardTable]:
    """Copy the samples of several shards into one; resumes a stopped copy."""
    layout = sources[0].layout
    shard = GrowingShard(target, empty_table(layout), layout)
    try:
        for source in sources:
            shard.copy(source.path, whole_samples(source.path, layout))
        return shard.finish(), shard.table()
    finally:
        shard.close()


def _write_manifest(out: Path, plan: PartsPlan, records: Mapping[str, Sequence[ShardRecord]]) -> None:
    """Write the manifest and the joined reject log."""
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


def _remedy(out: Path) -> str:
    """The remedy for a folder without parts."""
    if splits_in(out):
        return "it already holds a complete data set"
    return "give a folder with parts made by gcd generate --shard I/N"
