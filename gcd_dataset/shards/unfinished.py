"""Marks a split whose run was stopped before all its samples were written.

During a run ``.unfinished-train.json`` holds the requested number of samples, and the splits among which they are
divided (failed drapes go into a split of their own). A finished run removes the file.
"""

import contextlib
import json
from collections.abc import Iterable, Iterator
from pathlib import Path

from gcd_dataset.files import make_folder, write_whole
from gcd_dataset.names import require_name
from gcd_dataset.shards.access import reading, writing
from gcd_dataset.shards.download_file import read_download_record
from gcd_dataset.shards.layout import TRAIN, shard_number
from gcd_dataset.shards.manifest import Manifest, read_manifest

__all__ = ["filling", "unfinished"]


@contextlib.contextmanager
def filling(folder: Path, count: int, *splits: str) -> Iterator[None]:
    """Mark ``splits``, by default ``train``, as unfinished until the block ends without an error.

    ``count``: samples that the splits will have together. Raises ``OutputError``.
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
    """A message that a split is unfinished, with a remedy; ``None`` for a finished one.

    A split is unfinished during its run too. Raises ``ShardError`` for a folder that cannot be read.
    """
    download = read_download_record(folder)
    if download is not None and split in download.unfinished:
        return "its download is incomplete: run gcd download again"
    note = _note(folder, split)
    with reading(folder):
        parts = [path.name for path in folder.iterdir() if _is_part(path.name, split)]
        content = note.read_bytes() if note.exists() else None
    if content is None and not parts:
        return None
    progress = _progress(read_manifest(folder) or Manifest(), split, content)
    return f"{progress}: its run was stopped, or is still running: run the same command again"


def _note(folder: Path, split: str) -> Path:
    return folder / f".unfinished-{require_name(split, 'split')}.json"


def _is_part(name: str, split: str) -> bool:
    return name.endswith(".part") and shard_number(name.removesuffix(".part"), split) is not None


def _progress(manifest: Manifest, split: str, content: bytes | None) -> str:
    """``M of N samples`` on disk, with N from the note; without N if the note cannot be read."""
    with contextlib.suppress(ValueError, KeyError, TypeError, AttributeError, OverflowError, RecursionError):
        note = json.loads(content or b"{}")
        return f"{_count(manifest, note.get('splits', [split]))} of {int(note['count'])} samples"
    return f"{_count(manifest, [split])} samples in whole shards"


def _count(manifest: Manifest, splits: Iterable[str]) -> int:
    """Number of samples of these splits in finished shards."""
    return sum(shard.count for split in splits if split in manifest.splits for shard in manifest.splits[split].shards)
