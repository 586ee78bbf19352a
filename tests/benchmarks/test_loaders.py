"""The loaders benchmark: all loaders yield the same garments."""

import json
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from benchmarks.cases import loaders
from benchmarks.cases.loaders import _opening, _passes, _ratios, cpu_ms_of
from benchmarks.cases.remote import _Counting
from benchmarks.loading import CONFIGS, installed_loaders, large_sample, write_shards

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
    installed = installed_loaders(folder, fields)
    del installed["GarmentLoader"]  # in an order of its own
    expected = installed["memmap"](indices)
    for name, load in installed.items():
        batch = load(indices)
        for field in fields:
            rows = batch[field].reshape(expected[field].shape)  # points are stacked, or one after the other
            assert torch.equal(rows, expected[field]), (name, field)
            if field != "points":
                assert torch.equal(batch[f"{field}_ptr"], expected[f"{field}_ptr"]), (name, field)
    assert len(installed) >= 6


def test_a_figure_is_the_median_over_pairs_of_epochs() -> None:
    slow = [2.0, 2.0, 9.0]
    spent = {"geometry": {"ours": slow, "memmap": [1.0, 1.0, 1.0], "memmap as ndarray": [0.5, 1.0, 4.5], "arrow": slow}}
    figures = {figure.metric: figure.value for figure in _ratios(spent)}
    assert figures["geometry_over_memmap"] == 2.0
    assert figures["geometry_cpu_ms"] == 2.0
    counted: dict[str, list[int]] = {"a": [], "b": []}

    def counting(name: str) -> Callable[[Sequence[int]], None]:
        return lambda indices: counted[name].append(len(indices))

    times = cpu_ms_of({name: counting(name) for name in counted}, 5, 2, seconds=0)
    assert {name: sum(sizes) for name, sizes in counted.items()} == {"a": 10, "b": 10}  # one epoch before the clock
    assert np.min(times["a"]) >= 0


def test_first_passes_and_waits_are_measured(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(loaders, "TIMES", 1)
    figures = {figure.metric: figure.value for figure in _passes(folder)}
    assert figures["stream_over_random"] > 0
    assert 0 < figures["wait_percent"] < 100


def test_a_store_counts_requests_and_the_bytes_of_their_answers() -> None:
    def answer(request: dict[str, Any], start: Callable[..., Any]) -> list[bytes]:
        start("200 OK", [("Content-Length", "7")])
        return [b"content"]

    server, begun = _Counting(answer), []
    for method, path in (("GET", "/a"), ("HEAD", "/a"), ("GET", "/a")):
        server({"REQUEST_METHOD": method, "PATH_INFO": path}, lambda *begin: begun.append(begin))
    counts = [json.loads(b"".join(server({"PATH_INFO": "/counted"}, lambda *begin: None))) for _ in range(2)]
    assert counts == [[3, 14], [0, 0]]
    assert len(begun) == 3


def test_a_large_index_is_opened_and_filtered(tmp_path: Path) -> None:
    figures = {figure.metric: figure.value for figure in _opening(tmp_path / "large", 3000)}
    assert 0 < figures["index_bytes"] < 8
