"""Data sets brought here: whole shards, or shards of the fields that are wanted; gone on with wherever it broke off."""

import hashlib
import logging
import os
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

from gcd_dataset.errors import ConfigError, RemoteError, ShardError
from gcd_dataset.files import make_folder
from gcd_dataset.hub.checked import CheckedShards
from gcd_dataset.hub.place import MAIN, Repo, Url
from gcd_dataset.hub.remote import RemoteStore
from gcd_dataset.hub.site import Remote, Site
from gcd_dataset.shards.access import locked, reading, writing
from gcd_dataset.shards.contents import splits_in
from gcd_dataset.shards.copying import copy_shard
from gcd_dataset.shards.fetched import Fetched, FetchedSplit, changing_fetched, read_fetched
from gcd_dataset.shards.index import ShardIndex
from gcd_dataset.shards.layout import (
    FIELDS,
    FOREIGN,
    GARMENTS,
    Layout,
    index_name,
    known_fields,
    lock_name,
    part_path,
    shard_number,
    shards_in,
)
from gcd_dataset.shards.manifest import Manifest, ShardRecord, SplitRecord, keep_split, read_manifest
from gcd_dataset.shards.reader import ShardReader

__all__ = ["download", "remote_splits", "require_from"]

META = GARMENTS.members[0]
LINES = 4  # shards that come at a time

Told = Callable[[int, int], None]
"""Called with bytes that have come, and bytes in all."""

log = logging.getLogger(__name__)


def download(
    place: Repo | Url,
    folder: Path,
    remote: Remote | None = None,
    *,
    split: str = "train",
    fields: Sequence[str] | None = None,
    told: Told | None = None,
) -> Fetched:
    """Bring a split into ``folder``, as a data set of its own; with ``fields`` nothing else of each sample.

    What is whole there is not asked for again: broken off and started again, it goes on. Where ``place`` names another
    revision, that of a URL whose data set has grown, what has changed is brought. Every shard has the hash, or every
    member the CRC-32, that was published, or does not stay. Raises ``RemoteError`` for a server that fails for longer
    than it is waited for, ``ConfigError`` for a folder that holds something else, ``OutputError`` for one that cannot
    be written.
    """
    remote = remote or Remote()
    members = tuple(FIELDS[field] for field in known_fields(fields))
    wanted = GARMENTS.of([member for member in GARMENTS.members if member in {META, *members}])
    there = read_fetched(folder) if folder.is_dir() else None
    if there is not None and _is_there(folder, there, place, split, wanted):
        return there
    site = Site(place, remote)
    place = replace(place, revision=site.revision)
    store = RemoteStore(site, None)
    reader = ShardReader(store, split)
    if reader.manifest is None or reader.layout.kind == FOREIGN:
        raise _foreign(site)
    for name in reader.index.shards:  # the manifest's too: they have been compared
        if shard_number(name, split) is None:
            raise ShardError(f"{site.source}: tells of a shard {name!r}, which is no name for one: tell its publisher")
    layout = reader.layout.of([member for member in reader.layout.members if member in wanted.members])
    make_folder(folder)
    with locked(folder / lock_name(split), f"writing split {split}", wait=True):
        there = read_fetched(folder)
        if there is not None and _is_there(folder, there, place, split, layout):
            return there  # another process was faster
        with changing_fetched(folder):
            _begun(folder, site.source, split, layout, reader.manifest).write(folder)
            _begin_manifest(folder, reader.manifest)
        record = reader.manifest.splits[split]
        _drop_others(folder, split, record)
        if layout == reader.layout:
            _bring_whole(folder, site, split, record, told or _silent)
            shards = list(record.shards)
            reader.index.write(folder / index_name(split))
        else:
            shards = _bring_fields(folder, reader, layout, told or _silent)
        keep_split(folder, split, replace(record, shards=tuple(shards)))
        return _ended(folder, site.source, split, layout)


def require_from(folder: Path, place: Repo | Url) -> None:
    """Raise ``ConfigError`` for a folder that was downloaded from elsewhere; what a tag stood for, nobody can tell."""
    there = read_fetched(folder)
    known = place if isinstance(place, Url) or place.is_pinned else replace(place, revision=MAIN)
    if there is not None and not _is_from(there, known):
        raise ConfigError(f"{folder}: holds {there.source}, asked for {place}: choose another folder")


def remote_splits(place: Repo | Url, remote: Remote) -> tuple[Repo | Url, tuple[str, ...]]:
    """The place at its revision of now, and the splits there are.

    Raises ``ConfigError`` for tars of another program, else as ``download``.
    """
    site = Site(place, remote)
    manifest = RemoteStore(site, None).manifest()
    if manifest is None:
        raise _foreign(site)
    return replace(place, revision=site.revision), tuple(manifest.splits)


def _foreign(site: Site) -> ConfigError:
    return ConfigError(
        f"{site.source}: tars of another program have no manifest to check them by: read them without root, or get "
        "them with hf download"
    )


def _is_there(folder: Path, there: Fetched, place: Repo | Url, split: str, wanted: Layout) -> bool:
    """Whether a folder holds all that is wanted, so that no server need be asked."""
    known = there.splits.get(split)
    if known is None or not known.whole or not set(wanted.members) <= set(known.members):
        return False
    if not _has_shards(folder, split):
        return False
    return _is_from(there, place)


def _is_from(there: Fetched, place: Repo | Url) -> bool:
    """Whether a folder was downloaded from that place, at the revision that it names, if any."""
    name, _, revision = there.source.rpartition("@")
    if isinstance(place, Url):
        return name == place.url and place.revision in ("", revision)
    return name == f"hf://datasets/{place.name}" and place.revision in (MAIN, revision)


def _has_shards(folder: Path, split: str) -> bool:
    """Whether all shards in the folder's manifest are there, as long as it says."""
    record = (read_manifest(folder) or Manifest()).splits.get(split)
    with reading(folder):
        size = {path.name: path.stat().st_size for path in shards_in(folder, split)}
    return record is not None and all(size.get(shard.name) == shard.size for shard in record.shards)


def _begun(folder: Path, source: str, split: str, layout: Layout, manifest: Manifest) -> Fetched:
    """The record of the folder, in which this split is about to come. Raises ``ConfigError`` if another is there."""
    there = read_fetched(folder)
    if there is None and (read_manifest(folder) is not None or splits_in(folder)):
        raise ConfigError(f"{folder}: holds a data set that was not downloaded: choose another folder")
    note = there or Fetched(source)
    if note.source != source:
        note = _followed(folder, note, source, manifest)
    if (known := note.splits.get(split)) is not None and tuple(known.members) != layout.members:
        had, now = (", ".join(member.split(".")[0] for member in some) for some in (known.members, layout.members))
        raise ConfigError(f"{folder}: holds the fields {had} of split {split}, asked for {now}: choose another folder")
    return note.with_split(split, FetchedSplit(layout.members))


def _followed(folder: Path, note: Fetched, source: str, manifest: Manifest) -> Fetched:
    """The record of a folder whose URL holds more by now; splits of it that have changed are no longer whole.

    Raises ``ConfigError`` for another place, another commit, or a URL at which another data set is.
    """
    url = source.rpartition("@")[0]
    if note.source.rpartition("@")[0] != url or not url.startswith(("http://", "https://")):
        raise ConfigError(f"{folder}: holds {note.source}, asked for {source}: choose another folder, or that revision")
    here = read_manifest(folder) or Manifest()
    for name, record in here.splits.items():
        if name not in manifest.splits or _way(record) != _way(manifest.splits[name]):
            raise ConfigError(
                f"{folder}: holds {note.source}, and by now another data set is there, with another seed, recipe or "
                f"split than {name} had: choose another folder"
            )
    log.info("%s: %s has changed since: what is new is brought", folder, url)
    same = {name for name in note.splits if here.splits.get(name) == manifest.splits.get(name)}
    splits = {name: replace(split, whole=split.whole and name in same) for name, split in note.splits.items()}
    return Fetched(source, splits)


def _way(record: SplitRecord) -> SplitRecord:
    """How the samples of a split are made, and numbered, however many there are."""
    return replace(record, shards=())


def _drop_others(folder: Path, split: str, record: SplitRecord) -> None:
    """Remove shards that are no longer part of the split, which readers of the folder would find."""
    listed = {shard.name for shard in record.shards}
    for path in shards_in(folder, split):
        if path.name not in listed:
            with writing(path):
                path.unlink()


def _ended(folder: Path, source: str, split: str, layout: Layout) -> Fetched:
    """The record of the folder, in which this split is whole, unless it follows a later revision meanwhile."""
    with changing_fetched(folder):
        note = read_fetched(folder) or Fetched(source)
        if note.source == source:
            note = note.with_split(split, FetchedSplit(layout.members, whole=True))
            note.write(folder)
    return note


def _begin_manifest(folder: Path, manifest: Manifest) -> None:
    """A manifest that says who made the data set."""
    if read_manifest(folder) is None:
        replace(manifest, splits={}).write(folder)


# ------------------------------------------------------------------------------------------------------- whole shards


def _bring_whole(folder: Path, site: Site, split: str, record: SplitRecord, told: Told) -> None:
    checked = CheckedShards(folder, split)
    total, come = sum(shard.size for shard in record.shards), [0] * len(record.shards)

    def bring(number: int) -> None:
        def tell(size: int) -> None:
            come[number] = size
            told(sum(come), total)

        _bring_shard(folder, site, record.shards[number], checked, tell)

    _all_of(bring, len(record.shards), LINES)


def _bring_shard(
    folder: Path, site: Site, shard: ShardRecord, checked: CheckedShards, tell: Callable[[int], None]
) -> None:
    """One shard, checked. Raises ``RemoteError`` where wrong bytes come twice; none of them stay."""
    path = folder / shard.name
    if checked.holds(shard):
        tell(shard.size)
        return
    with writing(path):
        path.unlink(missing_ok=True)
    for _ in range(2):
        if _filled(part_path(path), site, shard, tell) == shard.sha256:
            with writing(path):
                part_path(path).replace(path)
            checked.remember(shard)
            return
        with writing(path):
            part_path(path).unlink()
    raise RemoteError(
        f"{site.web.address(shard.name)}: other bytes come than were published: none of them is kept; try again later, "
        "or tell its publisher"
    )


def _filled(part: Path, site: Site, shard: ShardRecord, tell: Callable[[int], None]) -> str:
    """SHA-256 of a shard's draft, after what was missing of it has come."""
    digest = hashlib.sha256()
    with _appending(part) as file:
        if os.fstat(file).st_size > shard.size:
            os.ftruncate(file, 0)
        place = 0
        while piece := os.pread(file, 1 << 20, place):
            digest.update(piece)
            place += len(piece)
        tell(place)
        for piece in site.web.pieces(shard.name, place, shard.size) if place < shard.size else ():
            with writing(part):
                place += _written(file, piece, place)
            digest.update(piece)
            tell(place)
        with writing(part):
            os.fsync(file)
    return digest.hexdigest()


@contextmanager
def _appending(part: Path) -> Iterator[int]:
    with writing(part):
        file = os.open(part, os.O_RDWR | os.O_CREAT, 0o644)
    try:
        yield file
    finally:
        os.close(file)


def _written(file: int, piece: bytes, place: int) -> int:
    rest = memoryview(piece)
    while rest:
        rest = rest[os.pwrite(file, rest, place + len(piece) - len(rest)) :]
    return len(piece)


# ------------------------------------------------------------------------------------------------------------- fields


def _bring_fields(folder: Path, reader: ShardReader, layout: Layout, told: Told) -> list[ShardRecord]:
    """Shards of the same names and samples, which hold these members alone."""
    columns = [reader.layout.members.index(member) for member in layout.members]
    index = reader.index
    total, come = int(index.table.size[:, columns].sum()), [0] * len(index.shards)
    records: list[ShardRecord | None] = [None] * len(index.shards)
    tables = {}
    position_of = dict(zip(reader.rows(range(len(reader))).tolist(), range(len(reader)), strict=True))

    def bring(number: int) -> None:
        positions = [position_of[row] for row in (index.shard == number).nonzero()[0].tolist()]

        def tell(size: int) -> None:
            come[number] += size
            told(sum(come), total)

        shard, table = copy_shard(folder / index.shards[number], reader, positions, layout, tell)
        records[number], tables[index.shards[number]] = shard, table

    _all_of(bring, len(index.shards), 1)  # the samples of one come side by side
    ShardIndex.of(folder, {name: tables[name] for name in index.shards}, layout).write(
        folder / index_name(reader.split)
    )
    return [shard for shard in records if shard is not None]


def _all_of(bring: Callable[[int], None], count: int, lines: int) -> None:
    """Bring every shard, ``lines`` at a time; the first error ends it, once those on their way have come."""
    with ThreadPoolExecutor(lines) as pool:
        jobs = [pool.submit(bring, number) for number in range(count)]
        try:
            for job in jobs:
                job.result()
        finally:
            for job in jobs:
                job.cancel()


def _silent(come: int, total: int) -> None:
    """Nobody is told."""
