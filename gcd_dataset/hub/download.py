"""Downloads splits, whole or reduced to some fields. An interrupted download is continued."""

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
from gcd_dataset.shards.contents import warn_of_others
from gcd_dataset.shards.copying import copy_shard
from gcd_dataset.shards.download_file import DownloadRecord
from gcd_dataset.shards.index import ShardIndex
from gcd_dataset.shards.layout import (
    FOREIGN,
    GARMENTS,
    JOINT,
    MOST_VIEWS,
    Layout,
    fields_of,
    garments_layout,
    index_name,
    is_view_field,
    joint_fields,
    lock_name,
    part_path,
    select_fields,
    shard_number,
)
from gcd_dataset.shards.manifest import ShardRecord, SplitRecord, keep_recipe, keep_split
from gcd_dataset.shards.reader import ShardReader

__all__ = ["download", "remote_splits", "wanted_layout"]

META = "meta"
PARALLEL_SHARDS = 4

Progress = Callable[[int, int], None]
"""Called with bytes downloaded, and bytes in total."""

log = logging.getLogger(__name__)


def download(
    source: Repo | Url,
    folder: Path,
    remote: Remote | None = None,
    *,
    split: str = "train",
    fields: Sequence[str] | None = None,
    on_progress: Progress | None = None,
) -> DownloadRecord:
    """Download a split into ``folder`` as a data set; with ``fields``, only these fields of each sample.

    An interrupted download continues with the missing shards. Where the data set at a URL has grown since, the changed
    shards are downloaded. Every shard is verified by its SHA-256, or every member by its CRC-32, and discarded on a
    mismatch. ``on_progress``: see ``Progress``. Raises ``RemoteError`` for a server that fails for longer than the
    patience, ``ConfigError`` for a folder that holds another data set, ``OutputError`` for one that cannot be written.
    """
    wanted, joint = wanted_layout(fields), _joint_of(fields)
    # The number of views is known to the server alone.
    if not joint and (completed := completed_download(folder, source, split, wanted)):
        return completed
    site = Site(source, remote or Remote())
    source = replace(source, revision=site.revision)
    reader = ShardReader(RemoteStore(site, None), split)
    if reader.manifest is None or reader.layout.kind == FOREIGN:
        raise _foreign_error(site)
    _require_shard_names(site, reader)
    layout = reader.layout if fields is None else _reduced_layout(site, reader.layout, wanted, joint)
    warn_of_others(make_folder(folder))
    with locked(folder / lock_name(split), f"writing split {split}", wait=True):
        if completed := completed_download(folder, source, split, layout):
            return completed  # by another process meanwhile
        begin_split(folder, site.source, split, layout, reader.manifest)
        record = reader.manifest.splits[split]
        if layout == reader.layout:
            _download_shards(folder, site, split, record, on_progress or _no_progress)
            shards = list(record.shards)
            reader.index.write(folder / index_name(split))
        else:
            shards = _download_fields(folder, reader, layout, on_progress or _no_progress)
        keep_split(folder, split, replace(record, shards=tuple(shards)))
        if reader.manifest.recipe is not None:
            keep_recipe(folder, reader.manifest.recipe)
        return finish_split(folder, site.source, split, layout)


def remote_splits(source: Repo | Url, remote: Remote) -> tuple[Repo | Url, tuple[str, ...]]:
    """The source pinned to its current revision, and its splits.

    Raises ``ConfigError`` for tars of another program, otherwise as ``download``.
    """
    site = Site(source, remote)
    manifest = RemoteStore(site, None).manifest()
    if manifest is None:
        raise _foreign_error(site)
    return replace(source, revision=site.revision), tuple(manifest.splits)


def wanted_layout(fields: Sequence[str] | None) -> Layout:
    """The members to download, ``meta.json`` included, by their current names. Raises ``ConfigError``.

    Of fields that join all views it holds the member of the first view.
    """
    if fields is None:
        return GARMENTS
    views = MOST_VIEWS if any(map(is_view_field, fields)) else 0
    full = garments_layout(caption=True, views=views)
    first = [_first_view(field) if field in JOINT else field for field in fields]
    names = {META, *select_fields(first, fields_of(full.members))}
    return full.of([member for field, member in fields_of(full.members).items() if field in names])


def _joint_of(fields: Sequence[str] | None) -> list[str]:
    """The fields among ``fields`` that join all views."""
    return [field for field in fields or () if field in JOINT]


def _first_view(joint: str) -> str:
    """The field of the first view from which a joint field is made."""
    return "view_0" if JOINT[joint] == "jpg" else "view_0_json"


def _require_shard_names(site: Site, reader: ShardReader) -> None:
    """Raise ``ShardError`` for an unsafe shard name in the index; the manifest lists the same names."""
    for name in reader.index.shards:
        if shard_number(name, reader.split) is None:
            raise ShardError(f"{site.source}: lists a shard {name!r}, which is not a valid name: tell its publisher")


def _reduced_layout(site: Site, layout: Layout, wanted: Layout, joint: Sequence[str]) -> Layout:
    """The published layout reduced to the fields of ``wanted``, and to those that ``joint`` fields join.

    Raises ``ConfigError`` for a missing field.
    """
    names, available = set(fields_of(wanted.members)), fields_of(layout.members)
    of_joint = joint_fields(layout.members)
    joined = {member for field in joint for member in of_joint.get(field, ())}
    names |= {field for field, member in available.items() if member in joined}
    if missing := sorted(names - available.keys()):
        raise ConfigError(f"{site.source}: its garments have no field {missing[0]}: there are {', '.join(available)}")
    return layout.of([member for field, member in available.items() if field in names])


def _foreign_error(site: Site) -> ConfigError:
    return ConfigError(
        f"{site.source}: tars of another program have no manifest, so they cannot be verified: read them without root, "
        "or get them with hf download"
    )


# ------------------------------------------------------------------------------------------------------- whole shards


def _download_shards(folder: Path, site: Site, split: str, record: SplitRecord, on_progress: Progress) -> None:
    checked = CheckedShards(folder, split)
    total, received = sum(shard.size for shard in record.shards), [0] * len(record.shards)

    def download_number(number: int) -> None:
        def report(size: int) -> None:
            received[number] = size
            on_progress(sum(received), total)

        _download_shard(folder, site, record.shards[number], checked, report)

    _run_all(download_number, len(record.shards), PARALLEL_SHARDS)


def _download_shard(
    folder: Path, site: Site, shard: ShardRecord, checked: CheckedShards, report: Callable[[int], None]
) -> None:
    """Download and verify one shard. Raises ``RemoteError`` after two wrong hashes, and keeps nothing."""
    path = folder / shard.name
    if checked.holds(shard):
        report(shard.size)
        return
    with writing(path):
        path.unlink(missing_ok=True)
    for _ in range(2):
        if _complete_part(part_path(path), site, shard, report) == shard.sha256:
            with writing(path):
                part_path(path).replace(path)
            checked.remember(shard)
            return
        with writing(path):
            part_path(path).unlink()
    raise RemoteError(
        f"{site.web.address(shard.name)}: received bytes do not match the published hash; none are kept: try again "
        "later, or tell its publisher"
    )


def _complete_part(part: Path, site: Site, shard: ShardRecord, report: Callable[[int], None]) -> str:
    """Download the rest of a ``.part`` file; the SHA-256 of the whole."""
    digest = hashlib.sha256()
    with _appending(part) as file:
        if os.fstat(file).st_size > shard.size:
            os.ftruncate(file, 0)
        offset = 0
        while piece := os.pread(file, 1 << 20, offset):
            digest.update(piece)
            offset += len(piece)
        report(offset)
        for piece in site.web.pieces(shard.name, offset, shard.size) if offset < shard.size else ():
            with writing(part):
                offset += _write_all(file, piece, offset)
            digest.update(piece)
            report(offset)
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


def _write_all(file: int, piece: bytes, offset: int) -> int:
    rest = memoryview(piece)
    while rest:
        rest = rest[os.pwrite(file, rest, offset + len(piece) - len(rest)) :]
    return len(piece)


# ------------------------------------------------------------------------------------------------------------- fields


def _download_fields(folder: Path, reader: ShardReader, layout: Layout, on_progress: Progress) -> list[ShardRecord]:
    """Write shards of the same names and samples, with the members of ``layout`` only."""
    columns = [reader.layout.members.index(member) for member in layout.members]
    index = reader.index
    total, received = int(index.table.size[:, columns].sum()), [0] * len(index.shards)
    records: list[ShardRecord | None] = [None] * len(index.shards)
    tables = {}
    position_of = dict(zip(reader.rows(range(len(reader))).tolist(), range(len(reader)), strict=True))

    def download_number(number: int) -> None:
        positions = [position_of[row] for row in (index.shard == number).nonzero()[0].tolist()]

        def report(size: int) -> None:
            received[number] += size
            on_progress(sum(received), total)

        shard, table = copy_shard(folder / index.shards[number], reader, positions, layout, report)
        records[number], tables[index.shards[number]] = shard, table

    _run_all(download_number, len(index.shards), 1)  # samples of one shard are fetched in parallel already
    ShardIndex.of(folder, {name: tables[name] for name in index.shards}, layout).write(
        folder / index_name(reader.split)
    )
    return [shard for shard in records if shard is not None]


def _run_all(task: Callable[[int], None], count: int, threads: int) -> None:
    """Run ``task`` for all numbers below ``count``; after an error finish running tasks and start no others."""
    with ThreadPoolExecutor(threads) as pool:
        jobs = [pool.submit(task, number) for number in range(count)]
        try:
            for job in jobs:
                job.result()
        finally:
            for job in jobs:
                job.cancel()


def _no_progress(received: int, total: int) -> None:
    """A ``Progress`` that does nothing."""
