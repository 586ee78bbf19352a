"""The Croissant description of a published data set, read by MLCommons' own library."""

import logging
import tarfile
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType

import pytest

from gcd_dataset.hub.publish import Staged, stage
from tests.hub.test_publish import put, sample

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
    made = put(folder / "made", (sample(i, design=i) for i in range(12)))
    return stage(made, "org/new-set", folder / "up", license="cc-by-4.0", endpoint="https://hub.example")


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
