"""Generating garments, the data set of a seed and a config or of a recipe, and people."""

import contextlib
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any, Literal, get_args

from gcd_dataset.errors import ConfigError
from gcd_dataset.generator.body.by_name import make_person, model_mesh, people_recipe
from gcd_dataset.generator.maker import produce
from gcd_dataset.generator.recipe import MakeConfig, device_kind, devices_of, recipe_of, versions
from gcd_dataset.generator.recipes import Recipe, find_recipe
from gcd_dataset.making.progress import Progress, ProgressCallback, ignore_progress
from gcd_dataset.making.run import Made, MakeShards, Wanted, make_shards, run
from gcd_dataset.making.store import place_for
from gcd_dataset.making.tasks import Job, Work, check_count
from gcd_dataset.outfits import joined
from gcd_dataset.records import MISFITS, Outcome, Sample
from gcd_dataset.shards import encode_sample
from gcd_dataset.shards.body_set import encode_person, mesh_bytes
from gcd_dataset.shards.layout import BODIES, GARMENTS, TRAIN, mesh_name
from gcd_dataset.shards.manifest import Plan
from gcd_dataset.workers import parallel_map_chunks

Engine = Literal["local", "ray"]

STARTUP = 4.0  # s for a worker to start
CPU_SECONDS: Mapping[str, float] = {"body": 0.016, "pattern": 0.03, "mesh": 0.1, "drape": 0.22}
"""Stage to a worker's CPU time per sample [s], without draping."""
CHUNK = 16  # people per task of a worker: a quarter of a second of work, 10 MB of results


def generate(
    out: Path | str,
    count: int,
    *,
    seed: int = 0,
    config: MakeConfig | None = None,
    job: Job | None = None,
    workers: int | None = None,
    engine: Engine = "local",
    on_progress: ProgressCallback = ignore_progress,
    log: Path | str | None = None,
) -> Progress:
    """Generate samples 0 … ``count`` - 1 of ``seed`` in ``out``; samples that it already holds are not made again.

    out
        A folder, or the URL of a store: ``s3://BUCKET/PREFIX`` or any other of ``fsspec``.
    job
        Make every N-th shard only, such as those of ``Job(2, 8)``. Jobs may run at the same time, on any machines; the
        last one to finish writes manifest and index.
    workers
        Processes that make samples, by default ``workers_for``; on each GPU of the config two draping processes serve
        them. With engine ``ray`` the number of shards in work at a time.
    engine
        This machine, or the Ray cluster that ``making.ray`` finds.
    on_progress
        Called with the progress before the first sample and after each.
    log
        A file to which ``gcd_dataset.making.log`` appends.

    A stopped call can be repeated, with either engine; the bytes of the shards do not depend on stops, ``workers`` and
    ``job``. Raises ``ConfigError`` if ``out`` holds another data set, ``OutputError`` if it cannot be written,
    ``GcdError`` if a process is killed.
    """
    splits, config = {TRAIN: range(check_count(count))}, config or MakeConfig()
    options = {"job": job, "workers": workers, "engine": engine, "on_progress": on_progress, "log": log}
    return _generate(out, splits, seed, config, None, **options)


def generate_recipe(
    out: Path | str,
    recipe: Recipe | str,
    *,
    device: str = "auto",
    job: Job | None = None,
    workers: int | None = None,
    engine: Engine = "local",
    on_progress: ProgressCallback = ignore_progress,
    log: Path | str | None = None,
) -> Progress:
    """Generate the data set of a recipe, with its splits, in the folder or store ``out``.

    ``recipe``: a recipe of ``find_recipe``, or its name. The other options, resumption and errors as for ``generate``;
    raises as ``find_recipe`` does, too. The manifest names the recipe, with the hash of all patterns.
    """
    recipe = recipe if isinstance(recipe, Recipe) else find_recipe(recipe)
    splits = {split: recipe.indices_in(split).tolist() for split in recipe.splits}
    config, named = replace(recipe.config, device=device), (recipe.name, recipe.sha256)
    options = {"job": job, "workers": workers, "engine": engine, "on_progress": on_progress, "log": log}
    return _generate(out, splits, recipe.seed, config, named, **options)


def _generate(
    out: Path | str,
    splits: Mapping[str, Sequence[int]],
    seed: int,
    config: MakeConfig,
    named: tuple[str, str] | None,
    **given: Any,
) -> Progress:
    """``named``: name and SHA-256 of the recipe; ``given``: the other options of ``generate``."""
    workers, engine = given["workers"], given["engine"]
    if engine not in (known := get_args(Engine)):
        raise ConfigError(f"engine={engine!r:.99}: give {' or '.join(map(repr, known))}")
    options = {"workers": workers, "engine": engine}
    with contextlib.ExitStack() as opened:
        make: MakeShards = make_shards
        devices: tuple[str, ...] = ()
        if engine == "ray":
            from gcd_dataset.making.ray import ray_cluster

            config, make = opened.enter_context(ray_cluster(config, workers))
            workers = 0
        elif config.stage == "drape":
            from gcd_dataset.generator.drape import resolve_device

            devices = devices_of(config)
            for device in devices:
                resolve_device(device)  # raises for one that is missing, before anything is written
        plan = Plan(GARMENTS.kind, seed, recipe_of(config), sum(map(len, splits.values())), 1, named=named)
        work = Work(place_for(out), plan, splits, config.wearers)
        maker = partial(make_garments, seed, config, workers, named is not None)
        run_options = {"job": given["job"], "log": given["log"], "options": options, "devices": devices}
        return run(work, maker, engine=make, on_progress=given["on_progress"], **run_options)


def make_garments(
    seed: int, config: MakeConfig, workers: int | None, keeps_all: bool, wanted: Wanted, **options: Any
) -> Iterator[Made]:
    """Make the missing garments of tasks.

    ``keeps_all``: failed drapes stay in their split; ``options``: of ``produce``.
    """
    indices = [index for _, left in wanted for index in left]
    if not indices:
        return iter(())
    if config.stage == "drape" and not options:
        from gcd_dataset.generator.drape import log_drape_time

        log_drape_time(len(indices), config.device, config.resolution)
    processes = workers_for(config, len(indices)) if workers is None else workers
    finished = partial(encoded, config, keeps_all)
    return produce(seed, indices, config, workers=processes, finished=finished, **options)


def encoded(config: MakeConfig, keeps_all: bool, sample: Sample) -> Made:
    """A sample, encoded for its shard. Raises ``ShardError`` where the format cannot hold it."""
    made, drape = sample.provenance, joined(sample).drape
    outcome = None if drape is None else drape.outcome
    fits = {None, Outcome.SETTLED} | (MISFITS if sample.fit else frozenset())
    failed = outcome not in fits and not keeps_all
    rejects = tuple(map(str, made.turned_down)) if made.index % config.wearers == 0 else ()  # once for each design
    name = None if outcome is None else outcome.name
    return Made(made.index, encode_sample(sample, garments=config.most_garments), "", failed, rejects, name)


def workers_for(config: MakeConfig, count: int) -> int:
    """The fastest number of processes to make ``count`` samples: one for each core, fewer for a small number."""
    from gcd_dataset.generator.device import cores
    from gcd_dataset.generator.drape import seconds_per_garment

    seconds = CPU_SECONDS[config.stage]
    if config.stage == "drape" and device_kind(config) == "cpu":
        seconds += seconds_per_garment("cpu", config.resolution)
    return min(cores(), int(seconds * count / STARTUP), math.ceil(count / config.wearers))


def generate_people(
    out: Path | str,
    count: int,
    *,
    seed: int = 0,
    bodies: str = "random",
    job: Job | None = None,
    workers: int | None = None,
    on_progress: ProgressCallback = ignore_progress,
    log: Path | str | None = None,
) -> Progress:
    """Generate people 0 … ``count`` - 1 of ``seed`` in ``out``, in two poses, with their measures.

    ``bodies``: the group they are drawn from: ``random`` (women and men), ``female``, ``male`` or ``pooled``. The other
    options, resumption and errors as for ``generate``; raises ``ConfigError`` for an unknown group, too.
    """
    check_count(count)
    mesh = model_mesh()
    recipe = {**people_recipe(bodies), "mesh": mesh.sha256}
    plan, files = Plan(BODIES.kind, seed, recipe, count, 1), {mesh_name(TRAIN): mesh_bytes(mesh)}
    work = Work(place_for(out), plan, {TRAIN: range(count)}, files=files)
    maker = partial(_make_people, seed, bodies, recipe, workers)
    return run(work, maker, job=job, on_progress=on_progress, log=log, options={"workers": workers})


def _make_people(seed: int, bodies: str, recipe: dict[str, Any], workers: int | None, wanted: Wanted) -> Iterator[Made]:
    from gcd_dataset.generator.device import cores

    indices = [index for _, left in wanted for index in left]
    processes = min(cores(), int(CPU_SECONDS["body"] * len(indices) / STARTUP)) if workers is None else workers
    return parallel_map_chunks(partial(_make_chunk, seed, bodies, recipe), indices, processes, chunk=CHUNK)


def _make_chunk(seed: int, bodies: str, recipe: dict[str, Any], indices: Sequence[int]) -> list[Made]:
    origin = {"seed": seed, "versions": versions()}
    people = ((index, make_person(seed, index, bodies=bodies)) for index in indices)
    return [
        Made(index, encode_person(person, {**origin, "index": index, "recipe": recipe})) for index, person in people
    ]
