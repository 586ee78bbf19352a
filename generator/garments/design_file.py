"""Designs as GarmentCode's ``design_params.yaml``: a tree whose leaves hold a value ``v`` beside range and type."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import yaml

from gcd_dataset.errors import ConfigError
from gcd_dataset.files import write_whole
from gcd_dataset.generator.garments.design import OutfitDesign
from gcd_dataset.generator.garments.parameter import Space, plain
from gcd_dataset.generator.garments.space import DesignSpace, from_dict, to_dict
from gcd_dataset.yamlfile import strict_yaml

__all__ = ["design_tree", "read_design", "write_design"]

DUMPER = getattr(yaml, "CSafeDumper", yaml.SafeDumper)
REMEDY = "give GarmentCode's design_params.yaml"


def read_design(path: Path | str) -> OutfitDesign:
    """The design in a ``design_params.yaml``; parameters that the file omits keep their defaults.

    Raises ``ConfigError`` with file and parameter path for a missing or broken file, an unknown parameter, or a value
    outside its range.
    """
    content = _parsed(Path(path))
    if not isinstance(content, Mapping) or not isinstance(content.get("design"), Mapping):
        raise ConfigError(f"{path}: has no tree named design: {REMEDY}")
    try:
        return from_dict(OutfitDesign, _values(DesignSpace.declared(OutfitDesign), content["design"], ""))
    except ConfigError as error:
        raise ConfigError(f"{path}: {error}") from error


def write_design(design: OutfitDesign, path: Path | str) -> None:
    """Write the design as a ``design_params.yaml``, numbers at full precision. Raises ``OutputError``."""
    write_whole(path, yaml.dump({"design": design_tree(design)}, Dumper=DUMPER, sort_keys=False).encode())


def design_tree(design: OutfitDesign) -> dict[str, Any]:
    """The tree of parameters: each leaf has its value ``v``, its ``range``, ``type`` and ``default_prob``."""
    return _leaves(DesignSpace.declared(OutfitDesign), to_dict(design))


def _parsed(path: Path) -> Any:
    try:
        return strict_yaml(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise ConfigError(f"{path}: cannot be read ({error.strerror}): {REMEDY}") from error
    except UnicodeDecodeError as error:
        raise ConfigError(f"{path}: byte {error.start} is not valid UTF-8: {REMEDY}") from error
    except RecursionError as error:
        raise ConfigError(f"{path}: nested too deep: {REMEDY}") from error
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        position = f"line {mark.line + 1}, column {mark.column + 1}: " if mark else ""
        raise ConfigError(f"{path}: {position}{error.problem or error.context}: correct the YAML") from error
    except (yaml.YAMLError, ValueError) as error:  # a character that YAML forbids; an impossible date
        raise ConfigError(f"{path}: {' '.join(str(error).split())}: correct the YAML") from error


def _values(space: DesignSpace[Any], tree: Mapping[str, Any], prefix: str) -> dict[str, Any]:
    """The tree with each leaf replaced by its value; entries that are not parameters stay unchanged."""
    spaces = {entry.key: entry.space for entry in space.entries}
    return {key: _value(spaces.get(key), node, f"{prefix}{key}") for key, node in tree.items()}


def _value(space: Space | DesignSpace[Any] | None, node: Any, path: str) -> Any:
    if space is None or not isinstance(node, Mapping):
        return node
    if isinstance(space, DesignSpace):
        return _values(space, node, f"{path}.")
    if "v" not in node:
        raise ConfigError(f"{path} has no value: write it as v")
    return node["v"]


def _leaves(space: DesignSpace[Any], values: Mapping[str, Any]) -> dict[str, Any]:
    return {entry.key: _leaf(entry.space, values[entry.key]) for entry in space.entries if entry.key in values}


def _leaf(space: Space | DesignSpace[Any], value: Any) -> dict[str, Any]:
    if isinstance(space, DesignSpace):
        return _leaves(space, value)
    leaf = {"v": plain(space.read(value)), "range": space.range, "type": space.kind}
    return leaf if space.keep is None else leaf | {"default_prob": space.keep}
