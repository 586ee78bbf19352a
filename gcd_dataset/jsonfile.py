"""JSON files by people and by other programs: read and checked, with errors that name the file and the place in it."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from gcd_dataset.errors import SpecError

__all__ = ["Place", "found", "parse_json", "read_json"]

LARGEST_NUMBER = 1e12  # no length, angle or count comes near; its square is a number still
DEEPEST = 64  # levels of lists and objects; a pattern has nine

SQUARE = bytes.maketrans(b"{}", b"[]")
OTHERS = bytes(sorted(set(range(256)) - set(b"[]{}")))

TOO_DEEP = f"more than {DEEPEST} levels deep: flatten it"


def read_json(path: Path, kind: str) -> Any:
    """What is in the file. Raises ``SpecError``, which asks for a ``kind``, where it is missing or broken."""
    try:
        return parse_json(path.read_text(encoding="utf-8"))
    except FileNotFoundError as error:
        raise SpecError(f"{path}: no such file: give the path of a {kind}") from error
    except PermissionError as error:
        raise SpecError(f"{path}: cannot be read ({error.strerror}): ask for the right to read it") from error
    except OSError as error:
        raise SpecError(f"{path}: cannot be read ({error.strerror}): give the path of a {kind}") from error
    except json.JSONDecodeError as error:
        raise SpecError(f"{path}: line {error.lineno}, column {error.colno}: {error.msg}: mend the JSON") from error
    except ValueError as error:
        raise SpecError(f"{path}: {error}: mend the JSON") from error


def parse_json(text: str, *, constants: bool = False) -> Any:
    """What is in the text; ``constants``: NaN and infinities too, which Python writes and JSON lacks.

    Raises ``ValueError``: for broken JSON, numbers of thousands of digits, and nesting without end.
    """
    try:
        value = json.loads(text, parse_constant=float if constants else _no_constant)
    except RecursionError as error:
        raise ValueError(TOO_DEEP) from error
    # The brackets of strings count too here: only where there are many is the value itself looked at.
    if _most_open(text) > DEEPEST and _is_deep(value):
        raise ValueError(TOO_DEEP)
    return value


def _most_open(text: str) -> int:
    """Brackets that are open at once, at most."""
    if text.count("[") + text.count("{") <= DEEPEST:
        return 0
    brackets = np.frombuffer(text.encode(errors="replace").translate(SQUARE, OTHERS), np.int8)
    return int(np.cumsum((ord("[") + ord("]")) // 2 - brackets, dtype=np.int32).max())


@dataclass(frozen=True)
class Place:
    """Where the reading stands, for errors; and the checks that need it."""

    source: str
    path: str = ""

    def within(self, part: str) -> "Place":
        return replace(self, path=f"{self.path}, {part}" if self.path else part)

    def error(self, what: str) -> SpecError:
        return SpecError(f"{self.source}: {self.path + ': ' if self.path else ''}{what}")

    def mapping(self, value: Any, what: str) -> Mapping[str, Any]:
        if not isinstance(value, Mapping):
            raise self.error(f"{what or 'the file'} must be a JSON object, found {found(value)}")
        return value

    def list_of(self, holder: Mapping[str, Any], key: str) -> Sequence[Any]:
        value = holder.get(key)
        if not isinstance(value, list):
            raise self.error(f"{key} must be a list, found {found(value)}")
        return value

    def numbers(self, value: Any, count: int, what: str) -> tuple[float, ...]:
        if not (isinstance(value, list | tuple) and len(value) == count and all(_is_number(n) for n in value)):
            raise self.error(f"{what} must be {count} numbers, found {found(value)}")
        return tuple(float(n) for n in value)

    def number(self, value: Any, what: str) -> float:
        if not _is_number(value):
            raise self.error(f"{what} must be a number, found {found(value)}")
        return float(value)

    def index(self, value: Any, what: str) -> int:
        if not (isinstance(value, int) and _is_number(value)):
            raise self.error(f"{what} must be a whole number, found {found(value)}")
        return value

    def text(self, value: Any, what: str) -> str:
        if not isinstance(value, str):
            raise self.error(f"{what} must be a string, found {found(value)}")
        return value

    def require_flat(self, value: Any) -> None:
        """Raise ``SpecError`` for what is nested so deep that it could not be written again."""
        if _is_deep(value):
            raise self.error(TOO_DEEP)


def found(value: Any) -> str:
    """A value as errors show it: cut where it is long."""
    text = json.dumps(value, default=str) if value is not None else "nothing"
    return text if len(text) < 60 else text[:57] + "..."


def _no_constant(text: str) -> float:
    raise ValueError(f"{text} is no number")


def _is_deep(value: Any) -> bool:
    """Whether anything is nested deeper than ``DEEPEST``."""
    level = [value]
    for _ in range(DEEPEST):
        lists = [inner.values() if isinstance(inner, Mapping) else inner for inner in level if _holds(inner)]
        level = [inner for values in lists for inner in values]
    return bool(level)


def _holds(value: Any) -> bool:
    return isinstance(value, Mapping | list | tuple)


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and abs(value) <= LARGEST_NUMBER
