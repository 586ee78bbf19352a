"""Several splits filled at once, as a recipe divides them."""

from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path

from gcd_dataset.generator.recipe import MakeConfig, recipe_of
from gcd_dataset.generator.recipes import Recipe
from gcd_dataset.shards.layout import Bytes
from gcd_dataset.shards.unfinished import filling
from gcd_dataset.shards.writer import SHARD_SIZE, ShardWriter

__all__ = ["DividedWriter", "divided_writer", "filling_splits"]

SMALLEST_SHARE = 0.01  # shards of a smaller split hold fewer samples than those of the others


@dataclass(frozen=True)
class DividedWriter:
    """Puts each sample into the split that is its own, under the index it has in the whole."""

    writers: Mapping[str, ShardWriter]
    split_of: Callable[[int], str]
    """Of the sample with an index."""

    @property
    def done(self) -> frozenset[int]:
        """Indices of the samples that are whole on disk."""
        return frozenset().union(*(writer.done for writer in self.writers.values()))

    def add(self, index: int, members: Mapping[str, Bytes]) -> None:
        """Add a sample. Raises as ``ShardWriter.add`` does."""
        self.writers[self.split_of(index)].add(index, members)


@contextmanager
def divided_writer(folder: Path | str, recipe: Recipe, config: MakeConfig) -> Iterator[DividedWriter]:
    """The only writer of all splits of a recipe, whose shards hold about as many samples each.

    ``config``: the recipe's with a device. Raises as ``ShardWriter`` does.
    """
    with ExitStack() as opened:
        writers = {
            split: opened.enter_context(
                ShardWriter(
                    folder,
                    split=split,
                    seed=recipe.seed,
                    recipe=recipe_of(config),
                    shard_size=round(SHARD_SIZE / max(share, SMALLEST_SHARE)),
                )
            )
            for split, share in recipe.splits.items()
        }
        yield DividedWriter(writers, recipe.split_of)


@contextmanager
def filling_splits(folder: Path, recipe: Recipe) -> Iterator[None]:
    """Note how many samples each split is to have, until the block ends well. Raises ``OutputError``."""
    with ExitStack() as notes:
        for split, count in recipe.sizes().items():
            notes.enter_context(filling(folder, count, split))
        yield
