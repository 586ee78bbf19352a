"""The one maker: finished samples of any indices, in order, from this process or from many.

indices ─► prepare (body, measures, design, pattern, box mesh) ─► draper ─► finish (points, pictures) ─► samples
              ▲                                                     │
              └──────────── the next design, where a drape failed ◄─┘
"""

from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import groupby
from typing import Any, Generic, TypeVar, overload

from gcd_dataset.generator.drapers import Draper, DraperAddress, DrapeReply, SharedDraper, addresses_for
from gcd_dataset.generator.drapers.in_order import Work, in_order
from gcd_dataset.generator.drapers.shared import AT_ONCE
from gcd_dataset.generator.pipeline import DressedDesign, drape_jobs, finish, prepare, turned_down
from gcd_dataset.generator.recipe import MakeConfig, devices_name, devices_of
from gcd_dataset.prefetch import prefetch
from gcd_dataset.records import Rejected, Sample
from gcd_dataset.waits import MAKERS
from gcd_dataset.workers import streams

__all__ = ["AHEAD", "READY", "LastDesign", "make", "produce"]

DEFAULT = MakeConfig()
# What a worker may have in work, as multiples of what it has at its draper.
AHEAD = 2 * AT_ONCE  # samples begun before the first is done: as many wait for one that is tried again as are draped
# Finished samples that wait to be taken: workers have the designs by turns, and all wait for one whose garments take
# long. Simulated with 14 workers, 24 samples let 0.77 of the drapers' rate arrive, 48 0.90 and 72 0.97.
READY = 3 * AT_ONCE

Made = TypeVar("Made")


def make(seed: int, index: int, config: MakeConfig = DEFAULT) -> Sample:
    """Sample ``index`` of ``seed``. Raises ``PatternError`` where ``config.max_attempts`` designs were turned down."""
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
    """The samples of ``indices``, in order; the same bytes by any draper and any number of workers.

    ``draper``: by default this process drapes on ``config.device``; the caller closes one that it gives.
    ``workers``: so many processes, from 2 on, make the samples by turns, and on GPUs one more for each drapes for all
    of them; ``indices`` must be finite then, and ``finished`` known by name.
    ``ahead``: samples that may be begun before the first is handed out; by default as many as are draped at a time.
    ``finished``: what is handed out for a sample, such as ``encode_sample``; by default the sample.
    ``known``: what is there already for an index, which is not made then; ``None`` for nothing.
    ``last``: with several bodies for a design, all of them are made although one is asked for; the others wait there
    for the next call. Without ``pictured`` no pictures are taken, and all else is the same.

    Raises ``PatternError`` where ``config.max_attempts`` designs of an index were turned down, ``ConfigError`` for a
    device that is not there, ``DrapeError`` where the draper cannot go on, ``GcdError`` where a worker is killed.
    """
    finished = finished or _whole
    if workers > 1:
        yield from _by_workers(seed, tuple(indices), config, workers, finished, pictured)
        return
    with ExitStack() as opened:
        if draper is None and config.stage == "drape":
            draper = opened.enter_context(_draper_here(config))
        at_once = 1 if draper is None else max(draper.at_once // config.wearers, 1)
        asked = _Asked(seed, config, finished, known, last or LastDesign(), pictured)
        for index in in_order(asked.work(indices), draper, ahead=ahead or at_once * config.wearers, at_once=at_once):
            yield asked.handed_out(index)


class LastDesign:
    """Room for one design, of one seed and recipe, of which not all samples were asked for.

    Comes out of a pickle empty: each process remembers its own.
    """

    def __init__(self) -> None:
        # One attribute, replaced at once: threads may share a data set.
        self._kept: tuple[int, Callable[[int], Sample]] | None = None

    def of(self, number: int) -> Callable[[int], Sample] | None:
        """The samples of a design by their index, if it is the one that is kept."""
        kept = self._kept
        return kept[1] if kept is not None and kept[0] == number else None

    def keep(self, number: int, sample_of: Callable[[int], Sample]) -> None:
        """Remember a design in the place of the one before; ``sample_of`` takes an index of one of its wearers."""
        self._kept = number, sample_of

    def __reduce__(self) -> tuple[type["LastDesign"], tuple[()]]:
        return LastDesign, ()


@dataclass
class _Asked(Generic[Made]):
    """Samples asked for and not yet handed out."""

    seed: int
    config: MakeConfig
    finished: Callable[[Sample], Made]
    known: Callable[[int], Made | None]
    last: LastDesign
    pictured: bool
    count: Counter[int] = field(default_factory=Counter)
    """How often each index waits to be handed out."""
    under_way: set[int] = field(default_factory=set)
    """Numbers of designs."""
    done: dict[int, Made] = field(default_factory=dict)

    def work(self, indices: Iterable[int]) -> Iterator[Work[int]]:
        """A piece of work for each index, which ends with the index; an empty one for all but the first of a design."""
        for index in indices:
            self.count[index] += 1
            number = index // self.config.wearers
            if number in self.under_way or index in self.done or self._is_known(index):
                yield Work((), lambda _, index=index: index)  # type: ignore[misc]
            else:
                self.under_way.add(number)
                yield self._attempt(index, ())

    def handed_out(self, index: int) -> Made:
        """The result for an index; it is forgotten when nothing waits for it any more."""
        self.count[index] -= 1
        if self.count[index]:
            return self.done[index]
        del self.count[index]
        return self.done.pop(index)

    def _is_known(self, index: int) -> bool:
        known = self.known(index)
        if known is None and (sample_of := self.last.of(index // self.config.wearers)) is not None:
            known = self.finished(sample_of(index))
        if known is not None:
            self.done[index] = known
        return known is not None

    def _attempt(self, index: int, rejects: tuple[Rejected, ...]) -> Work[int]:
        """The next design of an index that can be worn, to be draped."""
        design = prepare(self.seed, index // self.config.wearers, self.config, rejects)
        picture = self.config.picture if self.pictured else 0
        return Work(drape_jobs(design, self.config), partial(self._end, index, design), picture)

    def _end(self, index: int, design: DressedDesign, draped: Sequence[DrapeReply]) -> int | Work[int]:
        """Finish the samples of a design that are asked for, or try the next design."""
        failed = turned_down(design, [garment.drape for garment in draped], self.config)
        if failed is not None:
            return self._attempt(index, failed.rejects)
        self.under_way.remove(design.number)
        sample_of = partial(_sample_of, design, tuple(draped), self.config)
        for worn in design.dressed:
            if worn.index not in self.count:
                self.last.keep(design.number, sample_of)
            elif worn.index not in self.done:
                self.done[worn.index] = self.finished(sample_of(worn.index))
        return index


def _sample_of(design: DressedDesign, draped: Sequence[DrapeReply], config: MakeConfig, index: int) -> Sample:
    return finish(design, index, config, draped[index % config.wearers] if draped else None)


def _draper_here(config: MakeConfig) -> Draper:
    from gcd_dataset.generator.drapers.local import LocalDraper

    return LocalDraper(devices_of(config)[0])


def _whole(sample: Sample) -> Sample:
    return sample


# ------------------------------------------------------------------------------------------------------------- workers


@dataclass(frozen=True)
class _Share:
    """What one worker makes."""

    seed: int
    indices: tuple[int, ...]
    config: MakeConfig
    place: DraperAddress | None
    """Where its garments are draped; ``None``: in the worker."""
    finished: Callable[[Sample], Any]
    pictured: bool

    def made(self) -> Iterator[Any]:
        """The results, in order; the next are made by a thread while one is handed over."""
        with ExitStack() as opened:
            draper: Draper | None = None
            ahead = None
            if self.place is not None:
                draper, ahead = opened.enter_context(SharedDraper(self.place)), AHEAD
            elif self.config.stage == "drape":
                from gcd_dataset.generator.drapers.local import LocalDraper

                draper = opened.enter_context(LocalDraper("cpu", at_once=1))
            options = {"draper": draper, "ahead": ahead, "finished": self.finished, "pictured": self.pictured}
            made = produce(self.seed, self.indices, self.config, **options)  # type: ignore[call-overload]
            yield from prefetch(made, READY, name=MAKERS)


def _by_workers(
    seed: int,
    indices: tuple[int, ...],
    config: MakeConfig,
    workers: int,
    finished: Callable[[Sample], Any],
    pictured: bool,
) -> Iterator[Any]:
    """The results of workers that have the designs by turns."""
    devices = devices_of(config) if config.stage == "drape" else ("cpu",)
    places = addresses_for(devices)
    # By name: workers that looked for the devices themselves would each start CUDA.
    config = replace(config, device=devices_name(devices))
    shares = [
        _Share(seed, own, config, places[k % len(places)], finished, pictured)
        for k, own in enumerate(_dealt(indices, config, workers))
    ]
    with streams(_Share.made, shares) as made:
        for turn, group in enumerate(_designs(indices, config)):
            for _ in group:
                yield next(made[turn % workers])


def _dealt(indices: Iterable[int], config: MakeConfig, workers: int) -> list[tuple[int, ...]]:
    """The indices of each worker: designs by turns.

    >>> _dealt([0, 1, 2, 3, 5, 6, 7], MakeConfig(bodies="both"), 2)
    [(0, 1, 5), (2, 3, 6, 7)]
    """
    hands: list[list[int]] = [[] for _ in range(workers)]
    for turn, group in enumerate(_designs(indices, config)):
        hands[turn % workers].extend(group)
    return [tuple(hand) for hand in hands]


def _designs(indices: Iterable[int], config: MakeConfig) -> Iterator[Iterator[int]]:
    """Indices in a row of one design."""
    return (group for _, group in groupby(indices, key=lambda index: index // config.wearers))
