"""Where the garments that are made go: settled drapes into ``train``, with ``on_fail="keep"`` failed ones into
``failed``.
"""

import contextlib
from collections.abc import Mapping
from pathlib import Path
from types import TracebackType
from typing import Self

from gcd_dataset.errors import ConfigError
from gcd_dataset.generator.recipe import MakeConfig, recipe_of
from gcd_dataset.records import Outcome
from gcd_dataset.shards import ShardWriter, read_index
from gcd_dataset.shards.contents import splits_in
from gcd_dataset.shards.layout import FAILED, TRAIN, Bytes, shard_number
from gcd_dataset.shards.writer import SHARD_SIZE

__all__ = ["GarmentWriter", "is_begun", "splits_of"]


def splits_of(config: MakeConfig) -> tuple[str, ...]:
    """The splits that garments of a recipe go into."""
    return (TRAIN, FAILED) if config.stage == "drape" and config.on_fail == "keep" else (TRAIN,)


class GarmentWriter:
    """Writes the garments of one seed and recipe into a folder, each into the split of its outcome.

    The lock of ``train`` keeps other writers out of both splits. ``failed`` is begun with the first drape that failed.
    Raises as ``ShardWriter`` does, and ``ConfigError`` for a folder whose ``train`` holds failed drapes.
    """

    shard_size = SHARD_SIZE

    def __init__(self, folder: Path, seed: int, config: MakeConfig) -> None:
        self._folder, self._seed, self._recipe = folder, seed, recipe_of(config)
        self._keeps_apart = FAILED in splits_of(config)
        self._splits: dict[str, ShardWriter] = {}
        with contextlib.ExitStack() as self._opened:
            self._writer(TRAIN)
            if self._keeps_apart:
                _require_settled(folder)
                if is_begun(folder, FAILED):
                    self._writer(FAILED)
            self._opened = self._opened.pop_all()

    @property
    def done(self) -> frozenset[int]:
        """Indices of the samples that are whole on disk, in either split."""
        return frozenset[int]().union(*(writer.done for writer in self._splits.values()))

    def add(self, index: int, members: Mapping[str, Bytes], outcome: Outcome | None) -> None:
        """Add a sample. Raises as ``ShardWriter.add`` does."""
        fails = outcome not in (None, Outcome.SETTLED)
        self._writer(FAILED if fails and self._keeps_apart else TRAIN).add(index, members)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._opened.__exit__(kind, error, trace)

    def _writer(self, split: str) -> ShardWriter:
        if split not in self._splits:
            origin = {"seed": self._seed, "recipe": self._recipe, "shard_size": self.shard_size}
            self._splits[split] = self._opened.enter_context(ShardWriter(self._folder, split=split, **origin))
        return self._splits[split]


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
