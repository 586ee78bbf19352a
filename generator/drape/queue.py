"""Garments that take turns in a batch: one that has come to rest gives its place to the next.

A garment has two turns, its coarse mesh first and then itself, from the shape that the coarse one has come to. What
happens in a turn does not depend on when it begins, nor on who else is in the batch.
"""

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import Self

import numpy as np
from jaxtyping import Bool

from gcd_dataset.generator.drape.arrange import arranged
from gcd_dataset.generator.drape.body_field import HostField
from gcd_dataset.generator.drape.carry import carry_over
from gcd_dataset.generator.drape.coarse_start import go_on_from
from gcd_dataset.generator.drape.config import DrapeConfig, DrapeJob
from gcd_dataset.generator.drape.device import one_at_a_time
from gcd_dataset.generator.drape.holds import Wear
from gcd_dataset.generator.drape.kernels.world import RUNNING
from gcd_dataset.generator.drape.model import build_model
from gcd_dataset.generator.drape.outcome import collect
from gcd_dataset.generator.drape.solver import Solver, nothing
from gcd_dataset.generator.mesh import Coarse, coarse_start
from gcd_dataset.records import Drape

__all__ = ["Readied", "drape_in_turn"]

POLL_EVERY = 4  # frames after which the device is asked which garments still move
IDLE = 0.5  # share of the places that may stand empty while garments wait for one


@dataclass(frozen=True)
class Readied:
    """A garment with what its turns need of the host: worked out by any thread, while others are draped."""

    job: DrapeJob
    field: HostField
    wear: Wear
    coarse_wear: Wear | None
    """That of ``job.coarse``."""

    @classmethod
    def of(cls, job: DrapeJob) -> Self:
        coarse = Wear.of(replace(job, box_mesh=job.coarse.mesh)) if job.coarse else None
        return cls(job, HostField.of(job.body), Wear.of(job), coarse)


def no_more() -> int:
    """How many jobs have arrived that were not there: none."""
    return 0


def drape_in_turn(
    jobs: Iterable[DrapeJob | Readied | None],
    config: DrapeConfig,
    *,
    device: str,
    at_once: int,
    arrived: Callable[[], int] = no_more,
    between: Callable[[], None] = nothing,
) -> Iterator[tuple[int, Drape]]:
    """The number and the drape of each job, in the order in which they come to rest; ``at_once`` share the device.

    ``jobs`` may arrive while others are draped: a ``None`` among them, which counts as no job, says that there is none
    at this moment, and ``arrived`` how many have come since. It ends when all are draped and none is there, or by what
    ``between`` raises, which is called between steps.
    """
    waiting = _Waiting(jobs, config)
    turns = waiting.taken(at_once)
    before = None
    while turns:
        between()
        solver = _begin(turns, before, config, device)
        running = _run(solver, turns, not waiting.ended, partial(_as_fit, arrived, at_once - len(turns)), between)
        frames = solver.state.frames.numpy()
        ended = [k for k in np.flatnonzero(~running).tolist() if turns[k].coarse is None]
        for k, drape in zip(ended, collect(solver, [turns[k].whole for k in ended], ended), strict=True):
            yield turns[k].number, replace(drape, frames=drape.frames + turns[k].frames_before)
        going_on = [turns[k].goes_on(k) for k in np.flatnonzero(running).tolist()]
        refined = [turn.refined(k, int(frames[k])) for k, turn in enumerate(turns) if turn.coarse and not running[k]]
        turns = going_on + refined
        turns += waiting.taken(at_once - len(turns))
        before = solver
    if waiting.failed is not None:
        raise waiting.failed


@dataclass(frozen=True)
class _Turn:
    """A garment's place in a batch: for its coarse mesh first, if it has one, then for itself."""

    number: int
    whole: DrapeJob
    coarse: Coarse | None
    frames_before: int = 0
    """Those of the coarse mesh, once it is done."""
    old_place: int | None = None
    """Its world in the batch before."""
    start_from: Coarse | None = None
    """The coarse mesh in that place, whose shape this turn starts from."""
    known: Readied | None = None
    """What was worked out ahead of its first turn."""
    wear_before: Wear | None = None
    """That of this turn in the batch before."""

    @cached_property
    def wear(self) -> Wear:
        known = self.wear_before
        if known is None and self.known is not None:
            known = self.known.wear if self.coarse is None else self.known.coarse_wear
        return known or Wear.of(self.job)

    @classmethod
    def first(cls, number: int, given: DrapeJob | Readied, config: DrapeConfig) -> Self:
        known = given if isinstance(given, Readied) and not config.curved_start else None
        job = given.job if isinstance(given, Readied) else given
        coarse = (job.coarse or coarse_start(job.box_mesh)) if config.coarse_start else None
        if config.curved_start and coarse:
            coarse = replace(coarse, mesh=arranged(coarse.mesh, job.body))
        elif config.curved_start:
            job = replace(job, box_mesh=arranged(job.box_mesh, job.body))
        return cls(number, job, coarse, known=known)

    @property
    def job(self) -> DrapeJob:
        if self.coarse is None:
            return self.whole
        return replace(self.whole, box_mesh=self.coarse.mesh)

    def goes_on(self, place: int) -> Self:
        """The same turn in the next batch."""
        return replace(self, old_place=place, start_from=None, wear_before=self.wear)

    def refined(self, place: int, frames: int) -> Self:
        """The turn after that of the coarse mesh."""
        return replace(
            self, coarse=None, frames_before=frames, old_place=place, start_from=self.coarse, wear_before=None
        )


def _as_fit(arrived: Callable[[], int], room: int) -> int:
    return min(arrived(), room)


class _Waiting:
    """Garments that have no place yet."""

    def __init__(self, jobs: Iterable[DrapeJob | Readied | None], config: DrapeConfig) -> None:
        self._jobs, self._config, self._count = iter(jobs), config, 0
        self.ended = False
        """Whether the last of them has been taken."""
        self.failed: Exception | None = None
        """What went wrong with the next; told when those before it are draped."""

    def taken(self, room: int) -> list[_Turn]:
        """The next that are there, for so many places."""
        turns: list[_Turn] = []
        while len(turns) < room and not self.ended:
            try:
                job = next(self._jobs)
            except Exception as error:  # noqa: BLE001 - their end, or whatever is wrong with one
                self.ended = True
                self.failed = None if isinstance(error, StopIteration) else error
                break
            if job is None:
                break
            turns.append(_Turn.first(self._count, job, self._config))
            self._count += 1
        return turns


def _begin(turns: Sequence[_Turn], before: Solver | None, config: DrapeConfig, device: str) -> Solver:
    """The next batch, with what it takes over from the one before."""
    with one_at_a_time:
        coarse = [k for k, turn in enumerate(turns) if turn.coarse]
        solver = Solver(
            build_model(
                [turn.job for turn in turns],
                config,
                device,
                coarse=coarse,
                worn=[turn.wear for turn in turns],
                fields=[None if turn.known is None else turn.known.field for turn in turns],
            ),
            config,
        )
        if before is not None:
            places = [(t.old_place, k, t.start_from) for k, t in enumerate(turns) if t.old_place is not None]
            carry_over(before, solver, [(old, new) for old, new, mesh in places if mesh is None])
            go_on_from(before, solver, [(old, new, mesh) for old, new, mesh in places if mesh is not None])
    return solver


def _run(
    solver: Solver,
    turns: Sequence[_Turn],
    any_wait: bool,
    arrived: Callable[[], int],
    between: Callable[[], None],
) -> Bool[np.ndarray, " w"]:
    """Step until nothing moves, or many places stand empty that others wait for; which garments still move."""
    refining = np.array([turn.coarse is not None for turn in turns])
    while True:
        running = solver.state.status.numpy() == RUNNING
        idle = ~running if any_wait else ~running & refining
        if not running.any() or idle.sum() + arrived() >= max(1, IDLE * len(turns)):
            return running
        for _ in range(POLL_EVERY):
            solver.frame(between)
