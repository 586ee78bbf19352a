"""Whether a split is all that was asked for: a run that was stopped leaves whole shards, and this note of how many.

``.unfinished-train.json`` holds the number of samples that a run is to fill the split up to, until they are there; and
the splits that share them, where failed drapes go into one of their own.
"""

import contextlib
import json
from collections.abc import Iterable, Iterator
from pathlib import Path

from gcd_dataset.files import make_folder, write_whole
from gcd_dataset.names import require_name
from gcd_dataset.shards.access import reading, writing
from gcd_dataset.shards.download_file import read_fetched
from gcd_dataset.shards.layout import TRAIN, shard_number
from gcd_dataset.shards.manifest import Manifest, read_manifest

__all__ = ["filling", "unfinished"]


@contextlib.contextmanager
def filling(folder: Path, count: int, *splits: str) -> Iterator[None]:
    """Note that ``splits``, by default ``train``, are to have ``count`` samples together, until the block ends well.

    Raises ``OutputError``.
    """
    splits = splits or (TRAIN,)
    notes = [_note(make_folder(folder), split) for split in splits]
    for note in notes:
        write_whole(note, json.dumps({"count": count, "splits": splits}).encode())
    yield
    for note in notes:
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
    told = _told(read_manifest(folder) or Manifest(), split, content)
    return f"{told}: its making was stopped, or goes on: run the same command again"


def _note(folder: Path, split: str) -> Path:
    return folder / f".unfinished-{require_name(split, 'split')}.json"


def _is_part(name: str, split: str) -> bool:
    return name.endswith(".part") and shard_number(name.removesuffix(".part"), split) is not None


def _told(manifest: Manifest, split: str, content: bytes | None) -> str:
    """How many samples are there, and how many there are to be by the note, if that can be read."""
    with contextlib.suppress(ValueError, KeyError, TypeError, AttributeError, OverflowError, RecursionError):
        note = json.loads(content or b"{}")
        return f"{_there(manifest, note.get('splits', [split]))} of {int(note['count'])} samples"
    return f"{_there(manifest, [split])} samples in whole shards"


def _there(manifest: Manifest, splits: Iterable[str]) -> int:
    """How many samples of these splits are in whole shards."""
    return sum(shard.count for split in splits if split in manifest.splits for shard in manifest.splits[split].shards)
