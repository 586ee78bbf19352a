"""Downloaded archives: every garment is read, and the cache is used until the archive changes."""

import gzip
import shutil
import tracemalloc
from pathlib import Path

import pytest

from gcd_dataset.errors import OutputError, ShardError
from gcd_dataset.release.archive import KINDS, Archive
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
    archive.write_bytes(whole[:-2000])
    with pytest.raises(ShardError, match=r"data\.tar\.gz: a damaged archive .*: extract or download it again"):
        Archive.opened(archive, None)
    flipped = bytearray(whole)
    flipped[len(whole) // 2] ^= 1
    archive.write_bytes(flipped)
    with pytest.raises(ShardError, match=r"data\.tar\.gz: a damaged archive"):
        Archive.opened(archive, None)
    archive.write_bytes(gzip.compress(bytes(10240)))
    with pytest.raises(ShardError, match="holds no garment of the published layout"):
        Archive.opened(archive, None)


def test_an_unwritable_index_suggests_cache_dir(archive: Path) -> None:
    with public_folder() as folder:
        moved = Path(shutil.copy(archive, folder))
        with forbidden(folder, 0o555), pytest.raises(OutputError, match="or give another folder as cache_dir"):
            Archive.opened(moved, None)


@pytest.mark.parametrize("content", [gzip.compress(bytes(100_000_000)), gzip.compress(b"") * 20_000])
def test_an_empty_archive_takes_little_memory(archive: Path, content: bytes) -> None:
    archive.write_bytes(content)
    tracemalloc.start()
    with pytest.raises(ShardError, match=r"holds no garment of the published layout|empty file"):
        Archive.opened(archive, None)
    assert tracemalloc.get_traced_memory()[1] < 60_000_000
    tracemalloc.stop()
