"""Making shards on a Ray cluster: a shard is a task, its worker stores it, and this process only counts.

A shard exists whole or not at all, and its bytes depend on the plan alone: Ray makes the shards of a lost worker or
node again, and a run that was stopped continues with the missing ones. Tasks on one GPU share two draping processes.
"""

import contextlib
import fcntl
import hashlib
import os
import signal
import socket
import tempfile
from collections.abc import Generator, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from functools import cache, partial
from itertools import islice
from pathlib import Path
from typing import Any

from gcd_dataset.errors import ConfigError, DrapeError, GcdError, OutputError, shown
from gcd_dataset.generator.drapers import SharedDraper
from gcd_dataset.generator.drapers.address import DRAPERS_PER_GPU, DraperAddress, owner_file
from gcd_dataset.generator.maker import AHEAD
from gcd_dataset.generator.recipe import MakeConfig, versions
from gcd_dataset.making.run import Made, Maker, MakeShards, make_shards
from gcd_dataset.making.tasks import Task
from gcd_dataset.shards.access import Place

RETRIES = 3  # of a shard, after losses of its worker, node or draping process
IN_FLIGHT = 1000  # tasks that Ray knows of: an autoscaler sees the demand
ANSWER = 10.0  # s: longest wait for the address of a cluster
LOOK = 30.0  # s between checks of the nodes while no shard is done
CPUS, CPUS_BESIDE_GPU = 1.0, 0.5  # of a task: while one waits for its drapes, another uses the CPU
RESUME = "then give the same command again to continue"

_held: dict[Path, int] = {}
"""Folders of draping processes to their owner files, locked while this worker lives."""


@contextmanager
def ray_cluster(config: MakeConfig, workers: int | None = None) -> Iterator[tuple[MakeConfig, MakeShards]]:
    """Connect to a Ray cluster for the block: the config with the device that it drapes on, and its engine.

    The first available of: the cluster that this program is already connected to, the cluster at ``RAY_ADDRESS``, a
    cluster that runs on this machine, and a new local cluster, which ends with the block. ``workers``: most shards in
    work at a time, by default as many as the cluster has room for. Raises ``ConfigError`` if ray is not installed, the
    cluster does not answer, or it lacks the GPU that the config asks for.
    """
    with _connected() as ray:
        drapes = config.stage == "drape"
        config = with_cluster_device(config, int(ray.cluster_resources().get("GPU", 0)) if drapes else 0)
        gpu = gpu_share(ray.nodes()) if drapes and config.device == "cuda" else 0.0
        yield config, partial(_make_shards, gpu=gpu, most=workers or IN_FLIGHT)


def _make_shards(
    place: Place, tasks: Sequence[Task], maker: Maker, *, gpu: float, most: int
) -> Generator[Made, None, None]:
    """Make the shards of tasks, yielding their samples, without members, when a shard is stored.

    ``gpu``: part of a GPU for each task, 0 if tasks drape on their CPU; ``most``: tasks that Ray knows of at a time.
    The first error cancels the other tasks. Raises as ``make_shards``, and ``GcdError`` for a shard that Ray has lost
    too often.
    """
    import ray

    options = {"num_cpus": CPUS_BESIDE_GPU if gpu else CPUS, "num_gpus": gpu, "max_retries": RETRIES}
    # max_calls: by default a worker ends after one task with a GPU.
    submit = ray.remote(**options, max_calls=0, retry_exceptions=[DrapeError])(_make).remote
    waiting, in_flight = iter(tasks), dict[Any, Task]()
    try:
        while True:
            for task in islice(waiting, most - len(in_flight)):
                in_flight[submit(place, task, maker, code_versions())] = task
            if not in_flight:
                return
            ready, _ = ray.wait(list(in_flight), timeout=LOOK)
            if not ready and not any(node["Alive"] and "CPU" in node["Resources"] for node in ray.nodes()):
                raise GcdError(f"the Ray cluster has no node left: add one (ray status lists the nodes), {RESUME}")
            for reference in ready:
                yield from _fetched(ray, reference, place, in_flight.pop(reference))
    finally:
        for reference in in_flight:
            ray.cancel(reference, force=True)
        if in_flight:  # else ray.shutdown may crash
            ray.wait(list(in_flight), num_returns=len(in_flight), timeout=5.0)


def _fetched(ray: Any, reference: Any, place: Place, task: Task) -> list[Made]:
    """The samples of a finished task. Raises its error, and ``GcdError`` if Ray cannot run it."""
    try:
        node, made = ray.get(reference)
    except ray.exceptions.RayTaskError as error:
        if isinstance(error.cause, GcdError):
            raise error.cause from None
        cause = _line(f"{type(error.cause).__name__}: {error.cause}")
        if "No module named" in cause:
            raise ConfigError("node without gcd_dataset, or with another one: install the same on every node") from None
        raise GcdError(f"on a node of the Ray cluster: {cause}: correct this there, {RESUME}") from None
    except ray.exceptions.RayError as error:
        raise GcdError(
            f"Ray lost shard {task.tar} {RETRIES + 1} times, the last by {type(error).__name__} ({_line(error)}): look "
            f"at ray status and Ray's logs, {RESUME}"
        ) from error
    if not place.exists(task.tar):
        raise ConfigError(f"{place.location()}: node {node} has another folder of this name: give a shared folder")
    return list(made)


def with_cluster_device(config: MakeConfig, gpus: int) -> MakeConfig:
    """The config with the device that a cluster with ``gpus`` GPUs drapes on: ``cpu`` or ``cuda``.

    Raises ``ConfigError`` for ``cuda`` without a GPU, and for a device number: Ray assigns the GPUs.
    """
    if config.device not in ("auto", "cpu", "cuda"):
        raise ConfigError(f"device {config.device}: Ray assigns the GPUs of its nodes: give auto, cpu or cuda")
    if config.stage == "drape" and config.device == "cuda" and not gpus:
        raise ConfigError("device cuda: the Ray cluster has no GPU: give --device cpu, or add a node with one")
    return replace(config, device="cuda" if gpus and config.device != "cpu" else "cpu")


def gpu_share(nodes: Sequence[Mapping[str, Any]]) -> float:
    """The part of a GPU for a task, such that the tasks of every node need all its GPUs: Ray fills one first.

    >>> gpu_share([{"Alive": True, "Resources": {"CPU": 16.0, "GPU": 2.0}}])
    0.0625
    """
    parts = [node["Resources"] for node in nodes if node["Alive"] and node["Resources"].get("GPU")]
    share = max((part["GPU"] * CPUS_BESIDE_GPU / max(part.get("CPU", 0), 1) for part in parts), default=0.0)
    return float(min(int(share * 10_000) / 10_000, 1.0))  # in Ray's steps


def _make(place: Place, task: Task, maker: Maker, wanted: Mapping[str, str]) -> tuple[str, list[Made]]:
    """On a node: make and store a shard; the node's address and the samples. Raises ``ConfigError`` for other code."""
    import ray

    node = str(ray.util.get_node_ip_address())
    found = code_versions()
    if other := [name for name in wanted if found.get(name) != wanted[name]]:
        differences = ", ".join(f"{name} {found.get(name, 'missing')} instead of {wanted[name]}" for name in other)
        raise ConfigError(f"node {node}: {differences}: install the same on every node")
    try:
        with contextlib.ExitStack() as opened:
            options: dict[str, Any] = {}
            if task.plan.recipe["stage"] == "drape":
                options = {"draper": opened.enter_context(_draper(task)), "ahead": AHEAD}
            made = make_shards(place, [task], partial(maker, **options))
            return node, [sample._replace(members=None) for sample in made]
    except (OSError, MemoryError) as fault:
        said = str(fault) or "out of memory"
        remedy = "free disk or memory there, or give fewer --workers, or remove the node from the cluster"
        raise OutputError(f"node {node}: {said}: {remedy}, {RESUME}") from None


def _draper(task: Task) -> Any:
    """A draper for a task: one of the draping processes of its GPU, or its CPU without a GPU."""
    import ray

    context = ray.get_runtime_context()
    if not (gpus := context.get_accelerator_ids().get("GPU")):
        from gcd_dataset.generator.drapers.local import LocalDraper

        return LocalDraper("cpu", at_once=1)
    number = task.number % DRAPERS_PER_GPU
    name = f"gcd-draper-{os.getuid()}-{context.get_job_id()}-{context.get_node_id()[:8]}-{gpus[0]}-{number}"
    return SharedDraper(_address(Path(tempfile.gettempdir(), name)))


def _address(folder: Path) -> DraperAddress:
    """The address of the draping process in a folder, which ends when no worker holds the lock of its owner file.

    Raises ``OutputError`` for a folder of another user.
    """
    while folder not in _held:
        folder.mkdir(mode=0o700, exist_ok=True)
        if folder.stat().st_uid != os.getuid():
            raise OutputError(f"{folder}: belongs to another user: remove it")
        with contextlib.suppress(FileNotFoundError):  # removed meanwhile by a process that ends
            file = os.open(owner_file(folder), os.O_RDWR | os.O_CREAT, 0o600)
            fcntl.lockf(file, fcntl.LOCK_SH)
            if os.path.samestat(os.fstat(file), owner_file(folder).stat()):
                _held[folder] = file
    return DraperAddress(folder, "cuda:0", detached=True)  # the one GPU that Ray shows to this task


@cache
def code_versions() -> dict[str, str]:
    """Versions of the packages that determine the samples, and a hash of this package's source files.

    The hash tells checkouts of one version apart.
    """
    root, sources = Path(__file__).resolve().parents[1], hashlib.sha256()
    for path in sorted(root.rglob("*.py")):
        sources.update(f"{path.relative_to(root)}\0".encode() + path.read_bytes())
    return versions() | {"sources": sources.hexdigest()[:12]}


@contextmanager
def _connected() -> Iterator[Any]:
    """Ray, connected for the block, unless this program is connected already. Raises as ``ray_cluster`` does."""
    os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")  # no usage report from a local cluster
    os.environ.setdefault("RAY_ACCEL_ENV_VAR_OVERRIDE_ON_ZERO", "0")  # avoids a FutureWarning
    try:
        import ray
    except ImportError as error:
        raise ConfigError(f"engine ray: ray is not installed ({error}): pip install 'gcd-dataset[ray]'") from error
    with contextlib.ExitStack() as opened:
        if not ray.is_initialized():
            opened.callback(ray.shutdown)
            _connect(ray)
        yield ray


def _connect(ray: Any) -> None:
    address, options = os.environ.get("RAY_ADDRESS", ""), dict[str, Any](log_to_driver=False, logging_level="ERROR")
    if address == "local":
        from gcd_dataset.generator.device import cores

        options |= {"num_cpus": cores(), "include_dashboard": False}
    handler = signal.getsignal(signal.SIGTERM)
    try:
        if address not in ("", "auto", "local"):  # ray.init tries for long, deaf to Ctrl-C
            host, _, port = address.rpartition(":")
            socket.create_connection((host, int(port)), timeout=ANSWER).close()
        ray.init(**options)
    except (OSError, RuntimeError, ValueError) as error:
        remedy = "start a cluster at that HOST:PORT (ray status shows it), or unset RAY_ADDRESS for one on this machine"
        raise ConfigError(f"RAY_ADDRESS {shown(address)}: no Ray cluster answers ({_line(error)}): {remedy}") from error
    finally:
        with contextlib.suppress(ValueError):  # not in the main thread
            signal.signal(signal.SIGTERM, handler or signal.SIG_DFL)  # Ray's handler aborts the process


def _line(error: object) -> str:
    return " ".join(str(error).split())[:200]
