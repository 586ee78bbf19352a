"""Data sets on servers: pinned to a revision, read by shards that lie in the cache, or by ranges of single samples.

sets/NAME-HASH/refs/main           the revision of a branch, or of a URL, when it was last read
sets/NAME-HASH/REVISION/…          manifest and indices
shards/SHA256/{tar,views}          whole shards
"""

import contextlib
import hashlib
import logging
import math
import os
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from copy import copy
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TypeVar
from urllib.parse import quote

from gcd_dataset.errors import ConfigError, GcdError, MissingError, OutputError, RefusedError, RemoteError, ShardError
from gcd_dataset.files import make_folder, safe_name, user_path, write_whole
from gcd_dataset.hub.fetch import WEB, Files, fetch
from gcd_dataset.hub.source import COMMIT, Folder, Repo, Url, parse_source
from gcd_dataset.shards import cache
from gcd_dataset.shards.index import SplitIndex, index_name
from gcd_dataset.shards.manifest import MANIFEST, Manifest, ShardRecord, parse_manifest
from gcd_dataset.shards.store import FolderStore, Store

T = TypeVar("T")

LARGEST_MANIFEST = 1 << 24  # bytes: ten million garments; parsed it takes twenty times as many
LARGEST_SAMPLE = 1 << 26  # bytes; a dress meshed at 0.2 cm takes 25 MB, uncompressed
MOST_SAMPLES = 12_000_000  # of a split; checking their index takes .8 GB of memory
PARALLEL, REQUESTS = 4, 8  # downloads, and requests of single samples, at a time
REPUBLISH = "ask its publisher to run gcd index and publish it again"

log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Remote:
    """Options of access to servers, and of the cache."""

    revision: str | None = None
    cache_dir: str | Path | None = None
    max_cache_size: int | str | None = cache.SIZE
    endpoint: str | None = None
    token: str | None = None
    allowed: bool = True
    """Whether servers may be contacted."""
    patience: float | None = None
    """Seconds since the last received byte after which a request is given up; ``None`` for ``fetch.PATIENCE``."""

    def __post_init__(self) -> None:
        if self.patience is not None and not 0 <= self.patience <= math.inf:
            raise ConfigError(f"patience={self.patience!r}: give seconds, 0 or more; inf waits forever")
        cache.size_in_bytes(self.max_cache_size)

    @property
    def folder(self) -> Path:
        """The folder of the cache."""
        return cache.default_cache(self.cache_dir)

    def address(self, source: Repo | Url) -> str:
        """The URL of a repository, or of a folder of files."""
        return f"{hub_endpoint(self.endpoint)}/datasets/{source.name}" if isinstance(source, Repo) else source.url

    def files(self, source: Repo | Url) -> Files:
        """The files of a source. Raises ``ConfigError`` for an option of the Hub with the URL of an object store."""
        if isinstance(source, Repo):
            from huggingface_hub.utils import build_hf_headers  # type: ignore[attr-defined]

            headers = partial(build_hf_headers, token=self.token, library_name="gcd_dataset")
            url = f"{self.address(source)}/resolve/{quote(source.revision, safe='')}"
            return Files(url, headers=headers, patience=self.patience)
        if not source.url.startswith(WEB) and (self.endpoint, self.token) != (None, None):
            raise ConfigError(f"endpoint and token are for the Hub, not for {source}: set the variables of its store")
        return Files(source.url, patience=self.patience)


def hub_endpoint(endpoint: str | None) -> str:
    """The URL of the Hub: ``endpoint``, else ``HF_ENDPOINT``, else the default."""
    from huggingface_hub import constants

    return (endpoint or constants.ENDPOINT).rstrip("/")


def open_store(
    source: str | Path, remote: Remote | None = None, *, root: str | Path | None = None, splits: Sequence[str] = ()
) -> Store:
    """The store of a folder, a URL or a repository; ``root``: a folder to download ``splits`` into, and to read.

    Raises ``ConfigError`` for any other source, and for options that do not apply to it; else as ``Store``.
    """
    from gcd_dataset.hub.download import download, is_downloaded

    remote = remote or Remote()
    parsed = parse_source(source, remote.revision)
    if isinstance(parsed, Folder):
        given = {"root": root, "endpoint": remote.endpoint, "token": remote.token, "patience": remote.patience}
        if named := [name for name, value in given.items() if value is not None]:
            raise ConfigError(f"{named[0]} is for URLs and the Hub, and {parsed} is a folder: leave it out")
        root = parsed.path
    elif root is None:
        return RemoteStore(parsed, remote)
    elif not is_downloaded(folder := user_path(root), parsed, splits, offline=not remote.allowed):
        download(parsed, folder, remote, splits=splits)
    return FolderStore(root, cache_dir=remote.cache_dir)


class RemoteStore(Store):
    """A repository at a commit, or a URL at a hash of its manifest. The revision is looked up once.

    If the server is unreachable, the last revision seen is used, limited to the cached files. Raises ``MissingError``
    where the server has no such data set, ``RemoteError`` where it is unreachable and nothing is cached.
    """

    remedy = "try again later, or tell its publisher"

    def __init__(self, source: Repo | Url, remote: Remote) -> None:
        self._asked, self._remote, self.cache = source, remote, remote.folder / "shards"
        self._manifest: Manifest | None = None
        address = remote.address(source)
        digest = hashlib.sha256(address.encode()).hexdigest()[:16]
        self._folder = remote.folder / "sets" / safe_name(f"{address.rpartition('/')[2]}-{digest}")
        self.revision = source.revision if isinstance(source, Repo) and source.is_pinned else self._look_up()
        if isinstance(source, Repo):
            source = replace(source, revision=self.revision)
        self.source = str(source) if isinstance(source, Repo) else f"{source}@{self.revision}"
        self.files = remote.files(source)
        self.manifest()

    def location(self, name: str = "") -> str:
        return f"{self.source}/{name}" if name else str(self.source)

    def manifest(self) -> Manifest:
        if self._manifest is None:
            self._manifest = self._cached(MANIFEST, LARGEST_MANIFEST, self._parse_manifest)
        return self._manifest

    def index(self, split: str) -> SplitIndex:
        record, name = self.record(split), index_name(split)
        location = self.location(name)
        if record.count > MOST_SAMPLES:
            raise RemoteError(f"{self.location()}: {record.count} samples in a split, over the limit of {MOST_SAMPLES}")

        def parse(content: bytes) -> SplitIndex:
            if hashlib.sha256(content).hexdigest() != record.index_sha256:
                raise RemoteError(f"{location}: received bytes do not match the published hash: {REPUBLISH}")
            return SplitIndex.from_bytes(content, record, location, REPUBLISH)

        try:
            return self._cached(name, 16 * record.count + (1 << 12), parse)
        except MissingError as error:
            raise MissingError(f"{error}: {REPUBLISH}") from error

    def path(self, split: str, shard: ShardRecord, *, views: bool = False) -> Path:
        folder, kind = self.cache / shard.sha256, "views" if views else "tar"
        size, sha256 = (shard.views_size, shard.views_sha256) if views else (shard.size, shard.sha256)
        name = shard.name(split, views=views)
        if not (folder / kind).exists():
            self._require_allowed(name)
            if not size:
                raise ShardError(f"{self.location(name)}: these garments have no pictures: leave their fields out")
            cache.make_room(self.cache, size, cache.size_in_bytes(self._remote.max_cache_size))
            fetch(self.files, name, folder / kind, size, sha256, part=self.cache / f".{shard.sha256}.{kind}.part")
        cache.touch(folder)
        return folder / kind

    def part(self, split: str, shard: ShardRecord, start: int, end: int, *, views: bool = False) -> bytes:
        cached = self.cache / shard.sha256 / ("views" if views else "tar")
        with contextlib.suppress(OSError), cached.open("rb") as file:
            if len(content := os.pread(file.fileno(), end - start, start)) == end - start:
                return content
        name = shard.name(split, views=views)
        self._require_allowed(name)
        if end - start > LARGEST_SAMPLE:
            raise RemoteError(
                f"{self.location(name)}: a sample of {end - start} bytes, over the limit of {LARGEST_SAMPLE}: tell its "
                "publisher"
            )
        return self.files.read(name, start, end, limit=LARGEST_SAMPLE)[0]

    def parts(self, split: str, wanted: Sequence[tuple[ShardRecord, int, int, bool]]) -> Iterable[bytes]:
        with ThreadPoolExecutor(REQUESTS) as pool:
            for first in range(0, len(wanted), REQUESTS):  # not all at once: a stranger says how long samples are
                some = wanted[first : first + REQUESTS]
                yield from pool.map(lambda one: self.part(split, *one[:3], views=one[3]), some)

    def ensure(self, split: str, shards: Iterable[ShardRecord], *, views: bool = False) -> None:
        """Fetch whole tars of several shards into the cache, in parallel. Raises as ``path`` does."""
        store = copy(self)
        store.files = copy(self.files)  # stopped after an error
        run_all(store.files, partial(store.path, split, views=views), shards)

    def _parse_manifest(self, content: bytes) -> Manifest:
        return parse_manifest(content, f"{self._asked}/{MANIFEST}", self.remedy)

    def _look_up(self) -> str:
        """The revision of a branch, tag or URL: the server's, else the last one seen."""
        reference = self._folder / "refs" / safe_name(self._asked.revision if isinstance(self._asked, Repo) else "now")
        files = self._remote.files(self._asked)
        if reference.exists():
            files.patience = 0.0  # there is a revision to read
        try:
            self._require_allowed(MANIFEST)
            # The Hub names the commit in the answer.
            self._manifest, content, headers = _read(files, MANIFEST, LARGEST_MANIFEST, self._parse_manifest)
            revision = hashlib.sha256(content).hexdigest()
            if isinstance(self._asked, Repo) and COMMIT.fullmatch(revision := headers.get("X-Repo-Commit", "")) is None:
                raise RemoteError(f"{self._asked}: {ascii(revision)[:80]} is not a commit of the Hub: check endpoint")
        except RefusedError:
            raise
        except MissingError as error:
            raise MissingError(f"{error}; a data set becomes visible when its upload is complete") from error
        except RemoteError as error:
            with contextlib.suppress(OSError, ValueError):
                if re.fullmatch(r"[0-9a-f]{40,64}", known := reference.read_text()):
                    if self._remote.allowed:
                        log.warning("%s; continuing with the cached revision %s", error, known)
                    return known
            raise
        _write_cache(reference, revision.encode())
        _write_cache(self._folder / revision / MANIFEST, content)
        return revision

    def _cached(self, name: str, limit: int, parse: Callable[[bytes], T]) -> T:
        """A small file of this revision, from the cache; a missing or damaged one is fetched."""
        path = self._folder / self.revision / name
        with contextlib.suppress(OSError, ShardError):
            return parse(path.read_bytes())
        self._require_allowed(name)
        parsed, content, _ = _read(self.files, name, limit, parse)
        _write_cache(path, content)
        return parsed

    def _require_allowed(self, name: str) -> None:
        """Raise ``RemoteError`` if servers may not be contacted; ``name``: the file that is missing in the cache."""
        from huggingface_hub import constants

        if not self._remote.allowed:
            raise RemoteError(f"{self._asked}: {name} is not in the cache, and download=False: allow downloads")
        if constants.HF_HUB_OFFLINE and isinstance(self._asked, Repo):
            raise RemoteError(f"{self._asked}: {name} is not in the cache, and HF_HUB_OFFLINE is set: unset it")


def _read(files: Files, name: str, limit: int, parse: Callable[[bytes], T]) -> tuple[T, bytes, Mapping[str, str]]:
    """A small file, parsed and as received, and the headers of the answer; a damaged one is asked for again once."""
    content, headers = files.read(name, limit=limit)
    try:
        return parse(content), content, headers
    except ShardError:
        again, headers = files.read(name, limit=limit)
        if again == content:
            raise
        return parse(again), again, headers


def run_all(files: Files, task: Callable[[T], object], shards: Iterable[T]) -> None:
    """Run ``task`` for all shards, ``PARALLEL`` at a time; the first error stops the requests of ``files``."""
    errors: list[GcdError] = []

    def run(shard: T) -> None:
        try:
            if not errors:
                task(shard)
        except GcdError as error:
            errors.append(error)
            files.stopped = True  # before this thread takes the next shard

    with ThreadPoolExecutor(PARALLEL) as pool:
        try:
            list(pool.map(run, shards))
        except BaseException:
            files.stopped = True
            pool.shutdown(cancel_futures=True)
            raise
    if errors:
        raise errors[0]


def _write_cache(path: Path, content: bytes) -> None:
    """Write a file of the cache; logs a warning where that fails."""
    try:
        make_folder(path.parent)
        write_whole(path, content)
    except OutputError as error:
        log.warning("%s; continuing without caching", error)
