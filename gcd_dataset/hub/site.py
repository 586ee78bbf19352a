"""A data set on a server, pinned to a revision, with its small files cached on disk."""

import contextlib
import hashlib
import json
import logging
import math
import re
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property, partial
from pathlib import Path
from urllib.parse import quote

from gcd_dataset.errors import ConfigError, MissingError, OutputError, RefusedError, RemoteError
from gcd_dataset.files import make_folder, user_path, write_whole
from gcd_dataset.hub.objects import Objects
from gcd_dataset.hub.source import COMMIT, Repo, Url, slug
from gcd_dataset.hub.web import Web
from gcd_dataset.names import require_name, safe_name
from gcd_dataset.shards import limits
from gcd_dataset.shards.manifest import MANIFEST

__all__ = ["Remote", "Site", "hub_endpoint"]

LARGEST_MANIFEST, LARGEST_INDEX = limits.LARGEST_MANIFEST, limits.LARGEST_FILE  # bytes
LARGEST_LISTING = 64 << 20  # bytes: a million files of a repository
LISTING = "files.json"
CHECK = "check endpoint"
REVISION = re.compile(r"[0-9a-f]{40,64}")

log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Remote:
    """Options of access to servers, and of the cache."""

    revision: str | None = None
    cache_dir: str | Path | None = None
    max_cache_size: int | str | None = None
    endpoint: str | None = None
    token: str | None = None
    allowed: bool = True
    """Whether servers may be contacted."""
    patience: float | None = None
    """Seconds to wait for an unreachable or busy server; ``None`` for ``retry.PATIENCE``."""

    def __post_init__(self) -> None:
        if self.patience is not None and not 0 <= self.patience <= math.inf:
            raise ConfigError(f"patience={self.patience!r}: give seconds, 0 or more; inf waits forever")

    @property
    def folder(self) -> Path:
        """The folder of the cache."""
        return Path.home() / ".cache" / "gcd_dataset" if self.cache_dir is None else user_path(self.cache_dir)


def hub_endpoint(endpoint: str | None) -> str:
    """The URL of the Hub: ``endpoint``, else ``HF_ENDPOINT``, else the default."""
    from huggingface_hub import constants

    return (endpoint or constants.ENDPOINT).rstrip("/")


class Site:
    """A repository at a commit, or a URL at a hash of its manifest. The revision is looked up once.

    If the server is unreachable, the last revision seen is used, limited to the cached files. Raises ``MissingError``
    where the server has no such data set, ``RemoteError`` where it is unreachable and nothing is cached.
    """

    def __init__(self, source: Repo | Url, remote: Remote) -> None:
        self._parsed, self._remote = source, remote
        self._folder = remote.folder / "sets" / self._slug()
        self._headers = partial(_hub_headers, remote.token)
        if isinstance(source, Repo):
            base = f"{hub_endpoint(remote.endpoint)}/datasets/{source.name}/resolve"
            self.revision = source.revision if source.is_pinned else self._look_up(source.revision, self._commit)
            self.web: Web | Objects = Web(f"{base}/{self.revision}", headers=self._headers, patience=remote.patience)
            self.source = str(Repo(source.name, self.revision))
        else:
            _require_unused(source, remote)
            self.web = self._files()
            self.revision = self._look_up("now", self._manifest_hash)
            self.source = f"{source.url}@{self.revision}"

    @property
    def allowed(self) -> bool:
        """Whether the server may be contacted."""
        return self._remote.allowed

    @cached_property
    def names(self) -> tuple[str, ...]:
        """File names of a repository. Raises ``ConfigError`` for a URL, where files cannot be listed."""
        if not isinstance(self._parsed, Repo):
            raise ConfigError(f"{self._parsed}: a URL cannot list its files: give a folder, or a repository of the Hub")
        content = self.cached(LISTING, lambda: self._api(self.revision).get("", LARGEST_LISTING))
        try:
            return tuple(sorted(str(file["rfilename"]) for file in json.loads(content)["siblings"]))
        except (ValueError, KeyError, TypeError, RecursionError) as error:
            self.forget(LISTING)
            raise RemoteError(f"{self._parsed}: the answer is not a file list of the Hub: {CHECK}") from error

    def small_file(self, name: str) -> bytes:
        """A small file, cached. Raises ``MissingError``, and ``RemoteError`` for a damaged one."""
        marker = self._path(f"{name}.missing")
        if marker.exists():
            raise MissingError(f"{self.source}: has no {name}")
        try:
            return self.cached(name, lambda: self._checked(self.web, name))
        except MissingError:
            if isinstance(self._parsed, Repo):  # a URL may get the file later
                _write_cache(marker, b"")
            raise

    def forget(self, name: str) -> None:
        """Remove an invalid small file from the cache, if it may be fetched again."""
        with contextlib.suppress(OSError):
            if self.allowed:
                self._path(name).unlink(missing_ok=True)

    def cached(self, name: str, get: Callable[[], bytes]) -> bytes:
        """The cached content under a name; else the result of ``get``, which is then cached."""
        path = self._path(name)
        with contextlib.suppress(OSError):
            return path.read_bytes()
        self.require_allowed(name)
        content = get()
        _write_cache(path, content)
        return content

    def require_allowed(self, name: str) -> None:
        """Raise ``RemoteError`` if servers may not be contacted; ``name``: the item that is missing in the cache."""
        if not self.allowed:
            raise RemoteError(f"{self._parsed}: {name} is not in the cache, and download=False: allow downloads")

    def _path(self, name: str) -> Path:
        """Cache path of a file of this revision. Raises ``ShardError`` for an unsafe name."""
        return self._folder / self.revision / require_name(name, self.source)

    @staticmethod
    def _checked(web: Web | Objects, name: str) -> bytes:
        """A file, verified by its ETag if that is a hash. Raises ``RemoteError`` after two mismatches."""
        for _ in range(2):
            content = web.get(name, LARGEST_MANIFEST if name == MANIFEST else LARGEST_INDEX)
            if _matches_etag(content, web.etags.get(name, "")):
                return content
        raise RemoteError(f"{web.address(name)}: received bytes do not match its ETag: try again later")

    def _look_up(self, name: str, ask: Callable[[bool], str]) -> str:
        """The revision of a branch, tag or URL: the server's, else the last one seen.

        ``ask``: requests the revision from the server; its argument: whether to retry an unreachable server.
        """
        path = self._folder / "refs" / safe_name(name)
        try:
            if not self.allowed:
                raise RemoteError(f"{self._parsed}: never read before, and download=False: allow downloads")
            revision = ask(not path.exists())
        except (MissingError, RefusedError):
            raise
        except RemoteError as error:
            known = _read_revision(path)
            if known is None:
                raise
            if self.allowed:
                log.warning("%s; continuing with the cached revision %s", error, known)
            return known
        _write_cache(path, revision.encode())
        return revision

    def _commit(self, retry_unreachable: bool) -> str:
        assert isinstance(self._parsed, Repo)
        try:
            commit = json.loads(
                self._api(self._parsed.revision, retry_unreachable=retry_unreachable).get("", LARGEST_LISTING)
            )["sha"]
        except (MissingError, RefusedError) as error:
            raise type(error)(f"{error}; no local folder {self._parsed.name} exists either") from error
        except (ValueError, KeyError, TypeError, RecursionError) as error:
            raise RemoteError(
                f"{self._parsed}: the answer is not the Hub's description of a revision: {CHECK}"
            ) from error
        if COMMIT.fullmatch(str(commit)) is None:
            raise RemoteError(f"{self._parsed}: {ascii(commit)[:80]} is not a commit: {CHECK}")
        return str(commit)

    def _manifest_hash(self, retry_unreachable: bool) -> str:
        try:
            content = self._checked(self._files(retry_unreachable=retry_unreachable), MANIFEST)
        except MissingError as error:
            if isinstance(self._parsed, Url) and not self._parsed.is_web:
                raise MissingError(f"{error}; a data set becomes visible when its upload is complete") from error
            raise
        revision = hashlib.sha256(content).hexdigest()
        _write_cache(self._folder / revision / MANIFEST, content)
        return revision

    def _files(self, *, retry_unreachable: bool = True) -> Web | Objects:
        """Access to the files of a URL."""
        assert isinstance(self._parsed, Url)
        kind = Web if self._parsed.is_web else Objects
        return kind(self._parsed.url, patience=self._remote.patience, retry_unreachable=retry_unreachable)

    def _api(self, revision: str, *, retry_unreachable: bool = True) -> Web:
        """Access to the Hub's information on a revision."""
        assert isinstance(self._parsed, Repo)
        endpoint = hub_endpoint(self._remote.endpoint)
        return Web(
            f"{endpoint}/api/datasets/{self._parsed.name}/revision/{quote(revision, safe='')}",
            headers=self._headers,
            patience=self._remote.patience,
            retry_unreachable=retry_unreachable,
        )

    def _slug(self) -> str:
        """Cache folder name of the source."""
        if isinstance(self._parsed, Url):
            return self._parsed.slug
        return slug(self._parsed.name.replace("/", "--"), hub_endpoint(self._remote.endpoint))


def _require_unused(url: Url, remote: Remote) -> None:
    """Raise ``ConfigError`` for an option of the Hub with the URL of an object store."""
    for name in ("endpoint", "token"):
        if not url.is_web and getattr(remote, name) is not None:
            raise ConfigError(
                f"{name} is for the Hub, not for {url}: set the variables of its store, such as AWS_ENDPOINT_URL and "
                "AWS_ACCESS_KEY_ID"
            )


def _read_revision(path: Path) -> str | None:
    """The revision in a cache file; ``None`` without a valid one."""
    with contextlib.suppress(OSError, ValueError):
        if REVISION.fullmatch(known := path.read_text()):
            return known
    return None


def _hub_headers(token: str | None) -> dict[str, str]:
    # Called at the first request only: build_hf_headers may itself contact the Hub.
    from huggingface_hub.utils import build_hf_headers  # type: ignore[attr-defined]

    return build_hf_headers(token=token, library_name="gcd_dataset")


def _matches_etag(content: bytes, etag: str) -> bool:
    """Whether the content has the hash in its ETag, a Git blob hash or SHA-256; true for any other ETag."""
    if re.fullmatch(r"[0-9a-f]{40}", etag):
        return hashlib.sha1(b"blob %d\0" % len(content) + content, usedforsecurity=False).hexdigest() == etag
    return hashlib.sha256(content).hexdigest() == etag if re.fullmatch(r"[0-9a-f]{64}", etag) else True


def _write_cache(path: Path, content: bytes) -> None:
    """Write a file of the cache; logs a warning where that fails."""
    try:
        make_folder(path.parent)
        write_whole(path, content)
    except OutputError as error:
        log.warning("%s; continuing without caching", error)
