"""Files are written atomically by any number of writers; JSON, YAML and TOML from outside are refused in one line."""

import errno
import json
import os
import socket
import subprocess
import sys
from pathlib import Path
from unittest.mock import Mock

import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st

from gcd_dataset.errors import BodyError, ConfigError, OutputError, ShardError, SpecError
from gcd_dataset.files import make_folder, open_whole, read_whole, write_whole
from gcd_dataset.jsonfile import DEEPEST, parse_json, read_json, read_toml
from gcd_dataset.yamlfile import require_shallow, strict_yaml

REPOSITORY = Path(__file__).resolve().parent.parent


def test_a_write_that_fails_half_way_leaves_the_old_file(tmp_path: Path) -> None:
    path = tmp_path / "a.bin"
    write_whole(path, b"old")
    with pytest.raises(KeyboardInterrupt), open_whole(path) as file:
        file.write(b"half")
        raise KeyboardInterrupt
    assert path.read_bytes() == b"old"
    assert list(tmp_path.iterdir()) == [path]


def begun_by_another(path: Path) -> subprocess.Popen[bytes]:
    """A process that has written 5000 bytes of a draft and keeps it open."""
    program = f"""
import sys, time
from gcd_dataset.files import open_whole
with open_whole({str(path)!r}) as file:
    file.write(bytes(5000))
    file.flush()
    print(flush=True)
    time.sleep(600)
"""
    process = subprocess.Popen([sys.executable, "-c", program], cwd=REPOSITORY, stdout=subprocess.PIPE)
    assert process.stdout is not None
    process.stdout.readline()
    return process


def test_the_draft_of_a_killed_writer_goes_with_the_next_writer(tmp_path: Path) -> None:
    path = tmp_path / "a.bin"
    with begun_by_another(path) as process:
        [draft] = tmp_path.iterdir()
        write_whole(path, b"new")
        assert sorted(tmp_path.iterdir()) == [draft, path]  # the first still writes
        process.kill()
    assert draft.stat().st_size == 5000
    write_whole(path, b"newer")
    assert [path] == list(tmp_path.iterdir())
    assert path.read_bytes() == b"newer"


def test_any_number_may_write_one_file_at_once(tmp_path: Path) -> None:
    """It appears when the first has closed it."""
    path = tmp_path / "a.bin"
    files = [open_whole(path) for _ in range(3)]
    for number, file in enumerate(files):
        file.__enter__().write(bytes([number]))
    assert not path.exists()
    for number, file in enumerate(files):
        file.__exit__(None, None, None)
        assert path.read_bytes() == bytes([number])
    assert list(tmp_path.iterdir()) == [path]


REMEDIES = {
    "make room there, or choose another folder": (errno.ENOSPC, errno.EDQUOT),
    "choose a folder that you may write to": (errno.EACCES, errno.EPERM, errno.EROFS),
    "choose another name": (errno.EEXIST, errno.EISDIR, errno.ENOTDIR, errno.ENAMETOOLONG),
    "make its folder first": (errno.ENOENT,),
    "choose another folder": (errno.EIO,),
}


@pytest.mark.parametrize(("code", "remedy"), [(code, remedy) for remedy, codes in REMEDIES.items() for code in codes])
def test_the_remedy_is_that_of_the_reason(
    code: int, remedy: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(os, "fsync", Mock(side_effect=OSError(code, os.strerror(code))))
    with pytest.raises(OutputError) as caught:
        write_whole(tmp_path / "a.bin", b"")
    assert str(caught.value) == f"{tmp_path / 'a.bin'}: cannot be written ({os.strerror(code)}): {remedy}"


def test_a_file_in_the_way_of_a_folder_and_a_folder_in_the_way_of_a_file(tmp_path: Path) -> None:
    (tmp_path / "file").write_bytes(b"")
    (tmp_path / "folder").mkdir()
    for write in (
        lambda: make_folder(tmp_path / "file"),
        lambda: make_folder(tmp_path / "file" / "sub"),
        lambda: write_whole(tmp_path / "file" / "a.bin", b""),
        lambda: write_whole(tmp_path / "folder", b""),
    ):
        with pytest.raises(OutputError, match=": choose another name"):
            write()
    assert sorted(path.name for path in tmp_path.iterdir()) == ["file", "folder"]


@pytest.mark.parametrize("path", ["", ".", "/", "a\0b"])
def test_a_path_without_a_name_is_no_file(path: str) -> None:
    with pytest.raises(OutputError, match=r"names no file: give a file name$") as caught:
        write_whole(path, b"")
    assert str(caught.value).isprintable()
    if "\0" in path:
        with pytest.raises(OutputError, match="names no folder: give a folder name"):
            make_folder(path)


@pytest.mark.parametrize("url", ["s3://bucket/set", "https://example.org/set"])
def test_a_url_makes_no_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, url: str) -> None:
    monkeypatch.chdir(tmp_path)
    for path in (url, Path(url)):
        with pytest.raises(OutputError, match=r"a URL, but a local folder is needed: give a folder"):
            make_folder(path)
    assert not list(tmp_path.iterdir())


def test_what_is_no_regular_file_is_refused_and_never_waited_for(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)  # the path of a socket is short
    os.mkfifo("pipe")
    with socket.socket(socket.AF_UNIX) as bound:
        bound.bind("socket")
        for name, kind in {"pipe": "a pipe", "socket": "a socket", "/dev/zero": "a device"}.items():
            with pytest.raises(
                SpecError, match=rf"{name}: cannot be read \({kind}, not a file\): give the path of a mesh"
            ):
                read_whole(name, "mesh", limit=9, error=SpecError)


BROKEN: dict[str, str | bytes] = {
    "deep": "[" * 100_000 + "]" * 100_000,
    "one level too deep": "[" * (DEEPEST + 1) + "]" * (DEEPEST + 1),
    "digits": "9" * 5000,
    "nan": "[NaN]",
    "overflow": "1e400",
    "half a pair": r'"\ud800"',
    "key twice among many": "{" + ",".join(f'"k{number}": 0' for number in range(50_000)) + ',"z": 0, "z": 1}',
    "no JSON": "{",
    "latin": b'"\xe9"',
}


@pytest.mark.parametrize("case", BROKEN)
def test_broken_json_is_one_line_with_source_and_remedy(case: str) -> None:
    content = BROKEN[case]
    with pytest.raises(ShardError) as caught:
        parse_json(
            content if isinstance(content, bytes) else content.encode(), source="member spec.json", error=ShardError
        )
    text = str(caught.value)
    assert text.startswith("member spec.json: ")
    assert "\n" not in text and len(text) < 200
    assert text.endswith("correct the JSON")


scalars = st.none() | st.booleans() | st.integers() | st.floats(allow_nan=False, allow_infinity=False) | st.text()
values = st.recursive(scalars, lambda inner: st.lists(inner) | st.dictionaries(st.text(), inner))


@given(values)
def test_written_values_are_read_back(value: object) -> None:
    assert parse_json(json.dumps(value).encode(), source="x") == value


def test_more_than_the_limit_is_refused_before_it_is_parsed(tmp_path: Path) -> None:
    (tmp_path / "sparse.json").touch()
    with (tmp_path / "sparse.json").open("rb+") as file:
        file.truncate(1 << 40)
    with pytest.raises(BodyError, match=r"sparse\.json: more than 32 MB: give the path of a segmentation"):
        read_json(tmp_path / "sparse.json", "segmentation", error=BodyError)


def test_a_byte_order_mark_is_skipped(tmp_path: Path) -> None:
    assert parse_json(b"\xef\xbb\xbf[1]", source="x") == [1]
    assert strict_yaml(b"\xef\xbb\xbfa: 1") == {"a": 1}
    (tmp_path / "c.toml").write_bytes(b"\xef\xbb\xbfa = 1")
    assert read_toml(tmp_path / "c.toml") == {"a": 1}


KINDS: dict[str, tuple[str | bytes, str]] = {
    "a.svg": ('<?xml version="1.0"?>\n<!-- x -->\n<svg xmlns="x"/>', "an SVG drawing"),
    "svg.json": ("\ufeff<svg/>", "an SVG drawing"),
    "a.dxf": ("999\nby hand\n  0\r\nSECTION\r\n  2\r\n", "a DXF drawing"),
    "a.val": ('<?xml version="1.0"?>\n<!--x-->\n<pattern><version/></pattern>', "a file of Valentina or Seamly2D"),
    "a.zprj": (b"PK\x03\x04\x14", "a file of CLO or Marvelous Designer"),
    "zip.json": (b"PK\x03\x04\x14", "an archive, not a map: unpack it"),
    "a.obj": ("# by hand\no Cube\nv 1 2 3\n", "a mesh, not a map: if it is a body, give it as --body"),
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


@pytest.mark.parametrize("content", [b"[" * 100_000, b"{a: " * 50_000, b"- " * 50_000, b"? " * 50_000], ids=repr)
def test_deep_nesting_is_refused(content: bytes) -> None:
    with pytest.raises(RecursionError, match="levels deep"):
        require_shallow(content)


def test_a_repeated_key_is_named_among_many() -> None:
    keys = "".join(f"k{number}: 0\n" for number in range(5_000))
    with pytest.raises(yaml.MarkedYAMLError, match="a repeated key: remove one of the entries") as caught:
        strict_yaml(f"{keys}z: 0\nz: 1\n")
    assert caught.value.problem_mark is not None and caught.value.problem_mark.line == 5_000


BROKEN_TOML = {
    "points = " + "9" * 5000: "Exceeds the limit (4300 digits) for integer string conversion",
    "a = " + "[" * 100_000: "nested too deep: flatten the TOML",
    "a = 1\na = 2": "Cannot overwrite a value",
    "= 1": "Invalid statement (at line 1, column 1): correct the TOML",
    ".".join("a" * 50_000) + " = 1": "nested too deep: flatten the TOML",
    ".".join("a" * 100) + " = 1": "nested too deep: flatten the TOML",
    "# much\n" * 200_000: "more than 1 MB: give the path of a TOML file",
    'a = "é"': "byte 5 is not valid UTF-8: correct the TOML",
}


@pytest.mark.parametrize("text", BROKEN_TOML, ids=lambda text: text[:12])
def test_broken_toml_is_one_line_with_file_and_remedy(text: str, tmp_path: Path) -> None:
    (tmp_path / "c.toml").write_text(text, encoding="latin-1")
    with pytest.raises(ConfigError) as caught:
        read_toml(tmp_path / "c.toml")
    assert str(caught.value).startswith(f"{tmp_path / 'c.toml'}: ")
    assert BROKEN_TOML[text] in str(caught.value)
    assert str(caught.value).isprintable()
