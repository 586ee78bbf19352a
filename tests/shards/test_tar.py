"""Our archives, read by other programs and by this package."""

import io
import json
import os
import subprocess
import sys
import tarfile
from dataclasses import replace
from pathlib import Path
from typing import Any

import datasets
import numpy as np
import pytest
import webdataset as wds

from gcd_dataset.errors import ShardError
from gcd_dataset.loaders import GarmentDataset
from gcd_dataset.loaders.fake import fake_sample
from gcd_dataset.records import Grade, NamedFabric, Sample
from gcd_dataset.shards import MEMBERS, ShardIndex, ShardReader, ShardWriter, encode_sample
from gcd_dataset.shards.index import scan_shard
from gcd_dataset.shards.layout import key_of
from gcd_dataset.shards.tar import BLOCK, END, stream_samples, tar_entries, tar_entry
from gcd_dataset.spec import spec_from_pattern
from gcd_dataset.tensors import encode_pattern
from tests.shards.folders import fill
from tests.shards.real import first_schema, patterns


@pytest.fixture
def shard(tmp_path: Path) -> Path:
    return fill(tmp_path, range(3)) / "train-00000.tar"


def test_tarfile_reads_a_shard(shard: Path) -> None:
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
def test_webdataset_reads_and_decodes_a_shard(shard: Path) -> None:
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


def test_webdataset_reads_a_shard_in_secure_mode(shard: Path) -> None:
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
def test_entries_of_any_size_are_read_back(tmp_path: Path, size: int) -> None:
    archive = tar_entry("first", b"x" * size) + tar_entry("second", b"yy") + bytes(END)
    (tmp_path / "a.tar").write_bytes(archive)
    with (tmp_path / "a.tar").open("rb") as file:
        entries = list(tar_entries(file.fileno()))
        assert [(entry.name, entry.size) for entry in entries] == [("first", size), ("second", 2)]
        assert archive[entries[1].offset :][:2] == b"yy"
    with tarfile.open(fileobj=io.BytesIO(archive)) as read:
        assert [member.size for member in read] == [size, 2]


def test_damage_is_reported_with_its_offset(tmp_path: Path) -> None:
    archive = bytearray(tar_entry("first", b"x") + tar_entry("second", b"yy"))
    archive[BLOCK * 2 + 3] ^= 1
    (tmp_path / "a.tar").write_bytes(archive)
    with (tmp_path / "a.tar").open("rb") as file, pytest.raises(ShardError, match="no tar header at byte 1024"):
        list(tar_entries(file.fileno()))
    (tmp_path / "b.tar").write_bytes(tar_entry("first", b"x" * 2000)[:1500])
    with (tmp_path / "b.tar").open("rb") as file, pytest.raises(ShardError, match="first is cut off at byte 1500"):
        list(tar_entries(file.fileno()))


def test_names_too_long_for_a_header_are_refused() -> None:
    with pytest.raises(ShardError, match="do not fit into a tar header"):
        tar_entry("x" * 101, b"")


def barest_first() -> list[Sample]:
    """Real garments: the first five with as many missing values as possible, the others with all values."""
    bare = sorted(patterns(16), key=lambda sample: len(sample.pattern.panels))
    rich = [
        replace(
            sample,
            provenance=replace(
                sample.provenance,
                attempts=3,
                rejects=("self_crossing: sleeve", "drape: not_settled"),
                redraws={"too_long": 2, "narrow": 1},
                recipe={**sample.provenance.recipe, "design": {"meta": {"bottom": ["Pants", None, 1.5]}}},
                source="GarmentCodeData_v2/garments_5000_0/default_body/rand_0",
            ),
            measurements=replace(sample.measurements, bust=np.nan),
            grade=Grade.CLEAN,
            fabric=NamedFabric("denim", {"density": 0.4, "tensile": [90.0, 80.0, 30.0]}),
            gathers=tuple(1.5 for _ in sample.pattern.seams),
            tags=("dress", "long"),
        )
        for sample in bare[8:]
    ]
    return [replace(sample, gathers=(), tags=()) for sample in bare[:5]] + rich


def loaded(shard: Path, cache: Path, streaming: bool) -> list[Any]:
    options = {"data_files": {"train": str(shard)}, "split": "train", "cache_dir": str(cache)}
    return list(datasets.load_dataset("webdataset", streaming=streaming, **options))


@pytest.mark.parametrize("streaming", [False, True])
def test_datasets_reads_real_garments_of_every_kind(tmp_path: Path, streaming: bool) -> None:
    """``datasets`` infers types from the first five samples."""
    samples = barest_first()
    entries = [
        tar_entry(f"{sample.key}.{member}", data)
        for sample in samples
        for member, data in encode_sample(sample).items()
    ]
    (tmp_path / "train-00000.tar").write_bytes(b"".join([*entries, bytes(END)]))
    rows = loaded(tmp_path / "train-00000.tar", tmp_path / "cache", streaming)
    assert [row["__key__"] for row in rows] == [sample.key for sample in samples]
    for row, sample in zip(rows, samples, strict=True):
        assert isinstance(row["spec.txt"], str)
        assert json.loads(row["spec.txt"]) == json.loads(json.dumps(spec_from_pattern(sample.pattern)))
        assert json.loads(row["design.txt"]) == dict(sample.design)
        assert row["meta.json"]["index"] == sample.provenance.index
        assert json.loads(row["meta.json"]["recipe"]) == dict(sample.provenance.recipe)
        assert row["meta.json"]["rejects"] == (list(sample.provenance.rejects) or [""])
        assert row["measures.json"]["waist"] == sample.measurements.to_file_values()["waist"]
        assert np.array_equal(np.asarray(row["panels.npy"]), encode_pattern(sample.pattern).panels)
    assert rows[-1]["meta.json"]["grade"] == "clean"
    assert rows[-1]["meta.json"]["redraws"] == [{"rule": "too_long", "count": 2}, {"rule": "narrow", "count": 1}]
    assert (rows[-1]["measures.json"]["bust"], rows[0]["meta.json"]["tags"]) == (-1.0, [""])


@pytest.mark.parametrize("streaming", [False, True])
def test_datasets_reads_texts_of_patterns_followed_by_drapes(tmp_path: Path, streaming: bool) -> None:
    """Texts and JSON have one type at every stage; ``datasets`` infers none for arrays without rows."""
    drape = ShardReader(first_schema(tmp_path) / "drapes").sample(0)
    members = [encode_sample(sample) for sample in (*patterns(16)[:6], drape)]
    entries = [
        tar_entry(f"gcd_{number:09d}.{member}", data)
        for number, sample in enumerate(members)
        for member, data in sample.items()
        if member.endswith((".json", ".txt"))
    ]
    (tmp_path / "a.tar").write_bytes(b"".join([*entries, bytes(END)]))
    rows = loaded(tmp_path / "a.tar", tmp_path / "cache", streaming)
    assert [row["meta.json"]["drape"]["outcome"] for row in rows] == 6 * [""] + ["SETTLED"]
    assert [row["meta.json"]["holds"]["mesh"] for row in rows] == 6 * [False] + [True]
    assert rows[-1]["meta.json"]["vertex_labels"] == list(drape.box_mesh.labels) if drape.box_mesh else False


@pytest.mark.parametrize("streaming", [False, True])
def test_datasets_reads_drapes(tmp_path: Path, streaming: bool) -> None:
    drape = ShardReader(first_schema(tmp_path) / "drapes").sample(0)
    with ShardWriter(tmp_path / "new", seed=0, recipe={}) as writer:
        for index in range(6):
            writer.write(replace(drape, key=key_of(index), provenance=replace(drape.provenance, index=index)))
    rows = loaded(tmp_path / "new" / "train-00000.tar", tmp_path / "cache", streaming)
    assert drape.drape is not None
    assert np.array_equal(np.asarray(rows[5]["verts.npy"]), drape.drape.vertices)
    frame, points = rows[5]["meta.json"]["points"], np.asarray(rows[5]["points.npy"])
    there = points[:, :3] * frame["scale"] + frame["centre"]
    assert drape.points is not None
    assert np.abs(there - drape.points[:, :3]).max() < 0.005


def test_a_duplicate_member_is_refused(tmp_path: Path) -> None:
    folder = fill(tmp_path, range(2))
    content = bytearray((folder / "train-00000.tar").read_bytes())
    size = int(content[124:135], 8)
    second = BLOCK + -(-size // BLOCK) * BLOCK
    header = content[second : second + BLOCK]
    header[:100] = content[:100]
    header[148:156] = 8 * b" "
    header[148:156] = b"%06o\0 " % sum(header)
    content[second : second + BLOCK] = header
    (folder / "train-00000.tar").write_bytes(content)
    with pytest.raises(ShardError, match=r"train-00000\.tar: .*gcd_000000000\.meta\.json occurs twice"):
        list(GarmentDataset(folder, streaming=True))


def test_a_duplicate_sample_is_refused(tmp_path: Path) -> None:
    folder = fill(tmp_path, range(2))
    content = (folder / "train-00000.tar").read_bytes()
    first = content[: int(scan_shard(folder / "train-00000.tar").offset[1, 0]) - BLOCK]
    (folder / "train-00000.tar").write_bytes(first + content)
    index = ShardIndex.of(folder, {"train-00000.tar": scan_shard(folder / "train-00000.tar")[[0, 2]]})
    index.write(folder / "index-train.npz")
    with pytest.raises(ShardError, match="occurs twice"):
        list(GarmentDataset(folder, streaming=True))


def test_a_zeroed_header_is_not_taken_for_the_end(tmp_path: Path) -> None:
    """Without index and manifest, nothing else shows that samples are missing."""
    shard = fill(tmp_path, range(2)) / "train-00000.tar"
    content, second = bytearray(shard.read_bytes()), int(scan_shard(shard).offset[1, 0]) - BLOCK
    content[second : second + BLOCK] = bytes(BLOCK)
    shard.write_bytes(content)
    with pytest.raises(ShardError, match=f"zeros at byte {second}, but content after them"):
        scan_shard(shard)
    shard.write_bytes(content[:second] + bytes(10240))  # zero padding, as other programs write it
    assert len(scan_shard(shard)) == 1


def test_an_archive_with_zeroed_samples_contradicts_the_manifest(tmp_path: Path) -> None:
    shard = fill(tmp_path, range(2)) / "train-00000.tar"
    second = int(scan_shard(shard).offset[1, 0]) - BLOCK
    shard.write_bytes(shard.read_bytes()[:second].ljust(shard.stat().st_size, b"\0"))
    (tmp_path / "index-train.npz").unlink()
    with pytest.raises(ShardError, match=r"train-00000\.tar: 1 samples of the 2 that manifest\.json lists"):
        GarmentDataset(tmp_path)


@pytest.mark.parametrize("field", [b"-0000000777", b"0000000-777", b"00000000_77", b"           ", b"7777777777x"])
def test_a_size_that_is_no_number_is_reported(tmp_path: Path, field: bytes) -> None:
    header = bytearray(tar_entry("first", b"x"))
    header[124:135] = field
    header[148:156] = 8 * b" "
    header[148:156] = b"%06o\0 " % sum(header[:BLOCK])
    (tmp_path / "a.tar").write_bytes(header)
    with (tmp_path / "a.tar").open("rb") as file, pytest.raises(ShardError, match="another program at byte 0"):
        list(tar_entries(file.fileno()))
    with pytest.raises(ShardError, match="tar header of another program at byte 0"):
        list(stream_samples(io.BytesIO(header), ()))


def test_a_member_of_gigabytes_is_refused_before_it_is_read() -> None:
    header = bytearray(tar_entry("gcd_000000000.meta.json", b""))
    header[124:135] = b"%011o" % (8**11 - 1)
    header[148:156] = 8 * b" "
    header[148:156] = b"%06o\0 " % sum(header[:BLOCK])
    with pytest.raises(ShardError, match=r"meta\.json has 8589934591 bytes, over the limit of 536870912"):
        list(stream_samples(io.BytesIO(header), ("meta.json",)))
