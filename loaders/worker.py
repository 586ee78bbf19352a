"""Worker processes: start-up, shared memory, errors as values, and the end with the parent process."""

import contextlib
import errno
import gc
import multiprocessing
import os
import threading
import time
import traceback
from collections.abc import Iterator, Mapping
from multiprocessing.synchronize import Event
from typing import Any, TypeVar

import threadpoolctl
import torch
from torch.utils.data import get_worker_info

from gcd_dataset.errors import ConfigError, GcdError

POLL = 1.0  # s between two looks at the parent and the done event

Value = TypeVar("Value")


def begin_worker(worker: int) -> None:
    """The ``worker_init_fn`` for a ``DataLoader`` with workers that make garments, one per core.

    Tensors are shared by file name (``file_system``). With the default, file descriptors, the main process requests
    each tensor's descriptor from the worker, and a busy worker answers late: with six workers on two cores receiving a
    box mesh took 29 ms, by name 4 ms.

    BLAS is limited to one thread, as torch is in a worker: the threads of all workers would wait for each other, which
    with eight threads on two cores took a quarter more CPU time.

    The worker exits within seconds after its parent process has ended, even by a kill, or after its loader is no longer
    read; unfinished garments are dropped.
    """
    torch.multiprocessing.set_sharing_strategy("file_system")  # type: ignore[no-untyped-call]
    threadpoolctl.threadpool_limits(1)
    gc.freeze()  # a forked worker cannot free the parent's arrays on a GPU: keep the collector off them
    threading.Thread(target=_exit_with_parent, args=(os.getppid(), _done_event()), daemon=True).start()


@contextlib.contextmanager
def naming_full() -> Iterator[None]:
    """Turn the error of full shared memory into a ``ConfigError`` with the remedy."""
    try:
        yield
    except (OSError, RuntimeError) as error:
        if getattr(error, "errno", None) != errno.ENOSPC and f"({errno.ENOSPC})" not in str(error):
            raise
        raise ConfigError(
            "shared memory (/dev/shm) is full, and workers pass batches through it: give num_workers=0, or start the "
            "container with more of it, such as docker run --shm-size=2g"
        ) from error


@naming_full()
def require_semaphores(workers: int) -> None:
    """Raise ``ConfigError`` if shared memory is too full for a ``DataLoader`` to start its workers."""
    context = multiprocessing.get_context("fork")  # with others a process would track the semaphores
    tuple(context.Semaphore() for _ in range(8 + 3 * workers))  # of an event and a queue, and a queue for each worker


def sent(value: Value) -> Value | GcdError:
    """In a worker the value with its tensors in shared memory, or the error as a value if that is full.

    torch would move them in a thread, which only prints such an error, while the training waits forever.
    """
    try:
        for tensor in _tensors(value) if get_worker_info() is not None else ():
            if tensor.device.type == "cpu" and tensor.layout is torch.strided:
                with naming_full():
                    tensor.share_memory_()  # type: ignore[no-untyped-call]
    except GcdError as error:
        return with_traceback(error)
    return value


def _tensors(value: Any, depth: int = 2) -> Iterator[torch.Tensor]:
    """The tensors of a batch, or of its items; not those that lie deeper, as parsed JSON does."""
    if isinstance(value, torch.Tensor):
        yield value
    elif depth >= 0 and isinstance(value, Mapping | list | tuple):
        for part in value.values() if isinstance(value, Mapping) else value:
            yield from _tensors(part, depth - 1)


@naming_full()
def shared_number() -> torch.Tensor:
    """An int64 in shared memory: worker processes see its changes. Raises ``ConfigError`` if that memory is full."""
    return torch.zeros((), dtype=torch.int64).share_memory_()  # type: ignore[no-untyped-call]


def with_traceback(error: GcdError) -> GcdError:
    """The error being handled, with its traceback as a note; to be sent as a value.

    If it were raised in a worker, torch would raise it in the main process with the whole traceback in its message.
    """
    error.add_note(f"in a worker process:\n{traceback.format_exc()}")
    return error


def unwrap(value: Value | GcdError) -> Value:
    """The value that a worker has sent. Raises it if it is an error."""
    if isinstance(value, GcdError):
        try:
            raise value
        finally:
            del value  # its traceback refers to this frame: the cycle would keep the loader and its workers alive
    return value


def _done_event() -> Event | None:
    """torch's done event, if there is one: an argument of the worker process."""
    arguments = getattr(multiprocessing.current_process(), "_args", ()) if get_worker_info() else ()
    return next((value for value in arguments if isinstance(value, Event)), None)


def _exit_with_parent(parent: int, done: Event | None) -> None:
    """Exit this process, and free its shared memory, soon after its parent or its loader has ended."""
    # torch checks for the parent too, but then waits forever for its queue to be read, and keeps its memory. At the end
    # of a loader it waits five seconds for each worker in turn.
    while os.getppid() == parent:
        time.sleep(POLL)
        # Poll: `set()` blocks on dead waiters.
        if done is not None and done.is_set():
            time.sleep(POLL)  # an idle worker exits by itself meanwhile
            os._exit(0)
    os._exit(1)
