"""Batches of garments: their passes on the device, and the queue of garments that join as others leave.

A garment whose coarse mesh slid off starts its fine pass from the placed panels. A garment that crosses itself or the
body at rest is draped again, sewn more slowly. The result of a pass depends neither on the time at which it begins nor
on the other garments in the batch.
"""

import contextlib
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from operator import attrgetter
from typing import Self

import numpy as np
import warp as wp

from gcd_dataset.generator.device import WorkStream, keep_freed_memory, launch_lock, to_host, work_streams
from gcd_dataset.generator.drape.body_field import HostField, host_field
from gcd_dataset.generator.drape.config import DrapeConfig, DrapeJob
from gcd_dataset.generator.drape.holds import BodyConstraints
from gcd_dataset.generator.drape.kernels.carry import Move, carry_contacts, refine
from gcd_dataset.generator.drape.kernels.world import DIVERGED, RUNNING
from gcd_dataset.generator.drape.model import build_model
from gcd_dataset.generator.drape.outcome import best_of, collect, crosses, slid_worlds
from gcd_dataset.generator.drape.solver import Solver, nothing
from gcd_dataset.generator.dressing.sewing_start import sewing_start
from gcd_dataset.generator.mesh import CoarseMesh, coarse_start
from gcd_dataset.records import Drape

VERTEX_ARRAYS = (
    "x",
    "v",
    "ahead",
    "x_seen",
    "search.x",
    "search.skin",
    "contact_weight",
    "beside",
    "search.listed",
    "tangled",
)
WORLD_ARRAYS = (
    "time", "status", "held", "loose_after", "frames", "search.moved_far",
    "crossing.due", "crossing.searched", "crossing.least", "crossing.least_at", "crossing.separated",
)  # fmt: skip
CONTACT_COUNTS = ("point_count", "edge_count", "long_count", "crossing_count", "overfull")
THREADS = 256  # threads that copy the contact lists of one garment on a GPU


def carry_over(old: Solver, new: Solver, worlds: Sequence[tuple[int, int]]) -> None:
    """Copy the state of garments between two frames; ``worlds``: pairs of world indices in ``old`` and ``new``."""
    if not worlds:
        return
    first_old, first_new = old.model.topology.vertex_offset, new.model.topology.vertex_offset
    for name in VERTEX_ARRAYS:
        array_of = attrgetter(name)
        source, target = array_of(old.state), array_of(new.state)
        for before, after in worlds:
            count = int(first_old[before + 1] - first_old[before])
            wp.copy(target, source, dest_offset=int(first_new[after]), src_offset=int(first_old[before]), count=count)
    for name in WORLD_ARRAYS:
        array_of = attrgetter(name)
        _copy_worlds(array_of(old.state), array_of(new.state), worlds)
    for name in CONTACT_COUNTS:
        _copy_worlds(getattr(old.state.contacts, name), getattr(new.state.contacts, name), worlds)
    device = new.model.device
    threads = 1 if device == "cpu" else THREADS
    moves = wp.array([_move(old, new, *pair) for pair in worlds], dtype=Move, device=device)
    wp.launch(
        carry_contacts,
        dim=(len(worlds), threads),
        inputs=[old.model.worlds, new.model.worlds, moves, threads, old.state.contacts],
        outputs=[new.state.contacts],
        device=device,
    )


def _copy_worlds(source: wp.array, target: wp.array, worlds: Sequence[tuple[int, int]]) -> None:
    values, old_values = to_host(target), to_host(source)
    for before, after in worlds:
        values[after] = old_values[before]
    target.assign(values)


def _move(old: Solver, new: Solver, before: int, after: int) -> Move:
    move = Move()
    move.old_world, move.new_world = before, after
    old_topology, new_topology = old.model.topology, new.model.topology
    move.edge_shift = int(new_topology.edge_offset[after] - old_topology.edge_offset[before])
    move.face_shift = int(new_topology.face_offset[after] - old_topology.face_offset[before])
    return move


MIN_FRAMES = 4  # frames of the fine mesh before it may count as at rest


def start_from_coarse(coarse: Solver, fine: Solver, worlds: Sequence[tuple[int, int, CoarseMesh]]) -> None:
    """Start garments of ``fine`` from the end of their coarse drapes.

    ``worlds``: world index in ``coarse``, world index in ``fine``, and the coarse mesh that interpolates between them.
    A garment whose coarse drape diverged starts from its placed panels. A garment whose coarse drape overfilled a
    contact list is marked as overfull in ``fine`` too, since the choice of dropped contacts is not deterministic.
    """
    status, time, held = (to_host(array) for array in (coarse.state.status, coarse.state.time, coarse.state.held))
    overfull, new_overfull = to_host(coarse.state.contacts.overfull), to_host(fine.state.contacts.overfull)
    worlds = [entry for entry in worlds if status[entry[0]] != DIVERGED]
    if not worlds:
        return
    model, state, device = fine.model, fine.state, fine.model.device
    first, first_coarse = model.topology.vertex_offset, coarse.model.topology.vertex_offset
    corners = np.zeros((model.n_vertices, 3), np.int32)
    weights = np.zeros((model.n_vertices, 3), np.float32)
    new_time, new_held, loose_after = (to_host(array) for array in (state.time, state.held, state.loose_after))
    frame = to_host(model.worlds)["frame"]
    for old, new, mesh in worlds:
        span = slice(first[new], first[new + 1])
        corners[span], weights[span] = mesh.corners + first_coarse[old], mesh.weights
        new_time[new], new_held[new], new_overfull[new] = time[old], held[old], overfull[old]
        loose_after[new] = time[old] + MIN_FRAMES * frame[new]
    state.time.assign(new_time)
    state.held.assign(new_held)
    state.loose_after.assign(loose_after)
    state.contacts.overfull.assign(new_overfull)
    interpolation = [wp.array(corners, dtype=wp.vec3i, device=device), wp.array(weights, dtype=wp.vec3, device=device)]
    wp.launch(
        refine,
        dim=model.n_vertices,
        inputs=[model.worlds, model.cloth.vertex_world, *interpolation, coarse.state.x, coarse.state.v],
        outputs=[state.x, state.v, state.ahead, state.x_seen, state.search.x],
        device=device,
    )


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
        fine, mesh = self.fine, self.fine.box_mesh
        if config.sewing_start:
            fine = replace(fine, box_mesh=replace(mesh, vertices=sewing_start(mesh, fine.body)))
        return replace(
            self,
            fine=fine,
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


POLL_EVERY = 5  # frames between two reads of the status
AHEAD = 10  # frames queued before the host works for another lane
IDLE = 0.5  # share of the worlds that may be idle while jobs wait: rebuilding a batch takes time


class Lane:
    """A batch that takes jobs from ``pending``, on a stream of its own, or on a CPU without one."""

    def __init__(
        self,
        pending: PendingJobs,
        config: DrapeConfig,
        device: str,
        *,
        size: int,
        stream: WorkStream | None,
        between: Callable[[], None],
    ) -> None:
        self._pending, self._config, self._device, self._size = pending, config, device, size
        self._stream, self._between = stream, between
        self._passes: list[Pass] = []
        self._solver: Solver | None = None
        self._tried = False
        """Whether the lane has asked for jobs."""
        self._continued: list[Pass] | None = None
        """Between the two stages of a replacement: the passes that go on in the next batch."""
        self._status: wp.array | None = None

    @property
    def empty(self) -> bool:
        """Whether the lane has no garment."""
        return not self._passes and not self._continued

    def ready(self, arrived: Callable[[], int]) -> bool:
        """Whether ``advance`` has work: the queued frames have ended, or an empty lane may find jobs."""
        if self.empty:
            return not self._pending.ended and (not self._tried or arrived() > 0)
        return not self._in_flight()

    def _in_flight(self) -> bool:
        """Whether the device has not ended the queued frames."""
        return self._status is not None and self._stream is not None and not self._stream.reached()

    def replaces(self, arrived: Callable[[], int]) -> bool:
        """Whether the next ``advance`` collects garments or builds a batch, which takes the host some time.

        Counted as idle: each ended world that a pending job or its garment's fine pass could use, and each unused
        place in the batch for which a job has arrived.
        """
        if self._solver is None or self._continued is not None:
            return True
        assert self._status is not None
        running = self._status.numpy() == RUNNING
        refining = np.array([each.coarse is not None for each in self._passes])
        idle = ~running & refining if self._pending.ended else ~running
        free = min(arrived(), self._size - len(self._passes))
        return not running.any() or bool(idle.sum() + free >= max(1, IDLE * len(self._passes)))

    def queue_ahead(self) -> None:
        """Queue further frames if the lane has any in flight."""
        if self._in_flight():
            with self._on_stream():
                self._queue(AHEAD)

    def advance(self, arrived: Callable[[], int]) -> list[tuple[int, Drape]]:
        """Queue frames; or collect the garments at rest; or build the next batch and queue its first frames.

        Returns the number and drape of each collected garment.
        """
        with self._on_stream():
            if self._solver is not None and self._continued is None and self.replaces(arrived):
                return self._collect()
            if self._solver is None or self._continued is not None:
                self._build()
            if self._solver is not None:
                self._solver.refresh_bvh()
                self._queue(POLL_EVERY)
        return []

    def _collect(self) -> list[tuple[int, Drape]]:
        """The drapes of the garments that have ended their last fine pass; those that cross are draped again."""
        solver, passes = self._solver, self._passes
        assert solver is not None
        self.synchronize()
        running = to_host(solver.state.status) == RUNNING  # frames queued ahead may have ended more garments
        frames = to_host(solver.state.frames)
        ended = [k for k in np.flatnonzero(~running).tolist() if passes[k].coarse is None]
        drapes = collect(solver, [passes[k].fine for k in ended], ended)
        self._continued = [passes[k].continued(k) for k in np.flatnonzero(running).tolist()]
        slid = slid_worlds(solver, {k: each.job for k, each in enumerate(passes) if each.coarse})
        self._continued += [
            each.restarted(int(frames[k]), self._config) if k in slid else each.refined(k, int(frames[k]))
            for k, each in enumerate(passes)
            if each.coarse and not running[k]
        ]
        self.synchronize()
        finished: list[tuple[int, Drape]] = []
        for k, drape in zip(ended, drapes, strict=True):
            whole = replace(drape, frames=drape.frames + passes[k].coarse_frames)
            every = (*passes[k].earlier, whole)
            if crosses(whole) and len(every) < self._config.most_drapes:
                self._continued.append(passes[k].again(whole))
            else:
                finished.append((passes[k].number, best_of(every)))
        return finished

    def _build(self) -> None:
        """Fill the free places of the batch with jobs, and continue the other garments from the previous batch."""
        self._tried = True
        passes = self._continued or []
        passes += self._pending.take(self._size - len(passes))
        previous, self._solver = self._solver, None
        if passes:
            self._solver = next_batch(passes, previous, self._config, self._device)
        self._passes, self._continued, self._status = passes, None, None
        self.synchronize()

    def _queue(self, frames: int) -> None:
        """Queue frames, and a copy of the status after them; on a CPU, run them."""
        solver = self._solver
        assert solver is not None
        if self._stream is None:
            for _ in range(frames):
                solver.replay_frame(self._between)
            self._status = solver.state.status
            return
        for _ in range(frames):
            solver.replay_frame()
        if self._status is None:
            self._status = wp.empty(len(self._passes), dtype=int, device="cpu", pinned=True)
        wp.copy(self._status, solver.state.status)
        self._stream.mark()

    def synchronize(self) -> None:
        """Wait for the device, and free the memory of past batches."""
        if self._stream is not None:
            self._stream.wait()

    def _on_stream(self) -> contextlib.AbstractContextManager[None]:
        """Launch on the lane's stream; a CPU has none."""
        return contextlib.nullcontext() if self._stream is None else self._stream.active()


LANES = 3  # batches on a GPU: while the host replaces garments of one, the frames of the others keep the GPU busy
POLL_SECONDS = 1e-4  # s


def none_arrived() -> int:
    """The default for ``arrived``: all jobs are present from the start."""
    return 0


def drape_unordered(
    jobs: Iterable[DrapeJob | PreparedJob | None],
    config: DrapeConfig,
    *,
    device: str,
    at_once: int,
    lanes: int | None = None,
    arrived: Callable[[], int] = none_arrived,
    between: Callable[[], None] = nothing,
) -> Iterator[tuple[int, Drape]]:
    """Yield the number and drape of each job in the order in which they come to rest; up to ``at_once`` drape at once.

    ``jobs`` may receive jobs while others drape; it yields ``None`` whenever it has no job, and numbers count jobs
    only. ``arrived`` returns how many jobs ``jobs`` could yield now. The generator ends when all garments are draped
    and ``jobs`` has none. ``lanes``: batches that share the device (default: three on a GPU). ``between`` is called
    between substeps on a CPU, while frames run on a GPU; an exception that it raises ends the drapes.
    """
    pending = PendingJobs(jobs, config)
    count = min(lanes or (1 if device == "cpu" else LANES), at_once)
    sizes = [at_once // count + (number < at_once % count) for number in range(count)]
    batches = [
        Lane(pending, config, device, size=size, stream=stream, between=between)
        for size, stream in zip(sizes, work_streams(device, count), strict=True)
    ]
    if device != "cpu":
        wp.synchronize_device(device)  # a work stream does not wait for other streams
    with keep_freed_memory(device):
        while True:
            if device != "cpu":
                between()
            ready = [lane for lane in batches if lane.ready(arrived)]
            for lane in ready:
                if lane.replaces(arrived):
                    for other in batches:
                        other.queue_ahead()
                yield from lane.advance(arrived)
            if all(lane.empty for lane in batches) and (pending.ended or arrived() == 0):
                break
            if not ready:
                time.sleep(POLL_SECONDS)
        for lane in batches:
            lane.synchronize()
    if pending.error is not None:
        raise pending.error
