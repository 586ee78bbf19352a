"""The state of a download folder: source, revision, completed splits."""

import logging
from dataclasses import replace
from pathlib import Path

from gcd_dataset.errors import ConfigError
from gcd_dataset.hub.source import MAIN, Repo, Url
from gcd_dataset.shards.access import reading, writing
from gcd_dataset.shards.contents import splits_in
from gcd_dataset.shards.download_file import DownloadedSplit, DownloadRecord, download_record_lock, read_download_record
from gcd_dataset.shards.layout import Layout, fields_of, shard_number, shards_in
from gcd_dataset.shards.manifest import Manifest, SplitRecord, read_manifest

__all__ = ["begin_split", "completed_download", "finish_split", "require_same_source"]

log = logging.getLogger(__name__)


def completed_download(folder: Path, source: Repo | Url, split: str, wanted: Layout) -> DownloadRecord | None:
    """The record of a folder with a complete download of the ``wanted`` members; else ``None``. Asks no server.

    Raises ``ShardError`` for a broken record.
    """
    record = read_download_record(folder) if folder.is_dir() else None
    known = None if record is None else record.splits.get(split)
    if (
        record is None
        or known is None
        or not known.whole
        or not fields_of(wanted.members).keys() <= fields_of(known.members).keys()
    ):
        return None
    return record if _is_from(record, source) and _has_shards(folder, split) else None


def require_same_source(folder: Path, source: Repo | Url) -> None:
    """Raise ``ConfigError`` for a folder downloaded from another source. Branches and tags are not compared."""
    record = read_download_record(folder)
    comparable = source if isinstance(source, Url) or source.is_pinned else replace(source, revision=MAIN)
    if record is not None and not _is_from(record, comparable):
        raise ConfigError(f"{folder}: holds {record.source}, asked for {source}: choose another folder")


def begin_split(folder: Path, source: str, split: str, layout: Layout, manifest: Manifest) -> None:
    """Record the start of a split's download, and remove shards that are no longer part of it.

    ``manifest``: of the data set at ``source``. Raises ``ConfigError`` for a folder that holds another data set,
    ``OutputError`` for one that cannot be written.
    """
    with download_record_lock(folder):
        before = read_download_record(folder)
        _started_record(folder, source, split, layout, manifest).write(folder)
        if read_manifest(folder) is None:
            replace(manifest, splits={}).write(folder)  # keeps generator version and recipe
    known = None if before is None else before.splits.get(split)
    if known is not None and tuple(known.members) != layout.members:
        _remove_shards(folder, split)
    _remove_unlisted(folder, split, manifest.splits[split])


def finish_split(folder: Path, source: str, split: str, layout: Layout) -> DownloadRecord:
    """Record a split as complete, unless the folder is now at another revision; returns the record."""
    with download_record_lock(folder):
        record = read_download_record(folder) or DownloadRecord(source)
        if record.source == source:
            record = record.with_split(split, DownloadedSplit(layout.members, whole=True))
            record.write(folder)
    return record


def _is_from(record: DownloadRecord, source: Repo | Url) -> bool:
    """Whether a folder was downloaded from ``source``, at its revision if it has one."""
    name, _, revision = record.source.rpartition("@")
    if isinstance(source, Url):
        return name == source.url and source.revision in ("", revision)
    return name == f"hf://datasets/{source.name}" and source.revision in (MAIN, revision)


def _has_shards(folder: Path, split: str) -> bool:
    """Whether all shards of the folder's manifest are on disk with their sizes."""
    record = (read_manifest(folder) or Manifest()).splits.get(split)
    with reading(folder):
        size = {path.name: path.stat().st_size for path in shards_in(folder, split)}
    return record is not None and all(size.get(shard.name) == shard.size for shard in record.shards)


def _started_record(folder: Path, source: str, split: str, layout: Layout, manifest: Manifest) -> DownloadRecord:
    """The folder's record with this split incomplete. Raises ``ConfigError`` for a folder with another data set."""
    existing = read_download_record(folder)
    if existing is None and (read_manifest(folder) is not None or splits_in(folder)):
        raise ConfigError(f"{folder}: holds a data set that was not downloaded: choose another folder")
    record = existing or DownloadRecord(source)
    if record.source != source:
        record = _updated_record(folder, record, source, manifest)
    known = record.splits.get(split)
    was_whole = split in (read_manifest(folder) or Manifest()).splits
    if known is not None and tuple(known.members) != layout.members and was_whole:
        had, now = (
            ", ".join(member.split(".")[0] for member in members) for members in (known.members, layout.members)
        )
        raise ConfigError(f"{folder}: holds the fields {had} of split {split}, asked for {now}: choose another folder")
    return record.with_split(split, DownloadedSplit(layout.members))


def _updated_record(folder: Path, record: DownloadRecord, source: str, manifest: Manifest) -> DownloadRecord:
    """The record for a later revision of the same URL; changed splits become incomplete.

    Raises ``ConfigError`` for another source or commit, and for a URL that now holds another data set.
    """
    url = source.rpartition("@")[0]
    if record.source.rpartition("@")[0] != url or url.startswith("hf://"):
        raise ConfigError(
            f"{folder}: holds {record.source}, asked for {source}: choose another folder, or that revision"
        )
    local = read_manifest(folder) or Manifest()
    for name, split_record in local.splits.items():
        if name not in manifest.splits or _without_shards(split_record) != _without_shards(manifest.splits[name]):
            raise ConfigError(
                f"{folder}: holds {record.source}; the URL now has another data set, with another seed, recipe or "
                f"split than {name}: choose another folder"
            )
    log.info("%s: %s has changed since: downloading the changes", folder, url)
    same = {name for name in record.splits if local.splits.get(name) == manifest.splits.get(name)}
    splits = {name: replace(split, whole=split.whole and name in same) for name, split in record.splits.items()}
    return DownloadRecord(source, splits)


def _without_shards(record: SplitRecord) -> SplitRecord:
    """Seed, recipe, shard size and kind alone."""
    return replace(record, shards=())


def _remove_shards(folder: Path, split: str) -> None:
    """Remove all shards of a split, left by an incomplete download of other fields."""
    for path in folder.iterdir():
        if shard_number(path.name.removesuffix(".part"), split) is not None:
            with writing(path):
                path.unlink()


def _remove_unlisted(folder: Path, split: str, record: SplitRecord) -> None:
    """Remove shards that are no longer part of the split, since readers of the folder would find them."""
    listed = {shard.name for shard in record.shards}
    for path in shards_in(folder, split):
        if path.name not in listed:
            with writing(path):
                path.unlink()
