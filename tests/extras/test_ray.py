"""Generation on a Ray cluster of several nodes, one of which is killed: same bytes, one-line errors."""

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

ray = pytest.importorskip("ray", reason="ray is not installed: make test-extras")

from gcd_dataset.generator.drapers.ray_actor import RayDraper, start_actor  # noqa: E402
from gcd_dataset.verbs.making import generate  # noqa: E402

from gcd_dataset.cli import main  # noqa: E402
from gcd_dataset.errors import GcdError  # noqa: E402
from gcd_dataset.generator.drapers import ray_actor  # noqa: E402
from gcd_dataset.generator.drapers.local import LocalDraper  # noqa: E402
from gcd_dataset.generator.maker import produce  # noqa: E402
from gcd_dataset.generator.recipe import MakeConfig  # noqa: E402
from gcd_dataset.making.progress import Progress  # noqa: E402
from gcd_dataset.records import Sample  # noqa: E402
from gcd_dataset.verbs import ray_engine  # noqa: E402
from tests.test_cli import one_line, wait_for_bytes  # noqa: E402

pytestmark = [
    pytest.mark.filterwarnings("ignore::ResourceWarning"),  # Ray leaves files open
    pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning"),
    pytest.mark.filterwarnings("ignore::DeprecationWarning"),
    pytest.mark.filterwarnings("ignore::FutureWarning"),
]

ROOT = Path(__file__).resolve().parents[2]
NOTICES_SOON = {"health_check_initial_delay_ms": 500, "health_check_period_ms": 500}
"""A dead node refuses the connections of five checks, so the cluster notices it in 3 s instead of 20; a check of a
living node has the usual 10 s to answer."""
MESHED = MakeConfig(stage="mesh", resolution=8.0, points=16, picture=0, bodies="both")
DRAPED = MakeConfig(resolution=10.0, points=16, picture=0, device="cpu", on_fail="keep")
TOO_HEAVY = """
stage = "pattern"
max_attempts = 2
[design.meta]
upper = "none"
bottom = "SkirtCircle"
[design.flare-skirt]
length = 0.9
"""
WITHOUT_WARP_OF_OURS = """
import importlib.metadata as metadata
known = metadata.version
metadata.version = lambda name: "0.1" if name == "warp-lang" else known(name)
"""
WITHOUT_US = """
import sys
class Refuse:
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] == "gcd_dataset":
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)
sys.meta_path.insert(0, Refuse())
"""


@pytest.fixture(scope="module")
def cluster() -> Iterator[Any]:
    """A cluster; its head node has no CPUs, so no tasks run there."""
    from ray.cluster_utils import Cluster

    head = {"num_cpus": 0, "include_dashboard": False, "_system_config": NOTICES_SOON}
    started = Cluster(initialize_head=True, head_node_args=head)
    yield started
    ray.shutdown()
    started.shutdown()


@pytest.fixture
def node(cluster: Any, monkeypatch: pytest.MonkeyPatch) -> Iterator[Callable[..., Any]]:
    """A function that adds one-CPU nodes to the cluster of ``RAY_ADDRESS``; they are removed after the test."""
    monkeypatch.setenv("RAY_ADDRESS", cluster.address)

    def added(**options: Any) -> Any:
        found = {"PYTHONPATH": str(ROOT)} | options.pop("env_vars", {})
        return cluster.add_node(num_cpus=1, env_vars=found, **options)

    yield added
    ray.shutdown()
    for worker in list(cluster.worker_nodes):
        cluster.remove_node(worker, allow_graceful=False)


def files(folder: Path) -> Mapping[str, bytes]:
    return {path.name: path.read_bytes() for path in sorted(folder.iterdir())}


@pytest.mark.parametrize(("config", "count"), [(MESHED, 24), (DRAPED, 6)])
def test_a_killed_node_changes_no_byte(
    config: MakeConfig, count: int, tmp_path: Path, cluster: Any, node: Callable[..., Any]
) -> None:
    nodes = [node(), node()]

    def report(progress: Progress) -> None:
        if progress.made == 1:
            cluster.remove_node(nodes[0], allow_graceful=False)

    done = generate(tmp_path / "ray", count, seed=5, config=config, engine="ray", on_progress=report)
    assert done.made == count
    generate(tmp_path / "here", count, seed=5, config=config, workers=0)
    assert files(tmp_path / "ray") == files(tmp_path / "here")


def test_an_unwearable_design_gives_the_same_error_with_and_without_ray(
    tmp_path: Path, node: Callable[..., Any], capfd: pytest.CaptureFixture[str]
) -> None:
    node()
    config = tmp_path / "heavy.toml"
    config.write_text(TOO_HEAVY)
    said = []
    for engine in ("ray", "local"):
        command = ["generate", str(tmp_path / engine), "--count", "4", "--config", str(config), "--quiet"]
        assert main([*command, "--engine", engine]) == 1
        said.append(one_line(capfd.readouterr().err))
    assert said[0] == said[1]
    assert files(tmp_path / "ray") == files(tmp_path / "local")


@pytest.mark.parametrize(
    ("doctored", "told"), [(WITHOUT_WARP_OF_OURS, "warp-lang 0.1 instead of"), (WITHOUT_US, "gcd_dataset missing")]
)
def test_a_node_with_other_versions_is_refused_at_the_start(
    doctored: str, told: str, tmp_path: Path, node: Callable[..., Any], capfd: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "sitecustomize.py").write_text(doctored)
    node(env_vars={"PYTHONPATH": f"{tmp_path}{os.pathsep}{ROOT}"})
    out = tmp_path / "data"
    assert main(["generate", str(out), "--count", "4", "--stage", "pattern", "--engine", "ray", "--quiet"]) == 2
    line = one_line(capfd.readouterr().err)
    assert line.startswith("gcd generate: node ")
    assert told in line
    assert "install the same on every node" in line
    assert not out.exists()


def test_a_garment_that_kills_workers_is_named_and_earlier_ones_are_kept(node: Callable[..., Any]) -> None:
    node()

    def finished(sample: Sample) -> int:
        if sample.provenance.index == 1:
            os.kill(os.getpid(), signal.SIGKILL)
        return sample.provenance.index

    came: list[int] = []
    with ray_engine.ray_cluster(replace(MESHED, stage="pattern", bodies="random")) as connected:
        made = connected.produce(5, range(3), finished=finished, seconds=100.0)
        with pytest.raises(GcdError, match=r"Ray lost a range of garments 4 times.*the same command"):
            came.extend(made)
    assert came == [0]


def test_an_actor_that_dies_is_restarted_and_its_garments_are_draped(node: Callable[..., Any]) -> None:
    node(num_gpus=1)
    ray.init(log_to_driver=False)
    actor = start_actor("cpu", gpus=0.5)
    with LocalDraper("cpu") as draper:
        here = list(produce(5, range(3), DRAPED, draper=draper))
    made: list[Sample] = []
    with RayDraper([actor]) as draper:
        for sample in produce(5, range(3), DRAPED, draper=draper, ahead=2):
            if not made:
                ray.kill(actor, no_restart=False)
            made.append(sample)
    assert made == here


def test_a_node_whose_gpu_fails_is_dropped(
    cluster: Any, node: Callable[..., Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    started = ray_actor.start_actor
    monkeypatch.setattr(ray_actor, "start_actor", lambda device, gpus: started("cpu", gpus=gpus))  # on CPUs
    nodes = [node(num_gpus=1), node(num_gpus=1)]
    made: list[Sample] = []
    with ray_engine.ray_cluster(replace(DRAPED, device="auto")) as connected:
        assert (connected.config.device, len(connected.actors)) == ("cuda", 4)
        for sample in connected.produce(5, range(6), finished=replace, seconds=2.5):
            if not made:
                cluster.remove_node(nodes[0], allow_graceful=False)
            made.append(sample)
    with LocalDraper("cpu") as draper:
        here = list(produce(5, range(6), DRAPED, draper=draper))
    assert [sample.key for sample in made] == [sample.key for sample in here]
    for ours, theirs in zip(here, made, strict=True):
        assert ours.drape is not None
        assert theirs.drape is not None
        assert np.array_equal(ours.drape.vertices, theirs.drape.vertices)


def test_permanently_lost_actors_are_named(node: Callable[..., Any]) -> None:
    node(num_gpus=1)
    ray.init(log_to_driver=False)
    actor = start_actor("cpu", gpus=0.5)
    ray.get(actor.ready.remote())
    ray.kill(actor)
    with (
        RayDraper([actor]) as draper,
        pytest.raises(GcdError, match="no draping actor of the Ray cluster replies"),
    ):
        list(produce(5, range(1), DRAPED, draper=draper))


def test_an_address_without_a_server_fails_soon(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("RAY_ADDRESS", "127.0.0.1:1")
    monkeypatch.setattr(ray_engine, "CONNECTED", 3.0)
    assert main(["generate", str(tmp_path), "--count", "1", "--stage", "pattern", "--engine", "ray"]) == 2
    assert "RAY_ADDRESS 127.0.0.1:1: no Ray cluster answered within 3 s" in one_line(capfd.readouterr().err)


def test_ctrl_c_leaves_no_process_of_a_local_cluster(tmp_path: Path) -> None:
    mark = f"GCD_TEST_{tmp_path.name}={os.getpid()}"
    name, _, value = mark.partition("=")
    env = os.environ | {name: value, "RAY_ADDRESS": "local", "PYTHONPATH": str(ROOT), "OMP_NUM_THREADS": "1"}
    command = [sys.executable, "-m", "gcd_dataset", "generate", str(tmp_path / "data"), "--count", "100000"]
    before = signal.signal(signal.SIGINT, signal.default_int_handler)  # background jobs of a shell ignore SIGINT
    process = subprocess.Popen(
        [*command, "--stage", "pattern", "--engine", "ray", "--quiet"],
        stderr=subprocess.PIPE,
        text=True,
        env=env,
        start_new_session=True,
    )
    signal.signal(signal.SIGINT, before)
    wait_for_bytes(tmp_path / "data", 50_000, process)
    os.killpg(process.pid, signal.SIGINT)  # a terminal signals the whole process group
    _, said = process.communicate(timeout=60)
    assert process.returncode == 130, said
    assert "the same command continues from there" in one_line(said)
    wait_until(lambda: not marked(mark))


def marked(mark: str) -> list[str]:
    """The ids of the processes that have ``mark`` in their environment."""
    found = []
    for folder in Path("/proc").glob("[0-9]*"):
        try:
            if mark.encode() in (folder / "environ").read_bytes().split(b"\0"):
                found.append(folder.name)
        except OSError:  # the process has ended, or belongs to another user
            continue
    return found


def wait_until(holds: Callable[[], bool], *, seconds: float = 90.0) -> None:
    end = time.monotonic() + seconds
    while not holds():
        assert time.monotonic() < end, f"not within {seconds:.0f} s"
        time.sleep(0.1)
