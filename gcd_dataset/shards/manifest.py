"""``manifest.json``: the plan, the shards and the counts of each split of a data set.

It is gathered from the notes of the shards (``gcd_dataset.shards.notes``) when all are made, or by ``gcd index``. The
file is one line of JSON with sorted keys; ``digest`` is the SHA-256 of the file without it.
"""

import hashlib
import json
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields, is_dataclass
from itertools import pairwise
from pathlib import Path
from types import UnionType
from typing import Any, Self, get_args, get_origin

import gcd_dataset
from gcd_dataset.errors import ConfigError, ShardError, shown
from gcd_dataset.files import require_name
from gcd_dataset.jsonfile import found
from gcd_dataset.shards.access import read_file, reading
from gcd_dataset.shards.layout import LARGEST_MANIFEST, MEMBERS, SCHEMA, recipe_hash
from gcd_dataset.shards.meta import decode_json, is_count

MANIFEST = "manifest.json"
REMEDY = "delete it, then run gcd index"
DIGITS = 12  # shown digits of a hash, in messages
MOST = 1 << 31  # samples of a split, and shards
LONGEST = 1 << 40  # bytes of a shard
HASH = re.compile("[0-9a-f]{64}")
DIGEST = re.compile(rb'\{"digest":"([0-9a-f]{64})",')


def shard_name(split: str, number: int, *, views: bool = False) -> str:
    """The path of a shard's tar, or of that of its pictures, in the data set's folder."""
    return f"{'views/' if views else ''}{split}-{number:05d}.tar"


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
        """Raise ``ConfigError`` with the first difference; count and shard size may differ.

        ``location``: the file that holds this plan, for the message.
        """
        if self.generator != asked.generator:
            raise ConfigError(
                f"{location}: made by gcd_dataset {self.generator}, but this is {asked.generator}: choose another "
                f"folder, or install {self.generator} to continue this one"
            )
        mine, theirs = self._options(), asked._options()
        for name in [*mine, *sorted(theirs.keys() - mine.keys())]:
            before, now = mine.get(name), theirs.get(name)
            if recipe_hash({"": before}) != recipe_hash({"": now}):
                raise ConfigError(
                    f"{location}: made with {name}={before!r}, asked for {name}={now!r}: use the same or another folder"
                )

    def _options(self) -> dict[str, Any]:
        named = None if self.named is None else f"{self.named[0]} ({self.named[1][:DIGITS]})"
        return {"kind": self.kind, "recipe": named, "seed": self.seed, **dict(sorted(self.recipe.items()))}

    def to_json(self) -> dict[str, Any]:
        """The plan as a JSON object."""
        return {**self.__dict__, "recipe": dict(self.recipe)}

    @classmethod
    def from_json(cls, entry: Any, location: str) -> Self:
        """The plan in a JSON object. Raises ``ShardError``."""
        plan = cls(**checked(cls, entry, location))
        if not plan.shard_size:
            raise ShardError(f"{location}: shard_size is 0")
        return plan


@dataclass(frozen=True, slots=True)
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
        return shard_name(split, self.number, views=views)

    def views_name(self, split: str) -> str:
        """The path of the tar of its pictures in the data set's folder."""
        return shard_name(split, self.number, views=True)

    def to_json(self) -> list[Any]:
        """The record as a list: number, count, size, SHA-256; with pictures also their size and SHA-256."""
        views = [self.views_size, self.views_sha256] if self.views_size else []
        return [self.number, self.count, self.size, self.sha256, *views]

    @classmethod
    def from_json(cls, entry: Any, location: str) -> Self:
        """The record in such a list. Raises ``ShardError``."""
        # Not ``checked``: a manifest lists thousands.
        if not isinstance(entry, list) or len(entry) not in (4, 6):
            raise ShardError(f"{location}: {found(entry)}, expected 4 or 6 values")
        record = cls(*entry)
        number, count, size, views = record.number, record.count, record.size, record.views_size
        are_whole = type(number) is type(count) is type(size) is type(views) is int
        if not (
            are_whole and 0 <= number < MOST and 0 <= count < MOST and 0 <= size < LONGEST and 0 <= views < LONGEST
        ):
            raise ShardError(f"{location}: {found(entry)}: a number is out of range")
        for sha256 in entry[3::2]:
            if type(sha256) is not str or HASH.fullmatch(sha256) is None:
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
        return {**self.__dict__, "plan": self.plan.to_json(), "shards": [shard.to_json() for shard in self.shards]}

    @classmethod
    def from_json(cls, name: str, entry: Any) -> Self:
        """Split ``name`` from its JSON object. Raises ``ShardError``."""
        location = f"split {require_name(name, 'split')}"
        values = checked(cls, entry, location)
        shards = tuple(ShardRecord.from_json(shard, f"{location}, a shard") for shard in values["shards"])
        counts = {name: ranked(values[name]) for name in ("rejects", "redraws")}
        plan = Plan.from_json(values["plan"], f"{location}, plan")
        record = cls(**{**values, **counts, "plan": plan, "shards": shards})
        for member in record.members:
            require_name(member, f"{location}, member")
        if any(a.number >= b.number for a, b in pairwise(shards)):
            raise ShardError(f"{location}: the numbers of its shards do not ascend")
        if (count := record.count) >= MOST:
            raise ShardError(f"{location}: more than {MOST} samples")
        if count and record.members[:1] != MEMBERS[:1]:
            raise ShardError(f"{location}: its first member is not {MEMBERS[0]}")
        if record.index_sha256 and HASH.fullmatch(record.index_sha256) is None:
            raise ShardError(f"{location}: index_sha256 is not 64 hexadecimal digits")
        return record


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
        splits = {name: split.to_json() for name, split in self.splits.items()}
        body = sorted_json({**self.__dict__, "recipe": self.recipe and self.recipe.__dict__, "splits": splits})
        return b'{"digest":"%b",%b\n' % (hashlib.sha256(body).hexdigest().encode(), body[1:])


def read_manifest(folder: Path) -> Manifest | None:
    """The manifest of a folder; ``None`` if there is none.

    Raises ``ShardError`` for a broken file, and, naming both versions, for another schema.
    """
    path = folder / MANIFEST
    with reading(path):
        exists = path.exists()
    return parse_manifest(read_file(path, LARGEST_MANIFEST), str(path)) if exists else None


def parse_manifest(content: bytes, path: str, remedy: str = REMEDY) -> Manifest:
    """The manifest in a file's content; ``path`` and ``remedy`` for messages. Raises as ``read_manifest`` does."""
    try:
        entry = decode_json(content, limit=LARGEST_MANIFEST)
        schema: Any = entry.get("schema") if isinstance(entry, Mapping) else None
        if not is_count(schema):
            raise ShardError("schema is missing")
        if schema == SCHEMA:
            return _parsed(content, entry)
    except ShardError as error:
        raise ShardError(f"{path}: not a manifest ({error}): {remedy}") from error
    raise ShardError(other_schema(path, schema, entry.get("generator")))


def _parsed(content: bytes, entry: Mapping[str, Any]) -> Manifest:
    values, digest = checked(Manifest, entry, "the file"), DIGEST.match(content)
    if digest is None:
        raise ShardError("it does not begin with its digest")
    if hashlib.sha256(b"{" + content[digest.end() :].removesuffix(b"\n")).hexdigest().encode() != digest[1]:
        raise ShardError("its digest does not match its content")
    splits = {name: SplitRecord.from_json(name, split) for name, split in values["splits"].items()}
    recipe = values["recipe"]
    if recipe is not None:
        recipe = RecipeRecord(**checked(RecipeRecord, recipe, "recipe"))
    return Manifest(**{**values, "splits": splits, "recipe": recipe})


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


def sorted_json(entry: Mapping[str, Any]) -> bytes:
    """Compact JSON with sorted keys."""
    options: dict[str, Any] = {"separators": (",", ":"), "allow_nan": False, "ensure_ascii": False}
    return json.dumps(entry, sort_keys=True, default=dict, **options).encode()


def checked(kind: type, entry: Any, location: str) -> dict[str, Any]:
    """The fields of a dataclass from a JSON object, lists as tuples. Raises ``ShardError`` with ``location``."""
    if not isinstance(entry, Mapping):
        raise ShardError(f"{location} is {found(entry)}, expected an object")
    for one in fields(kind):
        if one.name not in entry:
            raise ShardError(f"{location}: {one.name} is missing")
        if not _fits(entry[one.name], one.type):
            raise ShardError(f"{location}: {one.name} is {found(entry[one.name])}")
    values = ((one.name, entry[one.name]) for one in fields(kind))
    return {name: tuple(value) if isinstance(value, list) else value for name, value in values}


def _fits(value: Any, kind: Any) -> bool:
    """Whether a JSON value is of the type of a field; a record in it checks itself."""
    origin, inner = get_origin(kind), get_args(kind)
    if origin is UnionType:
        return any(_fits(value, one) for one in inner)
    if origin is Mapping:
        return isinstance(value, Mapping) and all(_fits(one, inner[1]) for one in value.values())
    if origin is tuple and inner[-1] is not ...:
        return isinstance(value, list) and len(value) == len(inner) and all(map(_fits, value, inner))
    if origin in (tuple, Sequence):
        # A manifest lists thousands of records.
        return isinstance(value, list) and (is_dataclass(inner[0]) or all(_fits(one, inner[0]) for one in value))
    if is_dataclass(kind):
        return isinstance(value, list | Mapping)
    return is_count(value) if kind is int else kind is Any or isinstance(value, kind)
