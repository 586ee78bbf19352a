"""Data sets on paper: what they cost on many GPUs, what limits them, and how long they take on machines that fail.

All times in seconds, all sizes in bytes. A *part* is what ``gcd generate --shard I/N`` makes: a machine takes one after
the other until none is left.
"""

import math
from collections.abc import Generator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from gcd_dataset.errors import ConfigError
from gcd_dataset.shards.writer import SHARD_SIZE

__all__ = ["Bill", "Fleet", "Machine", "ObjectStore", "Run", "bill", "expected_seconds", "limits", "simulate"]


@dataclass(frozen=True)
class Machine:
    """A GPU with its cores, as measured by ``benchmarks.run scale``; the defaults are those of one H200, 16 cores."""

    rate: float = 34.7
    """Garments a second of one GPU, written, with pictures."""
    cores: int = 16
    """Of each GPU."""
    cpu: float = 0.225
    """CPU-seconds of a worker for a garment: 0.208 prepare, 0.008 points, 0.005 encoding, 0.004 pictures."""
    write: float = 4.3e-9
    """CPU-seconds of the writing process for a byte: copy, CRC-32, write, SHA-256 of the shard."""
    receive: float = 0.62e-9
    """CPU-seconds of the writing process to receive a byte from a worker."""
    network: float = 1.25e9
    """Bytes a second from one host, 10 Gbit/s."""
    gpus: int = 8
    """Of one host, which one ``gcd generate`` uses."""


@dataclass(frozen=True)
class ObjectStore:
    """An object store; the defaults are those that S3 documents, for one prefix, and its list prices in us-east-1."""

    puts: float = 3_500.0
    """Requests a second that write."""
    piece: int = 50 << 20
    """Bytes of a request of an upload in pieces."""
    beside: int = 5
    """Requests for a shard beside its pieces: begin, end, two notes, a look at its size."""
    put_usd: float = 5e-6
    """Of one request."""
    month_usd: float = 0.023e-9
    """Of a byte for a month."""

    def requests(self, shard: float) -> int:
        """For a shard of so many bytes."""
        return math.ceil(shard / self.piece) + self.beside


def limits(machine: Machine, store: ObjectStore, *, gpus: int, size: float) -> dict[str, float]:
    """Garments a second that each part of the way lets through, for so many GPUs and garments of ``size`` bytes."""
    hosts, together = math.ceil(gpus / machine.gpus), min(gpus, machine.gpus)
    writer = 1 / (size * (machine.write + machine.receive))
    return {
        "GPU": gpus * machine.rate,
        "cores": gpus * (machine.cores - 1) / machine.cpu,
        "writer": hosts * writer,
        "network": hosts * machine.network / size,
        "requests": store.puts / store.requests(SHARD_SIZE * size) * SHARD_SIZE,
    } | ({} if together == 1 else {"writers, a part for each GPU": gpus * writer})


@dataclass(frozen=True)
class Bill:
    """A data set on GPUs that do not fail."""

    garments: int
    gpus: int
    seconds: float
    """From the first garment to the last."""
    bottleneck: str
    gpu_hours: float
    cpu_hours: float
    size: float
    shards: int
    requests: int
    compute_usd: float
    store_usd: float
    """Of its requests and its first month."""
    index: int
    """Bytes of ``index-train.npz``."""
    manifest: int
    """Bytes of ``manifest.json``."""


INDEX_BYTES = 333.3  # a garment, measured
MANIFEST_BYTES = 240.0  # a shard, with two rules in ``rejects``, measured


def bill(machine: Machine, store: ObjectStore, *, garments: int, gpus: int, size: float, gpu_usd: float) -> Bill:
    """What a data set takes. ``gpu_usd``: of a GPU with its cores for an hour."""
    rates = limits(machine, store, gpus=gpus, size=size)
    if (alone := rates.pop("writers, a part for each GPU", None)) is not None:
        rates["writer"] = alone
    bottleneck = min(rates, key=lambda name: rates[name])
    seconds = garments / rates[bottleneck]
    shards = math.ceil(garments / SHARD_SIZE)
    requests = shards * store.requests(SHARD_SIZE * size)
    hours = seconds * gpus / 3600
    return Bill(
        garments=garments,
        gpus=gpus,
        seconds=seconds,
        bottleneck=bottleneck,
        gpu_hours=hours,
        cpu_hours=garments * (machine.cpu + size * (machine.write + machine.receive)) / 3600,
        size=garments * size,
        shards=shards,
        requests=requests,
        compute_usd=hours * gpu_usd,
        store_usd=requests * store.put_usd + garments * size * store.month_usd,
        index=round(garments * INDEX_BYTES),
        manifest=round(shards * MANIFEST_BYTES),
    )


# ------------------------------------------------------------------------------------------------ machines that fail


@dataclass(frozen=True)
class Fleet:
    """Machines of one GPU each, that fail while they are at work, by chance and without memory."""

    machines: int = 1000
    rate: float = 34.7
    """Garments a second."""
    begin: float = 25.0
    """From the start of a part to its first garment."""
    failing: float = math.inf
    """Seconds of work between two failures of a machine, on average."""
    again: float = 180.0
    """From a failure to the next garment of the part: another machine, its start, its processes."""
    kept: int = SHARD_SIZE
    """Garments that are safe together: a shard in a store; a part where a failure takes the disk along."""
    slow_share: float = 0.0
    """Of the machines, which are slow for good."""
    slow_rate: float = 0.5
    """Theirs, as a share of the others'."""

    def __post_init__(self) -> None:
        if self.machines < 1 or self.kept < 1 or min(self.rate, self.failing, self.slow_rate) <= 0:
            raise ConfigError(f"{self}: give machines, garments kept, rates and the time between failures above 0")


@dataclass(frozen=True)
class Run:
    """How a data set came about."""

    seconds: float
    failures: int
    lost: float
    """Seconds of work done twice, of all machines."""
    away: float
    """Seconds in which machines began parts or were being replaced."""
    idle: float
    """Seconds in which machines had no part left, while others were at work."""
    efficiency: float
    """Time of as many machines that never begin, fail or wait, by the time that it took."""


def expected_seconds(fleet: Fleet, part: int) -> float:
    """Time for a part on one machine that is not slow, on average.

    The garments that are kept together are begun anew until no failure comes: with failures at rate λ, a stretch of t
    seconds takes (1/λ + R)(exp(λt) - 1), where R passes after each failure.
    """
    stretches = _stretches(part, fleet.kept)
    rate = 1 / fleet.failing
    if not rate:
        return fleet.begin + part / fleet.rate
    return fleet.begin + sum(
        number * (1 / rate + fleet.again) * math.expm1(rate * garments / fleet.rate) for garments, number in stretches
    )


def _stretches(part: int, kept: int) -> list[tuple[int, int]]:
    """Garments of a stretch, and how many stretches of a part have as many."""
    whole, rest = divmod(part, kept)
    return [(kept, whole), (rest, 1)] if rest else [(kept, whole)]


def simulate(fleet: Fleet, garments: int, part: int, *, seed: int = 0) -> Run:
    """One run over parts of ``part`` garments. Raises ``ConfigError`` without a garment."""
    import simpy

    if min(garments, part) < 1:
        raise ConfigError(f"{garments} garments in parts of {part}: give 1 or more of each")
    clock = simpy.Environment()
    waiting = [size for size, number in reversed(_stretches(garments, part)) for _ in range(number)]
    count = {"failures": 0.0, "lost": 0.0, "away": 0.0}
    ends: list[float] = []

    def machine(chance: np.random.Generator, rate: float) -> Generator[Any, None, None]:
        while waiting:
            left = waiting.pop()
            count["away"] += fleet.begin
            yield clock.timeout(fleet.begin)
            while left:
                failing = chance.exponential(fleet.failing) if math.isfinite(fleet.failing) else math.inf
                if failing >= left / rate:
                    yield clock.timeout(left / rate)
                    break
                yield clock.timeout(failing + fleet.again)
                safe = int(failing * rate) // fleet.kept * fleet.kept
                left -= safe
                count["failures"] += 1
                count["lost"] += failing - safe / rate
                count["away"] += fleet.again
        ends.append(clock.now)

    chances = np.random.Generator(np.random.Philox(seed)).spawn(fleet.machines)
    slow = round(fleet.slow_share * fleet.machines)
    for number, chance in enumerate(chances):
        clock.process(machine(chance, fleet.rate * (fleet.slow_rate if number < slow else 1.0)))
    clock.run()
    seconds = max(ends)
    ideal = garments / fleet.rate / (fleet.machines - slow + slow * fleet.slow_rate)
    return Run(
        seconds=seconds,
        failures=int(count["failures"]),
        lost=count["lost"],
        away=count["away"],
        idle=sum(seconds - end for end in ends),
        efficiency=ideal / seconds,
    )


def as_row(run: Run) -> Mapping[str, Any]:
    """The run in hours, for a table."""
    return {
        "hours": run.seconds / 3600,
        "failures": run.failures,
        "GPU-h done twice": run.lost / 3600,
        "GPU-h of starts": run.away / 3600,
        "GPU-h idle": run.idle / 3600,
        "of the ideal rate": run.efficiency,
    }
