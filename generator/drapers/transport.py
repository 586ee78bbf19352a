"""Transport of requests to the draping process: arrays in a shared memory file, the rest as a pickle.

Through the socket, the draping process would need ten milliseconds to read and unpack a request of five megabytes, and
would launch no kernels meanwhile.
"""

import mmap
import os
import pickle
import tempfile
from itertools import accumulate
from multiprocessing.connection import Connection
from multiprocessing.reduction import recv_handle, send_handle
from typing import IO, Any

ALIGNMENT = 64  # bytes


def send_object(connection: Connection, content: object) -> None:
    """Send an object; its arrays are copied once. Raises ``OSError`` if the receiver has gone."""
    buffers: list[pickle.PickleBuffer] = []
    head = pickle.dumps(content, protocol=5, buffer_callback=buffers.append)
    arrays = [buffer.raw() for buffer in buffers]
    offsets = _offsets([array.nbytes for array in arrays])
    with _memory_file() as file:
        os.truncate(file.fileno(), offsets[-1])
        for array, offset in zip(arrays, offsets, strict=False):
            file.seek(offset)
            file.write(array)
        file.flush()
        connection.send((head, [array.nbytes for array in arrays]))
        send_handle(connection, file.fileno(), None)


def receive_object(connection: Connection) -> Any:
    """Wait for the next object. Raises ``EOFError`` or ``OSError`` if the sender has gone."""
    head, sizes = connection.recv()
    offsets = _offsets(sizes)
    try:
        file = recv_handle(connection)
    except RuntimeError as error:  # the sender ended between the two messages
        raise EOFError from error
    try:
        memory = memoryview(mmap.mmap(file, offsets[-1], mmap.MAP_PRIVATE))
    finally:
        os.close(file)
    # Unpickling is safe as in ``Connection.recv``: only this user can reach the socket's folder.
    return pickle.loads(
        head, buffers=[memory[offset : offset + size] for offset, size in zip(offsets, sizes, strict=False)]
    )


def _offsets(sizes: list[int]) -> list[int]:
    """Aligned offset of each array, then the total size [bytes]."""
    return [0, *accumulate(-(-max(size, 1) // ALIGNMENT) * ALIGNMENT for size in sizes)] if sizes else [0, ALIGNMENT]


def _memory_file() -> IO[bytes]:
    """An unnamed file, in memory on systems with ``memfd_create``."""
    if hasattr(os, "memfd_create"):
        return open(os.memfd_create("gcd-request"), "wb")  # noqa: PTH123 - it has no path
    return tempfile.TemporaryFile()
