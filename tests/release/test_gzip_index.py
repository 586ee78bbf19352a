"""Gzip content read from any offset equals the content unpacked from the beginning."""

import gzip
import os
import zlib
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from gcd_dataset.release import gzip_index
from gcd_dataset.release.archive import GzipScanner, SeekPoint, read_from

SIZE = 2_000_000


@pytest.fixture(autouse=True)
def close_points(monkeypatch: pytest.MonkeyPatch) -> None:
    """Seek points every 256 kB of content, so that small files have several."""
    monkeypatch.setattr(gzip_index, "EVERY", 1 << 18)


@pytest.fixture(scope="module")
def content() -> bytes:
    """Content of three compression ratios: numbers as text, noise, zeros."""
    random = np.random.default_rng(3)
    numbers = b"".join(b"%d\n" % n for n in random.integers(0, 4000, SIZE // 8))
    return numbers + random.bytes(SIZE // 4) + bytes(SIZE // 4) + numbers[::-1]


def packed_at(level: int) -> Callable[[bytes], bytes]:
    return lambda content: gzip.compress(content, level)


def in_streams(content: bytes) -> bytes:
    """Several concatenated streams, as written by parallel packers."""
    third = len(content) // 3
    return b"".join(gzip.compress(content[i : i + third]) for i in range(0, len(content), third))


@pytest.mark.parametrize("pack", [packed_at(0), packed_at(1), packed_at(6), in_streams])
def test_any_offset_reads_as_packed(pack: Callable[[bytes], bytes], content: bytes, tmp_path: Path) -> None:
    path = tmp_path / "file.gz"
    path.write_bytes(pack(content))
    with path.open("rb") as file:
        flow = GzipScanner(file.fileno())
        assert flow.read(len(content) + 1) == content
        points = flow.points
        for offset in np.random.default_rng(0).integers(0, len(content) - 70_000, 24).tolist():
            point = max((p for p in points if p.start <= offset), key=lambda p: p.start)
            assert read_from(file.fileno(), point, offset, 70_000) == content[offset : offset + 70_000]
        assert read_from(file.fileno(), points[-1], len(content) - 9, 9) == content[-9:]


def test_seek_points_are_found_inside_a_stream(content: bytes, tmp_path: Path) -> None:
    path = tmp_path / "file.gz"
    path.write_bytes(gzip.compress(content))
    with path.open("rb") as file:
        flow = GzipScanner(file.fileno())
        flow.skip(len(content))
    inside = [point for point in flow.points if point.window is not None]
    assert len(inside) >= 2
    for point in inside:
        assert point.window == content[point.start - gzip_index.WINDOW : point.start]


def test_a_truncated_file_is_reported(content: bytes, tmp_path: Path) -> None:
    path = tmp_path / "file.gz"
    packed = gzip.compress(content)
    path.write_bytes(packed[: len(packed) // 2])
    with path.open("rb") as file:
        with pytest.raises(EOFError):
            GzipScanner(file.fileno()).skip(len(content))
        with pytest.raises(EOFError):
            read_from(file.fileno(), SeekPoint(0, 0, None), len(content) - 5, 5)


def test_a_changed_byte_is_reported(content: bytes, tmp_path: Path) -> None:
    path = tmp_path / "file.gz"
    packed = bytearray(gzip.compress(content))
    packed[len(packed) // 2] ^= 1
    path.write_bytes(packed)
    with path.open("rb") as file, pytest.raises(zlib.error):
        GzipScanner(os.dup(file.fileno())).skip(2 * len(content))
