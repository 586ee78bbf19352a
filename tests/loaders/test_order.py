"""The order: a permutation per epoch, independent of ranks, resumable at any position."""

from collections import Counter
from collections.abc import Iterable
from itertools import pairwise, permutations

import pytest
from hypothesis import given
from hypothesis import strategies as st
from torch.utils.data import DataLoader

from gcd_dataset.errors import ConfigError
from gcd_dataset.loaders import ElasticSampler, FakeGarments
from gcd_dataset.loaders.order import Pad, Permutation


def garments(n: int, seed: int = 0) -> FakeGarments:
    return FakeGarments(n, seed, fields=["meta"])


def merged(samplers: Iterable[ElasticSampler]) -> list[int]:
    """Indices of one epoch over all ranks, ordered by position."""
    turns = zip(*samplers, strict=True)
    return [number for turn in turns for number in turn]


@given(st.integers(1, 2000), st.integers(0, 2**64), st.integers(0, 2**40))
def test_a_permutation_is_a_bijection(length: int, seed: int, epoch: int) -> None:
    shuffled = Permutation(length, seed, epoch)
    assert sorted(map(shuffled, range(length))) == list(range(length))


def test_all_permutations_of_four_are_equally_likely() -> None:
    times = 4800
    counts = Counter(tuple(map(Permutation(4, seed), range(4))) for seed in range(times))
    assert counts.keys() == set(permutations(range(4)))
    # Chi squared with 23 degrees of freedom exceeds 49.7 with probability 0.001.
    assert sum((count - times / 24) ** 2 / (times / 24) for count in counts.values()) < 49.7


def test_neighbours_are_scattered() -> None:
    n = 10_000
    shuffled = Permutation(n, 0, 0)
    places = [shuffled(place) for place in range(n)]
    steps = [abs(b - a) for a, b in pairwise(places)]
    assert abs(sum(steps) / len(steps) - n / 3) < n / 100  # mean distance of two uniform numbers: n / 3
    assert sum(step == 1 for step in steps) < 10


def test_the_order_is_stable_across_releases() -> None:
    """The positions in users' checkpoints must keep their meaning."""
    assert [Permutation(115_195, 3, 1)(place) for place in range(4)] == [19630, 97393, 69458, 93375]
    assert [Permutation(115_195, 3, 1)(place) for place in (1023, 1024, 115_194)] == [56467, 52793, 93004]
    assert list(ElasticSampler(garments(7))) == [1, 3, 0, 6, 2, 4, 5]


def test_a_permutation_of_10_to_the_15_needs_no_table() -> None:
    n = 10**15
    places = {Permutation(n, 1)(place) for place in range(1000)}
    assert len(places) == 1000
    assert max(places) > n // 2


@given(st.integers(1, 60), st.integers(1, 7), st.integers(0, 5))
def test_ranks_share_an_epoch(n: int, world: int, seed: int) -> None:
    def of(world_size: int, pad: Pad) -> list[ElasticSampler]:
        ranks = range(world_size)
        return [ElasticSampler(range(n), seed=seed, rank=r, world_size=world_size, pad=pad) for r in ranks]

    alone = merged(of(1, "none"))
    assert sorted(alone) == list(range(n))
    filled = merged(of(world, "repeat"))
    assert filled[:n] == alone
    assert len(filled) - n < world
    assert set(filled[n:]) <= set(alone[: world - 1])
    if n >= world:
        assert merged(of(world, "none")) == alone[: n // world * world]


def test_epochs_differ_in_order() -> None:
    sampler, again = ElasticSampler(garments(20)), ElasticSampler(garments(20))
    epochs = [list(sampler) for _ in range(3)]
    assert len({tuple(epoch) for epoch in epochs}) == 3
    assert [list(again) for _ in range(3)] == epochs
    assert list(ElasticSampler(garments(20), seed=1)) != epochs[0]
    assert list(ElasticSampler(garments(5), shuffle=False)) == [0, 1, 2, 3, 4]


def test_four_ranks_then_three_lose_and_repeat_nothing() -> None:
    ds, received = garments(100), 9
    four = [ElasticSampler(ds, rank=rank, world_size=4) for rank in range(4)]
    streams = [iter(sampler) for sampler in four]
    seen = [next(stream) for _ in range(received) for stream in streams]
    three = [ElasticSampler(ds, rank=rank, world_size=3) for rank in range(3)]
    for sampler in three:
        sampler.load_state_dict(four[0].state_dict())
    rest = merged(three)
    assert not set(seen) & set(rest)
    assert len(seen) + len(rest) == 99  # 64 garments on three ranks: one is left out
    assert [*seen, *rest] == list(ElasticSampler(ds))[:99]


@pytest.mark.parametrize("workers", [0, 2])
def test_received_excludes_prefetched_garments(workers: int) -> None:
    ds, size = garments(40), 4
    sampler = ElasticSampler(ds)
    batches = iter(DataLoader(ds, size, sampler=sampler, num_workers=workers, collate_fn=numbers))
    seen = [number for _ in range(3) for number in next(batches)]
    state = sampler.state_dict(received=3 * size)
    assert state["position"] == 12
    if not workers:
        assert sampler.state_dict() == state
    resumed = ElasticSampler(ds)
    resumed.load_state_dict(state)
    rest = [number for batch in DataLoader(ds, size, sampler=resumed, collate_fn=numbers) for number in batch]
    assert sorted(seen + rest) == list(range(40))
    assert resumed.state_dict()["position"] == 40


def numbers(items: list[dict]) -> list[int]:
    return [item["meta"]["index"] for item in items]


def test_a_foreign_state_is_refused() -> None:
    state = ElasticSampler(garments(10)).state_dict()
    for other, message in (
        (ElasticSampler(garments(11)), "its length is 10, here it is 11"),
        (ElasticSampler(garments(10), seed=1), "its seed is 0, here it is 1"),
        (ElasticSampler(garments(10), shuffle=False), "its shuffle is True, here it is False"),
        (ElasticSampler(garments(10, seed=5)), "its dataset is"),
    ):
        with pytest.raises(ConfigError, match=message):
            other.load_state_dict(state)
    with pytest.raises(ConfigError, match="the state has no dataset, length, position, seed, shuffle"):
        ElasticSampler(garments(10)).load_state_dict({"epoch": 3})


def test_invalid_ranks_are_refused() -> None:
    for options, message in (
        ({"rank": 0}, "give both, or neither"),
        ({"rank": 2, "world_size": 2}, "ranks count from 0"),
        ({"rank": 0, "world_size": 4}, "3 garments for 4 ranks: give pad='repeat'"),
        ({"pad": "wrap"}, "choose none or repeat"),
        ({"seed": -1}, "seed=-1"),
    ):
        with pytest.raises(ConfigError, match=message):
            ElasticSampler(garments(3), **options)
    with pytest.raises(ConfigError, match="an empty data set"):
        ElasticSampler(garments(0))
