"""How a data set's folder is laid out: names of files, of samples, of the members of a sample.

    manifest.json         schema, recipe and seed of each split; count, size and sha256 of each shard
    download.json         of a data set that was downloaded: where from
    index-train.npz       where each member of each sample lies
    mesh-train.npz        of bodies: triangles and parts, which all of them share
    train-00000.tar       samples 0 … shard_size-1, each as the files of ``MEMBERS``, bodies as those of ``BODIES``

>>> member_name(12, "verts.npy"), shard_name("train", 3)
('gcd_000000012.verts.npy', 'train-00003.tar')
"""

import hashlib
import json
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, TypeAlias

from gcd_dataset.errors import ConfigError, did_you_mean

__all__ = [
    "BODIES",
    "FIELDS",
    "FOREIGN",
    "GARMENTS",
    "MEMBERS",
    "SCHEMA",
    "Bytes",
    "Layout",
    "foreign_layout",
    "index_name",
    "key_of",
    "known_fields",
    "lock_name",
    "member_name",
    "mesh_name",
    "part_path",
    "recipe_hash",
    "shard_name",
    "shard_number",
    "shards_in",
]

Bytes: TypeAlias = bytes | bytearray | memoryview

SCHEMA = 1
"""Raised by one whenever a reader of today's shards would misread tomorrow's."""

MEMBERS: tuple[str, ...] = (
    "meta.json", "spec.json", "design.json", "measures.json", "panels.npy", "edges.npy", "stitches.npy", "body.npy",
    "faces.npy", "uv.npy", "panel_id.npy", "labels.npy", "seams.npy", "corners.npy", "uv_vertex.npy", "box.npy",
    "verts.npy", "points.npy", "front.jpg", "back.jpg",
)  # fmt: skip
"""The members of every sample, in the order of the file: what is small, or read together, stands together."""

FIELDS: Mapping[str, str] = {member.split(".")[0]: member for member in MEMBERS}
"""Field of a loaded sample to the member it comes from."""


@dataclass(frozen=True, slots=True)
class Layout:
    """What every sample of a data set is made of."""

    kind: str
    """What the samples are."""
    members: tuple[str, ...]
    """The files of a sample in their order; the first is ``meta.json``, which holds the CRC-32 of the others."""
    reader: str
    """The data set to read them with."""

    def holds(self, members: Sequence[str]) -> bool:
        """Whether these are members of the layout, in its order, the first among them."""
        return list(members) == [m for m in self.members if m in members] and list(members[:1]) == list(
            self.members[:1]
        )

    def of(self, members: Sequence[str]) -> "Layout":
        """The layout with these members and no others."""
        return replace(self, members=tuple(members))


GARMENTS = Layout("garments", MEMBERS, "GarmentDataset")
FOREIGN = "foreign"
BODIES = Layout("bodies", ("meta.json", "measures.json", "body.npy", "straight.npy", "apart.npy"), "BodyDataset")


def foreign_layout(members: Sequence[str]) -> Layout:
    """The layout of archives by others: any members, each of which a sample may lack."""
    return Layout(FOREIGN, tuple(members), "GarmentDataset")


def key_of(index: int) -> str:
    """The name of a sample in a shard; no dots, since readers take the first dot for the key's end."""
    return f"gcd_{index:09d}"


def member_name(index: int, member: str) -> str:
    """The name of a member's file in a shard."""
    return f"{key_of(index)}.{member}"


def shard_name(split: str, number: int) -> str:
    """The name of a shard. It does not say how many there are, so that a data set can grow."""
    return f"{split}-{number:05d}.tar"


def index_name(split: str) -> str:
    """The name of a split's index."""
    return f"index-{split}.npz"


def mesh_name(split: str) -> str:
    """The name of the mesh that all bodies of a split share."""
    return f"mesh-{split}.npz"


def lock_name(split: str) -> str:
    """The name of the file that a writer of the split holds."""
    return f".{split}.lock"


def part_path(path: Path) -> Path:
    """The name a shard has while it is written."""
    return path.with_name(path.name + ".part")


def shard_number(name: str, split: str) -> int | None:
    """Which shard of the split a file is; ``None`` for any other file.

    >>> shard_number("train-00003.tar", "train"), shard_number("val-00003.tar", "train")
    (3, None)
    """
    match = re.fullmatch(rf"{re.escape(split)}-(\d{{5,}})\.tar", name)
    return int(match[1]) if match else None


def shards_in(folder: Path, split: str) -> tuple[Path, ...]:
    """The whole shards of a split, in the order of their numbers. Raises ``OSError``."""
    # Not ``glob``: to that a folder which may not be read is an empty one.
    numbered = {number: path for path in folder.iterdir() if (number := shard_number(path.name, split)) is not None}
    return tuple(numbered[number] for number in sorted(numbered))


def known_fields(fields: Iterable[str] | None, there: Iterable[str] = FIELDS) -> tuple[str, ...]:
    """The fields asked for, in the order of those that are ``there``; all of them for ``None``.

    Raises ``ConfigError`` with the fields there are.
    """
    known = tuple(there)
    if fields is None:
        return known
    asked = {fields} if isinstance(fields, str) else set(fields)
    if unknown := sorted(asked - set(known)):
        raise ConfigError(
            f"no field {', '.join(unknown)}: there are {', '.join(known)}{did_you_mean(unknown[0], known)}"
        )
    return tuple(field for field in known if field in asked)


def recipe_hash(recipe: Mapping[str, Any]) -> str:
    """SHA-256 of a recipe, whatever the order of its keys, and whether it says 4 or 4.0."""
    return hashlib.sha256(json.dumps(_plain(recipe), sort_keys=True, separators=(",", ":")).encode()).hexdigest()


def _plain(value: Any) -> Any:
    """The value with whole numbers as integers."""
    if isinstance(value, Mapping):
        return {name: _plain(entry) for name, entry in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(entry) for entry in value]
    return int(value) if isinstance(value, float) and value.is_integer() else value
