"""How a worker process that makes garments begins, and that it ends with the process it works for."""

import os
import threading
import time

import threadpoolctl
import torch

__all__ = ["begin_worker"]


def begin_worker(worker: int) -> None:
    """The ``worker_init_fn`` of a ``DataLoader`` whose workers make garments, of which there is one a core.

    Tensors are shared by name. The other way, file descriptors, has the loop ask the worker for each tensor, and a
    worker at work answers late: with six of them on two cores a box mesh took the loop 29 ms, by name 4 ms.

    Linear algebra keeps to one thread, as torch does in a worker: threads of all workers wait for each other otherwise,
    which on two cores costs a quarter more CPU time with eight threads.

    The worker ends within a second of the process it works for, even if that is killed.
    """
    torch.multiprocessing.set_sharing_strategy("file_system")  # type: ignore[no-untyped-call]
    threadpoolctl.threadpool_limits(1)
    threading.Thread(target=_end_with, args=(os.getppid(),), daemon=True).start()


def _end_with(parent: int) -> None:
    """End this process, and with it its shared memory, within a second of its parent, however that has ended."""
    # torch looks for the parent too, but then waits until somebody reads what was made, for ever and with all of it.
    while os.getppid() == parent:
        time.sleep(1.0)
    os._exit(1)
