"""The parts of the Ray engine that run without Ray."""

import itertools
import sys
from pathlib import Path

import pytest

from gcd_dataset.cli import main
from gcd_dataset.errors import ConfigError
from gcd_dataset.generator.recipe import MakeConfig, recipe_of, versions
from gcd_dataset.verbs.ray_engine import (
    Actor,
    code_versions,
    mismatch,
    nearest_first,
    ranges,
    samples_of_range,
    with_cluster_device,
)
from tests.test_cli import one_line


@pytest.mark.parametrize("wearers", [1, 2, 3])
@pytest.mark.parametrize("size", [1, 4, 100])
def test_ranges_hold_each_index_once_and_divide_no_design(wearers: int, size: int) -> None:
    missing = [index for index in range(50) if index % 7]
    parts = list(ranges(missing, wearers, size))
    assert [index for part in parts for index in part] == missing
    designs = [{index // wearers for index in part} for part in parts]
    assert sum(map(len, designs)) == len(set.union(*designs))
    assert all(size <= len(part) < size + wearers for part in parts[:-1])


def test_ranges_are_made_when_asked_for() -> None:
    assert next(ranges(itertools.count(), 1, 3)) == (0, 1, 2)


@pytest.mark.parametrize(("count", "slots"), [(64, 2), (1000, 16), (1, 100)])
def test_each_slot_has_a_range_where_there_are_enough(count: int, slots: int) -> None:
    size = samples_of_range(count, 0.1, slots)
    assert -(-count // size) >= min(count, slots)


def test_a_long_sample_is_a_range_of_its_own() -> None:
    assert samples_of_range(1000, 60.0, 2) == 1


def test_tasks_of_a_node_share_its_actors_evenly_and_know_the_others() -> None:
    actors = [Actor(f"{node}{number}", node) for node in "xy" for number in range(4)]
    for node in "xyz":  # node z has no actors
        orders = [nearest_first(actors, node, task) for task in range(8)]
        assert all(sorted(order) == sorted(actor.handle for actor in actors) for order in orders)
        own = [actor.handle for actor in actors if actor.node == node] or [actor.handle for actor in actors]
        assert all(set(order[: len(own)]) == set(own) for order in orders)
        assert {order[0] for order in orders} == set(own)


@pytest.mark.parametrize(("asked", "gpus", "device"), [("auto", 4, "cuda"), ("auto", 0, "cpu"), ("cpu", 4, "cpu")])
def test_the_cluster_decides_the_device(asked: str, gpus: int, device: str) -> None:
    config = with_cluster_device(MakeConfig(device=asked), gpus)
    assert recipe_of(config) == recipe_of(MakeConfig(device=device))


@pytest.mark.parametrize(("asked", "message"), [("cuda", "has no GPU"), ("cuda:1", "give auto, cpu or cuda")])
def test_gpus_that_ray_cannot_give_are_reported(asked: str, message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        with_cluster_device(MakeConfig(device=asked), 0)


def test_versions_that_differ_are_named_with_both() -> None:
    theirs = versions() | {"numpy": "1.0"}
    message = mismatch(versions(), theirs)
    assert message is not None
    assert message.startswith(f"numpy 1.0 instead of {versions()['numpy']}: install the same")
    assert mismatch(versions(), dict(versions())) is None
    assert "gcd_dataset missing instead of" in str(mismatch(versions(), {}))


def test_sources_count_as_a_version() -> None:
    assert len(code_versions()["sources"]) == 12
    assert code_versions() | {"sources": ""} != code_versions()


def test_without_ray_the_extra_is_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setitem(sys.modules, "ray", None)
    out = tmp_path / "data"
    assert main(["generate", str(out), "--count", "1", "--stage", "pattern", "--engine", "ray"]) == 2
    assert "pip install 'gcd-dataset[ray]'" in one_line(capsys.readouterr().err)
    assert not out.exists()


def test_bodies_are_made_on_this_machine(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["generate", str(tmp_path / "people"), "--count", "1", "--stage", "body", "--engine", "ray"]) == 2
    assert "leave --engine out" in one_line(capsys.readouterr().err)
