"""Marks a split whose run was stopped before all its samples were written.

During a run ``.unfinished-train.json`` holds the requested number of samples, and the splits among which they are
divided (failed drapes go into a split of their own). A finished run removes the file.
"""

import contextlib
import json
import shlex
from collections.abc import Iterable, Iterator
from pathlib import Path

from gcd_dataset.files import make_folder, write_whole
from gcd_dataset.names import require_name
from gcd_dataset.shards.access import reading, writing
from gcd_dataset.shards.download_file import read_download_record
from gcd_dataset.shards.layout import TRAIN, shard_number
from gcd_dataset.shards.manifest import Manifest, read_manifest

__all__ = ["filling", "note_name", "unfinished", "unfinished_by"]


@contextlib.contextmanager
def filling(folder: Path, count: int, *splits: str) -> Iterator[None]:
    """Mark ``splits``, by default ``train``, as unfinished until the block ends without an error.

    ``count``: samples that the splits will have together. Raises ``OutputError``.
    """
    splits = splits or (TRAIN,)
    notes = [make_folder(folder) / note_name(split) for split in splits]
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
    note = folder / note_name(split)
    with reading(folder):
        parts = [path.name for path in folder.iterdir() if _is_part(path.name, split)]
        content = note.read_bytes() if note.exists() else None
    if content is None and not parts:
        return None
    return unfinished_by(content, read_manifest(folder) or Manifest(), split, folder)


def unfinished_by(note: bytes | None, manifest: Manifest, split: str, folder: Path | None = None) -> str | None:
    """The message for the content of a mark; ``None`` for a server's answer that is no mark."""
    noted = _noted(note or b"")
    if noted is None and folder is None:
        return None
    splits, count = noted or ([split], None)
    made = sum(shard.count for name in splits if name in manifest.splits for shard in manifest.splits[name].shards)
    progress = f"{made} samples in whole shards" if count is None else f"{made} of {count} samples"
    again = f"run the same command again{_command(manifest, split, count or 0, folder)}" if folder else ""
    return f"{progress}: its run was stopped, or is still running: {again or 'ask its publisher to finish it'}"


def note_name(split: str) -> str:
    """File name of the mark of a split. Raises ``ShardError`` for an unsafe split name."""
    return f".unfinished-{require_name(split, 'split')}.json"


def _noted(note: bytes) -> tuple[Iterable[str], int] | None:
    """The splits and the requested number of samples in a mark; ``None`` for a damaged one."""
    with contextlib.suppress(ValueError, KeyError, TypeError, AttributeError, OverflowError, RecursionError):
        content = json.loads(note)
        return [str(name) for name in content["splits"]], int(content["count"])
    return None


def _command(manifest: Manifest, split: str, count: int, folder: Path) -> str:
    """``: gcd generate …`` with the options in the manifest; empty if it does not hold all of them."""
    words = ["gcd", "generate", str(folder)]
    record = manifest.splits.get(split)
    if manifest.recipe is not None:
        words += ["--recipe", manifest.recipe.name]
    elif count and record is not None and "stage" in record.recipe and not record.recipe.get("design"):
        words += ["--count", str(count), "--seed", str(record.seed)]
        for name, value in record.recipe.items():
            if name not in ("design", "mesh", "part"):  # no options
                words += [f"--{name.replace('_', '-')}", *([] if value is True else [str(value)])]
    else:
        return ""
    return f": {shlex.join(words)}"


def _is_part(name: str, split: str) -> bool:
    return name.endswith(".part") and shard_number(name.removesuffix(".part"), split) is not None
