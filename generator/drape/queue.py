"""Continuous batching: a garment that has come to rest leaves its world in the batch to the next job."""

import time
from collections.abc import Callable, Iterable, Iterator

import warp as wp

from gcd_dataset.generator.drape.config import DrapeConfig, DrapeJob
from gcd_dataset.generator.drape.device import keep_freed_memory
from gcd_dataset.generator.drape.lane import Lane
from gcd_dataset.generator.drape.passes import PendingJobs, PreparedJob
from gcd_dataset.generator.drape.solver import nothing
from gcd_dataset.generator.drape.streams import work_streams
from gcd_dataset.records import Drape

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
    batches = _lanes(pending, config, device, at_once, count, between)
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
            lane.free_memory()
    if pending.error is not None:
        raise pending.error


def _lanes(
    pending: PendingJobs, config: DrapeConfig, device: str, at_once: int, count: int, between: Callable[[], None]
) -> list[Lane]:
    """``count`` lanes with room for ``at_once`` garments in total."""
    sizes = [at_once // count + (number < at_once % count) for number in range(count)]
    streams = work_streams(device, count)
    return [
        Lane(pending, config, device, size=size, stream=stream, between=between)
        for size, stream in zip(sizes, streams, strict=True)
    ]
