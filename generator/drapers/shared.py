"""The draper that many processes share: a process of its own for each device, reached through a socket."""

import contextlib
from multiprocessing.connection import Connection
from typing import Self

from gcd_dataset.errors import DrapeError
from gcd_dataset.generator.drapers.address import DraperAddress
from gcd_dataset.generator.drapers.draper import DrapeReply, DrapeRequest, require_faces
from gcd_dataset.generator.drapers.parcel import send_parcel

__all__ = ["AT_ONCE", "SharedDraper"]

AT_ONCE = 24  # garments of each caller: eleven callers fill both batches of a GPU, 2 x 128


class SharedDraper:
    """A connection to the draping process of a place, for one thread.

    Raises ``DrapeError`` where that process cannot be started; its methods where it cannot drape, or has ended.
    """

    def __init__(self, place: DraperAddress, *, at_once: int = AT_ONCE) -> None:
        self._place = place
        self.at_once = at_once
        self._connection: Connection = place.connect()

    def ask(self, order: DrapeRequest) -> None:
        require_faces(order)
        try:
            send_parcel(self._connection, order)
        except OSError as error:
            raise self._gone() from error

    def answered(self) -> bool:
        try:
            return self._connection.poll()
        except OSError as error:
            raise self._gone() from error

    def answer(self) -> DrapeReply:
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
        """The error that the draping process sent last, or that it ended without one."""
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
