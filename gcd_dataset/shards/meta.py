"""``meta.json``: provenance, names and figures of a sample, in the file and in loaded items.

In the file every key has one type in all samples, since readers such as ``datasets`` infer types from the first ones.
Values without a fixed structure are JSON text. In place of a missing value the file has ``""``, ``-1``, ``-1.0``, or a
list with one such entry, and a loaded item has ``None`` or an empty list; ``grade``, ``source`` and the counts of
``drape`` are the same in both. In items JSON text is parsed.

====================  =========  ===============================================================  =====================
garments              JSON type  holds                                                            if missing
====================  =========  ===============================================================  =====================
``schema``            int        version of the format: 2
``key``               text       name of the sample in its shard
``index``             int        number of the sample
``points``            object     ``scale`` [cm] of ``points.npy``, ``normal_scale``, both         scale 1.0
                                 floats, and ``centre`` [cm], 3 floats
``seed``              int
``attempts``          int        designs tried, this one included
``rejects``           texts      rule and reason of each rejected design                          ``[""]``
``redraws``           objects    ``rule`` (text), ``count`` (int): parameters, parts and designs  one of ``""``, 0
                                 drawn again
``versions``          JSON text  package to version, of all packages that affect the bytes
``recipe``            JSON text  options of the generator
``recipe_sha256``     text
``pattern``           text       name of the pattern
``body``              text       name of the body
``holds``             object     ``shape``, ``mesh``, ``drape`` (bools): whether it has one
``pose``              object     ``arm_angle`` [rad], float; ``legs_apart``, bool                 0.0, false
``panel_names``       texts      rows of ``panels.npy``
``panel_labels``      texts      labels that its column ``LABEL`` refers to
``edge_labels``       texts      labels that the column of ``edges.npy`` refers to
``vertex_labels``     texts      labels of vertices                                               ``[""]``
``drape``             object     ``outcome`` (text), ``frames``, ``self_crossings``,              ``""``, 0, -1, -1.0
                                 ``body_crossings`` (cloth edges through the body),
                                 ``body_through`` (body edges through the cloth) (ints),
                                 ``stretch_median``, ``stretch_p99`` (floats)
``strain``            object     ``principal``, 2 floats; ``panels``, 2 floats per panel  (*)     -1.0
``grade``             text       ``clean``, ``paper`` or ``failed``  (*)                          ``""``
``fabric``            object     ``name`` (text), ``parameters`` (JSON text)                      ``""``, ``"{}"``
``gathers``           floats     left edge / right edge in length, for each seam  (*)             ``[-1.0]``
``tags``              texts      names of the style: ``generator.garments.TAGS``  (*)             ``[""]``
``source``            text       publication that the garment comes from                          ``""``
``crc32``             object     CRC-32 of every other member, ints
``crc32_before``      int        CRC-32 of the bytes of this file before this key
====================  =========  ===============================================================  =====================

(*) missing where it was not computed, such as ``grade`` without a drape, or ``tags`` of a published garment.

In a body set each body has ``schema``, ``key``, ``index``, ``seed``, ``versions``, ``recipe``, ``recipe_sha256``,
``crc32``, ``crc32_before`` as above, ``name`` (text) and ``arm_angle`` [rad] (float). In schema 1 there was no
``crc32_before``, and missing values were null or left out.
"""

import json
import math
import re
import zlib
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

from gcd_dataset.errors import ShardError
from gcd_dataset.jsonfile import found, loads
from gcd_dataset.shards.layout import SCHEMA, SCHEMAS, Bytes
from gcd_dataset.shards.limits import LARGEST_JSON

__all__ = [
    "NO_QUANTIZATION",
    "Quantization",
    "decode_json",
    "json_bytes",
    "read_meta",
    "read_quantization",
    "read_sample_index",
    "sealed",
    "write_meta",
]


def _no_constant(text: str) -> float:
    raise ValueError(f"{text} is not valid JSON")


STRICT = json.JSONDecoder(parse_constant=_no_constant)

SEAL = "crc32_before"
SEALED = re.compile(rb',"crc32_before":(\d{1,10})\}')
NUMBER = rb"\s*(-?\d[\d.eE+-]{0,30})\s*"
HEAD = re.compile(rb'\{\s*"schema":\s*\d+,\s*"key":\s*"[^"\\]*",\s*"index":\s*(\d{1,18})\s*,')
FRAME = re.compile(
    HEAD.pattern
    + rb'\s*"points":\s*\{\s*"scale":%b,\s*"normal_scale":%b,\s*"centre":\s*\[%b,%b,%b\]\s*\}' % (5 * (NUMBER,))
)
LONGEST = 1 << 62  # exceeds every sample number and byte count in an index


class Quantization(NamedTuple):
    """The encoding of ``points.npy``: position = ``centre`` + ``scale`` · integer, normal = ``normal`` · integer."""

    scale: float
    """[cm]"""
    normal: float
    centre: tuple[float, float, float]
    """[cm]"""


NO_QUANTIZATION = Quantization(1.0, 1.0, (0.0, 0.0, 0.0))
"""For a sample without points."""


# ------------------------------------------------------------------------------------------------------------- writing


def write_meta(meta: Mapping[str, Any]) -> bytes:
    """The content of ``meta.json`` for the ``meta`` of an item, sealed with its own CRC-32."""
    return sealed({name: STORED[name](value) if name in STORED else value for name, value in meta.items()})


def sealed(stored: Mapping[str, Any]) -> bytes:
    """A ``meta.json`` of stored entries; its last entry, the seal, is the CRC-32 of the bytes before."""
    body = json_bytes(stored)[:-1]
    return body + b',"%b":%d}' % (SEAL.encode(), zlib.crc32(body))


def json_bytes(value: Any) -> bytes:
    """Compact JSON in the order of the keys; floats keep all digits."""
    return json.dumps(value, separators=(",", ":"), allow_nan=False, ensure_ascii=False).encode()


def _text(value: Any) -> str:
    return json_bytes(value).decode()


def _stored_drape(drape: Mapping[str, Any] | None) -> dict[str, Any]:
    neutral = {"outcome": "", "frames": 0} | dict.fromkeys(COUNTS, -1) | dict.fromkeys(STRETCHES, -1.0)
    return neutral | {name: value for name, value in (drape or {}).items() if value is not None}


def _stored_fabric(fabric: Mapping[str, Any] | None) -> dict[str, Any]:
    fabric = fabric or {"name": "", "parameters": {}}
    return {"name": fabric["name"], "parameters": _text(fabric["parameters"])}


COUNTS = ("self_crossings", "body_crossings", "body_through")
STRETCHES = ("stretch_median", "stretch_p99")
NO_STRAIN: Mapping[str, Any] = {"principal": [-1.0, -1.0], "panels": [[-1.0, -1.0]]}
NO_POSE: Mapping[str, Any] = {"arm_angle": 0.0, "legs_apart": False}

STORED: Mapping[str, Callable[[Any], Any]] = {
    "rejects": lambda words: list(words) or [""],
    "redraws": lambda rules: [{"rule": rule, "count": count} for rule, count in (rules or {"": 0}).items()],
    "versions": _text,
    "recipe": _text,
    "pose": lambda pose: pose or NO_POSE,
    "vertex_labels": lambda words: list(words or ()) or [""],
    "drape": _stored_drape,
    "strain": lambda strain: strain or NO_STRAIN,
    "grade": lambda grade: grade or "",
    "fabric": _stored_fabric,
    "gathers": lambda ratios: list(ratios) or [-1.0],
    "tags": lambda words: list(words) or [""],
}
"""Key to the function that converts an item's value to the stored value."""


# ------------------------------------------------------------------------------------------------------------- reading


def decode_json(data: Bytes, *, constants: bool = False, limit: int = LARGEST_JSON) -> Any:
    """Parsed JSON; ``constants`` allows NaN and infinities. Raises ``ShardError``, also for over ``limit`` bytes."""
    if len(data) > limit:
        raise ShardError(f"{len(data)} bytes of JSON, over the limit of {limit}")
    try:
        return loads(str(data, "utf-8"), decode=json.loads if constants else STRICT.decode)
    except ValueError as error:
        raise ShardError(f"not JSON ({error})") from error


def read_meta(data: Bytes) -> dict[str, Any]:
    """The ``meta`` of an item, from any known schema: the same keys, with ``None`` for missing values.

    Raises ``ShardError`` for an unknown schema, a wrong seal, or a missing or invalid key.
    """
    meta = _mapping(decode_json(data), "the file")
    schema = meta.get("schema")
    if schema not in SCHEMAS or isinstance(schema, bool):
        known = " and ".join(map(str, SCHEMAS))
        raise ShardError(f"of schema {found(schema)}, but this reader knows {known}: update gcd_dataset")
    if schema == SCHEMA:
        _require_seal(data)
    meta = _loaded(meta) if schema == SCHEMA else _of_first_schema(meta)
    forms = PERSON if "name" in meta else GARMENT
    for name, form in forms.items():
        if name not in meta:
            raise ShardError(f"{name} is missing")
        if not form(meta[name]):
            raise ShardError(f"{name} is {found(meta[name])}")
    return meta


def read_sample_index(data: Bytes) -> int:
    """The sample index in a ``meta.json``, read from its head where possible. Raises ``ShardError``."""
    match = HEAD.match(data)
    return int(match[1]) if match else int(read_meta(data)["index"])


def read_quantization(data: Bytes) -> Quantization:
    """The encoding of the points, from the head of ``meta.json`` where possible. Raises ``ShardError``."""
    match = FRAME.match(data)
    try:
        if match is not None:
            scale, normal, x, y, z = map(float, match.groups()[1:])
            return Quantization(scale, normal, (x, y, z))
    except ValueError as error:
        raise ShardError(f"points: {error}") from error
    points = read_meta(data)["points"]
    return Quantization(points["scale"], points["normal_scale"], tuple(points["centre"]))


def _require_seal(data: Bytes) -> None:
    """Raise ``ShardError`` unless the CRC-32 at the end of the file matches."""
    end = bytes(data[-40:])
    match = next((match for match in SEALED.finditer(end) if match.end() == len(end)), None)
    if match is None:
        raise ShardError(f"does not end with its {SEAL}")
    if zlib.crc32(memoryview(data)[: len(data) - len(match[0])]) != int(match[1]):
        raise ShardError("bytes differ from the written ones")


def _loaded(meta: Mapping[str, Any]) -> dict[str, Any]:
    """The ``meta`` of an item, from the stored one."""
    loaded = {name: value for name, value in meta.items() if name != SEAL}
    for name in ("versions", "recipe"):
        loaded[name] = _parsed(meta, name)
    if "name" in meta:
        return loaded
    holds = _mapping(meta.get("holds"), "holds")
    for name in ("rejects", "vertex_labels", "tags"):
        loaded[name] = [word for word in _list(meta.get(name), name) if word != ""]
    redraws = [_mapping(entry, "redraws") for entry in _list(meta.get("redraws"), "redraws")]
    loaded["redraws"] = {str(entry.get("rule")): entry.get("count") for entry in redraws if entry.get("rule") != ""}
    loaded["gathers"] = [ratio for ratio in _list(meta.get("gathers"), "gathers") if ratio != -1.0]
    loaded["fabric"] = _loaded_fabric(_mapping(meta.get("fabric"), "fabric"))
    loaded["strain"] = None if meta.get("strain") == NO_STRAIN else meta.get("strain")
    loaded["drape"] = _loaded_drape(_mapping(meta.get("drape"), "drape")) if holds.get("drape") else None
    for name, step in {"pose": "shape", "vertex_labels": "mesh"}.items():
        loaded[name] = loaded.get(name) if holds.get(step) else None
    return loaded


def _of_first_schema(meta: Mapping[str, Any]) -> dict[str, Any]:
    """The ``meta`` of an item, from one of schema 1."""
    if "name" in meta:
        return dict(meta)
    drape = meta.get("drape")
    added = {
        "points": {"scale": 1.0, "normal_scale": 1.0, "centre": [0.0, 0.0, 0.0]},
        "redraws": {},
        "holds": {
            "shape": meta.get("pose") is not None,
            "mesh": meta.get("vertex_labels") is not None,
            "drape": drape is not None,
        },
        "strain": None,
        "grade": "",
        "fabric": None,
        "gathers": [],
        "tags": [],
    }
    drape = None if drape is None else {"body_through": -1, **_mapping(drape, "drape")}
    return {**added, "source": "", **meta, "drape": drape}


def _loaded_fabric(fabric: Mapping[str, Any]) -> dict[str, Any] | None:
    return {"name": fabric["name"], "parameters": _parsed(fabric, "parameters")} if fabric.get("name") else None


def _loaded_drape(drape: Mapping[str, Any]) -> dict[str, Any]:
    return {name: None if name in STRETCHES and value == -1.0 else value for name, value in drape.items()}


def _parsed(entries: Mapping[str, Any], name: str) -> Any:
    """The value of an entry that is stored as JSON text. Raises ``ShardError``."""
    text = entries.get(name)
    if not isinstance(text, str):
        raise ShardError(f"{name} is {found(text)}, expected JSON text")
    return decode_json(text.encode(errors="replace"))


def _mapping(value: Any, name: str) -> Mapping[str, Any]:
    if not isinstance(value, Mapping):
        raise ShardError(f"{name} is {found(value)}, expected an object")
    return value


def _list(value: Any, name: str) -> Sequence[Any]:
    if not isinstance(value, list):
        raise ShardError(f"{name} is {found(value)}, expected a list")
    return value


# -------------------------------------------------------------------------------------------------------------- checks


def _is_word(value: Any) -> bool:
    return isinstance(value, str)


def _is_whole(value: Any) -> bool:
    return isinstance(value, int) and not isinstance(value, bool)


def _is_count(value: Any) -> bool:
    return _is_whole(value) and 0 <= value < LONGEST


def _is_number(value: Any) -> bool:
    return (isinstance(value, float) and math.isfinite(value)) or (_is_whole(value) and abs(value) < LONGEST)


def _is_mapping(value: Any) -> bool:
    return isinstance(value, Mapping)


def _are(form: Callable[[Any], bool], count: int | None = None) -> Callable[[Any], bool]:
    """A check for lists of values that pass ``form``, ``count`` of them if given."""

    def check(values: Any) -> bool:
        return isinstance(values, list) and all(map(form, values)) and count in (None, len(values))

    return check


def _maps_to(form: Callable[[Any], bool]) -> Callable[[Any], bool]:
    return lambda value: isinstance(value, Mapping) and all(map(form, value.values()))


def _has(**forms: Callable[[Any], bool]) -> Callable[[Any], bool]:
    """A check for objects with these entries."""
    return lambda value: isinstance(value, Mapping) and all(form(value.get(name)) for name, form in forms.items())


def _or_none(form: Callable[[Any], bool]) -> Callable[[Any], bool]:
    return lambda value: value is None or form(value)


_ORIGIN: Mapping[str, Callable[[Any], bool]] = {
    "schema": _is_count,
    "key": _is_word,
    "index": _is_count,
    "seed": lambda seed: _is_whole(seed) and seed >= 0,
    "versions": _maps_to(_is_word),
    "recipe": _is_mapping,
}
PERSON: Mapping[str, Callable[[Any], bool]] = {**_ORIGIN, "name": _is_word, "arm_angle": _is_number}
_PAIR = _are(_is_number, 2)
GARMENT: Mapping[str, Callable[[Any], bool]] = {
    **_ORIGIN,
    "points": _has(scale=_is_number, normal_scale=_is_number, centre=_are(_is_number, 3)),
    "attempts": _is_count,
    "rejects": _are(_is_word),
    "redraws": _maps_to(_is_count),
    "pattern": _is_word,
    "body": _is_word,
    "pose": _or_none(_has(arm_angle=_is_number, legs_apart=lambda value: isinstance(value, bool))),
    "panel_names": _are(_is_word),
    "panel_labels": _are(_is_word),
    "edge_labels": _are(_is_word),
    "vertex_labels": _or_none(_are(_is_word)),
    "drape": _or_none(
        _has(
            outcome=_is_word,
            frames=_is_whole,
            **dict.fromkeys(COUNTS, _is_whole),
            **dict.fromkeys(STRETCHES, _or_none(_is_number)),
        )
    ),
    "strain": _or_none(_has(principal=_PAIR, panels=_are(_PAIR))),
    "grade": _is_word,
    "fabric": _or_none(_has(name=_is_word, parameters=_is_mapping)),
    "gathers": _are(_is_number),
    "tags": _are(_is_word),
    "source": _is_word,
}
"""Key to the check of an item's value."""
