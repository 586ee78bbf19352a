"""Folders of fake garments, and hashes of their contents."""

import contextlib
import hashlib
import os
import tempfile
from collections.abc import Iterable, Iterator
from pathlib import Path

from gcd_dataset.loaders.fake import fake_sample
from gcd_dataset.shards import ShardWriter

RECIPE = {"fake": True}
SHARD_SIZE = 4


def fill(folder: Path, indices: Iterable[int], *, seed: int = 0) -> Path:
    """Write samples to a new folder."""
    with open_writer(folder, seed=seed) as writer:
        for index in sorted(indices):
            writer.write(fake_sample(seed, index))
    return folder


def open_writer(folder: Path, *, seed: int = 0, split: str = "train") -> ShardWriter:
    return ShardWriter(folder, split=split, seed=seed, recipe=RECIPE, shard_size=SHARD_SIZE)


@contextlib.contextmanager
def public_folder() -> Iterator[Path]:
    """A folder that all users can enter, unlike pytest's."""
    with tempfile.TemporaryDirectory() as name:
        Path(name).chmod(0o755)
        yield Path(name)


@contextlib.contextmanager
def forbidden(path: Path, mode: int) -> Iterator[None]:
    """Set the permissions of ``path``; as root, also switch to an unprivileged user, since root may read anything."""
    before = path.stat().st_mode
    path.chmod(mode)
    root = os.geteuid() == 0
    if root:
        os.seteuid(65534)  # nobody
    try:
        yield
    finally:
        if root:
            os.seteuid(0)
        path.chmod(before)


def contents(folder: Path) -> dict[str, str]:
    """Path to hash of the content of every file, hidden ones included."""
    files = sorted(path for path in folder.rglob("*") if path.is_file())
    return {str(path.relative_to(folder)): hashlib.sha256(path.read_bytes()).hexdigest() for path in files}
