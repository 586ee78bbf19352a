"""Broken or ambiguous JSON raises one error of the caller's class."""

import json
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from gcd_dataset.errors import BodyError, ShardError, SpecError
from gcd_dataset.jsonfile import DEEPEST, found, parse_json, read_json

BROKEN: dict[str, str | bytes] = {
    "deep": "[" * 100_000 + "]" * 100_000,
    "deep and open": '{"a":' * 100_000,
    "one level too deep": "[" * (DEEPEST + 1) + "]" * (DEEPEST + 1),
    "digits": "9" * 5000,
    "nan": "[NaN]",
    "infinity": '{"a": -Infinity}',
    "overflow": "1e400",
    "key twice": '{"front": 1, "back": 2, "front": 3}',
    "half a pair": r'"\ud800"',
    "no JSON": "{",
    "nothing": "",
    "latin": b'"\xe9"',
}


@pytest.mark.parametrize("case", BROKEN)
def test_broken_json_is_one_line_with_source_and_remedy(case: str) -> None:
    with pytest.raises(ShardError) as caught:
        parse_json(BROKEN[case], source="member spec.json", remedy="copy it again", error=ShardError)
    text = str(caught.value)
    assert text.startswith("member spec.json: ")
    assert "\n" not in text and len(text) < 200
    assert text.endswith("copy it again")


scalars = st.none() | st.booleans() | st.integers() | st.floats(allow_nan=False, allow_infinity=False) | st.text()
values = st.recursive(scalars, lambda inner: st.lists(inner) | st.dictionaries(st.text(), inner))


@given(values)
def test_written_values_are_read_back(value: object) -> None:
    text = json.dumps(value)
    assert parse_json(text, source="x") == value
    assert parse_json(memoryview(text.encode()), source="x") == value


def test_brackets_in_strings_are_no_levels() -> None:
    assert parse_json(json.dumps(["[" * 100]), source="x") == ["[" * 100]
    assert parse_json("[" * DEEPEST + "]" * DEEPEST, source="x")


def test_more_than_the_limit_is_refused_before_it_is_parsed(tmp_path: Path) -> None:
    with pytest.raises(SpecError, match="9 bytes, more than 8"):
        parse_json(b"[1,2,3,4]", source="x", limit=8)
    (tmp_path / "sparse.json").touch()
    with (tmp_path / "sparse.json").open("rb+") as file:
        file.truncate(1 << 40)
    with pytest.raises(BodyError, match=r"sparse\.json: more than 32 MB: give the path of a segmentation"):
        read_json(tmp_path / "sparse.json", "segmentation", error=BodyError)


def test_a_path_that_no_system_takes_is_reported() -> None:
    with pytest.raises(SpecError, match="names no file"):
        read_json(Path("a\0b"), "specification JSON")


def test_an_odd_value_is_shown_short() -> None:
    deep: list[object] = []
    for _ in range(100_000):
        deep = [deep]
    assert found(deep) == "a list"
    assert len(found(10**5000)) < 60
    assert found(None) == "nothing"
