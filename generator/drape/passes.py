"""The passes of a garment: first its coarse mesh, then the fine mesh from the coarse drape's shape.

A garment whose coarse mesh slid off starts its fine pass from the placed panels. A garment that crosses itself or the
body at rest is draped again, sewn more slowly. The result of a pass depends neither on the time at which it begins nor
on the other garments in the batch.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Self

from gcd_dataset.generator.drape.body_field import HostField, host_field
from gcd_dataset.generator.drape.carry import carry_over
from gcd_dataset.generator.drape.coarse_start import start_from_coarse
from gcd_dataset.generator.drape.config import DrapeConfig, DrapeJob
from gcd_dataset.generator.drape.device import launch_lock
from gcd_dataset.generator.drape.holds import BodyConstraints
from gcd_dataset.generator.drape.model import build_model
from gcd_dataset.generator.drape.solver import Solver
from gcd_dataset.generator.dressing.sewing_start import sewing_start
from gcd_dataset.generator.mesh import CoarseMesh, coarse_start
from gcd_dataset.records import Drape


@dataclass(frozen=True)
class PreparedJob:
    """A job with its precomputed host data, which any thread may prepare while other garments drape."""

    job: DrapeJob
    field: HostField
    constraints: BodyConstraints
    coarse_constraints: BodyConstraints | None
    """The constraints of ``job.coarse``."""

    @classmethod
    def of(cls, job: DrapeJob) -> Self:
        coarse = BodyConstraints.of(replace(job, box_mesh=job.coarse.mesh)) if job.coarse else None
        return cls(job, host_field(job.body), BodyConstraints.of(job), coarse)


@dataclass(frozen=True)
class Pass:
    """A garment in a batch: in its coarse pass, if it has a coarse mesh, or in its fine pass."""

    number: int
    fine: DrapeJob
    coarse: CoarseMesh | None
    """The coarse mesh in the coarse pass; None in the fine pass."""
    constraints: BodyConstraints
    """The constraints of ``job``."""
    prepared: PreparedJob | None = None
    coarse_frames: int = 0
    """In the fine pass: the frames that the coarse pass took."""
    previous_world: int | None = None
    """The garment's world in the previous batch."""
    refined_from: CoarseMesh | None = None
    """The coarse mesh in that world, if this is the first batch of the fine pass."""
    begun_with: CoarseMesh | None = None
    """The coarse mesh of the garment's first pass, if it has one."""
    earlier: tuple[Drape, ...] = ()
    """The drapes of the garment before this pass, none of them free of crossings."""

    @classmethod
    def first(cls, number: int, given: DrapeJob | PreparedJob, config: DrapeConfig) -> Self:
        prepared = given if isinstance(given, PreparedJob) else None
        job = given.job if isinstance(given, PreparedJob) else given
        coarse = (job.coarse or coarse_start(job.box_mesh)) if config.coarse_start else None
        constraints = _constraints(job, coarse, prepared)
        if config.sewing_start:
            mesh = coarse.mesh if coarse else job.box_mesh
            known = job.start if (job.coarse is None) == (coarse is None) else None
            mesh = replace(mesh, vertices=sewing_start(mesh, job.body) if known is None else known)
            coarse, job = (replace(coarse, mesh=mesh), job) if coarse else (None, replace(job, box_mesh=mesh))
        return cls(number, job, coarse, constraints, prepared, begun_with=coarse)

    @property
    def job(self) -> DrapeJob:
        """The job of this pass: with the coarse mesh, or with the fine mesh."""
        return _job(self.fine, self.coarse)

    def sewing_time(self, config: DrapeConfig) -> float:
        """The time over which the seams close in this pass [s]: doubled with each earlier drape."""
        return config.sewing_time * 2.0 ** len(self.earlier)

    def again(self, drape: Drape) -> Self:
        """The first pass of the garment's next drape, after ``drape``."""
        return type(self)(
            self.number,
            self.fine,
            self.begun_with,
            _constraints(self.fine, self.begun_with, self.prepared),
            self.prepared,
            begun_with=self.begun_with,
            earlier=(*self.earlier, drape),
        )

    def continued(self, world: int) -> Self:
        """The same pass in the next batch; ``world``: the world of the garment in the present batch."""
        return replace(self, previous_world=world, refined_from=None)

    def restarted(self, frames: int, config: DrapeConfig) -> Self:
        """The fine pass from the placed panels, after a coarse pass of ``frames`` frames that slid off the body."""
        return replace(
            self,
            fine=_sewn_from_panels(self.fine) if config.sewing_start else self.fine,
            coarse=None,
            constraints=_constraints(self.fine, None, self.prepared),
            coarse_frames=frames,
            previous_world=None,
            refined_from=None,
        )

    def refined(self, world: int, frames: int) -> Self:
        """The fine pass after a coarse pass of ``frames`` frames in ``world``."""
        return replace(
            self,
            coarse=None,
            constraints=_constraints(self.fine, None, self.prepared),
            coarse_frames=frames,
            previous_world=world,
            refined_from=self.coarse,
        )


def _sewn_from_panels(job: DrapeJob) -> DrapeJob:
    """The job with the start positions of ``sewing_start`` in its box mesh."""
    return replace(job, box_mesh=replace(job.box_mesh, vertices=sewing_start(job.box_mesh, job.body)))


def _job(fine: DrapeJob, coarse: CoarseMesh | None) -> DrapeJob:
    return fine if coarse is None else replace(fine, box_mesh=coarse.mesh)


def _constraints(fine: DrapeJob, coarse: CoarseMesh | None, prepared: PreparedJob | None) -> BodyConstraints:
    """The constraints of the coarse mesh, or of the fine mesh without one; precomputed where possible."""
    known = None
    if prepared is not None:
        known = prepared.constraints if coarse is None else prepared.coarse_constraints
    return known or BodyConstraints.of(_job(fine, coarse))


class PendingJobs:
    """Jobs that are not in a batch yet."""

    def __init__(self, jobs: Iterable[DrapeJob | PreparedJob | None], config: DrapeConfig) -> None:
        self._jobs, self._config, self._count = iter(jobs), config, 0
        self.ended = False
        """Whether the jobs are exhausted, or have failed."""
        self.error: Exception | None = None
        """The error of the jobs' iterator; raised after the drapes of the jobs before it."""

    def take(self, limit: int) -> list[Pass]:
        """The first passes of up to ``limit`` jobs that are present."""
        passes: list[Pass] = []
        while len(passes) < limit and not self.ended:
            try:
                job = next(self._jobs)
            except Exception as error:  # noqa: BLE001 - StopIteration, or an error of the jobs
                self.ended = True
                self.error = None if isinstance(error, StopIteration) else error
                break
            if job is None:
                break
            passes.append(Pass.first(self._count, job, self._config))
            self._count += 1
        return passes


def next_batch(passes: Sequence[Pass], previous: Solver | None, config: DrapeConfig, device: str) -> Solver:
    """A solver for the passes, with the state that continues from the previous batch."""
    with launch_lock:
        coarse = [k for k, each in enumerate(passes) if each.coarse]
        model = build_model(
            [each.job for each in passes],
            config,
            device,
            coarse=coarse,
            sewing_times=[each.sewing_time(config) for each in passes],
            constraints=[each.constraints for each in passes],
            fields=[None if each.prepared is None else each.prepared.field for each in passes],
        )
        solver = Solver(model, config)
        if previous is not None:
            moves = [
                (p.previous_world, k, p.refined_from) for k, p in enumerate(passes) if p.previous_world is not None
            ]
            carry_over(previous, solver, [(old, new) for old, new, mesh in moves if mesh is None])
            start_from_coarse(previous, solver, [(old, new, mesh) for old, new, mesh in moves if mesh is not None])
    return solver
