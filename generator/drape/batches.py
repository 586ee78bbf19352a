"""Batches of garments: their passes on the device, and the queue of garments that join as others leave.

A batch holds its garments in places (``slots``) of fixed buffers. A garment whose coarse mesh slid off starts its fine
pass from the placed panels. A garment that crosses itself or the body at rest is draped again, sewn more slowly. The
result of a pass depends neither on the time at which it begins nor on the other garments in the batch.
"""

import contextlib
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Self

import numpy as np
import warp as wp

from gcd_dataset.generator.device import Resumable, WorkStream, keep_freed_memory, launch_lock, work_streams
from gcd_dataset.generator.drape.body_field import BodyField, HostField, host_field
from gcd_dataset.generator.drape.config import DrapeConfig, DrapeJob
from gcd_dataset.generator.drape.holds import BodyConstraints
from gcd_dataset.generator.drape.kernels.world import DIVERGED, RUNNING, STOPPED
from gcd_dataset.generator.drape.model import ClothModel, build_model
from gcd_dataset.generator.drape.moving import Motion
from gcd_dataset.generator.drape.outcome import KEEPS_CROSSINGS, best_of, collect, crosses, slid_off
from gcd_dataset.generator.drape.slots import WIDTH, CoarseEnd, Slots, room_for, rooms_of
from gcd_dataset.generator.drape.solver import nothing
from gcd_dataset.generator.dressing.sewing_start import sewing_start
from gcd_dataset.generator.mesh import CoarseMesh, coarse_start
from gcd_dataset.records import Drape, Outcome


@dataclass(frozen=True)
class PreparedJob:
    """A job with its precomputed host data, which any thread may prepare while other garments drape."""

    job: DrapeJob
    field: HostField
    constraints: BodyConstraints
    coarse_constraints: BodyConstraints | None
    """The constraints of ``job.coarse``."""
    motion: Motion | None
    """The motion to ``job.pose``."""

    @classmethod
    def of(cls, job: DrapeJob) -> Self:
        coarse = BodyConstraints.of(replace(job, box_mesh=job.coarse.mesh)) if job.coarse else None
        return cls(job, host_field(job.body), BodyConstraints.of(job), coarse, motion_of(job))


def motion_of(job: DrapeJob) -> Motion | None:
    """The motion of a job's body to its pose, if it has one. Raises ``BodyError`` for an impossible pose."""
    return Motion.to_pose(job.body, job.pose) if job.pose else None


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
    start: CoarseEnd | None = None
    """In the fine pass: the end of the coarse pass, if the garment starts from it."""
    begun_with: CoarseMesh | None = None
    """The coarse mesh of the garment's first pass, if it has one."""
    rested: Drape | None = None
    """The drape before the body moved to its pose, once it does."""
    earlier: tuple[Drape, ...] = ()
    """The drapes of the garment before this pass, none of them free of crossings."""
    body: BodyField | None = None
    """The field of the last pass, kept in use for the next."""
    room_factor: int = 1
    """Factor of its room for contacts: doubled whenever a list has run over."""

    @classmethod
    def first(cls, number: int, given: DrapeJob | PreparedJob, config: DrapeConfig) -> Self:
        prepared = given if isinstance(given, PreparedJob) else None
        job = given.job if isinstance(given, PreparedJob) else given
        coarse = (job.coarse or coarse_start(job.box_mesh)) if config.coarse_start else None
        constraints = _constraints(job, coarse, prepared)
        if config.sewing_start:
            mesh = coarse.mesh if coarse else job.box_mesh
            known = job.start if (job.coarse is None) == (coarse is None) else None
            mesh = replace(mesh, vertices=sewing_start(mesh, job.body, job.under) if known is None else known)
            coarse, job = (replace(coarse, mesh=mesh), job) if coarse else (None, replace(job, box_mesh=mesh))
        return cls(number, job, coarse, constraints, prepared, begun_with=coarse)

    @property
    def job(self) -> DrapeJob:
        """The job of this pass: with the coarse mesh, or with the fine mesh."""
        return _job(self.fine, self.coarse)

    @property
    def motion(self) -> Motion:
        """The motion of the body to its pose."""
        motion = self.prepared.motion if self.prepared else motion_of(self.fine)
        assert motion is not None
        return motion

    @property
    def frames_before(self) -> int:
        """The frames of the coarse pass, and of the drape before the body moved."""
        return self.coarse_frames + (self.rested.frames if self.rested else 0)

    def moves_after(self, drape: Drape) -> bool:
        """Whether the body moves to its pose after ``drape``, at the end of a fine pass."""
        return (
            self.fine.pose is not None
            and self.rested is None
            and drape.outcome in (*KEEPS_CROSSINGS, Outcome.NOT_SETTLED)
        )

    def sewing_time(self, config: DrapeConfig) -> float:
        """The time over which the seams close in this pass [s]: doubled with each earlier drape."""
        return config.sewing_time * 2.0 ** len(self.earlier)

    def again(self, drape: Drape) -> Self:
        """The first pass of the garment's next drape, after ``drape``."""
        return replace(self.begun(), earlier=(*self.earlier, drape))

    def with_more_room(self) -> Self:
        """The first pass of a drape in place of this one, whose contact lists have run over."""
        return replace(self.begun(), room_factor=2 * self.room_factor)

    def begun(self) -> Self:
        """The first pass of this drape."""
        constraints = _constraints(self.fine, self.begun_with, self.prepared)
        return replace(self, coarse=self.begun_with, constraints=constraints, coarse_frames=0, start=None, rested=None)

    def restarted(self, frames: int, config: DrapeConfig) -> Self:
        """The fine pass from the placed panels, after a coarse pass of ``frames`` frames that slid off the body."""
        fine, mesh = self.fine, self.fine.box_mesh
        if config.sewing_start:
            fine = replace(fine, box_mesh=replace(mesh, vertices=sewing_start(mesh, fine.body, fine.under)))
        return replace(self.refined(None, frames), fine=fine)

    def refined(self, start: CoarseEnd | None, frames: int) -> Self:
        """The fine pass after a coarse pass of ``frames`` frames."""
        return replace(
            self,
            coarse=None,
            constraints=_constraints(self.fine, None, self.prepared),
            coarse_frames=frames,
            start=start,
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


def model_of(passes: Sequence[Pass], config: DrapeConfig, device: str) -> ClothModel:
    """The model of the passes' garments."""
    return build_model(
        [each.job for each in passes],
        config,
        device,
        coarse=[k for k, each in enumerate(passes) if each.coarse],
        sewing_times=[each.sewing_time(config) for each in passes],
        rooms=[each.room_factor for each in passes],
        constraints=[each.constraints for each in passes],
        fields=[None if each.prepared is None else each.prepared.field for each in passes],
    )


POLL_EVERY = 5  # frames between two reads of the status
AHEAD = 10  # frames queued before the host works for another lane
IDLE = 0.25  # share of the worlds that may be idle while jobs wait: replacing garments takes time
SPARE = 1.25  # room of a batch over that of its garments, while further jobs may come
MOST_ROOM = 16  # largest factor of a garment's room for contacts
CROWDED = 0.6  # a batch that has no room for more than this share of its garments gets larger buffers


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
        self._slots: Slots | None = None
        self._passes: dict[int, Pass] = {}
        """World to pass."""
        self._waiting: list[Pass] = []
        """Passes without a world."""
        self._is_crowded = False
        """Whether the batch waits for its last garment, to get larger buffers."""
        self._is_due = True
        """Whether garments may be placed: at first, and after others have left."""
        self._status: wp.array | None = None
        self._collecting: Resumable[list[tuple[int, Drape]]] | None = None
        """``_collect`` while it awaits results of the device."""

    @property
    def empty(self) -> bool:
        """Whether the lane has no garment, and has asked for jobs since it collected the last one."""
        return not (self._passes or self._waiting or self._is_due)

    def ready(self, arrived: Callable[[], int]) -> bool:
        """Whether ``advance`` has work: the device has ended the queued work, or an empty lane may find jobs."""
        if self.empty:
            return not self._pending.ended and arrived() > 0
        return not self._in_flight()

    def _in_flight(self) -> bool:
        """Whether the device has not ended the queued frames, or the results that are awaited."""
        return self._status is not None and self._stream is not None and not self._stream.reached()

    def replaces(self, arrived: Callable[[], int]) -> bool:
        """Whether the next ``advance`` begins to collect, or places garments, which takes the host some time.

        Counted as idle: each ended world that a garment could use (its own in the fine pass, one that waits, or a
        pending job), and each unused world for which a job has arrived.
        """
        if self._collecting is not None:
            return False
        if self._is_due or not self._passes:
            return True
        running = self._running()
        any_use = bool(self._waiting) or not self._pending.ended
        usable = [w for w, each in self._passes.items() if each.coarse or any_use]
        idle = sum(not running[w] for w in usable)
        free = min(arrived(), self._size - len(self._passes) - len(self._waiting))
        return not any(running[w] for w in self._passes) or idle + free >= max(1, IDLE * len(self._passes))

    def _running(self) -> np.ndarray:
        """(w) whether each world runs, after the frames of the last ``_queue``."""
        assert self._status is not None
        return np.asarray(self._status.numpy() == RUNNING)

    def queue_ahead(self) -> None:
        """Queue further frames if the lane has any in flight."""
        if self._collecting is None and self._in_flight():
            with self._on_stream():
                self._queue(AHEAD)

    def advance(self, arrived: Callable[[], int]) -> list[tuple[int, Drape]]:
        """Queue frames; or collect the garments at rest; or place garments and queue their first frames.

        Collecting takes several calls: each ends where the results of the device are awaited. Returns the number and
        drape of each collected garment.
        """
        if not self._is_due and self.replaces(arrived):
            self._collecting = self._collect()
        if self._collecting is not None:
            with self._on_stream(urgent=True):
                return self._resume(self._collecting)
        if self._is_due:
            self._take_jobs()
            with self._on_stream(urgent=True):
                self._place()
        if self._passes:
            assert self._slots is not None
            with self._on_stream():
                self._slots.solver.refresh_bvh()
                self._queue(POLL_EVERY)
        return []

    def _resume(self, collecting: Resumable[list[tuple[int, Drape]]]) -> list[tuple[int, Drape]]:
        """The drapes, if they are collected; none if results are awaited."""
        try:
            next(collecting)
        except StopIteration as end:
            self._collecting, self._is_due = None, True
            return list(end.value)
        if self._stream is not None:
            self._stream.mark()
        return []

    def _collect(self) -> Resumable[list[tuple[int, Drape]]]:
        """The drapes of the garments that have ended their last fine pass; those that cross are draped again."""
        if not self._passes:
            return []
        assert self._slots is not None
        assert self._status is not None
        if self._stream is not None:
            self._stream.free_dropped()
        passes, status = self._passes, np.array(self._status.numpy())
        ended = [w for w in passes if status[w] != RUNNING]
        self._waiting += yield from self._after_coarse([w for w in ended if passes[w].coarse], status)
        fine = [w for w in ended if passes[w].coarse is None]
        drapes = yield from collect(self._slots.solver, [passes[w].fine for w in fine], fine)
        finished: list[tuple[int, Drape]] = []
        for w, drape in zip(fine, drapes, strict=True):
            if passes[w].moves_after(drape):
                self._slots.move(w, passes[w].motion)
                passes[w] = replace(passes[w], rested=drape)
                ended.remove(w)
                continue
            whole = replace(drape, frames=drape.frames + passes[w].frames_before)
            if passes[w].fine.pose and not passes[w].rested:
                whole = replace(whole, reason=f"before the body moved{': ' if whole.reason else ''}{whole.reason}")
            every = (*passes[w].earlier, whole)
            if drape.outcome is Outcome.OVERFULL and passes[w].room_factor < MOST_ROOM:
                self._waiting.append(passes[w].with_more_room())
            elif crosses(whole) and len(every) < self._config.most_drapes:
                self._waiting.append(passes[w].again(whole))
            else:
                finished.append((passes[w].number, best_of(every)))
        self._slots.free(ended)
        for w in ended:
            del passes[w]
        return finished

    def _after_coarse(self, worlds: Sequence[int], status: np.ndarray) -> Resumable[list[Pass]]:
        """The next passes of the garments in some worlds, whose coarse passes have ended."""
        if not worlds:
            return []
        assert self._slots is not None
        solver, passes = self._slots.solver, []
        state, vertices = solver.state, solver.model.vertices
        frames, time, held, overfull, x = yield from solver.mirror.fetch(
            state.frames, state.time, state.held, state.contacts.overfull, state.x
        )
        for w in worlds:
            ended, count, start = self._passes[w], int(frames[w]), None
            assert ended.coarse is not None
            if overfull[w] and ended.room_factor < MOST_ROOM:
                passes.append(ended.with_more_room())
            elif status[w] == STOPPED and slid_off(ended.job, x[vertices[w]]):
                passes.append(ended.restarted(count, self._config))
            else:
                if status[w] != DIVERGED:
                    start = CoarseEnd.of(
                        ended.coarse,
                        state,
                        vertices[w],
                        time=float(time[w]),
                        held=int(held[w]),
                        overfull=int(overfull[w]),
                    )
                passes.append(ended.refined(start, count))
        return passes

    def _take_jobs(self) -> None:
        """Take a job for each free world. Not on the stream: jobs may wait for threads that launch kernels too."""
        self._is_due = False
        self._waiting += self._pending.take(self._size - len(self._passes) - len(self._waiting))

    def _place(self) -> None:
        """Fill the free places of the batch with passes that wait for one."""
        if not self._waiting or (self._is_crowded and self._passes):
            return
        chosen = self._waiting
        if self._slots is not None and self._passes:
            chosen = chosen[
                : self._slots.count_fitting([each.room_factor * room_for(each.job.box_mesh) for each in chosen])
            ]
        self._is_crowded = len(chosen) < len(self._waiting) and len(self._passes) <= CROWDED * self._size
        if not chosen:
            return
        with launch_lock:
            new = model_of(chosen, self._config, self._device)
            if not self._passes:
                self._renew(new)
            assert self._slots is not None
            worlds = self._slots.place(new, [each.start for each in chosen]) if self._slots.suits(new) else []
            chosen = [replace(each, body=body) for each, body in zip(chosen, new.bodies, strict=True)]
        if len(worlds) < len(chosen):
            self.synchronize()  # dropped bodies free their meshes at once; else ``refresh_bvh`` waits for the fields
        self._passes |= dict(zip(worlds, chosen, strict=False))
        self._waiting = self._waiting[len(worlds) :]

    def _renew(self, new: ClothModel) -> None:
        """Make the buffers of an empty batch, or larger ones, for the garments of ``new``: all that wait."""
        on_cpu, rows = self._device == "cpu", new.rows
        usual = [room_for(each.job.box_mesh if on_cpu else each.fine.box_mesh) for each in self._waiting]
        count, spare = (len(usual), 1.0) if self._pending.ended else (self._size, SPARE)
        needed = [
            max(own, each.room_factor * room)
            for each, own, room in zip(self._waiting, rooms_of(new), usual, strict=True)
        ]
        room = max(int(spare * count * np.mean(usual)), sum(needed))
        width, coupled = max(WIDTH, rows.width), bool(rows.coupled)
        if self._slots is not None and not on_cpu:
            if self._slots.room >= room and self._slots.suits(new):
                return
            old = self._slots.solver.model.rows
            room, width = max(room, self._slots.room), max(width, old.width)
            coupled = coupled or bool(old.coupled)
        self.free()
        self._slots = Slots(room, self._size, self._config, self._device, width=width, coupled=coupled)

    def free(self) -> None:
        """Free the buffers, once the device has ended the frames in flight."""
        self.synchronize()
        self._slots = self._status = self._collecting = None
        self.synchronize()

    def _queue(self, frames: int) -> None:
        """Queue frames, and a copy of the status after them; on a CPU, run them."""
        assert self._slots is not None
        solver = self._slots.solver
        if self._stream is None:
            for _ in range(frames):
                solver.replay_frame(self._between)
            self._status = solver.state.status
            return
        for _ in range(frames):
            solver.replay_frame()
        if self._status is None:
            self._status = wp.empty(solver.model.n_worlds, dtype=int, device="cpu", pinned=True)
        wp.copy(self._status, solver.state.status)
        self._stream.mark()

    def synchronize(self) -> None:
        """Wait for the device, and free the memory of dropped arrays."""
        if self._stream is not None:
            self._stream.wait()

    def _on_stream(self, *, urgent: bool = False) -> contextlib.AbstractContextManager[None]:
        """Launch on the lane's stream; a CPU has none."""
        return contextlib.nullcontext() if self._stream is None else self._stream.active(urgent=urgent)


LANES = 4  # batches on a GPU: while the host replaces garments of one, the frames of the others keep the GPU busy
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
    and ``jobs`` has none. ``lanes``: batches that share the device (default: four on a GPU). ``between`` is called
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
        try:
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
        finally:
            for lane in batches:
                lane.free()
    if pending.error is not None:
        raise pending.error
