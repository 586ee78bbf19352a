"""``manifest.json``: the plan, the shards and the counts of each split of a data set.

It is gathered from the notes of the shards (``gcd_dataset.shards.notes``) when all are made, or by ``gcd index``. The
file is one line of JSON with sorted keys; ``digest`` is the SHA-256 of the file without it.
"""

import hashlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path
from typing import Any, Self

import gcd_dataset
from gcd_dataset.errors import ConfigError, ShardError, shown
from gcd_dataset.jsonfile import found
from gcd_dataset.names import require_name
from gcd_dataset.shards.access import read_limited, reading
from gcd_dataset.shards.layout import SCHEMA, recipe_hash
from gcd_dataset.shards.limits import LARGEST_MANIFEST
from gcd_dataset.shards.meta import decode_json, json_bytes

__all__ = [
    "MANIFEST",
    "Manifest",
    "Plan",
    "RecipeRecord",
    "ShardRecord",
    "SplitRecord",
    "parse_manifest",
    "read_manifest",
]

MANIFEST = "manifest.json"
REMEDY = "delete it, then run gcd index"
DIGITS = 12  # shown digits of a hash, in messages
MOST = 1 << 31  # samples of a split, and shards
LONGEST = 1 << 40  # bytes of a shard


@dataclass(frozen=True)
class Plan:
    """What a data set will hold; its shards follow from it."""

    kind: str
    """``garments`` or ``bodies``."""
    seed: int
    recipe: Mapping[str, Any]
    """Options of the generator."""
    count: int
    """Samples of all splits together."""
    shard_size: int
    """Samples of a shard of this split; the last one may hold fewer."""
    generator: str = gcd_dataset.__version__
    """Version of this package that makes the data set."""
    named: tuple[str, str] | None = None
    """Name and SHA-256 of the published recipe that the data set follows."""

    def require_same(self, asked: "Plan", location: object) -> None:
        """Raise ``ConfigError`` with the first difference; count and shard size may differ, since data sets grow.

        ``location``: the file that holds this plan, for the message.
        """
        if self.generator != asked.generator:
            raise ConfigError(
                f"{location}: made by gcd_dataset {self.generator}, but this is {asked.generator}: choose another "
                f"folder, or install {self.generator} to continue this one"
            )
        for name, before, now in self._differences(asked):
            raise ConfigError(
                f"{location}: made with {name}={before!r}, asked for {name}={now!r}: use the same or another folder"
            )

    def _differences(self, asked: "Plan") -> list[tuple[str, Any, Any]]:
        mine, theirs = self._options(), asked._options()
        names = [*mine, *sorted(theirs.keys() - mine.keys())]
        return [
            (name, mine.get(name), theirs.get(name))
            for name in names
            if recipe_hash({"": mine.get(name)}) != recipe_hash({"": theirs.get(name)})
        ]

    def _options(self) -> dict[str, Any]:
        named = None if self.named is None else f"{self.named[0]} ({self.named[1][:DIGITS]})"
        return {"kind": self.kind, "recipe": named, "seed": self.seed, **dict(sorted(self.recipe.items()))}

    def to_json(self) -> dict[str, Any]:
        """The plan as a JSON object."""
        return {**self.__dict__, "recipe": dict(self.recipe), "named": self.named and list(self.named)}

    @classmethod
    def from_json(cls, entry: Any, location: str) -> Self:
        """The plan in a JSON object. Raises ``ShardError``."""
        values = checked(entry, location, PLAN_TYPES)
        return cls(**{**values, "named": values["named"] and tuple(values["named"])})


@dataclass(frozen=True)
class ShardRecord:
    """One finished shard."""

    number: int
    count: int
    """Samples; a shard may be empty, if all its drapes failed."""
    size: int
    """Bytes of the tar."""
    sha256: str
    views_size: int = 0
    """Bytes of the tar of its pictures; 0 without pictures."""
    views_sha256: str = ""

    def name(self, split: str, *, views: bool = False) -> str:
        """The path of its tar in the data set's folder.

        >>> ShardRecord(12, 32, 1024, "").name("train"), ShardRecord(12, 32, 1024, "").views_name("train")
        ('train-00012.tar', 'views/train-00012.tar')
        """
        return f"{'views/' if views else ''}{split}-{self.number:05d}.tar"

    def views_name(self, split: str) -> str:
        """The path of the tar of its pictures in the data set's folder."""
        return self.name(split, views=True)

    def to_json(self) -> list[Any]:
        """The record as a list: number, count, size, SHA-256; with pictures also their size and SHA-256."""
        views = [self.views_size, self.views_sha256] if self.views_size else []
        return [self.number, self.count, self.size, self.sha256, *views]

    @classmethod
    def from_json(cls, entry: Any, location: str) -> Self:
        """The record in such a list. Raises ``ShardError``."""
        if not isinstance(entry, list) or len(entry) not in (4, 6):
            raise ShardError(f"{location}: {found(entry)}, expected 4 or 6 values")
        record = cls(*entry)
        limits = (MOST, MOST, LONGEST, LONGEST)
        if not all(map(_is_count, (*entry[:3], record.views_size), limits)):
            raise ShardError(f"{location}: {found(entry)}: a number is out of range")
        if not _is_hash(record.sha256) or (record.views_size and not _is_hash(record.views_sha256)):
            raise ShardError(f"{location}: {found(entry)}: a hash is not 64 hexadecimal digits")
        return record


@dataclass(frozen=True)
class SplitRecord:
    """The plan and the shards of a split."""

    plan: Plan
    shards: tuple[ShardRecord, ...] = ()
    """In the order of their numbers."""
    members: tuple[str, ...] = ()
    """The members of every sample in file order, pictures last; empty without samples."""
    rejects: Mapping[str, int] = field(default_factory=dict)
    """Rule to the number of designs it rejected for the samples, the most frequent first."""
    redraws: Mapping[str, int] = field(default_factory=dict)
    """Rule to the number of redraws it caused, of parameters, parts and whole designs, the most frequent first."""
    index_sha256: str = ""
    """Of the file of the split's index."""
    skipped: int = 0
    """Samples that could not be made: damaged garments of a published data set."""

    @property
    def count(self) -> int:
        """Number of samples."""
        return sum(shard.count for shard in self.shards)

    def to_json(self) -> dict[str, Any]:
        """The record as a JSON object."""
        return {
            **self.__dict__,
            "plan": self.plan.to_json(),
            "shards": [shard.to_json() for shard in self.shards],
            "members": list(self.members),
            "rejects": dict(self.rejects),
            "redraws": dict(self.redraws),
        }

    @classmethod
    def from_json(cls, name: str, entry: Any) -> Self:
        """Split ``name`` from its JSON object. Raises ``ShardError``."""
        location = f"split {require_name(name, 'split')}"
        values = checked(entry, location, SPLIT_TYPES)
        shards = tuple(ShardRecord.from_json(shard, f"{location}, a shard") for shard in values["shards"])
        if any(a.number >= b.number for a, b in pairwise(shards)):
            raise ShardError(f"{location}: the numbers of its shards do not ascend")
        if sum(shard.count for shard in shards) >= MOST:
            raise ShardError(f"{location}: more than {MOST} samples")
        counts = {name: ranked(values[name]) for name in ("rejects", "redraws")}
        plan = Plan.from_json(values["plan"], f"{location}, plan")
        members = tuple(require_name(member, f"{location}, member") for member in values["members"])
        return cls(**{**values, **counts, "plan": plan, "shards": shards, "members": members})


@dataclass(frozen=True)
class RecipeRecord:
    """The published recipe that a data set follows."""

    name: str
    sha256: str
    """Hash of the recipe."""
    patterns: str = ""
    """``gcd_dataset.patternhash`` of all patterns; empty until all are made."""


@dataclass(frozen=True)
class Manifest:
    """The contents of ``manifest.json``."""

    splits: Mapping[str, SplitRecord] = field(default_factory=dict)
    generator: str = gcd_dataset.__version__
    """Version of this package that made the data set."""
    schema: int = SCHEMA
    recipe: RecipeRecord | None = None
    """The published recipe of the whole data set; ``None`` without one."""

    @property
    def counts(self) -> dict[str, int]:
        """Split to its number of samples."""
        return {name: split.count for name, split in self.splits.items()}

    def missing(self, split: str) -> tuple[int, int] | None:
        """How many of the planned samples are made, in all splits, and their planned number; ``None`` if all are."""
        planned = self.splits[split].plan.count
        made = sum(record.count + record.skipped for record in self.splits.values())
        return (made, planned) if made < planned else None

    def to_bytes(self) -> bytes:
        """The content of ``manifest.json``."""
        recipe = None if self.recipe is None else dict(self.recipe.__dict__)
        splits = {name: split.to_json() for name, split in self.splits.items()}
        entry = {"generator": self.generator, "recipe": recipe, "schema": self.schema, "splits": splits}
        return _sorted_bytes({**entry, "digest": hashlib.sha256(_sorted_bytes(entry)).hexdigest()}) + b"\n"


def read_manifest(folder: Path) -> Manifest | None:
    """The manifest of a folder; ``None`` if there is none.

    Raises ``ShardError`` for a broken file, and, naming both versions, for another schema.
    """
    path = folder / MANIFEST
    with reading(path):
        exists = path.exists()
    return parse_manifest(read_limited(path, LARGEST_MANIFEST), str(path)) if exists else None


def parse_manifest(content: bytes, path: str, remedy: str = REMEDY) -> Manifest:
    """The manifest in a file's content; ``path`` and ``remedy`` for messages. Raises as ``read_manifest`` does."""
    try:
        entry = decode_json(content, limit=LARGEST_MANIFEST)
        schema = entry.get("schema") if isinstance(entry, Mapping) else None
        if not isinstance(schema, int) or not _is_count(schema):
            raise ShardError("schema is missing")
        if schema != SCHEMA:
            raise ShardError(other_schema(path, schema, entry.get("generator")))
        values = checked(entry, "the file", FILE_TYPES)
        rest = {name: value for name, value in entry.items() if name != "digest"}
        if hashlib.sha256(_sorted_bytes(rest)).hexdigest() != values["digest"]:
            raise ShardError("its digest does not match its content")
        splits = {name: SplitRecord.from_json(name, split) for name, split in values["splits"].items()}
        recipe = values["recipe"] and RecipeRecord(**checked(values["recipe"], "recipe", RECIPE_TYPES))
        return Manifest(splits, values["generator"], schema, recipe)
    except ShardError as error:
        if str(error).startswith(path):
            raise
        raise ShardError(f"{path}: not a manifest ({error}): {remedy}") from error


def other_schema(path: object, schema: int, generator: object) -> str:
    """The message about a data set of another schema."""
    version = shown(str(generator or "of another version")[:40])
    return (
        f"{path}: a data set of schema {schema}, made by gcd_dataset {version}; "
        f"gcd_dataset {gcd_dataset.__version__} reads schema {SCHEMA} alone: make it again, or install that version"
    )


def ranked(counts: Mapping[str, int]) -> dict[str, int]:
    """The counts, the largest first."""
    return dict(sorted(counts.items(), key=lambda entry: (-entry[1], entry[0])))


def _sorted_bytes(entry: Mapping[str, Any]) -> bytes:
    return json_bytes(_sorted(entry))


def _sorted(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {name: _sorted(value[name]) for name in sorted(value)}
    return value


def checked(entry: Any, location: str, types: Mapping[str, Callable[[Any], bool]]) -> dict[str, Any]:
    """The entries named in ``types``. Raises ``ShardError`` for a missing or invalid one."""
    if not isinstance(entry, Mapping):
        raise ShardError(f"{location} is {found(entry)}, expected an object")
    for name, is_valid in types.items():
        if name not in entry:
            raise ShardError(f"{location}: {name} is missing")
        if not is_valid(entry[name]):
            raise ShardError(f"{location}: {name} is {found(entry[name])}")
    return {name: entry[name] for name in types}


def _is_count(value: Any, most: int = 1 << 62) -> bool:
    return isinstance(value, int) and not isinstance(value, bool) and 0 <= value < most


def _is_text(value: Any) -> bool:
    return isinstance(value, str)


def _is_hash(value: Any) -> bool:
    return isinstance(value, str) and len(value) == 64 and not value.strip("0123456789abcdef")


def _is_object(value: Any) -> bool:
    return isinstance(value, Mapping)


def _are_counts(value: Any) -> bool:
    return isinstance(value, Mapping) and all(map(_is_count, value.values()))


def _are_texts(value: Any) -> bool:
    return isinstance(value, list) and all(map(_is_text, value))


Types = Mapping[str, Callable[[Any], bool]]
FILE_TYPES: Types = {
    "generator": _is_text,
    "splits": _is_object,
    "digest": _is_text,
    "recipe": lambda value: value is None or _is_object(value),
}
RECIPE_TYPES: Types = {"name": _is_text, "sha256": _is_text, "patterns": _is_text}
PLAN_TYPES: Types = {
    "kind": _is_text,
    "seed": _is_count,
    "recipe": _is_object,
    "count": _is_count,
    "shard_size": lambda value: _is_count(value) and value > 0,
    "generator": _is_text,
    "named": lambda value: value is None or (_are_texts(value) and len(value) == 2),
}
SPLIT_TYPES: Types = {
    "plan": _is_object,
    "shards": lambda value: isinstance(value, list),
    "members": _are_texts,
    "rejects": _are_counts,
    "redraws": _are_counts,
    "index_sha256": lambda value: value == "" or _is_hash(value),
    "skipped": _is_count,
}
