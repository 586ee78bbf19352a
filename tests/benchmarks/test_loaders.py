"""The loaders benchmark: all loaders yield the same garments."""

import os
from pathlib import Path
from typing import Any

import pytest
import torch

from benchmarks.cases.loaders import _figures, _rows
from benchmarks.loading.loaders import LOADERS
from benchmarks.loading.timing import Cost, cost_of
from benchmarks.loading.workload import CONFIGS, large_sample, write_shards
from gcd_dataset.shards import FIELDS, encode_sample

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
def test_all_loaders_yield_the_same_garments(folder: Path, config: str) -> None:
    """``webdataset`` leaves files open, hence the filters."""
    seen = {}
    for loader in ("ours", "webdataset", "hdf5", "litdata"):
        batches = LOADERS[loader](folder, CONFIGS[config], 0)
        if batches is None:
            continue
        field = "verts" if config == "geometry" else "panels"
        rows = torch.cat([batch[field] for batch in batches])
        seen[loader] = rows.sort(dim=0)[0]
    assert len(seen) >= 2
    assert all(torch.equal(rows, seen["ours"]) for rows in seen.values())


def test_the_floor_reads_every_byte(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    read, preadv = [], os.preadv

    def counted(*arguments: Any) -> int:
        read.append(preadv(*arguments))
        return read[-1]

    monkeypatch.setattr(os, "preadv", counted)
    batches = LOADERS["floor"](folder, CONFIGS["geometry"], 0)
    assert batches is not None
    assert len(list(batches)) == COUNT // 16
    names = [FIELDS[field] for field in CONFIGS["geometry"]]
    assert sum(read) == sum(len(encode_sample(large_sample(index))[name]) for index in range(COUNT) for name in names)
    assert LOADERS["floor"](folder, CONFIGS["geometry"], 2) is None


def test_the_cost_is_that_of_the_cheapest_epoch() -> None:
    epochs = []

    class Batches:
        def __iter__(self):  # type: ignore[no-untyped-def]
            epochs.append(1)
            return iter(range(3))

    cost = cost_of(Batches(), 3, seconds=0.01)
    assert len(epochs) > 2
    assert cost.cpu_ms >= 0
    assert cost.wall_ms > 0


def test_missing_loaders_are_left_out() -> None:
    costs = {("ours", "geometry", 0): Cost(0.4, 0.5), ("floor", "geometry", 0): Cost(0.1, 0.1)}
    costs |= {("webdataset", "geometry", 0): Cost(2.0, 2.0)}
    figures = {figure.metric: figure.value for figure in _figures(costs)}
    assert figures["geometry_over_floor"] == pytest.approx(4)
    assert figures["webdataset_over_ours"] == pytest.approx(5)
    assert "litdata_over_ours" not in figures
    assert [row["loader"] for row in _rows(costs)] == ["ours", "webdataset", "floor"]
