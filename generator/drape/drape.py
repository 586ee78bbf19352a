"""Box meshes and bodies in, garments at rest out."""

import threading
from collections import deque
from collections.abc import Iterable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor

import warp as wp

from gcd_dataset.errors import DrapeError
from gcd_dataset.generator.drape.config import DrapeConfig, DrapeJob
from gcd_dataset.generator.drape.device import cores, resolve_device
from gcd_dataset.generator.drape.loading import load_drape
from gcd_dataset.generator.drape.queue import drape_in_turn
from gcd_dataset.records import Drape

__all__ = ["drape_all", "drape_batch", "places_on"]

DEFAULT = DrapeConfig()
AT_ONCE = 128  # garments on a GPU: at 1 cm they fill an H200
ROOM = 100e6  # bytes for each: 60 MB were measured at 1 cm, 12 000 vertices in the mean
SHARE = 0.7  # of a GPU's free memory


def drape_batch(
    jobs: Sequence[DrapeJob], config: DrapeConfig = DEFAULT, *, device: str = "auto", at_once: int | None = None
) -> list[Drape]:
    """The garments at rest on their bodies, one ``Drape`` for each job, in order.

    On a GPU ``at_once`` garments are simulated at the same time (128, or as many as its free memory holds), on a CPU so
    many threads drape one each (as many as there are cores). Each gives the same result alone as in any batch. A
    garment that does not come to rest, or comes to rest badly, is returned with the ``Outcome`` that says so.
    Raises ``ConfigError`` for a device that is not there, ``DrapeError`` for a box mesh without faces.
    """
    return list(drape_all(jobs, config, device=device, at_once=at_once))


def drape_all(
    jobs: Iterable[DrapeJob], config: DrapeConfig = DEFAULT, *, device: str = "auto", at_once: int | None = None
) -> Iterator[Drape]:
    """The same for any number of jobs, which are taken as there is room for them, and given back in their order."""
    device = resolve_device(device)
    checked = _checked(jobs, device)
    if device == "cpu":
        yield from _by_threads(checked, config, at_once or places_on(device))
        return
    early: dict[int, Drape] = {}
    following = 0
    for number, drape in drape_in_turn(checked, config, device=device, at_once=at_once or places_on(device)):
        early[number] = drape
        while following in early:
            yield early.pop(following)
            following += 1


def places_on(device: str, *, sharers: int = 1) -> int:
    """Garments that a device drapes at once: enough to fill a GPU, as far as its memory goes; one for each core.

    ``sharers``: processes that drape on the GPU, each with as many garments.
    """
    if device == "cpu":
        return cores()
    return places_in(wp.get_device(device).free_memory / sharers)


def places_in(free: float) -> int:
    """The same by its free memory [bytes].

    >>> places_in(139e9), places_in(8e9), places_in(0.0)
    (128, 56, 1)
    """
    return min(max(int(SHARE * free / ROOM), 1), AT_ONCE)


def _checked(jobs: Iterable[DrapeJob], device: str) -> Iterator[DrapeJob]:
    """The jobs; kernels are compiled with the first, in the thread that asks, which Ctrl-C reaches."""
    for number, job in enumerate(jobs):
        if len(job.box_mesh.faces) == 0:
            raise DrapeError(f"garment {number} has no faces: build its box mesh from a pattern with panels")
        if number == 0:
            load_drape(device)
        yield job


class _Left(Exception):  # noqa: N818 - no error: seen by nobody
    """Ends a drape that nobody waits for any more."""


def _by_threads(jobs: Iterable[DrapeJob], config: DrapeConfig, threads: int) -> Iterator[Drape]:
    """One garment a thread: a graph is played without the interpreter's lock. Those under way stop where the caller
    does, as by Ctrl-C."""

    left = threading.Event()

    def require_wanted() -> None:
        if left.is_set():
            raise _Left

    def drape(job: DrapeJob) -> Drape:
        [(_, done)] = drape_in_turn([job], config, device="cpu", at_once=1, between=require_wanted)
        return done

    ahead: deque[Future[Drape]] = deque()
    waiting, ended = iter(jobs), None
    with ThreadPoolExecutor(threads) as pool:
        try:
            while ended is None or ahead:
                try:
                    while ended is None and len(ahead) < threads:
                        ahead.append(pool.submit(drape, next(waiting)))
                except Exception as error:  # noqa: BLE001 - their end, or whatever is wrong with one: told after those before
                    ended = error
                if ahead:
                    yield ahead.popleft().result()
        finally:
            left.set()
            for future in ahead:
                future.cancel()
    if not isinstance(ended, StopIteration):
        raise ended
