"""The client of a draping process that many processes share, reached through a socket."""

import contextlib
from multiprocessing.connection import Connection
from typing import Self

from gcd_dataset.errors import DrapeError
from gcd_dataset.generator.drapers.address import DraperAddress, send_object
from gcd_dataset.generator.drapers.draper import DrapeReply, DrapeRequest, require_faces

AT_ONCE = 24  # requests of each client: eleven clients fill both batches of a GPU, 2 x 128


class SharedDraper:
    """A connection to the draping process at an address, for one thread; starts the process if there is none.

    Raises ``DrapeError`` if the process cannot be started; the methods raise it if the process fails or has ended.
    """

    def __init__(self, address: DraperAddress, *, at_once: int = AT_ONCE) -> None:
        self._address = address
        self.at_once = at_once
        self._connection: Connection = address.connect()

    def send(self, request: DrapeRequest) -> None:
        require_faces(request)
        try:
            send_object(self._connection, request)
        except OSError as error:
            raise self._closed() from error

    def poll(self) -> bool:
        try:
            return self._connection.poll()
        except OSError as error:
            raise self._closed() from error

    def receive(self) -> DrapeReply:
        try:
            reply = self._connection.recv()
        except (EOFError, OSError) as error:
            raise self._closed() from error
        if isinstance(reply, str):
            raise self._failed(reply)
        return reply

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._connection.close()

    def _closed(self) -> DrapeError:
        """The error that the draping process sent last; if it sent none, an error that says that it has ended."""
        with contextlib.suppress(EOFError, OSError):
            while self._connection.poll():
                if isinstance(last := self._connection.recv(), str):
                    return self._failed(last)
        return DrapeError(
            f"the process that drapes on {self._address.device} has ended, perhaps killed for lack of memory: start "
            "again, with other programs off that device"
        )

    def _failed(self, reason: str) -> DrapeError:
        return DrapeError(f"while draping on {self._address.device}: {reason}")
