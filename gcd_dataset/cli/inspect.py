"""Summary of a data set for ``gcd info``, and its faults for ``gcd verify``."""

import json
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from itertools import groupby
from pathlib import Path
from typing import Any

import numpy as np

from gcd_dataset.errors import GcdError, ShardError
from gcd_dataset.files import open_regular
from gcd_dataset.hub.partition import DESIGN, leaks
from gcd_dataset.shards.access import REMEDY, reading
from gcd_dataset.shards.codec import decode_field, opened_picture
from gcd_dataset.shards.folder import FolderStore
from gcd_dataset.shards.index import GRADES, index_name
from gcd_dataset.shards.layout import (
    BODIES,
    GARMENTS,
    Bytes,
    Layout,
    fields_of,
    is_picture,
    is_view_field,
    joint_fields,
    key_of,
)
from gcd_dataset.shards.manifest import MANIFEST, Manifest, ShardRecord, SplitRecord
from gcd_dataset.shards.meta import read_meta
from gcd_dataset.shards.notes import REJECTS, hashed, shards_named
from gcd_dataset.shards.place import FolderPlace
from gcd_dataset.shards.reader import ShardReader
from gcd_dataset.shards.store import Store
from gcd_dataset.shards.tar import BLOCK, tar_entries

FIRST_CAPTIONS = 3
DRAPE = "drape"  # the stage that drapes
SAMPLED = 500  # samples of a split that are read for statistics: shares are accurate to a few per cent
WEIGHED = 20  # samples of a split whose members are weighed
BAR = 30  # characters


# --------------------------------------------------------------------------------------------------------------- info


def info_lines(store: Store) -> Iterator[str]:
    """Counts, shares and text plots of a data set. Raises ``ShardError``, at the end where its pictures are lost."""
    manifest = store.manifest()
    source = "" if store.source in (None, store.location()) else f", from {store.source}"
    yield f"{store.location()}{source}, made by gcd_dataset {manifest.generator}, schema {manifest.schema}"
    if manifest.recipe is not None:
        recipe = manifest.recipe
        yield f"  recipe {recipe.name}, sha256 {recipe.sha256}, patterns {recipe.patterns or 'not all made yet'}"
    for split in manifest.splits:
        if (fault := store.unfinished(split)) is not None:
            yield f"  unfinished: {fault}"
            break
    lost: ShardError | None = None
    for split, record in manifest.splits.items():
        yield ""
        if not record.count:
            yield f"{split}: no samples"
            continue
        reader = ShardReader(store, split, layout=_layout_of(record))
        yield from _split_lines(reader)
        yield from _recipe_lines(record)
        yield from _reject_lines(store, record)
        if isinstance(store, FolderStore):
            lost = lost or store.missing_pictures(split)
            members = [member for member in reader.layout.members if lost is None or not is_picture(member)]
            yield from _bars("bytes by field", _bytes_by_member(reader, members))
            if reader.layout.kind == GARMENTS.kind:
                yield from _content_lines(reader, members)
    if lost is not None:
        raise lost


def _layout_of(record: SplitRecord) -> Layout:
    return BODIES if record.plan.kind == BODIES.kind else GARMENTS


def _split_lines(reader: ShardReader) -> Iterator[str]:
    index, count, shards = reader.index, len(reader), reader.record.shards
    size = f"{sum(shard.size + shard.views_size for shard in shards) / 1e6:.1f} MB"
    settled = int(index.settled.sum())
    stage = reader.record.plan.recipe.get("stage", DRAPE)
    at_rest = f"{settled} at rest ({settled / count:.1%})" if stage == DRAPE else f"stage {stage}, without drapes"
    drapes = f", {at_rest}" if reader.layout.kind == GARMENTS.kind else ""
    yield f"{reader.split}: {count} samples in {len(shards)} shards, {size}{drapes}"
    grades = np.bincount(index.grade, minlength=len(GRADES))
    if grades[1:].any():
        shares = (
            f"{name} {number / count:.1%}" for name, number in zip(GRADES, grades, strict=True) if name and number
        )
        yield f"  grades: {', '.join(reversed(list(shares)))}"


def _recipe_lines(record: SplitRecord) -> Iterator[str]:
    yield f"  seed {record.plan.seed}, recipe {json.dumps(dict(record.plan.recipe), sort_keys=True)}"
    if record.rejects:
        yield from _bars("rejected attempts by rule", record.rejects)
    if record.redraws:
        total, count = sum(record.redraws.values()), record.count
        yield from _bars(f"redraws by rule, {total / count:.2f} per sample", record.redraws)


def _reject_lines(store: Store, record: SplitRecord) -> Iterator[str]:
    """A line with the path of the reject log, if there is one."""
    if record.rejects and isinstance(store, FolderStore) and (store.folder / REJECTS).exists():
        yield f"    every rejected attempt, with its figures: {store.folder / REJECTS}"


def _bytes_by_member(reader: ShardReader, members: Sequence[str]) -> dict[str, int]:
    amounts: Counter[str] = Counter()
    for content in reader.read_many(_chosen(reader, WEIGHED), members):
        for member, data in content.items():
            amounts[_stem(member)] += len(data)
    return dict(amounts)


def _chosen(reader: ShardReader, count: int) -> list[int]:
    """At most ``count`` evenly spaced positions."""
    return np.unique(np.linspace(0, len(reader) - 1, min(len(reader), count)).astype(int)).tolist()


def _stem(member: str) -> str:
    """The name of a member in the plot; all views count as one."""
    stem = member.split(".")[0]
    return "views" if is_view_field(stem) else stem


def _content_lines(reader: ShardReader, present: Sequence[str]) -> Iterator[str]:
    """Outcomes, wearers and types of garments, from the ``present`` members at evenly spaced positions."""
    member_of = fields_of(present)
    members = [member_of[field] for field in ("meta", "design", "caption") if field in member_of]
    chosen = _chosen(reader, SAMPLED)
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
    if views := joint_fields(present).get("views"):
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
    members; whether the data set is finished; and whether two splits share designs.
    """
    store = FolderStore(folder)
    manifest = store.manifest()
    names = FolderPlace(folder).names()
    if MANIFEST not in names:
        yield f"{folder / MANIFEST}: no such file: run gcd index"
    listed = {(split, shard.number) for split, record in manifest.splits.items() for shard in record.shards}
    for split, number in shards_named(names):
        if (split, number) not in listed:
            yield f"{folder / ShardRecord(number, 0, 0, '').name(split)}: not listed in {MANIFEST}: run gcd index"
    for split in manifest.splits:
        if (fault := store.unfinished(split)) is not None:
            yield f"{folder}: the data set is unfinished: {fault}"
            break
    readers = dict(_readers(store, manifest))
    for split, reader in readers.items():
        if isinstance(reader, str):
            yield reader
        else:
            if MANIFEST in names and index_name(split) not in names:
                yield f"{folder / index_name(split)}: no such file: run gcd index"
            yield from _shard_faults(reader, folder, full=full)
    garments = {
        split: r for split, r in readers.items() if isinstance(r, ShardReader) and r.layout.kind == GARMENTS.kind
    }
    if len(garments) == len(readers) and all(DESIGN in reader.layout.members for reader in garments.values()):
        yield from (
            f"{folder}: {leak}: scores on one are biased for a model trained on the other" for leak in leaks(garments)
        )


def _readers(store: FolderStore, manifest: Manifest) -> Iterator[tuple[str, ShardReader | str]]:
    """Split to its reader, or to the fault for which there is none."""
    for split, record in manifest.splits.items():
        try:
            if record.count:
                yield split, ShardReader(store, split, layout=_layout_of(record))
        except GcdError as error:
            yield split, str(error)


def _shard_faults(reader: ShardReader, folder: Path, *, full: bool) -> Iterator[str]:
    first = reader.index.first.tolist()
    for row, shard in enumerate(reader.record.shards):
        rows = slice(first[row], first[row + 1])
        keys = list(map(key_of, reader.index.number[rows].tolist()))
        yield from _tar_faults(folder / shard.name(reader.split), keys, reader.index.start[rows].tolist(), shard.size)
        if shard.views_size:
            starts = reader.index.views_start[rows].tolist()
            yield from _tar_faults(folder / shard.views_name(reader.split), keys, starts, shard.views_size)
        for views in (False, True) if full else ():
            path = folder / shard.name(reader.split, views=views)
            expected = (shard.views_size, shard.views_sha256) if views else (shard.size, shard.sha256)
            if expected[0] and path.exists() and hashed(path) != expected:
                yield f"{path}: its hash differs from {MANIFEST}: {REMEDY}"
    for position in range(len(reader)) if full else ():
        try:
            reader.check(position)
        except ShardError as error:
            yield str(error)


def _tar_faults(path: Path, keys: list[str], starts: list[int], size: int) -> Iterator[str]:
    """The faults of the headers of a tar: its samples are ``keys``, which begin at ``starts``."""
    try:
        with reading(path), open_regular(path) as file:
            entries = list(tar_entries(file.fileno()))
            found = file.seek(0, 2)
    except ShardError as error:
        yield str(error) if str(error).startswith(str(path)) else f"{path}: {error}: {REMEDY}"
        return
    groups = {
        key: next(group).offset - BLOCK for key, group in groupby(entries, lambda entry: entry.name.split(".")[0])
    }
    if found != size:
        yield f"{path}: {found} bytes, but {MANIFEST} lists {size}: {REMEDY}"
    elif list(groups.items()) != list(zip(keys, starts, strict=True)):
        yield f"{path}: its samples differ from the index: run gcd index"
