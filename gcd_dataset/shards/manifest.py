"""What a data set is made of: the recipe and the shards of each split, kept in ``manifest.json``."""

import json
from collections import Counter
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any, Self

import gcd_dataset
from gcd_dataset.errors import ShardError
from gcd_dataset.files import write_whole
from gcd_dataset.names import require_name
from gcd_dataset.shards.access import locked, reading
from gcd_dataset.shards.layout import SCHEMA, shard_number

__all__ = ["MANIFEST", "Manifest", "ShardRecord", "SplitRecord", "keep_split", "parse_manifest", "read_manifest"]

MANIFEST = "manifest.json"
REMEDY = "delete it: shards are read without it, and gcd generate makes it again"


@dataclass(frozen=True)
class ShardRecord:
    """One whole shard."""

    name: str
    count: int
    """Samples in it."""
    size: int
    """Bytes of it."""
    sha256: str
    rejects: Mapping[str, int] = field(default_factory=dict)
    """Designs turned down before those of its samples were taken, by the rule they broke; counted with each sample."""


@dataclass(frozen=True)
class SplitRecord:
    """How the samples of a split are made, and the shards that hold them."""

    seed: int
    recipe: Mapping[str, Any]
    shard_size: int
    """Shard k holds the samples from ``k * shard_size`` to ``(k + 1) * shard_size - 1``."""
    shards: tuple[ShardRecord, ...] = ()
    kind: str = "garments"
    """What the samples are: ``garments`` or ``bodies``."""

    @property
    def rejects(self) -> Mapping[str, int]:
        """Designs turned down on the way to all samples, by the rule they broke, the most frequent first."""
        total: Counter[str] = Counter()
        for shard in self.shards:
            total.update(shard.rejects)
        return dict(total.most_common())

    @classmethod
    def from_json(cls, entry: Mapping[str, Any]) -> Self:
        """From an entry of the file. Raises ``KeyError`` or ``TypeError`` for one that is not whole."""
        return cls(**{**entry, "shards": tuple(ShardRecord(**shard) for shard in entry["shards"])})


@dataclass(frozen=True)
class Manifest:
    """The contents of ``manifest.json``."""

    splits: Mapping[str, SplitRecord] = field(default_factory=dict)
    generator: str = gcd_dataset.__version__
    """Version of this package that began the data set."""
    schema: int = SCHEMA

    def with_split(self, name: str, record: SplitRecord) -> "Manifest":
        """The manifest with one split put in or replaced."""
        return replace(self, splits=dict(sorted({**self.splits, name: record}.items())))

    def write(self, folder: Path) -> None:
        """Keep the manifest in the folder, whole or not at all. Raises ``OutputError``."""
        write_whole(folder / MANIFEST, (json.dumps(asdict(self), indent=1, sort_keys=True) + "\n").encode())


def read_manifest(folder: Path) -> Manifest | None:
    """The manifest of a folder; ``None`` if there is none.

    Raises ``ShardError`` for a broken file, and for another schema with both versions.
    """
    path = folder / MANIFEST
    with reading(path):
        content = path.read_bytes() if path.exists() else None
    return None if content is None else parse_manifest(content, str(path))


def parse_manifest(content: bytes, path: str, remedy: str = REMEDY) -> Manifest:
    """The manifest in a file's content; ``path`` and ``remedy`` stand in errors. Raises as ``read_manifest`` does."""
    try:
        entry = json.loads(content)
        if (schema := entry["schema"]) != SCHEMA:
            raise ShardError(
                f"{path}: written as schema {schema} by gcd_dataset {entry.get('generator')}; gcd_dataset "
                f"{gcd_dataset.__version__} reads schema {SCHEMA}: install the version that wrote it"
            )
        splits = {name: SplitRecord.from_json(split) for name, split in entry["splits"].items()}
        _require_names(splits, path)
        return Manifest(splits, entry["generator"], schema)
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        raise ShardError(f"{path}: not a manifest ({error}): {remedy}") from error


def _require_names(splits: Mapping[str, SplitRecord], path: str) -> None:
    """Raise ``ShardError`` unless all splits and shards are called as ours are: their names become paths."""
    for split, record in splits.items():
        require_name(split, f"{path}: split")
        for shard in record.shards:
            if shard_number(require_name(shard.name, f"{path}: split {split}, shard"), split) is None:
                raise ShardError(f"{path}: split {split} tells of a shard {shard.name!r}: give {split}-00000.tar, …")


def keep_split(folder: Path, split: str, record: SplitRecord) -> None:
    """Put a split into the folder's manifest, beside those that other writers put there. Raises ``OutputError``."""
    with locked(folder / f".{MANIFEST}.lock", f"writing {MANIFEST}", wait=True):
        (read_manifest(folder) or Manifest()).with_split(split, record).write(folder)
