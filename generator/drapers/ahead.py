"""Samples in order, the next ones prepared here while those before are draped by another process."""

from collections import Counter, deque
from collections.abc import Callable, Iterable, Iterator, Mapping
from functools import partial
from typing import Generic, TypeVar

from gcd_dataset.generator.drapers.asking import Asking, Draped, Order
from gcd_dataset.generator.drapers.place import Place
from gcd_dataset.generator.last_design import LastDesign, MadeDesign
from gcd_dataset.generator.pipeline import DressedDesign, finish, prepare, turned_down
from gcd_dataset.generator.recipe import MakeConfig
from gcd_dataset.records import Sample

__all__ = ["make_ahead"]


Made = TypeVar("Made")


def make_ahead(
    seed: int,
    indices: Iterable[int],
    config: MakeConfig,
    place: Place,
    *,
    ahead: int,
    finished: Callable[[Sample], Made],
    at_once: int | None = None,
    known: Callable[[int], Made | None] = lambda index: None,
    last: LastDesign | None = None,
    pictured: bool = True,
) -> Iterator[Made]:
    """What ``finished`` makes of the samples of ``indices``, which may be endless, in order: those of ``make_many``.

    Up to ``ahead`` of them are begun before the first is handed out, up to ``at_once`` designs draped at a time.
    ``known``: what there is already of an index, which is not made then. ``last`` and ``pictured``: as for
    ``make_many``. ``place`` belongs to ``config.device``. Raises ``PatternError`` as ``make_many`` does, ``DrapeError``
    where the draper is no more.
    """
    in_work = _InWork(
        seed, iter(indices), config, ahead, at_once or ahead, finished, known, last or LastDesign(), pictured
    )
    with Asking(place) as asking:
        yield from in_work.all(asking)


class _InWork(Generic[Made]):
    """Garments asked for and not yet handed out."""

    def __init__(
        self,
        seed: int,
        indices: Iterator[int],
        config: MakeConfig,
        ahead: int,
        at_once: int,
        finished: Callable[[Sample], Made],
        known: Callable[[int], Made | None],
        last: LastDesign,
        pictured: bool,
    ) -> None:
        self._seed, self._indices, self._config = seed, indices, config
        self._ahead, self._at_once = ahead, at_once
        self._finished, self._known, self._last, self._pictured = finished, known, last, pictured
        self._order: deque[int] = deque()
        self._asked: Counter[int] = Counter()
        self._designs: dict[int, DressedDesign] = {}
        self._draped: dict[int, dict[int, Draped]] = {}
        self._done: dict[int, Made] = {}
        self._ended = False

    def all(self, asking: Asking) -> Iterator[Made]:
        """All of them, in order."""
        while True:
            while self._designs and asking.answered():
                self._take(asking.answer(), asking)
            # Before one is handed out: nothing goes on here until the next is asked for.
            begun = self._begin_next(asking)
            if self._order and self._order[0] in self._done:
                yield self._handed_out()
            elif not self._order:
                return
            elif not begun:
                self._take(asking.answer(), asking)

    def _begin_next(self, asking: Asking) -> bool:
        """Begin one more if there is room for it; whether that was done."""
        if self._ended or len(self._order) >= self._ahead or len(self._designs) >= self._at_once:
            return False
        index = next(self._indices, None)
        self._ended = index is None
        if index is not None:
            self._begin(index, asking)
        return index is not None

    def _begin(self, index: int, asking: Asking) -> None:
        """Have a sample's design draped, unless that is under way or done."""
        self._order.append(index)
        self._asked[index] += 1
        number = index // self._config.wearers
        if number in self._designs or index in self._done:
            return
        known, made = self._known(index), self._last.made
        if known is not None:
            self._done[index] = known
        elif made is not None and made.number == number:
            self._done[index] = self._finished(made.sample_of(index))
        else:
            self._send(prepare(self._seed, number, self._config), asking)

    def _send(self, design: DressedDesign, asking: Asking, *, again: bool = False) -> None:
        from gcd_dataset.generator.drape import DrapeJob, fabric_named

        fabric = fabric_named(self._config.fabric)
        self._designs[design.number], self._draped[design.number] = design, {}
        for worn in design.dressed:
            assert worn.box_mesh is not None  # the stage is "drape"
            job = DrapeJob(worn.box_mesh, worn.body, worn.size, fabric, worn.coarse)
            asking.ask(Order(worn.index, job, self._config.picture if self._pictured else 0, again))

    def _take(self, answer: Draped, asking: Asking) -> None:
        """Finish the samples of a design when all of its wearers are draped, or try the next design."""
        number = answer.number // self._config.wearers
        design, draped = self._designs[number], self._draped[number]
        draped[answer.number] = answer
        if len(draped) < len(design.dressed):
            return
        del self._designs[number], self._draped[number]
        failed = turned_down(design, [draped[worn.index].drape for worn in design.dressed], self._config)
        if failed is not None:
            self._send(prepare(self._seed, number, self._config, failed.rejects), asking, again=True)
            return
        made = MadeDesign(number, partial(_sample, design, draped, self._config, self._pictured))
        for worn in design.dressed:
            if worn.index not in self._asked:
                self._last.made = made
            elif worn.index not in self._done:
                self._done[worn.index] = self._finished(made.sample_of(worn.index))

    def _handed_out(self) -> Made:
        index = self._order.popleft()
        self._asked[index] -= 1
        if self._asked[index]:
            return self._done[index]
        del self._asked[index]
        return self._done.pop(index)


def _sample(
    design: DressedDesign, draped: Mapping[int, Draped], config: MakeConfig, pictured: bool, index: int
) -> Sample:
    from gcd_dataset.generator.drawing import jpeg_bytes

    worn, answer = design.dressed[index % config.wearers], draped[index]
    pictures = None if answer.pictures is None else (jpeg_bytes(answer.pictures[0]), jpeg_bytes(answer.pictures[1]))
    return finish(design, worn, config, answer.drape, pictures, pictured)
