"""Summary of a data set for ``gcd info``, and its faults for ``gcd verify``."""

import hashlib
import json
from collections import Counter
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from gcd_dataset.errors import GcdError, ShardError
from gcd_dataset.files import open_regular
from gcd_dataset.hub.partition import DESIGN, leaks
from gcd_dataset.shards.access import REMEDY, reading
from gcd_dataset.shards.codec import decode_field, read_meta
from gcd_dataset.shards.contents import layout_in, require_splits
from gcd_dataset.shards.folder import FolderStore
from gcd_dataset.shards.index import GRADES, ShardTable, read_stored_index, scan_shard
from gcd_dataset.shards.layout import (
    FOREIGN,
    GARMENTS,
    Bytes,
    fields_of,
    index_name,
    is_view_field,
    joint_fields,
)
from gcd_dataset.shards.manifest import MANIFEST, SplitRecord
from gcd_dataset.shards.picture import opened_picture
from gcd_dataset.shards.reader import ShardReader
from gcd_dataset.shards.rejects import REJECTS
from gcd_dataset.shards.store import Store
from gcd_dataset.shards.unfinished import unfinished

__all__ = ["faults", "info_lines"]

FIRST_CAPTIONS = 3
DRAPE = "drape"  # the stage that drapes
SAMPLED = 500  # samples of a split that are read for statistics: shares are accurate to a few per cent
BAR = 30  # characters


# --------------------------------------------------------------------------------------------------------------- info


def info_lines(store: Store) -> Iterator[str]:
    """Counts, shares and text plots of a data set. Raises ``ShardError``."""
    manifest = store.manifest()
    if isinstance(store, FolderStore):
        splits = require_splits(store.folder)
    else:
        splits = tuple(manifest.splits) if manifest is not None else ("train",)
    source = "" if store.source in (None, store.location()) else f", from {store.source}"
    version = "" if manifest is None else f", begun by gcd_dataset {manifest.generator}, schema {manifest.schema}"
    yield f"{store.location()}{source}{version}"
    if manifest is not None and manifest.recipe is not None:
        recipe = manifest.recipe
        yield f"  recipe {recipe.name}, sha256 {recipe.sha256}, patterns {recipe.patterns or 'not all made yet'}"
    for split in splits:
        layout = layout_in(store.folder, split) if isinstance(store, FolderStore) else GARMENTS
        reader = ShardReader(store, split, layout=layout)
        yield ""
        yield from _split_lines(reader)
        if isinstance(store, FolderStore) and (fault := unfinished(store.folder, split)) is not None:
            yield f"  not whole: {fault}"
        record = manifest.splits.get(split) if manifest is not None else None
        if record is not None:
            yield from _recipe_lines(record)
            yield from _reject_lines(store, record)
        yield from _bars("bytes by field", _bytes_by_member(reader))
        if reader.layout.kind == GARMENTS.kind and isinstance(store, FolderStore):
            yield from _content_lines(reader)


def _split_lines(reader: ShardReader) -> Iterator[str]:
    index, count = reader.index, len(reader)
    size = f"{index.length.sum() / 1e6:.1f} MB"
    settled = int(index.table.settled.sum())
    record = None if reader.manifest is None else reader.manifest.splits.get(reader.split)
    stage = DRAPE if record is None else record.recipe.get("stage", DRAPE)
    at_rest = f"{settled} at rest ({settled / count:.1%})" if stage == DRAPE else f"stage {stage}, without drapes"
    drapes = f", {at_rest}" if reader.layout.kind == GARMENTS.kind else ""
    yield f"{reader.split}: {count} samples in {len(index.shards)} shards, {size}{drapes}"
    grades = np.bincount(index.table.grade, minlength=len(GRADES))
    if grades[1:].any():
        shares = (
            f"{name} {number / count:.1%}" for name, number in zip(GRADES, grades, strict=True) if name and number
        )
        yield f"  grades: {', '.join(reversed(list(shares)))}"


def _recipe_lines(record: SplitRecord) -> Iterator[str]:
    yield f"  seed {record.seed}, recipe {json.dumps(dict(record.recipe), sort_keys=True)}"
    if record.rejects:
        yield from _bars("rejected attempts by rule", record.rejects)
    if record.redraws:
        total, count = sum(record.redraws.values()), sum(shard.count for shard in record.shards)
        yield from _bars(f"redraws by rule, {total / count:.2f} per sample", record.redraws)


def _reject_lines(store: Store, record: SplitRecord) -> Iterator[str]:
    """A line with the path of the reject log, if there is one."""
    if record.rejects and isinstance(store, FolderStore) and (store.folder / REJECTS).exists():
        yield f"    every rejected attempt, with its figures: {store.folder / REJECTS}"


def _bytes_by_member(reader: ShardReader) -> dict[str, int]:
    total = reader.index.table.size.sum(axis=0, dtype=np.int64)
    members = reader.layout.members
    # Foreign members may share a stem: keep their full names.
    names = members if reader.layout.kind == FOREIGN else map(_stem, members)
    amounts: Counter[str] = Counter()
    for name, size in zip(names, total.tolist(), strict=True):
        amounts[name] += size
    return dict(amounts)


def _stem(member: str) -> str:
    """The name of a member in the plot; all views count as one."""
    stem = member.split(".")[0]
    return "views" if is_view_field(stem) else stem


def _content_lines(reader: ShardReader) -> Iterator[str]:
    """Outcomes, wearers and types of garments, from samples at evenly spaced positions."""
    member_of = fields_of(reader.layout.members)
    members = [member_of[field] for field in ("meta", "design", "caption") if field in member_of]
    chosen = np.unique(np.linspace(0, len(reader) - 1, min(len(reader), SAMPLED)).astype(int)).tolist()
    counts: dict[str, Counter[str]] = {name: Counter() for name in ("outcome", "wearer", "upper", "bottom")}
    panels, tags, captions = [], Counter[str](), []
    for content in reader.read_many(chosen, members):
        if "caption" in member_of:
            captions.append(decode_field("caption", content).partition("\n")[0])
        meta = read_meta(content["meta.json"])
        counts["outcome"][meta["drape"]["outcome"] if meta["drape"] else "not draped"] += 1
        counts["wearer"][str(meta["body"]).partition(":")[0] or "unnamed"] += 1
        panels.append(len(meta["panel_names"]))
        tags.update(meta["tags"])
        kinds = _kinds(content)
        for name in ("upper", "bottom"):
            if name in kinds:
                counts[name][str(_value(kinds[name]))] += 1
    sampled = "" if len(chosen) == len(reader) else f", in {len(chosen)} samples"
    for name, counter in counts.items():
        if counter:
            yield from _bars(f"{name}{sampled}", dict(counter.most_common()))
    if tags:
        yield from _bars(f"tags, of all samples{sampled}", dict(tags.most_common()), of=len(chosen))
    if views := joint_fields(reader.layout.members).get("views"):
        yield f"  views: {len(views)} of each garment, {_view_size(reader, views[0])}"
    low, middle, high = np.percentile(panels, [0, 50, 100])
    yield f"  panels: {low:.0f} to {high:.0f}, median {middle:.0f}{sampled}"
    if captions:
        yield "  first captions:"
        yield from (f"    {text}" for text in captions[:FIRST_CAPTIONS])


def _view_size(reader: ShardReader, member: str) -> str:
    """Size of the first garment's view."""
    with opened_picture(reader.read(0, [member])[member], ("JPEG",)) as picture:
        return f"{picture.width} x {picture.height} pixels"


def _kinds(content: Mapping[str, Bytes]) -> Mapping[str, Any]:
    """The design's choice of garment types; empty if the data set does not hold the design."""
    kinds = decode_field("design", content).get("meta") if "design" in fields_of(content) else None
    return kinds if isinstance(kinds, Mapping) else {}


def _value(entry: Any) -> Any:
    return entry.get("v") if isinstance(entry, Mapping) else entry


def _bars(title: str, amounts: Mapping[str, int], *, of: int | None = None) -> Iterator[str]:
    """A text plot: one line for each entry, with its share ``of`` a number, by default of the sum."""
    total, most = of or sum(amounts.values()), max(amounts.values())
    if not total:
        return
    yield f"  {title}:"
    width = max(map(len, amounts))
    for name, amount in amounts.items():
        bar = "█" * round(BAR * amount / most)
        yield f"    {name:<{width}} {amount / total:6.1%} {bar}"


# ------------------------------------------------------------------------------------------------------------- verify


def faults(folder: Path, *, full: bool = False) -> Iterator[str]:
    """The faults of the data set in a folder, one line each.

    Checks the headers, length and index of every shard, and with ``full`` every byte, by the hashes of shard and
    members; whether each split is finished; and whether two splits share designs.
    """
    store = FolderStore(folder)
    splits = require_splits(folder)
    readers = {}
    for split in splits:
        try:
            readers[split] = ShardReader(store, split, layout=layout_in(folder, split))
        except GcdError as error:
            yield str(error)
            continue
        if (fault := unfinished(folder, split)) is not None:
            yield f"{folder}: split {split} is not whole: {fault}"
        yield from _shard_faults(readers[split], folder, full=full)
    manifest = store.manifest()
    for split in sorted(set(manifest.splits) - set(splits) if manifest is not None else ()):
        if manifest is not None and manifest.splits[split].shards:
            yield f"{folder}: split {split} of {MANIFEST} has no shards: copy them again"
    if all(DESIGN in fields_of(reader.layout.members) for reader in readers.values()):
        yield from (
            f"{folder}: {leak}: scores on one are biased for a model trained on the other" for leak in leaks(readers)
        )


def _shard_faults(reader: ShardReader, folder: Path, *, full: bool) -> Iterator[str]:
    manifest, index = reader.manifest, reader.index
    stored = read_stored_index(folder, reader.split, reader.layout, partial=True)
    if stored is None:
        yield f"{folder / index_name(reader.split)}: no such file: run gcd index"
    elif (stored.shards, stored.length.tolist()) != (index.shards, index.length.tolist()):
        yield f"{folder / index_name(reader.split)}: differs from the shards in the folder: run gcd index"
    record = manifest.splits.get(reader.split) if manifest is not None else None
    records = {shard.name: shard for shard in record.shards} if record is not None else {}
    for name, table in index.tables().items():
        path = folder / name
        if record is not None and name not in records:
            yield f"{path}: not listed in {MANIFEST}: run gcd generate again"
        elif record is not None and records[name].count != len(table):
            yield f"{path}: {len(table)} samples, but {MANIFEST} lists {records[name].count}: copy it again"
        if reader.layout.kind != FOREIGN:
            yield from _header_faults(path, reader, table)
        if full and name in records and _sha256(path) != records[name].sha256:
            yield f"{path}: its hash differs from {MANIFEST}: {REMEDY}"
    if full:
        for position in range(len(reader)):
            try:
                reader.check(position)
            except ShardError as error:
                yield str(error)


def _header_faults(path: Path, reader: ShardReader, table: ShardTable) -> Iterator[str]:
    try:
        scanned = scan_shard(path, reader.layout)
    except ShardError as error:
        yield str(error)
        return
    same = all(
        np.array_equal(getattr(scanned, name), getattr(table, name)) for name in ("sample", "offset", "size", "crc")
    )
    if not same:
        yield f"{path}: its contents differ from the index: run gcd index"


def _sha256(path: Path) -> str:
    with reading(path), open_regular(path) as file:
        return hashlib.file_digest(file, "sha256").hexdigest()
