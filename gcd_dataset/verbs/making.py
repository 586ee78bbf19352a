"""Generating a data set: samples in shards, with resumption of a stopped run."""

import contextlib
import math
from collections.abc import Generator, Iterator, Mapping
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, get_args

from gcd_dataset.errors import ConfigError
from gcd_dataset.files import user_path
from gcd_dataset.generator.maker import produce
from gcd_dataset.generator.recipe import MakeConfig, device_kind, devices_of, recipe_of
from gcd_dataset.generator.recipes import Recipe, find_recipe
from gcd_dataset.hub.source import Folder, parse_target
from gcd_dataset.records import Outcome, Rejected, Sample
from gcd_dataset.shards import encode_sample
from gcd_dataset.shards.contents import warn_of_others
from gcd_dataset.shards.layout import Bytes
from gcd_dataset.verbs.array_jobs import JobPart
from gcd_dataset.verbs.log import run_log
from gcd_dataset.verbs.making_plan import MakingPlan, check_count
from gcd_dataset.verbs.progress import Pace, Progress, ProgressCallback, ignore_progress
from gcd_dataset.verbs.seal import seal
from gcd_dataset.verbs.target import Target, require_folder, target_of
from gcd_dataset.waits import WRITER, Waits, sum_waits, take_waits, timed

if TYPE_CHECKING:
    from gcd_dataset.verbs.ray_engine import RayCluster

__all__ = [
    "Engine",
    "GarmentPlan",
    "StoredSample",
    "generate",
    "generate_recipe",
    "plan_garments",
    "store_samples",
    "workers_for",
]

Engine = Literal["local", "ray"]

STARTUP = 4.0  # s for a worker to start
CPU_SECONDS = {"pattern": 0.03, "mesh": 0.1, "drape": 0.22}  # worker's CPU time per garment [s], without draping


@dataclass(frozen=True)
class StoredSample:
    """Summary of a sample after it was stored."""

    index: int
    body_name: str
    turned_down: tuple[Rejected, ...]
    """Rejected attempts, in order."""
    outcome: Outcome | None
    """Outcome of the drape; ``None`` at an earlier stage."""
    waits: Waits = field(default_factory=dict)
    """Waits of its worker, and of the draping processes, since the previous sample."""

    @property
    def rejects(self) -> tuple[str, ...]:
        """``rule: reason`` of each rejected attempt."""
        return tuple(map(str, self.turned_down))


@dataclass(frozen=True)
class GarmentPlan(MakingPlan):
    """The missing garments of a data set, or of a part."""

    target: Target
    seed: int
    config: MakeConfig


def plan_garments(
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
    """Plan for samples 0 … ``count`` - 1 of ``seed`` in ``out``, or for the samples of one ``part``.

    ``out``: a folder, or the URL of a store; ``recipe`` divides the samples into splits; ``spool`` and ``patience`` as
    for ``target_of``. Repairs shards that a killed run left unfinished. Raises ``ConfigError`` if ``out`` holds a data
    set of another recipe or seed, parts of another plan, or, without ``part``, parts that are not merged;
    ``OutputError`` if it cannot be written, ``RemoteError`` for a store that does not answer, or refuses.
    """
    config = config or MakeConfig()
    check_count(count)
    if config.stage == "drape":
        from gcd_dataset.generator.drape import resolve_device

        for device in devices_of(config):
            resolve_device(device)  # raises before anything is written
    return _plan(
        target_of(out, count, seed=seed, config=config, recipe=recipe, part=part, spool=spool, patience=patience),
        seed,
        config,
    )


def _plan(target: Target, seed: int, config: MakeConfig) -> GarmentPlan:
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
    on_progress: ProgressCallback = ignore_progress,
    log: Path | str | None = None,
) -> Progress:
    """Generate samples 0 … ``count`` - 1 of ``seed`` in ``out``; samples that it already holds are not made again.

    out
        A folder, or the URL of a store: ``s3://BUCKET/PREFIX`` or any other of ``fsspec``. Shards of a store are filled
        in the folder ``spool`` and uploaded when full; readers see the data set when it is complete.
    recipe
        Divides the samples into splits; its other options are not applied (``generate_recipe`` applies them).
    part
        Make one part only, such as ``JobPart(2, 8)``, in its own subfolder of ``out``. Parts may be made by any number
        of processes at the same time; ``merge`` joins them.
    workers
        Worker processes, as for ``store_samples``.
    engine
        This machine, or the Ray cluster that ``ray_engine.ray_cluster`` finds; this process writes in both cases.
    spool, patience
        As for ``target_of``.
    on_progress
        Called with the progress before the first sample and after each.
    log
        A file to which ``gcd_dataset.verbs.log`` appends.

    A stopped call can be repeated, with either engine; the bytes of the shards do not depend on interruptions. Raises
    as ``plan_garments``, ``store_samples`` and ``ray_cluster`` do, and ``OutputError`` for a log that cannot be opened.
    """
    config, cluster = config or MakeConfig(), None
    check_count(count)
    if engine not in (known := get_args(Engine)):
        raise ConfigError(f"engine={engine!r:.99}: give {' or '.join(map(repr, known))}")
    options = {"out": str(out), "count": count, "seed": seed, "workers": workers, "engine": engine} | _as_json(config)
    options |= {"part": part and str(part), "name": recipe and recipe.name}
    if isinstance(folder := parse_target(out), Folder):
        warn_of_others(user_path(folder.path))
    target = {"recipe": recipe, "part": part, "spool": spool, "patience": patience}
    with contextlib.ExitStack() as opened:
        if engine == "ray":
            from gcd_dataset.verbs.ray_engine import ray_cluster

            cluster = opened.enter_context(ray_cluster(config, workers))
            config = cluster.config
        drapes_here = cluster is None and config.stage == "drape"
        devices = devices_of(config) if drapes_here else ()
        logging = run_log(log, on_progress, options=options, recipe=recipe_of(config), devices=devices)
        on_progress = opened.enter_context(logging)
        if cluster is not None:
            plan = _plan(target_of(out, count, seed=seed, config=config, **target), seed, config)  # type: ignore[arg-type]
        else:
            plan = plan_garments(out, count, seed=seed, config=config, **target)  # type: ignore[arg-type]
            _log_drape_estimate(plan)
        progress, pace = Progress(plan.count, plan.existing), Pace()
        on_progress(progress)
        with contextlib.closing(store_samples(plan, workers=workers, cluster=cluster)) as samples:
            for sample in samples:
                rejects = sample.rejects if sample.index % config.wearers == 0 else ()  # once for each design
                progress = progress.with_sample(rejects=rejects, outcome=sample.outcome and sample.outcome.name)
                progress = pace.of(progress, sum_waits(sample.waits, take_waits()))
                on_progress(progress)
    return progress


def _log_drape_estimate(plan: GarmentPlan) -> None:
    if plan.config.stage == "drape":
        from gcd_dataset.generator.drape import log_drape_time

        log_drape_time(len(plan.missing), plan.config.device, plan.config.resolution)


def _as_json(config: MakeConfig) -> dict[str, Any]:
    """The options as a JSON object."""
    return {entry.name: getattr(config, entry.name) for entry in fields(config)} | {"design": config.design.to_dict()}


def store_samples(
    plan: GarmentPlan, *, workers: int | None = None, cluster: "RayCluster | None" = None
) -> Generator[StoredSample, None, None]:
    """Make and store the missing samples, yielding a summary of each one after it is stored.

    ``workers``: processes that make samples, by default ``workers_for(plan)``; on each GPU of the config two draping
    processes serve them. With a ``cluster`` its nodes make the samples instead. The bytes of the shards depend neither
    on these nor on interruptions. Raises ``OutputError`` if the shards cannot be written, ``GcdError`` if a process is
    killed.
    """
    with plan.target.writing(is_missing=bool(plan.missing)) as writer:
        for sample, members in timed(_make(plan, workers, cluster), WRITER):
            writer.add(sample.index, members, sample.outcome, sample.turned_down)
            yield sample


def _make(
    plan: GarmentPlan, workers: int | None, cluster: "RayCluster | None"
) -> Iterator[tuple[StoredSample, Mapping[str, Bytes]]]:
    if not plan.missing:
        return iter(())
    if cluster is not None:
        return cluster.produce(plan.seed, plan.missing, finished=_encode, seconds=_cpu_seconds(plan.config))
    workers = workers_for(plan) if workers is None else workers
    return produce(plan.seed, plan.missing, plan.config, workers=workers, finished=_encode)


def generate_recipe(
    out: Path | str,
    recipe: Recipe | str,
    *,
    device: str = "auto",
    part: JobPart | None = None,
    workers: int | None = None,
    engine: Engine = "local",
    on_progress: ProgressCallback = ignore_progress,
    log: Path | str | None = None,
) -> Progress:
    """Generate the data set of a recipe in the folder ``out``, with its splits, or one part of it.

    ``recipe``: a recipe of ``find_recipe``, or its name. The other options, and resumption, as for ``generate``. When
    the data set is complete, the hash of its patterns is written to the manifest; ``merge`` does so for parts. Raises
    as ``find_recipe`` and ``generate`` do.
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
        on_progress=on_progress,
        log=log,
    )
    if part is None:
        seal(folder, recipe)
    return progress


def workers_for(plan: GarmentPlan) -> int:
    """The fastest number of processes: one for each core, fewer for a short plan."""
    from gcd_dataset.generator.drape.device import cores

    worthwhile = int(_cpu_seconds(plan.config) * len(plan.missing) / STARTUP)
    return min(cores(), worthwhile, math.ceil(len(plan.missing) / plan.config.wearers))


def _cpu_seconds(config: MakeConfig) -> float:
    """CPU time of a worker for one garment [s], draping included if it runs on the CPU."""
    from gcd_dataset.generator.drape import seconds_per_garment

    each = CPU_SECONDS[config.stage]
    if config.stage == "drape" and device_kind(config) == "cpu":
        each += seconds_per_garment("cpu", config.resolution)
    return each


def _encode(sample: Sample) -> tuple[StoredSample, Mapping[str, Bytes]]:
    provenance, outcome = sample.provenance, None if sample.drape is None else sample.drape.outcome
    members = encode_sample(sample)
    return StoredSample(provenance.index, provenance.body_name, provenance.turned_down, outcome, take_waits()), members
