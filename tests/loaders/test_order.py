"""The order: a permutation per epoch, independent of ranks, resumable at any position."""

import sys
from collections import Counter
from collections.abc import Iterable
from itertools import permutations
from unittest.mock import Mock

import pytest
from hypothesis import given
from hypothesis import strategies as st
from torch.utils.data import DataLoader

from gcd_dataset.errors import ConfigError
from gcd_dataset.loaders import ElasticSampler, FakeGarments, GarmentLoader, GeneratedGarments
from gcd_dataset.loaders.order import Pad, Permutation
from gcd_dataset.shards.layout import recipe_hash


def garments(n: int, seed: int = 0) -> FakeGarments:
    return FakeGarments(n, seed, fields=["meta"])


def merged(samplers: Iterable[ElasticSampler]) -> list[int]:
    """Indices of one epoch over all ranks, ordered by position."""
    turns = zip(*samplers, strict=True)
    return [number for turn in turns for number in turn]


@given(st.integers(1, 2000), st.integers(0, 2**64), st.integers(0, 2**40))
def test_a_permutation_is_a_bijection(length: int, seed: int, epoch: int) -> None:
    assert sorted(map(Permutation(length, seed, epoch), range(length))) == list(range(length))


def test_all_permutations_of_four_are_equally_likely() -> None:
    times = 4800
    counts = Counter(tuple(map(Permutation(4, seed), range(4))) for seed in range(times))
    assert counts.keys() == set(permutations(range(4)))
    # Chi squared with 23 degrees of freedom exceeds 49.7 with probability 0.001.
    assert sum((count - times / 24) ** 2 / (times / 24) for count in counts.values()) < 49.7


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


def test_received_excludes_prefetched_garments() -> None:
    ds, size = garments(40), 4
    sampler = ElasticSampler(ds)
    batches = iter(DataLoader(ds, size, sampler=sampler, num_workers=2, collate_fn=numbers))
    seen = [number for _ in range(3) for number in next(batches)]
    state = sampler.state_dict(received=3 * size)
    assert state["position"] == 12
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


GPUS = 4


@pytest.fixture(autouse=True)
def machine(monkeypatch: pytest.MonkeyPatch) -> None:
    """A machine with four GPUs, none used by another rank, and no rank set."""
    monkeypatch.setattr("torch.cuda.device_count", lambda: GPUS)
    for name in ("LOCAL_RANK", "LOCAL_WORLD_SIZE"):
        monkeypatch.delenv(name, raising=False)


def become(monkeypatch: pytest.MonkeyPatch, rank: int, count: int) -> None:
    """Set the environment of a rank started by ``torchrun``."""
    monkeypatch.setenv("LOCAL_RANK", str(rank))
    monkeypatch.setenv("LOCAL_WORLD_SIZE", str(count))


def device(name: str = "auto") -> str:
    """The resolved device."""
    return GeneratedGarments(1, device=name).config.device


@pytest.mark.parametrize(
    ("name", "devices"),
    [("auto", "cuda:0,1,2,3"), ("cuda:0,2", "cuda:0,2"), ("cuda", "cuda:0"), ("cuda:3", "cuda:3"), ("cpu", "cpu")],
)
def test_without_ranks_all_named_devices_are_used(name: str, devices: str) -> None:
    assert device(name) == devices


@pytest.mark.parametrize("name", ["auto", "cuda"])
def test_each_rank_has_a_gpu_of_its_own(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    taken = []
    for rank in range(6):
        become(monkeypatch, rank, 6)
        taken.append(device(name))
    assert taken == ["cuda:0", "cuda:1", "cuda:2", "cuda:3", "cuda:0", "cuda:1"]


def test_a_process_group_without_torchrun_has_ranks(monkeypatch: pytest.MonkeyPatch) -> None:
    for name, value in (("is_initialized", True), ("get_rank", 2), ("get_world_size", 4)):
        monkeypatch.setattr(f"torch.distributed.{name}", lambda value=value: value)
    assert device() == "cuda:2"


def test_ranks_divide_a_list_of_gpus(monkeypatch: pytest.MonkeyPatch) -> None:
    taken = []
    for rank in range(2):
        become(monkeypatch, rank, 2)
        taken.append(device("cuda:0,1,3"))
    assert taken == ["cuda:0,3", "cuda:1"]
    monkeypatch.delenv("LOCAL_WORLD_SIZE")
    assert device("cuda:0,1,3") == "cuda:1"
    assert device("cuda:2") == "cuda:2"  # a single GPU may be used by all ranks: it may be the only visible one
    become(monkeypatch, 0, 3)
    with pytest.raises(ConfigError, match="3 ranks on this machine share 2 GPUs, cuda:0, cuda:1: give device='auto'"):
        device("cuda:0,1")


def test_an_invalid_rank_environment_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    for rank, count in (("two", "4"), ("4", "4"), ("-1", "4"), ("1", "")):
        monkeypatch.setenv("LOCAL_RANK", rank)
        monkeypatch.setenv("LOCAL_WORLD_SIZE", count)
        with pytest.raises(ConfigError, match=f"LOCAL_RANK={rank!r}"):
            device()
    assert device("cpu") == "cpu"


def test_the_recipe_is_independent_of_the_gpu(monkeypatch: pytest.MonkeyPatch) -> None:
    """All ranks, and earlier runs, share one cache."""
    recipes = [GeneratedGarments(1, device=name).recipe(0)["recipe"] for name in ("auto", "cuda:0", "cuda:1,3")]
    become(monkeypatch, 3, 4)
    recipes.append(GeneratedGarments(1).recipe(0)["recipe"])
    assert {recipe["device"] for recipe in recipes} == {"cuda"}
    assert len({recipe_hash(recipe) for recipe in recipes}) == 1


def test_several_processes_of_accelerate_are_never_split_twice(monkeypatch: pytest.MonkeyPatch) -> None:
    """A loader that accelerate prepares splits its items itself; a ``GarmentLoader`` is none."""
    state = Mock(PartialState=Mock(_shared_state={"num_processes": 2}))
    monkeypatch.setitem(sys.modules, "accelerate.state", state)
    monkeypatch.setattr("torch.cuda.device_count", lambda: 0)
    for ask in (len, iter):
        for sampler in (ElasticSampler(garments(6)), ElasticSampler(garments(6), rank=1, world_size=2)):
            with pytest.raises(ConfigError, match=r"accelerate runs 2 processes, .*: give rank=0, world_size=1 and"):
                ask(sampler)
    assert len(list(ElasticSampler(garments(6), rank=0, world_size=1))) == 6
    assert len(list(GarmentLoader(garments(6), 2))) == 3
