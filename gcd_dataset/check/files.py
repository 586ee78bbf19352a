"""Faults of the files of a data set: damage, members without index, shards without manifest, garments without split."""

import contextlib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import groupby
from pathlib import Path
from typing import Any

from gcd_dataset.check import checks
from gcd_dataset.check.checks import Check
from gcd_dataset.errors import GcdError, ShardError
from gcd_dataset.files import open_regular
from gcd_dataset.hub.partition import DESIGN, leaks
from gcd_dataset.release.batches import PublishedBatches
from gcd_dataset.release.bodies import FOLDER
from gcd_dataset.release.garment_list import PublishedGarments
from gcd_dataset.release.published_names import DEFAULT_BODY
from gcd_dataset.shards.access import REMEDY, Place, reading
from gcd_dataset.shards.index import index_name
from gcd_dataset.shards.layout import BODIES, GARMENTS, Layout, key_of
from gcd_dataset.shards.manifest import MANIFEST, Manifest, ShardRecord, SplitRecord
from gcd_dataset.shards.notes import REJECTS, Note, hashed, note_name, note_of, rejects_bytes, shards_named
from gcd_dataset.shards.reader import ShardReader
from gcd_dataset.shards.store import FolderStore
from gcd_dataset.shards.tar import BLOCK, tar_entries

FileFault = tuple[Check, str, str]
"""A check, the file or key, and the fault in words."""
PEOPLE_FILES = ("measurements/{}.yaml", "meta/{}_meta.json", "meshes/{}_straight.obj", "meshes/{}_apart.obj")


def set_faults(folder: Path, *, every_byte: bool = False) -> Iterator[str]:
    """The faults of the data set in a folder, one line each.

    Checks the headers, length and index of every shard, and with ``every_byte`` every byte, by the hashes of shard and
    members, and every note; whether the data set is finished; and whether two splits share designs.
    """
    store = FolderStore(folder)
    manifest = store.manifest()
    names = Place(folder).names()
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
            yield from _shard_faults(reader, folder, every_byte=every_byte)
    if every_byte and MANIFEST in names:
        yield from _note_faults(Place(folder), manifest)
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
                yield split, ShardReader(store, split, layout=layout_of(record))
        except GcdError as error:
            yield split, str(error)


def _shard_faults(reader: ShardReader, folder: Path, *, every_byte: bool) -> Iterator[str]:
    first = reader.index.first.tolist()
    for row, shard in enumerate(reader.record.shards):
        rows = slice(first[row], first[row + 1])
        keys = list(map(key_of, reader.index.number[rows].tolist()))
        yield from _tar_faults(folder / shard.name(reader.split), keys, reader.index.start[rows].tolist(), shard.size)
        if shard.views_size:
            starts = reader.index.views_start[rows].tolist()
            yield from _tar_faults(folder / shard.views_name(reader.split), keys, starts, shard.views_size)
        for views in (False, True) if every_byte else ():
            path = folder / shard.name(reader.split, views=views)
            expected = (shard.views_size, shard.views_sha256) if views else (shard.size, shard.sha256)
            if expected[0] and path.exists() and hashed(path) != expected:
                yield f"{path}: its hash differs from {MANIFEST}: {REMEDY}"
    for position in range(len(reader)) if every_byte else ():
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


def _note_faults(place: Place, manifest: Manifest) -> Iterator[str]:
    """Notes that differ from their shards, and rejects that differ from the notes; damaged shards are left out."""
    names, lines = place.names(), list[Mapping[str, Any]]()
    is_whole = REJECTS in names
    for split, record in manifest.splits.items():
        for shard in record.shards:
            name = note_name(split, shard.number)
            tar, views = (place.folder / shard.name(split, views=views) for views in (False, True))
            if name not in names:
                is_whole = False
                continue
            try:
                note = Note.from_bytes(content := next(place.read([name])), place.location(name))
            except ShardError as error:
                is_whole = False
                yield str(error)
                continue
            lines += note.rejects
            with contextlib.suppress(ShardError):
                made = note_of(tar, views if shard.views_size else None, split, shard.number, note.plan)
                if note.plan != record.plan or replace(made, skipped=note.skipped).to_bytes() != content:
                    is_whole = False
                    yield f"{place.location(name)}: differs from its shard: delete it, then run gcd index"
    if is_whole and next(place.read([REJECTS])) != rejects_bytes(lines):
        yield f"{place.location(REJECTS)}: differs from the notes: run gcd index"


def layout_of(record: SplitRecord) -> Layout:
    """The layout of a split's samples."""
    return BODIES if record.plan.kind == BODIES.kind else GARMENTS


def published_faults(
    batches: PublishedBatches, splits: Sequence[PublishedGarments], wearers: set[str] | None
) -> Iterator[FileFault]:
    """Faults of the files of a published data set.

    ``splits``: the splits that are examined; ``wearers``: names of the bodies of their garments; ``None``
    where not all garments were read: people are not examined.
    """
    listed = {str(entry) for split in splits for entry in split.entries}
    for (batch, folder), files in batches.files.items():
        fails = batches.properties[batch, folder].fails
        for name in files.names:
            place = f"{batch}/{folder}/{name}"
            if name in fails:
                yield checks.ORPHANS, place, "folders of failed garments, which are left out"
            elif place not in listed:
                yield checks.ORPHANS, place, "garments in no split"
    for split in splits:
        yield from (
            (checks.INCOMPLETE, place, "listed in the split, but neither on disk nor failed") for place in split.missing
        )
    if wearers is not None:
        yield from _people_faults(batches.root, wearers)


def _people_faults(root: Path, wearers: set[str]) -> Iterator[FileFault]:
    """People without a garment, and wearers without files, where the release's bodies are on disk."""
    folder = root / FOLDER
    with reading(root):
        if not folder.is_dir():
            return
        people = {path.stem for path in (folder / "measurements").glob("*.yaml")}
        files = {str(path.relative_to(folder)) for sub in ("meta", "meshes") for path in (folder / sub).glob("*")}
    worn = {name.removesuffix("_straight").removesuffix("_apart") for name in wearers} - {DEFAULT_BODY}
    yield from ((checks.ORPHANS, f"{FOLDER}/{name}", "bodies without a garment") for name in sorted(people - worn))
    for name in sorted(people & worn):
        if any(kind.format(name) not in files for kind in PEOPLE_FILES[1:]):
            yield checks.BODILESS, name, "a body without mesh or metadata"
    yield from ((checks.BODILESS, name, "a body that is not on disk") for name in sorted(worn - people))
