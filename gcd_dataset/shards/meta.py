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
``pose``              object     ``arm_angle`` [rad], float; ``legs_apart``, bool; only of        0.0, false
                                 recipes with ``poses``: ``name`` (text), ``cuts`` (int), edges
                                 at which the body cuts itself, ``bones``, for each of
                                 ``records.BONES`` bend, spread and twist, floats [rad]
``panel_names``       texts      rows of ``panels``
``panel_labels``      texts      labels that its column ``LABEL`` refers to
``edge_labels``       texts      labels that the column of ``edges`` refers to
``vertex_labels``     texts      labels of vertices                                               ``[""]``
``drape``             object     ``outcome`` (text), ``frames``, ``self_crossings``,              ``""``, 0, -1, -1.0
                                 ``body_crossings`` (cloth edges through body, garments under),
                                 ``body_through`` (edges of these through the cloth) (ints),
                                 ``stretch_median``, ``stretch_p99`` (floats)
``strain``            object     ``principal``, 2 floats; ``panels``, 2 floats per panel  (*)     -1.0
``grade``             text       ``clean``, ``paper`` or ``failed``  (*)                          ``""``
``fabric``            object     ``name`` (text), ``parameters`` (JSON text)                      ``""``, ``"{}"``
``gathers``           floats     left edge / right edge in length, for each seam  (*)             ``[-1.0]``
``softened``          float      stiffness of the fabric over that in the drape, for
                                 ``pressure``: ``records.Maps``; a key only of recipes with
                                 ``maps``
``motion``            object     only of recipes with a motion: ``frames``, ``asked`` (ints):      one of -1
                                 frames in ``motion.z`` and in the whole motion; ``fps``
                                 (float); ``ended`` (text): SETTLED, or the outcome for which
                                 it ends early; ``crossings``, for each frame 3 ints as in
                                 ``drape``
``outfit``            objects    only of sets of outfits: an entry for each garment, from the
                                 skin outwards: ``tucked``, ``closed`` (bools), ``pattern``,
                                 ``panel_names``, ``panel_labels``, ``edge_labels``,
                                 ``vertex_labels``, ``drape``, ``strain``, ``fabric`` and
                                 ``holds``, as here for the first garment
``layers``            objects    only of sets of outfits: for each two draped garments ``inner``    one of -1, -1.0
                                 and ``outer``, their places in ``outfit``, ``crossings`` and
                                 ``covered`` (ints), ``wrong_order`` (float): ``records.Layer``
``tags``              texts      names of the style: ``generator.garments.TAGS``  (*)             ``[""]``
``source``            text       publication that the garment comes from                          ``""``
``fit``               object     only of recipes with ``sizes``: ``chart``, ``cut_for``,          ``wearer_size`` ``""``
                                 ``wearer_size`` (texts), ``step`` (int), ``labels``, objects     for a body outside
                                 with ``rule``, ``reason`` (texts), ``figures`` (JSON text);      of it; a label of
                                 only with ``ease``: ``ease``, for each of ``records.EASE`` 3     ``""``, ``"{}"``;
                                 floats [cm]: cloth as cut, body, cloth as worn                   -1.0
``crc32``             object     CRC-32 of every other member, ints
``crc32_before``      int        CRC-32 of the bytes of this file before the comma of this key
====================  =========  ===============================================================  =====================

(*) missing where it was not computed, such as ``grade`` without a drape, or ``tags`` of a published garment.

In a body set each body has ``schema``, ``key``, ``index``, ``seed``, ``versions``, ``recipe``, ``recipe_sha256``,
``crc32``, ``crc32_before`` as above, ``name`` (text) and ``arm_angle`` [rad] (float).
"""

import json
import math
import re
import zlib
from collections.abc import Mapping
from typing import Any

import numpy as np
from jaxtyping import Float

from gcd_dataset.errors import ShardError
from gcd_dataset.jsonfile import found, loads
from gcd_dataset.records import BONES, EASE, BodyShape, Fit, FitLabel, GarmentMotion, Outcome, Pose, Rejected
from gcd_dataset.shards.layout import LARGEST_JSON, META, SCHEMA, Bytes, key_of


def _no_constant(text: str) -> float:
    raise ValueError(f"{text} is not valid JSON")


STRICT = json.JSONDecoder(parse_constant=_no_constant)

SEAL = "crc32_before"
SEALED = re.compile(rb',"crc32_before":(\d{1,10})\}')
LONGEST = 1 << 62  # exceeds every sample number and byte count in an index
DIGITS = 4  # decimals of a figure of a reject

# What the file holds in place of a missing value.
NO_REJECT: Mapping[str, Any] = {"index": -1, "rule": "", "reason": "", "figures": "{}"}
NO_REDRAW: Mapping[str, Any] = {"rule": "", "count": 0}
NO_POSE: Mapping[str, Any] = {"arm_angle": 0.0, "legs_apart": False}
COUNTS = ("self_crossings", "body_crossings", "body_through")
STRETCHES = ("stretch_median", "stretch_p99")
NO_DRAPE: Mapping[str, Any] = {"outcome": "", "frames": 0} | dict.fromkeys(COUNTS, -1) | dict.fromkeys(STRETCHES, -1.0)
NO_STRAIN: Mapping[str, Any] = {"principal": [-1.0, -1.0], "panels": [[-1.0, -1.0]]}
NO_FABRIC: Mapping[str, Any] = {"name": "", "parameters": "{}"}
NO_LABEL: Mapping[str, Any] = {"rule": "", "reason": "", "figures": "{}"}
NO_LENGTH = -1.0
NO_CROSSINGS = [-1, -1, -1]
NO_LAYER: Mapping[str, Any] = {"inner": -1, "outer": -1, "crossings": -1, "covered": -1, "wrong_order": -1.0}


def sealed(stored: Mapping[str, Any]) -> bytes:
    """A ``meta.json`` of stored entries; its last entry, the seal, is the CRC-32 of the bytes before."""
    body = json_bytes(stored)[:-1]
    return body + b',"%b":%d}' % (SEAL.encode(), zlib.crc32(body))


def json_bytes(value: Any) -> bytes:
    """Compact JSON in the order of the keys; floats keep all digits."""
    return json_text(value).encode()


def json_text(value: Any) -> str:
    """The text of ``json_bytes``. Raises ``ValueError`` for NaN and infinity."""
    return json.dumps(value, separators=(",", ":"), allow_nan=False, ensure_ascii=False)


def reject_entry(reject: Rejected) -> dict[str, Any]:
    """A rejected attempt as an entry of ``rejects``; ``figures`` are rounded to four decimals."""
    return {"index": reject.index, **_broken_rule(reject)}


def fit_entry(fit: Fit) -> dict[str, Any]:
    """The fit as the entry ``fit``; ``figures`` are rounded to four decimals."""
    named = {name: getattr(fit, name) for name in ("chart", "cut_for", "wearer_size", "step")}
    return {**named, "labels": list(map(_broken_rule, fit.labels)) or [NO_LABEL]}


def pose_entry(shape: BodyShape) -> dict[str, Any]:
    """The pose of a body as the entry ``pose``."""
    entry = {"arm_angle": float(shape.arm_angle), "legs_apart": bool(shape.legs_apart)}
    if (pose := shape.pose) is None:
        return entry
    return {**entry, "name": pose.name, "cuts": pose.cuts, "bones": dict(zip(BONES, pose.array.tolist(), strict=True))}


def shape_of(weights: Float[np.ndarray, " k"], entry: Mapping[str, Any]) -> BodyShape:
    """The body of shape weights and an entry ``pose``: the inverse of ``pose_entry``."""
    pose = None
    if "bones" in entry:
        turns = {bone: tuple(turn) for bone, turn in entry["bones"].items() if any(turn)}
        pose = Pose(turns, entry["name"], entry["cuts"])
    return BodyShape(weights, entry["arm_angle"], entry["legs_apart"], pose)


def motion_entry(motion: GarmentMotion) -> dict[str, Any]:
    """The motion as the entry ``motion``."""
    crossings = np.asarray(motion.crossings, int).tolist()
    known = {"frames": len(crossings), "asked": motion.asked, "fps": float(motion.fps), "ended": motion.ended.name}
    return {**known, "crossings": crossings or [NO_CROSSINGS]}


def _broken_rule(broken: Rejected | FitLabel) -> dict[str, Any]:
    figures = {name: x if isinstance(x, int) else round(float(x), DIGITS) for name, x in broken.figures.items()}
    return {"rule": broken.rule, "reason": broken.reason, "figures": json_text(figures)}


def decode_json(data: Bytes, *, limit: int = LARGEST_JSON) -> Any:
    """Parsed JSON. Raises ``ShardError``, also for over ``limit`` bytes, and for NaN and infinities."""
    if len(data) > limit:
        raise ShardError(f"{len(data)} bytes of JSON, over the limit of {limit}")
    try:
        return loads(str(data, "utf-8"), decode=STRICT.decode)
    except ValueError as error:
        raise ShardError(f"not JSON ({error})") from error


def decode_object(data: Bytes) -> dict[str, Any]:
    """A parsed JSON object. Raises ``ShardError`` as ``decode_json`` does, and for any other value."""
    value = decode_json(data)
    if not isinstance(value, dict):
        raise ShardError(f"{found(value)}, expected an object")
    return value


def read_meta(data: Bytes) -> dict[str, Any]:
    """The ``meta`` of an item: ``rejects`` as texts, ``rule: reason``; ``None`` for missing values.

    Raises ``ShardError`` for another schema, a wrong seal, or a missing or invalid key.
    """
    meta = decode_object(data)
    if meta.get("schema") != SCHEMA or isinstance(meta["schema"], bool):
        raise ShardError(f"of schema {found(meta.get('schema'))}, but this reader knows {SCHEMA}: update gcd_dataset")
    _require_seal(data)
    forms = PERSON if "name" in meta else GARMENT
    worn = ("outfit", "layers")
    for name in (*forms, *(worn if any(name in meta for name in worn) else ())):
        if name not in meta:
            raise ShardError(f"{name} is missing")
    for name, form in {**forms, **SOMETIMES}.items():
        if name in meta and not _has_form(meta[name], form):
            raise ShardError(f"{name} is {found(meta[name])}")
    loaded = {name: value for name, value in meta.items() if name != SEAL}
    loaded |= {name: _parsed(meta[name]) for name in ("versions", "recipe")}
    if not all(isinstance(version, str) for version in loaded["versions"].values()):
        raise ShardError(f"versions is {found(loaded['versions'])}")
    if "fit" in meta:
        loaded["fit"] = _loaded_fit(meta["fit"])
    if "motion" in meta:
        motion = meta["motion"]
        loaded["motion"] = motion | {"crossings": [each for each in motion["crossings"] if each != NO_CROSSINGS]}
    if "outfit" in meta:
        loaded["outfit"] = [entry | _loaded_garment(entry) for entry in meta["outfit"]]
        loaded["layers"] = [layer for layer in meta["layers"] if layer["inner"] >= 0]
    return loaded if forms is PERSON else loaded | _loaded(meta)


def _loaded(meta: Mapping[str, Any]) -> dict[str, Any]:
    """The values in items of the keys for which the file has others."""
    return {
        "rejects": [f"{entry['rule']}: {entry['reason']}" for entry in meta["rejects"] if entry["rule"]],
        "redraws": {entry["rule"]: entry["count"] for entry in meta["redraws"] if entry["rule"]},
        "pose": meta["pose"] if meta["holds"]["shape"] else None,
        **_loaded_garment(meta),
        "gathers": [ratio for ratio in meta["gathers"] if ratio != -1.0],
        "tags": [word for word in meta["tags"] if word],
    }


def _loaded_garment(entry: Mapping[str, Any]) -> dict[str, Any]:
    """The same, of an entry of ``outfit``."""
    holds, drape, fabric = entry["holds"], entry["drape"], entry["fabric"]
    stretches = {name: None if drape[name] == -1.0 else drape[name] for name in STRETCHES}
    return {
        "vertex_labels": [word for word in entry["vertex_labels"] if word] if holds["mesh"] else None,
        "drape": drape | stretches if holds["drape"] else None,
        "strain": None if entry["strain"] == NO_STRAIN else entry["strain"],
        "fabric": fabric | {"parameters": _parsed(fabric["parameters"])} if fabric["name"] else None,
    }


def _loaded_fit(fit: Mapping[str, Any]) -> dict[str, Any]:
    loaded = dict(fit)
    if "labels" in fit:
        labels = (label for label in fit["labels"] if label["rule"])
        loaded["labels"] = [label | {"figures": _parsed(label["figures"])} for label in labels]
    if "ease" in fit:
        loaded["ease"] = {
            name: {key: None if x == NO_LENGTH else x for key, x in zip(("cloth", "body", "worn"), of, strict=True)}
            for name, of in fit["ease"].items()
        }
    return loaded


def _parsed(text: str) -> dict[str, Any]:
    return decode_object(text.encode(errors="replace"))


def read_rejects(data: Bytes) -> list[dict[str, Any]]:
    """The entries of ``rejects`` in a ``meta.json``. Raises ``ShardError``."""
    entries: Any = decode_object(data).get("rejects")
    if not _has_form(entries, GARMENT["rejects"]):
        raise ShardError(f"rejects is {found(entries)}")
    return [entry for entry in entries if entry["rule"]]


def checked_meta(members: Mapping[str, Bytes], number: int) -> dict[str, Any]:
    """The ``meta`` of sample ``number``. Raises ``ShardError`` unless these of its members match its checksums."""
    try:
        meta = read_meta(members.get(META, b""))
        if not isinstance(meta.get("crc32"), Mapping):
            raise ShardError(f"crc32 is {found(meta.get('crc32'))}, expected an object")
        if meta["index"] != number:
            raise ShardError(f"is of {key_of(meta['index'])}")
    except ShardError as error:
        raise ShardError(f"member {META}: {error}") from error
    for member, data in members.items():
        if member != META and zlib.crc32(data) != meta["crc32"].get(member):
            raise ShardError(f"member {member}: bytes differ from the written ones")
    return meta


def _require_seal(data: Bytes) -> None:
    """Raise ``ShardError`` unless the CRC-32 at the end of the file matches."""
    end = bytes(data[-40:])
    match = next((match for match in SEALED.finditer(end) if match.end() == len(end)), None)
    if match is None:
        raise ShardError(f"does not end with its {SEAL}")
    if zlib.crc32(memoryview(data)[: len(data) - len(match[0])]) != int(match[1]):
        raise ShardError("bytes differ from the written ones")


def _has_form(value: Any, form: Any) -> bool:
    """Whether a value has the form: a type; a list of one form, or of several in turn; an object; or a predicate."""
    match form:
        case type():
            return type(value) is form
        case list():
            return isinstance(value, list) and all(_has_form(entry, form[0]) for entry in value)
        case tuple():
            return isinstance(value, list) and len(value) == len(form) and all(map(_has_form, value, form))
        case dict():
            return isinstance(value, dict) and all(_has_form(value.get(name), inner) for name, inner in form.items())
        case _:
            return bool(form(value))


def is_count(value: Any) -> bool:
    """Whether a value is a number from 0 on."""
    return type(value) is int and 0 <= value < LONGEST


def _is_number(value: Any) -> bool:
    return (type(value) is float and math.isfinite(value)) or (type(value) is int and abs(value) < LONGEST)


_ORIGIN: Mapping[str, Any] = {
    "schema": is_count,
    "key": str,
    "index": is_count,
    "seed": lambda seed: type(seed) is int and seed >= 0,
    "versions": str,
    "recipe": str,
}
PERSON: Mapping[str, Any] = {**_ORIGIN, "name": str, "arm_angle": _is_number}
_PAIR = (_is_number, _is_number)
_SIZES: Mapping[str, Any] = {"chart": str, "cut_for": str, "wearer_size": str, "step": int} | {
    "labels": [{"rule": str, "reason": str, "figures": str}]
}


def _is_fit(fit: Any) -> bool:
    """Whether a value is the ``fit`` of a recipe with ``sizes``, with ``ease`` or with both."""
    if not isinstance(fit, dict) or not fit:
        return False
    ease = {"ease": dict.fromkeys(EASE, (_is_number, _is_number, _is_number))} if "ease" in fit else {}
    return _has_form(fit, {**(_SIZES if fit.keys() - ease.keys() else {}), **ease})


_WORN: Mapping[str, Any] = {
    "pattern": str,
    "holds": {"mesh": bool, "drape": bool},
    "panel_names": [str],
    "panel_labels": [str],
    "edge_labels": [str],
    "vertex_labels": [str],
    "drape": {"outcome": str, "frames": int} | dict.fromkeys(COUNTS, int) | dict.fromkeys(STRETCHES, _is_number),
    "strain": {"principal": _PAIR, "panels": [_PAIR]},
    "fabric": {"name": str, "parameters": str},
}
_STANDS: Mapping[str, Any] = {"arm_angle": _is_number, "legs_apart": bool}
_POSED: Mapping[str, Any] = {
    **_STANDS,
    "name": str,
    "cuts": is_count,
    "bones": dict.fromkeys(BONES, (*_PAIR, _is_number)),
}
GARMENT: Mapping[str, Any] = {
    **_ORIGIN,
    "attempts": is_count,
    "rejects": [{"index": int, "rule": str, "reason": str, "figures": str}],
    "redraws": [{"rule": str, "count": is_count}],
    "body": str,
    **_WORN,
    "holds": {"shape": bool, "mesh": bool, "drape": bool},
    "pose": lambda pose: _has_form(pose, _POSED if isinstance(pose, dict) and "bones" in pose else _STANDS),
    "grade": str,
    "gathers": [_is_number],
    "tags": [str],
    "source": str,
}
"""Key to the form of its value in the file."""
_LAYER: Mapping[str, Any] = dict.fromkeys(("inner", "outer", "crossings", "covered"), int) | {"wrong_order": _is_number}
SOMETIMES: Mapping[str, Any] = {
    "fit": _is_fit,
    "softened": _is_number,
    "motion": {"frames": is_count, "asked": is_count, "fps": _is_number}
    | {"ended": Outcome.__members__.__contains__, "crossings": [(int, int, int)]},
    "outfit": lambda worn: bool(worn) and _has_form(worn, [{**_WORN, "tucked": bool, "closed": bool}]),
    "layers": [_LAYER],
}
"""The same of the keys that only some recipes have."""
