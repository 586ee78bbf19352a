"""``meta.json``: provenance, names and figures of a sample, in the file and in loaded items.

In the file every key has one type in all samples, since readers such as ``datasets`` infer types from the first ones.
Values without a fixed structure are JSON text. In place of a missing value the file has ``""``, ``-1``, ``-1.0``, or a
list with one such entry, and a loaded item has ``None`` or an empty list; ``grade``, ``source`` and the counts of
``drape`` are the same in both. In items JSON text is parsed.

====================  =========  ===============================================================  =====================
garments              JSON type  holds                                                            if missing
====================  =========  ===============================================================  =====================
``schema``            int        version of the format: 3
``key``               text       name of the sample in its shard
``index``             int        number of the sample
``seed``              int
``attempts``          int        designs tried, this one included
``rejects``           objects    a rejected design each: ``index`` (int) of the sample that       one of -1, ``""``
                                 failed, ``rule``, ``reason`` (texts), ``figures`` (JSON text);
                                 in items a text each, ``rule: reason``
``redraws``           objects    ``rule`` (text), ``count`` (int): parameters, parts and designs  one of ``""``, 0
                                 drawn again
``versions``          JSON text  package to version, of all packages that affect the bytes
``recipe``            JSON text  options of the generator
``recipe_sha256``     text
``pattern``           text       name of the pattern
``body``              text       name of the body
``holds``             object     ``shape``, ``mesh``, ``drape`` (bools): whether it has one
``pose``              object     ``arm_angle`` [rad], float; ``legs_apart``, bool                 0.0, false
``panel_names``       texts      rows of ``panels``
``panel_labels``      texts      labels that its column ``LABEL`` refers to
``edge_labels``       texts      labels that the column of ``edges`` refers to
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
``crc32``, ``crc32_before`` as above, ``name`` (text) and ``arm_angle`` [rad] (float).
"""

import json
import math
import re
import zlib
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from gcd_dataset.errors import ShardError
from gcd_dataset.jsonfile import found, loads
from gcd_dataset.records import Rejected
from gcd_dataset.shards.layout import SCHEMA, Bytes
from gcd_dataset.shards.limits import LARGEST_JSON

__all__ = [
    "decode_json",
    "json_bytes",
    "read_meta",
    "read_rejects",
    "read_sample_index",
    "reject_entry",
    "sealed",
    "write_meta",
]


def _no_constant(text: str) -> float:
    raise ValueError(f"{text} is not valid JSON")


STRICT = json.JSONDecoder(parse_constant=_no_constant)

SEAL = "crc32_before"
SEALED = re.compile(rb',"crc32_before":(\d{1,10})\}')
HEAD = re.compile(rb'\{\s*"schema":\s*\d+,\s*"key":\s*"[^"\\]*",\s*"index":\s*(\d{1,18})\s*,')
LONGEST = 1 << 62  # exceeds every sample number and byte count in an index


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


def reject_entry(reject: Rejected) -> dict[str, Any]:
    """A rejected attempt as an entry of ``rejects``; ``figures`` are rounded to four decimals."""
    figures = {name: _rounded(value) for name, value in reject.figures.items()}
    return {"index": reject.index, "rule": reject.rule, "reason": reject.reason, "figures": _text(figures)}


def _rounded(value: float) -> float:
    return value if isinstance(value, int) else round(float(value), DIGITS)


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
NO_REJECT: Mapping[str, Any] = {"index": -1, "rule": "", "reason": "", "figures": "{}"}
DIGITS = 4  # decimals of a figure of a reject
NO_STRAIN: Mapping[str, Any] = {"principal": [-1.0, -1.0], "panels": [[-1.0, -1.0]]}
NO_POSE: Mapping[str, Any] = {"arm_angle": 0.0, "legs_apart": False}

STORED: Mapping[str, Callable[[Any], Any]] = {
    "rejects": lambda rejects: list(rejects) or [NO_REJECT],
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
    """The ``meta`` of an item: ``rejects`` as texts, ``rule: reason``; ``None`` for missing values.

    Raises ``ShardError`` for another schema, a wrong seal, or a missing or invalid key.
    """
    meta = _mapping(decode_json(data), "the file")
    if meta.get("schema") != SCHEMA or isinstance(meta["schema"], bool):
        raise ShardError(f"of schema {found(meta.get('schema'))}, but this reader knows {SCHEMA}: update gcd_dataset")
    _require_seal(data)
    meta = _loaded(meta)
    forms = PERSON if "name" in meta else GARMENT
    for name, form in forms.items():
        if name not in meta:
            raise ShardError(f"{name} is missing")
        if not form(meta[name]):
            raise ShardError(f"{name} is {found(meta[name])}")
    return meta


def read_rejects(data: Bytes) -> list[dict[str, Any]]:
    """The entries of ``rejects`` in a ``meta.json``. Raises ``ShardError``."""
    entries = _list(_mapping(decode_json(data), "the file").get("rejects"), "rejects")
    if not all(map(IS_REJECT, entries)):
        raise ShardError(f"rejects is {found(entries)}")
    return [entry for entry in entries if entry["rule"]]


def read_sample_index(data: Bytes) -> int:
    """The sample index in a ``meta.json``, read from its head where possible. Raises ``ShardError``."""
    match = HEAD.match(data)
    return int(match[1]) if match else int(read_meta(data)["index"])


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
    rejects = [_mapping(entry, "rejects") for entry in _list(meta.get("rejects"), "rejects")]
    loaded["rejects"] = [f"{entry.get('rule')}: {entry.get('reason')}" for entry in rejects if entry.get("rule")]
    for name in ("vertex_labels", "tags"):
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
IS_REJECT = _has(index=_is_whole, rule=_is_word, reason=_is_word, figures=_is_word)
