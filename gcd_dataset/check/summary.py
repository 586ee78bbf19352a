"""Counts, shares and plots of a data set, for ``gcd info``."""

import json
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from gcd_dataset.check.files import layout_of
from gcd_dataset.check.sets import evenly_spaced, kinds_of
from gcd_dataset.errors import ShardError
from gcd_dataset.shards.codec import decode_field, opened_picture
from gcd_dataset.shards.index import GRADES
from gcd_dataset.shards.layout import GARMENTS, fields_of, is_picture, is_view_field, joint_fields
from gcd_dataset.shards.meta import read_meta
from gcd_dataset.shards.notes import REJECTS
from gcd_dataset.shards.reader import ShardReader
from gcd_dataset.shards.store import FolderStore, Store

FIRST_CAPTIONS = 3
DRAPE = "drape"  # the stage that drapes
SAMPLED = 500  # samples of a split that are read for statistics: shares are accurate to a few per cent
WEIGHED = 20  # samples of a split whose members are weighed
BAR = 30  # characters


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
        reader = ShardReader(store, split, layout=layout_of(record))
        yield from _split_lines(reader)
        yield f"  seed {record.plan.seed}, recipe {json.dumps(dict(record.plan.recipe), sort_keys=True)}"
        yield from _bars("rejected attempts by rule", record.rejects)
        average = sum(record.redraws.values()) / record.count
        yield from _bars(f"redraws by rule, {average:.2f} per sample", record.redraws)
        if record.rejects and isinstance(store, FolderStore) and (store.folder / REJECTS).exists():
            yield f"    every rejected attempt, with its figures: {store.folder / REJECTS}"
        if isinstance(store, FolderStore):
            lost = lost or store.missing_pictures(split)
            members = [member for member in reader.layout.members if lost is None or not is_picture(member)]
            yield from _bars("bytes by field", _bytes_by_member(reader, members))
            if reader.layout.kind == GARMENTS.kind:
                yield from _content_lines(reader, members)
    if lost is not None:
        raise lost


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


def _bytes_by_member(reader: ShardReader, members: Sequence[str]) -> dict[str, int]:
    amounts: Counter[str] = Counter()
    for content in reader.read_many(evenly_spaced(len(reader), WEIGHED), members):
        for member, data in content.items():
            stem = member.split(".")[0]
            amounts["views" if is_view_field(stem) else stem] += len(data)
    return dict(amounts)


def _content_lines(reader: ShardReader, present: Sequence[str]) -> Iterator[str]:
    """Outcomes, wearers and types of garments, from the ``present`` members at evenly spaced positions."""
    member_of = fields_of(present)
    members = [member_of[field] for field in ("meta", "design", "caption") if field in member_of]
    chosen = evenly_spaced(len(reader), SAMPLED)
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
        for name, kind in kinds_of(decode_field("design", content) if "design" in member_of else None).items():
            counts[name][kind] += 1
    sampled = "" if len(chosen) == len(reader) else f", in {len(chosen)} samples"
    for name, counter in counts.items():
        yield from _bars(f"{name}{sampled}", dict(counter.most_common()))
    if tags:
        yield from _bars(f"tags, of all samples{sampled}", dict(tags.most_common()), of=len(chosen))
    if views := joint_fields(present).get("views"):
        with opened_picture(reader.read(0, views[:1])[views[0]]) as picture:
            size = f"{picture.width} x {picture.height} pixels"
        yield f"  views: {len(views)} of each garment, {size}"
    low, middle, high = np.percentile(panels, [0, 50, 100])
    yield f"  panels: {low:.0f} to {high:.0f}, median {middle:.0f}{sampled}"
    if captions:
        yield "  first captions:"
        yield from (f"    {text}" for text in captions[:FIRST_CAPTIONS])


def _bars(title: str, amounts: Mapping[str, int], *, of: int | None = None) -> Iterator[str]:
    """A text plot: one line for each entry, with its share ``of`` a number, by default of the sum."""
    total, most = of or sum(amounts.values()), max(amounts.values(), default=0)
    if not total:
        return
    yield f"  {title}:"
    width = max(map(len, amounts))
    for name, amount in amounts.items():
        bar = "█" * round(BAR * amount / most)
        yield f"    {name:<{width}} {amount / total:6.1%} {bar}"
