"""Where the time of renderings goes: host and device time by stage, and the bytes copied."""

import contextlib
import threading
import time
from collections import defaultdict
from collections.abc import Iterator
from contextlib import AbstractContextManager

import warp as wp


class Profile:
    """Sums over the renderings that are started with it; several threads may share one.

    On a CPU kernels run in the calling thread: their time is host time.
    """

    def __init__(self, device: str) -> None:
        self._device = wp.get_device(device)
        self._lock = threading.Lock()
        self._spans: list[tuple[str, wp.Event, wp.Event]] = []
        self.host: defaultdict[str, float] = defaultdict(float)
        """Elapsed time of each stage on the host [s], in the order of first use."""
        self.cpu: defaultdict[str, float] = defaultdict(float)
        """CPU time of each stage in the thread that runs it [s]."""
        self.copied: defaultdict[str, int] = defaultdict(int)
        """Bytes copied, ``to device`` and ``to host``."""

    @contextlib.contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """Add the block to a stage: its time on the host, and the device's time for the work started in it."""
        elapsed, busy, start = time.perf_counter(), time.thread_time(), self._mark()
        yield
        elapsed, busy, end = time.perf_counter() - elapsed, time.thread_time() - busy, self._mark()
        with self._lock:
            self.host[name] += elapsed
            self.cpu[name] += busy
            if start is not None and end is not None:
                self._spans.append((name, start, end))

    def add_bytes(self, direction: str, count: int) -> None:
        """Add to ``copied``."""
        with self._lock:
            self.copied[direction] += count

    def device_times(self) -> dict[str, float]:
        """Time of each stage on the GPU [s], between two events on its stream; empty for a CPU. Waits for the device.

        Idle time counts where the host launches more slowly than the GPU works.
        """
        times: defaultdict[str, float] = defaultdict(float)
        for name, start, end in self._spans:
            times[name] += 1e-3 * wp.get_event_elapsed_time(start, end)
        return dict(times)

    def _mark(self) -> wp.Event | None:
        if not self._device.is_cuda:
            return None
        return wp.get_stream(self._device).record_event(wp.Event(self._device, enable_timing=True))


def in_stage(profile: Profile | None, name: str) -> AbstractContextManager[None]:
    """``profile.stage(name)``; without a profile, nothing."""
    return contextlib.nullcontext() if profile is None else profile.stage(name)
