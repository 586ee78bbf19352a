"""Pictures of draped garments, rendered several at a time while the device drapes on."""

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass

from gcd_dataset.generator.drapers.draper import DrapeReply, DrapeRequest
from gcd_dataset.generator.render import garment_scene
from gcd_dataset.generator.render.plain_batch import PendingRender, View, start_render
from gcd_dataset.records import Drape

__all__ = ["PictureQueue"]

PIXELS = 16 * 512**2  # pixels of one rendering: 8 garments in two views fill an H200 and take half a GB of its memory
VIEWS: tuple[View, View] = ("front", "back")
MAX_IN_FLIGHT = 2  # renderings: one runs while the next is prepared


@dataclass(frozen=True)
class _Pending:
    """A draped garment that waits for its pictures."""

    request: DrapeRequest
    drape: Drape
    reply: Callable[[DrapeReply], None]


class PictureQueue:
    """Replies to requests on one device: at once without pictures, else after rendering, in the order of ``add``."""

    def __init__(self, device: str) -> None:
        self._device = device
        self._pending: list[_Pending] = []
        self._in_flight: deque[tuple[PendingRender, list[_Pending]]] = deque()

    def add(self, request: DrapeRequest, drape: Drape, reply: Callable[[DrapeReply], None]) -> None:
        """Add a draped garment; this call, or a later call of any method, calls ``reply`` with its pictures."""
        if not request.picture:
            reply(DrapeReply(request.number, drape, None))
            return
        if self._pending and self._pending[0].request.picture != request.picture:
            self._render()
        self._pending.append(_Pending(request, drape, reply))
        if len(self._pending) >= self._batch_size(request.picture):
            self._render()

    def advance(self) -> None:
        """Start rendering pending garments, or reply with a finished rendering, without waiting."""
        if self._pending:
            self._render()
        elif self._in_flight and self._in_flight[0][0].ready():
            self._reply_first()

    def flush(self) -> None:
        """Render and reply to all garments."""
        if self._pending:
            self._render()
        while self._in_flight:
            self._reply_first()

    def _batch_size(self, size: int) -> int:
        """Garments in one rendering; a CPU renders one at a time."""
        return 1 if self._device == "cpu" else PIXELS // (len(VIEWS) * size**2)

    def _render(self) -> None:
        while len(self._in_flight) >= MAX_IN_FLIGHT:
            self._reply_first()
        batch, self._pending = self._pending, []
        scenes = [garment_scene(p.drape.vertices, p.request.job.box_mesh, p.request.job.body) for p in batch]
        size = batch[0].request.picture
        self._in_flight.append((start_render(scenes, VIEWS, size=size, device=self._device), batch))

    def _reply_first(self) -> None:
        render, batch = self._in_flight.popleft()
        for pending, (front, back) in zip(batch, render.pictures(), strict=True):
            pending.reply(DrapeReply(pending.request.number, pending.drape, (front, back)))
