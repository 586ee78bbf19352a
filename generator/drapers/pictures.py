"""Pictures of draped garments, rendered several at a time while the device drapes on."""

from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

from gcd_dataset.generator.drape.drape import batch_capacity
from gcd_dataset.generator.drape.maps import PendingMaps
from gcd_dataset.generator.drape.outcome import KEEPS_CROSSINGS
from gcd_dataset.generator.drapers.draper import DrapeReply, DrapeRequest, moved
from gcd_dataset.generator.render import PendingPictures, Scene, View, garment_scene, start_pictures
from gcd_dataset.generator.render.plain import SIDES, start_plain
from gcd_dataset.generator.views import RenderedView, finished_view, requested_scene, requested_views
from gcd_dataset.records import Drape, GarmentMotion, Maps

PIXELS = 16 * 512**2  # pixels of one rendering: 8 garments in two views, 0.2 GB of hits
MAPPED = 8  # garments whose maps are computed at once, without pictures
MOVED = 32  # garments that a GPU moves at once
PATIENCE = 128  # garments draped for others while one waits to move with more
MAX_IN_FLIGHT = 2  # renderings: one runs while the next is prepared


@dataclass(frozen=True)
class _PendingRequest:
    """A draped garment that waits for its pictures."""

    request: DrapeRequest
    drape: Drape
    reply: Callable[[DrapeReply], None]
    motion: GarmentMotion | None = None


class PictureQueue:
    """Replies to requests on a device, at once if only the drape is asked for; motions wait until several can begin."""

    def __init__(self, device: str) -> None:
        self._device = device
        self._pending: list[_PendingRequest] = []
        self._moving: list[_PendingRequest] = []
        """Garments at rest whose bodies will move."""
        self._let_pass = 0
        """Garments added while others wait to move."""
        self._in_flight: deque[tuple[_Renderings, list[_PendingRequest]]] = deque()

    def add(self, request: DrapeRequest, drape: Drape, reply: Callable[[DrapeReply], None]) -> None:
        """Add a draped garment; this call, or a later call of any method, calls ``reply``."""
        pending = _PendingRequest(request, drape, reply)
        self._let_pass = self._let_pass + 1 if self._moving else 0
        if not request.motion or drape.outcome not in KEEPS_CROSSINGS:
            [motion] = moved([request], [drape], self._device)
            self._show(replace(pending, motion=motion))
        else:
            self._moving.append(pending)
        if self._moving and (len(self._moving) >= self._most_moving() or self._let_pass >= PATIENCE):
            self._move()

    def _most_moving(self) -> int:
        """Garments in motion at once, while the batches of the device wait; a CPU moves one at a time."""
        return 1 if self._device == "cpu" else min(MOVED, batch_capacity(self._device, sharers=8))

    def _move(self) -> None:
        batch, self._moving = self._moving, []
        motions = moved([one.request for one in batch], [one.drape for one in batch], self._device)
        for one, motion in zip(batch, motions, strict=True):
            self._show(replace(one, motion=motion))

    def _show(self, pending: _PendingRequest) -> None:
        request = pending.request
        if not request.picture and request.views is None and not request.maps:
            pending.reply(DrapeReply(request.number, pending.drape, None, motion=pending.motion))
            return
        if self._pending and _sizes(self._pending[0].request) != _sizes(request):
            self._render()
        self._pending.append(pending)
        views = request.views
        pixels = len(SIDES) * request.picture**2 + (0 if views is None else views.count * views.size**2)
        if len(self._pending) >= self._batch_size(pixels):
            self._render()

    def advance(self) -> None:
        """Start rendering pending garments, or reply with a finished rendering, without waiting."""
        if self._pending:
            self._render()
        elif self._in_flight and self._in_flight[0][0].ready():
            self._reply_first()

    def flush(self) -> None:
        """Move, render and reply to all garments."""
        if self._moving:
            self._move()
        if self._pending:
            self._render()
        while self._in_flight:
            self._reply_first()

    def _batch_size(self, pixels: int) -> int:
        """Garments of ``pixels`` each in one rendering; a CPU renders one at a time."""
        if self._device == "cpu":
            return 1
        return max(1, PIXELS // pixels) if pixels else MAPPED

    def _render(self) -> None:
        while len(self._in_flight) >= MAX_IN_FLIGHT:
            self._reply_first()
        batch, self._pending = self._pending, []
        self._in_flight.append((_Renderings(batch, self._device), batch))

    def _reply_first(self) -> None:
        renderings, batch = self._in_flight.popleft()
        results = zip(batch, renderings.pictures(), renderings.views(), renderings.maps(), strict=True)
        for pending, pictures, views, maps in results:
            number, drape, motion = pending.request.number, pending.drape, pending.motion
            pending.reply(DrapeReply(number, drape, pictures, views=views, maps=maps, motion=motion))


class _Renderings:
    """Front, back, drawn views and maps that a device makes of a batch of garments; all ask for the same."""

    def __init__(self, batch: Sequence[_PendingRequest], device: str) -> None:
        self._batch = batch
        self._plain: PendingPictures | None = None
        self._maps = PendingMaps([(p.request.job, p.drape) for p in batch], device) if batch[0].request.maps else None
        if size := batch[0].request.picture:
            shown = [(p.request.shown(p.drape), p.request.body) for p in batch]
            scenes = [garment_scene(vertices, mesh, body) for (mesh, vertices), body in shown]
            self._plain = start_plain(scenes, size=size, device=device)
        self._scenes: list[Scene] = []
        self._views: list[list[View]] = [[] for _ in batch]
        self._drawn: PendingPictures | None = None
        if batch[0].request.views is not None:
            self._start_views(batch[0].request.views.size, device)

    def ready(self) -> bool:
        """Whether ``pictures`` and ``views`` return without waiting."""
        return all(pending is None or pending.ready() for pending in (self._plain, self._drawn))

    def pictures(self) -> list[Any]:
        """Front and back of each garment; ``None`` where they were not asked for."""
        if self._plain is None:
            return [None] * len(self._batch)
        pictures = self._plain.lend_rgb()
        return list(zip(pictures[::2], pictures[1::2], strict=True))

    def maps(self) -> Sequence[Maps | None]:
        """The maps of each drape; ``None`` where they were not asked for. Call once."""
        return [None] * len(self._batch) if self._maps is None else self._maps.maps()

    def views(self) -> list[tuple[RenderedView, ...]]:
        """The drawn views of each garment. Call once."""
        if self._drawn is None:
            return [()] * len(self._batch)
        pictures = iter(self._drawn.lend())
        return [
            tuple(finished_view(view, next(pictures), self._scenes[view.scene]) for view in views)
            for views in self._views
        ]

    def _start_views(self, size: int, device: str) -> None:
        for garment, pending in enumerate(self._batch):
            asked = pending.request.views
            assert asked is not None
            scene = requested_scene(asked, *pending.request.shown(pending.drape))
            self._views[garment] = requested_views(asked, scene, row=len(self._scenes))
            if scene is not None:
                self._scenes.append(scene)
        views = [view for views in self._views for view in views]
        self._drawn = start_pictures(self._scenes, views, size=size, device=device)


def _sizes(request: DrapeRequest) -> tuple[int, int, bool]:
    """Sizes of the pictures that a request asks for, and whether it asks for maps; equal ones are served together."""
    return request.picture, 0 if request.views is None else request.views.size, request.maps
