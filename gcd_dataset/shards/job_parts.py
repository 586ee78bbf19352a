"""The parts of a data set made by independent jobs of a cluster; ``gcd merge`` joins them.

    .parts/parts.json                  the plan: number of parts, count, seed, recipe, versions
    .parts/00002-of-00008/             a part: shards, index and manifest as in any data set, and a lock
    .parts/00002-of-00008/part.json    of a finished part: its range, seed, recipe hash, versions, and its shards
    .parts/merging                     exists during ``gcd merge``, and after an interrupted one
    .parts-merged/                     ``.parts`` after its shards are merged, until the merge is complete

Shards of a part have the numbers of the merged data set. A shard that spans two parts exists in both, with the
samples of the respective part.
"""

import contextlib
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Self

import gcd_dataset
from gcd_dataset.errors import ConfigError, ShardError
from gcd_dataset.files import make_folder, write_whole
from gcd_dataset.jsonfile import found
from gcd_dataset.shards.access import locked, read_limited, reading
from gcd_dataset.shards.layout import FAILED, recipe_hash
from gcd_dataset.shards.limits import LARGEST_JSON
from gcd_dataset.shards.manifest import ShardRecord, SplitRecord
from gcd_dataset.shards.meta import decode_json, json_bytes

__all__ = [
    "MERGED",
    "PARTS",
    "FinishedPart",
    "NamedRecipe",
    "PartsPlan",
    "finished_path",
    "has_plan",
    "is_merging",
    "merging_path",
    "part_folder",
    "parts_lock",
    "parts_waiting",
    "read_finished",
    "read_plan",
    "require_merged",
    "require_version",
    "write_finished",
    "write_or_check_plan",
]

PARTS, MERGED = ".parts", ".parts-merged"
PLAN, FINISHED, MERGING = "parts.json", "part.json", "merging"
LOCK = ".parts.lock"
DIGITS = 12  # shown digits of a hash, in messages


@dataclass(frozen=True)
class NamedRecipe:
    """A published recipe, as far as ``merge`` needs it."""

    name: str
    sha256: str
    """Hash of the recipe."""
    splits: Mapping[str, float]
    """Split to its share of the designs."""
    patterns: str
    """Hash of all its patterns; empty where the recipe does not hold it."""


@dataclass(frozen=True)
class PartsPlan:
    """The plan shared by all parts of a data set."""

    of: int
    """Number of parts."""
    count: int
    """Samples of all parts together."""
    seed: int
    recipe: Mapping[str, Any]
    """Options of the generator."""
    shard_sizes: Mapping[str, int]
    """Split to the range of indices that a shard covers."""
    schema: int
    versions: Mapping[str, str]
    """Package to version, of all packages that decide the bytes."""
    named: NamedRecipe | None = None
    """The published recipe, if the data set follows one."""

    @property
    def recipe_sha256(self) -> str:
        """Hash of the options and of the published recipe."""
        return recipe_hash({**self.recipe, **({} if self.named is None else {"named": self.named.sha256})})

    @property
    def splits(self) -> tuple[str, ...]:
        """All splits except ``failed``; a job locks the first of them."""
        return tuple(split for split in self.shard_sizes if split != FAILED)

    def require_same(self, requested: "PartsPlan", path: Path) -> None:
        """Raise ``ConfigError`` with both values where ``requested`` differs; ``path``: the file of this plan."""
        existing, wanted = self._flat(), requested._flat()
        for name in sorted(existing.keys() | wanted.keys()):
            if recipe_hash({name: existing.get(name)}) != recipe_hash({name: wanted.get(name)}):
                raise ConfigError(
                    f"{path}: parts begun with {name}={existing.get(name)!r}, asked for {name}={wanted.get(name)!r}: "
                    f"use the same, choose another folder, or delete {path.parent} to start over"
                )

    def _flat(self) -> dict[str, Any]:
        """Name to value of everything in the plan, options and versions included."""
        sizes = {"parts": self.of, "count": self.count, "seed": self.seed, "shard_sizes": dict(self.shard_sizes)}
        named = None if self.named is None else f"{self.named.name} ({self.named.sha256[:DIGITS]})"
        return {"named": named, **sizes, "schema": self.schema, **self.versions, **self.recipe}


@dataclass(frozen=True)
class FinishedPart:
    """The record of a finished part, ``part.json``."""

    part: int
    """Counted from 0."""
    of: int
    """Number of parts."""
    first: int
    """Index of its first sample."""
    stop: int
    """One past the index of its last sample."""
    count: int
    """Samples of all parts together."""
    seed: int
    recipe_sha256: str
    schema: int
    versions: Mapping[str, str]
    splits: Mapping[str, tuple[ShardRecord, ...]]
    """Split to the records of its shards."""

    @classmethod
    def of_plan(cls, part: int, indices: range, plan: PartsPlan, splits: Mapping[str, SplitRecord]) -> Self:
        """The record of part ``part``, which covers ``indices``; ``splits``: of its manifest."""
        return cls(
            part, plan.of, indices.start, indices.stop, plan.count, plan.seed, plan.recipe_sha256, plan.schema,
            plan.versions, {name: split.shards for name, split in splits.items()},
        )  # fmt: skip

    def require_of(self, plan: PartsPlan, part: int, path: Path, remedy: str) -> None:
        """Raise ``ConfigError`` unless this is part ``part`` of ``plan``; ``path``: the file of this record."""
        if self.part != part:
            raise ConfigError(f"{path}: record of part {self.part}, expected part {part}: {remedy}")
        own = {"parts": self.of, "count": self.count, "seed": self.seed, "recipe_sha256": self.recipe_sha256}
        planned = {"parts": plan.of, "count": plan.count, "seed": plan.seed, "recipe_sha256": plan.recipe_sha256}
        own |= {"schema": self.schema, **self.versions}
        planned |= {"schema": plan.schema, **plan.versions}
        for name in sorted(own.keys() | planned.keys()):
            if own.get(name) != planned.get(name):
                raise ConfigError(
                    f"{path}: made with {name}={own.get(name)!r}, the other parts with {name}={planned.get(name)!r}: "
                    f"{remedy}"
                )


def part_folder(out: Path, part: int, of: int) -> Path:
    """The folder of a part.

    >>> part_folder(Path("shards"), 2, 8).as_posix()
    'shards/.parts/00002-of-00008'
    """
    return out / PARTS / f"{part:05d}-of-{of:05d}"


def finished_path(folder: Path) -> Path:
    """The path of the record ``part.json`` of the part in ``folder``."""
    return folder / FINISHED


def merging_path(out: Path) -> Path:
    """The file that exists during a merge, and after an interrupted one."""
    return out / PARTS / MERGING


def is_merging(out: Path) -> bool:
    """Whether a merge is running or was interrupted. Raises ``ShardError``."""
    with reading(merging_path(out)):
        return merging_path(out).exists()


def parts_waiting(out: Path) -> str | None:
    """A message about the unmerged parts in a folder, with a remedy; ``None`` where there are none.

    Raises ``ShardError`` for a folder that cannot be read.
    """
    with reading(out):
        folder = out / PARTS
        if not folder.is_dir():
            return None
        finished = sum(1 for _ in folder.glob(f"*-of-*/{FINISHED}"))
        begun = (folder / PLAN).exists()
    if is_merging(out):
        return f"the merge of its parts is running or was stopped: run gcd merge {out}"
    of = read_plan(folder).of if begun else 0
    others = "" if finished == of else "make the others, then "
    return f"{finished} of {of or 'its'} parts are finished: {others}run gcd merge {out}"


def require_merged(out: Path, error: type[ShardError | ConfigError] = ShardError) -> None:
    """Raise ``error`` for a folder with unmerged parts."""
    if (problem := parts_waiting(out)) is not None:
        raise error(f"{out}: made in parts: {problem}")


@contextlib.contextmanager
def parts_lock(out: Path) -> Iterator[None]:
    """Lock the folder against the start of a part, and the start or end of a merge. Raises ``OutputError``."""
    with locked(make_folder(out) / LOCK, "beginning a part", wait=True):
        yield


def write_or_check_plan(out: Path, requested: PartsPlan) -> None:
    """Write the plan to ``out`` if there is none. Raises ``ConfigError`` where ``out`` has another plan.

    Raises ``OutputError`` where the plan cannot be written, ``ShardError`` for a broken one.
    """
    path = make_folder(out / PARTS) / PLAN
    if not path.exists():
        write_whole(path, _json(asdict(requested)))
    read_plan(out / PARTS).require_same(requested, path)


def has_plan(folder: Path) -> bool:
    """Whether ``folder`` holds a plan of parts. Raises ``ShardError``."""
    with reading(folder):
        return (folder / PLAN).exists()


def read_plan(folder: Path) -> PartsPlan:
    """The plan of the parts in ``folder``. Raises ``ShardError`` for a missing or broken file."""
    remedy = f"copy it again, or delete {folder} and make the parts again"
    values = _read(folder / PLAN, PLAN_TYPES, remedy)
    named = values["named"]
    return PartsPlan(**{**values, "named": None if named is None else NamedRecipe(**named)})


def read_finished(folder: Path) -> FinishedPart | None:
    """The record of the part in ``folder``; ``None`` for an unfinished part. Raises ``ShardError``."""
    path, remedy = finished_path(folder), "delete it and run this part again"
    with reading(path):
        if not path.exists():
            return None
    values = _read(path, FINISHED_TYPES, remedy)
    try:
        splits = {
            name: SplitRecord.from_json(name, {"seed": 0, "recipe": {}, "shard_size": 1, "shards": shards}).shards
            for name, shards in values["splits"].items()
        }
    except ShardError as error:
        raise ShardError(f"{path}: {error}: {remedy}") from error
    return FinishedPart(**{**values, "splits": splits})


def write_finished(folder: Path, finished: FinishedPart) -> None:
    """Write the record of the finished part in ``folder``. Raises ``OutputError``."""
    write_whole(finished_path(folder), _json(asdict(finished)))


def require_version(path: Path, plan: PartsPlan) -> None:
    """Raise ``ConfigError`` for parts made by another version of this package; ``path``: for the message."""
    if (made := plan.versions.get("gcd_dataset")) != (now := gcd_dataset.__version__):
        raise ConfigError(f"{path}: its parts were made by gcd_dataset {made}, but this is {now}: install {made}")


def _json(value: Any) -> bytes:
    return json_bytes(value) + b"\n"


def _is_count(value: Any) -> bool:
    return isinstance(value, int) and not isinstance(value, bool) and 0 <= value < 1 << 62


def _is_natural(value: Any) -> bool:
    return isinstance(value, int) and not isinstance(value, bool) and value >= 0


def _is_text(value: Any) -> bool:
    return isinstance(value, str)


def _is_mapping(value: Any) -> bool:
    return isinstance(value, Mapping)


def _is_versions(value: Any) -> bool:
    return isinstance(value, Mapping) and all(map(_is_text, value.values()))


def _is_sizes(value: Any) -> bool:
    return isinstance(value, Mapping) and all(_is_count(size) and size > 0 for size in value.values())


def _is_named(value: Any) -> bool:
    if value is None:
        return True
    texts = ("name", "sha256", "patterns")
    return (
        isinstance(value, Mapping)
        and value.keys() == {"splits", *texts}
        and all(_is_text(value[name]) for name in texts)
        and _is_mapping(value["splits"])
    )


PLAN_TYPES = {
    "of": _is_count, "count": _is_count, "seed": _is_natural, "recipe": _is_mapping, "shard_sizes": _is_sizes,
    "schema": _is_count, "versions": _is_versions, "named": _is_named,
}  # fmt: skip
FINISHED_TYPES = {
    "part": _is_count, "of": _is_count, "first": _is_count, "stop": _is_count, "count": _is_count,
    "seed": _is_natural, "recipe_sha256": _is_text, "schema": _is_count, "versions": _is_versions,
    "splits": _is_mapping,
}  # fmt: skip


def _read(path: Path, types: Mapping[str, Any], remedy: str) -> dict[str, Any]:
    """The entries of a JSON file, checked. Raises ``ShardError`` for a missing or broken file."""
    try:
        entry = decode_json(read_limited(path, LARGEST_JSON))
        if not isinstance(entry, Mapping):
            raise ShardError(f"it holds {found(entry)}, expected an object")
        for name, is_valid in types.items():
            if not is_valid(entry.get(name)):
                raise ShardError(f"{name} is {found(entry.get(name))}")
    except ShardError as error:
        if str(error).startswith(str(path)):
            raise
        raise ShardError(f"{path}: {error}: {remedy}") from error
    return {name: entry[name] for name in types}
