"""Generated patterns in shards, for tests that train; one takes 30 ms."""

from pathlib import Path

from gcd_dataset.generator.maker import make
from gcd_dataset.generator.recipe import MakeConfig, recipe_of
from gcd_dataset.shards import ShardWriter

CONFIG = MakeConfig(bodies="neutral", stage="pattern")


def pattern_shards(folder: Path, count: int, *, seed: int = 0, shard_size: int = 1000) -> Path:
    """Write patterns 0 … ``count`` - 1 of a seed as shards. Returns the folder."""
    with ShardWriter(folder, split="train", seed=seed, recipe=recipe_of(CONFIG), shard_size=shard_size) as writer:
        for index in range(count):
            writer.write(make(seed, index, CONFIG))
    return folder
