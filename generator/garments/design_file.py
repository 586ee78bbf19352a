"""Designs as nested values and as files: plain, or as GarmentCode's ``design_params.yaml``, whose leaves hold ``v``."""

import logging
from collections.abc import Iterator, Mapping
from itertools import islice
from pathlib import Path
from reprlib import repr as short
from typing import Any, NamedTuple

import yaml

from gcd_dataset.errors import ConfigError
from gcd_dataset.files import read_whole, write_whole
from gcd_dataset.generator.garments.design import OutfitDesign
from gcd_dataset.generator.garments.parameter import Space, plain
from gcd_dataset.generator.garments.space import (
    DesignSpace,
    nearest_path,
    read_values,
    require_no_fault,
    to_dict,
    unknown_parameters,
)
from gcd_dataset.jsonfile import parse_json
from gcd_dataset.tomlfile import read_toml
from gcd_dataset.yamlfile import LARGEST_YAML, strict_yaml

__all__ = ["design_from_dict", "design_to_dict", "design_tree", "read_design", "write_design"]

log = logging.getLogger(__name__)

DUMPER = getattr(yaml, "CSafeDumper", yaml.SafeDumper)
REMEDY = "give GarmentCode's design_params.yaml, or a design as gcd_dataset writes it"
MOST_UNKNOWN = 100  # names that are looked at: aliases of YAML can stand for more than any memory holds
DEEPEST = 4  # points in the path of a parameter
LISTED = 12  # ignored parameters in a message


def read_design(path: Path | str) -> OutfitDesign:
    """The design in a file: GarmentCode's ``design_params.yaml``, or the same tree with plain values, as YAML, JSON or
    TOML, below a level ``design`` or without it.

    As ``design_from_dict`` otherwise. Raises ``ConfigError`` with the file.
    """
    content = _parsed(Path(path))
    sections = {entry.key for entry in DesignSpace.declared(OutfitDesign).entries}
    if not isinstance(content, Mapping) or content.keys().isdisjoint({"design", *sections}):
        names = ", ".join(map(str, islice(content, 3))) if isinstance(content, Mapping) else ""
        raise ConfigError(f"{path}: holds no design{f', but {names[:60]}' if names else ''}: {REMEDY}")
    try:
        return _design(content, f"{path}: ")
    except ConfigError as error:
        raise ConfigError(f"{path}: {error}") from error


def design_from_dict(values: Mapping[str, Any]) -> OutfitDesign:
    """The design from nested plain values, or from the tree of a design file; omitted parameters keep their defaults.

    Parameters of another version of GarmentCode, which have a range or a type in the tree, are logged and ignored if
    they change nothing: they are false, zero or null, or of a garment that is not worn. Raises ``ConfigError`` with
    the paths of all other unknown parameters, and of all values outside their ranges.

    >>> design_from_dict({"meta": {"upper": None, "bottom": "SkirtCircle"}, "flare-skirt": {"suns": 1}}).meta.bottom
    <Bottom.CIRCLE: 'SkirtCircle'>
    """
    return _design(values, "")


def design_to_dict(design: OutfitDesign) -> dict[str, Any]:
    """The design as nested plain values, under GarmentCode's names."""
    return to_dict(design)


def write_design(design: OutfitDesign, path: Path | str) -> None:
    """Write the design as a ``design_params.yaml``, numbers at full precision. Raises ``OutputError``."""
    write_whole(path, yaml.dump({"design": design_tree(design)}, Dumper=DUMPER, sort_keys=False).encode())


def design_tree(design: OutfitDesign) -> dict[str, Any]:
    """The tree of parameters: each leaf has its value ``v``, its ``range``, ``type`` and ``default_prob``."""
    return _leaves(DesignSpace.declared(OutfitDesign), to_dict(design))


def _parsed(path: Path) -> Any:
    if path.suffix.lower() == ".toml":
        return read_toml(path)
    content = read_whole(path, "design file", limit=LARGEST_YAML, error=ConfigError)
    if path.suffix.lower() == ".json":
        return parse_json(content, source=str(path), error=ConfigError)
    try:
        return strict_yaml(content)
    except RecursionError as error:
        raise ConfigError(f"{path}: nested too deep: {REMEDY}") from error
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        position = f"line {mark.line + 1}, column {mark.column + 1}: " if mark else ""
        raise ConfigError(f"{path}: {position}{error.problem or error.context}: correct the YAML") from error
    except (yaml.YAMLError, ValueError) as error:  # a character that YAML forbids; an impossible date
        raise ConfigError(f"{path}: {' '.join(str(error).split())}: correct the YAML") from error


# ----------------------------------------------------------------------------------------------------------- parameters


class _Other(NamedTuple):
    """A parameter of a design file that ``OutfitDesign`` lacks."""

    path: str
    value: Any
    declared: bool
    """Whether the file states its range or type: then it is no misspelt name, but of another version of GarmentCode."""

    def changes_nothing(self, design: OutfitDesign, tree: Mapping[str, Any]) -> bool:
        if not self.declared or self.value is None or self.value == 0:
            return self.declared
        space = DesignSpace.declared(OutfitDesign)
        fields = {entry.key: entry.name for entry in space.entries}
        section = self.path.partition(".")[0]
        if section in fields:
            return fields[section] not in design.sections_used()
        near = nearest_path(space, self.path)
        return near is None or _holds(tree, near)  # a parameter that the file lacks may be renamed there


def _design(values: Mapping[str, Any], source: str) -> OutfitDesign:
    tree, space = values.get("design", values), DesignSpace.declared(OutfitDesign)
    if not isinstance(tree, Mapping):
        raise ConfigError(f"holds no design, but design = {short(tree)}: {REMEDY}")
    unknown = list(islice(unknown_parameters(space, tree), MOST_UNKNOWN))
    design, faults = read_values(space, tree)
    ignored: list[_Other] = []
    for one in reversed(unknown):
        others = list(islice(_others(one.path, one.node), MOST_UNKNOWN))
        harmful = [other for other in others if not other.changes_nothing(design, tree)]
        if harmful or len(others) == MOST_UNKNOWN:
            named = [one._replace(path=other.path) for other in harmful if other.declared] or [one]
            faults = [*(each.fault(space) for each in named), *faults]
        ignored = [*others, *ignored]
    require_no_fault(faults)
    if ignored:
        listed = ", ".join(f"{other.path[:60]} = {short(other.value)}" for other in ignored[:LISTED])
        more = f" and {len(ignored) - LISTED} more" if len(ignored) > LISTED else ""
        log.warning("%sparameters of another version of GarmentCode are ignored: %s%s", source, listed, more)
    return design


def _others(path: str, node: Any) -> Iterator[_Other]:
    """The parameters below an unknown name."""
    if isinstance(node, Mapping) and "v" in node:
        yield _Other(path, node["v"], not node.keys().isdisjoint(("range", "type")))
    elif isinstance(node, Mapping) and node and path.count(".") < DEEPEST:
        for key, inner in node.items():
            yield from _others(f"{path}.{key}", inner)
    else:
        yield _Other(path, node, declared=False)


def _holds(tree: Any, path: str) -> bool:
    key, _, rest = path.partition(".")
    return isinstance(tree, Mapping) and key in tree and (not rest or _holds(tree[key], rest))


def _leaves(space: DesignSpace[Any], values: Mapping[str, Any]) -> dict[str, Any]:
    return {entry.key: _leaf(entry.space, values[entry.key]) for entry in space.entries if entry.key in values}


def _leaf(space: Space | DesignSpace[Any], value: Any) -> dict[str, Any]:
    if isinstance(space, DesignSpace):
        return _leaves(space, value)
    leaf = {"v": plain(space.read(value)), "range": space.range, "type": space.kind}
    return leaf if space.keep is None else leaf | {"default_prob": space.keep}
