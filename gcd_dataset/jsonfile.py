"""JSON and TOML from outside: strict parsing and type checks, with errors that name the file and the position in it."""

import json
import tomllib
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import chain, islice
from math import isfinite
from pathlib import Path
from typing import Any

from gcd_dataset.errors import ConfigError, GcdError, SpecError, shown
from gcd_dataset.filekinds import other_kind
from gcd_dataset.files import read_whole

LARGEST_JSON = 32 << 20  # bytes; a published pattern has 60 kB, and a parsed file takes up to twenty times its size
LARGEST_NUMBER = 1e12  # larger than any length, angle or count; its square is finite
DEEPEST = 64  # levels of lists and objects; a pattern has nine
REMEDY = "correct the JSON"

TOO_DEEP = f"more than {DEEPEST} levels deep"
NOT_BRACKETS = bytes(set(range(256)) - set(b"[]{}"))


def parse_json(content: bytes, *, source: str, error: type[GcdError] = SpecError) -> Any:
    """The parsed value of a JSON text.

    Raises ``error``, whose message begins with ``source``, for text that is not JSON in UTF-8, and for JSON that
    readers disagree on: more than 64 levels, numbers beyond float64 or of thousands of digits, a repeated key, a lone
    surrogate.
    """
    try:
        value = loads(str(content, "utf-8-sig"), decode=DECODER.decode)
        if b"\\u" in content:
            json.dumps(value, ensure_ascii=False).encode()
    except json.JSONDecodeError as cause:
        position = f"line {cause.lineno}, column {cause.colno}"
        raise error(f"{source}: {position}: {cause.msg}: {REMEDY}") from cause
    except UnicodeError as cause:
        raise error(f"{source}: not UTF-8 ({cause.reason}): {REMEDY}") from cause  # type: ignore[attr-defined]
    except ValueError as cause:
        # Without Python's advice on ``sys.set_int_max_str_digits``.
        raise error(f"{source}: {str(cause).partition(';')[0]}: {REMEDY}") from cause
    return value


def loads(text: str, *, decode: Callable[[str], Any] = json.loads) -> Any:
    """The value of a JSON text, parsed by ``decode``.

    Raises ``ValueError`` for broken JSON, numbers of thousands of digits, and more than 64 levels.
    """
    try:
        value = decode(text)
    except RecursionError as error:
        raise ValueError(TOO_DEEP) from error
    if not _surely_flat(text.encode("utf-8", "replace")) and not is_flat(value):
        raise ValueError(TOO_DEEP)
    return value


def read_json(path: Path, kind: str, *, limit: int = LARGEST_JSON, error: type[GcdError] = SpecError) -> Any:
    """The parsed JSON of a file of at most ``limit`` bytes.

    Raises ``error``, which asks for a ``kind``, if it is missing, broken, too large or recognised as another kind.
    """
    try:
        content = read_whole(path, kind, limit=limit, error=error)
        return parse_json(content, source=str(path), error=error)
    except error as cause:
        if (other := other_kind(path)) is None:
            raise
        found_kind, remedy = other
        raise error(f"{path}: {found_kind}, not a {kind}: {remedy or f'give the path of a {kind}'}") from cause


@dataclass(frozen=True)
class JsonPath:
    """A position in a JSON file, named in errors; its methods check the type of a value found there.

    >>> JsonPath("a.json").within("panel front").number("wide", "width")
    Traceback (most recent call last):
    gcd_dataset.errors.SpecError: a.json: panel front: width must be a number, found "wide"
    """

    source: str
    """The file."""
    path: str = ""

    def within(self, part: str) -> "JsonPath":
        return replace(self, path=f"{self.path}, {part}" if self.path else part)

    def error(self, fault: str) -> SpecError:
        return SpecError(f"{self.source}: {self.path + ': ' if self.path else ''}{fault}")

    def mapping(self, value: Any, name: str) -> Mapping[str, Any]:
        if not isinstance(value, Mapping):
            raise self.error(f"{name or 'the file'} must be a JSON object, found {found(value)}")
        return value

    def list_of(self, holder: Mapping[str, Any], key: str) -> Sequence[Any]:
        value = holder.get(key)
        if not isinstance(value, list):
            raise self.error(f"{key} must be a list, found {found(value)}")
        return value

    def numbers(self, value: Any, count: int, name: str) -> tuple[float, ...]:
        if not (isinstance(value, list | tuple) and len(value) == count and all(_is_number(n) for n in value)):
            raise self.error(f"{name} must be {count} numbers{_limit(value)}, found {found(value)}")
        return tuple(float(n) for n in value)

    def number(self, value: Any, name: str) -> float:
        if not _is_number(value):
            raise self.error(f"{name} must be a number{_limit([value])}, found {found(value)}")
        return float(value)

    def index(self, value: Any, name: str) -> int:
        number = whole(value)
        if number is None or not _is_number(number):
            raise self.error(f"{name} must be a whole number{_limit([value])}, found {found(value)}")
        return number

    def text(self, value: Any, name: str) -> str:
        if not isinstance(value, str):
            raise self.error(f"{name} must be a string, found {found(value)}")
        return value

    def require_flat(self, value: Any) -> None:
        """Raise ``SpecError`` for a value nested too deep to be written again."""
        if not is_flat(value):
            raise self.error(f"{TOO_DEEP}: flatten it")


def given(holder: Mapping[str, Any], key: str, default: Any) -> Any:
    """The value of a key, or ``default`` if it is absent or null."""
    return default if (value := holder.get(key)) is None else value


def whole(value: Any) -> int | None:
    """The whole number that a parsed value is, ``1.0`` included; ``None`` for any other value."""
    if isinstance(value, float) and value.is_integer():
        return int(value)
    return value if type(value) is int else None


def is_flat(value: Any, *, most: int | None = None) -> bool:
    """Whether a tree has at most 64 levels, and on each level fewer than ``most`` values, aliases counted each time."""
    level = [value]
    for _ in range(DEEPEST):
        holders = (value for value in level if isinstance(value, Mapping | list | tuple))
        inner = (holder.values() if isinstance(holder, Mapping) else holder for holder in holders)
        level = list(islice(chain.from_iterable(inner), most))
        if len(level) == most:
            return False
    return not level


def found(value: Any) -> str:
    """The value as JSON for an error message, cut to 60 characters."""
    try:
        text = json.dumps(value, default=str) if value is not None else "nothing"
    except (RecursionError, TypeError, ValueError):  # too deep, an odd key, a number of thousands of digits
        text = f"a {type(value).__name__}"
    return text if len(text) < 60 else text[:57] + "..."


def _no_constant(text: str) -> float:
    raise ValueError(f"{text} is not a number")


def _finite(text: str) -> float:
    if not isfinite(value := float(text)):
        raise ValueError(f"the number {text[:20]} is too large")
    return value


def _unique(items: list[tuple[str, Any]]) -> dict[str, Any]:
    table = dict(items)
    if len(table) < len(items):
        twice = next(key for key, count in Counter(key for key, _ in items).items() if count > 1)
        raise ValueError(f"key {shown(twice[:40])} occurs twice in one object")
    return table


DECODER = json.JSONDecoder(object_pairs_hook=_unique, parse_float=_finite, parse_constant=_no_constant)


def _surely_flat(content: bytes) -> bool:
    """Whether the brackets alone prove at most ``DEEPEST`` levels; fast. May be false where strings hold brackets."""
    if content.count(b"[") + content.count(b"{") <= DEEPEST:
        return True
    brackets = content.translate(None, NOT_BRACKETS)
    for _ in range(DEEPEST):
        if not brackets:
            break
        brackets = brackets.replace(b"[]", b"").replace(b"{}", b"")
    return not brackets


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and abs(value) <= LARGEST_NUMBER


def _limit(values: Any) -> str:
    """The bound of numbers, for a message on values of which one exceeds it."""
    numbers = [value for value in values if isinstance(value, int | float)] if isinstance(values, list) else []
    return f" of at most {LARGEST_NUMBER:g}" if any(abs(value) > LARGEST_NUMBER for value in numbers) else ""


LARGEST_TOML = 1 << 20  # bytes, a second to parse; a config file has some kilobytes
MOST_DOTS = 1000  # in a line; for a dotted key tomllib takes time and memory that grow with the square of its parts


def read_toml(path: Path | str) -> dict[str, Any]:
    """The parsed TOML of a file. Raises ``ConfigError`` if it is missing, broken or too large."""
    content = read_whole(path, "TOML file", limit=LARGEST_TOML, error=ConfigError)
    try:
        if max(line.count(b".") for line in content.split(b"\n")) > MOST_DOTS:
            raise RecursionError
        table = tomllib.loads(content.decode("utf-8-sig"))
        if not is_flat(table):
            raise RecursionError
        return table
    except RecursionError as error:
        raise ConfigError(f"{path}: nested too deep: flatten the TOML") from error
    except UnicodeDecodeError as error:
        raise ConfigError(f"{path}: byte {error.start} is not valid UTF-8: correct the TOML") from error
    except ValueError as error:  # also raised for an integer of thousands of digits, with advice after a semicolon
        raise ConfigError(f"{path}: {str(error).partition(';')[0]}: correct the TOML") from error
