"""Making a data set: samples into shards, going on where an earlier run was stopped."""

import math
from collections.abc import Generator, Iterator, Mapping
from contextlib import AbstractContextManager, ExitStack
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from gcd_dataset.generator.maker import produce
from gcd_dataset.generator.recipe import MakeConfig, device_kind, devices_of, recipe_of
from gcd_dataset.generator.recipes import Recipe, find_recipe
from gcd_dataset.records import Outcome, Sample
from gcd_dataset.shards import ShardWriter, encode_sample
from gcd_dataset.shards.layout import Bytes
from gcd_dataset.shards.unfinished import filling
from gcd_dataset.verbs.log import logged
from gcd_dataset.verbs.plan import Plan, check_count
from gcd_dataset.verbs.progress import Pace, Progress, Told, unheard
from gcd_dataset.verbs.seal import claim, seal
from gcd_dataset.verbs.splits import DividedWriter, divided_writer, filling_splits
from gcd_dataset.waits import WRITER, Waits, added, taken, waited_for

if TYPE_CHECKING:
    from gcd_dataset.verbs.ray_engine import RayCluster

__all__ = ["Engine", "GarmentPlan", "Stored", "generate", "generate_recipe", "plan", "stored", "workers_for"]

Engine = Literal["local", "ray"]

BEGUN = 4.0  # s that a worker takes to start
MADE = {"pattern": 0.03, "mesh": 0.1, "drape": 0.22}  # CPU-s of a worker for a garment of a stage, without the drape


@dataclass(frozen=True)
class Stored:
    """A sample that was stored, in short."""

    index: int
    body_name: str
    rejects: tuple[str, ...]
    """Why earlier attempts were turned down, in order."""
    outcome: Outcome | None
    """How the drape ended; ``None`` at an earlier stage."""
    waits: Waits = field(default_factory=dict)
    """What its maker, and the draping processes it asked, have waited since the sample before."""


@dataclass(frozen=True)
class GarmentPlan(Plan):
    """Garments to be made."""

    seed: int
    config: MakeConfig
    recipe: Recipe | None = None
    """Divides them into splits; without one all go into ``train``."""


def plan(
    out: Path | str, count: int, *, seed: int = 0, config: MakeConfig | None = None, recipe: Recipe | None = None
) -> GarmentPlan:
    """What it takes to have samples 0 … ``count`` - 1 of ``seed`` in ``out``.

    What a killed run left half-written in ``out`` is put in order. Raises ``ConfigError`` where ``out`` holds a data
    set of another recipe or seed, ``OutputError`` where it cannot be written.
    """
    config = config or MakeConfig()
    check_count(count)
    if config.stage == "drape":
        from gcd_dataset.generator.drape import resolve_device

        for device in devices_of(config):
            resolve_device(device)  # told before anything is written
    return _planned(out, count, seed, config, recipe)


def _planned(out: Path | str, count: int, seed: int, config: MakeConfig, recipe: Recipe | None) -> GarmentPlan:
    claim(Path(out), recipe)
    with _writer(out, seed, config, recipe) as writer:
        done = writer.done
    missing = tuple(index for index in range(count) if index not in done)
    return GarmentPlan(Path(out), count, missing, seed, config, recipe)


def generate(
    out: Path | str,
    count: int,
    *,
    seed: int = 0,
    config: MakeConfig | None = None,
    recipe: Recipe | None = None,
    workers: int | None = None,
    engine: Engine = "local",
    told: Told = unheard,
    log: Path | str | None = None,
) -> Progress:
    """Have samples 0 … ``count`` - 1 of ``seed`` in the folder ``out``; those that are there are not made again.

    ``told`` is called with how far it has come; ``workers`` as ``stored`` takes it; ``recipe`` divides the samples into
    splits (``generate_recipe`` takes the other options from it too); ``engine``: this machine, or a Ray cluster as
    ``ray_engine.ray_cluster`` finds it, for which this process writes; ``log``: a file to which
    ``gcd_dataset.verbs.log`` appends. Stopped at any moment and called again it goes on, by either engine; the shards
    come out as the same bytes. Raises as ``plan``, ``stored`` and ``ray_cluster`` do, and ``OutputError`` for a log
    that cannot be opened.
    """
    config, cluster = config or MakeConfig(), None
    check_count(count)
    options = {"out": str(out), "count": count, "seed": seed, "workers": workers, "engine": engine} | _plain(config)
    with ExitStack() as opened:
        if engine == "ray":
            from gcd_dataset.verbs.ray_engine import ray_cluster

            cluster = opened.enter_context(ray_cluster(config, workers))
            config = cluster.config
        here = cluster is None and config.stage == "drape"
        devices = devices_of(config) if here else ()
        told = opened.enter_context(logged(log, told, options=options, recipe=recipe_of(config), devices=devices))
        if cluster is not None:
            task = _planned(out, count, seed, config, recipe)
        else:
            task = plan(out, count, seed=seed, config=config, recipe=recipe)
            _tell_wait(task)
        progress, pace = Progress(count, task.there), Pace()
        told(progress)
        for made in stored(task, workers=workers, cluster=cluster):
            progress = progress.with_sample(rejects=made.rejects, outcome=made.outcome and made.outcome.name)
            progress = pace.of(progress, added(made.waits, taken()))
            told(progress)
    return progress


def _tell_wait(task: GarmentPlan) -> None:
    if task.config.stage == "drape":
        from gcd_dataset.generator.drape import tell_wait

        tell_wait(len(task.missing), task.config.device, task.config.resolution)


def _plain(config: MakeConfig) -> dict[str, Any]:
    """The options as JSON takes them."""
    return {entry.name: getattr(config, entry.name) for entry in fields(config)} | {"design": config.design.to_dict()}


def stored(
    plan: GarmentPlan, *, workers: int | None = None, cluster: "RayCluster | None" = None
) -> Generator[Stored, None, None]:
    """Make and store what is missing, telling of each sample once it is stored.

    Stopped at any moment and planned again it goes on; the shards come out as the same bytes. ``workers`` processes
    make samples side by side, by default as ``workers_for`` counts them; on each GPU of the config two more processes
    drape for them. With a ``cluster`` its nodes make them instead. Raises ``OutputError`` where the shards cannot be
    written, ``GcdError`` where a process is killed.
    """
    with filling(plan.out, plan.count) if plan.recipe is None else filling_splits(plan.out, plan.recipe):
        if not plan.missing:
            return
        with _writer(plan.out, plan.seed, plan.config, plan.recipe) as writer:
            for stored, members in waited_for(_made(plan, workers, cluster), WRITER):
                writer.add(stored.index, members)
                yield stored


def _made(
    plan: GarmentPlan, workers: int | None, cluster: "RayCluster | None"
) -> Iterator[tuple[Stored, Mapping[str, Bytes]]]:
    if cluster is not None:
        return cluster.produce(plan.seed, plan.missing, finished=_encoded, seconds=_cpu_seconds(plan.config))
    workers = workers_for(plan) if workers is None else workers
    return produce(plan.seed, plan.missing, plan.config, workers=workers, finished=_encoded)


def generate_recipe(
    out: Path | str,
    recipe: Recipe | str,
    *,
    device: str = "auto",
    workers: int | None = None,
    engine: Engine = "local",
    told: Told = unheard,
    log: Path | str | None = None,
) -> Progress:
    """Have the data set of a recipe in the folder ``out``, with its splits; gone on with as ``generate`` does.

    ``recipe``: one of ``find_recipe``, or its name. When all of it is there the manifest gets the hash of its patterns.
    Raises as ``find_recipe`` and ``generate`` do.
    """
    recipe = recipe if isinstance(recipe, Recipe) else find_recipe(recipe)
    config = replace(recipe.config, device=device)
    progress = generate(
        out,
        recipe.count,
        seed=recipe.seed,
        config=config,
        recipe=recipe,
        workers=workers,
        engine=engine,
        told=told,
        log=log,
    )
    seal(Path(out), recipe)
    return progress


def _writer(
    out: Path | str, seed: int, config: MakeConfig, recipe: Recipe | None
) -> AbstractContextManager[ShardWriter | DividedWriter]:
    if recipe is None:
        return ShardWriter(out, seed=seed, recipe=recipe_of(config))
    return divided_writer(out, recipe, config)


def workers_for(plan: GarmentPlan) -> int:
    """The processes that make samples soonest: one for each core, or fewer where there is little to do."""
    from gcd_dataset.generator.drape.device import cores

    begun = int(_cpu_seconds(plan.config) * len(plan.missing) / BEGUN)
    return min(cores(), begun, math.ceil(len(plan.missing) / plan.config.wearers))


def _cpu_seconds(config: MakeConfig) -> float:
    """Of a worker, for a garment."""
    from gcd_dataset.generator.drape import seconds_per_garment

    each = MADE[config.stage]
    if config.stage == "drape" and device_kind(config) == "cpu":
        each += seconds_per_garment("cpu", config.resolution)
    return each


def _encoded(sample: Sample) -> tuple[Stored, Mapping[str, Bytes]]:
    made, outcome = sample.provenance, None if sample.drape is None else sample.drape.outcome
    members = encode_sample(sample)
    return Stored(made.index, made.body_name, made.rejects, outcome, taken()), members
