"""Generating a body set: people in shards, with resumption of a stopped run."""

from collections.abc import Generator, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from gcd_dataset.bodies import Person
from gcd_dataset.errors import ConfigError
from gcd_dataset.files import user_path
from gcd_dataset.generator.drape.device import cores
from gcd_dataset.generator.people import make_person, model_mesh, people_recipe
from gcd_dataset.generator.recipe import versions
from gcd_dataset.shards.body_set import BodyWriter
from gcd_dataset.shards.contents import warn_of_others
from gcd_dataset.shards.job_parts import require_merged
from gcd_dataset.shards.unfinished import filling
from gcd_dataset.verbs.log import run_log
from gcd_dataset.verbs.making_plan import MakingPlan, check_count
from gcd_dataset.verbs.progress import Pace, Progress, ProgressCallback, ignore_progress
from gcd_dataset.verbs.target import require_folder
from gcd_dataset.waits import WRITER, take_waits, timed
from gcd_dataset.workers import parallel_map_chunks

__all__ = ["PeoplePlan", "generate_people", "plan_people", "store_people", "workers_for"]

CHUNK = 16  # people per task: a quarter of a second of work, 10 MB of results
CPU_SECONDS = 0.016  # CPU time per body [s]
STARTUP = 4.0  # s for a worker to start


@dataclass(frozen=True)
class PeoplePlan(MakingPlan):
    """The missing people of a body set."""

    out: Path
    seed: int
    bodies: str = "random"


def plan_people(out: Path | str, count: int, *, seed: int = 0, bodies: str = "random") -> PeoplePlan:
    """Plan for people 0 … ``count`` - 1 of ``seed``, drawn from group ``bodies``, in the folder ``out``.

    Repairs shards that a killed run left unfinished. Raises ``ConfigError`` for an unknown group, or if ``out`` holds
    bodies of another group or seed, ``ShardError`` if it holds garments, ``OutputError`` if it cannot be written.
    """
    check_count(count)
    people_recipe(bodies)
    folder = require_folder(out, "bodies")
    require_merged(user_path(folder), ConfigError)
    with _writer(folder, seed, bodies) as writer:
        done = writer.done
    return PeoplePlan(count, tuple(index for index in range(count) if index not in done), folder, seed, bodies)


def generate_people(
    out: Path | str,
    count: int,
    *,
    seed: int = 0,
    bodies: str = "random",
    workers: int | None = None,
    on_progress: ProgressCallback = ignore_progress,
    log: Path | str | None = None,
) -> Progress:
    """Generate people 0 … ``count`` - 1 of ``seed`` in the folder ``out``, in two poses, with their measures.

    ``bodies``: the group they are drawn from: ``random`` (women and men), ``female``, ``male`` or ``pooled``.
    People that the folder already holds are not made again, so a stopped call can be repeated. ``workers``,
    ``on_progress`` and ``log`` as for ``generate``. Raises as ``plan_people`` and ``store_people`` do, and
    ``OutputError`` for a log that cannot be opened.
    """
    recipe = people_recipe(bodies)
    options = {"out": str(out), "count": count, "seed": seed, "workers": workers, **recipe}
    warn_of_others(user_path(require_folder(out, "bodies")))
    with run_log(log, on_progress, options=options, recipe=recipe) as on_progress:
        task = plan_people(out, count, seed=seed, bodies=bodies)
        progress, pace = Progress(count, task.existing), Pace()
        on_progress(progress)
        for _ in store_people(task, workers=workers_for(task, cores()) if workers is None else workers):
            progress = pace.of(progress.with_sample(), take_waits())
            on_progress(progress)
    return progress


def workers_for(plan: PeoplePlan, cores: int) -> int:
    """The fastest number of processes: one for each core, fewer for a short plan."""
    return min(cores, int(CPU_SECONDS * len(plan.missing) / STARTUP))


def store_people(plan: PeoplePlan, *, workers: int = 0) -> Generator[Person, None, None]:
    """Make and store the missing people, yielding each one after it is stored.

    The bytes of the shards depend neither on ``workers`` nor on interruptions. Raises ``OutputError`` if the shards
    cannot be written, ``GcdError`` if a worker is killed.
    """
    with filling(plan.out, plan.count):
        if not plan.missing:
            return
        with _writer(plan.out, plan.seed, plan.bodies) as writer:
            for index, person in zip(plan.missing, timed(_made(plan, workers), WRITER), strict=True):
                writer.write(index, person)
                yield person


def _writer(out: Path | str, seed: int, bodies: str) -> BodyWriter:
    return BodyWriter(out, model_mesh(), seed=seed, recipe=people_recipe(bodies), versions=versions())


def _made(plan: PeoplePlan, workers: int) -> Iterator[Person]:
    return parallel_map_chunks(partial(_make, plan.bodies, plan.seed), plan.missing, workers, chunk=CHUNK)


def _make(bodies: str, seed: int, indices: Sequence[int]) -> list[Person]:
    return [make_person(seed, index, bodies=bodies) for index in indices]
