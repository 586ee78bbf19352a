"""Designs as nested values and as files: plain, or as GarmentCode's ``design_params.yaml``, whose leaves hold ``v``."""

import logging
from collections.abc import Iterator, Mapping
from itertools import islice
from pathlib import Path
from reprlib import repr as short
from typing import Any

import yaml

from gcd_dataset.errors import ConfigError
from gcd_dataset.files import write_whole
from gcd_dataset.generator.garments.design import OutfitDesign
from gcd_dataset.generator.garments.parameter import Space, plain
from gcd_dataset.generator.garments.space import DesignSpace, read_values, require_no_fault, to_dict, unknown_parameters
from gcd_dataset.jsonfile import read_toml
from gcd_dataset.yamlfile import read_yaml

log = logging.getLogger(__name__)

DUMPER = getattr(yaml, "CSafeDumper", yaml.SafeDumper)
MOST_UNKNOWN = 100  # names that are looked at: aliases of YAML can stand for more than any memory holds
DEEPEST = 4  # points in the path of a parameter
LISTED = 12  # ignored parameters in a message


def read_design(path: Path | str) -> OutfitDesign:
    """The design in a YAML, JSON or TOML file: a tree as ``design_from_dict`` takes it. Raises ``ConfigError``."""
    is_toml = Path(path).suffix.lower() == ".toml"
    content = read_toml(path) if is_toml else read_yaml(path, "design file", error=ConfigError)  # reads JSON too
    sections = {entry.key for entry in DesignSpace.declared(OutfitDesign).entries}
    if not isinstance(content, Mapping) or content.keys().isdisjoint({"design", *sections}):
        names = short(list(islice(content, 3)) if isinstance(content, Mapping) else content)
        raise ConfigError(f"{path}: holds {names}, no design: give GarmentCode's design_params.yaml, or ours")
    try:
        return _design(content, f"{path}: ")
    except ConfigError as error:
        raise ConfigError(f"{path}: {error}") from error


def design_from_dict(values: Mapping[str, Any]) -> OutfitDesign:
    """The design from nested plain values or from GarmentCode's tree, below ``design`` or not; others are defaults.

    Logs and ignores parameters of another version of GarmentCode (the tree states their range or type) that change
    nothing: false, zero, null, or of a section that the outfit does not use. Raises ``ConfigError`` with the paths of
    all other unknown parameters and of all values outside their ranges.

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


def _design(values: Mapping[str, Any], source: str) -> OutfitDesign:
    tree, space = values.get("design", values), DesignSpace.declared(OutfitDesign)
    if not isinstance(tree, Mapping):
        raise ConfigError(f"design is {short(tree)}, not a table of parameters")
    design, faults = read_values(space, tree)
    used = {entry.key for entry in space.entries if entry.name in design.sections_used()}
    refused, ignored = [], []
    unknown = list(islice(unknown_parameters(space, tree), MOST_UNKNOWN))
    for one in unknown:
        found = list(islice(_changes(one.path, one.node, used), MOST_UNKNOWN))
        if MOST_UNKNOWN in (len(unknown), len(found)) or any(changes for _, changes in found):
            refused.append(one.fault(space))
        else:
            ignored += [text for text, _ in found]
    require_no_fault([*refused, *faults])
    if ignored:
        more = f" and {len(ignored) - LISTED} more" if len(ignored) > LISTED else ""
        log.warning("%signored, as gcd_dataset lacks them: %s%s", source, ", ".join(ignored[:LISTED]), more)
    return design


def _changes(path: str, node: Any, used: set[str]) -> Iterator[tuple[str, bool]]:
    """The parameters below an unknown name, each with whether it may change the garment, or may be misspelt."""
    if isinstance(node, Mapping) and "v" not in node and node and path.count(".") < DEEPEST:
        for key, inner in node.items():
            yield from _changes(f"{path}.{key}", inner, used)
        return
    value = node.get("v") if isinstance(node, Mapping) else node
    is_foreign = isinstance(node, Mapping) and not node.keys().isdisjoint(("range", "type"))
    is_neutral = value is None or value == 0 or path.partition(".")[0] not in used
    yield f"{path[:60]} = {short(value)}", not (is_foreign and is_neutral)


def _leaves(space: DesignSpace[Any], values: Mapping[str, Any]) -> dict[str, Any]:
    return {entry.key: _leaf(entry.space, values[entry.key]) for entry in space.entries if entry.key in values}


def _leaf(space: Space | DesignSpace[Any], value: Any) -> dict[str, Any]:
    if isinstance(space, DesignSpace):
        return _leaves(space, value)
    leaf = {"v": plain(space.read(value)), "range": space.range, "type": space.kind}
    return leaf if space.keep is None else leaf | {"default_prob": space.keep}
