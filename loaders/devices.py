"""The device that this process, or rank, renders or drapes on."""

import torch

from gcd_dataset.devicenames import devices_name, named_devices
from gcd_dataset.errors import ConfigError
from gcd_dataset.loaders.ranks import gpu_of_rank, gpus_of_rank

__all__ = ["device_of_process", "devices_of_process"]


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
