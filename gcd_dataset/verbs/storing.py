"""Writing garments into their splits.

Without a recipe all garments go to ``train``, except that ``on_fail="keep"`` puts failed drapes into ``failed``. With a
recipe a garment goes to the split of its design, settled or not.
"""

import contextlib
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Self

from gcd_dataset.errors import ConfigError
from gcd_dataset.generator.recipe import MakeConfig, layout_of_samples, recipe_of
from gcd_dataset.generator.recipes import Recipe
from gcd_dataset.records import Outcome
from gcd_dataset.shards import ShardWriter, read_index
from gcd_dataset.shards.contents import splits_in
from gcd_dataset.shards.layout import FAILED, TRAIN, Bytes, shard_number
from gcd_dataset.shards.unfinished import filling
from gcd_dataset.shards.writer import SHARD_SIZE

__all__ = ["GarmentWriter", "SplitRule", "is_begun", "marked_unfinished", "split_rule"]

SMALLEST_SHARE = 0.01  # a split with a smaller share gets shards of fewer samples


@dataclass(frozen=True)
class SplitRule:
    """The rule that divides the garments of a data set into splits."""

    shard_sizes: Mapping[str, int]
    """Split to the number of indices that a shard spans. The first split always exists; ``failed`` only if used."""
    counts: Mapping[str, int] | None
    """Split to its final number of samples; ``None`` if it depends on outcomes."""
    split_of: Callable[[int, Outcome | None], str]
    """Index and outcome of a sample to its split."""
    recipe: Recipe | None = None
    """The recipe that defines the splits."""

    @property
    def initial_splits(self) -> tuple[str, ...]:
        """Splits that are created before their first sample: all but ``failed``."""
        return tuple(split for split in self.shard_sizes if split != FAILED)


def split_rule(config: MakeConfig, recipe: Recipe | None = None) -> SplitRule:
    """The split rule of a recipe, or of the garments made with ``config``."""
    if recipe is not None:
        # A recipe interleaves its splits: wider index ranges give shards of about SHARD_SIZE samples in each.
        sizes = {split: round(SHARD_SIZE / max(share, SMALLEST_SHARE)) for split, share in recipe.splits.items()}
        return SplitRule(sizes, recipe.sizes(), lambda index, outcome: recipe.split_of(index), recipe)
    if config.stage != "drape" or config.on_fail != "keep":
        return SplitRule({TRAIN: SHARD_SIZE}, None, lambda index, outcome: TRAIN)
    sizes = dict.fromkeys((TRAIN, FAILED), SHARD_SIZE)
    return SplitRule(sizes, None, lambda index, outcome: TRAIN if outcome is Outcome.SETTLED else FAILED)


class GarmentWriter:
    """Writes the garments of one seed and config into a folder, each into its split.

    The lock of the first split excludes other writers from all splits. Raises as ``ShardWriter`` does, and
    ``ConfigError`` for a folder of an older version, which put failed drapes into ``train``.
    """

    def __init__(self, folder: Path, seed: int, config: MakeConfig, rule: SplitRule) -> None:
        self._folder, self._seed, self._recipe = folder, seed, recipe_of(config)
        self._layout = layout_of_samples(config)
        self._rule = rule
        self._splits: dict[str, ShardWriter] = {}
        with contextlib.ExitStack() as self._opened:
            for split in rule.initial_splits:
                self._writer(split)
            if FAILED in rule.shard_sizes:
                _require_settled(folder)
                if is_begun(folder, FAILED):
                    self._writer(FAILED)
            self._opened = self._opened.pop_all()

    @property
    def done(self) -> frozenset[int]:
        """Indices of the samples that are complete on disk, in all splits."""
        return frozenset[int]().union(*(writer.done for writer in self._splits.values()))

    def add(self, index: int, members: Mapping[str, Bytes], outcome: Outcome | None) -> None:
        """Add a sample. Raises as ``ShardWriter.add`` does."""
        self._writer(self._rule.split_of(index, outcome)).add(index, members)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._opened.__exit__(kind, error, trace)

    def _writer(self, split: str) -> ShardWriter:
        if split not in self._splits:
            size = self._rule.shard_sizes[split]
            writer = ShardWriter(
                self._folder,
                split=split,
                seed=self._seed,
                recipe=self._recipe,
                shard_size=size,
                layout=self._layout,
            )
            self._splits[split] = self._opened.enter_context(writer)
        return self._splits[split]


@contextlib.contextmanager
def marked_unfinished(folder: Path, count: int, rule: SplitRule) -> Iterator[None]:
    """Mark the splits as unfinished, with their final counts, until the block succeeds. Raises ``OutputError``."""
    with contextlib.ExitStack() as marks:
        if rule.counts is None:
            marks.enter_context(filling(folder, count, *rule.shard_sizes))
        for split, split_count in (rule.counts or {}).items():
            marks.enter_context(filling(folder, split_count, split))
        yield


def is_begun(folder: Path, split: str) -> bool:
    """Whether a folder holds shards of a split, unfinished ones included."""
    names = [path.name.removesuffix(".part") for path in folder.glob("*.tar*")]
    return any(shard_number(name, split) is not None for name in names)


def _require_settled(folder: Path) -> None:
    """Raise ``ConfigError`` if ``train`` holds failed drapes: an older version put them there."""
    if TRAIN in splits_in(folder) and not read_index(folder, TRAIN).table.settled.all():
        raise ConfigError(
            f"{folder}: split {TRAIN} holds failed drapes, which this version puts into split {FAILED}: the folder can "
            "be read; make further samples in another folder"
        )
