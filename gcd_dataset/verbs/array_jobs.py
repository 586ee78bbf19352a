"""Parts of a data set, for array jobs: indices, folder and completion record of a part."""

import shlex
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Self

from gcd_dataset.errors import ConfigError, shown
from gcd_dataset.generator.recipe import MakeConfig, recipe_of, versions
from gcd_dataset.generator.recipes import Recipe, recipe_names
from gcd_dataset.options import options_of
from gcd_dataset.shards.access import reading, writing
from gcd_dataset.shards.contents import read_index
from gcd_dataset.shards.job_parts import (
    PARTS,
    FinishedPart,
    NamedRecipe,
    PartsPlan,
    finished_path,
    is_merging,
    part_folder,
    parts_lock,
    parts_waiting,
    read_finished,
    read_plan,
    write_finished,
    write_or_check_plan,
)
from gcd_dataset.shards.layout import SCHEMA
from gcd_dataset.shards.manifest import SplitRecord, read_manifest
from gcd_dataset.shards.origin import record_to_resume
from gcd_dataset.verbs.storing import SplitRule, is_begun

__all__ = ["JobPart", "PartFolder", "begin_part", "command_of"]

MOST = 100_000  # largest number of parts: folder names have five digits


@dataclass(frozen=True)
class JobPart:
    """Part ``number`` of ``of`` parts of a data set. Raises ``ConfigError`` for a number out of range.

    >>> JobPart.parse("2/8").indices(100, wearers=2)
    range(24, 36)
    """

    number: int
    """Counted from 0."""
    of: int
    """Number of parts."""

    def __post_init__(self) -> None:
        if not 1 <= self.of <= MOST:
            raise ConfigError(f"part {self}: of {self.of} parts: give 1 to {MOST}, as 0/{min(max(self.of, 1), MOST)}")
        if not 0 <= self.number < self.of:
            raise ConfigError(f"part {self}: no such part: the first is 0/{self.of}, the last {self.of - 1}/{self.of}")

    def __str__(self) -> str:
        return f"{self.number}/{self.of}"

    @classmethod
    def parse(cls, text: str) -> Self:
        """The part written as ``I/N``. Raises ``ConfigError``."""
        number, _, of = text.partition("/")
        if not all(word.isascii() and word.isdecimal() and len(word) < 10 for word in (number, of)):
            raise ConfigError(f"part {shown(text)}: write I/N, two whole numbers, I from 0 to N - 1: 0/8, 1/8, … 7/8")
        return cls(int(number), int(of))

    def indices(self, count: int, *, wearers: int) -> range:
        """Indices of this part's samples, of ``count`` in all; a design's ``wearers`` samples stay together."""
        designs = -(-count // wearers)
        first, stop = (designs * number // self.of for number in (self.number, self.number + 1))
        return range(min(first * wearers, count), min(stop * wearers, count))


@dataclass(frozen=True)
class PartFolder:
    """The folder of a part. Writes and deletes the completion record, ``part.json``."""

    out: Path
    """Folder of the data set."""
    part: JobPart
    indices: range
    is_merged: bool = False
    """Whether the data set itself already holds the samples of this part, so that nothing is made."""

    @property
    def path(self) -> Path:
        """Folder of the part."""
        return part_folder(self.out, self.part.number, self.part.of)

    @property
    def is_finished(self) -> bool:
        """Whether the part is merged, or has a completion record. Raises ``ShardError``."""
        return self.is_merged or read_finished(self.path) is not None

    def begin(self) -> None:
        """Delete the completion record. Called before samples are added, with the writer open.

        Raises ``ConfigError`` while the parts are merged.
        """
        _require_not_merging(self.out, self.path)
        with writing(finished_path(self.path)):
            finished_path(self.path).unlink(missing_ok=True)

    def finish(self) -> None:
        """Write the completion record. Raises ``OutputError``."""
        manifest = read_manifest(self.path)
        assert manifest is not None
        plan = read_plan(self.out / PARTS)
        finished = FinishedPart.of_plan(self.part.number, self.indices, plan, manifest.splits)
        write_finished(self.path, finished)


def begin_part(out: Path, part: JobPart, count: int, seed: int, config: MakeConfig, rule: SplitRule) -> PartFolder:
    """The folder of a part; the first call for ``out`` writes the plan that all parts share.

    Raises ``ConfigError`` for parts of another plan, while the parts are merged, and if ``out`` holds a data set
    without the samples of this part; ``OutputError`` if it cannot be written.
    """
    indices = part.indices(count, wearers=config.wearers)
    with parts_lock(out):
        if not (out / PARTS).exists() and any(is_begun(out, split) for split in rule.shard_sizes):
            _require_stored(out, part, indices, seed, config, rule)
            return PartFolder(out, part, indices, is_merged=True)
        _require_not_merging(out, part_folder(out, part.number, part.of))
        options, named = recipe_of(config), _named_set(rule.recipe)
        write_or_check_plan(out, PartsPlan(part.of, count, seed, options, rule.shard_sizes, SCHEMA, versions(), named))
    return PartFolder(out, part, indices)


def command_of(out: Path, plan: PartsPlan, part: int) -> str:
    """The ``gcd generate`` command that makes a part of a plan, for messages."""
    options = _options_of(plan) if plan.named is None else _options_of_named(plan, plan.named)
    return shlex.join(["gcd", "generate", str(out), *options, "--shard", str(JobPart(part, plan.of))])


def _named_set(recipe: Recipe | None) -> NamedRecipe | None:
    if recipe is None:
        return None
    return NamedRecipe(recipe.name, recipe.sha256, dict(recipe.splits), recipe.patterns)


def _options_of_named(plan: PartsPlan, named: NamedRecipe) -> Iterator[str]:
    yield from ("--recipe", named.name if named.name in recipe_names() else "FILE.toml")
    yield from _device_of(plan)


def _device_of(plan: PartsPlan) -> tuple[str, ...]:
    is_on_cpu = (plan.recipe.get("device"), plan.recipe.get("stage")) == ("cpu", "drape")
    return ("--device", "cpu") if is_on_cpu else ()


def _options_of(plan: PartsPlan) -> Iterator[str]:
    """Count, seed, and the options that differ from their defaults."""
    yield from ("--count", str(plan.count), "--seed", str(plan.seed))
    for option in options_of(MakeConfig):
        value = plan.recipe.get(option.name, option.default)
        if option.name == "design":
            yield from ("--config", "FILE.toml") if value else ()
        elif option.name == "device":
            yield from _device_of(plan)
        elif value != option.default:
            yield from (option.flag, str(value))


def _require_not_merging(out: Path, folder: Path) -> None:
    """Raise ``ConfigError`` while parts are merged, unless a stopped merge waits for the part in ``folder``."""
    if is_merging(out) and not _is_wanted(out, folder):
        raise ConfigError(f"{out}: {parts_waiting(out)}")


def _is_wanted(out: Path, folder: Path) -> bool:
    """Whether a part is unfinished, or lacks a shard that is not merged yet: a damaged shard that was deleted."""
    finished = read_finished(folder)
    if finished is None:
        return True
    names = [record.name for records in finished.splits.values() for record in records]
    with reading(folder):
        return not all((folder / name).exists() or (out / name).exists() for name in names)


def _require_stored(out: Path, part: JobPart, indices: range, seed: int, config: MakeConfig, rule: SplitRule) -> None:
    """Raise ``ConfigError`` unless the data set in ``out``, merged or made in one run, holds these samples."""
    stored: set[int] = set()
    for split, size in rule.shard_sizes.items():
        asked = SplitRecord(seed, recipe_of(config), size)
        index = read_index(out, split)
        record_to_resume(out, split, index.tables(), asked)
        stored.update(index.table.sample.tolist())
    if missing := set(indices) - stored:
        raise ConfigError(
            f"{out}: holds a data set that was not made in parts and lacks {len(missing)} of the {len(indices)} "
            f"samples of part {part}: continue it without --shard, or choose another folder"
        )
