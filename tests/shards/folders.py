"""Folders of fake garments, and what lies in them."""

import hashlib
from collections.abc import Iterable
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


def contents(folder: Path) -> dict[str, str]:
    """File name to a hash of the content, hidden files too."""
    return {path.name: hashlib.sha256(path.read_bytes()).hexdigest() for path in sorted(folder.iterdir())}
