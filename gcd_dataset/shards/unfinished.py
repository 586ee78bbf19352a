"""Whether a split is all that was asked for: a run that was stopped leaves whole shards, and this note of how many.

``.unfinished-train.json`` holds the number of samples that a run is to fill the split up to, until they are there.
"""

import contextlib
import json
from collections.abc import Iterator
from pathlib import Path

from gcd_dataset.files import make_folder, write_whole
from gcd_dataset.names import require_name
from gcd_dataset.shards.access import reading, writing
from gcd_dataset.shards.fetched import read_fetched
from gcd_dataset.shards.layout import shard_number
from gcd_dataset.shards.manifest import Manifest, read_manifest

__all__ = ["filling", "unfinished"]


@contextlib.contextmanager
def filling(folder: Path, count: int, split: str = "train") -> Iterator[None]:
    """Note that a split is to have ``count`` samples, until the block ends well. Raises ``OutputError``."""
    note = _note(make_folder(folder), split)
    write_whole(note, json.dumps({"count": count}).encode())
    yield
    with writing(note):
        note.unlink(missing_ok=True)


def unfinished(folder: Path, split: str) -> str | None:
    """What is missing of a split, and what to do about it; ``None`` for one that is whole.

    A split that is written at this moment is not whole either. Raises ``ShardError`` for a folder that cannot be read.
    """
    fetched = read_fetched(folder)
    if fetched is not None and split in fetched.unfinished:
        return "its download has not ended: run gcd download again"
    note = _note(folder, split)
    with reading(folder):
        parts = [path.name for path in folder.iterdir() if _is_part(path.name, split)]
        content = note.read_bytes() if note.exists() else None
    if content is None and not parts:
        return None
    record = (read_manifest(folder) or Manifest()).splits.get(split)
    there = sum(shard.count for shard in record.shards) if record is not None else 0
    return f"{_told(there, content)}: its making was stopped, or goes on: run the same command again"


def _note(folder: Path, split: str) -> Path:
    return folder / f".unfinished-{require_name(split, 'split')}.json"


def _is_part(name: str, split: str) -> bool:
    return name.endswith(".part") and shard_number(name.removesuffix(".part"), split) is not None


def _told(there: int, content: bytes | None) -> str:
    """How many samples are there, and how many there are to be by the note, if that can be read."""
    with contextlib.suppress(ValueError, KeyError, TypeError, OverflowError, RecursionError):
        return f"{there} of {int(json.loads(content or b'{}')['count'])} samples"
    return f"{there} samples in whole shards"
