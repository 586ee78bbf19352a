"""A published data set, read by the library of the Hub, and its Croissant description by that of MLCommons."""

import hashlib
import json
import logging
import tarfile
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType
from typing import Any

import datasets
import pytest

from gcd_dataset.hub.publish import Staged, stage
from tests.hub.test_publish import SHARES, put, sample

MISSING = {"citeAs", "datePublished"}
"""Recommended properties that an unpublished data set lacks."""
pytestmark = [
    pytest.mark.filterwarnings("ignore::DeprecationWarning"),  # in the dependencies of mlcroissant
    pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning"),  # mlcroissant leaves files open
]


@pytest.fixture(scope="module")
def mlc(tmp_path_factory: pytest.TempPathFactory) -> Iterator[ModuleType]:
    """The module ``mlcroissant``; on import it reads its cache folder from ``CROISSANT_CACHE``."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("CROISSANT_CACHE", str(tmp_path_factory.mktemp("cache")))
        yield pytest.importorskip("mlcroissant", reason="mlcroissant is not installed: make test-extras")


@pytest.fixture(scope="module")
def staged(tmp_path_factory: pytest.TempPathFactory) -> Staged:
    folder = tmp_path_factory.mktemp("published")
    made = put(folder / "made", (sample(i, design=i) for i in range(40)))
    return stage(made, "org/new-set", folder / "up", shares=SHARES, license="cc-by-4.0", endpoint="https://hub.example")


def test_the_library_of_the_hub_loads_every_configuration(staged: Staged, tmp_path: Path) -> None:
    for name, member in (("default", "verts.z"), ("views", "front.jpg")):
        splits: Any = datasets.load_dataset(str(staged.folder), name, streaming=True, cache_dir=str(tmp_path))
        assert [split for split, samples in splits.items() if member in next(iter(samples))] == list(SHARES)


def test_croissant_lists_the_hash_of_every_file(staged: Staged) -> None:
    entry = json.loads((staged.folder / "croissant.json").read_text())
    assert entry["conformsTo"] == "http://mlcommons.org/croissant/1.0"
    objects = {thing["@id"]: thing for thing in entry["distribution"]}
    files = {name: thing for name, thing in objects.items() if thing["@type"] == "cr:FileObject"}
    assert files.keys() == staged.files.keys() - {"README.md", "croissant.json"}
    for name, thing in files.items():
        assert thing["sha256"] == hashlib.sha256((staged.folder / name).read_bytes()).hexdigest()
        assert thing["contentUrl"] == f"https://hub.example/datasets/org/new-set/resolve/main/{name}"
    for thing in objects.values():
        assert all(inside["@id"] in files for inside in thing.get("containedIn", ()))
    sources = [field["source"]["fileSet"]["@id"] for records in entry["recordSet"] for field in records["field"]]
    assert all(objects[source]["@type"] == "cr:FileSet" for source in sources)


def test_the_description_is_valid_croissant(mlc: ModuleType, staged: Staged, caplog: pytest.LogCaptureFixture) -> None:
    with caplog.at_level(logging.WARNING):
        described = mlc.Dataset(jsonld=staged.folder / "croissant.json").metadata
    assert {described.name, *described.license} == {"new-set", "cc-by-4.0"}
    assert not described.ctx.issues.errors
    assert {issue.split('"')[1].rpartition("/")[2] for issue in described.ctx.issues.warnings} <= MISSING
    assert "not standard" not in caplog.text


def test_records_equal_the_files_of_the_shards(mlc: ModuleType, staged: Staged) -> None:
    names = [record.name("train") for record in staged.manifest.splits["train"].shards]
    shards = {name: staged.folder / name for name in names}
    records = mlc.Dataset(jsonld=staged.folder / "croissant.json", mapping=shards).records("train")
    found = {record["train/file"].decode(): record["train/content"] for record in records}
    assert found == {name: content for path in shards.values() for name, content in files_of(path).items()}


def files_of(shard: Path) -> dict[str, bytes]:
    with tarfile.open(shard) as tar:
        return {member.name: content.read() for member in tar if (content := tar.extractfile(member)) is not None}
