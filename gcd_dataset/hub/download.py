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
from gcd_dataset.hub.checked_shards import CheckedShards
from gcd_dataset.hub.download_record import begin_split, completed_download, finish_split
from gcd_dataset.hub.remote import RemoteStore
from gcd_dataset.hub.site import Remote, Site
from gcd_dataset.hub.source import Repo, Url
from gcd_dataset.shards.access import locked, writing
from gcd_dataset.shards.copying import copy_shard
from gcd_dataset.shards.download_file import DownloadRecord
from gcd_dataset.shards.index import ShardIndex
from gcd_dataset.shards.layout import (
    FOREIGN,
    GARMENTS,
    MOST_VIEWS,
    Layout,
    fields_of,
    garments_layout,
    index_name,
    lock_name,
    part_path,
    select_fields,
    shard_number,
)
from gcd_dataset.shards.manifest import ShardRecord, SplitRecord, keep_recipe, keep_split
from gcd_dataset.shards.reader import ShardReader

__all__ = ["download", "remote_splits"]

META = "meta"
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
) -> DownloadRecord:
    """Bring a split into ``folder``, as a data set of its own; with ``fields`` nothing else of each sample.

    What is whole there is not asked for again: broken off and started again, it goes on. Where ``place`` names another
    revision, that of a URL whose data set has grown, what has changed is brought. Every shard has the hash, or every
    member the CRC-32, that was published, or does not stay. Raises ``RemoteError`` for a server that fails for longer
    than it is waited for, ``ConfigError`` for a folder that holds something else, ``OutputError`` for one that cannot
    be written.
    """
    remote = remote or Remote()
    views = MOST_VIEWS if any(field.startswith("view_") for field in fields or ()) else 0
    everything = GARMENTS if fields is None else garments_layout(caption=True, views=views)
    names = {META, *select_fields(fields, fields_of(everything.members))}
    wanted = everything.of([member for field, member in fields_of(everything.members).items() if field in names])
    if there := completed_download(folder, place, split, wanted):
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
    layout = reader.layout
    if fields is not None:
        held = fields_of(layout.members)
        if missing := sorted(names - held.keys()):
            raise ConfigError(f"{site.source}: its garments have no {missing[0]}: there are {', '.join(held)}")
        layout = layout.of([member for field, member in held.items() if field in names])
    make_folder(folder)
    with locked(folder / lock_name(split), f"writing split {split}", wait=True):
        if there := completed_download(folder, place, split, layout):
            return there  # another process was faster
        begin_split(folder, site.source, split, layout, reader.manifest)
        record = reader.manifest.splits[split]
        if layout == reader.layout:
            _bring_whole(folder, site, split, record, told or _silent)
            shards = list(record.shards)
            reader.index.write(folder / index_name(split))
        else:
            shards = _bring_fields(folder, reader, layout, told or _silent)
        keep_split(folder, split, replace(record, shards=tuple(shards)))
        if reader.manifest.recipe is not None:
            keep_recipe(folder, reader.manifest.recipe)
        return finish_split(folder, site.source, split, layout)


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
        file = os.open(part, os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW, 0o644)
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
