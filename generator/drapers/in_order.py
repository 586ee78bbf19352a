"""Work of which parts are draped, given back in order: the next is prepared while those before are draped."""

from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Generic, TypeVar, Union

from gcd_dataset.generator.drapers.draper import Draper, DrapeReply, DrapeRequest
from gcd_dataset.waits import record_wait

if TYPE_CHECKING:
    from gcd_dataset.generator.drape import DrapeJob

__all__ = ["Work", "in_order"]

Made = TypeVar("Made")


@dataclass(frozen=True)
class Work(Generic[Made]):
    """Garments to be draped, and what becomes of them."""

    jobs: Sequence["DrapeJob"]
    finish: Callable[[Sequence[DrapeReply]], Union[Made, "Work[Made]"]]
    """From the drapes of ``jobs`` to the result, or to the next attempt."""
    picture: int = 0
    """Side of the pictures to be taken [pixels]; 0 for none."""


def in_order(work: Iterable[Work[Made]], draper: Draper | None, *, ahead: int, at_once: int) -> Iterator[Made]:
    """The results, in the order of ``work``, which may be infinite.

    Up to ``ahead`` pieces of work are begun before the first is handed out, up to ``at_once`` are draped at a time. One
    without jobs is finished as it is begun, and needs no ``draper``. Raises ``DrapeError`` where the draper
    cannot go on.
    """
    waiting = iter(work)
    line: deque[_Place[Made]] = deque()
    desk = _Desk(draper)
    ended: Exception | None = None
    while True:
        while desk.answered():
            desk.take()
        # Begin the next before handing out the first: the caller may be away for long.
        begun = False
        if ended is None and len(line) < ahead and desk.busy < at_once:
            try:
                line.append(desk.begin(next(waiting)))
                begun = True
            except Exception as error:  # noqa: BLE001 -- the end of the work, or an error: raised after those before it
                ended = error
        if line and line[0].results:
            yield line.popleft().results.pop()
        elif line and line[0].error is not None:
            raise line[0].error
        elif line and not begun:
            desk.take()
        elif not line and ended is not None:
            break
    if not isinstance(ended, StopIteration):
        raise ended


@dataclass
class _Place(Generic[Made]):
    """One piece of work in the line, and the drapes of its present attempt."""

    work: Work[Made]
    drapes: dict[int, DrapeReply] = field(default_factory=dict)
    results: list[Made] = field(default_factory=list)
    """None, or one."""
    error: Exception | None = None
    """The error that ended the work."""


class _Desk:
    """Orders that the draper has not answered."""

    def __init__(self, draper: Draper | None) -> None:
        self._draper = draper
        self._numbers = 0
        self._part_of: dict[int, tuple[_Place, int]] = {}
        self.busy = 0
        """Pieces of work at the draper."""

    def begin(self, work: Work[Made]) -> _Place[Made]:
        """Order the garments of a piece of work."""
        place = _Place(work)
        self.busy += 1
        self._order(place, again=False)
        return place

    def answered(self) -> bool:
        """Whether an answer can be taken without waiting."""
        return self._draper is not None and self.busy > 0 and self._draper.answered()

    def take(self) -> None:
        """Wait for one answer."""
        assert self._draper is not None  # work without jobs is never waited for
        answer = self._draper.answer()
        for name, wait in answer.waits.items():
            record_wait(name, wait)
        place, part = self._part_of.pop(answer.number)
        place.drapes[part] = answer
        try:
            self._finish(place)
        except Exception as error:  # noqa: BLE001 -- raised after the results before it
            place.error = error
            self.busy -= 1

    def _order(self, place: _Place, *, again: bool) -> None:
        place.drapes = {}
        for part, job in enumerate(place.work.jobs):
            assert self._draper is not None
            self._part_of[self._numbers] = place, part
            self._draper.ask(DrapeRequest(self._numbers, job, place.work.picture, again))
            self._numbers += 1
        self._finish(place)

    def _finish(self, place: _Place) -> None:
        """Finish the work if all its garments are draped: the result, or another attempt."""
        count = len(place.work.jobs)
        if len(place.drapes) < count:
            return
        result = place.work.finish([place.drapes[part] for part in range(count)])
        if isinstance(result, Work):
            place.work = result
            self._order(place, again=True)
        else:
            place.results.append(result)
            self.busy -= 1
