"""Designs as rows of numbers: a number for each parameter of ``OutfitDesign``, and which of them have an effect."""

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from jaxtyping import Bool, Float

from gcd_dataset.errors import ConfigError
from gcd_dataset.generator.garments import OutfitDesign, design_from_dict
from gcd_dataset.generator.garments.parameter import Choice, Space, plain
from gcd_dataset.generator.garments.space import Leaf, leaves

__all__ = ["PARAMETERS", "decode_design", "encode_design"]

PARAMETERS: tuple[Leaf, ...] = tuple(leaves(OutfitDesign, added=True))
"""All parameters, in the order of a row."""


def encode_design(values: Mapping[str, Any]) -> Float[np.ndarray, " d"]:
    """The row of a design in plain values (``design_to_dict``): numbers as they are, choices by the row of the option.

    NaN stands for a parameter that is missing or outside its range, such as one of another version.
    """
    return np.array([_code(leaf.space, _at(values, leaf.path)) for leaf in PARAMETERS], np.float32)


def decode_design(row: Float[np.ndarray, " d"]) -> OutfitDesign:
    """The design of a row; numbers are moved into their ranges, NaN becomes the default."""
    tree: dict[str, Any] = {}
    for leaf, code in zip(PARAMETERS, row.tolist(), strict=True):
        if np.isnan(code):
            continue
        *parents, name = leaf.path.split(".")
        node = tree
        for key in parents:
            node = node.setdefault(key, {})
        node[name] = _value(leaf.space, code)
    return design_from_dict(tree)


def _at(values: Mapping[str, Any], path: str) -> Any:
    node: Any = values
    for key in path.split("."):
        if not isinstance(node, Mapping) or key not in node:
            return _MISSING
        node = node[key]
    return node


_MISSING = object()


def _code(space: Space, value: Any) -> float:
    if value is _MISSING:
        return np.nan
    try:
        read = space.read(value)
    except ConfigError:
        return np.nan
    return float(options_of(space).index(plain(read))) if isinstance(space, Choice) else float(read)


def options_of(space: Choice) -> list[Any]:
    """The plain values of the options, each once."""
    return list(dict.fromkeys(plain(option) for option in space.options))


def _value(space: Space, code: float) -> Any:
    if isinstance(space, Choice):
        options = options_of(space)
        return options[int(np.clip(round(code), 0, len(options) - 1))]
    low, high = space.range
    return type(low)(np.clip(round(code) if space.kind == "int" else code, low, high))
