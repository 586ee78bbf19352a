"""Downloaded archives: every garment is read, and the cached index is used until the archive changes."""

import gzip
import os
import shutil
import tracemalloc
import zlib
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from gcd_dataset.errors import OutputError, ShardError
from gcd_dataset.release.archive import WINDOW, Archive, GzipScanner, SeekPoint, read_from
from gcd_dataset.release.published_names import ENDINGS
from tests.release.published import BATCH, BODIES, TRAIN, file_of, pack, publish
from tests.shards.folders import forbidden, public_folder


@pytest.fixture(scope="module")
def folders(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return publish(tmp_path_factory.mktemp("folders"))


@pytest.fixture
def archive(folders: Path, tmp_path: Path) -> Path:
    """The archive of one batch."""
    return pack(Path(shutil.copytree(folders, tmp_path / "packed"))) / BATCH / BODIES[0] / "data.tar.gz"


def test_every_file_reads_as_packed(folders: Path, archive: Path) -> None:
    opened = Archive.opened(archive, None)
    for name in TRAIN:
        found = opened.read(name, list(ENDINGS))
        assert found == {kind: file_of(folders, name, kind).read_bytes() for kind in ENDINGS}


def test_an_archive_is_scanned_once(archive: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    cache = tmp_path / "cache"
    Archive.opened(archive, cache)
    assert sorted(path.suffix for path in cache.iterdir()) == [".npz", ".windows"]
    assert [path.name for path in archive.parent.iterdir() if path.name.startswith(".")] == []
    monkeypatch.setattr("gcd_dataset.release.archive._scan", None)
    Archive.opened(archive, cache)


def test_the_index_of_another_archive_is_not_used(archive: Path) -> None:
    before = Archive.opened(archive, None)
    content = gzip.decompress(archive.read_bytes())
    archive.write_bytes(gzip.compress(content, 1))
    after = Archive.opened(archive, None)
    assert after.read(TRAIN[0], ["spec"]) == before.read(TRAIN[0], ["spec"])
    next(archive.parent.glob(".*.npz")).write_bytes(b"broken")
    assert Archive.opened(archive, None).names == after.names


def test_a_damaged_archive_is_named_with_a_remedy(archive: Path) -> None:
    whole = archive.read_bytes()
    archive.write_bytes(whole[:-2000])
    with pytest.raises(ShardError, match=r"data\.tar\.gz: a damaged archive .*: extract or download it again"):
        Archive.opened(archive, None)
    changed = bytearray(gzip.decompress(whole))
    changed[changed.index(b"ustar")] = 0  # a header with a wrong checksum; tarfile would take it for the end
    archive.write_bytes(gzip.compress(bytes(changed)))
    with pytest.raises(ShardError, match=r"no tar header at byte"):
        Archive.opened(archive, None)
    archive.write_bytes(gzip.compress(bytes(10240)))
    with pytest.raises(ShardError, match="holds no garment of the published layout"):
        Archive.opened(archive, None)


def test_an_unwritable_index_suggests_cache_dir(archive: Path) -> None:
    with public_folder() as folder:
        moved = Path(shutil.copy(archive, folder))
        with forbidden(folder, 0o555), pytest.raises(OutputError, match="or give another folder as cache_dir"):
            Archive.opened(moved, None)


# ---------------------------------------------------------------------------------------------------------- damage


def with_size(archive: Path, size: bytes, member: int = 0) -> None:
    """Change the size field of a member, with a valid header checksum."""
    content = bytearray(gzip.decompress(archive.read_bytes()))
    place = content.index(b"ustar") - 257
    for _ in range(member):
        place = content.index(b"ustar", place + 512) - 257
    content[place + 124 : place + 136] = size
    content[place + 148 : place + 156] = b" " * 8
    content[place + 148 : place + 156] = b"%06o\0 " % sum(content[place : place + 512])
    archive.write_bytes(gzip.compress(bytes(content), 1))


@pytest.mark.parametrize(
    "size", [b"\xff" * 10 + b"\xfe\x00", b"\xff" * 12, b"\x80" + b"\x7f" * 11, b"\x80" + b"\xff" * 11]
)
def test_a_member_of_negative_or_huge_size_is_reported(archive: Path, size: bytes) -> None:
    """A size of -512 leads back to the same header: the scan would never end."""
    with_size(archive, size)
    with pytest.raises(ShardError, match=r"data\.tar\.gz: a damaged archive \(\S+ of -?\d+ bytes at byte 0"):
        Archive.opened(archive, None)


def test_a_file_over_the_limit_is_not_read(archive: Path) -> None:
    for member in range(20):
        with_size(archive, b"\x80" + (1 << 40).to_bytes(11, "big"), member)
        with pytest.raises(
            ShardError, match=r"data\.tar\.gz: a damaged archive \((ends in|.* bytes, where 268435456 are)"
        ):
            Archive.opened(archive, None)


@pytest.mark.parametrize("content", [gzip.compress(bytes(100_000_000)), gzip.compress(b"") * 20_000])
def test_a_decompression_bomb_takes_little_memory_and_time(archive: Path, content: bytes) -> None:
    archive.write_bytes(content)
    tracemalloc.start()
    with pytest.raises(ShardError, match="holds no garment of the published layout"):
        Archive.opened(archive, None)
    assert tracemalloc.get_traced_memory()[1] < 60_000_000
    tracemalloc.stop()


SIZE = 2_000_000


@pytest.fixture(autouse=True)
def close_points(monkeypatch: pytest.MonkeyPatch) -> None:
    """Seek points every 256 kB of content, so that small files have several."""
    monkeypatch.setattr("gcd_dataset.release.archive.EVERY", 1 << 18)


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
        assert point.window == content[point.start - WINDOW : point.start]


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
