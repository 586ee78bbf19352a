"""Files are whole or not there."""

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


def test_a_place_that_cannot_be_written_is_named(tmp_path: Path) -> None:
    (tmp_path / "file").write_bytes(b"")
    with pytest.raises(OutputError, match=r"nowhere/a\.bin: cannot be written \(No such file or directory\)"):
        write_whole(tmp_path / "nowhere" / "a.bin", b"")
    with pytest.raises(OutputError, match=r"file/sub: cannot be written"):
        make_folder(tmp_path / "file" / "sub")
