"""GPUs of ranks: one each under torchrun, all of them without ranks."""

import sys
from unittest.mock import Mock

import pytest

from gcd_dataset.errors import ConfigError
from gcd_dataset.loaders import ElasticSampler, FakeGarments, GarmentLoader, GeneratedGarments
from gcd_dataset.shards.layout import recipe_hash

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


def test_the_current_device_of_a_rank_is_used(monkeypatch: pytest.MonkeyPatch) -> None:
    """Current device 0 means that the rank has set none, and takes its own GPU."""
    become(monkeypatch, 1, 2)
    monkeypatch.setattr("torch.cuda.is_initialized", lambda: True)
    for current, taken in ((3, "cuda:3"), (0, "cuda:1")):
        monkeypatch.setattr("torch.cuda.current_device", lambda current=current: current)
        assert device() == taken


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
    garments = FakeGarments(6, fields=["meta"])
    for ask in (len, iter):
        for sampler in (ElasticSampler(garments), ElasticSampler(garments, rank=1, world_size=2)):
            with pytest.raises(ConfigError, match=r"accelerate runs 2 processes, .*: give rank=0, world_size=1 and"):
                ask(sampler)
    assert len(list(ElasticSampler(garments, rank=0, world_size=1))) == 6
    assert len(list(GarmentLoader(garments, 2))) == 3
