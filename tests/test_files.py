"""Files are written atomically, by any number of writers."""

import errno
import fcntl
import os
import socket
import subprocess
import sys
from pathlib import Path

import pytest

from gcd_dataset.errors import OutputError, SpecError
from gcd_dataset.files import DRAFTS, make_folder, open_whole, read_whole, write_whole

REPOSITORY = Path(__file__).resolve().parent.parent


def test_a_file_appears_when_it_is_whole(tmp_path: Path) -> None:
    path = tmp_path / "a.bin"
    with open_whole(path) as file:
        file.write(b"new")
        assert not path.exists()
    assert path.read_bytes() == b"new"


def test_a_write_that_fails_half_way_leaves_the_old_file(tmp_path: Path) -> None:
    path = tmp_path / "a.bin"
    write_whole(path, b"old")
    with pytest.raises(KeyboardInterrupt), open_whole(path) as file:
        file.write(b"half")
        raise KeyboardInterrupt
    assert path.read_bytes() == b"old"
    assert list(tmp_path.iterdir()) == [path]


def test_two_may_write_one_file_at_once(tmp_path: Path) -> None:
    """Threads of one process, or processes with the same pid in two containers."""
    path = tmp_path / "a.bin"
    with open_whole(path) as file:
        file.write(b"one")
        write_whole(path, b"another")
        assert path.read_bytes() == b"another"
    assert path.read_bytes() == b"one"
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
    with begun_by_another(path) as first, begun_by_another(path) as second:
        drafts = sorted(tmp_path.iterdir())
        assert [draft.stat().st_size for draft in drafts] == [5000, 5000]
        second.kill()
        second.wait()
        write_whole(path, b"new")
        assert sorted(tmp_path.iterdir()) == [drafts[0], path]  # the first still writes
        first.kill()
    write_whole(tmp_path / "b.bin", b"of another name")
    assert drafts[0].exists()
    write_whole(path, b"newer")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a.bin", "b.bin"]
    assert path.read_bytes() == b"newer"


def test_any_number_may_write_one_file_at_once(tmp_path: Path) -> None:
    path = tmp_path / "a.bin"
    files = [open_whole(path) for _ in range(DRAFTS + 2)]
    for number, file in enumerate(files):
        file.__enter__().write(bytes([number]))
    for number, file in enumerate(files):
        file.__exit__(None, None, None)
        assert path.read_bytes() == bytes([number])
    assert list(tmp_path.iterdir()) == [path]


def test_files_are_written_without_locks_too(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: object) -> None:
        raise OSError(errno.ENOLCK, os.strerror(errno.ENOLCK))

    monkeypatch.setattr(fcntl, "flock", refuse)
    with open_whole(tmp_path / "a.bin") as file:
        write_whole(tmp_path / "a.bin", b"another")
        file.write(b"one")
    assert {path.name: path.read_bytes() for path in tmp_path.iterdir()} == {"a.bin": b"one"}


def test_a_link_in_the_place_of_a_draft_is_not_followed(tmp_path: Path) -> None:
    (tmp_path / "victim").write_bytes(b"a user's own")
    for number in range(DRAFTS):
        (tmp_path / f".a.bin.{number}.part").symlink_to(tmp_path / "victim")
    write_whole(tmp_path / "a.bin", b"new")
    assert (tmp_path / "a.bin").read_bytes() == b"new"
    assert (tmp_path / "victim").read_bytes() == b"a user's own"


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
