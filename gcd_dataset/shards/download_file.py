"""``download.json``: the source of a downloaded folder, and its complete splits."""

import contextlib
import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path

from gcd_dataset.errors import ShardError
from gcd_dataset.files import write_whole
from gcd_dataset.shards.access import locked, read_limited, reading
from gcd_dataset.shards.limits import LARGEST_JSON
from gcd_dataset.shards.meta import decode_json

__all__ = ["DOWNLOAD_FILE", "DownloadRecord", "DownloadedSplit", "download_record_lock", "read_download_record"]

DOWNLOAD_FILE = "download.json"


@dataclass(frozen=True)
class DownloadedSplit:
    """One split of a download."""

    members: Sequence[str]
    """Members of each sample that are downloaded."""
    whole: bool = False
    """Whether the download of the split is complete."""


@dataclass(frozen=True)
class DownloadRecord:
    """The contents of ``download.json``."""

    source: str
    """URL, or repository and commit."""
    splits: Mapping[str, DownloadedSplit] = field(default_factory=dict)

    @property
    def unfinished(self) -> frozenset[str]:
        """Splits with missing shards."""
        return frozenset(name for name, split in self.splits.items() if not split.whole)

    def with_split(self, name: str, split: DownloadedSplit) -> "DownloadRecord":
        """The record with one split added or replaced."""
        return replace(self, splits=dict(sorted({**self.splits, name: split}.items())))

    def write(self, folder: Path) -> None:
        """Write the record to the folder, atomically. Raises ``OutputError``."""
        write_whole(folder / DOWNLOAD_FILE, (json.dumps(asdict(self), indent=1) + "\n").encode())


@contextlib.contextmanager
def download_record_lock(folder: Path) -> Iterator[None]:
    """Lock the record for a read and a write: splits may be downloaded in parallel. Raises ``OutputError``."""
    with locked(folder / f".{DOWNLOAD_FILE}.lock", f"writing {DOWNLOAD_FILE}", wait=True):
        yield


def read_download_record(folder: Path) -> DownloadRecord | None:
    """The record of a folder; ``None`` for one that was not downloaded. Raises ``ShardError`` for a broken one."""
    path = folder / DOWNLOAD_FILE
    with reading(path):
        exists = path.exists()
    if not exists:
        return None
    content = read_limited(path, LARGEST_JSON)
    try:
        entry = decode_json(content)
        splits = {
            name: DownloadedSplit(tuple(split["members"]), split["whole"]) for name, split in entry["splits"].items()
        }
        return DownloadRecord(entry["source"], splits)
    except (ShardError, ValueError, KeyError, TypeError, AttributeError) as error:
        raise ShardError(f"{path}: not a download record ({error}): delete it, and download again") from error
