"""Our archives, read by other programs and by this package."""

import io
import json
import tarfile
from dataclasses import replace
from pathlib import Path
from typing import Any

import datasets
import numpy as np
import pytest

from gcd_dataset.errors import ShardError
from gcd_dataset.loaders.fake import fake_sample
from gcd_dataset.records import Grade, NamedFabric, Sample
from gcd_dataset.shards import MEMBERS, encode_sample
from gcd_dataset.shards.layout import is_picture
from gcd_dataset.shards.sections import unpack
from gcd_dataset.shards.tar import BLOCK, END, samples_in, tar_entries, tar_entry
from gcd_dataset.spec import spec_from_pattern
from gcd_dataset.tensors import encode_pattern
from tests.shards.folders import fill
from tests.shards.real import patterns

MAIN = [member for member in MEMBERS if not is_picture(member)]


@pytest.fixture
def shard(tmp_path: Path) -> Path:
    return fill(tmp_path, range(3)) / "train-00000.tar"


def test_tarfile_reads_a_shard(shard: Path) -> None:
    with tarfile.open(shard) as archive:
        members = archive.getmembers()
        assert [m.name for m in members] == [f"gcd_{i:09d}.{member}" for i in range(3) for member in MAIN]
        assert {(m.mtime, m.uid, m.gid, m.mode, m.uname, m.type) for m in members} == {(0, 0, 0, 0o644, "", b"0")}
        assert all(m.offset_data % BLOCK == 0 for m in members)
        file = archive.extractfile("gcd_000000001.verts.z")
        assert file is not None
        assert file.read() == encode_sample(fake_sample(0, 1))["verts.z"]


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
                turned_down=(),
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
        rejects = [f"{entry['rule']}: {entry['reason']}" for entry in row["meta.json"]["rejects"] if entry["rule"]]
        assert rejects == list(sample.provenance.rejects)
        assert row["measures.json"]["waist"] == sample.measurements.to_file_values()["waist"]
        assert np.array_equal(unpack(row["pattern.z"])["panels"], encode_pattern(sample.pattern).panels)
    assert rows[-1]["meta.json"]["grade"] == "clean"
    assert rows[-1]["meta.json"]["redraws"] == [{"rule": "too_long", "count": 2}, {"rule": "narrow", "count": 1}]
    assert (rows[-1]["measures.json"]["bust"], rows[0]["meta.json"]["tags"]) == (-1.0, [""])


def test_samples_of_an_archive_in_memory_are_found(shard: Path) -> None:
    content = memoryview(shard.read_bytes())
    samples = dict(samples_in(content))
    assert list(samples) == [f"gcd_{index:09d}" for index in range(3)]
    assert bytes(samples["gcd_000000002"]["verts.z"]) == encode_sample(fake_sample(0, 2))["verts.z"]
    again = memoryview(b"".join([tar_entry("a.x", b"1"), tar_entry("b.x", b"2"), tar_entry("a.y", b"3")]))
    for damaged, message in ((content[:3000], "is cut off"), (again, "occurs twice")):
        with pytest.raises(ShardError, match=message):
            list(samples_in(damaged))
