"""A data set on a server, at one revision: its small files, kept here for good, and the way to its large ones."""

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
    """How servers are asked, and where what they say is kept."""

    revision: str | None = None
    cache_dir: str | Path | None = None
    max_cache_size: int | str | None = None
    endpoint: str | None = None
    token: str | None = None
    allowed: bool = True
    """Whether any server may be asked at all."""
    patience: float | None = None
    """Seconds to wait for a server that is gone or busy; ``None`` for ``patience.PATIENCE``."""

    def __post_init__(self) -> None:
        if self.patience is not None and not 0 <= self.patience <= math.inf:
            raise ConfigError(f"patience={self.patience!r}: give seconds, 0 or more; inf waits for ever")

    @property
    def folder(self) -> Path:
        """Of the cache."""
        return Path.home() / ".cache" / "gcd_dataset" if self.cache_dir is None else user_path(self.cache_dir)


def hub_endpoint(endpoint: str | None) -> str:
    """The address of the Hub: the one given, or ``HF_ENDPOINT``, or its own."""
    from huggingface_hub import constants

    return (endpoint or constants.ENDPOINT).rstrip("/")


class Site:
    """A repository at a commit, or a URL whose manifest has a certain hash: looked up once, then it does not change.

    Where the server cannot be reached, the revision that was last seen is read, as far as it is kept here.
    Raises ``MissingError`` for what the server does not have, ``RemoteError`` where nothing is known of it.
    """

    def __init__(self, place: Repo | Url, remote: Remote) -> None:
        self._place, self._remote = place, remote
        self._seen = remote.folder / "sets" / self._slug()
        self._headers = partial(_hub_headers, remote.token)
        if isinstance(place, Repo):
            base = f"{hub_endpoint(remote.endpoint)}/datasets/{place.name}/resolve"
            self.revision = place.revision if place.is_pinned else self._look_up(place.revision, self._commit)
            self.web: Web | Objects = Web(f"{base}/{self.revision}", headers=self._headers, patience=remote.patience)
            self.source = str(Repo(place.name, self.revision))
        else:
            _require_unused(place, remote)
            self.web = self._files()
            self.revision = self._look_up("now", self._manifest_hash)
            self.source = f"{place.url}@{self.revision}"

    @property
    def allowed(self) -> bool:
        """Whether the server may be asked."""
        return self._remote.allowed

    @cached_property
    def names(self) -> tuple[str, ...]:
        """The files of a repository. Raises ``ConfigError`` for a URL, which cannot list them."""
        if not isinstance(self._place, Repo):
            raise ConfigError(f"{self._place}: a URL cannot list its files: give a folder, or a repository of the Hub")
        content = self.cached(LISTING, lambda: self._api(self.revision).get("", LARGEST_LISTING))
        try:
            return tuple(sorted(str(file["rfilename"]) for file in json.loads(content)["siblings"]))
        except (ValueError, KeyError, TypeError, RecursionError) as error:
            self.forget(LISTING)
            raise RemoteError(f"{self._place}: the server's list of files is none of the Hub's: {CHECK}") from error

    def small_file(self, name: str) -> bytes:
        """A small file, asked for once. Raises ``MissingError``, or ``RemoteError`` for one that comes damaged."""
        sign = self._path(f"{name}.missing")
        if sign.exists():
            raise MissingError(f"{self.source}: has no {name}")
        try:
            return self.cached(name, lambda: self._checked(self.web, name))
        except MissingError:
            if isinstance(self._place, Repo):  # at a URL it may come later
                _keep(sign, b"")
            raise

    def forget(self, name: str) -> None:
        """Ask for a small file anew the next time, if a server may be asked: it was not what it should be."""
        with contextlib.suppress(OSError):
            if self.allowed:
                self._path(name).unlink(missing_ok=True)

    def cached(self, name: str, get: Callable[[], bytes]) -> bytes:
        """What is kept of this revision under a name; gotten and kept where it is not."""
        path = self._path(name)
        with contextlib.suppress(OSError):
            return path.read_bytes()
        self.require_allowed(name)
        content = get()
        _keep(path, content)
        return content

    def require_allowed(self, what: str) -> None:
        """Raise ``RemoteError`` if no server may be asked."""
        if not self.allowed:
            raise RemoteError(f"{self._place}: {what} is not in the cache, and download=False: leave that out")

    def _path(self, name: str) -> Path:
        """Where a file of this revision is kept. Raises ``ShardError`` for a name that leads elsewhere."""
        return self._seen / self.revision / require_name(name, self.source)

    @staticmethod
    def _checked(web: Web | Objects, name: str) -> bytes:
        """A file whose hash is that of its ETag, if that is one."""
        for _ in range(2):
            content = web.get(name, LARGEST_MANIFEST if name == MANIFEST else LARGEST_INDEX)
            if _is_that(content, web.etags.get(name, "")):
                return content
        raise RemoteError(f"{web.address(name)}: other bytes come than were published: try again later")

    def _look_up(self, name: str, ask: Callable[[bool], str]) -> str:
        """The revision that a name stands for, or stood for when it was last asked for."""
        path = self._seen / "refs" / safe_name(name)
        try:
            if not self.allowed:
                raise RemoteError(f"{self._place}: never read before, and download=False: leave that out")
            revision = ask(not path.exists())
        except (MissingError, RefusedError):
            raise
        except RemoteError as error:
            known = _revision_in(path)
            if known is None:
                raise
            if self.allowed:
                log.warning("%s; going on with revision %s, which was read before", error, known)
            return known
        _keep(path, revision.encode())
        return revision

    def _commit(self, patient: bool) -> str:
        assert isinstance(self._place, Repo)
        try:
            commit = json.loads(self._api(self._place.revision, patient=patient).get("", LARGEST_LISTING))["sha"]
        except (MissingError, RefusedError) as error:
            raise type(error)(f"{error}; and there is no folder {self._place.name} here") from error
        except (ValueError, KeyError, TypeError, RecursionError) as error:
            raise RemoteError(f"{self._place}: the server's answer is none of the Hub's: {CHECK}") from error
        if COMMIT.fullmatch(str(commit)) is None:
            raise RemoteError(f"{self._place}: {ascii(commit)[:80]} is no commit: {CHECK}")
        return str(commit)

    def _manifest_hash(self, patient: bool) -> str:
        try:
            content = self._checked(self._files(patient=patient), MANIFEST)
        except MissingError as error:
            if isinstance(self._place, Url) and not self._place.is_web:
                raise MissingError(f"{error}; a set that is being made shows when all of it is there") from error
            raise
        revision = hashlib.sha256(content).hexdigest()
        _keep(self._seen / revision / MANIFEST, content)
        return revision

    def _files(self, *, patient: bool = True) -> Web | Objects:
        """The way to the files of a URL."""
        assert isinstance(self._place, Url)
        kind = Web if self._place.is_web else Objects
        return kind(self._place.url, patience=self._remote.patience, patient=patient)

    def _api(self, revision: str, *, patient: bool = True) -> Web:
        assert isinstance(self._place, Repo)
        endpoint = hub_endpoint(self._remote.endpoint)
        return Web(
            f"{endpoint}/api/datasets/{self._place.name}/revision/{quote(revision, safe='')}",
            headers=self._headers,
            patience=self._remote.patience,
            patient=patient,
        )

    def _slug(self) -> str:
        """A folder's name for the place, whatever the server."""
        if isinstance(self._place, Url):
            return self._place.slug
        return slug(self._place.name.replace("/", "--"), hub_endpoint(self._remote.endpoint))


def _require_unused(place: Url, remote: Remote) -> None:
    """Raise ``ConfigError`` for an option of the Hub that a store has no use for."""
    for name in ("endpoint", "token"):
        if not place.is_web and getattr(remote, name) is not None:
            raise ConfigError(
                f"{name} is for the Hub, and {place} is none: set what its store takes, such as AWS_ENDPOINT_URL and "
                "AWS_ACCESS_KEY_ID"
            )


def _revision_in(path: Path) -> str | None:
    """The revision that was kept in a file; ``None`` where there is none."""
    with contextlib.suppress(OSError, ValueError):
        if REVISION.fullmatch(known := path.read_text()):
            return known
    return None


def _hub_headers(token: str | None) -> dict[str, str]:
    # Only where a request follows: the library may ask the Hub for something of its own on the way.
    from huggingface_hub.utils import build_hf_headers  # type: ignore[attr-defined]

    return build_hf_headers(token=token, library_name="gcd_dataset")


def _is_that(content: bytes, etag: str) -> bool:
    """Whether the content has the hash in its ETag: of Git, or SHA-256; any other tells nothing."""
    if re.fullmatch(r"[0-9a-f]{40}", etag):
        return hashlib.sha1(b"blob %d\0" % len(content) + content, usedforsecurity=False).hexdigest() == etag
    return hashlib.sha256(content).hexdigest() == etag if re.fullmatch(r"[0-9a-f]{64}", etag) else True


def _keep(path: Path, content: bytes) -> None:
    """Write a file of the cache; without one, everything is asked for again."""
    try:
        make_folder(path.parent)
        write_whole(path, content)
    except OutputError as error:
        log.warning("%s; going on without keeping what is read", error)
