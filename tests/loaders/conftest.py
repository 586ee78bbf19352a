"""Fake garments are made once in each process."""

from collections.abc import Iterator
from functools import cache

import pytest

from gcd_dataset.loaders.fake import FakeGarments, fake_sample
from gcd_dataset.shards.codec import encode_sample


@pytest.fixture(scope="package", autouse=True)
def _fake_garments_made_once() -> Iterator[None]:
    members = cache(lambda seed, position: encode_sample(fake_sample(seed, position)))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(FakeGarments, "_members", lambda ds, position, names: members(ds._seed, position))
        yield
