"""Names of files, samples, members and fields of a data set.

>>> member_name(12, "verts.z"), mesh_name("train")
('gcd_000000012.verts.z', 'mesh-train.z')
"""

import hashlib
import json
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any, TypeAlias, TypeVar

from gcd_dataset.errors import ConfigError, did_you_mean
from gcd_dataset.files import require_name

Bytes: TypeAlias = bytes | bytearray | memoryview
_T = TypeVar("_T")

SCHEMA = 3
"""The schema of the format; incremented whenever old readers would misread new shards."""

# Limits on the memory that reading a file may allocate: above any garment's need, below a machine's memory.
LARGEST_JSON = 1 << 23
"""Bytes of a JSON member; the parsed value takes about twenty times as many."""
LARGEST_MANIFEST = 1 << 26
"""Bytes of a manifest; for ten million garments it has 15 MB."""
LARGEST_SAMPLE = 1 << 29
"""Bytes of all members of a sample; a dress meshed at 0.2 cm takes 25 MB."""
LARGEST_FILE = 1 << 32
"""Bytes of an index; for ten million garments it has 3.3 GB."""
MOST_PIXELS = 1 << 26
"""Pixels of a picture: 8192 × 8192."""

MEMBERS: tuple[str, ...] = (
    "meta.json", "spec.txt", "design.txt", "measures.json", "pattern.z", "mesh.z", "verts.z", "points.z",
    "front.jpg", "back.jpg",
)  # fmt: skip
"""The members of every sample in file order, small members first."""
META = MEMBERS[0]

WORN = ("spec.txt", "design.txt", "pattern.z", "mesh.z", "verts.z")
"""The members of each further garment of an outfit: ``g1.spec.txt``, …, ``g2.spec.txt``, …"""
WORN_NAME = re.compile(r"g([1-7])[._](.+)")
MOST_GARMENTS = 8
"""Garments of an outfit, so that their numbers have one digit."""

TRAIN, FAILED = "train", "failed"
"""The default split, and the split of failed drapes."""

CAPTION, MAPS, POSE, MOTION = "caption.txt", "maps.z", "pose.z", "motion.z"
MOST_VIEWS = 100
VIEW = re.compile(r"view_(0|[1-9]\d?)\.(jpg|json)")

JOINT: Mapping[str, str] = {"views": "jpg", "camera_k": "json", "camera_rt": "json"}
"""Field decoded from a member of each view, with the ending of these members."""


def worn_name(number: int, name: str) -> str:
    """The member or field of garment ``number`` of an outfit, from its name in a single garment.

    >>> worn_name(1, "verts.z"), worn_name(2, "verts"), worn_name(0, "verts")
    ('g1.verts.z', 'g2_verts', 'verts')
    """
    return f"g{number}{'.' if '.' in name else '_'}{name}" if number else name


@lru_cache(1024)
def split_worn(name: str) -> tuple[int, str]:
    """The garment of a member or field, and its name in a single garment: the inverse of ``worn_name``.

    >>> split_worn("g1.verts.z"), split_worn("verts")
    ((1, 'verts.z'), (0, 'verts'))
    """
    match = WORN_NAME.fullmatch(name)
    return (int(match[1]), match[2]) if match else (0, name)


def of_garment(number: int, values: Mapping[str, _T]) -> dict[str, _T]:
    """The members or fields of one garment of an outfit, by their names in a single garment."""
    return {plain: values[name] for name in values for worn, plain in [split_worn(name)] if worn == number}


def of_each_garment(values: Mapping[str, _T]) -> dict[str, _T]:
    """The same values for the members or fields of every garment of an outfit, by ``worn_name``."""
    return {worn_name(number, name): value for number in range(MOST_GARMENTS) for name, value in values.items()}


def garments_in(members: Iterable[str]) -> int:
    """The number of garments in the largest outfit of a data set with these members.

    >>> garments_in(["pattern.z", "g1.pattern.z"]), garments_in(MEMBERS)
    (2, 1)
    """
    return 1 + max((split_worn(member)[0] for member in members), default=0)


_ARRAYS: dict[str, tuple[str, ...]] = {
    "pattern.z": ("panels", "edges", "stitches", "closures", "lines", "body"),
    "mesh.z": ("faces", "uv", "panel_id", "labels", "seams", "corners", "uv_vertex", "box"),
    "verts.z": ("verts",),
    "points.z": ("points",),
    MAPS: ("stretch", "gap", "pressure"),
    POSE: ("pose",),
    MOTION: ("motion_verts", "motion_pose"),
}
ARRAYS: Mapping[str, tuple[str, ...]] = _ARRAYS | {
    worn_name(number, member): tuple(worn_name(number, field) for field in _ARRAYS[member] if field != "body")
    for number in range(1, MOST_GARMENTS)
    for member in WORN
    if member in _ARRAYS
}
"""Member to the arrays in it."""


@dataclass(frozen=True, slots=True)
class Layout:
    """The kind and the members of the samples of a data set."""

    kind: str
    """``garments`` or ``bodies``."""
    members: tuple[str, ...]
    """The files of a sample in order; the first is ``meta.json``."""
    reader: str
    """The class in ``gcd_dataset.loaders`` that reads such samples, for messages."""
    schema: int = SCHEMA
    """The version of the format."""

    def of(self, members: Sequence[str]) -> "Layout":
        """The layout reduced to these members."""
        return replace(self, members=tuple(members))


def garments_layout(
    *,
    caption: bool = False,
    maps: bool = False,
    pose: bool = False,
    motion: bool = False,
    views: int = 0,
    sides: bool = True,
    garments: int = 1,
) -> Layout:
    """The layout of garments; with a caption, maps, a pose, a motion, some views, or both ``sides`` as pictures.

    ``garments``: of the largest outfit.

    >>> garments_layout(caption=True, views=1).members[4:6], garments_layout(views=1).members[-3:]
    (('caption.txt', 'pattern.z'), ('back.jpg', 'view_0.jpg', 'view_0.json'))
    >>> [member for member in garments_layout(garments=2).members if member not in MEMBERS]
    ['g1.spec.txt', 'g1.design.txt', 'g1.pattern.z', 'g1.mesh.z', 'g1.verts.z']
    """
    first_array, first_picture = MEMBERS.index("pattern.z"), MEMBERS.index("front.jpg")
    pictures = [f"view_{number}.{ending}" for number in range(views) for ending in ("jpg", "json")]
    worn = [worn_name(number, member) for number in range(1, garments) for member in WORN]
    texts = (*MEMBERS[:first_array], *([CAPTION] if caption else []), *(m for m in worn if m.endswith(".txt")))
    own = [member for member, has in {MAPS: maps, POSE: pose, MOTION: motion}.items() if has]
    arrays = (*MEMBERS[first_array:first_picture], *own, *(m for m in worn if m.endswith(".z")))
    members = (*texts, *arrays, *(MEMBERS[first_picture:] if sides else []), *pictures)
    return Layout("garments", members, "GarmentDataset")


GARMENTS = garments_layout()
BODIES = Layout("bodies", ("meta.json", "measures.json", "person.z"), "BodyDataset")


def fields_of(members: Iterable[str]) -> dict[str, str]:
    """Field to member, for garments with these members.

    >>> fields_of(["spec.txt", "verts.z", "view_0.jpg", "view_0.json"])
    {'spec': 'spec.txt', 'verts': 'verts.z', 'view_0': 'view_0.jpg', 'view_0_json': 'view_0.json'}
    """
    return {field: member for member in members for field in ARRAYS.get(member) or (_name_of(member),)}


def _name_of(member: str) -> str:
    """The field of a member that holds one: ``view_0_json`` of ``view_0.json``, ``g1_spec`` of ``g1.spec.txt``."""
    number, member = split_worn(member)
    stem, ending = member.split(".", 1)
    return f"{stem}_json" if ending == "json" and VIEW.fullmatch(member) else worn_name(number, stem)


FIELDS: Mapping[str, str] = fields_of(MEMBERS)
"""Field of a loaded sample to its member; ``fields_of`` adds the optional ones."""


def joint_fields(members: Iterable[str]) -> dict[str, tuple[str, ...]]:
    """The fields of ``JOINT`` that these members hold, each with its members: those of all views.

    >>> joint_fields(["verts.z", "view_0.jpg", "view_1.jpg"])
    {'views': ('view_0.jpg', 'view_1.jpg')}
    """
    views = [member for member in members if VIEW.fullmatch(member)]
    of_ending = {ending: tuple(view for view in views if view.endswith(f".{ending}")) for ending in ("jpg", "json")}
    return {field: found for field, ending in JOINT.items() if (found := of_ending[ending])}


def is_picture(member: str) -> bool:
    """Whether a member lies in the tar of the pictures: a picture, or the facts of a view.

    >>> is_picture("front.jpg"), is_picture("view_0.json"), is_picture("meta.json")
    (True, True, False)
    """
    return member.endswith(".jpg") or VIEW.fullmatch(member) is not None


def is_view_field(field: str) -> bool:
    """Whether a field is decoded from the views.

    >>> is_view_field("views"), is_view_field("view_0_json"), is_view_field("verts")
    (True, True, False)
    """
    return field in JOINT or re.fullmatch(r"view_\d+(_json)?", field) is not None


def members_of(fields: Iterable[str], available: Mapping[str, str] = FIELDS) -> tuple[str, ...]:
    """The members that decoding these fields needs; ``available``: field to member."""
    joint = joint_fields(available.values())
    wanted = dict.fromkeys(member for field in fields for member in joint.get(field) or (available[field],))
    for number, field in map(split_worn, fields):
        if field == "box":  # derived from the places of the panels
            wanted[member_of(worn_name(number, "panels"))] = None
    return tuple(wanted)


def member_of(field: str) -> str:
    """The member of a field; ``view_0_json`` is in ``view_0.json``, ``g1_box`` in ``g1.mesh.z``."""
    number, field = split_worn(field)
    if number:
        return worn_name(number, member_of(field))
    if field in FIELDS:
        return FIELDS[field]
    for member in (MAPS, POSE, MOTION):
        if field in ARRAYS[member]:
            return member
    return CAPTION if field == "caption" else f"{field.removesuffix('_json')}.{'json' if '_json' in field else 'jpg'}"


def key_of(index: int) -> str:
    """The name of a sample in a shard. No dots: readers end the key at the first dot."""
    return f"gcd_{index:09d}"


def member_name(index: int, member: str) -> str:
    """The name of a member's file in a shard."""
    return f"{key_of(index)}.{member}"


def mesh_name(split: str) -> str:
    """The file name of the common mesh of the bodies of a split. Raises ``ShardError`` for an unsafe split name."""
    return f"mesh-{require_name(split, 'split')}.z"


def select_fields(fields: Iterable[str] | None, available: Iterable[str] = FIELDS) -> tuple[str, ...]:
    """The requested fields in the order of ``available``; all of them for ``None``.

    Raises ``ConfigError`` with the available fields.
    """
    known = tuple(available)
    if fields is None:
        return known
    requested = {fields} if isinstance(fields, str) else set(fields)
    if unknown := sorted(requested - set(known)):
        remedy = did_you_mean(unknown[0], known)
        if unknown[0] in ARRAYS[MAPS]:
            remedy = "; gcd generate --maps stores maps"
        elif unknown[0].startswith("motion_"):
            remedy = "; frames=8 reads garments in motion, 8 frames at a time"
        raise ConfigError(f"no field {', '.join(unknown)}: there are {', '.join(known)}{remedy}")
    return tuple(field for field in known if field in requested)


def recipe_hash(recipe: Mapping[str, Any]) -> str:
    """SHA-256 of a recipe, independent of the order of keys, and equal for 4 and 4.0."""
    return hashlib.sha256(json.dumps(_plain(recipe), sort_keys=True, separators=(",", ":")).encode()).hexdigest()


def _plain(value: Any) -> Any:
    """The value with integral floats as ints."""
    if isinstance(value, Mapping):
        return {name: _plain(entry) for name, entry in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(entry) for entry in value]
    return int(value) if isinstance(value, float) and value.is_integer() else value
