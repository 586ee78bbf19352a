"""The draper interface: send requests, receive replies in order of completion."""

from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol, Self

import numpy as np
from jaxtyping import UInt8

from gcd_dataset.generator.views import (
    RenderedView,
    ViewRequest,
    finished_view,
    requested_scene,
    requested_views,
)
from gcd_dataset.records import Drape

if TYPE_CHECKING:
    from gcd_dataset.generator.drape import DrapeJob


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
    """The reply to a request, with the pictures that it asks for, rendered on ``device``."""
    pictures = None
    if request.picture:
        from gcd_dataset.generator.render import render_garment

        mesh, body = request.job.box_mesh, request.job.body
        pictures = render_garment(drape.vertices, mesh, body, size=request.picture, device=device)
    return DrapeReply(request.number, drape, pictures, seconds, views=_views(request, drape, device))


def _views(request: DrapeRequest, drape: Drape, device: str) -> tuple[RenderedView, ...]:
    """The drawn views that a request asks for."""
    asked = request.views
    scene = None if asked is None else requested_scene(asked, request.job.box_mesh, drape.vertices)
    if asked is None or scene is None:
        return ()
    from gcd_dataset.generator.render import render

    views = requested_views(asked, scene)
    pictures = render([scene], views, size=asked.size, device=device)
    return tuple(finished_view(view, picture, scene) for view, picture in zip(views, pictures, strict=True))


def require_faces(request: DrapeRequest) -> None:
    """Raise ``DrapeError`` for a mesh without faces, or other input that cannot be draped."""
    request.job.require_drapeable()
