"""How a worker process that makes garments begins, how it hands over errors, and that it ends with its parent."""

import multiprocessing
import os
import threading
import time
import traceback
from multiprocessing.synchronize import Event
from typing import TypeVar

import threadpoolctl
import torch
from torch.utils.data import get_worker_info

from gcd_dataset.errors import GcdError

__all__ = ["begin_worker", "received", "told"]

WAIT = 1.0  # s

Made = TypeVar("Made")


def begin_worker(worker: int) -> None:
    """The ``worker_init_fn`` of a ``DataLoader`` whose workers make garments, of which there is one a core.

    Tensors are shared by name. The other way, file descriptors, has the loop ask the worker for each tensor, and a
    worker at work answers late: with six of them on two cores a box mesh took the loop 29 ms, by name 4 ms.

    Linear algebra keeps to one thread, as torch does in a worker: threads of all workers wait for each other otherwise,
    which on two cores costs a quarter more CPU time with eight threads.

    The worker ends within seconds of the process it works for, even if that is killed, and of a loader that nobody
    takes garments from any more: it leaves those that it is making.
    """
    torch.multiprocessing.set_sharing_strategy("file_system")  # type: ignore[no-untyped-call]
    threadpoolctl.threadpool_limits(1)
    threading.Thread(target=_end_with, args=(os.getppid(), _ended()), daemon=True).start()


def told(error: GcdError) -> GcdError:
    """The error that is being handled, to be handed over as a result, with a note of what the worker was at.

    Raised in the worker, it would come with the whole traceback in its message.
    """
    error.add_note(f"in a worker process:\n{traceback.format_exc()}")
    return error


def received(made: Made | GcdError) -> Made:
    """What a worker has handed over. Raises its error."""
    if isinstance(made, GcdError):
        try:
            raise made
        finally:
            del made  # the error would hold this frame, and with it the loader and its workers
    return made


def _ended() -> Event | None:
    """What torch tells its workers by that nobody takes what they make any more, an argument of theirs."""
    arguments = getattr(multiprocessing.current_process(), "_args", ()) if get_worker_info() else ()
    return next((value for value in arguments if isinstance(value, Event)), None)


def _end_with(parent: int, ended: Event | None) -> None:
    """End this process, and with it its shared memory, soon after its parent or the loader, however that has ended."""
    # torch looks for the parent too, but then waits until somebody reads what was made, for ever and with all of it. At
    # the end of a loader it waits five seconds for each worker in turn.
    while os.getppid() == parent:
        time.sleep(WAIT)
        # Not ``wait``: whoever sets the event waits for all who wait for it, and for ever for one that ended meanwhile.
        if ended is not None and ended.is_set():
            time.sleep(WAIT)  # one that has nothing to do ends by itself
            os._exit(0)
    os._exit(1)
