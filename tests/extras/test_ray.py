"""Generation on a Ray cluster of several nodes, one of which is killed: same bytes, one-line errors."""

import os
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

ray = pytest.importorskip("ray", reason="ray is not installed: make test-extras")

from gcd_dataset import Progress, generate  # noqa: E402
from gcd_dataset.cli import main  # noqa: E402
from gcd_dataset.generator.recipe import MakeConfig  # noqa: E402
from tests.helpers import wait_until  # noqa: E402
from tests.shards.folders import contents  # noqa: E402
from tests.test_cli import one_line  # noqa: E402

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


def test_a_killed_node_changes_no_byte(tmp_path: Path, cluster: Any, node: Callable[..., Any]) -> None:
    nodes, count = [node(), node()], 6

    def report(progress: Progress) -> None:
        if progress.made == 1:
            cluster.remove_node(nodes[0], allow_graceful=False)

    done = generate(tmp_path / "ray", count, seed=5, config=DRAPED, engine="ray", on_progress=report)
    assert done.made == count
    generate(tmp_path / "here", count, seed=5, config=DRAPED, workers=0)
    assert contents(tmp_path / "ray") == contents(tmp_path / "here")


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
    # Of other shards some may be finished before they are cancelled.
    assert contents(tmp_path / "local").items() <= contents(tmp_path / "ray").items()


@pytest.mark.parametrize(
    ("doctored", "told"), [(WITHOUT_WARP_OF_OURS, "warp-lang 0.1 instead of"), (WITHOUT_US, "without gcd_dataset")]
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
    assert not list(out.glob("*.tar"))


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
    wait_until(lambda: len(list((tmp_path / "data").glob("*.tar"))) > 1)
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
