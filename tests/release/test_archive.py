"""Archives as downloaded: each garment is found again, and what is kept of an archive is used while it holds."""

import gzip
import shutil
from pathlib import Path

import pytest

from gcd_dataset.errors import OutputError, ShardError
from gcd_dataset.release.archive import Archive
from gcd_dataset.release.layout import ENDINGS
from tests.release.published import BATCH, BODIES, TRAIN, file_of, pack, publish
from tests.shards.folders import forbidden, public_folder


@pytest.fixture(scope="module")
def folders(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return publish(tmp_path_factory.mktemp("folders"))


@pytest.fixture
def archive(folders: Path, tmp_path: Path) -> Path:
    """The archive of one batch."""
    return pack(Path(shutil.copytree(folders, tmp_path / "packed"))) / BATCH / BODIES[0] / "data.tar.gz"


def test_every_file_reads_as_it_was_packed(folders: Path, archive: Path) -> None:
    opened = Archive.opened(archive, None)
    for name in TRAIN:
        found = opened.read(name, list(ENDINGS))
        assert found == {kind: file_of(folders, name, kind).read_bytes() for kind in ENDINGS}


def test_an_archive_that_is_not_packed_is_read_too(folders: Path, tmp_path: Path) -> None:
    root = pack(Path(shutil.copytree(folders, tmp_path / "plain")), packed=False)
    opened = Archive.opened(root / BATCH / BODIES[0] / "data.tar", None)
    assert opened.read(TRAIN[1], ["sim"])["sim"] == file_of(folders, TRAIN[1], "sim").read_bytes()


def test_an_archive_is_read_through_once(archive: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    cache = tmp_path / "cache"
    Archive.opened(archive, cache)
    assert sorted(path.suffix for path in cache.iterdir()) == [".npz", ".windows"]
    assert [path.name for path in archive.parent.iterdir() if path.name.startswith(".")] == []
    monkeypatch.setattr("gcd_dataset.release.archive._scan", None)
    Archive.opened(archive, cache)


def test_what_is_kept_of_another_archive_is_not_used(archive: Path) -> None:
    before = Archive.opened(archive, None)
    content = gzip.decompress(archive.read_bytes())
    archive.write_bytes(gzip.compress(content, 1))
    after = Archive.opened(archive, None)
    assert after.read(TRAIN[0], ["spec"]) == before.read(TRAIN[0], ["spec"])
    next(archive.parent.glob(".*.npz")).write_bytes(b"broken")
    assert Archive.opened(archive, None).names == after.names


def test_a_damaged_archive_is_named_with_the_way_out(archive: Path) -> None:
    whole = archive.read_bytes()
    archive.write_bytes(whole[:-2000])
    with pytest.raises(ShardError, match=r"data\.tar\.gz: a damaged archive .*: extract or download it again"):
        Archive.opened(archive, None)
    changed = bytearray(gzip.decompress(whole))
    changed[changed.index(b"ustar")] = 0  # a header whose checksum is wrong, where tarfile would see the end
    archive.write_bytes(gzip.compress(bytes(changed)))
    with pytest.raises(ShardError, match=r"no tar header at byte"):
        Archive.opened(archive, None)
    archive.write_bytes(gzip.compress(bytes(10240)))
    with pytest.raises(ShardError, match="holds no garment of the published layout"):
        Archive.opened(archive, None)


def test_where_the_index_cannot_be_kept_another_place_is_asked_for(archive: Path) -> None:
    with public_folder() as folder:
        moved = Path(shutil.copy(archive, folder))
        with forbidden(folder, 0o555), pytest.raises(OutputError, match="or give another folder as cache_dir"):
            Archive.opened(moved, None)
