"""The way to the shards of whatever a user has named."""

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
    """The shards at a folder, a URL, or in a repository; ``root``: a folder to download these splits and fields into.

    Raises ``ConfigError`` for a source that is none of these, or options that it has no use for; else as ``Store``.
    """
    remote = remote or Remote()
    place = parse_source(source, remote.revision)
    if isinstance(place, Folder):
        _require_unused(place, remote, root)
        return FolderStore(place.path)
    limit = size_in_bytes(remote.max_cache_size)
    if root is not None:
        folder = user_path(root)
        if not remote.allowed:
            require_same_source(folder, place)
        for split in splits if remote.allowed else ():
            download(place, folder, remote, split=split, fields=fields)
        return FolderStore(folder)
    return RemoteStore(Site(place, remote), Cache(remote.folder, limit))


def _require_unused(place: Folder, remote: Remote, root: str | Path | None) -> None:
    """Raise ``ConfigError`` for an option that a folder has no use for."""
    names = ("cache_dir", "max_cache_size", "endpoint", "token", "patience")
    given = {"root": root, **{name: getattr(remote, name) for name in names}}
    if named := [name for name, value in given.items() if value is not None]:
        shown = "" if named[0] == "token" else f"={given[named[0]]!r}"
        raise ConfigError(f"{named[0]}{shown} is for URLs and the Hub, and {place} is a folder: leave it out")
