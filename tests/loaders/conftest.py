"""Garments that are made once in each process."""

from collections.abc import Iterator
from functools import cache
from pathlib import Path

import pytest

from gcd_dataset.loaders.fake import FakeGarments
from gcd_dataset.records import Sample
from tests.loaders.rendered import COUNT, samples, write


@pytest.fixture(scope="package", autouse=True)
def _fake_garments_made_once() -> Iterator[None]:
    made = FakeGarments._members
    members = cache(lambda seed, most, position: made(FakeGarments(position + 1, seed, garments=most), position, ()))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(FakeGarments, "_members", lambda ds, position, names: members(ds._seed, ds._most, position))
        yield


@pytest.fixture(scope="session")
def worn() -> list[Sample]:
    """Garments with their views, on their wearers."""
    return samples(COUNT)


@pytest.fixture(scope="session")
def worn_folder(worn: list[Sample], tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write(tmp_path_factory.mktemp("worn"), worn)
