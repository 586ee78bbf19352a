"""A model of making a data set on many GPUs: cost, bottleneck, and a simulation of failing machines.

Times in seconds, sizes in bytes. A *part* is the work of one ``gcd generate --shard I/N``; a machine takes parts from a
common queue until it is empty.
"""

import math
from collections.abc import Generator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from gcd_dataset.errors import ConfigError
from gcd_dataset.shards.writer import LARGEST as SHARD_SIZE

__all__ = ["RATE", "Bill", "Fleet", "Machine", "ObjectStore", "Run", "bill", "expected_seconds", "limits", "simulate"]


RATE = 43.6  # garments/s of one H200 with 16 cores, with pictures, over 5,000 garments: benchmarks/reports/scale.md


@dataclass(frozen=True)
class Machine:
    """A GPU with its cores, as measured by ``benchmarks.run scale``; defaults for one H200 with 16 cores."""

    rate: float = RATE
    """Garments per second of one GPU, written, with pictures."""
    cores: int = 16
    """CPU cores per GPU."""
    cpu: float = 0.225
    """CPU seconds of a worker per garment: 0.208 prepare, 0.008 points, 0.005 encoding, 0.004 pictures."""
    write: float = 4.3e-9
    """CPU seconds of the writing process per byte: copy, CRC-32, write, SHA-256 of the shard."""
    receive: float = 0.62e-9
    """CPU seconds of the writing process to receive a byte from a worker."""
    network: float = 1.25e9
    """Bytes per second of one host, 10 Gbit/s."""
    gpus: int = 8
    """GPUs per host, used by one ``gcd generate``."""


@dataclass(frozen=True)
class ObjectStore:
    """An object store; defaults are S3's documented limits per prefix and its list prices in us-east-1."""

    puts: float = 3_500.0
    """Write requests per second."""
    piece: int = 50 << 20
    """Bytes per part of a multipart upload."""
    beside: int = 5
    """Other write requests per shard: begin and complete the upload, write two notes, check the size."""
    put_usd: float = 5e-6
    """Price of a write request."""
    month_usd: float = 0.023e-9
    """Price of a byte per month."""

    def requests(self, shard: float) -> int:
        """Write requests for a shard of a size [bytes]."""
        return math.ceil(shard / self.piece) + self.beside


def limits(machine: Machine, store: ObjectStore, *, gpus: int, size: float) -> dict[str, float]:
    """Garments per second that each resource permits, for ``gpus`` GPUs and garments of ``size`` bytes."""
    hosts, gpus_per_host = math.ceil(gpus / machine.gpus), min(gpus, machine.gpus)
    writer = 1 / (size * (machine.write + machine.receive))
    return {
        "GPU": gpus * machine.rate,
        "cores": gpus * (machine.cores - 1) / machine.cpu,
        "writer": hosts * writer,
        "network": hosts * machine.network / size,
        "requests": store.puts / store.requests(SHARD_SIZE * size) * SHARD_SIZE,
    } | ({} if gpus_per_host == 1 else {"writers, a part for each GPU": gpus * writer})


@dataclass(frozen=True)
class Bill:
    """Resources and cost of a data set on GPUs that do not fail."""

    garments: int
    gpus: int
    seconds: float
    """Time from the first garment to the last."""
    bottleneck: str
    gpu_hours: float
    cpu_hours: float
    size: float
    shards: int
    requests: int
    compute_usd: float
    store_usd: float
    """Price of the write requests and of one month of storage."""
    index: int
    """Bytes of ``index-train.npz``."""
    manifest: int
    """Bytes of ``manifest.json``."""


INDEX_BYTES = 333.3  # per garment, measured
MANIFEST_BYTES = 240.0  # per shard, with two rules in ``rejects``, measured


def bill(machine: Machine, store: ObjectStore, *, garments: int, gpus: int, size: float, gpu_usd: float) -> Bill:
    """The bill of a data set. ``gpu_usd``: price of a GPU with its cores per hour."""
    rates = limits(machine, store, gpus=gpus, size=size)
    if (per_gpu := rates.pop("writers, a part for each GPU", None)) is not None:
        rates["writer"] = per_gpu
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
    """Machines of one GPU each, with failures during work as a Poisson process."""

    machines: int = 1000
    rate: float = RATE
    """Garments per second."""
    begin: float = 25.0
    """Time from the start of a part to its first garment."""
    failing: float = math.inf
    """Mean working time between failures of a machine."""
    again: float = 180.0
    """Time from a failure to the next garment of the part: another machine, its start, its processes."""
    kept: int = SHARD_SIZE
    """Garments per unit of safe storage: a shard in an object store; a whole part if a failure loses the disk."""
    slow_share: float = 0.0
    """Share of machines that are permanently slow."""
    slow_rate: float = 0.5
    """Rate of a slow machine relative to the others."""

    def __post_init__(self) -> None:
        if self.machines < 1 or self.kept < 1 or min(self.rate, self.failing, self.slow_rate) <= 0:
            raise ConfigError(f"{self}: give machines, garments kept, rates and the time between failures above 0")


@dataclass(frozen=True)
class Run:
    """The result of a simulation."""

    seconds: float
    failures: int
    lost: float
    """Seconds of repeated work, over all machines."""
    away: float
    """Seconds spent on starts and replacements, over all machines."""
    idle: float
    """Seconds without a part while others were still working, over all machines."""
    efficiency: float
    """Ratio of the time without starts, failures and waits to the actual time, with the same machines."""


def expected_seconds(fleet: Fleet, part: int) -> float:
    """Expected time for a part on one machine of normal rate.

    Each stretch of ``kept`` garments is repeated until no failure interrupts it: with failure rate λ, a stretch of
    t seconds takes (1/λ + R)(exp(λt) - 1), where R is the delay after each failure.
    """
    stretches = _stretches(part, fleet.kept)
    rate = 1 / fleet.failing
    if not rate:
        return fleet.begin + part / fleet.rate
    return fleet.begin + sum(
        number * (1 / rate + fleet.again) * math.expm1(rate * garments / fleet.rate) for garments, number in stretches
    )


def _stretches(part: int, kept: int) -> list[tuple[int, int]]:
    """Stretch lengths of a part [garments], with the number of stretches of each length."""
    whole, rest = divmod(part, kept)
    return [(kept, whole), (rest, 1)] if rest else [(kept, whole)]


def simulate(fleet: Fleet, garments: int, part: int, *, seed: int = 0) -> Run:
    """Simulate one run over parts of ``part`` garments. Raises ``ConfigError`` if either number is below 1."""
    import simpy

    if min(garments, part) < 1:
        raise ConfigError(f"{garments} garments in parts of {part}: give 1 or more of each")
    clock = simpy.Environment()
    waiting = [size for size, number in reversed(_stretches(garments, part)) for _ in range(number)]
    count = {"failures": 0.0, "lost": 0.0, "away": 0.0}
    ends: list[float] = []

    def machine(rng: np.random.Generator, rate: float) -> Generator[Any, None, None]:
        while waiting:
            left = waiting.pop()
            count["away"] += fleet.begin
            yield clock.timeout(fleet.begin)
            while left:
                failing = rng.exponential(fleet.failing) if math.isfinite(fleet.failing) else math.inf
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

    rngs = np.random.Generator(np.random.Philox(seed)).spawn(fleet.machines)
    slow = round(fleet.slow_share * fleet.machines)
    for number, rng in enumerate(rngs):
        clock.process(machine(rng, fleet.rate * (fleet.slow_rate if number < slow else 1.0)))
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
    """The run as a table row, in hours."""
    return {
        "hours": run.seconds / 3600,
        "failures": run.failures,
        "GPU-h done twice": run.lost / 3600,
        "GPU-h of starts": run.away / 3600,
        "GPU-h idle": run.idle / 3600,
        "of the ideal rate": run.efficiency,
    }
