"""Makes samples: ``produce`` yields the finished samples of any indices in order, from one process or many.

indices ─► prepare (body, measures, design, pattern, box mesh) ─► draper ─► finish (points, pictures) ─► samples
              ▲                                                     │
              └──────────── next attempt, if a drape failed ◄───────┘
"""

from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import groupby
from typing import Any, Generic, TypeVar, overload

from gcd_dataset.devicenames import devices_name
from gcd_dataset.generator.drapers import Draper, DraperAddress, DrapeReply, SharedDraper, addresses_for
from gcd_dataset.generator.drapers.address import AT_ONCE
from gcd_dataset.generator.drapers.draper import DrapeWork, in_order
from gcd_dataset.generator.pipeline import (
    NO_REDRAWS,
    DrapedDesign,
    DressedDesign,
    all_replies,
    drape_jobs,
    finish,
    prepare,
    rejection,
    shown_under,
    view_requests,
)
from gcd_dataset.generator.recipe import MakeConfig, devices_of
from gcd_dataset.records import Rejected, Sample
from gcd_dataset.workers import prefetch, streams

DEFAULT = MakeConfig()
# Samples in work in a worker: twice the number at its draper, so that the draper stays busy while finished samples wait
# for an earlier one on its next attempt.
MOVING_AT_ONCE = 8  # garments with a motion in work in each process: a second of it takes 9 MB
AHEAD = 2 * AT_ONCE
# Finished samples buffered in a worker. Designs are dealt round-robin and yielded in order, so one slow design blocks
# all workers. In a simulation with 14 workers, a buffer of 24 samples reaches 0.77 of the drapers' rate, 48 samples
# reach 0.90, and 72 reach 0.97.
READY = 3 * AT_ONCE

Made = TypeVar("Made")


def make(seed: int, index: int, config: MakeConfig = DEFAULT) -> Sample:
    """Sample ``index`` of ``seed``. Raises ``PatternError`` after ``config.max_attempts`` rejected designs."""
    return next(produce(seed, [index], config))


@overload
def produce(
    seed: int,
    indices: Iterable[int],
    config: MakeConfig = ...,
    *,
    draper: Draper | None = ...,
    workers: int = ...,
    ahead: int | None = ...,
    last: "LastDesign | None" = ...,
    pictured: bool = ...,
) -> Iterator[Sample]: ...
@overload
def produce(
    seed: int,
    indices: Iterable[int],
    config: MakeConfig = ...,
    *,
    finished: Callable[[Sample], Made],
    draper: Draper | None = ...,
    workers: int = ...,
    ahead: int | None = ...,
    known: Callable[[int], Made | None] = ...,
    last: "LastDesign | None" = ...,
    pictured: bool = ...,
) -> Iterator[Made]: ...
def produce(
    seed: int,
    indices: Iterable[int],
    config: MakeConfig = DEFAULT,
    *,
    draper: Draper | None = None,
    workers: int = 0,
    ahead: int | None = None,
    finished: Callable[[Sample], Any] | None = None,
    known: Callable[[int], Any] = lambda index: None,
    last: "LastDesign | None" = None,
    pictured: bool = True,
) -> Iterator[Any]:
    """The samples of ``indices``, in order; the same bytes with any draper and any number of workers.

    ``draper``: default: this process drapes on ``config.device``. A draper that is passed in stays open.
    ``workers``: from 2 on, this many processes make the samples, designs round-robin, and each GPU gets one draping
    process; ``indices`` must be finite then, and ``finished`` must pickle (a module-level function).
    ``ahead``: samples in work before the first is yielded; default: one batch of the draper.
    ``finished``: maps a sample to the result yielded for it, such as ``encode_sample``; default: the sample itself.
    ``known``: maps an index to an existing result, which is yielded; ``None`` for an index: make its sample.
    ``last``: cache of the last design. All wearers of a design are made together; this caches the samples that were not
    requested, for the next call. ``pictured=False`` skips the pictures and changes nothing else.

    Raises ``PatternError`` after ``config.max_attempts`` rejected designs of an index, ``ConfigError`` for a missing
    device, ``DrapeError`` if the draper fails, ``GcdError`` if a worker is killed.
    """
    finished = finished or _unchanged
    if workers > 1:
        yield from _by_workers(seed, tuple(indices), config, workers, finished, pictured)
        return
    with ExitStack() as opened:
        if draper is None and config.stage == "drape":
            from gcd_dataset.generator.drapers.local import LocalDraper

            draper = opened.enter_context(LocalDraper(devices_of(config)[0]))
        most = 1 if draper is None else min(draper.at_once, MOVING_AT_ONCE) if config.motion else draper.at_once
        at_once = max(most // config.wearers, 1)
        pending = _Pending(seed, config, finished, known, last or LastDesign(), pictured)
        for index in in_order(pending.work(indices), draper, ahead=ahead or at_once * config.wearers, at_once=at_once):
            yield pending.pop(index)


class LastDesign:
    """A cache of the last design, for samples of its other wearers that may be requested next.

    Use one for each seed and recipe. Unpickles empty: each process caches its own design.
    """

    def __init__(self) -> None:
        # A single attribute, replaced atomically: threads may share a data set.
        self._cached: tuple[int, Callable[[int], Sample]] | None = None

    def of(self, number: int) -> Callable[[int], Sample] | None:
        """The function from index to sample of design ``number``, if that design is cached."""
        cached = self._cached
        return cached[1] if cached is not None and cached[0] == number else None

    def keep(self, number: int, sample_of: Callable[[int], Sample]) -> None:
        """Cache design ``number`` instead of the previous one; ``sample_of`` maps its indices to samples."""
        self._cached = number, sample_of

    def __reduce__(self) -> tuple[type["LastDesign"], tuple[()]]:
        return LastDesign, ()


@dataclass
class _Pending(Generic[Made]):
    """Samples requested and not yet yielded."""

    seed: int
    config: MakeConfig
    finished: Callable[[Sample], Made]
    known: Callable[[int], Made | None]
    last: LastDesign
    pictured: bool
    count: Counter[int] = field(default_factory=Counter)  # open requests of each index
    under_way: set[int] = field(default_factory=set)  # numbers of the designs in work
    done: dict[int, Made] = field(default_factory=dict)  # results by index, until all its requests are served

    def work(self, indices: Iterable[int]) -> Iterator[DrapeWork[int]]:
        """Work for each index, with the index as its result; without jobs if the design is in work or done."""
        for index in indices:
            self.count[index] += 1
            number = index // self.config.wearers
            if number in self.under_way or index in self.done or self._is_known(index):
                yield DrapeWork((), lambda _, index=index: index)  # type: ignore[misc]
            else:
                self.under_way.add(number)
                yield self._attempt(index)

    def pop(self, index: int) -> Made:
        """Serve one request of an index; the last one removes the result."""
        self.count[index] -= 1
        if self.count[index]:
            return self.done[index]
        del self.count[index]
        return self.done.pop(index)

    def _is_known(self, index: int) -> bool:
        result = self.known(index)
        if result is None and (sample_of := self.last.of(index // self.config.wearers)) is not None:
            result = self.finished(sample_of(index))
        if result is not None:
            self.done[index] = result
        return result is not None

    def _attempt(
        self,
        index: int,
        rejects: tuple[Rejected, ...] = (),
        redraws: Mapping[str, int] = NO_REDRAWS,
        under: tuple[DrapedDesign, ...] = (),
    ) -> DrapeWork[int]:
        """The next accepted design for an index, or for the next garment of its outfit, as drape jobs."""
        config = self.config
        design = prepare(self.seed, index // config.wearers, config, rejects, redraws, under)
        jobs, finished = drape_jobs(design, config), partial(self._finish, index, design)
        maps = config.maps and not under
        motions = [wearer.motion for wearer in design.dressed if wearer.is_draped]
        if not (self.pictured and design.is_outermost):
            return DrapeWork(jobs, finished, maps=maps, motions=motions)
        under_jobs, views = shown_under(design) if jobs else (), view_requests(design, config)
        return DrapeWork(jobs, finished, config.picture, views, maps, motions, under_jobs)

    def _finish(self, index: int, design: DressedDesign, replies: Sequence[DrapeReply]) -> int | DrapeWork[int]:
        """Finish the requested samples of a design; return the next attempt if a drape failed, or the next garment."""
        replies = all_replies(design, replies, self.config)
        failed = rejection(design, [reply.drape for reply in replies], self.config)
        if failed is not None:
            return self._attempt(index, (*design.rejects, failed), design.redraws, design.under)
        if not design.is_outermost:
            return self._attempt(index, under=(*design.under, DrapedDesign(design, replies)))
        self.under_way.remove(design.number)
        sample_of = partial(_sample_of, design, replies, self.config)
        for wearer in design.dressed:
            if wearer.index not in self.count:
                self.last.keep(design.number, sample_of)
            elif wearer.index not in self.done:
                self.done[wearer.index] = self.finished(sample_of(wearer.index))
        return index


def _sample_of(design: DressedDesign, replies: Sequence[DrapeReply], config: MakeConfig, index: int) -> Sample:
    return finish(design, index, config, replies[index % config.wearers] if replies else None)


def _unchanged(sample: Sample) -> Sample:
    return sample


@dataclass(frozen=True)
class _WorkerShare:
    """The samples of one worker and the options to make them."""

    seed: int
    indices: tuple[int, ...]
    config: MakeConfig
    address: DraperAddress | None  # the draping process; ``None``: the worker drapes on the CPU
    finished: Callable[[Sample], Any]
    pictured: bool

    def run(self) -> Iterator[Any]:
        """The results, in order; a thread makes the next results while the worker sends one."""
        with ExitStack() as opened:
            draper: Draper | None = None
            ahead = None
            if self.address is not None:
                draper, ahead = opened.enter_context(SharedDraper(self.address)), AHEAD
            elif self.config.stage == "drape":
                from gcd_dataset.generator.drapers.local import LocalDraper

                draper = opened.enter_context(LocalDraper("cpu", at_once=1))
            options = {"draper": draper, "ahead": ahead, "finished": self.finished, "pictured": self.pictured}
            results = produce(self.seed, self.indices, self.config, **options)  # type: ignore[call-overload]
            yield from prefetch(results, READY)


def _by_workers(
    seed: int,
    indices: tuple[int, ...],
    config: MakeConfig,
    workers: int,
    finished: Callable[[Sample], Any],
    pictured: bool,
) -> Iterator[Any]:
    """The results of worker processes, in the order of ``indices``; designs are dealt round-robin."""
    devices = devices_of(config) if config.stage == "drape" else ("cpu",)
    addresses = addresses_for(devices)
    # Resolve "auto" here: a worker that resolves it would initialise CUDA.
    config = replace(config, device=devices_name(devices))
    shares = [
        _WorkerShare(seed, subset, config, addresses[k % len(addresses)], finished, pictured)
        for k, subset in enumerate(_round_robin(indices, config, workers))
    ]
    with streams(_WorkerShare.run, shares) as results:
        for turn, group in enumerate(_designs(indices, config)):
            for _ in group:
                yield next(results[turn % workers])


def _round_robin(indices: Iterable[int], config: MakeConfig, workers: int) -> list[tuple[int, ...]]:
    """The indices of each worker: whole designs, round-robin.

    >>> _round_robin([0, 1, 2, 3, 5, 6, 7], MakeConfig(bodies="both"), 2)
    [(0, 1, 5), (2, 3, 6, 7)]
    """
    shares: list[list[int]] = [[] for _ in range(workers)]
    for turn, group in enumerate(_designs(indices, config)):
        shares[turn % workers].extend(group)
    return [tuple(share) for share in shares]


def _designs(indices: Iterable[int], config: MakeConfig) -> Iterator[Iterator[int]]:
    """Runs of consecutive indices of the same design."""
    return (group for _, group in groupby(indices, key=lambda index: index // config.wearers))
