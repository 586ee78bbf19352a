"""Errors of TOML files name the file and a remedy."""

from pathlib import Path

import pytest

from gcd_dataset.errors import ConfigError
from gcd_dataset.tomlfile import read_toml

BROKEN = {
    "points = " + "9" * 5000: "Exceeds the limit (4300 digits) for integer string conversion",
    "points = 0x" + "f" * 100 + "g": "correct the TOML",
    "a = " + "[" * 100_000: "nested too deep: flatten the TOML",
    "a = 1\na = 2": "Cannot overwrite a value",
    "a = 2026-13-45": "correct the TOML",
    "= 1": "Invalid statement (at line 1, column 1): correct the TOML",
    ".".join("a" * 50_000) + " = 1": "nested too deep: flatten the TOML",
    ".".join("a" * 100) + " = 1": "nested too deep: flatten the TOML",
    "# much\n" * 200_000: "more than 1 MB: give the path of a TOML file",
}


@pytest.mark.parametrize("text", BROKEN, ids=lambda text: text[:12])
def test_broken_toml_is_one_line_with_file_and_remedy(text: str, tmp_path: Path) -> None:
    (tmp_path / "c.toml").write_text(text)
    with pytest.raises(ConfigError) as caught:
        read_toml(tmp_path / "c.toml")
    assert str(caught.value).startswith(f"{tmp_path / 'c.toml'}: ")
    assert BROKEN[text] in str(caught.value)
    assert str(caught.value).isprintable()


def test_a_byte_order_mark_is_skipped(tmp_path: Path) -> None:
    (tmp_path / "c.toml").write_bytes(b"\xef\xbb\xbfa = 1")
    assert read_toml(tmp_path / "c.toml") == {"a": 1}


def test_other_encodings_and_places_are_reported(tmp_path: Path) -> None:
    (tmp_path / "c.toml").write_bytes(b'a = "\xe9"')
    with pytest.raises(ConfigError, match=r"c\.toml: byte 5 is not valid UTF-8: correct the TOML"):
        read_toml(tmp_path / "c.toml")
    with pytest.raises(ConfigError, match=r"no\.toml: no such file: give the path of a TOML file"):
        read_toml(tmp_path / "no.toml")
    with pytest.raises(ConfigError, match=r"cannot be read \(Is a directory\)"):
        read_toml(tmp_path)
