"""The loaders benchmark: all loaders yield the same garments."""

from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import pytest
import torch

from benchmarks.cases.loaders import _opening, _ratios
from benchmarks.loading.loaders import LOADERS
from benchmarks.loading.timing import cpu_ms_of
from benchmarks.loading.workload import CONFIGS, large_sample, write_shards

COUNT = 32


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_shards(tmp_path_factory.mktemp("data"), COUNT)


def test_garments_have_the_size_of_a_dress() -> None:
    garments = [large_sample(index) for index in range(12)]
    counts = [len(garment.box_mesh.vertices) for garment in garments if garment.box_mesh is not None]
    assert 12_000 < sum(counts) / len(counts) < 17_000
    assert {len(garment.pattern.panels) for garment in garments} == {11}
    assert {len(garment.pattern.seams) for garment in garments} == {28}


@pytest.mark.filterwarnings("ignore::ResourceWarning", "ignore::pytest.PytestUnraisableExceptionWarning")
@pytest.mark.parametrize("config", CONFIGS)
def test_all_loaders_yield_the_same_batches(folder: Path, config: str) -> None:
    """``webdataset`` leaves files open, hence the filters; it reads in order, as the indices here are."""
    fields, indices = CONFIGS[config], range(16)
    expected = LOADERS["memmap"](folder, fields)(indices)  # type: ignore[misc]
    seen = 0
    for name, load in LOADERS.items():
        if name == "GarmentLoader" or (batches := load(folder, fields)) is None:
            continue
        batch, seen = batches(indices), seen + 1
        for field in fields:
            rows = batch[field].reshape(expected[field].shape)  # points are stacked, or one after the other
            assert torch.equal(rows, expected[field]), (name, field)
            if field != "points":
                assert torch.equal(batch[f"{field}_ptr"], expected[f"{field}_ptr"]), (name, field)
    assert seen >= 6


def test_a_figure_is_the_median_over_pairs_of_epochs() -> None:
    slow = [2.0, 2.0, 9.0]
    spent = {"geometry": {"ours": slow, "memmap": [1.0, 1.0, 1.0], "memmap as ndarray": [0.5, 1.0, 4.5], "arrow": slow}}
    figures = {figure.metric: figure.value for figure in _ratios(spent)}
    assert figures["geometry_over_memmap"] == 2.0
    assert figures["geometry_arrow"] == 1.0
    counted: dict[str, list[int]] = {"a": [], "b": []}

    def counting(name: str) -> Callable[[Sequence[int]], None]:
        return lambda indices: counted[name].append(len(indices))

    times = cpu_ms_of({name: counting(name) for name in counted}, 5, 2, seconds=0)
    assert {name: sum(sizes) for name, sizes in counted.items()} == {"a": 10, "b": 10}  # one epoch before the clock
    assert np.min(times["a"]) >= 0


def test_a_large_index_is_opened_and_filtered(tmp_path: Path) -> None:
    figures = {figure.metric: figure.value for figure in _opening(tmp_path / "large", 3000)}
    assert 0 < figures["index_bytes"] < 8
