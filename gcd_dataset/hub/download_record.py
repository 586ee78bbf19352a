"""What a folder holds of a data set that is downloaded into it: of which place, which revision, and whether all."""

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


def completed_download(folder: Path, place: Repo | Url, split: str, wanted: Layout) -> DownloadRecord | None:
    """The record of a folder that holds all that is wanted, so that no server need be asked; else ``None``.

    Raises ``ShardError`` for a record that is broken.
    """
    there = read_download_record(folder) if folder.is_dir() else None
    known = None if there is None else there.splits.get(split)
    if (
        there is None
        or known is None
        or not known.whole
        or not fields_of(wanted.members).keys() <= fields_of(known.members).keys()
    ):
        return None
    return there if _is_from(there, place) and _has_shards(folder, split) else None


def require_same_source(folder: Path, place: Repo | Url) -> None:
    """Raise ``ConfigError`` for a folder that was downloaded from elsewhere; what a tag stood for, nobody can tell."""
    there = read_download_record(folder)
    known = place if isinstance(place, Url) or place.is_pinned else replace(place, revision=MAIN)
    if there is not None and not _is_from(there, known):
        raise ConfigError(f"{folder}: holds {there.source}, asked for {place}: choose another folder")


def begin_split(folder: Path, source: str, split: str, layout: Layout, manifest: Manifest) -> None:
    """Note that a split of ``source``, whose manifest this is, is about to come, and remove what is no part of it.

    Raises ``ConfigError`` for a folder that holds something else, ``OutputError`` for one that cannot be written.
    """
    with download_record_lock(folder):
        before = read_download_record(folder)
        _begun(folder, source, split, layout, manifest).write(folder)
        if read_manifest(folder) is None:
            replace(manifest, splits={}).write(folder)  # it says who made the data set
    known = None if before is None else before.splits.get(split)
    if known is not None and tuple(known.members) != layout.members:
        _drop_begun(folder, split)
    _drop_others(folder, split, manifest.splits[split])


def finish_split(folder: Path, source: str, split: str, layout: Layout) -> DownloadRecord:
    """Note that all of a split has come, unless the folder follows a later revision meanwhile; the record."""
    with download_record_lock(folder):
        note = read_download_record(folder) or DownloadRecord(source)
        if note.source == source:
            note = note.with_split(split, DownloadedSplit(layout.members, whole=True))
            note.write(folder)
    return note


def _is_from(there: DownloadRecord, place: Repo | Url) -> bool:
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


def _begun(folder: Path, source: str, split: str, layout: Layout, manifest: Manifest) -> DownloadRecord:
    """The record of the folder, with this split about to come. Raises ``ConfigError`` if another is there."""
    there = read_download_record(folder)
    if there is None and (read_manifest(folder) is not None or splits_in(folder)):
        raise ConfigError(f"{folder}: holds a data set that was not downloaded: choose another folder")
    note = there or DownloadRecord(source)
    if note.source != source:
        note = _followed(folder, note, source, manifest)
    known = note.splits.get(split)
    was_whole = split in (read_manifest(folder) or Manifest()).splits
    if known is not None and tuple(known.members) != layout.members and was_whole:
        had, now = (", ".join(member.split(".")[0] for member in some) for some in (known.members, layout.members))
        raise ConfigError(f"{folder}: holds the fields {had} of split {split}, asked for {now}: choose another folder")
    return note.with_split(split, DownloadedSplit(layout.members))


def _followed(folder: Path, note: DownloadRecord, source: str, manifest: Manifest) -> DownloadRecord:
    """The record of a folder whose URL holds more by now; splits of it that have changed are no longer whole.

    Raises ``ConfigError`` for another place, another commit, or a URL at which another data set is.
    """
    url = source.rpartition("@")[0]
    if note.source.rpartition("@")[0] != url or url.startswith("hf://"):
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
    return DownloadRecord(source, splits)


def _way(record: SplitRecord) -> SplitRecord:
    """How the samples of a split are made, and numbered, however many there are."""
    return replace(record, shards=())


def _drop_begun(folder: Path, split: str) -> None:
    """Remove what a download of other fields, which was never whole, has left."""
    for path in folder.iterdir():
        if shard_number(path.name.removesuffix(".part"), split) is not None:
            with writing(path):
                path.unlink()


def _drop_others(folder: Path, split: str, record: SplitRecord) -> None:
    """Remove shards that are no longer part of the split, which readers of the folder would find."""
    listed = {shard.name for shard in record.shards}
    for path in shards_in(folder, split):
        if path.name not in listed:
            with writing(path):
                path.unlink()
