"""Slices, selections, and sums of splits."""

from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from torch.utils.data import DataLoader

from gcd_dataset.errors import ConfigError
from gcd_dataset.loaders import FakeGarments, GarmentDataset
from gcd_dataset.loaders.fake import fake_sample
from gcd_dataset.loaders.shards import SplitPart, parse_splits
from gcd_dataset.shards import ShardReader
from tests.loaders.test_shards import assert_all_same
from tests.shards.folders import open_writer

COUNT, TESTED = 10, 3


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Ten garments in ``train``, three different ones in ``test``."""
    place = tmp_path_factory.mktemp("splits")
    for split, indices in (("train", range(COUNT)), ("test", range(20, 20 + TESTED))):
        with open_writer(place, split=split) as writer:
            for index in indices:
                writer.write(fake_sample(0, index))
    return place


def ids(folder: Path, split: str, *, streaming: bool = False) -> list[int]:
    ds = GarmentDataset(folder, split, fields=["meta"], streaming=streaming)
    return [item["meta"]["index"] for item in ds]


@pytest.mark.parametrize("streaming", [False, True])
@pytest.mark.parametrize(
    ("split", "expected"),
    [
        ("train", range(10)),
        ("train[:10%]", [0]),
        ("train[3:5]", [3, 4]),
        ("train[-2:]", [8, 9]),
        ("train[50%:]+test", [5, 6, 7, 8, 9, 20, 21, 22]),
        ("test[1:] + train[:2]", [21, 22, 0, 1]),
        ("train[90:]+test[:1]", [20]),
    ],
)
def test_a_split_may_be_sliced_and_added(folder: Path, split: str, expected: list[int], streaming: bool) -> None:
    assert ids(folder, split, streaming=streaming) == list(expected)


@pytest.mark.parametrize("split", ["train[", "train[1]", "train[:1:2]", "train++test", "train[:200%]", "", "../train"])
def test_invalid_splits_are_refused(folder: Path, split: str) -> None:
    with pytest.raises(ConfigError, match=r"write train|give -100%"):
        GarmentDataset(folder, split)


@given(st.integers(0, 10_000), st.lists(st.integers(0, 100), max_size=5))
def test_adjacent_slices_cover_the_split_once(count: int, cuts: list[int]) -> None:
    ends = [0, *sorted(cuts), 100]
    parts = [SplitPart("train", f"{a}%", f"{b}%").range_of(count) for a, b in pairwise(ends)]
    assert [position for part in parts for position in part] == list(range(count))


def test_names_with_dots_and_negative_bounds_are_parsed() -> None:
    assert parse_splits("a.b[1:-1]+c") == (SplitPart("a.b", "1", "-1"), SplitPart("c"))


def test_slices_and_selections_are_data_sets(folder: Path) -> None:
    ds = GarmentDataset(folder, fields=["meta", "verts"])
    assert_all_same(ds[2:6], [ds[i] for i in range(2, 6)])
    assert_all_same(ds[::-3], [ds[9], ds[6], ds[3], ds[0]])
    some = ds.select([7, 0, -1])
    assert (len(some), some.fields) == (3, ds.fields)
    assert_all_same(some[1:], [ds[0], ds[9]])
    assert some.recipe(0) == ds.recipe(7)
    some.verify(2)
    with pytest.raises(IndexError):
        some[3]
    with pytest.raises(IndexError):
        ds.select([10])
    assert_all_same(DataLoader(some, batch_size=None), [ds[7], ds[0], ds[9]])
    assert_all_same(FakeGarments(5)[3:], [FakeGarments(5)[3], FakeGarments(5)[4]])


def test_a_stream_has_no_selections(folder: Path) -> None:
    stream = GarmentDataset(folder, streaming=True)
    for choose in (lambda: stream[0], lambda: stream[1:], lambda: stream.select([1])):
        with pytest.raises(ConfigError, match="a stream has no indices"):
            choose()


def test_a_sample_is_found_in_every_part(folder: Path) -> None:
    ds = GarmentDataset(folder, "test+train[4:]", fields=["body"])
    assert [ds.recipe(i)["index"] for i in (0, 2, 3, -1)] == [20, 22, 4, 9]
    ds.verify(4)
    assert len(ShardReader(folder, "test")) == TESTED


@pytest.mark.parametrize("text", [f"train[:{5000 * '9'}]", f"train[-{20 * '9'}%:]", 3, None, ["train"]])
def test_the_error_for_an_invalid_split_is_one_short_line(text: Any) -> None:
    with pytest.raises(ConfigError, match="write train, ") as raised:
        parse_splits(text)
    assert len(str(raised.value)) < 200
