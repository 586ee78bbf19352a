"""Garments for the tests of the reconstruction benchmark."""

from collections.abc import Iterator
from typing import Any

import pytest
import torch

from benchmarks.reconstruction.garments import GarmentSet, generated
from benchmarks.reconstruction.tasks import NAMED, SURFACES

SKIRTS: dict[str, Any] = {"meta": {"upper": "none", "bottom": {"options": ["SkirtCircle", "Skirt2"]}}}


@pytest.fixture(scope="session")
def six() -> GarmentSet:
    """Six skirts with coarse box meshes."""
    extra = (*NAMED, "box_labels")
    return generated(6, 0, points=512, extra=extra, drape=None, resolution=5.0, design=SKIRTS)


@pytest.fixture(scope="session")
def draped() -> GarmentSet:
    """Two skirts, draped, with all arrays of the tasks T4 to T6."""
    return generated(3, 0, points=64, extra=SURFACES, resolution=6.0, design=SKIRTS).select([0, 1])


@pytest.fixture(autouse=True)
def one_thread() -> Iterator[None]:
    """Tiny networks are fastest on one thread."""
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(threads)
