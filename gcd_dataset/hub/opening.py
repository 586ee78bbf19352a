"""Opens the store of a source: a folder, a URL or a repository."""

from collections.abc import Sequence
from pathlib import Path

from gcd_dataset.errors import ConfigError
from gcd_dataset.files import user_path
from gcd_dataset.hub.cache import Cache, size_in_bytes
from gcd_dataset.hub.download import download
from gcd_dataset.hub.download_record import require_same_source
from gcd_dataset.hub.remote import RemoteStore
from gcd_dataset.hub.site import Remote, Site
from gcd_dataset.hub.source import Folder, parse_source
from gcd_dataset.shards.folder import FolderStore
from gcd_dataset.shards.store import Store

__all__ = ["open_store"]


def open_store(
    source: str | Path,
    remote: Remote | None = None,
    *,
    root: str | Path | None = None,
    splits: Sequence[str] = (),
    fields: Sequence[str] | None = None,
) -> Store:
    """The store of a folder, a URL or a repository; ``root``: a folder to download ``splits`` and ``fields`` into.

    Raises ``ConfigError`` for any other source, and for options that do not apply to it; else as ``Store``.
    """
    remote = remote or Remote()
    parsed = parse_source(source, remote.revision)
    if isinstance(parsed, Folder):
        _require_unused(parsed, remote, root)
        return FolderStore(parsed.path)
    limit = size_in_bytes(remote.max_cache_size)
    if root is not None:
        folder = user_path(root)
        if not remote.allowed:
            require_same_source(folder, parsed)
        for split in splits if remote.allowed else ():
            download(parsed, folder, remote, split=split, fields=fields)
        return FolderStore(folder)
    return RemoteStore(Site(parsed, remote), Cache(remote.folder, limit))


def _require_unused(folder: Folder, remote: Remote, root: str | Path | None) -> None:
    """Raise ``ConfigError`` for an option that does not apply to a folder."""
    names = ("cache_dir", "max_cache_size", "endpoint", "token", "patience")
    given = {"root": root, **{name: getattr(remote, name) for name in names}}
    if named := [name for name, value in given.items() if value is not None]:
        shown = "" if named[0] == "token" else f"={given[named[0]]!r}"
        raise ConfigError(f"{named[0]}{shown} is for URLs and the Hub, and {folder} is a folder: leave it out")
