"""Downloaded archives: every garment is read, and the cache is used until the archive changes."""

import gzip
import shutil
import tracemalloc
from pathlib import Path

import pytest

from gcd_dataset.errors import OutputError, ShardError
from gcd_dataset.release.archive import KINDS, Archive
from tests.release.published import BATCH, BODIES, TRAIN, file_of, pack
from tests.shards.folders import forbidden, public_folder


@pytest.fixture
def archive(own: Path) -> Path:
    """The archive of one batch."""
    return pack(own) / BATCH / BODIES[0] / "data.tar.gz"


def test_every_file_reads_as_packed(folders: Path, archive: Path) -> None:
    opened = Archive.opened(archive, None)
    for name in TRAIN:
        assert opened.read(name, KINDS) == {kind: file_of(folders, name, kind).read_bytes() for kind in KINDS}


def test_an_archive_is_unpacked_once(archive: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    cache = tmp_path / "cache"
    Archive.opened(archive, cache)
    assert sorted(path.suffix for path in cache.iterdir()) == [".files", ".npz"]
    assert [path.name for path in archive.parent.iterdir() if path.name.startswith(".")] == []
    monkeypatch.setattr("gcd_dataset.release.archive._unpack", None)
    Archive.opened(archive, cache)


def test_the_cache_of_another_archive_is_not_used(archive: Path) -> None:
    before = Archive.opened(archive, None)
    content = gzip.decompress(archive.read_bytes())
    third = len(content) // 3
    streams = (content[:third], content[third:])  # several, as parallel packers write them
    archive.write_bytes(b"".join(gzip.compress(part, 1) for part in streams))
    after = Archive.opened(archive, None)
    assert after.read(TRAIN[0], ["spec"]) == before.read(TRAIN[0], ["spec"])
    next(archive.parent.glob(".*.npz")).write_bytes(b"broken")
    assert Archive.opened(archive, None).names == after.names


def test_a_damaged_archive_is_named_with_a_remedy(archive: Path) -> None:
    whole = archive.read_bytes()
    half = len(whole) // 2
    damaged = r"data\.tar\.gz: a damaged archive .*: extract or download it again"
    # A header with a wrong checksum; tarfile would take it for the end.
    header = gzip.compress(gzip.decompress(whole).replace(b"ustar", b"\0star", 1))
    for content, message in (
        (whole[:-2000], damaged),
        (whole[:half] + bytes([whole[half] ^ 1]) + whole[half + 1 :], damaged),
        (header, r"no tar header at byte"),
        (gzip.compress(bytes(10240)), "holds no garment of the published layout"),
    ):
        archive.write_bytes(content)
        with pytest.raises(ShardError, match=message):
            Archive.opened(archive, None)


def test_an_unwritable_index_suggests_cache_dir(archive: Path) -> None:
    with public_folder() as folder:
        moved = Path(shutil.copy(archive, folder))
        with forbidden(folder, 0o555), pytest.raises(OutputError, match="or give another folder as cache_dir"):
            Archive.opened(moved, None)


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
    for member in (0, 3, 4, 5):
        with_size(archive, b"\x80" + (1 << 40).to_bytes(11, "big"), member)
        with pytest.raises(ShardError, match=r"tar\.gz: a damaged archive \((ends in|.* bytes, over the limit of)"):
            Archive.opened(archive, None)


@pytest.mark.parametrize("content", [gzip.compress(bytes(100_000_000)), gzip.compress(b"") * 20_000])
def test_a_decompression_bomb_takes_little_memory_and_time(archive: Path, content: bytes) -> None:
    archive.write_bytes(content)
    tracemalloc.start()
    with pytest.raises(ShardError, match="holds no garment of the published layout"):
        Archive.opened(archive, None)
    assert tracemalloc.get_traced_memory()[1] < 60_000_000
    tracemalloc.stop()
