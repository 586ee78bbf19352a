"""Files that describe a body: GarmentCode's measurement YAML and part segmentation JSON."""

import reprlib
from collections.abc import Mapping
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from jaxtyping import UInt8

from gcd_dataset.errors import BodyError, shown
from gcd_dataset.files import read_whole, write_whole
from gcd_dataset.jsonfile import read_json
from gcd_dataset.measurements import MEASURE, Measure
from gcd_dataset.records import BodyPart, Measurements
from gcd_dataset.yamlfile import read_yaml

__all__ = [
    "measurements_text",
    "parse_measurements",
    "read_body_file",
    "read_body_parts",
    "read_measurements",
    "write_measurements",
]

LARGEST_BODY_FILE = 512 << 20  # bytes: a mesh, or a shape space with its components
LONGEST_NAME = 40  # characters of a name in a message
LONGEST_NUMBER = 10**15  # messages do not print larger integers
SHORT = reprlib.Repr()
SHORT.maxlevel = 2

LIMBS = frozenset({"left_arm", "right_arm", "left_leg", "right_leg"})
"""Parts that a segmentation file must list: no garment can be draped without them."""

SEGMENTS = {
    "body": BodyPart.TRUNK,
    "left_arm": BodyPart.LEFT_ARM,
    "right_arm": BodyPart.RIGHT_ARM,
    "left_leg": BodyPart.LEFT_LEG,
    "right_leg": BodyPart.RIGHT_LEG,
    "head": BodyPart.HEAD,
    "hands": BodyPart.HANDS,
    "feet": BodyPart.FEET,
    "face_internal": BodyPart.INTERNAL,
}
"""Part names of a segmentation file. Vertices under other names, and unlisted vertices, count as trunk."""


def read_measurements(path: Path | str) -> Measurements:
    """The measures in a YAML file with a ``body:`` map. Raises ``BodyError`` with the file, the key and a remedy."""
    table = read_yaml(path, "measurement YAML", error=BodyError)
    return parse_measurements(table if isinstance(table, dict) else {}, str(path))


def parse_measurements(table: Mapping[str, Any], path: str) -> Measurements:
    """The measures in ``table``, the parsed content of the file ``path``. Raises ``BodyError``."""
    values = table.get("body")
    if not isinstance(values, dict):
        raise BodyError(f"{path}: no map named body: a measurement file begins with 'body:' and one 'key: cm' a line")
    for key, known in MEASURE.items():
        if key in values and not _is_measure(known, values[key]):
            wanted = "a number of degrees" if known.unit == "degrees" else "a positive number of centimetres"
            raise BodyError(f"{path}: body.{key} is {_found(values[key])}: give {wanted}")
    missing = [key for key, known in MEASURE.items() if key not in values and not known.optional]
    if missing:
        raise BodyError(f"{path}: body lacks {', '.join(missing)}: add {'it' if len(missing) == 1 else 'them'}")
    return Measurements.from_file_values(values)


def write_measurements(measurements: Measurements, path: Path | str) -> None:
    """Write the measures and GarmentCode's derived values as YAML with every digit. Raises ``OutputError``."""
    write_whole(path, measurements_text(measurements).encode())


def measurements_text(measurements: Measurements) -> str:
    """YAML text of a measurement file, as ``write_measurements`` writes it."""
    return str(yaml.safe_dump({"body": measurements_tree(measurements)}))


def measurements_tree(measurements: Measurements) -> dict[str, float]:
    """The measures and GarmentCode's derived values: cm, inclinations in degrees."""
    return measurements.to_file_values() | _derived(measurements)


def read_body_parts(path: Path, n_vertices: int, mesh: Path) -> UInt8[np.ndarray, " v"]:
    """``BodyPart`` value of each vertex, from a segmentation JSON. Raises ``BodyError``.

    ``mesh``: the file of the mesh, named in errors.
    """
    lists = read_json(path, "segmentation JSON", error=BodyError)
    if not isinstance(lists, dict):
        raise BodyError(f"{path}: a {type(lists).__name__}: give a map from part names to lists of vertex ids")
    if not lists.keys() >= LIMBS:
        names = ", ".join(shown(name[:LONGEST_NAME]) for name in islice(lists, 9)) or "nothing"
        raise BodyError(f"{path}: lists the parts {names}: add left_arm, right_arm, left_leg and right_leg")
    parts = np.full(n_vertices, BodyPart.TRUNK.value, np.uint8)
    for name, ids in lists.items():
        vertices = _vertex_ids(path, shown(name[:LONGEST_NAME]), ids)
        if max(vertices, default=0) >= n_vertices:
            raise BodyError(
                f"{path}: {shown(name[:LONGEST_NAME])} names vertex {_found(max(vertices))}, but {mesh} has "
                f"{n_vertices} vertices: give the segmentation of this mesh"
            )
        if not vertices and name in LIMBS:
            raise BodyError(f"{path}: {name} has no vertices: list the vertices of the limb")
        parts[vertices] = SEGMENTS.get(name, BodyPart.TRUNK).value
    return parts


def _vertex_ids(path: Path, name: str, ids: Any) -> list[int]:
    if not isinstance(ids, list) or not all(type(i) is int and i >= 0 for i in ids):  # isinstance(True, int) holds
        raise BodyError(f"{path}: {name} is not a list of vertex ids: give whole numbers, 0 or more")
    return ids


def _derived(size: Measurements) -> dict[str, float]:
    """GarmentCode's derived values; their keys begin with an underscore."""
    derived = {
        "_armscye_depth": size.eased_armscye_depth,
        "_base_sleeve_balance": size.sleeve_balance,
        "_bust_line": size.drawn_bust_line,
        "_hip_inclination": np.degrees(size.drawn_hip_inclination),
        "_leg_length": size.leg_length,
        "_shoulder_incl": np.degrees(size.shoulder_incl),
        "_waist_level": size.waist_level,
    }
    return {key: float(value) for key, value in derived.items() if not np.isnan(value)}


def _is_measure(known: Measure, value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and known.holds(value)


def _found(value: Any) -> str:
    """Short text of any value, for messages."""
    if isinstance(value, int) and abs(value) >= LONGEST_NUMBER:
        return f"{'-' if value < 0 else ''}10**15 or more"
    return SHORT.repr(value)[:100]


def read_body_file(path: Path) -> bytes:
    """All bytes of a file. Raises ``BodyError``."""
    return read_whole(path, "file of a body", limit=LARGEST_BODY_FILE, error=BodyError)
