"""The entry points: drape any number of jobs, batched on a GPU, in threads on a CPU."""

import threading
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import replace
from itertools import islice
from typing import TypeVar, cast

import numpy as np
import warp as wp
from jaxtyping import Int

from gcd_dataset.errors import ConfigError, DrapeError
from gcd_dataset.generator.device import Resumable, cores, keep_freed_memory, resolve_device
from gcd_dataset.generator.drape.batches import PreparedJob, drape_unordered
from gcd_dataset.generator.drape.config import DrapeConfig, DrapeJob
from gcd_dataset.generator.drape.loading import load_drape
from gcd_dataset.generator.drape.model import build_model
from gcd_dataset.generator.drape.moving import Motion
from gcd_dataset.generator.drape.outcome import KEEPS_CROSSINGS, collect
from gcd_dataset.generator.drape.slots import CoarseEnd, Slots
from gcd_dataset.generator.dressing.worn import WornCloth
from gcd_dataset.records import FPS, Body, Drape, GarmentMotion, Outcome, Pose
from gcd_dataset.shards.motion import NO_FRAMES, motion_as_stored

Made = TypeVar("Made")
DEFAULT = DrapeConfig()
AT_ONCE = 128  # garments in a GPU batch: at 1 cm they fill an H200
GARMENT_BYTES = 120e6  # GPU memory reserved per garment; measured: 100 MB at 1 cm, 12 000 vertices on average
PREPARERS = 4  # threads that prepare jobs for a GPU
PART = 64  # poses of a part of a motion: 20 MB of keys
MOVING_ROOM = 2  # factor of the room for contacts of a garment in motion
UNTANGLING_STEPS = 20  # most for a frame in motion: all garments of a GPU wait for the one that takes most
ENDS_MOTION = (Outcome.DIVERGED, Outcome.FELL, Outcome.SLID_OFF, Outcome.OVERFULL)
MEMORY_SHARE = 0.7  # share of a GPU's free memory that a batch may take


def drape_batch(
    jobs: Sequence[DrapeJob], config: DrapeConfig = DEFAULT, *, device: str = "auto", at_once: int | None = None
) -> list[Drape]:
    """One ``Drape`` for each job, in order.

    ``at_once``: garments in a GPU batch (default: 128, fewer if free memory is short), or threads that drape one
    garment each on a CPU (default: one for each core). A garment drapes to the same bytes alone and in any batch.
    ``outcome`` tells whether the garment settled. A job that cannot be draped, such as a mesh without faces, costs no
    other: it is ``REFUSED``, with the ``reason`` and the box mesh's vertices. Raises ``ConfigError`` for an unknown
    device.
    """
    return list(drape_all(jobs, config, device=device, at_once=at_once))


def drape_all(
    jobs: Iterable[DrapeJob], config: DrapeConfig = DEFAULT, *, device: str = "auto", at_once: int | None = None
) -> Iterator[Drape]:
    """``drape_batch`` for an iterable of any length: takes jobs as the batch has room, yields drapes in job order."""
    device = resolve_device(device)
    at_once = at_once or batch_capacity(device)
    refused: dict[int, Drape] = {}
    checked = _checked(jobs, device, refused)
    drapes = _by_threads(checked, config, at_once) if device == "cpu" else _on_gpu(checked, config, device, at_once)
    number = 0
    for drape in drapes:
        while number in refused:
            yield refused.pop(number)
            number += 1
        yield drape
        number += 1
    yield from refused.values()


def drape_outfit(jobs: Sequence[DrapeJob], config: DrapeConfig = DEFAULT, *, device: str = "auto") -> tuple[Drape, ...]:
    """One ``Drape`` for each garment of an outfit on one body; ``jobs``: from the skin outwards.

    Each garment drapes over those before it, which stay as they are. A garment over one that did not settle is
    ``REFUSED``. Raises ``ConfigError`` for jobs with different bodies, and for an unknown device.
    """
    drapes: list[Drape] = []
    for number, job in enumerate(jobs):
        if job.body is not jobs[0].body:
            raise ConfigError(
                f"drape_outfit: garment {number} is for body {job.body.name}, garment 0 for {jobs[0].body.name}: give "
                "all jobs of an outfit one Body object"
            )
        failed = next((k for k, drape in enumerate(drapes) if drape.outcome is not Outcome.SETTLED), None)
        if failed is not None:
            drapes.append(_refused(job, f"garment {failed} under it is {drapes[failed].outcome.name}"))
            continue
        worn = [WornCloth.of(under.box_mesh, drape.vertices) for under, drape in zip(jobs, drapes, strict=False)]
        drapes += drape_batch([replace(job, under=tuple(worn))], config, device=device)
    return tuple(drapes)


def drape_motion(
    job: DrapeJob, poses: Iterable[Pose], config: DrapeConfig = DEFAULT, *, fps: float = FPS, device: str = "auto"
) -> Iterator[Drape]:
    """One ``Drape`` for each pose that the body takes, ``fps`` a second; the garment is at rest in the first.

    The body moves to the first pose as for ``DrapeJob.pose``. Between two poses it moves straight, for the nearest
    number of frames: time steps follow from the mesh, and at a spacing of 4 cm a frame takes 0.04 s. Later drapes have
    ``frames`` since the first, and are ``SETTLED`` though they move, with crossings or without: cloth that crosses
    itself is untangled in the drape, and moves on as it was. A garment that slides off, falls, diverges or has no room
    for its contacts ends the sequence after its drape. Raises ``BodyError`` for an impossible pose.
    """
    device, numbered = resolve_device(device), iter(poses)
    if (first := next(numbered, None)) is None:
        return
    job = replace(job, pose=first)
    [rest] = drape_batch([job], config, device=device)
    yield rest
    parts = _parts(job.body, first, numbered)
    for _, drape in drape_on([PreparedJob.of(job)], [rest], [parts], config, fps=fps, device=device):
        yield drape


def _parts(body: Body, last: Pose, poses: Iterator[Pose]) -> Iterator[Motion]:
    """The motion of a body through poses, of which there may be any number, in parts that fit into memory."""
    while following := list(islice(poses, PART)):
        yield Motion.through(body, [last, *following])
        last = following[-1]


def drape_on(
    prepared: Sequence[PreparedJob],
    rests: Sequence[Drape],
    ways: Sequence[Iterable[Motion]],
    config: DrapeConfig = DEFAULT,
    *,
    fps: float = FPS,
    device: str = "auto",
) -> Iterator[tuple[int, Drape]]:
    """The later drapes of ``drape_motion`` of several garments, in one batch, each with the number of its job.

    ``rests``: the drapes in the first poses. ``ways``: the motion of each body in parts, each from the last key of the
    part before it; a key for each pose. Of a garment that is not at rest there are none.
    """
    parts = [iter(way) for way in ways]
    firsts = {k: next(parts[k], None) for k, rest in enumerate(rests) if rest.outcome in KEEPS_CROSSINGS}
    begun = [(k, part) for k, part in firsts.items() if part is not None and len(part.keys) > 1]
    if not begun:
        return
    device = resolve_device(device)
    config = replace(config, untangling_steps=min(config.untangling_steps, UNTANGLING_STEPS))
    model = build_model(
        [prepared[k].job for k, _ in begun],
        config,
        device,
        rooms=[MOVING_ROOM] * len(begun),
        constraints=[prepared[k].constraints for k, _ in begun],
        fields=[prepared[k].field for k, _ in begun],
    )
    time = config.sewing_time + config.held_time
    slots = Slots.of(model, config, [CoarseEnd.at_rest(rests[k].vertices, time, device) for k, _ in begun])
    for w, (_, part) in enumerate(begun):
        slots.move(w, part.from_home(), ends=False)
        slots.move_on(w, part, 1.0 / fps)
    with keep_freed_memory(device):
        yield from _moved(slots, dict(enumerate(k for k, _ in begun)), prepared, parts, fps, device)


def _moved(
    slots: Slots,
    number_in: dict[int, int],
    prepared: Sequence[PreparedJob],
    parts: Sequence[Iterator[Motion]],
    fps: float,
    device: str,
) -> Iterator[tuple[int, Drape]]:
    """The drapes of ``drape_on``; ``number_in``: the number of the job in each world."""
    solver = slots.solver
    while number_in:
        solver.frame()
        arrived = [w for w in number_in if solver.moving[w].is_at_key]
        if not arrived:
            continue
        for w in arrived:
            solver.moving[w].arrive()
        moving = wp.clone(solver.state.x)  # the finish is for the drape alone: the cloth moves on as it was
        drapes = _at_once(collect(solver, [prepared[number_in[w]].job for w in arrived], arrived), device)
        wp.copy(solver.state.x, moving)
        for w, drape in zip(arrived, drapes, strict=True):
            k, has_arrived = number_in[w], solver.moving[w].frame == solver.moving[w].frames
            yield k, replace(drape, outcome=Outcome.SETTLED) if drape.outcome is Outcome.NOT_SETTLED else drape
            following = next(parts[k], None) if has_arrived else None
            if drape.outcome in ENDS_MOTION or (has_arrived and following is None):
                del number_in[w]
                slots.free([w])
            elif following is not None:
                slots.move_on(w, following, 1.0 / fps)


def garment_motion(
    drapes: Sequence[Drape], faces: Int[np.ndarray, "f 3"], poses: Sequence[Pose], *, fps: float = FPS
) -> GarmentMotion:
    """The drapes of ``drape_motion`` as one record, without the last one if it ends the motion early."""
    ended = Outcome.SETTLED if drapes[-1].outcome in KEEPS_CROSSINGS else drapes[-1].outcome
    kept = drapes if ended is Outcome.SETTLED else drapes[:-1]
    motion = replace(NO_FRAMES, fps=fps, asked=len(poses), ended=ended)
    if not kept:
        return motion
    counts = np.array([[d.self_crossings, d.body_crossings, d.body_through] for d in kept])
    vertices = motion_as_stored(np.stack([d.vertices for d in kept]))
    return replace(motion, vertices=vertices, faces=faces, poses=tuple(poses[: len(kept)]), crossings=counts)


def _at_once(work: Resumable[Made], device: str) -> Made:
    """The result of work on a device, waiting for it where it yields."""
    while True:
        try:
            next(work)
        except StopIteration as end:
            return cast(Made, end.value)
        wp.synchronize_stream(device)


def _refused(job: DrapeJob, reason: str) -> Drape:
    return Drape(np.array(job.box_mesh.vertices, np.float32), Outcome.REFUSED, 0, 0, 0, np.nan, np.nan, reason=reason)


def _on_gpu(jobs: Iterable[DrapeJob], config: DrapeConfig, device: str, at_once: int) -> Iterator[Drape]:
    finished: dict[int, Drape] = {}
    next_number = 0
    for number, drape in drape_unordered(_prepared(jobs, at_once), config, device=device, at_once=at_once):
        finished[number] = drape
        while next_number in finished:
            yield finished.pop(next_number)
            next_number += 1


def batch_capacity(device: str, *, sharers: int = 1) -> int:
    """Garments that a device drapes at once: as many as fill a GPU and fit in its memory, or one for each CPU core.

    ``sharers``: processes that share the GPU, with a batch each.
    """
    if device == "cpu":
        return cores()
    return capacity_for(wp.get_device(device).free_memory / sharers)


def capacity_for(free: float) -> int:
    """Garments in the batch of a GPU with ``free`` bytes of memory.

    >>> capacity_for(139e9), capacity_for(8e9), capacity_for(0.0)
    (128, 46, 1)
    """
    return min(max(int(MEMORY_SHARE * free / GARMENT_BYTES), 1), AT_ONCE)


def _checked(jobs: Iterable[DrapeJob], device: str, refused: dict[int, Drape]) -> Iterator[DrapeJob]:
    """The jobs that can be draped; the drapes of the others go to ``refused``, by number."""
    for number, job in enumerate(jobs):
        try:
            job.require_drapeable()
        except DrapeError as error:
            refused[number] = _refused(job, str(error))
            continue
        if number == len(refused):
            load_drape(device)  # in the calling thread, where Ctrl-C works
        yield job


def _prepared(jobs: Iterable[DrapeJob], ahead: int) -> Iterator[PreparedJob]:
    """The jobs with their host data, which threads prepare for up to ``ahead`` jobs while others drape."""
    with ThreadPoolExecutor(PREPARERS) as pool:
        try:
            yield from _mapped(pool, PreparedJob.of, jobs, ahead)
        finally:
            pool.shutdown(cancel_futures=True)


def _mapped(
    pool: ThreadPoolExecutor, function: Callable[[DrapeJob], Made], jobs: Iterable[DrapeJob], ahead: int
) -> Iterator[Made]:
    """The results of a function in order, up to ``ahead`` in work. An error of the jobs follows the earlier results."""
    waiting: deque[Future[Made]] = deque()
    pending, ended = iter(jobs), None
    while ended is None or waiting:
        try:
            while ended is None and len(waiting) < ahead:
                waiting.append(pool.submit(function, next(pending)))
        except Exception as error:  # noqa: BLE001 - StopIteration, or an error of the jobs: raised after the earlier results
            ended = error
        if waiting:
            yield waiting.popleft().result()
    if not isinstance(ended, StopIteration):
        raise ended


class _Cancelled(Exception):  # noqa: N818 - not an error: never leaves this module
    """Ends a drape after its caller has closed the iterator."""


def _by_threads(jobs: Iterable[DrapeJob], config: DrapeConfig, threads: int) -> Iterator[Drape]:
    """One garment in each thread: replaying a graph releases the GIL. Closing the iterator cancels running drapes."""
    cancelled = threading.Event()

    def check_cancelled() -> None:
        if cancelled.is_set():
            raise _Cancelled

    def drape(job: DrapeJob) -> Drape:
        [(_, done)] = drape_unordered([job], config, device="cpu", at_once=1, between=check_cancelled)
        return done

    with ThreadPoolExecutor(threads) as pool:
        try:
            yield from _mapped(pool, drape, jobs, threads)
        finally:
            cancelled.set()
            pool.shutdown(cancel_futures=True)
