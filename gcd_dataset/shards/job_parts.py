"""A data set that is made in parts, by jobs that need not know of each other, until ``gcd merge`` joins them.

    .parts/parts.json              what the parts have in common: how many they are, count, seed, recipe, versions
    .parts/00002-of-00008/         shards, index and manifest of a part, as of any data set; its lock
    .parts/00002-of-00008/part.json    of a finished part: its range, seed, recipe hash, versions, and its shards
    .parts/merging                 while, or since a killed, ``gcd merge`` moves shards

Shards of a part have the numbers that they have in the whole; a shard at the border of two parts is in both, with the
samples of each.
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
from gcd_dataset.shards.access import locked, read_small, reading
from gcd_dataset.shards.layout import FAILED, recipe_hash
from gcd_dataset.shards.limits import LARGEST_JSON
from gcd_dataset.shards.manifest import ShardRecord, SplitRecord
from gcd_dataset.shards.meta import decode_json, json_bytes

__all__ = [
    "MERGED",
    "PARTS",
    "FinishedPart",
    "NamedSet",
    "PartsPlan",
    "agree_on",
    "changing_parts",
    "finished_path",
    "has_plan",
    "is_merging",
    "merging_path",
    "part_folder",
    "parts_waiting",
    "read_finished",
    "read_plan",
    "require_merged",
    "require_version",
    "write_finished",
]

PARTS, MERGED = ".parts", ".parts-merged"
PLAN, FINISHED, MERGING = "parts.json", "part.json", "merging"
LOCK = ".parts.lock"
DIGITS = 12  # of a hash, in messages


@dataclass(frozen=True)
class NamedSet:
    """The recipe of a data set that has a name, as far as ``merge`` needs it."""

    name: str
    sha256: str
    """Of the recipe."""
    splits: Mapping[str, float]
    """Split to its share of the designs."""
    patterns: str
    """The hash of all its patterns; empty where the recipe does not tell it."""


@dataclass(frozen=True)
class PartsPlan:
    """What the parts of a data set have in common."""

    of: int
    """How many they are."""
    count: int
    """Samples of all parts."""
    seed: int
    recipe: Mapping[str, Any]
    """The options that samples are made with."""
    shard_sizes: Mapping[str, int]
    """Split to the range of indices of its shards."""
    schema: int
    versions: Mapping[str, str]
    """Package to version, of all that decides the bytes."""
    named: NamedSet | None = None
    """The recipe, of a data set that has a name."""

    @property
    def recipe_sha256(self) -> str:
        """Of the options, and of the recipe of a data set that has a name."""
        return recipe_hash({**self.recipe, **({} if self.named is None else {"named": self.named.sha256})})

    @property
    def splits(self) -> tuple[str, ...]:
        """Splits that are there whatever comes out, the first of them locked while a part is made."""
        return tuple(split for split in self.shard_sizes if split != FAILED)

    def require_same(self, asked: "PartsPlan", place: Path) -> None:
        """Raise ``ConfigError`` with both sides where other parts are asked for; ``place``: the file of this plan."""
        mine, theirs = self._told(), asked._told()
        for name in sorted(mine.keys() | theirs.keys()):
            if recipe_hash({name: mine.get(name)}) != recipe_hash({name: theirs.get(name)}):
                raise ConfigError(
                    f"{place}: parts begun with {name}={mine.get(name)!r}, asked for {name}={theirs.get(name)!r}: use "
                    f"the same, choose another folder, or delete {place.parent} to begin anew"
                )

    def _told(self) -> dict[str, Any]:
        """Name to value of everything in it."""
        own = {"parts": self.of, "count": self.count, "seed": self.seed, "shard_sizes": dict(self.shard_sizes)}
        named = None if self.named is None else f"{self.named.name} ({self.named.sha256[:DIGITS]})"
        return {"named": named, **own, "schema": self.schema, **self.versions, **self.recipe}


@dataclass(frozen=True)
class FinishedPart:
    """What a part that is finished leaves."""

    part: int
    of: int
    first: int
    """Its first sample."""
    stop: int
    """Its last sample, plus one."""
    count: int
    """Samples of all parts."""
    seed: int
    recipe_sha256: str
    schema: int
    versions: Mapping[str, str]
    splits: Mapping[str, tuple[ShardRecord, ...]]
    """Split to its shards."""

    @classmethod
    def of_plan(cls, part: int, indices: range, plan: PartsPlan, splits: Mapping[str, SplitRecord]) -> Self:
        """Part ``part`` of a plan, of these samples, with the splits of its manifest."""
        return cls(
            part, plan.of, indices.start, indices.stop, plan.count, plan.seed, plan.recipe_sha256, plan.schema,
            plan.versions, {name: split.shards for name, split in splits.items()},
        )  # fmt: skip

    def require_of(self, plan: PartsPlan, part: int, place: Path, remedy: str) -> None:
        """Raise ``ConfigError`` where this is not that part of ``plan``; ``place``: its file."""
        if self.part != part:
            raise ConfigError(f"{place}: of part {self.part}, where part {part} is read: {remedy}")
        mine = {"parts": self.of, "count": self.count, "seed": self.seed, "recipe_sha256": self.recipe_sha256}
        theirs = {"parts": plan.of, "count": plan.count, "seed": plan.seed, "recipe_sha256": plan.recipe_sha256}
        mine |= {"schema": self.schema, **self.versions}
        theirs |= {"schema": plan.schema, **plan.versions}
        for name in sorted(mine.keys() | theirs.keys()):
            if mine.get(name) != theirs.get(name):
                raise ConfigError(
                    f"{place}: made with {name}={mine.get(name)!r}, the other parts with {name}={theirs.get(name)!r}: "
                    f"{remedy}"
                )


def part_folder(out: Path, part: int, of: int) -> Path:
    """The place of a part.

    >>> part_folder(Path("shards"), 2, 8).as_posix()
    'shards/.parts/00002-of-00008'
    """
    return out / PARTS / f"{part:05d}-of-{of:05d}"


def finished_path(folder: Path) -> Path:
    """The file that the part in ``folder`` leaves when it is finished."""
    return folder / FINISHED


def merging_path(out: Path) -> Path:
    """The file that is there while parts are merged, and after that was broken off."""
    return out / PARTS / MERGING


def is_merging(out: Path) -> bool:
    """Whether the parts are being merged, or have been merged in part. Raises ``ShardError``."""
    with reading(merging_path(out)):
        return merging_path(out).exists()


def parts_waiting(out: Path) -> str | None:
    """How many parts wait in a folder to be merged, and what to do about it; ``None`` where there are none.

    Raises ``ShardError`` for a folder that cannot be read.
    """
    with reading(out):
        folder = out / PARTS
        if not folder.is_dir():
            return None
        finished = sum(1 for _ in folder.glob(f"*-of-*/{FINISHED}"))
        begun = (folder / PLAN).exists()
    if is_merging(out):
        return f"the merge of its parts goes on, or was stopped: run gcd merge {out}"
    of = read_plan(folder).of if begun else 0
    others = "" if finished == of else "make the others, then "
    return f"{finished} of {of or 'its'} parts are finished: {others}run gcd merge {out}"


def require_merged(out: Path, error: type[ShardError | ConfigError] = ShardError) -> None:
    """Raise ``error`` for a folder whose parts wait to be merged."""
    if (told := parts_waiting(out)) is not None:
        raise error(f"{out}: made in parts: {told}")


@contextlib.contextmanager
def changing_parts(out: Path) -> Iterator[None]:
    """Hold off parts that begin, and a merge that begins or ends, for the moment that the block takes.

    Raises ``OutputError``.
    """
    with locked(make_folder(out) / LOCK, "beginning a part", wait=True):
        yield


def agree_on(out: Path, asked: PartsPlan) -> None:
    """Have a plan in ``out``, written if there is none. Raises ``ConfigError`` for parts of another plan.

    Raises ``OutputError`` where it cannot be written, ``ShardError`` for a broken one.
    """
    path = make_folder(out / PARTS) / PLAN
    if not path.exists():
        write_whole(path, _json(asdict(asked)))
    read_plan(out / PARTS).require_same(asked, path)


def has_plan(folder: Path) -> bool:
    """Whether parts were begun in ``folder``. Raises ``ShardError``."""
    with reading(folder):
        return (folder / PLAN).exists()


def read_plan(folder: Path) -> PartsPlan:
    """The plan of the parts in ``folder``. Raises ``ShardError`` for one that is missing or broken."""
    remedy = f"copy it again, or delete {folder} and make the parts anew"
    values = _read(folder / PLAN, PLAN_TYPES, remedy)
    named = values["named"]
    return PartsPlan(**{**values, "named": None if named is None else NamedSet(**named)})


def read_finished(folder: Path) -> FinishedPart | None:
    """What the part in ``folder`` left when it was finished; ``None`` if it is not. Raises ``ShardError``."""
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
    """Leave word that the part in ``folder`` is finished. Raises ``OutputError``."""
    write_whole(finished_path(folder), _json(asdict(finished)))


def require_version(place: Path, plan: PartsPlan) -> None:
    """Raise ``ConfigError`` for parts by another version of this package."""
    if (made := plan.versions.get("gcd_dataset")) != (now := gcd_dataset.__version__):
        raise ConfigError(f"{place}: its parts were made by gcd_dataset {made}, and this is {now}: install {made}")


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
    """The entries of a file. Raises ``ShardError`` for one that is missing or broken."""
    try:
        entry = decode_json(read_small(path, LARGEST_JSON))
        if not isinstance(entry, Mapping):
            raise ShardError(f"it holds {found(entry)}, where an object is read")
        for name, is_fit in types.items():
            if not is_fit(entry.get(name)):
                raise ShardError(f"{name} is {found(entry.get(name))}")
    except ShardError as error:
        if str(error).startswith(str(path)):
            raise
        raise ShardError(f"{path}: {error}: {remedy}") from error
    return {name: entry[name] for name in types}
