"""Making a body set: people into shards, going on where an earlier run was stopped."""

from collections.abc import Generator, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from gcd_dataset.bodies import Person
from gcd_dataset.errors import ConfigError
from gcd_dataset.files import user_path
from gcd_dataset.generator.drape.device import cores
from gcd_dataset.generator.people import PEOPLE_RECIPE, make_person, model_mesh
from gcd_dataset.generator.recipe import versions
from gcd_dataset.shards.body_set import BodyWriter
from gcd_dataset.shards.job_parts import require_merged
from gcd_dataset.shards.unfinished import filling
from gcd_dataset.verbs.log import logged
from gcd_dataset.verbs.making_plan import MakingPlan, check_count
from gcd_dataset.verbs.progress import Pace, Progress, Told, unheard
from gcd_dataset.verbs.target import require_folder
from gcd_dataset.waits import WRITER, taken, waited_for
from gcd_dataset.workers import side_by_side_in_parts

__all__ = ["PeoplePlan", "generate_people", "plan_people", "stored_people", "workers_for"]

AT_ONCE = 16  # people a task: a quarter of a second of work, 10 MB to be sent back
MADE = 0.016  # CPU-s of a person
BEGUN = 4.0  # s that a worker takes to start


@dataclass(frozen=True)
class PeoplePlan(MakingPlan):
    """A body set to be made."""

    out: Path
    seed: int


def plan_people(out: Path | str, count: int, *, seed: int = 0) -> PeoplePlan:
    """What it takes to have people 0 … ``count`` - 1 of ``seed`` in ``out``.

    What a killed run left half-written in ``out`` is put in order. Raises ``ConfigError`` where ``out`` holds bodies of
    another seed, ``ShardError`` where it holds garments, ``OutputError`` where it cannot be written.
    """
    check_count(count)
    folder = require_folder(out, "bodies")
    require_merged(user_path(folder), ConfigError)
    with _writer(folder, seed) as writer:
        done = writer.done
    return PeoplePlan(count, tuple(index for index in range(count) if index not in done), folder, seed)


def generate_people(
    out: Path | str,
    count: int,
    *,
    seed: int = 0,
    workers: int | None = None,
    told: Told = unheard,
    log: Path | str | None = None,
) -> Progress:
    """Have people 0 … ``count`` - 1 of ``seed`` in the folder ``out``, in two poses, with their measures.

    ``told`` is called with how far it has come; ``workers`` and ``log`` as ``generate`` takes them. Stopped and called
    again it goes on. Raises as ``plan_people`` and ``stored_people`` do, and ``OutputError`` for a log that cannot
    be opened.
    """
    options = {"out": str(out), "count": count, "seed": seed, "workers": workers, "stage": "body"}
    with logged(log, told, options=options, recipe=PEOPLE_RECIPE) as told:
        task = plan_people(out, count, seed=seed)
        progress, pace = Progress(count, task.there), Pace()
        told(progress)
        for _ in stored_people(task, workers=workers_for(task, cores()) if workers is None else workers):
            progress = pace.of(progress.with_sample(), taken())
            told(progress)
    return progress


def workers_for(plan: PeoplePlan, cores: int) -> int:
    """The processes that make people soonest: one for each core, or fewer where there is little to do."""
    return min(cores, int(MADE * len(plan.missing) / BEGUN))


def stored_people(plan: PeoplePlan, *, workers: int = 0) -> Generator[Person, None, None]:
    """Make and store who is missing, yielding each person once stored.

    Stopped at any moment and planned again it goes on; the shards come out as the same bytes, for any ``workers``.
    Raises ``OutputError`` where the shards cannot be written, ``GcdError`` where a process is killed.
    """
    with filling(plan.out, plan.count):
        if not plan.missing:
            return
        with _writer(plan.out, plan.seed) as writer:
            made = waited_for(_made(plan, workers), WRITER)
            for index, person in zip(plan.missing, made, strict=True):
                writer.write(index, person)
                yield person


def _writer(out: Path | str, seed: int) -> BodyWriter:
    return BodyWriter(out, model_mesh(), seed=seed, recipe=PEOPLE_RECIPE, versions=versions())


def _made(plan: PeoplePlan, workers: int) -> Iterator[Person]:
    return side_by_side_in_parts(partial(_make, plan.seed), plan.missing, workers, at_once=AT_ONCE)


def _make(seed: int, indices: Sequence[int]) -> list[Person]:
    return [make_person(seed, index) for index in indices]
