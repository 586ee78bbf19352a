"""The parts of the Ray engine that run without Ray."""

import errno
import itertools
import signal
import sys
from pathlib import Path
from types import ModuleType

import pytest

from gcd_dataset.cli import main
from gcd_dataset.errors import ConfigError, DrapeError, GcdError
from gcd_dataset.generator.drapers import DrapeRequest, ray_actor
from gcd_dataset.generator.recipe import MakeConfig, recipe_of, versions
from gcd_dataset.records import Sample
from gcd_dataset.verbs import ray_engine
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


def test_ray_does_not_keep_its_handler_of_sigterm() -> None:
    """It would abort the process without finishing the shards."""
    before = signal.getsignal(signal.SIGTERM)
    with ray_engine._own_handler():
        signal.signal(signal.SIGTERM, lambda *_: None)
    assert signal.getsignal(signal.SIGTERM) == before


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


# ----------------------------------------------------------------------------------------------------- faults of a node


@pytest.mark.parametrize(
    ("fault", "message"),
    [
        (MemoryError(), r"node 10\.0\.0\.7: out of memory: give fewer --workers, or a node with more memory"),
        (MemoryError("Unable to allocate 3 GiB"), r"out of memory \(Unable to allocate 3 GiB\): give fewer --workers"),
        (OSError(errno.ENOMEM, "Cannot allocate memory"), "out of memory .*: give fewer --workers"),
        (OSError(errno.ENOSPC, "No space left on device"), "No space left on device: make room there, or remove"),
        (PermissionError(errno.EACCES, "Permission denied"), "Permission denied: correct this there, or remove"),
    ],
)
def test_a_fault_of_a_node_is_named_with_its_remedy(
    fault: Exception, message: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    def finished(sample: Sample) -> None:
        raise fault

    monkeypatch.setattr(ray_engine, "_node", lambda: "10.0.0.7")
    task = ray_engine._Task(0, 5, (0,), MakeConfig(stage="pattern"), finished, code_versions())
    with pytest.raises(GcdError, match=f"{message}.*then give the same command again to continue"):
        raise ray_engine._run_task(task, ()).error or AssertionError("no error")


class FakeRay(ModuleType):
    """Ray with actors that are lost with each garment: ``get`` raises for every reply, or for those of ``drape``."""

    class RayError(Exception):
        """Ray's base class of errors."""

    def __init__(self, *, restarts: bool) -> None:
        super().__init__("ray")
        self.exceptions = self
        self.restarts = restarts

    def wait(self, references: list[str], **_: object) -> tuple[list[str], list[str]]:
        return references[:1], references[1:]

    def get(self, reference: str) -> str:
        if reference.startswith("drape") or not self.restarts:
            raise self.RayError(reference)
        return "node"


class FakeActor:
    """An actor whose calls return a reference at once."""

    def __init__(self) -> None:
        self.drape = self.ready = self
        self.calls = 0

    def options(self, **_: object) -> "FakeActor":
        return self

    def remote(self, *request: object) -> str:
        self.calls += 1
        return f"{'drape' if request else 'ready'} {id(self)} {self.calls}"


@pytest.mark.parametrize(
    ("restarts", "message"),
    [
        (True, "a garment was sent to 4 draping actors .* in turn, and each ended before it replied, the last with "
         r"RayError: read their logs \(.*\), then give the same command again to continue"),
        (False, r"no draping actor of the Ray cluster replies: all 2 have ended.*\(ray status, ray list actors\)"),
    ],
)  # fmt: skip
def test_lost_actors_are_reported_with_what_happened(
    restarts: bool, message: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "ray", FakeRay(restarts=restarts))
    monkeypatch.setattr(ray_actor, "require_faces", lambda request: None)
    draper = ray_actor.RayDraper([FakeActor(), FakeActor()])
    draper.send(DrapeRequest(0, job=None))  # type: ignore[arg-type]
    with pytest.raises(DrapeError, match=message):
        draper.receive()


# ---------------------------------------------------------------------------------------------------------------- verbs


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
