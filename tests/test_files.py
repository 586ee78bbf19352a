"""Files are whole or not there."""

import errno
import os
from pathlib import Path

import pytest

from gcd_dataset.errors import OutputError
from gcd_dataset.files import make_folder, open_whole, write_whole


def test_a_file_appears_when_it_is_whole(tmp_path: Path) -> None:
    path = tmp_path / "a.bin"
    with open_whole(path) as file:
        file.write(b"new")
        assert not path.exists()
    assert path.read_bytes() == b"new"


def test_what_breaks_half_way_leaves_the_old_file(tmp_path: Path) -> None:
    path = tmp_path / "a.bin"
    write_whole(path, b"old")
    with pytest.raises(KeyboardInterrupt), open_whole(path) as file:
        file.write(b"half")
        raise KeyboardInterrupt
    assert path.read_bytes() == b"old"
    assert list(tmp_path.iterdir()) == [path]


def test_two_that_write_the_same_file_at_once_do_not_meet(tmp_path: Path) -> None:
    """They may have the same process number, in containers that share a folder."""
    path = tmp_path / "a.bin"
    with open_whole(path) as first:
        first.write(b"the first")
        write_whole(path, b"second")
        assert path.read_bytes() == b"second"
    assert path.read_bytes() == b"the first"


def test_a_place_that_cannot_be_written_is_named(tmp_path: Path) -> None:
    (tmp_path / "file").write_bytes(b"")
    with pytest.raises(OutputError, match=r"nowhere/a\.bin: cannot be written \(No such file or directory\)"):
        write_whole(tmp_path / "nowhere" / "a.bin", b"")
    with pytest.raises(OutputError, match=r"file/sub: cannot be written"):
        make_folder(tmp_path / "file" / "sub")


@pytest.mark.parametrize(
    ("code", "remedy"),
    [
        (errno.ENOSPC, "make room there, or choose another folder"),
        (errno.EDQUOT, "make room there, or choose another folder"),
        (errno.EACCES, "choose a folder that you may write to"),
        (errno.EPERM, "choose a folder that you may write to"),
        (errno.EROFS, "choose a folder that you may write to"),
        (errno.EEXIST, "choose another name"),
        (errno.EISDIR, "choose another name"),
        (errno.ENOTDIR, "choose another name"),
        (errno.ENAMETOOLONG, "choose another name"),
        (errno.ENOENT, "make its folder first"),
        (errno.EIO, "choose another folder"),
    ],
)
def test_the_remedy_is_that_of_the_reason(
    code: int, remedy: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(*_: object) -> None:
        raise OSError(code, os.strerror(code))

    monkeypatch.setattr(os, "fsync", refuse)
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
