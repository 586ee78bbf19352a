"""The sizes of a network, from the options of ``--set``."""

from collections.abc import Mapping, Sequence
from dataclasses import fields
from typing import Any, TypeVar

from gcd_dataset.errors import ConfigError

Config = TypeVar("Config")
NONE: Mapping[str, Any] = {}


def sizes_from(
    model: str,
    kind: type[Config],
    options: Mapping[str, Any],
    *,
    own: Sequence[str] = (),
    without: Sequence[str] = (),
    least: Mapping[str, int] = NONE,
    heads: Mapping[str, str] = NONE,
) -> tuple[Config, dict[str, Any]]:
    """The configuration of a network, and the options ``own``, which are no fields of it.

    ``without``: fields that the network does not use. ``least``: least values of sizes, 1 for others. ``heads``: names
    of widths, each with the name of the number of heads that share it. Raises ``ConfigError`` for an unusable option.
    """
    names = [*(field.name for field in fields(kind) if field.name not in without), *own]  # type: ignore[arg-type]
    unknown = set(options) - set(names)
    if unknown:
        raise ConfigError(f"no size {min(unknown)} of {model}: choose of {', '.join(names)}")
    for name, value in options.items():
        if isinstance(value, int) and value < least.get(name, 1):
            raise ConfigError(f"{name} {value} of {model}: give {least.get(name, 1)} or more")
    config = kind(**{name: value for name, value in options.items() if name not in own})
    for width, count in heads.items():
        if getattr(config, width) % getattr(config, count):
            given = f"{width} {getattr(config, width)} is no multiple of {count} {getattr(config, count)}"
            raise ConfigError(f"{given} of {model}: change one")
    return config, {name: options[name] for name in own if name in options}
