"""Making a data set: samples into shards, going on where an earlier run was stopped."""

from collections.abc import Generator
from dataclasses import dataclass
from pathlib import Path

from gcd_dataset.cli.plan import Plan
from gcd_dataset.errors import ConfigError
from gcd_dataset.generator.maker import produce
from gcd_dataset.generator.recipe import MakeConfig, recipe_of
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
