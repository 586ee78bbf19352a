"""Making a data set: samples into shards, going on where an earlier run was stopped."""

import math
from collections.abc import Generator
from dataclasses import dataclass
from pathlib import Path

from gcd_dataset.cli.plan import Plan
from gcd_dataset.errors import ConfigError
from gcd_dataset.generator.maker import produce
from gcd_dataset.generator.recipe import MakeConfig, device_kind, recipe_of
from gcd_dataset.records import Sample
from gcd_dataset.shards import ShardWriter

__all__ = ["GarmentPlan", "generate", "plan", "waiting_line"]

LONG = 10.0  # s: a shorter wait is not worth a line


@dataclass(frozen=True)
class GarmentPlan(Plan):
    """Garments to be made."""

    seed: int
    config: MakeConfig


def plan(out: Path | str, count: int, *, seed: int = 0, config: MakeConfig | None = None) -> GarmentPlan:
    """What it takes to have samples 0 … ``count`` - 1 of ``seed`` in ``out``.

    What a killed run left half-written in ``out`` is put in order. Raises ``ConfigError`` where ``out`` holds a data
    set of another recipe or seed, ``OutputError`` where it cannot be written.
    """
    config = config or MakeConfig()
    if count < 1:
        raise ConfigError(f"count is {count}: give 1 or more")
    if config.stage == "drape":
        from gcd_dataset.generator.drape import resolve_device

        resolve_device(config.device)  # told before anything is written
    with ShardWriter(out, seed=seed, recipe=recipe_of(config)) as writer:
        done = writer.done
    return GarmentPlan(Path(out), count, tuple(index for index in range(count) if index not in done), seed, config)


def generate(plan: GarmentPlan, *, workers: int = 0) -> Generator[Sample, None, None]:
    """Make and store what is missing, yielding each sample as it is stored.

    Stopped at any moment and planned again it goes on; the shards come out as the same bytes. ``workers`` processes
    make samples side by side on a CPU. On a GPU garments are draped together, by this process alone.
    Raises ``OutputError`` where the shards cannot be written, ``GcdError`` where a process is killed.
    """
    if not plan.missing:
        return
    with ShardWriter(plan.out, seed=plan.seed, recipe=recipe_of(plan.config)) as writer:
        for sample in produce(plan.seed, plan.missing, plan.config, workers=workers):
            writer.write(sample)
            yield sample


def waiting_line(plan: GarmentPlan, workers: int = 0) -> str | None:
    """How long the drapes of a plan are to take, and what makes them faster; ``None`` for a short wait.

    An estimate from measured figures of other machines; designs and drapes that are turned down come on top.
    """
    if plan.config.stage != "drape":
        return None
    from gcd_dataset.generator.drape import seconds_per_garment
    from gcd_dataset.generator.drape.device import cores

    count, spacing, is_cpu = len(plan.missing), plan.config.resolution, device_kind(plan.config) == "cpu"
    each, processes = seconds_per_garment(plan.config.device, spacing), min(max(workers, 1), cores()) if is_cpu else 1
    seconds = each * math.ceil(count / processes)
    if seconds < LONG:
        return None
    told = f"{count} garments to drape at {spacing:g} cm: about {_duration(seconds)}"
    if not is_cpu:
        return told
    faster = f"--workers {cores()} uses all cores; " if processes < min(cores(), count) else ""
    return f"{told}, {_duration(each)} each on a core of a CPU: {faster}--resolution {2 * spacing:g} takes a fifth"


def _duration(seconds: float) -> str:
    """A length of time to two figures.

    >>> _duration(22.0), _duration(330.0), _duration(40_000.0)
    ('22 s', '5.5 min', '11 h')
    """
    for unit, size in (("d", 86400.0), ("h", 3600.0), ("min", 60.0)):
        if seconds >= 1.5 * size:
            return f"{seconds / size:.2g} {unit}" if seconds < 100 * size else f"{seconds / size:.0f} {unit}"
    return f"{seconds:.2g} s"
