"""Which rank this process is, of how many, on which GPU, and whether another library shares garments out."""

import os
import sys
from collections.abc import Sequence
from types import FrameType

import torch
import torch.distributed

from gcd_dataset.errors import ConfigError
from gcd_dataset.loaders.base import natural

__all__ = [
    "is_in_group",
    "own_gpu",
    "own_gpus",
    "present_rank",
    "require_rank",
    "runs_beside_accelerate",
    "shared_out_by",
]

NAMES = ("RANK", "WORLD_SIZE")  # that ``torchrun`` sets in the environment of each process
LOCAL = ("LOCAL_RANK", "LOCAL_WORLD_SIZE")  # the same, of this machine

# What shares out what any sampler or stream gives among the ranks, whoever has made it: module, and its classes.
ACCELERATE = "accelerate.data_loader", frozenset({"BatchSamplerShard", "IterableDatasetShard", "DataLoaderDispatcher"})


def require_rank(rank: int | None, world_size: int | None) -> tuple[int, int] | None:
    """Rank and number of ranks, if they are given. Raises ``ConfigError`` for those that cannot be."""
    if (rank is None) != (world_size is None):
        raise ConfigError(f"rank={rank} and world_size={world_size}: give both, or neither")
    if rank is None or world_size is None:
        return None
    if not 0 <= natural("rank", rank) < natural("world_size", world_size):
        raise ConfigError(f"rank {rank} of {world_size}: ranks count from 0")
    return rank, world_size


def is_in_group() -> bool:
    """Whether ``torch.distributed`` runs in this process."""
    return torch.distributed.is_available() and torch.distributed.is_initialized()


def present_rank() -> tuple[int, int]:
    """Those of ``torch.distributed`` where it runs, else of ``torchrun``'s environment, else 0 of 1.

    Raises ``ConfigError`` for an environment that names no rank.
    """
    if is_in_group():
        return torch.distributed.get_rank(), torch.distributed.get_world_size()
    if any(name not in os.environ for name in NAMES):
        return 0, 1
    rank, world_size = (os.environ[name] for name in NAMES)
    if not (rank.isdecimal() and world_size.isdecimal() and int(rank) < int(world_size)):
        raise ConfigError(
            f"the environment has RANK={rank!r} and WORLD_SIZE={world_size!r}: start with torchrun, or unset both"
        )
    return int(rank), int(world_size)


def own_gpu(count: int) -> int | None:
    """The number of the GPU, of ``count``, that this rank computes on; ``None`` for a process that is no rank.

    Raises ``ConfigError`` for an environment that names no rank.
    """
    ranks = _local_rank()
    if ranks is None:
        return None
    # GPU 0 is also torch's current one where the training names its device with each tensor instead.
    chosen = torch.cuda.current_device() if torch.cuda.is_initialized() else 0  # type: ignore[no-untyped-call]
    return chosen or ranks[0] % count


def own_gpus(devices: Sequence[str]) -> Sequence[str]:
    """This rank's share of several GPUs; all of them for a process that is no rank. One GPU is every rank's.

    Raises ``ConfigError`` for more ranks than GPUs.
    """
    ranks = _local_rank() if len(devices) > 1 else None
    if ranks is None:
        return devices
    rank, count = ranks[0], ranks[1] or max(ranks[0] + 1, len(devices))
    if count > len(devices):
        raise ConfigError(
            f"{count} ranks on this machine share {len(devices)} GPUs, {', '.join(devices)}: give device='auto', one "
            "GPU, or as many as ranks"
        )
    return devices[rank::count]


def _local_rank() -> tuple[int, int | None] | None:
    """Which rank of this machine this process is, of how many, if the launcher tells; ``None`` for one that is none."""
    if LOCAL[0] not in os.environ:
        return present_rank() if is_in_group() else None
    rank, count = (os.environ.get(name) for name in LOCAL)
    known = all(value is None or value.isdecimal() for value in (rank, count))
    if rank is None or not known or (count is not None and int(rank) >= int(count)):
        named = f"LOCAL_RANK={rank!r} and LOCAL_WORLD_SIZE={count!r}"
        raise ConfigError(f"the environment has {named}: start with torchrun, or unset both")
    return int(rank), None if count is None else int(count)


def shared_out_by() -> str | None:
    """The library whose loader asks this thread for garments and shares them out among ranks by itself."""
    # It asks every rank for all garments and takes those of its own rank. It knows no sampler that has done so already,
    # and does not tell a sampler that it will: who calls is all there is to see.
    module, classes = ACCELERATE
    frame: FrameType | None = sys._getframe(1)
    while frame is not None:
        if frame.f_globals.get("__name__") == module and frame.f_code.co_qualname.partition(".")[0] in classes:
            return module.partition(".")[0]
        frame = frame.f_back
    return None


def runs_beside_accelerate() -> bool:
    """Whether ``accelerate`` knows of other ranks in this process, or in the one that this is forked from."""
    state = getattr(sys.modules.get("accelerate.state"), "PartialState", None)
    return getattr(state, "_shared_state", {}).get("num_processes", 1) > 1
