"""What a draper is: garments are ordered and come back draped, in the order in which they come to rest."""

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Protocol, Self

import numpy as np
from jaxtyping import UInt8

from gcd_dataset.errors import DrapeError
from gcd_dataset.records import Drape
from gcd_dataset.waits import Waits

if TYPE_CHECKING:
    from gcd_dataset.generator.drape import DrapeJob

__all__ = ["DrapeReply", "DrapeRequest", "Draper", "draped", "require_faces"]


@dataclass(frozen=True)
class DrapeRequest:
    """A garment to be draped."""

    number: int
    """Chosen by the caller; the answer bears it."""
    job: "DrapeJob"
    picture: int = 0
    """Side of the pictures to be taken [pixels]; 0 for none."""
    again: bool = False
    """A further attempt at a sample for which later ones already wait: it is draped before any other."""


@dataclass(frozen=True)
class DrapeReply:
    """A garment at rest."""

    number: int
    drape: Drape
    pictures: tuple[UInt8[np.ndarray, "h w 3"], UInt8[np.ndarray, "h w 3"]] | None
    """From the front and from behind."""
    seconds: float = 0.0
    """Time of its batch on the device, divided by the garments in it; 0 where several callers share the device."""
    waits: Waits = field(default_factory=dict)
    """How long a draping process has waited for orders since its answer before, by its device."""


class Draper(Protocol):
    """Drapes garments on one device. A context manager: leaving the block gives up what is not answered.

    Implementations: ``DraperHere`` in this process, ``SharedDraper`` in a process for each GPU that many callers share,
    ``RayDraper`` in a Ray actor. All methods raise ``DrapeError`` where the draper cannot go on.
    """

    at_once: int
    """Garments worth having ordered at a time: more of them only wait."""

    def ask(self, order: DrapeRequest) -> None:
        """Order a garment. Raises ``DrapeError`` for a mesh without faces."""

    def answered(self) -> bool:
        """Whether ``answer`` returns at once."""

    def answer(self) -> DrapeReply:
        """The next garment at rest."""

    def __enter__(self) -> Self: ...

    def __exit__(self, *_: object) -> None: ...


def draped(order: DrapeRequest, drape: Drape, device: str, *, seconds: float = 0.0) -> DrapeReply:
    """The answer to an order, with its pictures taken on ``device``."""
    if not order.picture:
        return DrapeReply(order.number, drape, None, seconds)
    from gcd_dataset.generator.render import render_garment

    mesh, body = order.job.box_mesh, order.job.body
    pictures = render_garment(drape.vertices, mesh, body, size=order.picture, device=device)
    return DrapeReply(order.number, drape, pictures, seconds)


def require_faces(order: DrapeRequest) -> None:
    """Raise ``DrapeError`` for a mesh without faces."""
    if not len(order.job.box_mesh.faces):
        raise DrapeError("a garment has no faces: build its box mesh from a pattern with panels")
