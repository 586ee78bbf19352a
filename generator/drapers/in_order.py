"""Run work that needs drapes and yield its results in order: later pieces are prepared while earlier ones drape."""

from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Generic, TypeVar, Union

from gcd_dataset.generator.drapers.draper import Draper, DrapeReply, DrapeRequest
from gcd_dataset.generator.views import ViewRequest

if TYPE_CHECKING:
    from gcd_dataset.generator.drape import DrapeJob

Made = TypeVar("Made")


@dataclass(frozen=True)
class Work(Generic[Made]):
    """Garments to drape, and the function that makes the result from their drapes."""

    jobs: Sequence["DrapeJob"]
    finish: Callable[[Sequence[DrapeReply]], Union[Made, "Work[Made]"]]
    """Makes the result, or the work of another attempt, from the replies in the order of ``jobs``."""
    picture: int = 0
    """Side of front and back [pixels]; 0 for none."""
    views: Sequence[ViewRequest] = ()
    """The drawn views of each job; empty for none."""


def in_order(work: Iterable[Work[Made]], draper: Draper | None, *, ahead: int, at_once: int) -> Iterator[Made]:
    """The results in the order of ``work``, which may be infinite.

    Begins up to ``ahead`` pieces before it yields the first, and drapes up to ``at_once`` pieces at a time. A piece
    without jobs is finished as it begins and needs no ``draper``. An error of a piece is raised after the results
    of the earlier pieces. Raises ``DrapeError`` if the draper fails.
    """
    upcoming = iter(work)
    tasks: deque[_Task[Made]] = deque()
    dispatcher = _Dispatcher(draper)
    ended: Exception | None = None
    while True:
        while dispatcher.poll():
            dispatcher.receive()
        # Begin the next task before yielding: the consumer may take long, and the draper must not run dry.
        begun = False
        if ended is None and len(tasks) < ahead and dispatcher.busy < at_once:
            try:
                tasks.append(dispatcher.begin(next(upcoming)))
                begun = True
            except Exception as error:  # noqa: BLE001 -- StopIteration, or an error: raised after the earlier results
                ended = error
        if tasks and tasks[0].results:
            yield tasks.popleft().results.pop()
        elif tasks and tasks[0].error is not None:
            raise tasks[0].error
        elif tasks and not begun:
            dispatcher.receive()
        elif not tasks and ended is not None:
            break
    if not isinstance(ended, StopIteration):
        raise ended


@dataclass
class _Task(Generic[Made]):
    """A piece of work that has begun, and the replies of its present attempt."""

    work: Work[Made]
    replies: dict[int, DrapeReply] = field(default_factory=dict)
    """Replies by index of the job."""
    results: list[Made] = field(default_factory=list)
    """The result in a list of one; empty before the piece is finished."""
    error: Exception | None = None


class _Dispatcher:
    """Sends the jobs of tasks to the draper, and assigns each reply to its task."""

    def __init__(self, draper: Draper | None) -> None:
        self._draper = draper
        self._next_number = 0
        self._job_of: dict[int, tuple[_Task, int]] = {}
        """Task and index of the job, by the number of the request."""
        self.busy = 0
        """Tasks that are neither finished nor failed."""

    def begin(self, work: Work[Made]) -> _Task[Made]:
        """Send the jobs of a new task."""
        task = _Task(work)
        self.busy += 1
        self._send(task, retry=False)
        return task

    def poll(self) -> bool:
        """Whether ``receive`` would return without waiting."""
        return self._draper is not None and self.busy > 0 and self._draper.poll()

    def receive(self) -> None:
        """Wait for one reply; finish its task if that was the last."""
        assert self._draper is not None  # tasks without jobs are never waited for
        reply = self._draper.receive()
        task, job = self._job_of.pop(reply.number)
        task.replies[job] = reply
        try:
            self._finish(task)
        except Exception as error:  # noqa: BLE001 -- raised after the earlier results
            task.error = error
            self.busy -= 1

    def _send(self, task: _Task, *, retry: bool) -> None:
        task.replies = {}
        for number, job in enumerate(task.work.jobs):
            assert self._draper is not None
            self._job_of[self._next_number] = task, number
            views = task.work.views[number] if task.work.views else None
            self._draper.send(DrapeRequest(self._next_number, job, task.work.picture, retry, views))
            self._next_number += 1
        self._finish(task)

    def _finish(self, task: _Task) -> None:
        """If all jobs are draped, store the result or send the next attempt."""
        count = len(task.work.jobs)
        if len(task.replies) < count:
            return
        result = task.work.finish([task.replies[job] for job in range(count)])
        if isinstance(result, Work):
            task.work = result
            self._send(task, retry=True)
        else:
            task.results.append(result)
            self.busy -= 1
