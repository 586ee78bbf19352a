"""``manifest.json``: the recipe and the shards of each split of a data set."""

import json
from collections import Counter
from collections.abc import Callable, Iterable, Mapping
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any, Self

import gcd_dataset
from gcd_dataset.errors import ShardError, shown
from gcd_dataset.files import write_whole
from gcd_dataset.jsonfile import found
from gcd_dataset.names import require_name
from gcd_dataset.shards.access import locked, read_limited, reading
from gcd_dataset.shards.layout import SCHEMA, shard_number
from gcd_dataset.shards.limits import LARGEST_MANIFEST
from gcd_dataset.shards.meta import decode_json

__all__ = [
    "MANIFEST",
    "Manifest",
    "RecipeRecord",
    "ShardRecord",
    "SplitRecord",
    "keep_recipe",
    "keep_split",
    "parse_manifest",
    "read_manifest",
]

MANIFEST = "manifest.json"
REMEDY = "delete it: shards are read without it, and gcd generate makes it again"


@dataclass(frozen=True)
class ShardRecord:
    """One finished shard."""

    name: str
    count: int
    """Samples."""
    size: int
    """Bytes."""
    sha256: str
    rejects: Mapping[str, int] = field(default_factory=dict)
    """Rule to the number of designs it rejected for the samples of this shard."""
    redraws: Mapping[str, int] = field(default_factory=dict)
    """Rule to the number of redraws it caused in the samples of this shard, of parameters, parts and whole designs."""


@dataclass(frozen=True)
class SplitRecord:
    """The recipe and the shards of a split."""

    seed: int
    recipe: Mapping[str, Any]
    shard_size: int
    """Shard k holds the samples from ``k * shard_size`` to ``(k + 1) * shard_size - 1``."""
    shards: tuple[ShardRecord, ...] = ()
    kind: str = "garments"
    """``garments`` or ``bodies``."""

    @property
    def rejects(self) -> Mapping[str, int]:
        """Rule to the number of designs it rejected for all samples, the most frequent first."""
        return _summed(shard.rejects for shard in self.shards)

    @property
    def redraws(self) -> Mapping[str, int]:
        """Rule to the number of redraws it caused in all samples, the most frequent first."""
        return _summed(shard.redraws for shard in self.shards)

    @classmethod
    def from_json(cls, name: str, entry: Any) -> Self:
        """Split ``name`` from its entry in the file. Raises ``ShardError`` for an invalid entry."""
        values = _checked(entry, f"split {name}", SPLIT_TYPES, {"kind": "garments"})
        shards = [_checked(shard, f"split {name}, shard", SHARD_TYPES, NO_COUNTS) for shard in values["shards"]]
        for shard in shards:
            if shard_number(require_name(shard["name"], f"split {name}, shard"), name) is None:
                raise ShardError(f"split {name} lists a shard {found(shard['name'])}: give {name}-00000.tar, …")
            for counts in NO_COUNTS:
                if not all(map(_is_count, shard[counts].values())):
                    raise ShardError(f"split {name}, shard {shard['name']}: {counts} is {found(shard[counts])}")
        return cls(**{**values, "shards": tuple(ShardRecord(**shard) for shard in shards)})


def _summed(counts: Iterable[Mapping[str, int]]) -> dict[str, int]:
    total: Counter[str] = Counter()
    for rules in counts:
        total.update(rules)
    return dict(total.most_common())


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
    """Version of this package that started the data set."""
    schema: int = SCHEMA
    recipe: RecipeRecord | None = None
    """The published recipe of the whole data set; ``None`` without one."""

    @property
    def counts(self) -> dict[str, int]:
        """Split to its number of samples."""
        return {name: sum(shard.count for shard in split.shards) for name, split in self.splits.items()}

    def with_split(self, name: str, record: SplitRecord) -> "Manifest":
        """The manifest with one split added or replaced."""
        return replace(self, splits=dict(sorted({**self.splits, name: record}.items())))

    def write(self, folder: Path) -> None:
        """Write the manifest to the folder, atomically. Raises ``OutputError``."""
        write_whole(folder / MANIFEST, self.to_bytes())

    def to_bytes(self) -> bytes:
        """The content of ``manifest.json``."""
        entry = {name: value for name, value in asdict(self).items() if (name, value) != ("recipe", None)}
        return (json.dumps(entry, indent=1, sort_keys=True) + "\n").encode()


def read_manifest(folder: Path) -> Manifest | None:
    """The manifest of a folder; ``None`` if there is none.

    Raises ``ShardError`` for a broken file, and, naming both versions, for an unknown schema.
    """
    path = folder / MANIFEST
    with reading(path):
        exists = path.exists()
    content = read_limited(path, LARGEST_MANIFEST) if exists else None
    return None if content is None else parse_manifest(content, str(path))


def parse_manifest(content: bytes, path: str, remedy: str = REMEDY) -> Manifest:
    """The manifest in a file's content; ``path`` and ``remedy`` for messages. Raises as ``read_manifest`` does."""
    try:
        entry = decode_json(content, limit=LARGEST_MANIFEST)
        if not isinstance(entry, Mapping) or not _is_count(schema := entry.get("schema")):
            raise ShardError("schema is missing")
        if schema != SCHEMA:
            raise ShardError(
                f"{path}: written as schema {schema} by gcd_dataset {shown(str(entry.get('generator')))}; gcd_dataset "
                f"{gcd_dataset.__version__} reads schema {SCHEMA}: install the version that "
                "wrote it"
            )
        values = _checked(entry, "the file", FILE_TYPES, {"recipe": None})
        for name in values["splits"]:
            require_name(name, "split")
        splits = {name: SplitRecord.from_json(name, split) for name, split in values["splits"].items()}
        named = None if values["recipe"] is None else _checked(values["recipe"], "recipe", RECIPE_TYPES, {})
        return Manifest(splits, values["generator"], schema, None if named is None else RecipeRecord(**named))
    except ShardError as error:
        if str(error).startswith(path):
            raise
        raise ShardError(f"{path}: not a manifest ({error}): {remedy}") from error


def _is_count(value: Any) -> bool:
    return isinstance(value, int) and not isinstance(value, bool) and 0 <= value < 1 << 62


def _is_text(value: Any) -> bool:
    return isinstance(value, str)


def _is_mapping(value: Any) -> bool:
    return isinstance(value, Mapping)


FILE_TYPES: Mapping[str, Callable[[Any], bool]] = {
    "generator": _is_text,
    "splits": _is_mapping,
    "schema": _is_count,
    "recipe": lambda value: value is None or _is_mapping(value),
}
RECIPE_TYPES: Mapping[str, Callable[[Any], bool]] = {"name": _is_text, "sha256": _is_text, "patterns": _is_text}
SPLIT_TYPES: Mapping[str, Callable[[Any], bool]] = {
    "seed": lambda value: isinstance(value, int) and not isinstance(value, bool) and value >= 0,
    "recipe": _is_mapping,
    "shard_size": lambda value: _is_count(value) and value > 0,
    "shards": lambda value: isinstance(value, list),
    "kind": _is_text,
}
SHARD_TYPES: Mapping[str, Callable[[Any], bool]] = {
    "name": _is_text,
    "count": _is_count,
    "size": _is_count,
    "sha256": _is_text,
    "rejects": _is_mapping,
    "redraws": _is_mapping,
}
NO_COUNTS: Mapping[str, Mapping[str, int]] = {"rejects": {}, "redraws": {}}
"""The counts of a shard that older versions did not write."""


def _checked(
    entry: Any, location: str, types: Mapping[str, Callable[[Any], bool]], defaults: Mapping[str, Any]
) -> dict[str, Any]:
    """The entries named in ``types``, with ``defaults`` for missing ones. Raises ``ShardError``."""
    if not isinstance(entry, Mapping):
        raise ShardError(f"{location} is {found(entry)}, expected an object")
    values = {**defaults, **entry}
    for name, is_valid in types.items():
        if name not in values:
            raise ShardError(f"{location}: {name} is missing")
        if not is_valid(values[name]):
            raise ShardError(f"{location}: {name} is {found(values[name])}")
    return {name: values[name] for name in types}


def keep_split(folder: Path, split: str, record: SplitRecord) -> None:
    """Add or replace a split in the folder's manifest, under a lock: splits may be written in parallel.

    Raises ``OutputError``.
    """
    with locked(folder / f".{MANIFEST}.lock", f"writing {MANIFEST}", wait=True):
        (read_manifest(folder) or Manifest()).with_split(split, record).write(folder)


def keep_recipe(folder: Path, record: RecipeRecord) -> None:
    """Write the published recipe to the folder's manifest. Raises ``OutputError``."""
    with locked(folder / f".{MANIFEST}.lock", f"writing {MANIFEST}", wait=True):
        replace(read_manifest(folder) or Manifest(), recipe=record).write(folder)
