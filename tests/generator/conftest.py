"""Bodies that the tests of several folders share."""

from pathlib import Path

import pytest

from gcd_dataset.generator.body import read_body
from gcd_dataset.records import Body, Measurements


@pytest.fixture(scope="session")
def published(examples: Path) -> tuple[Body, Measurements]:
    """The published mean body of all people, with its measures and segmentation."""
    folder = examples / "bodies"
    return read_body(folder / "mean_all.obj", folder / "mean_all.yaml", folder / "ggg_body_segmentation.json")
