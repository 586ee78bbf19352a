"""Garments that are made once in each process."""

from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import Any

import pytest

from gcd_dataset.generator.pipeline import DressedDesign, prepare
from gcd_dataset.loaders.fake import FakeGarments
from gcd_dataset.records import Sample
from tests.loaders.rendered import COUNT, samples, write
from tests.release.published import publish_people
from tests.shards.folders import fill
from tests.shards.people import MESH, fake_person


@pytest.fixture(scope="package", autouse=True)
def _fake_garments_made_once() -> Iterator[None]:
    made = FakeGarments._members
    members = cache(lambda seed, most, position: made(FakeGarments(position + 1, seed, garments=most), position, ()))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(FakeGarments, "_members", lambda ds, position, names: members(ds._seed, ds._most, position))
        yield


@pytest.fixture(scope="session")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Ten fake garments, in shards of 4, 4 and 2."""
    return fill(tmp_path_factory.mktemp("data"), range(10))


@pytest.fixture
def designed(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """Records the numbers of the designs made in this process."""
    numbers = []

    def recorded(seed: int, number: int, *options: Any) -> DressedDesign:
        numbers.append(number)
        return prepare(seed, number, *options)

    monkeypatch.setattr("gcd_dataset.generator.maker.prepare", recorded)
    return numbers


@pytest.fixture
def few(tmp_path: Path) -> Path:
    """Two people of four vertices in the published layout."""
    return publish_people(tmp_path / "few", [fake_person(0), fake_person(1)], MESH)


@pytest.fixture(scope="session")
def worn() -> list[Sample]:
    """Garments with their views, on their wearers."""
    return samples(COUNT)


@pytest.fixture(scope="session")
def worn_folder(worn: list[Sample], tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write(tmp_path_factory.mktemp("worn"), worn)
