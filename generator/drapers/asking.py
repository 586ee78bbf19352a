"""The side that has garments to be draped."""

import contextlib
from dataclasses import dataclass
from multiprocessing.connection import Connection
from typing import TYPE_CHECKING, Self

import numpy as np
from jaxtyping import UInt8

from gcd_dataset.errors import DrapeError
from gcd_dataset.generator.drapers.parcel import send_parcel
from gcd_dataset.generator.drapers.place import Place
from gcd_dataset.records import Drape

if TYPE_CHECKING:
    from gcd_dataset.generator.drape import DrapeJob

__all__ = ["Asking", "Draped", "Order"]


@dataclass(frozen=True)
class Order:
    """A garment to be draped."""

    number: int
    """The asker's own."""
    job: "DrapeJob"
    picture: int = 0
    """Side of the pictures to be taken [pixels]; 0 for none."""
    again: bool = False
    """Another try, for which those after it wait already: it comes before whatever waits."""


@dataclass(frozen=True)
class Draped:
    """A garment at rest."""

    number: int
    drape: Drape
    pictures: tuple[UInt8[np.ndarray, "h w 3"], UInt8[np.ndarray, "h w 3"]] | None
    """From the front and from behind."""


class Asking:
    """A connection to the draper of a place, for one thread; it is closed at the end of the ``with`` block.

    All its methods raise ``DrapeError`` where the draper cannot be started, cannot drape, or is no more.
    """

    def __init__(self, place: Place) -> None:
        self._place = place
        self._connection: Connection = place.connect()

    def ask(self, order: Order) -> None:
        """Have a garment draped; the answer comes by ``answer``."""
        if not len(order.job.box_mesh.faces):
            raise DrapeError("a garment has no faces: build its box mesh from a pattern with panels")
        try:
            send_parcel(self._connection, order)
        except OSError as error:
            raise self._gone() from error

    def answered(self) -> bool:
        """Whether an answer waits to be taken."""
        try:
            return self._connection.poll()
        except OSError as error:
            raise self._gone() from error

    def answer(self) -> Draped:
        """The next garment at rest, as soon as there is one."""
        try:
            answer = self._connection.recv()
        except (EOFError, OSError) as error:
            raise self._gone() from error
        if isinstance(answer, str):
            raise self._failed(answer)
        return answer

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._connection.close()

    def _gone(self) -> DrapeError:
        """What the draper has said last, or that it said nothing."""
        with contextlib.suppress(EOFError, OSError):
            while self._connection.poll():
                if isinstance(last := self._connection.recv(), str):
                    return self._failed(last)
        return DrapeError(
            f"the process that drapes on {self._place.device} has ended, killed perhaps for lack of memory: start "
            "again, with other programs off that device"
        )

    def _failed(self, reason: str) -> DrapeError:
        return DrapeError(f"while draping on {self._place.device}: {reason}")
