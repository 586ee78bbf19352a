"""Making a data set: samples into shards, going on where an earlier run was stopped."""

from collections.abc import Generator, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import groupby
from pathlib import Path

from gcd_dataset.cli.plan import Plan, check_count
from gcd_dataset.cli.workers import side_by_side
from gcd_dataset.generator.pipeline import make_many
from gcd_dataset.generator.recipe import MakeConfig, device_kind, recipe_of
from gcd_dataset.records import Sample
from gcd_dataset.shards import ShardWriter

__all__ = ["GarmentPlan", "generate", "plan"]


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
    check_count(count)
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
        for sample in _made(plan, workers):
            writer.write(sample)
            yield sample


def _made(plan: GarmentPlan, workers: int) -> Iterator[Sample]:
    if workers < 2 or (plan.config.stage == "drape" and device_kind(plan.config) == "cuda"):
        yield from make_many(plan.seed, plan.missing, plan.config)
        return
    designs = groupby(plan.missing, key=lambda index: index // plan.config.wearers)
    make = partial(_make, plan.seed, plan.config)
    for samples in side_by_side(make, (tuple(indices) for _, indices in designs), workers):
        yield from samples


def _make(seed: int, config: MakeConfig, indices: Sequence[int]) -> list[Sample]:
    return list(make_many(seed, indices, config))
