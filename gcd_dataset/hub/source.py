"""Parses the source of a data set as given by a user: a folder, a URL, or a repository of the Hugging Face Hub.

A URL is of a web server, or of an object store known to ``fsspec``: ``s3://``, ``gs://``, ``az://`` and others.

>>> parse_source("org/garments@v1.0")
Repo(name='org/garments', revision='v1.0')
>>> parse_source("https://example.org/garments/").url
'https://example.org/garments'
"""

import re
from dataclasses import dataclass
from pathlib import Path
from urllib.parse import unquote, urlsplit

from gcd_dataset.errors import ConfigError, shown
from gcd_dataset.files import user_path
from gcd_dataset.shards.access import reading

MAIN = "main"
WEB = ("http://", "https://")
LOCAL = ("file://", "local://")
STORE = re.compile(r"(?P<protocol>[a-z][a-z0-9+-]*)://[^/:].*")
COMMIT = re.compile(r"[0-9a-f]{40}")
REPO = re.compile(r"(?:hf://)?(?:datasets/)?(?P<name>\w[\w.-]*/\w[\w.-]*)(?:@(?P<revision>.+))?")
REVISION = re.compile(r"\w[\w.+-]*(?:/\w[\w.+-]*)*")


@dataclass(frozen=True)
class Folder:
    """A local folder."""

    path: Path

    def __str__(self) -> str:
        return str(self.path)


@dataclass(frozen=True)
class Url:
    """A folder of a web server, or a prefix in an object store."""

    url: str

    def __str__(self) -> str:
        return self.url


@dataclass(frozen=True)
class Repo:
    """A data set repository of the Hub."""

    name: str
    revision: str = MAIN
    """Branch, tag or commit."""

    @property
    def is_pinned(self) -> bool:
        """Whether the revision is a commit hash."""
        return COMMIT.fullmatch(self.revision) is not None

    def __str__(self) -> str:
        return f"hf://datasets/{self.name}@{self.revision}"


def parse_source(source: str | Path, revision: str | None = None) -> Folder | Url | Repo:
    """Parse a source. A local folder takes precedence over a repository of the same name.

    Raises ``ConfigError`` for anything else, and for a revision of a folder or URL.
    """
    if str(source).startswith("~"):
        source = user_path(source)
    text, path = str(source), Path(source)
    if text.startswith(LOCAL):
        return parse_source(Path(unquote(urlsplit(text).path)), revision)
    with reading(path):
        is_folder, is_file = "://" not in text and path.is_dir(), "://" not in text and path.is_file()
    if is_file:
        raise ConfigError(f"{shown(text)}: a file, not a folder of shards; Hdf5Garments reads HDF5 files")
    if is_folder or _is_url(text):
        found = Folder(path) if is_folder else Url(text.rstrip("/"))
        if revision is not None:
            raise ConfigError(f"revision={revision!r} is for repositories of the Hub, not for {found}: leave it out")
        return found
    match = None if isinstance(source, Path) else REPO.fullmatch(text)
    if match is None:
        raise ConfigError(
            f"{shown(text)}: no such folder, and neither a URL nor a repository of the Hub: give a folder, http://…, "
            "https://…, s3://BUCKET/PREFIX or ORG/NAME"
        )
    if match["revision"] and revision and match["revision"] != revision:
        raise ConfigError(f"{text}: revision={revision!r} contradicts it: give one of them")
    wanted = revision or match["revision"] or MAIN
    if REVISION.fullmatch(wanted) is None:
        raise ConfigError(f"{match['name']}: {shown(wanted)} is not a revision: give a branch, a tag or a commit")
    return Repo(match["name"], wanted)


def _is_url(text: str) -> bool:
    """Whether this is the URL of a web server or an object store; not for ``a::b://c``, which invokes other protocols.

    Raises ``ConfigError`` for a web server without a valid host and port.
    """
    if not text.isprintable():
        return False
    if not text.startswith(WEB):
        import fsspec

        match = STORE.fullmatch(text)
        is_store = match is not None and match["protocol"] in fsspec.available_protocols()
        return is_store and "::" not in text and not text.startswith("hf://")
    try:
        parts = urlsplit(text)
        if parts.hostname and " " not in parts.netloc and parts.port != 0:
            return True
    except ValueError:  # brackets that do not close, a port beyond 65535
        pass
    raise ConfigError(f"{shown(text)}: not a server address: check host and port")
