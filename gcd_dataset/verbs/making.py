"""Making a data set: samples into shards, going on where an earlier run was stopped."""

import math
from collections.abc import Generator, Mapping
from dataclasses import dataclass
from pathlib import Path

from gcd_dataset.errors import ConfigError
from gcd_dataset.files import user_path
from gcd_dataset.generator.maker import produce
from gcd_dataset.generator.recipe import MakeConfig, device_kind, devices_of
from gcd_dataset.records import Outcome, Rejected, Sample
from gcd_dataset.shards import encode_sample
from gcd_dataset.shards.layout import Bytes
from gcd_dataset.shards.parts import require_merged
from gcd_dataset.shards.rejects import RejectLog, has_rejects
from gcd_dataset.shards.unfinished import filling
from gcd_dataset.verbs.parts import Part, PartPlace, begin_part
from gcd_dataset.verbs.plan import Plan, check_count
from gcd_dataset.verbs.progress import Progress, Told, unheard
from gcd_dataset.verbs.storing import GarmentWriter, splits_of

__all__ = ["GarmentPlan", "Stored", "generate", "plan", "stored", "workers_for"]

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

    @property
    def rejects(self) -> tuple[str, ...]:
        """Why earlier attempts were turned down."""
        return tuple(map(str, self.turned_down))


@dataclass(frozen=True)
class GarmentPlan(Plan):
    """Garments to be made."""

    seed: int
    config: MakeConfig
    place: PartPlace | None = None
    """Of a part of a data set; ``out`` is the part's folder then, and ``count`` its samples."""


def plan(
    out: Path | str, count: int, *, seed: int = 0, config: MakeConfig | None = None, part: Part | None = None
) -> GarmentPlan:
    """What it takes to have samples 0 … ``count`` - 1 of ``seed`` in ``out``, or those of one ``part``.

    What a killed run left half-written in ``out`` is put in order. Raises ``ConfigError`` where ``out`` holds a data
    set of another recipe or seed, parts of another plan, or, without ``part``, parts that wait to be merged;
    ``OutputError`` where it cannot be written.
    """
    config = config or MakeConfig()
    check_count(count)
    out = user_path(out)
    if config.stage == "drape":
        from gcd_dataset.generator.drape import resolve_device

        for device in devices_of(config):
            resolve_device(device)  # told before anything is written
    if part is None:
        require_merged(out, ConfigError)
        return GarmentPlan(out, count, _missing(out, range(count), seed, config), seed, config)
    place = begin_part(out, part, count, seed, config)
    missing = () if place.is_merged else _missing(place.folder, place.indices, seed, config)
    return GarmentPlan(place.folder, len(place.indices), missing, seed, config, place)


def _missing(out: Path, indices: range, seed: int, config: MakeConfig) -> tuple[int, ...]:
    with GarmentWriter(out, seed, config) as writer:
        done = writer.done
    return tuple(index for index in indices if index not in done)


def generate(
    out: Path | str,
    count: int,
    *,
    seed: int = 0,
    config: MakeConfig | None = None,
    part: Part | None = None,
    workers: int | None = None,
    told: Told = unheard,
) -> Progress:
    """Have samples 0 … ``count`` - 1 of ``seed`` in the folder ``out``; those that are there are not made again.

    ``part``: one part of them, as ``Part(2, 8)``, in a place of its own in ``out``; any number of processes may make
    one each, and ``merge`` joins them. ``told`` is called with how far it has come; ``workers`` as ``stored`` takes it.
    Stopped at any moment and called again it goes on; the shards come out as the same bytes. Raises as ``plan`` and
    ``stored`` do.
    """
    task = plan(out, count, seed=seed, config=config, part=part)
    if task.config.stage == "drape":
        from gcd_dataset.generator.drape import tell_wait

        tell_wait(len(task.missing), task.config.device, task.config.resolution)
    progress = Progress(task.count, task.there)
    told(progress)
    for made in stored(task, workers=workers):
        progress = progress.with_sample(rejects=made.rejects, outcome=made.outcome and made.outcome.name)
        told(progress)
    return progress


def stored(plan: GarmentPlan, *, workers: int | None = None) -> Generator[Stored, None, None]:
    """Make and store what is missing, telling of each sample once it is stored.

    Stopped at any moment and planned again it goes on; the shards come out as the same bytes. ``workers`` processes
    make samples side by side, by default as ``workers_for`` counts them; on each GPU of the config two more processes
    drape for them. Raises ``OutputError`` where the shards cannot be written, ``GcdError`` where a process is killed.
    """
    workers = workers_for(plan) if workers is None else workers
    if plan.place is not None and not plan.missing and plan.place.is_finished:
        return
    with filling(plan.out, plan.count, *splits_of(plan.config)):
        if plan.missing or not has_rejects(plan.out):
            yield from _stored(plan, workers)
    if plan.place is not None:
        plan.place.finish()


def _stored(plan: GarmentPlan, workers: int) -> Generator[Stored, None, None]:
    with GarmentWriter(plan.out, plan.seed, plan.config) as writer, _reject_log(plan, writer) as rejects:
        if plan.place is not None:
            plan.place.begin()
        indices = plan.missing
        made = produce(plan.seed, indices, plan.config, workers=workers, finished=_encoded) if indices else ()
        for stored, members in made:
            rejects.add(stored.turned_down)
            writer.add(stored.index, members, stored.outcome)
            yield stored


def _reject_log(plan: GarmentPlan, writer: GarmentWriter) -> RejectLog:
    return RejectLog(plan.out, seed=plan.seed, wearers=plan.config.wearers, done=lambda: writer.done)


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
    return Stored(made.index, made.body_name, made.turned_down, outcome), encode_sample(sample)
