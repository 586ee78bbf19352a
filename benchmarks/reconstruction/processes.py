"""The processes of ``torchrun``, one for each GPU, and the signals that end them; a process alone is rank 0 of 1."""

import os
import signal
import threading
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from datetime import timedelta
from typing import Any

import torch
import torch.distributed as dist
from torch import Tensor

from gcd_dataset.devicenames import named_devices
from gcd_dataset.errors import ConfigError

MAKING = timedelta(hours=4)  # that the others wait for the garments that the first rank makes


def rank() -> int:
    """The number of this process."""
    return dist.get_rank() if dist.is_initialized() else 0


def ranks() -> int:
    """The number of processes."""
    return dist.get_world_size() if dist.is_initialized() else 1


@contextmanager
def one_of_several(device: str) -> Iterator[torch.device]:
    """The device of this rank; under ``torchrun``, the ranks are joined for the length of the block.

    Raises ``ConfigError`` for an unknown device, several, and one that this machine does not have.
    """
    own, several = _device(device), int(os.environ.get("WORLD_SIZE", "1")) > 1
    if own.type == "cuda":
        own = torch.device("cuda", int(os.environ["LOCAL_RANK"])) if several else own
        torch.cuda.set_device(own)
    if not several:
        yield own
        return
    dist.init_process_group("cpu:gloo,cuda:nccl" if own.type == "cuda" else "gloo", timeout=MAKING)
    try:
        yield own
    finally:
        dist.destroy_process_group()


def _device(name: str) -> torch.device:
    count = torch.cuda.device_count()
    if name == "auto":
        return torch.device("cuda:0" if count else "cpu")
    first, *others = named_devices(name)
    if others:
        raise ConfigError(f"device {name}: give one; torchrun starts a process for each of several GPUs")
    if first != "cpu" and int(first.removeprefix("cuda:")) >= count:
        raise ConfigError(f"device {name}: this machine has {count} GPUs that torch can use: give another, cpu or auto")
    return torch.device(first)


@contextmanager
def first_rank_first() -> Iterator[None]:
    """The first rank runs the block before the others do."""
    if rank():
        dist.barrier()
    yield
    if ranks() > 1 and not rank():
        dist.barrier()


def same_on_all_ranks(tensors: Iterable[Tensor]) -> None:
    """Give all ranks the first one's values, in place."""
    if ranks() > 1:
        for tensor in tensors:
            dist.broadcast(tensor, 0)


def averaged_over_ranks(tensors: Sequence[Tensor]) -> None:
    """Replace tensors by their means over the ranks, in place, in one message."""
    if ranks() == 1:
        return
    flat = torch.cat([tensor.flatten() for tensor in tensors])
    dist.all_reduce(flat)
    parts = torch.split(flat / ranks(), [tensor.numel() for tensor in tensors])
    torch._foreach_copy_(list(tensors), [part.view_as(own) for part, own in zip(parts, tensors, strict=True)])


def agreed(seconds: float, *, is_over: bool) -> tuple[float, bool]:
    """The time and the decision of the first rank, so that all stop at the same step."""
    if ranks() == 1:
        return seconds, is_over
    said = torch.tensor([seconds, is_over], dtype=torch.float64)  # on the CPU: no GPU is waited for
    dist.broadcast(said, 0)
    return float(said[0]), bool(said[1])


def of_all_ranks(value: object) -> list[object]:
    """The values of all ranks, in their order."""
    found: list[object] = [value] * ranks()
    if ranks() > 1:
        dist.all_gather_object(found, value)
    return found


@contextmanager
def ending_signals() -> Iterator[Callable[[], bool]]:
    """A function that tells whether SIGINT or SIGTERM arrived; the second of a kind acts as before."""
    owner, before, received = os.getpid(), dict[int, Any](), list[int]()

    def note(number: int, frame: object) -> None:
        signal.signal(number, before[number])
        if os.getpid() == owner:
            received.append(number)
        else:  # a process that was forked meanwhile, such as a worker
            os.kill(os.getpid(), number)

    if threading.current_thread() is threading.main_thread():  # others cannot set handlers
        before |= {number: signal.signal(number, note) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield lambda: bool(received)
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
