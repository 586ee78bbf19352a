"""A data set made in parts: which samples a part makes, where, and what it leaves when it is finished."""

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

__all__ = ["JobPart", "PartPlace", "begin_part", "command_of"]

MOST = 100_000  # parts: five digits in their names


@dataclass(frozen=True)
class JobPart:
    """One of several parts that together make a data set. Raises ``ConfigError`` for one that there is not.

    >>> Part.parse("2/8").indices(100, wearers=2)
    range(24, 36)
    """

    number: int
    """From 0 on."""
    of: int
    """How many parts there are."""

    def __post_init__(self) -> None:
        if not 1 <= self.of <= MOST:
            raise ConfigError(f"part {self}: of {self.of} parts: give 1 to {MOST}, as 0/{min(max(self.of, 1), MOST)}")
        if not 0 <= self.number < self.of:
            raise ConfigError(
                f"part {self}: there is no such part: the first is 0/{self.of}, the last {self.of - 1}/{self.of}"
            )

    def __str__(self) -> str:
        return f"{self.number}/{self.of}"

    @classmethod
    def parse(cls, text: str) -> Self:
        """The part that ``I/N`` names. Raises ``ConfigError``."""
        number, _, of = text.partition("/")
        if not all(word.isascii() and word.isdecimal() and len(word) < 10 for word in (number, of)):
            raise ConfigError(f"part {shown(text)}: write I/N, two whole numbers, I from 0 to N - 1: 0/8, 1/8, … 7/8")
        return cls(int(number), int(of))

    def indices(self, count: int, *, wearers: int) -> range:
        """The samples of this part, of ``count`` in all: those of whole designs, each with ``wearers`` samples."""
        designs = -(-count // wearers)
        first, stop = (designs * place // self.of for place in (self.number, self.number + 1))
        return range(min(first * wearers, count), min(stop * wearers, count))


@dataclass(frozen=True)
class PartPlace:
    """Where a part is made: in a folder of its own, or nowhere, since the data set holds its samples already."""

    out: Path
    """The folder of the data set."""
    part: JobPart
    indices: range
    is_merged: bool = False
    """Whether the data set holds the samples of this part."""

    @property
    def folder(self) -> Path:
        """The part's own."""
        return part_folder(self.out, self.part.number, self.part.of)

    @property
    def is_finished(self) -> bool:
        """Whether the part has left word that it is finished, or is merged. Raises ``ShardError``."""
        return self.is_merged or read_finished(self.folder) is not None

    def begin(self) -> None:
        """Take back that the part is finished, before it is made (again). To be called while its writer is open.

        Raises ``ConfigError`` where the parts are being merged.
        """
        _require_not_merging(self.out, self.folder)
        with writing(finished_path(self.folder)):
            finished_path(self.folder).unlink(missing_ok=True)

    def finish(self) -> None:
        """Leave word that the part is finished. Raises ``OutputError``."""
        manifest = read_manifest(self.folder)
        assert manifest is not None
        plan = read_plan(self.out / PARTS)
        finished = FinishedPart.of_plan(self.part.number, self.indices, plan, manifest.splits)
        write_finished(self.folder, finished)


def begin_part(out: Path, part: JobPart, count: int, seed: int, config: MakeConfig, division: SplitRule) -> PartPlace:
    """The place of a part; the first writes down what all parts have in common.

    Raises ``ConfigError`` for parts of another plan, while they are merged, and where ``out`` holds a data set without
    the samples of this part; ``OutputError`` where it cannot be written.
    """
    indices = part.indices(count, wearers=config.wearers)
    with parts_lock(out):
        if not (out / PARTS).exists() and any(is_begun(out, split) for split in division.shard_sizes):
            _require_there(out, part, indices, seed, config, division)
            return PartPlace(out, part, indices, is_merged=True)
        _require_not_merging(out, part_folder(out, part.number, part.of))
        options, named = recipe_of(config), _named(division.recipe)
        write_or_check_plan(
            out, PartsPlan(part.of, count, seed, options, division.shard_sizes, SCHEMA, versions(), named)
        )
    return PartPlace(out, part, indices)


def command_of(out: Path, plan: PartsPlan, part: int) -> str:
    """The command that makes a part of a plan."""
    options = _options_of(plan) if plan.named is None else _options_of_named(plan, plan.named)
    return shlex.join(["gcd", "generate", str(out), *options, "--shard", str(JobPart(part, plan.of))])


def _named(recipe: Recipe | None) -> NamedRecipe | None:
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
    """Count, seed, and the options that are not their defaults."""
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
    """Raise ``ConfigError`` where parts are being merged, unless a stopped merge waits for the part in ``folder``."""
    if is_merging(out) and not _is_wanted(out, folder):
        raise ConfigError(f"{out}: {parts_waiting(out)}")


def _is_wanted(out: Path, folder: Path) -> bool:
    """Whether a part lacks a shard that a merge has not moved: it was found damaged, and deleted."""
    finished = read_finished(folder)
    if finished is None:
        return True
    names = [record.name for records in finished.splits.values() for record in records]
    with reading(folder):
        return not all((folder / name).exists() or (out / name).exists() for name in names)


def _require_there(
    out: Path, part: JobPart, indices: range, seed: int, config: MakeConfig, division: SplitRule
) -> None:
    """Raise ``ConfigError`` unless a data set that is merged, or was made in one go, holds these samples."""
    there: set[int] = set()
    for split, size in division.shard_sizes.items():
        asked = SplitRecord(seed, recipe_of(config), size)
        index = read_index(out, split)
        record_to_resume(out, split, index.tables(), asked)
        there.update(index.table.sample.tolist())
    if missing := set(indices) - there:
        raise ConfigError(
            f"{out}: holds a data set that is not made in parts, without {len(missing)} of the {len(indices)} samples "
            f"of part {part}: go on with it without --shard, or choose another folder"
        )
