"""Bodies in shards: each person is a sample with the members of ``BODIES``; all share one mesh beside the shards.

=================  =====================================================================================================
``meta.json``      schema, key, index, seed, versions, recipe and its hash; name of the person; arm_angle: angle of both
                   arms above the A-pose [rad]; CRC-32 of every other member and its own; see
                   ``gcd_dataset.shards.meta``
``measures.json``  the tailor's measures: cm, inclinations in degrees, as in a GarmentCode measurement file; -1.0 for
                   a missing measure
``person.z``       sections ``shape``, f8 [k]: weights of the body's shape components [standard deviations];
                   ``straight`` and ``apart``, [v, 3]: vertex positions with the legs straight, and apart [cm]
=================  =====================================================================================================

Positions are multiples of 2⁻⁹ cm, float32: those of a person are stored within 1e-3 cm. ``mesh-train.z`` has the
sections ``faces`` [f, 3] and ``parts``, u1 [v], or u1 [0] without a segmentation. Its hash is part of the recipe, so a
set cannot be continued on another mesh.

Vertices are stored: rebuilding them from the weights takes 8 ms of CPU time, and needs the body model of the version
that wrote the shards.
"""

import math
import zlib
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from gcd_dataset.bodies import POSES, BodyMesh, Person, measure_row
from gcd_dataset.errors import ShardError
from gcd_dataset.records import POSITION_STEP, BodyShape, Measurements
from gcd_dataset.shards.access import REMEDY, read_file
from gcd_dataset.shards.codec import measures_json, read_measures
from gcd_dataset.shards.layout import LARGEST_SAMPLE, SCHEMA, Bytes, key_of, mesh_name, recipe_hash
from gcd_dataset.shards.meta import json_text, read_meta, sealed
from gcd_dataset.shards.sections import Coding, pack, unpack

MEMBER_OF: Mapping[str, str] = {
    "name": "meta.json", "arm_angle": "meta.json", "measures": "measures.json"
} | dict.fromkeys(("shape", *POSES), "person.z")  # fmt: skip
"""Field of a loaded person to the member it comes from."""
READERS: Mapping[str, Callable[[Bytes], Any]] = {
    "meta.json": read_meta, "measures.json": read_measures, "person.z": unpack
}  # fmt: skip
POSITION = Coding(2, step=round(math.log2(POSITION_STEP)))


def encode_person(person: Person, origin: Mapping[str, Any]) -> dict[str, bytes]:
    """Member name to bytes; equal people give equal bytes. ``origin``: the entries index, seed, recipe, versions.

    Raises ``ShardError`` for NaN or infinity.
    """
    arrays = {"shape": np.asarray(person.shape.weights, float)} | {pose: getattr(person, pose) for pose in POSES}
    try:
        for name, array in arrays.items():
            if not np.isfinite(array).all():
                raise ShardError(f"{name} holds NaN or infinity")
        content = {
            "measures.json": measures_json(person.measurements),
            "person.z": pack(arrays, dict.fromkeys(POSES, POSITION)),
        }
        meta = {
            "schema": SCHEMA,
            "key": key_of(origin["index"]),
            **origin,
            "versions": json_text(origin["versions"]),
            "recipe": json_text(origin["recipe"]),
            "recipe_sha256": recipe_hash(origin["recipe"]),
            "name": person.name,
            "arm_angle": float(person.shape.arm_angle),
            "crc32": {member: zlib.crc32(data) for member, data in content.items()},
        }
        return {"meta.json": sealed(meta), **content}
    except (ShardError, ValueError) as error:
        raise ShardError(f"person {person.name} cannot be stored: {error}") from error


def mesh_bytes(mesh: BodyMesh) -> bytes:
    """The content of the file ``mesh_name``."""
    parts = np.zeros(0, np.uint8) if mesh.parts is None else mesh.parts
    return pack({"faces": np.asarray(mesh.faces), "parts": parts}, {"faces": Coding(1)})


def decode_body_fields(members: Mapping[str, Bytes], fields: Iterable[str]) -> dict[str, Any]:
    """Field name to value as stored: name, arm_angle [rad], measures in the order of ``MEASURES``, arrays.

    Raises ``ShardError`` with the member's name for invalid content.
    """
    found = {member: _decoded(member, members[member]) for member in {MEMBER_OF[field] for field in fields}}
    values = {field: found[MEMBER_OF[field]] for field in fields}
    for field in values.keys() - {"measures"}:
        values[field] = values[field][field]
    if "measures" in values:
        values["measures"] = measure_row(Measurements.from_file_values(values["measures"]))
    return values


def decode_person(members: Mapping[str, Bytes]) -> Person:
    """The inverse of ``encode_person``. Raises ``ShardError`` with the member's name for invalid content."""
    value = decode_body_fields(members, ("name", "arm_angle", "shape", *POSES))
    return Person(
        name=value["name"],
        shape=BodyShape(value["shape"], value["arm_angle"]),
        straight=value["straight"],
        apart=value["apart"],
        measurements=Measurements.from_file_values(_decoded("measures.json", members["measures.json"])),
    )


def read_set_mesh(folder: Path, split: str, sha256: str) -> BodyMesh:
    """The mesh of a split. Raises ``ShardError`` for a missing or broken file, or where its hash is not ``sha256``."""
    path = folder / mesh_name(split)
    try:
        sections = unpack(read_file(path, LARGEST_SAMPLE))
        _require_forms(sections, {"faces": ("i4", (3,)), "parts": ("u1", ())})
        mesh = BodyMesh(sections["faces"], sections["parts"] if len(sections["parts"]) else None)
    except (ShardError, ValueError) as error:
        if str(error).startswith(str(path)):
            raise
        raise ShardError(f"{path}: not the mesh of a body set ({error}): {REMEDY}") from error
    if mesh.sha256 != sha256:
        raise ShardError(f"{path}: not the mesh of these bodies: {REMEDY}")
    return mesh


def _decoded(member: str, data: Bytes) -> Any:
    try:
        value = READERS[member](data)
        if member == "person.z":
            _require_forms(value, {"shape": ("f8", ()), "straight": ("f4", (3,)), "apart": ("f4", (3,))})
        return value
    except ShardError as error:
        raise ShardError(f"member {member}: {error}: {REMEDY}") from error


def _require_forms(sections: Mapping[str, np.ndarray], forms: Mapping[str, tuple[str, tuple[int, ...]]]) -> None:
    """Raise ``ShardError`` unless every section has its type and the shape of its rows."""
    for name, (kind, row) in forms.items():
        if name not in sections:
            raise ShardError(f"section {name} is missing")
        if (array := sections[name]).dtype != kind or array.shape[1:] != row:
            raise ShardError(f"section {name}: {array.dtype} of shape {array.shape}, expected {kind}, rows {row}")
