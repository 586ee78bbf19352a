"""``MixedDataset``: shares, seeds, and resuming."""

from collections.abc import Sequence
from itertools import accumulate, islice
from pathlib import Path
from typing import Any

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from torch.utils.data import DataLoader

from gcd_dataset.errors import ConfigError, ShardError
from gcd_dataset.loaders import FakeGarments, GarmentDataset, GarmentLoader, Garments, GeneratedGarments, MixedDataset
from tests.shards.folders import fill


def fake(n: int, seed: int = 0, **options: Any) -> FakeGarments:
    return FakeGarments(n, seed, fields=["meta"], **options)


def mixed(weights: list[float], lengths: list[int], seed: int = 0) -> MixedDataset:
    return MixedDataset([fake(n, part) for part, n in enumerate(lengths)], weights, seed=seed)


def worst(ds: MixedDataset, weights: list[float], places: int) -> float:
    """Largest deviation of any stretch of the order from its shares [garments]."""
    parts = [ds.source(i)[0] for i in range(places)]
    furthest = 0.0
    for part, weight in enumerate(weights):
        ahead = list(accumulate((float(p == part) - weight / sum(weights) for p in parts), initial=0.0))
        furthest = max(furthest, max(ahead) - min(ahead))
    return furthest


@pytest.mark.parametrize("lengths", [[3, 5], [3, 5, 2]])
@given(weights=st.lists(st.floats(0.001, 1000), min_size=3, max_size=3))
def test_two_data_sets_are_within_a_garment_of_their_shares_and_three_within_two(
    lengths: list[int], weights: list[float]
) -> None:
    weights = weights[: len(lengths)]
    assert worst(mixed(weights, lengths), weights, 300) < len(lengths) - 1 + 1e-9


def test_whole_shares_are_exact() -> None:
    ds = mixed([0.8, 0.2], [90, 10])
    parts = [ds.source(i)[0] for i in range(1000)]
    assert all(sum(parts[i : i + 5]) == 1 for i in range(996))
    even = mixed([1, 1, 1], [4, 4, 4])
    assert all({even.source(3 * i + j)[0] for j in range(3)} == {0, 1, 2} for i in range(100))


@given(st.integers(1, 9), st.integers(1, 9), st.integers(1, 9), st.integers(0, 99))
def test_an_epoch_ends_when_each_data_set_is_exhausted(a: int, b: int, c: int, seed: int) -> None:
    ds = mixed([3, 1, 0.5], [a, b, c], seed)
    there = {(part, number) for part, n in enumerate((a, b, c)) for number in range(n)}
    epoch = [ds.source(i) for i in range(len(ds))]
    assert set(epoch) == there
    assert len(set(epoch[:-1])) < len(there)


def test_a_data_set_is_exhausted_before_it_is_reshuffled() -> None:
    ds = mixed([1, 1], [20, 200])
    small = [number for i in range(402) for part, number in [ds.source(i)] if part == 0]
    passes = [tuple(small[k : k + 20]) for k in range(0, 200, 20)]
    assert all(sorted(one) == list(range(20)) for one in passes)
    assert len(set(passes)) == 10
    assert [ds.source(i) for i in range(50)] != [mixed([1, 1], [20, 200], seed=1).source(i) for i in range(50)]


def test_it_is_a_data_set_like_its_parts(tmp_path: Path) -> None:
    published, fresh = GarmentDataset(fill(tmp_path / "data", range(10))), FakeGarments(30, seed=1)
    ds: Garments = MixedDataset([published, fresh], [0.25, 0.75], seed=3)
    assert len(ds) == 40
    assert ds.fields == published.fields
    for i in (0, 17, -1):
        item, recipe = ds[i], ds.recipe(i)
        assert (item["meta"]["seed"], item["meta"]["index"]) == (recipe["seed"], recipe["index"])
        ds.verify(i)
    assert [item["meta"]["seed"] for item in islice(ds, 8)] == [ds[i]["meta"]["seed"] for i in range(8)]
    assert sum(recipe["seed"] for recipe in map(ds.recipe, range(40))) == 30
    assert [item["meta"]["seed"] for item in ds[4:8]] == [ds[i]["meta"]["seed"] for i in range(4, 8)]
    with pytest.raises(IndexError):
        ds[-41]


def test_the_mix_transforms_after_its_parts() -> None:
    parts = [FakeGarments(4, seed, fields=["meta"], transform=lambda item: [item["meta"]["seed"]]) for seed in (0, 1)]
    ds: Any = MixedDataset(parts, [1, 1], transform=lambda item: [*item, "mixed"])
    assert {tuple(ds[i]) for i in range(8)} == {(0, "mixed"), (1, "mixed")}


def test_a_damaged_garment_of_a_part_is_found(tmp_path: Path) -> None:
    folder = fill(tmp_path / "data", range(4))
    ds = MixedDataset([GarmentDataset(folder, fields=["verts"]), FakeGarments(4, fields=["verts"])], [1, 1])
    path = folder / "train-00000.tar"
    path.write_bytes(bytes(byte ^ 4 for byte in path.read_bytes()))
    broken = next(i for i in range(8) if ds.source(i) == (0, 2))
    with pytest.raises(ShardError, match="gcd_000000002"):
        ds.verify(broken)


def numbers(items: list[Any]) -> list[tuple[int, int]]:
    return [(item["meta"]["seed"], item["meta"]["index"]) for item in items]


@pytest.mark.parametrize("workers", [0, 2])
def test_a_loader_keeps_the_shares_over_epochs(workers: int) -> None:
    def loader(batch_size: int, **options: Any) -> GarmentLoader:
        return GarmentLoader(mixed([0.75, 0.25], [6, 12]), batch_size, collate_fn=numbers, **options)

    first, seen = loader(4, num_workers=workers), []
    for _ in range(2):
        for batch in first:
            assert len(batch) < 4 or sum(seed for seed, _ in batch) == 1
            seen += batch
    ds = mixed([0.75, 0.25], [6, 12])
    assert seen == [ds.source(i) for i in range(2 * len(ds))]
    second = loader(10, seed=0)
    second.load_state_dict({**first.state_dict(), "position": 20})
    assert [pair for batch in second for pair in batch] == seen[20 : len(ds)]


def test_a_plain_loader_requests_whole_batches() -> None:
    asked: list[list[int]] = []

    class AtOnce(FakeGarments):
        def __getitems__(self, indices: Sequence[int]) -> list[Any]:
            asked.append(list(indices))
            return [self[index] for index in indices]

    ds = MixedDataset([AtOnce(8, fields=["meta"]), fake(8, seed=1)], [1, 1])
    batches = list(DataLoader(ds, 4, collate_fn=numbers))
    assert [pair for batch in batches for pair in batch] == [ds.source(i) for i in range(16)]
    assert [len(numbers) for numbers in asked] == [2, 2, 2, 2]


def test_generated_and_stored_garments_mix(tmp_path: Path) -> None:
    """Generated garments with a cache, mixed with stored ones."""
    fresh = GeneratedGarments(2, drape=None, resolution=4.0, cache_dir=tmp_path, fields=["meta", "box", "faces"])
    ds = MixedDataset([fresh, FakeGarments(2, fields=["meta", "box", "faces"])], [1, 1])
    [batch] = GarmentLoader(ds, 4)
    assert batch["box_ptr"].shape == (5,)
    assert torch.equal(batch["box"][batch["faces"]].isfinite(), torch.ones_like(batch["box"][batch["faces"]]) > 0)


def test_data_sets_that_do_not_fit_together_are_refused() -> None:
    cases: list[tuple[list[Any], list[float], str]] = [
        ([fake(2)], [1, 1], "1 data sets and 2 weights"),
        ([], [], r"weights=\[\]"),
        ([fake(2)], [0], r"weights=\[0\]: give a positive number"),
        ([fake(2)], [float("nan")], "give a positive number"),
        ([fake(2), fake(0)], [1, 1], "data set 1 has no garments"),
        ([fake(2), FakeGarments(2)], [1, 1], "only one of data sets 0 and 1 has .*verts.*: give both the same fields"),
        ([fake(2), fake(2, dtype=None)], [1, 1], r"floats as torch\.float32 and None: give both the same dtype"),
        ([fake(2), [1]], [1, 1], "data set 1 is a list"),
    ]
    for datasets, weights, message in cases:
        with pytest.raises(ConfigError, match=message):
            MixedDataset(datasets, weights)
