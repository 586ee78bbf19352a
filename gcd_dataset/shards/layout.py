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
from gcd_dataset.names import require_name

__all__ = [
    "BODIES",
    "CAPTION",
    "FAILED",
    "FIELDS",
    "FIRST_NAMES",
    "FOREIGN",
    "GARMENTS",
    "MEMBERS",
    "MOST_VIEWS",
    "SCHEMA",
    "SCHEMAS",
    "TRAIN",
    "WAITING",
    "Bytes",
    "Layout",
    "content_of",
    "fields_of",
    "foreign_layout",
    "garments_layout",
    "index_name",
    "is_extra",
    "key_of",
    "known_fields",
    "layout_of",
    "lock_name",
    "member_name",
    "members_of",
    "mesh_name",
    "part_path",
    "recipe_hash",
    "shard_name",
    "shard_number",
    "shards_in",
]

Bytes: TypeAlias = bytes | bytearray | memoryview

SCHEMA = 2
"""Of what is written. Raised by one whenever a reader of today's shards would misread tomorrow's."""

SCHEMAS = (1, SCHEMA)
"""What is read. In schema 1 specification and design were members of JSON, and points absolute 16-bit floats."""

MEMBERS: tuple[str, ...] = (
    "meta.json", "spec.txt", "design.txt", "measures.json", "panels.npy", "edges.npy", "stitches.npy", "body.npy",
    "faces.npy", "uv.npy", "panel_id.npy", "labels.npy", "seams.npy", "corners.npy", "uv_vertex.npy", "box.npy",
    "verts.npy", "points.npy", "front.jpg", "back.jpg",
)  # fmt: skip
"""The members of every sample, in the order of the file: what is small, or read together, stands together."""

FIRST_NAMES: Mapping[str, str] = {"spec.txt": "spec.json", "design.txt": "design.json"}
"""Member to its name in schema 1, where that differed."""

TRAIN, FAILED = "train", "failed"
WAITING = ".waiting"  # folder of samples whose shard is not full yet
"""The split of what is made, and that of drapes that failed and are kept."""

CAPTION = "caption.txt"
MOST_VIEWS = 100
VIEW = re.compile(r"view_(0|[1-9]\d?)\.(jpg|json)")

FIELDS: Mapping[str, str] = {member.split(".")[0]: member for member in MEMBERS}
"""Field of a loaded sample to the member it comes from; ``fields_of`` adds those that a data set need not have."""


@dataclass(frozen=True, slots=True)
class Layout:
    """What every sample of a data set is made of."""

    kind: str
    """What the samples are."""
    members: tuple[str, ...]
    """The files of a sample in their order; the first is ``meta.json``, which holds the CRC-32 of the others."""
    reader: str
    """The data set to read them with."""
    schema: int = SCHEMA
    """The version of the format."""

    def holds(self, members: Sequence[str]) -> bool:
        """Whether these are members of the layout, in its order, the first among them.

        Garments may have a caption and views besides.
        """
        known = self.members
        if self.kind == "garments" and self.schema > 1:
            views = [int(match[1]) for member in members if (match := VIEW.fullmatch(member))]
            known = garments_layout(caption=CAPTION in members, views=max(views, default=-1) + 1).members
        return list(members) == [m for m in known if m in members] and list(members[:1]) == list(known[:1])

    def of(self, members: Sequence[str]) -> "Layout":
        """The layout with these members and no others."""
        return replace(self, members=tuple(members))


def garments_layout(*, caption: bool = False, views: int = 0) -> Layout:
    """Garments; with a caption, or so many views, in every sample.

    >>> garments_layout(caption=True, views=1).members[4:6], garments_layout(views=1).members[-3:]
    (('caption.txt', 'panels.npy'), ('back.jpg', 'view_0.jpg', 'view_0.json'))
    """
    small = MEMBERS.index("panels.npy")
    pictures = [f"view_{number}.{ending}" for number in range(views) for ending in ("jpg", "json")]
    members = (*MEMBERS[:small], *([CAPTION] if caption else []), *MEMBERS[small:], *pictures)
    return Layout("garments", members, "GarmentDataset")


GARMENTS = garments_layout()
FOREIGN = "foreign"
BODIES = Layout("bodies", ("meta.json", "measures.json", "body.npy", "straight.npy", "apart.npy"), "BodyDataset")


def is_extra(member: str) -> bool:
    """Whether a member is one that a data set need not have."""
    return member == CAPTION or VIEW.fullmatch(member) is not None


def layout_of(layout: Layout, schema: int, members: Sequence[str]) -> Layout | None:
    """The layout of samples of ``layout``'s kind with these members, in an earlier schema too; ``None`` if they are
    none of it."""
    if schema == layout.schema:
        there = layout
    elif schema in SCHEMAS:
        there = replace(layout, schema=schema, members=tuple(FIRST_NAMES.get(m, m) for m in layout.members))
    else:
        return None
    return there.of(members) if there.holds(members) else None


def fields_of(members: Iterable[str]) -> dict[str, str]:
    """Field to member, of garments with these members.

    >>> fields_of(["spec.json", "verts.npy", "view_0.jpg", "view_0.json"])
    {'spec': 'spec.json', 'verts': 'verts.npy', 'view_0': 'view_0.jpg', 'view_0_json': 'view_0.json'}
    """
    return {
        member.replace(".", "_")
        if VIEW.fullmatch(member) and member.endswith(".json")
        else member.split(".")[0]: member
        for member in members
    }


def members_of(fields: Iterable[str], there: Mapping[str, str] = FIELDS) -> tuple[str, ...]:
    """The members that fields are decoded from; ``there``: field to member."""
    wanted = dict.fromkeys(there[field] for field in fields)
    if "points" in there and there["points"] in wanted:  # whose scale and centre are there
        wanted[there["meta"]] = None
    return tuple(wanted)


def content_of(field: str, members: Mapping[str, Bytes]) -> Bytes:
    """The member that a field comes from, under its name in any schema. Raises ``KeyError``."""
    member = FIELDS.get(field)
    if member is None:
        member = field.removesuffix("_json") + ".json" if field.endswith("_json") else f"{field}.jpg"
        member = CAPTION if field == "caption" else member
    return members[member] if member in members else members[FIRST_NAMES[member]]


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
    """The name of a shard. It does not say how many there are, so that a data set can grow.

    Raises ``ShardError``, as the functions below do, for a split whose name cannot be part of a file's.
    """
    return f"{require_name(split, 'split')}-{number:05d}.tar"


def index_name(split: str) -> str:
    """The name of a split's index."""
    return f"index-{require_name(split, 'split')}.npz"


def mesh_name(split: str) -> str:
    """The name of the mesh that all bodies of a split share."""
    return f"mesh-{require_name(split, 'split')}.npz"


def lock_name(split: str) -> str:
    """The name of the file that a writer of the split holds."""
    return f".{require_name(split, 'split')}.lock"


def part_path(path: Path) -> Path:
    """The name a shard has while it is written."""
    return path.with_name(path.name + ".part")


def shard_number(name: str, split: str) -> int | None:
    """Which shard of the split a file is; ``None`` for any other file.

    >>> shard_number("train-00003.tar", "train"), shard_number("val-00003.tar", "train")
    (3, None)
    """
    match = re.fullmatch(rf"{re.escape(split)}-(\d{{5,18}})\.tar", name)
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
