"""Making a data set: samples into shards, going on where an earlier run was stopped."""

import contextlib
import math
from collections.abc import Generator, Iterator, Mapping
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, get_args

from gcd_dataset.errors import ConfigError
from gcd_dataset.generator.maker import produce
from gcd_dataset.generator.recipe import MakeConfig, device_kind, devices_of, recipe_of
from gcd_dataset.generator.recipes import Recipe, find_recipe
from gcd_dataset.records import Outcome, Rejected, Sample
from gcd_dataset.shards import encode_sample
from gcd_dataset.shards.layout import Bytes
from gcd_dataset.verbs.array_jobs import JobPart
from gcd_dataset.verbs.log import logged
from gcd_dataset.verbs.making_plan import MakingPlan, check_count
from gcd_dataset.verbs.progress import Pace, Progress, Told, unheard
from gcd_dataset.verbs.seal import seal
from gcd_dataset.verbs.target import Target, require_folder, target_of
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
    turned_down: tuple[Rejected, ...]
    """Earlier attempts, in order."""
    outcome: Outcome | None
    """How the drape ended; ``None`` at an earlier stage."""
    waits: Waits = field(default_factory=dict)
    """What its maker, and the draping processes it asked, have waited since the sample before."""

    @property
    def rejects(self) -> tuple[str, ...]:
        """Why earlier attempts were turned down."""
        return tuple(map(str, self.turned_down))


@dataclass(frozen=True)
class GarmentPlan(MakingPlan):
    """Garments to be made."""

    target: Target
    seed: int
    config: MakeConfig


def plan(
    out: Path | str,
    count: int,
    *,
    seed: int = 0,
    config: MakeConfig | None = None,
    recipe: Recipe | None = None,
    part: JobPart | None = None,
    spool: Path | str | None = None,
    patience: float | None = None,
) -> GarmentPlan:
    """What it takes to have samples 0 … ``count`` - 1 of ``seed`` in ``out``, or those of one ``part``.

    ``out``: a folder, or the URL of a store; ``recipe`` divides the samples into splits; ``spool`` and ``patience`` as
    ``target_of`` takes them. What a killed run left half-written in ``out`` is put in order. Raises ``ConfigError``
    where ``out`` holds a data set of another recipe or seed, parts of another plan, or, without ``part``, parts that
    wait to be merged; ``OutputError`` where it cannot be written, ``RemoteError`` for a store that does not answer, or
    refuses.
    """
    config = config or MakeConfig()
    check_count(count)
    if config.stage == "drape":
        from gcd_dataset.generator.drape import resolve_device

        for device in devices_of(config):
            resolve_device(device)  # told before anything is written
    return _planned(
        target_of(out, count, seed=seed, config=config, recipe=recipe, part=part, spool=spool, patience=patience),
        seed,
        config,
    )


def _planned(target: Target, seed: int, config: MakeConfig) -> GarmentPlan:
    done = target.done()
    missing = tuple(index for index in target.indices if index not in done)
    return GarmentPlan(len(target.indices), missing, target, seed, config)


def generate(
    out: Path | str,
    count: int,
    *,
    seed: int = 0,
    config: MakeConfig | None = None,
    recipe: Recipe | None = None,
    part: JobPart | None = None,
    workers: int | None = None,
    engine: Engine = "local",
    spool: Path | str | None = None,
    patience: float | None = None,
    told: Told = unheard,
    log: Path | str | None = None,
) -> Progress:
    """Have samples 0 … ``count`` - 1 of ``seed`` in the folder ``out``; those that are there are not made again.

    ``out`` may be the URL of a store, ``s3://BUCKET/PREFIX`` or any other of ``fsspec``: shards fill in ``spool`` and
    go up one by one, whole; readers see the data set when all of it is there.

    ``recipe`` divides the samples into splits (``generate_recipe`` takes the other options from it too). ``part``: one
    part of them, as ``JobPart(2, 8)``, in a place of its own in ``out``; any number of processes may make one each, and
    ``merge`` joins them. ``engine``: this machine, or a Ray cluster as ``ray_engine.ray_cluster`` finds it, for which
    this process writes. ``told`` is called with how far it has come; ``workers`` as ``stored`` takes it; ``log``: a
    file to which ``gcd_dataset.verbs.log`` appends. Stopped at any moment and called again it goes on, by either
    engine; the shards come out as the same bytes. Raises as ``plan``, ``stored`` and ``ray_cluster`` do, and
    ``OutputError`` for a log that cannot be opened.
    """
    config, cluster = config or MakeConfig(), None
    check_count(count)
    if engine not in (known := get_args(Engine)):
        raise ConfigError(f"engine={engine!r:.99}: give {' or '.join(map(repr, known))}")
    options = {"out": str(out), "count": count, "seed": seed, "workers": workers, "engine": engine} | _plain(config)
    options |= {"part": part and str(part), "name": recipe and recipe.name}
    place = {"recipe": recipe, "part": part, "spool": spool, "patience": patience}
    with contextlib.ExitStack() as opened:
        if engine == "ray":
            from gcd_dataset.verbs.ray_engine import ray_cluster

            cluster = opened.enter_context(ray_cluster(config, workers))
            config = cluster.config
        here = cluster is None and config.stage == "drape"
        devices = devices_of(config) if here else ()
        told = opened.enter_context(logged(log, told, options=options, recipe=recipe_of(config), devices=devices))
        if cluster is not None:
            task = _planned(target_of(out, count, seed=seed, config=config, **place), seed, config)  # type: ignore[arg-type]
        else:
            task = plan(out, count, seed=seed, config=config, **place)  # type: ignore[arg-type]
            _tell_wait(task)
        progress, pace = Progress(task.count, task.there), Pace()
        told(progress)
        with contextlib.closing(stored(task, workers=workers, cluster=cluster)) as samples:
            for made in samples:
                rejects = made.rejects if made.index % config.wearers == 0 else ()  # once for each design
                progress = progress.with_sample(rejects=rejects, outcome=made.outcome and made.outcome.name)
                progress = pace.of(progress, added(made.waits, taken()))
                told(progress)
    return progress


def _tell_wait(task: GarmentPlan) -> None:
    if task.config.stage == "drape":
        from gcd_dataset.generator.drape import log_drape_time

        log_drape_time(len(task.missing), task.config.device, task.config.resolution)


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
    with plan.target.filling(is_missing=bool(plan.missing)) as writer:
        for stored, members in waited_for(_made(plan, workers, cluster), WRITER):
            writer.add(stored.index, members, stored.outcome, stored.turned_down)
            yield stored


def _made(
    plan: GarmentPlan, workers: int | None, cluster: "RayCluster | None"
) -> Iterator[tuple[Stored, Mapping[str, Bytes]]]:
    if not plan.missing:
        return iter(())
    if cluster is not None:
        return cluster.produce(plan.seed, plan.missing, finished=_encoded, seconds=_cpu_seconds(plan.config))
    workers = workers_for(plan) if workers is None else workers
    return produce(plan.seed, plan.missing, plan.config, workers=workers, finished=_encoded)


def generate_recipe(
    out: Path | str,
    recipe: Recipe | str,
    *,
    device: str = "auto",
    part: JobPart | None = None,
    workers: int | None = None,
    engine: Engine = "local",
    told: Told = unheard,
    log: Path | str | None = None,
) -> Progress:
    """Have the data set of a recipe in the folder ``out``, with its splits, or one part; gone on with as ``generate``
    does.

    ``recipe``: one of ``find_recipe``, or its name. When all of it is there, by ``merge`` if it is made in parts, the
    manifest gets the hash of its patterns. Raises as ``find_recipe`` and ``generate`` do.
    """
    recipe = recipe if isinstance(recipe, Recipe) else find_recipe(recipe)
    folder, config = require_folder(out, "data sets of recipes"), replace(recipe.config, device=device)
    progress = generate(
        folder,
        recipe.count,
        seed=recipe.seed,
        config=config,
        recipe=recipe,
        part=part,
        workers=workers,
        engine=engine,
        told=told,
        log=log,
    )
    if part is None:
        seal(folder, recipe)
    return progress


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
    return Stored(made.index, made.body_name, made.turned_down, outcome, taken()), members
