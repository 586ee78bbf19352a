"""Folders of fake garments, and what lies in them."""

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
    """Put samples into a folder, in one sitting."""
    with open_writer(folder, seed=seed) as writer:
        for index in indices:
            writer.write(fake_sample(seed, index))
    return folder


def open_writer(folder: Path, *, seed: int = 0, split: str = "train") -> ShardWriter:
    return ShardWriter(folder, split=split, seed=seed, recipe=RECIPE, shard_size=SHARD_SIZE)


@contextlib.contextmanager
def public_folder() -> Iterator[Path]:
    """A folder that everybody can reach, other than those of pytest."""
    with tempfile.TemporaryDirectory() as name:
        Path(name).chmod(0o755)
        yield Path(name)


@contextlib.contextmanager
def forbidden(path: Path, mode: int) -> Iterator[None]:
    """Let ``path`` have these permissions, and let us be somebody to whom they apply: nothing is closed to root."""
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
    """File name to a hash of the content, hidden files too."""
    return {path.name: hashlib.sha256(path.read_bytes()).hexdigest() for path in sorted(folder.iterdir())}
