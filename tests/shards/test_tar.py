"""Our archives, read by others and by ourselves."""

import io
import json
import os
import subprocess
import sys
import tarfile
from pathlib import Path

import datasets
import numpy as np
import pytest
import webdataset as wds

from gcd_dataset.errors import ShardError
from gcd_dataset.loaders.fake import fake_sample
from gcd_dataset.shards import MEMBERS, encode_sample
from gcd_dataset.shards.tar import BLOCK, END, tar_entries, tar_entry
from tests.shards.folders import fill


@pytest.fixture
def shard(tmp_path: Path) -> Path:
    return fill(tmp_path, range(3)) / "train-00000.tar"


def test_python_reads_it(shard: Path) -> None:
    with tarfile.open(shard) as archive:
        members = archive.getmembers()
        assert [m.name for m in members] == [f"gcd_{i:09d}.{member}" for i in range(3) for member in MEMBERS]
        assert {(m.mtime, m.uid, m.gid, m.mode, m.uname, m.type) for m in members} == {(0, 0, 0, 0o644, "", b"0")}
        assert all(m.offset_data % BLOCK == 0 for m in members)
        file = archive.extractfile("gcd_000000001.verts.npy")
        assert file is not None
        assert file.read() == encode_sample(fake_sample(0, 1))["verts.npy"]


# webdataset 1.0.2 leaves the files that it opens to the garbage collector.
@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning", "ignore:unclosed file:ResourceWarning")
def test_webdataset_reads_and_decodes_it(shard: Path) -> None:
    samples = list(wds.WebDataset(str(shard), shardshuffle=False).decode("pil"))
    assert [sample["__key__"] for sample in samples] == [f"gcd_{i:09d}" for i in range(3)]
    for index, sample in enumerate(samples):
        assert set(MEMBERS) <= set(sample)
        drape = fake_sample(0, index).drape
        assert drape is not None
        assert np.array_equal(sample["verts.npy"], drape.vertices.astype(np.float32))
        assert sample["meta.json"]["index"] == index
        assert sample["front.jpg"].size == (16, 16)


SECURE = """
import json, sys
import webdataset as wds
from webdataset.tariterators import group_by_keys, tar_file_expander
assert wds.utils.enforce_security
decode = wds.autodecode.Decoder([wds.autodecode.imagehandler("pil")])
with open(sys.argv[1], "rb") as stream:
    samples = group_by_keys(tar_file_expander([{"url": sys.argv[1], "stream": stream}]))
    print(json.dumps([list(sample["verts.npy"].shape) for sample in map(decode, samples)]))
"""


def test_webdataset_reads_it_with_its_security_on(shard: Path) -> None:
    run = subprocess.run(
        [sys.executable, "-c", SECURE, str(shard)],
        env={**os.environ, "WDS_SECURE": "1"},
        capture_output=True,
        text=True,
        check=True,
    )
    drapes = [fake_sample(0, index).drape for index in range(3)]
    assert json.loads(run.stdout) == [[len(drape.vertices), 3] for drape in drapes if drape is not None]


@pytest.mark.parametrize("size", [0, 1, BLOCK - 1, BLOCK, BLOCK + 1, 100_000])
def test_entries_of_any_size_come_back(tmp_path: Path, size: int) -> None:
    archive = tar_entry("first", b"x" * size) + tar_entry("second", b"yy") + bytes(END)
    (tmp_path / "a.tar").write_bytes(archive)
    with (tmp_path / "a.tar").open("rb") as file:
        entries = list(tar_entries(file.fileno()))
        assert [(entry.name, entry.size) for entry in entries] == [("first", size), ("second", 2)]
        assert archive[entries[1].offset :][:2] == b"yy"
    with tarfile.open(fileobj=io.BytesIO(archive)) as read:
        assert [member.size for member in read] == [size, 2]


def test_damage_is_told_with_the_byte(tmp_path: Path) -> None:
    archive = bytearray(tar_entry("first", b"x") + tar_entry("second", b"yy"))
    archive[BLOCK * 2 + 3] ^= 1
    (tmp_path / "a.tar").write_bytes(archive)
    with (tmp_path / "a.tar").open("rb") as file, pytest.raises(ShardError, match="no tar header at byte 1024"):
        list(tar_entries(file.fileno()))
    (tmp_path / "b.tar").write_bytes(tar_entry("first", b"x" * 2000)[:1500])
    with (tmp_path / "b.tar").open("rb") as file, pytest.raises(ShardError, match="first is cut off at byte 1500"):
        list(tar_entries(file.fileno()))


def test_names_that_no_header_holds_are_refused() -> None:
    with pytest.raises(ShardError, match="do not fit into a tar header"):
        tar_entry("x" * 101, b"")


def test_datasets_reads_it(shard: Path, tmp_path: Path) -> None:
    options = {"data_files": {"train": str(shard)}, "split": "train"}
    for streaming in (False, True):
        samples = list(
            datasets.load_dataset("webdataset", streaming=streaming, cache_dir=str(tmp_path / "cache"), **options)
        )
        assert [sample["__key__"] for sample in samples] == [f"gcd_{i:09d}" for i in range(3)]
        assert np.asarray(samples[1]["verts.npy"]).shape == fake_sample(0, 1).drape.vertices.shape  # type: ignore[union-attr]
        assert samples[2]["meta.json"]["index"] == 2
