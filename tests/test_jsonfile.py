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
    "key twice among many": "{" + ",".join(f'"k{number}": 0' for number in range(50_000)) + ',"z": 0, "z": 1}',
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


def test_a_byte_order_mark_is_skipped() -> None:
    assert parse_json(b"\xef\xbb\xbf[1]", source="x") == [1]


KINDS: dict[str, tuple[str | bytes, str]] = {
    "a.svg": ('<?xml version="1.0"?>\n<!-- x -->\n<svg xmlns="x"/>', "an SVG drawing"),
    "svg.json": ("\ufeff<svg/>", "an SVG drawing"),
    "a.dxf": ("999\nby hand\n  0\r\nSECTION\r\n  2\r\n", "a DXF drawing"),
    "a.val": ('<?xml version="1.0"?>\n<!--x-->\n<pattern><version/></pattern>', "a file of Valentina or Seamly2D"),
    "a.sm2d": ("damaged", "a file of Valentina or Seamly2D"),
    "a.zprj": (b"PK\x03\x04\x14", "a file of CLO or Marvelous Designer"),
    "zip.json": (b"PK\x03\x04\x14", "an archive, not a map: unpack it"),
    "a.obj": ("# by hand\no Cube\nv 1 2 3\n", "a mesh, not a map: if it is a body, give it as --body"),
    "a.pdf": ("%PDF-1.7", "a PDF"),
    "a.jpg": (b"\xff\xd8\xff\xe0", "a picture"),
    "page.json": ("\n<!DOCTYPE html>\n<svg>", "a web page, perhaps the error of a server, not a map: download"),
    "lfs.json": (
        "version https://git-lfs.github.com/spec/v1\noid",
        "a pointer of Git LFS, not a map: get the file itself",
    ),
    "utf16.json": ("[1]".encode("utf-16"), "text in UTF-16, not a map: save it as UTF-8"),
    "design.yaml": ("meta: {upper: Shirt}", "YAML"),
    "empty.json": (b"", "empty"),
    "large.obj": (b"v 1 2 3\n" * 5_000_000, "a mesh"),
    "json.svg": ('{"a": ', "line 1, column 7: Expecting value: correct the JSON"),
}


@pytest.mark.parametrize("name", KINDS)
def test_files_of_other_kinds_are_named_by_content_first(name: str, tmp_path: Path) -> None:
    content, said = KINDS[name]
    (tmp_path / name).write_bytes(content.encode() if isinstance(content, str) else content)
    with pytest.raises(SpecError) as caught:
        read_json(tmp_path / name, "map")
    assert str(caught.value).startswith(f"{tmp_path / name}: {said}")


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
