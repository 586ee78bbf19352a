"""Where a folder was downloaded from, and whether all of it has come: kept in ``download.json``."""

import contextlib
import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path

from gcd_dataset.errors import ShardError
from gcd_dataset.files import write_whole
from gcd_dataset.shards.access import locked, read_small, reading
from gcd_dataset.shards.limits import LARGEST_JSON
from gcd_dataset.shards.meta import decode_json

__all__ = ["FETCHED", "Fetched", "FetchedSplit", "changing_fetched", "read_fetched"]

FETCHED = "download.json"


@dataclass(frozen=True)
class FetchedSplit:
    """One split."""

    members: Sequence[str]
    """Of each sample."""
    whole: bool = False
    """Whether all of it has come."""


@dataclass(frozen=True)
class Fetched:
    """The contents of ``download.json``."""

    source: str
    """URL, or repository and commit."""
    splits: Mapping[str, FetchedSplit] = field(default_factory=dict)

    @property
    def unfinished(self) -> frozenset[str]:
        """Splits of which something is missing."""
        return frozenset(name for name, split in self.splits.items() if not split.whole)

    def with_split(self, name: str, split: FetchedSplit) -> "Fetched":
        """The record with one split put in or replaced."""
        return replace(self, splits=dict(sorted({**self.splits, name: split}.items())))

    def write(self, folder: Path) -> None:
        """Keep the record in the folder, whole or not at all. Raises ``OutputError``."""
        write_whole(folder / FETCHED, (json.dumps(asdict(self), indent=1) + "\n").encode())


@contextlib.contextmanager
def changing_fetched(folder: Path) -> Iterator[None]:
    """Hold the record while it is read and written: splits may come side by side. Raises ``OutputError``."""
    with locked(folder / f".{FETCHED}.lock", f"writing {FETCHED}", wait=True):
        yield


def read_fetched(folder: Path) -> Fetched | None:
    """The record of a folder; ``None`` for one that was not downloaded. Raises ``ShardError`` for a broken one."""
    path = folder / FETCHED
    with reading(path):
        is_there = path.exists()
    if not is_there:
        return None
    content = read_small(path, LARGEST_JSON)
    try:
        entry = decode_json(content)
        splits = {
            name: FetchedSplit(tuple(split["members"]), split["whole"]) for name, split in entry["splits"].items()
        }
        return Fetched(entry["source"], splits)
    except (ShardError, ValueError, KeyError, TypeError, AttributeError) as error:
        raise ShardError(f"{path}: not the record of a download ({error}): delete it, and download again") from error
