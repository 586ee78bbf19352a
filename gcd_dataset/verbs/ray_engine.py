"""Garments made on a Ray cluster: ranges of designs are its tasks, and its GPUs drape for all of them.

    missing indices ─► ranges ─► tasks, a bounded number at a time ─► results, fetched in order ─► the one writer, here
                                   │  ▲
                                   ▼  │
                                 actors that drape, two for each GPU; without GPUs each task drapes on its CPU

Ray places the tasks and repeats those that are lost with a worker or a node. Samples are functions of seed and index
and this process alone writes them, so that a repeated task makes the same bytes and none is stored twice.
"""

import contextlib
import hashlib
import logging
import math
import os
import subprocess
import sys
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
    "mismatch",
    "near_first",
    "on_cluster",
    "origin",
    "ranges",
    "ray_cluster",
    "samples_of_range",
]

CONNECTED = 30.0  # s within which a cluster answers at its address
STARTED = 120.0  # s within which a worker starts on each node, and an actor on a GPU
LOOK = 30.0  # s between two looks at the nodes while a result is waited for
RETRIES = 3  # of a range whose worker or node was lost
AHEAD = 2  # ranges begun for each that is made at a time, so that none waits for the writer
RANGE = 5.0  # CPU-s of a range: a task costs Ray some milliseconds
EVENT = 160  # characters of a message of Ray
SHARES = 4  # ranges for each that is made at a time, at least, where there is little to do
CPUS_BESIDE_GPU = 0.5  # of a task: two share a core, and one prepares while the last garments of another are draped

logger = logging.getLogger("gcd_dataset")


@contextmanager
def ray_cluster(config: MakeConfig, workers: int | None = None) -> Iterator["RayCluster"]:
    """The cluster that this program is connected to, that of ``RAY_ADDRESS``, one on this machine, or a new local one.

    A new one ends with the block. ``workers``: ranges made at a time; by default one for each CPU of the cluster, or
    two where its GPUs drape. Raises ``ConfigError`` where ray is not installed, a cluster does not answer within half
    a minute, has no GPU that the config asks for, or where a node has another version of what decides bytes.
    """
    ray = _imported()
    with ExitStack() as opened:
        if not ray.is_initialized():
            _hear_events(ray)
            opened.callback(ray.shutdown)
            _connect(ray, os.environ.get("RAY_ADDRESS"))
        _require_same(ray)
        resources = ray.cluster_resources()
        gpus = int(resources.get("GPU", 0)) if config.stage == "drape" else 0
        config = on_cluster(config, gpus)
        actors = _actors(ray, gpus) if config.device == "cuda" else ()
        opened.callback(_end, ray, [actor.handle for actor in actors])
        cpus = CPUS_BESIDE_GPU if actors else 1.0
        slots = workers or max(int(resources.get("CPU", 0) / cpus), 1)
        yield RayCluster(config, slots, cpus, tuple(actors))


class Actor(NamedTuple):
    """One that drapes."""

    handle: Any
    node: str
    """Identifier of the node that it was started on."""


@dataclass(frozen=True)
class RayCluster:
    """A cluster that is connected, of the versions that are here."""

    config: MakeConfig
    """What is made, with the device that the cluster drapes on."""
    slots: int
    """Ranges made at a time."""
    cpus: float
    """Share of a core that a range takes."""
    actors: tuple["Actor", ...]
    """Those that drape."""

    def produce(
        self, seed: int, indices: Sequence[int], *, finished: Callable[[Sample], Any], seconds: float
    ) -> Iterator[Any]:
        """What ``finished`` returns for the samples of ``indices``, in order; ``seconds``: of a CPU for one of them.

        Raises what ``generator.maker.produce`` raises, after the results before it, and ``GcdError`` where Ray has lost
        a range too often.
        """
        import ray

        size = samples_of_range(len(indices), seconds, self.slots)
        waiting = enumerate(ranges(indices, self.config.wearers, size))
        task = ray.remote(num_cpus=self.cpus, max_retries=RETRIES, retry_exceptions=False)(_make)
        flight: deque[Any] = deque()
        try:
            while True:
                for number, part in islice(waiting, AHEAD * self.slots - len(flight)):
                    work = _Range(number, seed, part, self.config, finished, origin())
                    flight.append(task.remote(work, self.actors))
                if not flight:
                    return
                made = _fetched(ray, flight[0])
                flight.popleft()
                for level, message in made.said:
                    logger.log(level, "%s", message)
                yield from made.results
                if made.error is not None:
                    raise made.error
        finally:
            for reference in flight:
                ray.cancel(reference, force=True)


def ranges(indices: Iterable[int], wearers: int, size: int) -> Iterator[tuple[int, ...]]:
    """Indices in a row, ``size`` of them or a few more: the samples of a design stay together.

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
    """Samples of a range that takes ``RANGE`` seconds, or less where there are too few for all slots.

    >>> samples_of_range(100_000, 0.1, 64), samples_of_range(64, 0.1, 2), samples_of_range(3, 30.0, 2)
    (50, 8, 1)
    """
    return max(min(int(RANGE / seconds), math.ceil(count / (SHARES * slots))), 1)


def near_first(actors: Sequence[Actor], node: str, number: int) -> list[Any]:
    """The handles in the order in which task ``number`` on a node tries them: those of its node, then the others.

    Each is the first of some task, so that all have as much to do.

    >>> near_first([Actor("a", "x"), Actor("b", "x"), Actor("c", "y")], "x", 1)
    ['b', 'a', 'c']
    """
    found = []
    for group in ([actor for actor in actors if actor.node == node], [actor for actor in actors if actor.node != node]):
        turn = number % max(len(group), 1)
        found += [actor.handle for actor in group[turn:] + group[:turn]]
    return found


def on_cluster(config: MakeConfig, gpus: int) -> MakeConfig:
    """The config with the kind of device that a cluster with so many GPUs drapes on, ``cpu`` or ``cuda``.

    Raises ``ConfigError`` for GPUs that it does not have, or by their numbers.
    """
    if config.device not in ("auto", "cpu", "cuda"):
        raise ConfigError(f"device {config.device}: Ray hands out the GPUs of its nodes: give auto, cpu or cuda")
    if config.stage == "drape" and config.device == "cuda" and not gpus:
        raise ConfigError("device cuda: the Ray cluster has no GPU: give --device cpu, or add a node with one")
    return replace(config, device="cuda" if gpus and config.device != "cpu" else "cpu")


# ------------------------------------------------------------------------------------------------------- on the cluster


@dataclass(frozen=True)
class _Range:
    """What a task makes."""

    number: int
    seed: int
    indices: tuple[int, ...]
    config: MakeConfig
    finished: Callable[[Sample], Any]
    origin: Mapping[str, str]
    """Versions where the samples are written."""


@dataclass(frozen=True)
class _Made:
    """What a task has made, and the error that ended it: Ray repeats no task that returns."""

    results: tuple[Any, ...]
    error: Exception | None
    said: tuple[tuple[int, str], ...]
    """Level and message of what was logged meanwhile."""


def _make(work: _Range, actors: Sequence[Actor]) -> _Made:
    """The task."""
    results: list[Any] = []
    error: Exception | None = None
    with _heard() as said:
        try:
            if differs := mismatch(work.origin, origin()):  # of a node that has joined since
                raise ConfigError(f"node {_node()}: {differs}")
            with ExitStack() as opened:
                draper = opened.enter_context(_draper(actors, work.number)) if work.config.stage == "drape" else None
                for result in produce(work.seed, work.indices, work.config, draper=draper, finished=work.finished):
                    results.append(result)  # noqa: PERF402 - those before an error are kept
        except (OSError, MemoryError) as met:
            error = OutputError(
                f"node {_node()}: {met}: make room there, or take it out of the cluster, then give the same command "
                "again: it goes on from here"
            )
        except Exception as met:  # noqa: BLE001 -- raised where the results are read
            error = met
    return _Made(tuple(results), error, tuple(said))


def _draper(actors: Sequence[Actor], number: int) -> Draper:
    """The draper of a task: the actors, or its CPU where there are none."""
    if not actors:
        from gcd_dataset.generator.drapers.local import LocalDraper

        return LocalDraper("cpu", at_once=1)
    import ray

    from gcd_dataset.generator.drapers.ray_actor import RayDraper

    return RayDraper(near_first(actors, ray.get_runtime_context().get_node_id(), number))


@contextmanager
def _heard() -> Iterator[list[tuple[int, str]]]:
    """What this package logs in the block, from warnings on."""
    said: list[tuple[int, str]] = []
    handler = logging.Handler(logging.WARNING)
    handler.emit = lambda record: said.append((record.levelno, record.getMessage()))  # type: ignore[method-assign]
    logger.addHandler(handler)
    try:
        yield said
    finally:
        logger.removeHandler(handler)


def _node() -> str:
    import ray

    return str(ray.util.get_node_ip_address())


@cache
def origin() -> dict[str, str]:
    """Versions of all that decides bytes, and a hash of this package: a checkout changes without its version."""
    root = Path(__file__).resolve().parents[1]
    found = hashlib.sha256()
    for folder, below, names in os.walk(root, followlinks=True):
        below.sort()
        for name in sorted(name for name in names if name.endswith(".py")):
            path = Path(folder, name)
            found.update(f"{path.relative_to(root)}\0".encode() + path.read_bytes())
    return versions() | {"sources": found.hexdigest()[:12]}


def mismatch(ours: Mapping[str, str], theirs: Mapping[str, str]) -> str | None:
    """How the versions of a node differ from those here, and the remedy; ``None`` where they do not."""
    other = [f"{name} {theirs.get(name, 'missing')} instead of {mine}" for name, mine in ours.items()]
    other = [told for told, name in zip(other, ours, strict=True) if theirs.get(name) != ours[name]]
    return f"{', '.join(other)}: install the same on every node" if other else None


# ----------------------------------------------------------------------------------------------------------------- here


def _imported() -> ModuleType:
    os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")  # a local cluster would report to its makers
    os.environ.setdefault("RAY_ACCEL_ENV_VAR_OVERRIDE_ON_ZERO", "0")  # else a FutureWarning
    try:
        import ray
    except ImportError as error:
        raise ConfigError(f"engine ray: ray is not installed ({error}): pip install 'gcd-dataset[ray]'") from error
    return ray


def _hear_events(ray: ModuleType) -> None:
    """Have nodes and workers that are lost logged in a line each: Ray prints them on stdout, whatever it is told."""

    def log(data: Mapping[str, Any], *_: object, **__: object) -> None:
        logger.warning("Ray: %s", shown(" ".join(" ".join(data["lines"]).split())[:EVENT]))

    ray._private.worker.print_to_stdstream = log


def _connect(ray: ModuleType, address: str | None) -> None:
    """Connect to the cluster at ``address``, or to one of this machine, or to a new one. Raises ``ConfigError``."""
    quiet = {"log_to_driver": False, "logging_level": logging.ERROR}
    if address not in (None, "", "auto", "local"):
        _require_answer(address)
        ray.init(address=address, **quiet)
        return
    if address != "local":
        with contextlib.suppress(ConnectionError):
            ray.init(address="auto", **quiet)
            there = ray.get_runtime_context().gcs_address
            logger.info("Ray: the cluster at %s runs on this machine and is used; RAY_ADDRESS=local starts one", there)
            return
    if address == "auto":
        raise ConfigError("RAY_ADDRESS is auto, and no Ray cluster runs on this machine: start one, or unset it")
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
    """Raise ``ConfigError`` where no cluster of this version of Ray answers soon.

    Asked by a process of its own: Ray tries for minutes, prints all the while, and cannot be stopped.
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
    """Raise ``ConfigError`` with the nodes whose versions differ from those here, or that do not answer."""
    from ray.exceptions import RayError, RayTaskError
    from ray.util.scheduling_strategies import NodeAffinitySchedulingStrategy

    nodes = {node["NodeID"]: node["NodeManagerAddress"] for node in _working(ray)}
    asked = {}
    for node, address in nodes.items():
        there = NodeAffinitySchedulingStrategy(node, soft=False)
        asked[ray.remote(num_cpus=0, scheduling_strategy=there)(_asked_origin()).remote()] = address
    answered, silent = ray.wait(list(asked), num_returns=len(asked), timeout=STARTED) if asked else ([], [])
    faults = [f"node {asked[reference]}: no answer within {STARTED:.0f} s: see ray status" for reference in silent]
    for reference in answered:
        try:
            differs = mismatch(origin(), ray.get(reference))
        except RayTaskError as error:
            differs = f"{type(error.cause).__name__}: {error.cause}"
        except RayError:
            continue  # lost meanwhile: Ray gives it nothing to do
        if differs:
            faults.append(f"node {asked[reference]}: {differs}")
    if faults:
        raise ConfigError(faults[0] + (f"; and {len(faults) - 1} more nodes" if len(faults) > 1 else ""))


def _asked_origin() -> Callable[[], dict[str, str]]:
    """A function that goes to a node as its code, since the node may lack this package."""

    def found() -> dict[str, str]:
        try:
            from gcd_dataset.verbs.ray_engine import origin
        except ImportError:  # not there, or a version without Ray
            try:
                from gcd_dataset import __version__
            except ImportError:
                return {}
            return {"gcd_dataset": __version__}
        return origin()

    return found


def _working(ray: ModuleType) -> list[dict[str, Any]]:
    """The nodes that are alive and take tasks or actors."""
    return [node for node in ray.nodes() if node["Alive"] and {"CPU", "GPU"} & node["Resources"].keys()]


def _actors(ray: ModuleType, gpus: int) -> Sequence[Actor]:
    """Those of the GPUs' actors that stand within ``STARTED`` seconds; other jobs may have some of the GPUs."""
    from gcd_dataset.generator.drapers.ray_actor import start_actor

    started = [start_actor("cuda:0", gpus=1 / DRAPERS_PER_GPU) for _ in range(gpus * DRAPERS_PER_GPU)]
    standing = {actor.ready.remote(): actor for actor in started}
    answered, late = ray.wait(list(standing), num_returns=len(standing), timeout=STARTED)
    _end(ray, [standing[reference] for reference in late])
    actors = []
    for reference in answered:
        try:
            actors.append(Actor(standing[reference], ray.get(reference)))
        except ray.exceptions.RayError as error:
            fault = " ".join(str(getattr(error, "cause", None) or error).split())
    if not actors:
        told = fault if answered else f"none was free within {STARTED:.0f} s, see ray status"
        raise ConfigError(f"no GPU of the Ray cluster can drape: {told}: give --device cpu, or free one")
    return actors


def _end(ray: ModuleType, handles: Iterable[Any]) -> None:
    for handle in handles:
        ray.kill(handle)


def _fetched(ray: ModuleType, reference: Any) -> _Made:
    """What a task has made. Raises ``GcdError`` where Ray cannot have it made."""
    goes_on = "give the same command again: it goes on from here"
    while not ray.wait([reference], timeout=LOOK)[0]:
        if not any(node["Resources"].get("CPU") for node in _working(ray)):
            raise GcdError(f"no node of the Ray cluster is left: add one (ray status shows them), then {goes_on}")
    try:
        return ray.get(reference)
    except ray.exceptions.RayTaskError as error:  # before or after our own code: a node without it
        raise GcdError(
            f"on a node of the Ray cluster: {type(error.cause).__name__}: {error.cause}; {goes_on}"
        ) from None
    except ray.exceptions.RayError as error:
        lost = " ".join(str(error).split())[:200]
        raise GcdError(
            f"Ray lost a range of garments {RETRIES + 1} times, the last by {type(error).__name__} ({lost}): see ray "
            f"status and its logs, then {goes_on}"
        ) from error
