"""Pictures of garments at rest, taken several at a time while the device that draped them goes on."""

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass

from gcd_dataset.generator.drapers.draper import DrapeReply, DrapeRequest
from gcd_dataset.generator.render import garment_scene
from gcd_dataset.generator.render_batch import PendingRender, View, start_render
from gcd_dataset.records import Drape

__all__ = ["Studio"]

PIXELS = 16 * 512**2  # in one exposure, eight garments: enough to fill an H200, and half a gigabyte of its memory
VIEWS: tuple[View, View] = ("front", "back")
UNDER_WAY = 2  # exposures: one is taken while the next is prepared


@dataclass(frozen=True)
class _Sitter:
    """A garment that waits for its pictures."""

    order: DrapeRequest
    drape: Drape
    tell: Callable[[DrapeReply], None]


class Studio:
    """Answers orders for one device: at once without pictures, else in the order in which the garments are brought."""

    def __init__(self, device: str) -> None:
        self._device = device
        self._waiting: list[_Sitter] = []
        self._exposed: deque[tuple[PendingRender, list[_Sitter]]] = deque()

    def take(self, order: DrapeRequest, drape: Drape, tell: Callable[[DrapeReply], None]) -> None:
        """Have pictures taken as ordered, and the answer told, by this call or a later one of any method."""
        if not order.picture:
            tell(DrapeReply(order.number, drape, None))
            return
        if self._waiting and self._waiting[0].order.picture != order.picture:
            self._expose()
        self._waiting.append(_Sitter(order, drape, tell))
        if len(self._waiting) >= self._together(order.picture):
            self._expose()

    def go_on(self) -> None:
        """Begin the pictures that wait, and tell an answer that is ready. Costs nothing where there is none."""
        if self._waiting:
            self._expose()
        elif self._exposed and self._exposed[0][0].ready():
            self._hand_out()

    def finish(self) -> None:
        """Tell all answers."""
        if self._waiting:
            self._expose()
        while self._exposed:
            self._hand_out()

    def _together(self, size: int) -> int:
        """Garments in one exposure; a CPU takes them one after the other."""
        return 1 if self._device == "cpu" else PIXELS // (len(VIEWS) * size**2)

    def _expose(self) -> None:
        while len(self._exposed) >= UNDER_WAY:
            self._hand_out()
        sitters, self._waiting = self._waiting, []
        scenes = [garment_scene(s.drape.vertices, s.order.job.box_mesh, s.order.job.body) for s in sitters]
        size = sitters[0].order.picture
        self._exposed.append((start_render(scenes, VIEWS, size=size, device=self._device), sitters))

    def _hand_out(self) -> None:
        exposure, sitters = self._exposed.popleft()
        for sitter, (front, back) in zip(sitters, exposure.pictures(), strict=True):
            sitter.tell(DrapeReply(sitter.order.number, sitter.drape, (front, back)))
