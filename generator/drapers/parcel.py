"""Orders on their way to the draper: their arrays in memory that both sides see, the rest as bytes.

Five megabytes a garment would take the draper, which launches kernels meanwhile, ten milliseconds to read and unpack.
"""

import mmap
import os
import pickle
import tempfile
from itertools import accumulate
from multiprocessing.connection import Connection
from multiprocessing.reduction import recv_handle, send_handle
from typing import IO, Any

__all__ = ["receive_parcel", "send_parcel"]

ALIGNED = 64  # bytes


def send_parcel(connection: Connection, content: object) -> None:
    """Send an object; its arrays are copied once. Raises ``OSError`` where nobody is there."""
    buffers: list[pickle.PickleBuffer] = []
    head = pickle.dumps(content, protocol=5, buffer_callback=buffers.append)
    arrays = [buffer.raw() for buffer in buffers]
    places = _places([array.nbytes for array in arrays])
    with _memory() as file:
        os.truncate(file.fileno(), places[-1])
        for array, place in zip(arrays, places, strict=False):
            file.seek(place)
            file.write(array)
        file.flush()
        connection.send((head, [array.nbytes for array in arrays]))
        send_handle(connection, file.fileno(), None)


def receive_parcel(connection: Connection) -> Any:
    """The next object sent. Raises ``EOFError`` or ``OSError`` where the sender has gone."""
    head, sizes = connection.recv()
    places = _places(sizes)
    try:
        file = recv_handle(connection)
    except RuntimeError as error:  # gone between the two
        raise EOFError from error
    try:
        memory = memoryview(mmap.mmap(file, places[-1], mmap.MAP_PRIVATE))
    finally:
        os.close(file)
    # As ``Connection.recv`` does it: the socket lies in a folder that is the user's alone.
    return pickle.loads(
        head, buffers=[memory[place : place + size] for place, size in zip(places, sizes, strict=False)]
    )


def _places(sizes: list[int]) -> list[int]:
    """Where each array begins, and the size of all."""
    return [0, *accumulate(-(-max(size, 1) // ALIGNED) * ALIGNED for size in sizes)] if sizes else [0, ALIGNED]


def _memory() -> IO[bytes]:
    """A file without a name, in memory where the system has such files."""
    if hasattr(os, "memfd_create"):
        return open(os.memfd_create("gcd-order"), "wb")  # noqa: PTH123 - it has no path
    return tempfile.TemporaryFile()
