"""Names of devices, as options and Warp write them: ``cpu``, ``cuda:0``, ``cuda:0,1``."""

import re
from collections.abc import Sequence

from gcd_dataset.errors import ConfigError


def devices_name(devices: Sequence[str]) -> str:
    """One name for several devices; the inverse of ``named_devices``.

    >>> devices_name(["cuda:0", "cuda:2"]), devices_name(["cpu"])
    ('cuda:0,2', 'cpu')
    """
    if devices[0] == "cpu":
        return "cpu"
    return "cuda:" + ",".join(device.partition(":")[2] for device in devices)


def named_devices(name: str) -> tuple[str, ...]:
    """The devices in a name such as ``cuda:0,1``. Raises ``ConfigError`` for a malformed name.

    >>> named_devices("cuda")
    ('cuda:0',)
    """
    if not re.fullmatch(r"cpu|cuda(:\d+(,\d+)*)?", name):
        raise ConfigError(f"device={name!r:.99}: give auto, cpu, a GPU as cuda:0, or several as cuda:0,1")
    kind, _, numbers = name.partition(":")
    if kind == "cpu":
        return ("cpu",)
    return tuple(dict.fromkeys(f"cuda:{int(number)}" for number in (numbers or "0").split(",")))
