"""The splits that garments are stored in.

Without a recipe: ``train``, and with ``on_fail="keep"`` drapes that failed in ``failed``. With a recipe: the split of
the design, settled or not.
"""

import contextlib
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Self

from gcd_dataset.errors import ConfigError
from gcd_dataset.generator.recipe import MakeConfig, recipe_of
from gcd_dataset.generator.recipes import Recipe
from gcd_dataset.records import Outcome
from gcd_dataset.shards import ShardWriter, read_index
from gcd_dataset.shards.contents import splits_in
from gcd_dataset.shards.layout import FAILED, TRAIN, Bytes, shard_number
from gcd_dataset.shards.unfinished import filling
from gcd_dataset.shards.writer import SHARD_SIZE

__all__ = ["GarmentWriter", "SplitRule", "division_of", "filling_all", "is_begun"]

SMALLEST_SHARE = 0.01  # shards of a smaller split hold fewer samples than those of the others


@dataclass(frozen=True)
class SplitRule:
    """How the garments of a data set are divided into splits."""

    shard_sizes: Mapping[str, int]
    """Split to the range of indices of its shards; the first split is always there, ``failed`` when it has a sample."""
    counts: Mapping[str, int] | None
    """Split to its samples in the end, where that is known."""
    split_of: Callable[[int, Outcome | None], str]
    """The split of the sample with an index, whose drape ended so."""
    recipe: Recipe | None = None
    """That divides them."""

    @property
    def at_once(self) -> tuple[str, ...]:
        """Splits that are begun before their first sample."""
        return tuple(split for split in self.shard_sizes if split != FAILED)


def division_of(config: MakeConfig, recipe: Recipe | None = None) -> SplitRule:
    """The splits of the garments made with ``config``, or of a recipe."""
    if recipe is not None:
        # Shards of all splits hold about as many samples each.
        sizes = {split: round(SHARD_SIZE / max(share, SMALLEST_SHARE)) for split, share in recipe.splits.items()}
        return SplitRule(sizes, recipe.sizes(), lambda index, outcome: recipe.split_of(index), recipe)
    if config.stage != "drape" or config.on_fail != "keep":
        return SplitRule({TRAIN: SHARD_SIZE}, None, lambda index, outcome: TRAIN)
    sizes = dict.fromkeys((TRAIN, FAILED), SHARD_SIZE)
    return SplitRule(sizes, None, lambda index, outcome: TRAIN if outcome is Outcome.SETTLED else FAILED)


class GarmentWriter:
    """Writes the garments of one seed and config into a folder, each into its split.

    The lock of the first split keeps other writers out of all. Raises as ``ShardWriter`` does, and ``ConfigError`` for
    a folder whose ``train`` holds failed drapes where they are kept apart.
    """

    def __init__(self, folder: Path, seed: int, config: MakeConfig, division: SplitRule) -> None:
        self._folder, self._seed, self._recipe = folder, seed, recipe_of(config)
        self._division = division
        self._splits: dict[str, ShardWriter] = {}
        with contextlib.ExitStack() as self._opened:
            for split in division.at_once:
                self._writer(split)
            if FAILED in division.shard_sizes:
                _require_settled(folder)
                if is_begun(folder, FAILED):
                    self._writer(FAILED)
            self._opened = self._opened.pop_all()

    @property
    def done(self) -> frozenset[int]:
        """Indices of the samples that are whole on disk, in all splits."""
        return frozenset[int]().union(*(writer.done for writer in self._splits.values()))

    def add(self, index: int, members: Mapping[str, Bytes], outcome: Outcome | None) -> None:
        """Add a sample. Raises as ``ShardWriter.add`` does."""
        self._writer(self._division.split_of(index, outcome)).add(index, members)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._opened.__exit__(kind, error, trace)

    def _writer(self, split: str) -> ShardWriter:
        if split not in self._splits:
            size = self._division.shard_sizes[split]
            writer = ShardWriter(self._folder, split=split, seed=self._seed, recipe=self._recipe, shard_size=size)
            self._splits[split] = self._opened.enter_context(writer)
        return self._splits[split]


@contextlib.contextmanager
def filling_all(folder: Path, count: int, division: SplitRule) -> Iterator[None]:
    """Note how many samples the splits are to have, until the block ends well. Raises ``OutputError``."""
    with contextlib.ExitStack() as notes:
        if division.counts is None:
            notes.enter_context(filling(folder, count, *division.shard_sizes))
        for split, its in (division.counts or {}).items():
            notes.enter_context(filling(folder, its, split))
        yield


def is_begun(folder: Path, split: str) -> bool:
    """Whether a folder holds shards of a split, or one that a killed run left."""
    names = [path.name.removesuffix(".part") for path in folder.glob("*.tar*")]
    return any(shard_number(name, split) is not None for name in names)


def _require_settled(folder: Path) -> None:
    """Raise ``ConfigError`` where failed drapes are in ``train``: an earlier version put them there."""
    if TRAIN in splits_in(folder) and not read_index(folder, TRAIN).table.settled.all():
        raise ConfigError(
            f"{folder}: its train holds failed drapes, which now go into split {FAILED}: what is there can be read; "
            "make more in another folder"
        )
