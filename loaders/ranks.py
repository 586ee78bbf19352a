"""The rank of this process and its device."""

import os
import sys
from collections.abc import Sequence

import torch
import torch.distributed

from gcd_dataset.devicenames import devices_name, named_devices
from gcd_dataset.errors import ConfigError
from gcd_dataset.loaders.base import require_integer

GLOBAL = ("RANK", "WORLD_SIZE")  # environment variables of ``torchrun``
LOCAL = ("LOCAL_RANK", "LOCAL_WORLD_SIZE")  # the same within this machine


def require_rank(rank: int | None, world_size: int | None) -> tuple[int, int] | None:
    """Rank and world size if given, otherwise ``None``. Raises ``ConfigError`` for an invalid pair."""
    if (rank is None) != (world_size is None):
        raise ConfigError(f"rank={rank} and world_size={world_size}: give both, or neither")
    if rank is None or world_size is None:
        return None
    if not 0 <= require_integer("rank", rank) < require_integer("world_size", world_size):
        raise ConfigError(f"rank {rank} of {world_size}: ranks count from 0")
    return rank, world_size


def in_process_group() -> bool:
    """Whether ``torch.distributed`` is initialised in this process."""
    return torch.distributed.is_available() and torch.distributed.is_initialized()


def current_rank() -> tuple[int, int]:
    """Rank and world size: of ``torch.distributed`` if initialised, else of ``torchrun``'s environment, else 0 of 1.

    Raises ``ConfigError`` for an invalid environment.
    """
    if in_process_group():
        return torch.distributed.get_rank(), torch.distributed.get_world_size()
    if any(name not in os.environ for name in GLOBAL):
        return 0, 1
    rank, world_size = (os.environ[name] for name in GLOBAL)
    if not (rank.isdecimal() and world_size.isdecimal() and int(rank) < int(world_size)):
        raise ConfigError(
            f"the environment has RANK={rank!r} and WORLD_SIZE={world_size!r}: start with torchrun, or unset both"
        )
    return int(rank), int(world_size)


def gpu_of_rank(count: int) -> int | None:
    """This rank's GPU, from 0 to ``count`` - 1; ``None`` for a process that is not a rank.

    Raises ``ConfigError`` for an invalid environment.
    """
    ranks = _local_rank()
    if ranks is None:
        return None
    # Device 0 may also mean that the training sets no current device and names a device for each tensor.
    current = torch.cuda.current_device() if torch.cuda.is_initialized() else 0  # type: ignore[no-untyped-call]
    return current or ranks[0] % count


def gpus_of_rank(devices: Sequence[str]) -> Sequence[str]:
    """This rank's share of several GPUs. All ranks share a single GPU; a process that is not a rank gets all GPUs.

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
    """Rank within this machine, and the number of its ranks if known; ``None`` for a process that is not a rank."""
    if LOCAL[0] not in os.environ:
        return current_rank() if in_process_group() else None
    rank, count = (os.environ.get(name) for name in LOCAL)
    known = all(value is None or value.isdecimal() for value in (rank, count))
    if rank is None or not known or (count is not None and int(rank) >= int(count)):
        given = f"LOCAL_RANK={rank!r} and LOCAL_WORLD_SIZE={count!r}"
        raise ConfigError(f"the environment has {given}: start with torchrun, or unset both")
    return int(rank), None if count is None else int(count)


def accelerate_processes() -> int:
    """Number of processes of ``accelerate``, in this process or the one that it was forked from; 1 without it.

    A loader that it prepares splits the items of any sampler or stream over them, even if they have been split already.
    """
    state = getattr(sys.modules.get("accelerate.state"), "PartialState", None)
    return getattr(state, "_shared_state", {}).get("num_processes", 1)


def devices_of_process(device: str) -> str:
    """The device names, with ``auto`` resolved; for a rank, its own. Raises ``ConfigError``."""
    if not isinstance(device, str):
        raise ConfigError(f"device={device!r:.99}: give a name, such as auto, cpu or cuda:0")
    # device_count() only: initialising CUDA here would break workers that are forked later.
    count = torch.cuda.device_count()
    gpu = gpu_of_rank(count) if count and device in ("auto", "cuda") else None
    if gpu is not None:
        return f"cuda:{gpu}"
    if device != "auto":
        return devices_name(gpus_of_rank(named_devices(device)))
    return devices_name([f"cuda:{number}" for number in range(count)] or ["cpu"])


def device_of_process(device: str) -> str:
    """As ``devices_of_process``, one device: the first of several. Raises ``ConfigError``."""
    return named_devices(devices_of_process(device))[0]
