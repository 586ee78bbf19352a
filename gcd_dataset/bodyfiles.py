"""Files that describe a body: GarmentCode's measurement YAML and part segmentation JSON."""

import codecs
import logging
import math
import re
import reprlib
from collections.abc import Mapping
from functools import partial
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from jaxtyping import UInt8

from gcd_dataset.errors import BodyError, shown
from gcd_dataset.files import read_whole, write_whole
from gcd_dataset.jsonfile import read_json, whole
from gcd_dataset.measurements import ANGLES, MEASURE
from gcd_dataset.records import BodyPart, Measurements
from gcd_dataset.yamlfile import read_yaml

log = logging.getLogger(__name__)

LARGEST_BODY_FILE = 512 << 20  # bytes: a mesh, or a shape space with its components
LONGEST_NAME = 40  # characters of a name in a message
LONGEST_NUMBER = 10**15  # messages do not print larger integers
SHORT = reprlib.Repr()
SHORT.maxlevel = 2

OTHER_UNITS: Mapping[str, float] = {"inches": 2.54, "feet": 30.48, "decimetres": 10.0, "metres": 100.0}
"""Length [cm] of units in which measures, or a mesh, may be given instead of centimetres."""
FACTORS = [*OTHER_UNITS.items(), ("millimetres", 0.1), ("inches, converted twice", 1 / 2.54)]
SAME_UNIT = 1.3  # factor by which a measure of another adult differs at most
FAR, FAR_SHARE = 3.0, 0.05  # cm, and share of the measure: other clothes and tailors differ by less

LIMBS = (BodyPart.LEFT_ARM, BodyPart.RIGHT_ARM, BodyPart.LEFT_LEG, BodyPart.RIGHT_LEG)
"""Parts that a segmentation file must list: no garment can be draped without them."""

RELATIVE = re.compile(rb"(?<=\s)-(\d+)")  # a vertex number, not one of a texture or normal after a slash

SMPL_SEGMENTS = {
    BodyPart.LEFT_ARM: "leftShoulder leftArm leftForeArm",
    BodyPart.RIGHT_ARM: "rightShoulder rightArm rightForeArm",
    BodyPart.LEFT_LEG: "leftUpLeg leftLeg",
    BodyPart.RIGHT_LEG: "rightUpLeg rightLeg",
    BodyPart.HANDS: "leftHand leftHandIndex1 rightHand rightHandIndex1",
    BodyPart.FEET: "leftFoot leftToeBase rightFoot rightToeBase",
    BodyPart.INTERNAL: "leftEye rightEye eyeballs",
}
SEGMENTS = {name: part for part, names in SMPL_SEGMENTS.items() for name in names.split()} | {
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
"""Part names of a segmentation file, SMPL's and SMPL-X's too. Vertices unlisted, or under other names, are trunk."""


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
        value = values.get(key, math.nan)
        is_number = isinstance(value, int | float) and not isinstance(value, bool)
        if key in values and not (is_number and known.holds(value)):
            wanted = "a number of degrees" if known.unit == "degrees" else "a positive number of centimetres"
            raise BodyError(f"{path}: body.{key} is {_found(value)}: give {wanted}")
    missing = [key for key, known in MEASURE.items() if key not in values and not known.optional]
    if missing:
        raise BodyError(f"{path}: body lacks {', '.join(missing)}: add {'it' if len(missing) == 1 else 'them'}")
    return Measurements.from_file_values(values)


def require_same_body(given: Measurements, ours: Measurements, source: Path | str, mesh: Path | str) -> None:
    """Log a warning that names the measures of the file ``source`` that are over 3 cm and 5 % off those of a mesh.

    Angles are not compared. Raises ``BodyError`` if most measures are the mesh's in another unit.
    """
    pairs = [(name, getattr(given, name), getattr(ours, name)) for name in MEASURE if name not in ANGLES]
    ratios = np.array([other / one for _, one, other in pairs if min(one, other) > 0])  # of neither NaN
    for unit, factor in FACTORS:
        if np.mean(np.abs(np.log(ratios / factor)) < np.log(SAME_UNIT)) > 0.5:
            raise BodyError(f"{source}: most measures are those of {mesh} in {unit}: give them in centimetres")
    far = [
        f"{name} {one:.1f} ({other:.1f})"
        for name, one, other in pairs
        if abs(one - other) > max(FAR, FAR_SHARE * other)
    ]
    if far:
        reason = f"differs from {mesh} (its measures in brackets): {', '.join(far)} [cm]"
        log.warning("%s: doubtful: %s: give the measures of this body", source, reason)


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
    if not {SEGMENTS.get(name) for name in lists}.issuperset(LIMBS):
        names = ", ".join(shown(name[:LONGEST_NAME]) for name in islice(lists, 9)) or "nothing"
        raise BodyError(f"{path}: lists the parts {names}: add left_arm, right_arm, left_leg and right_leg (or SMPL's)")
    parts = np.full(n_vertices, BodyPart.TRUNK.value, np.uint8)
    for name, ids in lists.items():
        vertices = _vertex_ids(path, shown(name[:LONGEST_NAME]), [] if ids is None else ids)
        if max(vertices, default=0) >= n_vertices:
            raise BodyError(
                f"{path}: {shown(name[:LONGEST_NAME])} names vertex {_found(max(vertices))}, but {mesh} has "
                f"{n_vertices} vertices: give the segmentation of this mesh"
            )
        parts[vertices] = SEGMENTS.get(name, BodyPart.TRUNK).value
    for limb in LIMBS:
        if limb.value not in parts:
            raise BodyError(f"{path}: {limb.name.lower()} has no vertices: list the vertices of the limb")
    return parts


def _vertex_ids(path: Path, name: str, ids: Any) -> list[int]:
    numbers = [-1 if (number := whole(i)) is None else number for i in ids] if isinstance(ids, list) else [-1]
    if min(numbers, default=0) < 0:
        raise BodyError(f"{path}: {name} is not a list of vertex ids: give whole numbers, 0 or more")
    return numbers


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


def _found(value: Any) -> str:
    """Short text of any value, for messages."""
    if isinstance(value, int) and abs(value) >= LONGEST_NUMBER:
        return f"{'-' if value < 0 else ''}10**15 or more"
    return SHORT.repr(value)[:100]


def read_body_file(path: Path) -> bytes:
    """All bytes of a file. Raises ``BodyError``."""
    return read_whole(path, "file of a body", limit=LARGEST_BODY_FILE, error=BodyError)


def obj_lines(content: bytes) -> list[bytes]:
    """The ``v`` and ``f`` lines of an OBJ file; relative vertex numbers (-1: the latest) are made absolute."""
    joined = re.sub(rb"\\\r?\n", b" ", content.removeprefix(codecs.BOM_UTF8))
    lines = [line for line in joined.splitlines() if line[:2] in (b"v ", b"f ", b"v\t", b"f\t")]
    count = 0
    for row, line in enumerate(lines):
        if line[:1] == b"v":
            count += 1
        elif b"-" in line:
            lines[row] = RELATIVE.sub(partial(_absolute, count), line)
    return lines


def _absolute(count: int, relative: re.Match[bytes]) -> bytes:
    back = int(relative[1])
    return b"%d" % (count + 1 - back) if 0 < back <= count else relative[0]
