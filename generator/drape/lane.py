"""A lane: one batch of garments with its own stream, and the replacement of its garments at rest."""

import contextlib
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import warp as wp
from jaxtyping import Bool

from gcd_dataset.generator.drape.config import DrapeConfig
from gcd_dataset.generator.drape.device import to_host
from gcd_dataset.generator.drape.kernels.world import RUNNING
from gcd_dataset.generator.drape.outcome import best_of, collect, crosses, slid_worlds
from gcd_dataset.generator.drape.passes import Pass, PendingJobs, next_batch
from gcd_dataset.generator.drape.solver import Solver
from gcd_dataset.generator.drape.streams import WorkStream
from gcd_dataset.records import Drape

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
        running = self._read_status()
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

    def free_memory(self) -> None:
        """Free the memory of past batches."""
        self._synchronize()

    def _collect(self) -> list[tuple[int, Drape]]:
        """The drapes of the garments that have ended their last fine pass; those that cross are draped again."""
        solver, passes = self._solver, self._passes
        assert solver is not None
        self._synchronize()
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
        self._synchronize()
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
        self._synchronize()

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

    def _read_status(self) -> Bool[np.ndarray, " w"]:
        assert self._status is not None
        return self._status.numpy() == RUNNING

    def _synchronize(self) -> None:
        if self._stream is not None:
            self._stream.wait()

    def _on_stream(self) -> contextlib.AbstractContextManager[None]:
        """Launch on the lane's stream; a CPU has none."""
        return contextlib.nullcontext() if self._stream is None else self._stream.active()
