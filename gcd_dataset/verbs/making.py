"""Making a data set: samples into shards, going on where an earlier run was stopped."""

import contextlib
import math
from collections.abc import Generator, Mapping
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import Any

from gcd_dataset.generator.maker import produce
from gcd_dataset.generator.recipe import MakeConfig, device_kind, devices_of, recipe_of
from gcd_dataset.generator.recipes import Recipe, find_recipe
from gcd_dataset.records import Outcome, Rejected, Sample
from gcd_dataset.shards import encode_sample
from gcd_dataset.shards.layout import Bytes
from gcd_dataset.verbs.log import logged
from gcd_dataset.verbs.parts import Part
from gcd_dataset.verbs.plan import Plan, check_count
from gcd_dataset.verbs.progress import Pace, Progress, Told, unheard
from gcd_dataset.verbs.seal import seal
from gcd_dataset.verbs.target import Target, require_folder, target_of
from gcd_dataset.waits import WRITER, Waits, added, taken, waited_for

__all__ = ["GarmentPlan", "Stored", "generate", "generate_recipe", "plan", "stored", "workers_for"]

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
class GarmentPlan(Plan):
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
    part: Part | None = None,
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
    target = target_of(out, count, seed=seed, config=config, recipe=recipe, part=part, spool=spool, patience=patience)
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
    part: Part | None = None,
    workers: int | None = None,
    spool: Path | str | None = None,
    patience: float | None = None,
    told: Told = unheard,
    log: Path | str | None = None,
) -> Progress:
    """Have samples 0 … ``count`` - 1 of ``seed`` in the folder ``out``; those that are there are not made again.

    ``out`` may be the URL of a store, ``s3://BUCKET/PREFIX`` or any other of ``fsspec``: shards fill in ``spool`` and
    go up one by one, whole; readers see the data set when all of it is there.

    ``recipe`` divides the samples into splits (``generate_recipe`` takes the other options from it too). ``part``: one
    part of them, as ``Part(2, 8)``, in a place of its own in ``out``; any number of processes may make one each, and
    ``merge`` joins them. ``told`` is called with how far it has come; ``workers`` as ``stored`` takes it; ``log``: a
    file to which ``gcd_dataset.verbs.log`` appends. Stopped at any moment and called again it goes on; the shards come
    out as the same bytes. Raises as ``plan`` and ``stored`` do, and ``OutputError`` for a log that cannot be opened.
    """
    config = config or MakeConfig()
    options = {"out": str(out), "count": count, "seed": seed, "workers": workers} | _plain(config)
    options |= {"part": part and str(part), "name": recipe and recipe.name}
    devices = devices_of(config) if config.stage == "drape" else ()
    with logged(log, told, options=options, recipe=recipe_of(config), devices=devices) as told:
        task = plan(out, count, seed=seed, config=config, recipe=recipe, part=part, spool=spool, patience=patience)
        if config.stage == "drape":
            from gcd_dataset.generator.drape import tell_wait

            tell_wait(len(task.missing), config.device, config.resolution)
        progress, pace = Progress(task.count, task.there), Pace()
        told(progress)
        with contextlib.closing(stored(task, workers=workers)) as samples:
            for made in samples:
                progress = progress.with_sample(rejects=made.rejects, outcome=made.outcome and made.outcome.name)
                progress = pace.of(progress, added(made.waits, taken()))
                told(progress)
    return progress


def _plain(config: MakeConfig) -> dict[str, Any]:
    """The options as JSON takes them."""
    return {entry.name: getattr(config, entry.name) for entry in fields(config)} | {"design": config.design.to_dict()}


def stored(plan: GarmentPlan, *, workers: int | None = None) -> Generator[Stored, None, None]:
    """Make and store what is missing, telling of each sample once it is stored.

    Stopped at any moment and planned again it goes on; the shards come out as the same bytes. ``workers`` processes
    make samples side by side, by default as ``workers_for`` counts them; on each GPU of the config two more processes
    drape for them. Raises ``OutputError`` where the shards cannot be written, ``GcdError`` where a process is killed.
    """
    workers = workers_for(plan) if workers is None else workers
    with plan.target.filling(is_missing=bool(plan.missing)) as writer:
        indices = plan.missing
        made = produce(plan.seed, indices, plan.config, workers=workers, finished=_encoded) if indices else iter(())
        for stored, members in waited_for(made, WRITER):
            writer.add(stored.index, members, stored.outcome, stored.turned_down)
            yield stored


def generate_recipe(
    out: Path | str,
    recipe: Recipe | str,
    *,
    device: str = "auto",
    part: Part | None = None,
    workers: int | None = None,
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
        told=told,
        log=log,
    )
    if part is None:
        seal(folder, recipe)
    return progress


def workers_for(plan: GarmentPlan) -> int:
    """The processes that make samples soonest: one for each core, or fewer where there is little to do."""
    from gcd_dataset.generator.drape import seconds_per_garment
    from gcd_dataset.generator.drape.device import cores

    each = MADE[plan.config.stage]
    if plan.config.stage == "drape" and device_kind(plan.config) == "cpu":
        each += seconds_per_garment("cpu", plan.config.resolution)
    return min(cores(), int(each * len(plan.missing) / BEGUN), math.ceil(len(plan.missing) / plan.config.wearers))


def _encoded(sample: Sample) -> tuple[Stored, Mapping[str, Bytes]]:
    made, outcome = sample.provenance, None if sample.drape is None else sample.drape.outcome
    members = encode_sample(sample)
    return Stored(made.index, made.body_name, made.turned_down, outcome, taken()), members
