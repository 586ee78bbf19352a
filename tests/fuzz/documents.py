"""Damage to documents: trees of JSON, YAML or TOML values with some of their branches replaced, as strategies."""

import json
from collections.abc import Iterator, Sequence
from typing import Any

from hypothesis import strategies as st

DEEP = 3000  # levels: more than any parser of the standard library recurses
MOST_EDITS = 3
WORDS = ("", "..", "../../x", "/x", "\0", "a\nb", "NaN", "1e999", "right_wrong", "ф" * 300)


def edited(document: Any) -> st.SearchStrategy[Any]:
    """The document with one to three of its branches replaced, removed, repeated or renamed."""
    return st.lists(st.tuples(st.integers(0, 10**6), _edits()), min_size=1, max_size=MOST_EDITS).map(
        lambda edits: _apply(document, edits)
    )


def replaced(document: Any, number: int, text: str) -> Any:
    """The document with one of its branches replaced by JSON ``text``."""
    places = list(_places(document))
    return _changed(document, places[number % len(places)], "replace", _Raw(text))


def json_bytes(document: Any) -> bytes:
    """The document as JSON, with numbers and nesting that other JSON writers produce."""
    return _text(document).encode("utf-8", "surrogatepass")


class _Raw:
    """Text inserted into the document unquoted."""

    def __init__(self, text: str) -> None:
        self.text = text

    def __repr__(self) -> str:
        return f"{self.text[:30]}… ({len(self.text)})"


RAW = (_Raw("9" * 5000), _Raw("[" * DEEP + "]" * DEEP), _Raw('{"a":' * DEEP + "1" + "}" * DEEP), _Raw("1e400"))


def _values() -> st.SearchStrategy[Any]:
    scalars = st.one_of(
        st.none(),
        st.booleans(),
        st.integers(-3, 3),
        st.sampled_from((-(2**70), 2**31, 2**63, 2**70, 10**30)),
        st.floats(),
        st.sampled_from(WORDS),
        st.text(max_size=8),
    )
    return st.one_of(
        scalars,
        st.lists(scalars, max_size=4),
        st.dictionaries(st.sampled_from(WORDS), scalars, max_size=3),
        st.sampled_from(RAW),
    )


def _edits() -> st.SearchStrategy[tuple[str, Any]]:
    return st.one_of(
        st.tuples(st.just("replace"), _values()),
        st.tuples(st.sampled_from(("remove", "repeat", "wrap")), st.none()),
        st.tuples(st.just("rename"), st.sampled_from(WORDS)),
    )


def _apply(document: Any, edits: Sequence[tuple[int, tuple[str, Any]]]) -> Any:
    for number, (kind, value) in edits:
        places = list(_places(document))
        document = _changed(document, places[number % len(places)], kind, value)
    return document


def _places(value: Any, path: tuple[Any, ...] = ()) -> Iterator[tuple[Any, ...]]:
    """The paths of all branches, the root first."""
    yield path
    if isinstance(value, dict):
        for key, inner in value.items():
            yield from _places(inner, (*path, key))
    elif isinstance(value, list):
        for index, inner in enumerate(value):
            yield from _places(inner, (*path, index))


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


def _text(value: Any) -> str:
    if isinstance(value, _Raw):
        return value.text
    if isinstance(value, dict):
        return "{" + ",".join(f"{json.dumps(str(key))}:{_text(inner)}" for key, inner in value.items()) + "}"
    if isinstance(value, list | tuple):
        return "[" + ",".join(map(_text, value)) + "]"
    return json.dumps(value, default=str)
