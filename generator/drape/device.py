"""Which device a drape runs on, and Warp's quiet start there."""

import warp as wp

from gcd_dataset.errors import ConfigError

__all__ = ["resolve_device"]

wp.config.quiet = True


def resolve_device(name: str) -> str:
    """``auto`` becomes the first GPU or the CPU. Raises ``ConfigError`` where there is no such device."""
    wp.init()
    if name == "auto":
        return "cuda:0" if wp.is_cuda_available() else "cpu"
    known = {device.alias: device.alias for device in wp.get_devices()}
    if wp.is_cuda_available():
        known["cuda"] = "cuda:0"
    if name not in known:
        raise ConfigError(f"device {name}: there is {', '.join(sorted(known))}; use --device auto or cpu")
    return known[name]
