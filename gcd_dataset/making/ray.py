"""Generation on a Ray cluster: a task makes the samples of a range of indices, and actors on the GPUs drape.

    missing indices ─► ranges ─► tasks, a bounded number at a time ─► results in order ─► the writer, this process
                                   │  ▲
                                   ▼  │
                                 draping actors, two per GPU; without GPUs each task drapes on a CPU

Ray schedules the tasks, and retries a task whose worker or node is lost. A sample depends only on seed and index, so a
retried task makes the same bytes; only this process writes, so no sample is stored twice.
"""

import contextlib
import errno
import hashlib
import logging
import math
import os
import signal
import subprocess
import sys
import threading
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, replace
from functools import cache
from itertools import groupby, islice
from pathlib import Path
from types import ModuleType
from typing import Any, NamedTuple

from gcd_dataset.errors import ConfigError, GcdError, OutputError, shown
from gcd_dataset.generator.drapers import Draper
from gcd_dataset.generator.drapers.address import DRAPERS_PER_GPU
from gcd_dataset.generator.maker import produce
from gcd_dataset.generator.recipe import MakeConfig, versions
from gcd_dataset.records import Sample

__all__ = [
    "Actor",
    "RayCluster",
    "code_versions",
    "mismatch",
    "nearest_first",
    "ranges",
    "ray_cluster",
    "samples_of_range",
    "with_cluster_device",
]

CONNECTED = 30.0  # s: longest wait for a cluster's answer at its address
STARTED = 120.0  # s: longest wait for a worker on each node, and for an actor on a GPU, to start
LOOK = 30.0  # s between checks of the nodes while waiting for a result
RETRIES = 3  # repetitions of a task after losses of its worker or node
AHEAD = 2  # tasks submitted for each slot, so that none is idle while the writer is busy
RANGE = 5.0  # CPU time of a task [s]: long against Ray's overhead of some milliseconds
FULL = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)  # errors of a disk without room
EVENT = 160  # most characters of a logged event message of Ray
SHARES = 4  # least number of tasks for each slot in a short run
CPUS_BESIDE_GPU = 0.5  # CPUs per task if GPUs drape: while one task waits for its drapes, another uses the CPU

logger = logging.getLogger("gcd_dataset")


@contextmanager
def ray_cluster(config: MakeConfig, workers: int | None = None) -> Iterator["RayCluster"]:
    """Connect to a Ray cluster for the block.

    The first available of: the cluster that this program is already connected to, the cluster at ``RAY_ADDRESS``, a
    cluster that runs on this machine, and a new local cluster, which ends with the block. ``workers``: number of
    concurrent tasks, by default one per CPU of the cluster, or two per CPU if GPUs drape. Raises ``ConfigError`` if ray
    is not installed, the cluster does not answer within half a minute, it lacks the GPU that the config asks for, or a
    node has other versions of the packages that determine the samples.
    """
    ray = _imported()
    with ExitStack() as opened:
        if not ray.is_initialized():
            _log_events(ray)
            opened.callback(ray.shutdown)
            with _own_handler():
                _connect(ray, os.environ.get("RAY_ADDRESS"))
        _require_same(ray)
        resources = ray.cluster_resources()
        gpus = int(resources.get("GPU", 0)) if config.stage == "drape" else 0
        config = with_cluster_device(config, gpus)
        actors = _actors(ray, gpus) if config.device == "cuda" else ()
        opened.callback(_end, ray, [actor.handle for actor in actors])
        cpus = CPUS_BESIDE_GPU if actors else 1.0
        slots = workers or max(int(resources.get("CPU", 0) / cpus), 1)
        yield RayCluster(config, slots, cpus, tuple(actors))


class Actor(NamedTuple):
    """A draping actor."""

    handle: Any
    node: str
    """Identifier of its node."""


@dataclass(frozen=True)
class RayCluster:
    """A connected cluster; its nodes have the same package versions as this machine."""

    config: MakeConfig
    """Options of the samples; the device is the one that the cluster drapes on."""
    slots: int
    """Number of tasks that run at a time."""
    cpus: float
    """CPUs of a task."""
    actors: tuple["Actor", ...]
    """Draping actors; empty if tasks drape on their CPU."""

    def produce(
        self, seed: int, indices: Sequence[int], *, finished: Callable[[Sample], Any], seconds: float
    ) -> Iterator[Any]:
        """The results of ``finished`` for the samples of ``indices``, in order.

        ``seconds``: CPU time of one sample. An error of ``generator.maker.produce`` is raised after all results that
        precede it. Raises ``GcdError`` for a task that Ray has lost too often.
        """
        import ray

        size = samples_of_range(len(indices), seconds, self.slots)
        waiting = enumerate(ranges(indices, self.config.wearers, size))
        submit = ray.remote(num_cpus=self.cpus, max_retries=RETRIES, retry_exceptions=False)(_run_task).remote
        in_flight: deque[Any] = deque()
        try:
            while True:
                for number, part in islice(waiting, AHEAD * self.slots - len(in_flight)):
                    task = _Task(number, seed, part, self.config, finished, code_versions())
                    in_flight.append(submit(task, self.actors))
                if not in_flight:
                    return
                done = _fetch(ray, in_flight[0])
                in_flight.popleft()
                for level, message in done.logged:
                    logger.log(level, "%s", message)
                yield from done.results
                if done.error is not None:
                    raise done.error
        finally:
            for reference in in_flight:
                ray.cancel(reference, force=True)


def ranges(indices: Iterable[int], wearers: int, size: int) -> Iterator[tuple[int, ...]]:
    """The indices in ranges of ``size``, or a few more: the samples of a design stay together.

    >>> list(ranges([0, 1, 2, 3, 5], wearers=2, size=3))
    [(0, 1, 2, 3), (5,)]
    """
    part: list[int] = []
    for _, design in groupby(indices, key=lambda index: index // wearers):
        part.extend(design)
        if len(part) >= size:
            yield tuple(part)
            part = []
    if part:
        yield tuple(part)


def samples_of_range(count: int, seconds: float, slots: int) -> int:
    """The number of samples that take ``RANGE`` CPU-seconds, or fewer if some slots would otherwise stay idle.

    >>> samples_of_range(100_000, 0.1, 64), samples_of_range(64, 0.1, 2), samples_of_range(3, 30.0, 2)
    (50, 8, 1)
    """
    return max(min(int(RANGE / seconds), math.ceil(count / (SHARES * slots))), 1)


def nearest_first(actors: Sequence[Actor], node: str, number: int) -> list[Any]:
    """Actor handles in the order in which task ``number`` on ``node`` tries them: first the actors of its node.

    The order is rotated by ``number``, so that the tasks are spread evenly over the actors.

    >>> nearest_first([Actor("a", "x"), Actor("b", "x"), Actor("c", "y")], "x", 1)
    ['b', 'a', 'c']
    """
    handles = []
    for group in ([actor for actor in actors if actor.node == node], [actor for actor in actors if actor.node != node]):
        shift = number % max(len(group), 1)
        handles += [actor.handle for actor in group[shift:] + group[:shift]]
    return handles


def with_cluster_device(config: MakeConfig, gpus: int) -> MakeConfig:
    """The config with the device that a cluster with ``gpus`` GPUs drapes on: ``cpu`` or ``cuda``.

    Raises ``ConfigError`` for ``cuda`` without a GPU, and for a device number: Ray assigns the GPUs.
    """
    if config.device not in ("auto", "cpu", "cuda"):
        raise ConfigError(f"device {config.device}: Ray assigns the GPUs of its nodes: give auto, cpu or cuda")
    if config.stage == "drape" and config.device == "cuda" and not gpus:
        raise ConfigError("device cuda: the Ray cluster has no GPU: give --device cpu, or add a node with one")
    return replace(config, device="cuda" if gpus and config.device != "cpu" else "cpu")


# ------------------------------------------------------------------------------------------------------- on the cluster


@dataclass(frozen=True)
class _Task:
    """The arguments of a task."""

    number: int
    seed: int
    indices: tuple[int, ...]
    config: MakeConfig
    finished: Callable[[Sample], Any]
    """Applied to each sample on the node; its results are sent back."""
    versions: Mapping[str, str]
    """``code_versions`` of the writing process."""


@dataclass(frozen=True)
class _TaskResult:
    """Results of a task and the error that ended it; returned, not raised, so that Ray does not retry."""

    results: tuple[Any, ...]
    error: Exception | None
    logged: tuple[tuple[int, str], ...]
    """Level and message of the task's log records."""


def _run_task(task: _Task, actors: Sequence[Actor]) -> _TaskResult:
    """Make the samples of a task; runs on a node."""
    results: list[Any] = []
    error: Exception | None = None
    with _captured_log() as logged:
        try:
            if difference := mismatch(task.versions, code_versions()):  # the node may be newer than the check
                raise ConfigError(f"node {_node()}: {difference}")
            with ExitStack() as opened:
                draper = opened.enter_context(_draper(actors, task.number)) if task.config.stage == "drape" else None
                for result in produce(task.seed, task.indices, task.config, draper=draper, finished=task.finished):
                    results.append(result)  # noqa: PERF402 - keeps the results before an error
        except (OSError, MemoryError) as fault:
            error = _node_fault(_node(), fault)
        except Exception as fault:  # noqa: BLE001 -- raised in the writing process
            error = fault
    return _TaskResult(tuple(results), error, tuple(logged))


def _node_fault(node: str, fault: OSError | MemoryError) -> GcdError:
    """The error for a fault of a node: too little memory, a full disk, or another one of its system."""
    resume = "then give the same command again to continue"
    if isinstance(fault, MemoryError) or fault.errno == errno.ENOMEM:
        said = f" ({fault})" if str(fault) else ""
        remedy = "give fewer --workers, or a node with more memory for each CPU"
        return GcdError(f"node {node}: out of memory{said}: {remedy}, {resume}")
    remedy = "make room there" if fault.errno in FULL else "correct this there"
    return OutputError(f"node {node}: {fault}: {remedy}, or remove the node from the cluster, {resume}")


def _draper(actors: Sequence[Actor], number: int) -> Draper:
    """The draper of a task: the actors, or its CPU where there are none."""
    if not actors:
        from gcd_dataset.generator.drapers.local import LocalDraper

        return LocalDraper("cpu", at_once=1)
    import ray

    from gcd_dataset.generator.drapers.ray_actor import RayDraper

    return RayDraper(nearest_first(actors, ray.get_runtime_context().get_node_id(), number))


@contextmanager
def _captured_log() -> Iterator[list[tuple[int, str]]]:
    """Level and message of the warnings and errors that this package logs in the block."""
    logged: list[tuple[int, str]] = []
    handler = logging.Handler(logging.WARNING)
    handler.emit = lambda record: logged.append((record.levelno, record.getMessage()))  # type: ignore[method-assign]
    logger.addHandler(handler)
    try:
        yield logged
    finally:
        logger.removeHandler(handler)


def _node() -> str:
    import ray

    return str(ray.util.get_node_ip_address())


@cache
def code_versions() -> dict[str, str]:
    """Versions of the packages that determine the samples, and a hash of this package's source files.

    The hash tells checkouts of one version apart.
    """
    root = Path(__file__).resolve().parents[1]
    sources = hashlib.sha256()
    for folder, below, names in os.walk(root, followlinks=True):
        below.sort()
        for name in sorted(name for name in names if name.endswith(".py")):
            path = Path(folder, name)
            sources.update(f"{path.relative_to(root)}\0".encode() + path.read_bytes())
    return versions() | {"sources": sources.hexdigest()[:12]}


def mismatch(ours: Mapping[str, str], theirs: Mapping[str, str]) -> str | None:
    """The differences between the versions of a node and of this machine, with a remedy; ``None`` without any."""
    different = [
        f"{name} {theirs.get(name, 'missing')} instead of {version}"
        for name, version in ours.items()
        if theirs.get(name) != version
    ]
    return f"{', '.join(different)}: install the same on every node" if different else None


# ------------------------------------------------------------------------------------------------------ on this machine


def _imported() -> ModuleType:
    os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")  # no usage report from a local cluster
    os.environ.setdefault("RAY_ACCEL_ENV_VAR_OVERRIDE_ON_ZERO", "0")  # avoids a FutureWarning
    try:
        import ray
    except ImportError as error:
        raise ConfigError(f"engine ray: ray is not installed ({error}): pip install 'gcd-dataset[ray]'") from error
    return ray


def _log_events(ray: ModuleType) -> None:
    """Log Ray's events, such as lost nodes, as one line each; no option stops Ray from printing them to stdout."""

    def log(data: Mapping[str, Any], *_: object, **__: object) -> None:
        logger.warning("Ray: %s", shown(" ".join(" ".join(data["lines"]).split())[:EVENT]))

    ray._private.worker.print_to_stdstream = log


@contextmanager
def _own_handler() -> Iterator[None]:
    """Restore the handler of SIGTERM after the block: that of Ray aborts the process, without finishing the shards."""
    handler = signal.getsignal(signal.SIGTERM)
    yield
    if handler is not None and threading.current_thread() is threading.main_thread():
        signal.signal(signal.SIGTERM, handler)


def _connect(ray: ModuleType, address: str | None) -> None:
    """Connect to the cluster at ``address``, to one on this machine, or to a new one. Raises ``ConfigError``."""
    quiet = {"log_to_driver": False, "logging_level": logging.ERROR}
    if address not in (None, "", "auto", "local"):
        _require_answer(address)
        ray.init(address=address, **quiet)
        return
    if address != "local":
        with contextlib.suppress(ConnectionError):
            ray.init(address="auto", **quiet)
            running = ray.get_runtime_context().gcs_address
            logger.info("Ray: using the cluster at %s on this machine; RAY_ADDRESS=local starts a new one", running)
            return
    if address == "auto":
        raise ConfigError("RAY_ADDRESS is auto, but no Ray cluster runs on this machine: start one, or unset it")
    from gcd_dataset.generator.drape.device import cores

    ray.init(address="local", num_cpus=cores(), include_dashboard=False, **quiet)


ANSWER = """
import logging, sys
import ray
try:
    ray.init(address=sys.argv[1], log_to_driver=False, logging_level=logging.CRITICAL)
except Exception as error:
    print(" ".join(str(error).split()))
    sys.exit(1)
"""


def _require_answer(address: str) -> None:
    """Raise ``ConfigError`` unless a cluster of this version of Ray answers within ``CONNECTED`` seconds.

    Connects in a subprocess: Ray tries for minutes, prints meanwhile, and cannot be interrupted.
    """
    if "://" in address:
        raise ConfigError(
            f"RAY_ADDRESS is {shown(address)}: give HOST:PORT, and run gcd on a node of the cluster, or by ray job "
            "submit"
        )
    command = [sys.executable, "-c", ANSWER, address]
    remedy = "start the cluster there (ray status shows it), or unset RAY_ADDRESS for one on this machine"
    try:
        asked = subprocess.run(
            command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True, timeout=CONNECTED, check=False
        )
    except subprocess.TimeoutExpired as error:
        raise ConfigError(
            f"RAY_ADDRESS {shown(address)}: no Ray cluster answered within {CONNECTED:.0f} s: {remedy}"
        ) from error
    if asked.returncode:
        raise ConfigError(f"RAY_ADDRESS {shown(address)}: {asked.stdout.strip() or 'no Ray cluster there'}: {remedy}")


def _require_same(ray: ModuleType) -> None:
    """Raise ``ConfigError`` with the first node that has other versions than this machine, or does not answer."""
    from ray.exceptions import RayError, RayTaskError
    from ray.util.scheduling_strategies import NodeAffinitySchedulingStrategy

    nodes = {node["NodeID"]: node["NodeManagerAddress"] for node in _usable_nodes(ray)}
    asked = {}
    for node, address in nodes.items():
        on_node = NodeAffinitySchedulingStrategy(node, soft=False)
        asked[ray.remote(num_cpus=0, scheduling_strategy=on_node)(_versions_task()).remote()] = address
    answered, silent = ray.wait(list(asked), num_returns=len(asked), timeout=STARTED) if asked else ([], [])
    faults = [f"node {asked[reference]}: no answer within {STARTED:.0f} s: see ray status" for reference in silent]
    for reference in answered:
        try:
            differs = mismatch(code_versions(), ray.get(reference))
        except RayTaskError as error:
            differs = f"{type(error.cause).__name__}: {error.cause}"
        except RayError:
            continue  # the node was lost meanwhile: Ray schedules nothing on it
        if differs:
            faults.append(f"node {asked[reference]}: {differs}")
    if faults:
        raise ConfigError(faults[0] + (f"; nodes with further faults: {len(faults) - 1}" if len(faults) > 1 else ""))


def _versions_task() -> Callable[[], dict[str, str]]:
    """A function that Ray pickles by value, since the node may lack this package; it returns the node's versions."""

    def found() -> dict[str, str]:
        try:
            from gcd_dataset.verbs.ray_engine import code_versions
        except ImportError:  # not installed, or a version without the Ray engine
            try:
                from gcd_dataset import __version__
            except ImportError:
                return {}
            return {"gcd_dataset": __version__}
        return code_versions()

    return found


def _usable_nodes(ray: ModuleType) -> list[dict[str, Any]]:
    """The nodes that are alive and have CPUs or GPUs."""
    return [node for node in ray.nodes() if node["Alive"] and {"CPU", "GPU"} & node["Resources"].keys()]


def _actors(ray: ModuleType, gpus: int) -> Sequence[Actor]:
    """The draping actors that start within ``STARTED`` seconds; other jobs may occupy some of the GPUs."""
    from gcd_dataset.generator.drapers.ray_actor import start_actor

    started = [start_actor("cuda:0", gpus=1 / DRAPERS_PER_GPU) for _ in range(gpus * DRAPERS_PER_GPU)]
    starting = {actor.ready.remote(): actor for actor in started}
    answered, late = ray.wait(list(starting), num_returns=len(starting), timeout=STARTED)
    _end(ray, [starting[reference] for reference in late])
    actors = []
    fault = f"none was free within {STARTED:.0f} s, see ray status"
    for reference in answered:
        try:
            actors.append(Actor(starting[reference], ray.get(reference)))
        except ray.exceptions.RayError as error:
            fault = " ".join(str(getattr(error, "cause", None) or error).split())
    if not actors:
        raise ConfigError(f"no GPU of the Ray cluster can drape: {fault}: give --device cpu, or free a GPU")
    return actors


def _end(ray: ModuleType, handles: Iterable[Any]) -> None:
    for handle in handles:
        ray.kill(handle)


def _fetch(ray: ModuleType, reference: Any) -> _TaskResult:
    """The result of a task. Raises ``GcdError`` if Ray cannot run it."""
    resume = "give the same command again to continue"
    while not ray.wait([reference], timeout=LOOK)[0]:
        if not any(node["Resources"].get("CPU") for node in _usable_nodes(ray)):
            raise GcdError(f"the Ray cluster has no node left: add one (ray status lists the nodes), then {resume}")
    try:
        return ray.get(reference)
    except ray.exceptions.RayTaskError as error:  # raised outside this package, which the node lacks
        cause = f"{type(error.cause).__name__}: {error.cause}"
        raise GcdError(f"on a node of the Ray cluster: {cause}: install this package there, then {resume}") from None
    except ray.exceptions.RayError as error:
        lost = " ".join(str(error).split())[:200]
        raise GcdError(
            f"Ray lost a range of garments {RETRIES + 1} times, the last by {type(error).__name__} ({lost}): look "
            f"at ray status and Ray's logs, then {resume}"
        ) from error
