"""The draper interface, and work through a draper: later pieces are prepared while earlier ones drape."""

from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, Generic, Protocol, Self, TypeVar, Union

import numpy as np
from jaxtyping import Float32, UInt8

from gcd_dataset.generator.views import RenderedView, ViewRequest, finished_view, requested_scene, requested_views
from gcd_dataset.outfits import joined_mesh
from gcd_dataset.records import Body, BoxMesh, Drape, GarmentMotion, Maps, Pose, WornGarment

if TYPE_CHECKING:
    from gcd_dataset.generator.drape import DrapeJob
    from gcd_dataset.generator.drape.batches import PreparedJob
    from gcd_dataset.generator.drape.moving import Motion


@dataclass(frozen=True)
class DrapeRequest:
    """A garment to drape."""

    number: int
    """Chosen by the sender; the reply has the same number."""
    job: "DrapeJob"
    picture: int = 0
    """Side of front and back [pixels]; 0 for none."""
    retry: bool = False
    """A further attempt at a sample; draped before all other requests, since later samples wait for it."""
    views: ViewRequest | None = None
    """The drawn views to take, if any."""
    maps: bool = False
    """Whether to compute ``DrapeReply.maps``."""
    motion: tuple[Pose, ...] = ()
    """The poses that the body takes, from that of ``job`` on, ``FPS`` a second; none for a body that stays."""
    under: tuple[WornGarment, ...] = ()
    """The garments of ``job.under`` that the pictures show too."""
    prepared: "PreparedJob | None" = None
    """The job with its host data, made by a sender in another process."""
    way: "Motion | None" = None
    """The body through ``motion``, made likewise."""

    @cached_property
    def body(self) -> Body:
        """The wearer in the pose of the drape."""
        motion = self.prepared and self.prepared.motion
        return motion.body if motion else self.job.posed_body

    def shown(self, drape: Drape) -> tuple[BoxMesh, Float32[np.ndarray, "v 3"]]:
        """Mesh and vertices of the draped garment and those under it, for pictures."""
        if not self.under:
            return self.job.box_mesh, drape.vertices
        worn = [(one.box_mesh, one.drape.vertices) for one in self.under if one.box_mesh and one.drape]
        seams = [len(one.pattern.seams) for one in self.under]
        meshes = [*(mesh for mesh, _ in worn), self.job.box_mesh]
        return joined_mesh(meshes, [*seams, 0]), np.concatenate([*(own for _, own in worn), drape.vertices])


@dataclass(frozen=True)
class DrapeReply:
    """A draped garment."""

    number: int
    """The number of the request."""
    drape: Drape
    pictures: tuple[UInt8[np.ndarray, "h w 3"], UInt8[np.ndarray, "h w 3"]] | None
    """Front and back."""
    seconds: float = 0.0
    """Time of the batch divided by its garments; 0 from a draper that several processes share."""
    views: tuple[RenderedView, ...] = ()
    """The drawn views; none of a diverged drape."""
    maps: Maps | None = None
    motion: GarmentMotion | None = None


class Draper(Protocol):
    """Drapes garments on one device. A context manager: leaving the block drops the requests without a reply.

    Implementations: ``LocalDraper`` in this process, ``SharedDraper`` in a process that many workers share. All methods
    raise ``DrapeError`` after the draper has failed.
    """

    at_once: int
    """Requests to send before the first reply; more would wait in the draper's queue."""

    def send(self, request: DrapeRequest) -> None:
        """Send a request. Raises ``DrapeError`` for a mesh without faces."""

    def poll(self) -> bool:
        """Whether ``receive`` would return without waiting."""

    def receive(self) -> DrapeReply:
        """Wait for the next reply."""

    def __enter__(self) -> Self: ...

    def __exit__(self, *_: object) -> None: ...


def make_reply(request: DrapeRequest, drape: Drape, device: str, *, seconds: float = 0.0) -> DrapeReply:
    """The reply to a request, with the pictures and maps that it asks for, made on ``device``."""
    pictures = None
    if request.picture:
        from gcd_dataset.generator.render import render_garment

        mesh, vertices = request.shown(drape)
        pictures = render_garment(vertices, mesh, request.body, size=request.picture, device=device)
    maps = None
    if request.maps:
        from gcd_dataset.generator.drape import maps_of

        maps = maps_of(request.job, drape, device=device)
    views, [motion] = _views(request, drape, device), moved([request], [drape], device)
    return DrapeReply(request.number, drape, pictures, seconds, views, maps, motion)


def moved(requests: Sequence[DrapeRequest], drapes: Sequence[Drape], device: str) -> list[GarmentMotion | None]:
    """The motion of each request's garment, whose first frame is its drape; ``None`` where its body stays."""
    from gcd_dataset.generator.drape.batches import PreparedJob
    from gcd_dataset.generator.drape.drape import drape_on, garment_motion
    from gcd_dataset.generator.drape.moving import Motion
    from gcd_dataset.generator.drape.outcome import KEEPS_CROSSINGS

    frames = [[drape] for drape in drapes]
    moving = [k for k, own in enumerate(drapes) if requests[k].motion and own.outcome in KEEPS_CROSSINGS]
    prepared = [requests[k].prepared or PreparedJob.of(requests[k].job) for k in moving]
    ways = [[requests[k].way or Motion.through(requests[k].job.body, requests[k].motion)] for k in moving]
    for number, drape in drape_on(prepared, [drapes[k] for k in moving], ways, device=device):
        frames[moving[number]].append(drape)
    return [
        garment_motion(own, request.job.box_mesh.faces, request.motion) if request.motion else None
        for request, own in zip(requests, frames, strict=True)
    ]


def _views(request: DrapeRequest, drape: Drape, device: str) -> tuple[RenderedView, ...]:
    """The drawn views that a request asks for."""
    asked = request.views
    scene = None if asked is None else requested_scene(asked, *request.shown(drape))
    if asked is None or scene is None:
        return ()
    from gcd_dataset.generator.render import render

    views = requested_views(asked, scene)
    pictures = render([scene], views, size=asked.size, device=device)
    return tuple(finished_view(view, picture, scene) for view, picture in zip(views, pictures, strict=True))


Made = TypeVar("Made")


@dataclass(frozen=True)
class DrapeWork(Generic[Made]):
    """Garments to drape, and the function that makes the result from their drapes."""

    jobs: Sequence["DrapeJob"]
    finish: Callable[[Sequence[DrapeReply]], Union[Made, "DrapeWork[Made]"]]
    """Makes the result, or the work of another attempt, from the replies in the order of ``jobs``."""
    picture: int = 0
    """Side of front and back [pixels]; 0 for none."""
    views: Sequence[ViewRequest] = ()
    """The drawn views of each job; empty for none."""
    maps: bool = False
    """Whether to compute the maps of the drapes."""
    motions: Sequence[tuple[Pose, ...]] = ()
    """``DrapeRequest.motion`` of each job; empty for none."""
    under: Sequence[tuple[WornGarment, ...]] = ()
    """The garments under each job, for its pictures; empty for none."""


def in_order(work: Iterable[DrapeWork[Made]], draper: Draper | None, *, ahead: int, at_once: int) -> Iterator[Made]:
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

    work: DrapeWork[Made]
    replies: dict[int, DrapeReply] = field(default_factory=dict)  # replies by index of the job
    results: list[Made] = field(default_factory=list)  # the result in a list of one; empty before the piece is finished
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

    def begin(self, work: DrapeWork[Made]) -> _Task[Made]:
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
            under = task.work.under[number] if task.work.under else ()
            motion = task.work.motions[number] if task.work.motions else ()
            work = task.work
            self._draper.send(
                DrapeRequest(self._next_number, job, work.picture, retry, views, work.maps, motion, under)
            )
            self._next_number += 1
        self._finish(task)

    def _finish(self, task: _Task) -> None:
        """If all jobs are draped, store the result or send the next attempt."""
        count = len(task.work.jobs)
        if len(task.replies) < count:
            return
        result = task.work.finish([task.replies[job] for job in range(count)])
        if isinstance(result, DrapeWork):
            task.work = result
            self._send(task, retry=True)
        else:
            task.results.append(result)
            self.busy -= 1
