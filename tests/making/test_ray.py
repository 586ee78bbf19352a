"""The parts of the Ray engine that run without Ray."""

import errno
import re
import signal
import sys
from pathlib import Path
from types import SimpleNamespace
from unittest.mock import Mock

import pytest

from gcd_dataset.cli import main
from gcd_dataset.errors import ConfigError, OutputError
from gcd_dataset.generator.recipe import MakeConfig, recipe_of, versions
from gcd_dataset.making import ray
from gcd_dataset.making.ray import code_versions, gpu_share, with_cluster_device
from gcd_dataset.making.run import Maker
from gcd_dataset.making.tasks import Task
from gcd_dataset.shards.access import Place
from gcd_dataset.shards.manifest import Plan
from tests.test_cli import one_line


@pytest.fixture
def fake_ray(monkeypatch: pytest.MonkeyPatch) -> SimpleNamespace:
    """A module ``ray`` whose ``init`` takes SIGTERM, as that of Ray does."""
    found = SimpleNamespace(is_initialized=lambda: False, shutdown=lambda: None, cluster_resources=dict, nodes=list)
    found.util = SimpleNamespace(get_node_ip_address=lambda: "10.0.0.7")
    found.init = lambda **_: signal.signal(signal.SIGTERM, lambda *_: None)
    monkeypatch.setitem(sys.modules, "ray", found)
    monkeypatch.delenv("RAY_ADDRESS", raising=False)
    return found


def test_ray_does_not_keep_its_handler_of_sigterm(fake_ray: SimpleNamespace) -> None:
    """It would abort the process."""
    before = signal.getsignal(signal.SIGTERM)
    with ray.ray_cluster(MakeConfig(stage="pattern")):
        assert signal.getsignal(signal.SIGTERM) == before


def test_the_cluster_decides_the_device() -> None:
    for asked, gpus, device in (("auto", 4, "cuda"), ("auto", 0, "cpu"), ("cpu", 4, "cpu")):
        config = with_cluster_device(MakeConfig(device=asked), gpus)
        assert recipe_of(config) == recipe_of(MakeConfig(device=device))
    for asked, message in (("cuda", "has no GPU"), ("cuda:1", "give auto, cpu or cuda")):
        with pytest.raises(ConfigError, match=message):
            with_cluster_device(MakeConfig(device=asked), 0)


def test_the_tasks_of_a_node_need_all_its_gpus() -> None:
    """As many tasks as the CPUs of any node have room for are no more than its GPUs have."""
    resources = [{"CPU": 8.0, "GPU": 1.0}, {"CPU": 96.0, "GPU": 8.0}, {"CPU": 32.0}]
    share = gpu_share([{"Alive": True, "Resources": part} for part in resources])
    for part in resources[:2]:
        assert part["CPU"] / ray.CPUS_BESIDE_GPU * share >= part["GPU"] - 1e-3
    assert gpu_share([{"Alive": False, "Resources": resources[0]}, {"Alive": True, "Resources": resources[2]}]) == 0


def node_task(place: Path, maker: Maker, wanted: dict[str, str]) -> None:
    """Make a shard on this node; the driver has the versions ``wanted``."""
    task = Task(Plan("garments", 0, {"stage": "pattern"}, 1, 1), "train", 0, [0])
    ray._make(Place(place), task, maker, wanted)


def test_faults_of_a_node_are_named_with_their_remedy(tmp_path: Path, fake_ray: SimpleNamespace) -> None:
    wanted = code_versions() | {"numpy": "1.0", "other": "2.0"}
    assert len(wanted["sources"]) == 12
    message = f"node 10.0.0.7: numpy {versions()['numpy']} instead of 1.0, other missing instead of 2.0: install the"
    with pytest.raises(ConfigError, match=re.escape(message)):
        node_task(tmp_path, lambda wanted: iter(()), wanted)
    for fault, said in (
        (MemoryError(), "node 10.0.0.7: out of memory: free disk or memory there, or give fewer --workers"),
        (OSError(errno.ENOSPC, "No space left on device"), "No space left on device: free disk or memory there"),
    ):
        with pytest.raises(OutputError, match=f"{said}.*then give the same command again to continue"):
            node_task(tmp_path, Mock(side_effect=fault), code_versions())


def test_an_address_without_a_server_fails_soon(
    tmp_path: Path, fake_ray: SimpleNamespace, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    command = ["generate", str(tmp_path / "out"), "--count", "1", "--stage", "pattern", "--engine", "ray"]
    for address in ("127.0.0.1:1", "ray://127.0.0.1:1", "nowhere"):
        monkeypatch.setenv("RAY_ADDRESS", address)
        assert main(command) == 2
        message = one_line(capsys.readouterr().err)
        assert f"RAY_ADDRESS {address}: no Ray cluster answers" in message and "HOST:PORT" in message
        assert not (tmp_path / "out").exists()


def test_without_ray_the_extra_is_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setitem(sys.modules, "ray", None)
    assert main(["generate", str(tmp_path / "out"), "--count", "1", "--engine", "ray"]) == 2
    assert "pip install 'gcd-dataset[ray]'" in one_line(capsys.readouterr().err)
    assert main(["generate", str(tmp_path / "out"), "--count", "1", "--engine", "ray", "--stage", "body"]) == 2
    assert "stage body is made on this machine: leave --engine out" in one_line(capsys.readouterr().err)
