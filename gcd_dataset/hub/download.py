"""Downloads splits into a folder: whole verified tars, then indices, then the manifest. A stopped download continues.

download.json                      source and revision of the data set
.train-00012.tar.part              a tar whose download was stopped
train.index, manifest.json         written last
"""

import hashlib
import json
import shutil
from collections.abc import Callable, Container, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np

from gcd_dataset.errors import ConfigError, OutputError
from gcd_dataset.files import make_folder, write_whole
from gcd_dataset.hub.fetch import fetch
from gcd_dataset.hub.remote import Remote, RemoteStore, run_all
from gcd_dataset.hub.source import MAIN, Repo, Url
from gcd_dataset.shards.access import locked, reading, writing
from gcd_dataset.shards.index import SplitIndex, index_name
from gcd_dataset.shards.layout import is_picture
from gcd_dataset.shards.manifest import MANIFEST, Manifest, SplitRecord, read_manifest
from gcd_dataset.shards.notes import hashed
from gcd_dataset.shards.store import DOWNLOAD_FILE, downloaded_from

Tars = Mapping[str, tuple[int, str]]  # name of a tar to its size [bytes] and SHA-256


def download(
    source: Repo | Url,
    folder: Path,
    remote: Remote | None = None,
    *,
    splits: Sequence[str] = (),
    views: bool = True,
    on_progress: Callable[[int, int], None] = lambda received, total: None,
) -> Manifest:
    """Download ``splits``, by default all, into ``folder`` as a data set, with or without pictures; its manifest.

    Every tar is verified by its SHA-256, those in the folder too: a second call downloads changed and damaged ones.
    ``on_progress`` is called with the bytes received, and the bytes in total. Raises ``RemoteError`` for a server that
    fails for longer than the patience, ``ConfigError`` for a folder that holds another data set, ``OutputError`` for
    one that cannot be written.
    """
    store = RemoteStore(source, remote or Remote())
    indices = {split: _index(store, split, views=views) for split in splits or store.manifest().splits}
    chosen = {split: index.record for split, index in indices.items()}
    with locked(make_folder(folder) / ".download.lock", "downloading", wait=True):
        manifest = _begin(folder, store, chosen)
        _download_tars(folder, store, tars_of(chosen), on_progress)
        remove_others(folder, tars_of(store.manifest().splits))
        for split, index in indices.items():
            write_changed(folder / index_name(split), index.to_bytes())
        write_changed(folder / MANIFEST, manifest.to_bytes())
    return manifest


def is_downloaded(folder: Path, source: Repo | Url, splits: Sequence[str], *, offline: bool = False) -> bool:
    """Whether a folder holds whole splits of ``source``; no server is asked, which alone knows the commit of a tag.

    ``offline``: what there is must do. Raises ``ConfigError`` for a folder of another source.
    """
    known = downloaded_from(folder) if folder.is_dir() else None
    is_pinned = isinstance(source, Repo) and source.is_pinned
    is_tag = isinstance(source, Repo) and not is_pinned and source.revision != MAIN
    address = f"hf://datasets/{source.name}" if isinstance(source, Repo) else source.url
    is_same = str(source) == known if is_pinned else (known or "").rpartition("@")[0] == address
    if offline and known and not is_same:
        raise ConfigError(f"{folder}: holds {known}, asked for {source}: choose another folder")
    if offline or not is_same or is_tag or (manifest := read_manifest(folder)) is None:
        return offline
    if not {*splits} <= manifest.splits.keys():
        return False
    wanted = tars_of({split: manifest.splits[split] for split in splits})
    return all(_has(folder, name, size) for name, (size, _) in wanted.items())


def _index(store: RemoteStore, split: str, *, views: bool) -> SplitIndex:
    """The index of a split, on request without pictures; its ``record`` is that of the downloaded split."""
    index = store.index(split)
    if views or not index.has_views:
        return index
    shards = tuple(replace(shard, views_size=0, views_sha256="") for shard in index.record.shards)
    members = tuple(member for member in index.record.members if not is_picture(member))
    bare = replace(index, views_blocks=np.zeros(0, np.int32))
    digest = hashlib.sha256(bare.to_bytes()).hexdigest()
    return replace(bare, record=replace(index.record, shards=shards, members=members, index_sha256=digest))


def _begin(folder: Path, store: RemoteStore, chosen: Mapping[str, SplitRecord]) -> Manifest:
    """Prepare the folder for the splits; the manifest that it gets. Raises ``ConfigError`` for another data set."""
    source, published, known = str(store.source), store.manifest(), downloaded_from(folder)
    local = (read_manifest(folder) or Manifest()).splits
    if known is None and (local or tar_files(folder)):
        raise ConfigError(f"{folder}: holds a data set that was not downloaded: choose another folder")
    if known != source:
        if known and (known.rpartition("@")[0] != source.rpartition("@")[0] or source.startswith("hf://")):
            raise ConfigError(f"{folder}: holds {known}, asked for {source}: choose another folder, or that revision")
        for split, record in local.items():
            if split not in published.splits:
                raise ConfigError(f"{folder}: holds {known}; the URL has no split {split} now: choose another folder")
            record.plan.require_same(published.splits[split].plan, folder)
        with writing(folder / MANIFEST):
            (folder / MANIFEST).unlink(missing_ok=True)  # written anew at the end
        write_whole(folder / DOWNLOAD_FILE, (json.dumps({"source": source}) + "\n").encode())
    kept = {
        split: replace(record, plan=published.splits[split].plan)
        for split, record in local.items()
        if known == source or record.shards == published.splits[split].shards
    }
    splits = dict(sorted({**kept, **chosen}.items()))
    if splits.keys() < published.splits.keys() and not any(map(published.missing, published.splits)):
        count = sum(record.count + record.skipped for record in splits.values())  # so that they are not unfinished
        splits = {split: replace(record, plan=replace(record.plan, count=count)) for split, record in splits.items()}
    return replace(published, splits=splits)


def _download_tars(folder: Path, store: RemoteStore, tars: Tars, on_progress: Callable[[int, int], None]) -> None:
    """Download the tars that are missing or damaged."""
    received = {name: size if _has(folder, name, size) else 0 for name, (size, _) in tars.items()}
    total = sum(size for size, _ in tars.values())
    begun = sum(path.stat().st_size for path in folder.rglob(".*.tar.part"))
    if (needed := total - sum(received.values()) - begun) > (free := shutil.disk_usage(folder).free):
        raise OutputError(f"{folder}: {needed} bytes are needed, and {free} are free: make room, or choose another one")

    def report(name: str, size: int) -> None:
        received[name] = size
        on_progress(sum(received.values()), total)

    def download_tar(name: str) -> None:
        path = folder / name
        with writing(path):
            if path.exists() and not (_has(folder, name, tars[name][0]) and hashed(path) == tars[name]):
                path.unlink()
        fetch(store.files, name, path, *tars[name], on_progress=partial(report, name))
        report(name, tars[name][0])

    on_progress(sum(received.values()), total)
    run_all(store.files, download_tar, tars)


def _has(folder: Path, name: str, size: int) -> bool:
    path = folder / name
    return path.exists() and path.stat().st_size == size


def tars_of(splits: Mapping[str, SplitRecord]) -> Tars:
    """The tars of splits, those of the pictures included."""
    tars = {}
    for split, record in splits.items():
        for shard in record.shards:
            tars[shard.name(split)] = shard.size, shard.sha256
            if shard.views_size:
                tars[shard.views_name(split)] = shard.views_size, shard.views_sha256
    return tars


def tar_files(folder: Path) -> list[Path]:
    """The tars in a folder, those of the pictures included. Raises ``ShardError``."""
    with reading(folder):
        return [*folder.glob("*.tar"), *folder.glob("views/*.tar")]


def remove_others(folder: Path, names: Container[str]) -> None:
    """Remove all tars but these; readers of the folder would find them. Raises ``OutputError``."""
    for path in tar_files(folder):
        if path.relative_to(folder).as_posix() not in names:
            with writing(path):
                path.unlink()


def write_changed(path: Path, content: bytes) -> None:
    """Write a file, unless it has this content."""
    if not path.exists() or path.read_bytes() != content:
        write_whole(path, content)
