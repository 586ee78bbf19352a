"""Inputs for readers of files: damaged bytes, and edited documents."""

import json
import math
import random
import re
import struct
from collections.abc import Iterator
from typing import Any

MOST_EDITS = 3
EXTREME_INTEGERS = (0, 1, 0x7F, 0xFF, 0x7FFF, 0xFFFF, 2**31 - 1, 2**32 - 1, 2**63 - 1, 2**64 - 1)
EXTREME_TEXTS = (
    b"-1", b"0", b"1e400", b"-1e400", b"NaN", b"1e-320", b"9" * 25, b"9" * 5000, b"null", b'""', b"[]", b"{}", b"true",
    b"[" * 3000, b'"../../x"', b'"\\u0000"', b"'a'",
)  # fmt: skip
NUMBER = re.compile(rb"-?\d+(?:\.\d+)?(?:[eE][+-]?\d+)?")
RARE = ("overwrite", "delete", "repeat", "move", "zero", "truncate", "noise", "integer")
EDITS = ("flip", "flip", *RARE, "number", "number")


def mutated(content: bytes, chance: random.Random) -> bytes:
    """The content after one to three random edits: bits, ranges, integers and numbers in text."""
    for _ in range(chance.randint(1, MOST_EDITS)):
        content = _mutation(content, chance.choice(EDITS), chance)
    return content


def _mutation(content: bytes, kind: str, chance: random.Random) -> bytes:
    start, longest = chance.randint(0, len(content)), chance.choice((4, 64, 1024, len(content)))
    end = min(len(content), start + chance.randint(1, max(longest, 1)))
    before, part, after = content[:start], content[start:end], content[end:]
    match kind:
        case "flip" if part:
            return before + bytes([part[0] ^ 1 << chance.randrange(8)]) + part[1:] + after
        case "overwrite" if part:
            return before + chance.randbytes(1) + part[1:] + after
        case "delete":
            return before + after
        case "repeat":
            return before + part + part + after
        case "move":
            at = chance.randint(0, len(before + after))
            return (before + after)[:at] + part + (before + after)[at:]
        case "zero":
            return before + bytes(len(part)) + after
        case "truncate":
            return before
        case "noise":
            return before + chance.randbytes(chance.randint(1, 16)) + part + after
        case "integer":  # binary, of 1 to 8 bytes, as if a size or offset in a header were wrong
            size, order = chance.choice((1, 2, 4, 8)), chance.choice("<>")
            number = struct.pack(
                order + {1: "B", 2: "H", 4: "I", 8: "Q"}[size], chance.choice(EXTREME_INTEGERS) % 2 ** (8 * size)
            )
            return before + number + content[start + size :]
        case "number":  # written as text, in JSON, YAML, OBJ and tar headers
            found = NUMBER.search(content, start) or NUMBER.search(content)
            if found is not None:
                return content[: found.start()] + chance.choice(EXTREME_TEXTS) + content[found.end() :]
    return content


DEEP = 3000  # levels: more than any parser of the standard library recurses
WORDS = ("", "..", "../../x", "/x", "\0", "a\nb", "NaN", "1e999", "right_wrong", "ф" * 300, "\ud800", "é\u202e")
NUMBERS = (
    *(-3, -1, 0, 1, 2, 3, -(2**70), 2**31, 2**63, 2**70, 10**30),
    *(0.5, -0.0, 5e-324, 1.8e308, 1e-9, -7.25, math.nan, math.inf, -math.inf),
)
CHANGES = ("replace", "replace", "replace", "remove", "repeat", "wrap", "rename")


class _Raw:
    """Text inserted into the document unquoted."""

    def __init__(self, text: str) -> None:
        self.text = text


RAW = (_Raw("9" * 5000), _Raw("[" * DEEP + "]" * DEEP), _Raw('{"a":' * DEEP + "1" + "}" * DEEP), _Raw("1e400"))


def edited(document: Any, chance: random.Random) -> bytes:
    """The document as JSON with one to three of its branches replaced, removed, repeated, wrapped or renamed."""
    for _ in range(chance.randint(1, MOST_EDITS)):
        kind = chance.choice(CHANGES)
        new = chance.choice(WORDS) if kind == "rename" else _value(chance)
        document = _changed(document, chance.choice(list(_places(document))), kind, new)
    return json_bytes(document)


def _value(chance: random.Random) -> Any:
    scalars = [chance.choice((None, True, False, *NUMBERS, *WORDS)) for _ in range(chance.randint(1, 4))]
    return chance.choice((scalars[0], scalars[0], scalars, dict(zip(WORDS, scalars, strict=False)), chance.choice(RAW)))


def _places(value: Any, path: tuple[Any, ...] = ()) -> Iterator[tuple[Any, ...]]:
    """The paths of all branches, the root first."""
    yield path
    branches = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    for key, inner in branches:
        yield from _places(inner, (*path, key))


def _changed(value: Any, path: tuple[Any, ...], kind: str, new: Any) -> Any:
    if not path:
        return {"replace": new, "wrap": [value]}.get(kind, value)
    key, rest = path[0], path[1:]
    copy = dict(value) if isinstance(value, dict) else list(value)
    if rest or kind in ("replace", "wrap"):
        copy[key] = _changed(copy[key], rest, kind, new)
    elif kind == "remove":
        del copy[key]
    elif kind == "repeat" and isinstance(copy, list):
        copy.insert(key, copy[key])
    elif kind == "rename" and isinstance(copy, dict):
        copy[new] = copy.pop(key)
    return copy


def json_bytes(document: Any) -> bytes:
    """The document as JSON, with numbers and nesting that other JSON writers produce."""
    return _text(document).encode("utf-8", "surrogatepass")


def _text(value: Any) -> str:
    if isinstance(value, _Raw):
        return value.text
    if isinstance(value, dict):
        return "{" + ",".join(f"{json.dumps(str(key))}:{_text(inner)}" for key, inner in value.items()) + "}"
    if isinstance(value, list | tuple):
        return "[" + ",".join(map(_text, value)) + "]"
    return json.dumps(value, default=str)
