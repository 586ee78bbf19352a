"""A sample as the files of ``MEMBERS``, and back.

===================  ===================================================================================================
``meta.json``        schema, key, index, seed, attempts, rejects, versions, recipe and its hash; the words of
                     ``PatternTensor``: panel_names, panel_labels, edge_labels; labels that vertices have; pose of the
                     body; outcome and figures of the drape; for others' garments the source; CRC-32 of every
                     other member
``spec.json``        the pattern as a GarmentCode specification
``design.json``      the design's parameters
``measures.json``    the tailor's measures: cm, inclinations in degrees, as in a GarmentCode measurement file
``panels.npy``       the pattern as arrays, see ``gcd_dataset.tensors``: one row a panel,
``edges.npy``        one row an edge,
``stitches.npy``     one row a seam
``body.npy``         f32 [k]: weights of the body's shape components [standard deviations]
``faces.npy``        id [f, 3]: triangles, rows of ``verts`` and ``box``
``uv.npy``           f32 [c, 2]: panel-plane coordinates [cm] of the seam-split vertices
``panel_id.npy``     id [f]: the panel of each face, a row of ``panels``
``labels.npy``       id [n, 2]: (vertex, row of ``edge_labels``), label by label
``seams.npy``        id [s, 2]: (vertex, row of ``stitches``), as ``BoxMesh.seams``
``corners.npy``      id [f, 3]: rows of ``uv`` at each face's corners
``uv_vertex.npy``    id [c]: the vertex each row of ``uv`` belongs to
``box.npy``          f32 [v, 3]: positions before sewing [cm]
``verts.npy``        f32 [v, 3]: positions at rest [cm]
``points.npy``       f16 [n, 6]: surface points [cm] and normals
``front.jpg``        pictures; a step not taken leaves a picture of one pixel,
``back.jpg``         as it leaves arrays without rows
===================  ===================================================================================================

An id is u16 up to 65 536 rows, else u32 (``panel_id``: u8 up to 256 panels); loaded fields hold ids as int32.
"""

import contextlib
import io
import json
import zlib
from collections.abc import Callable, Iterable, Iterator, Mapping
from typing import Any

import numpy as np
from jaxtyping import Int
from PIL import Image

from gcd_dataset.errors import ShardError
from gcd_dataset.records import BodyShape, BoxMesh, Drape, Measurements, Outcome, Pattern, Provenance, Sample
from gcd_dataset.shards.layout import FIELDS, MEMBERS, SCHEMA, Bytes, known_fields, recipe_hash
from gcd_dataset.shards.npy import read_npy, write_npy
from gcd_dataset.shards.room import room_for
from gcd_dataset.spec import pattern_from_spec, spec_from_pattern
from gcd_dataset.tensors import PatternTensor, encode_pattern

__all__ = ["NO_PICTURE", "decode_field", "decode_fields", "decode_sample", "encode_part", "encode_sample", "read_json"]

NO_PICTURE = (
    bytes.fromhex("ffd8ffe000104a46494600010100000100010000ffdb004300")
    + 64 * b"\xff"
    + bytes.fromhex("ffc0000b080001000101011100ffc40014000100000000000000000000000000000003")
    + bytes.fromhex("ffc40014100100000000000000000000000000000000ffda0008010100003f0037ffd9")
)
"""A grey JPEG of one pixel: other readers decode every picture they meet, so none may be empty."""

IDS = frozenset({"faces", "panel_id", "labels", "seams", "corners", "uv_vertex", "stitches"})
"""Fields of row numbers."""


# ------------------------------------------------------------------------------------------------------------- encoding


def encode_sample(sample: Sample) -> dict[str, bytes]:
    """The members of a sample, the same names for every sample; the same sample gives the same bytes.

    Raises ``ShardError`` with the sample's key for content that the format cannot hold.
    """
    with _storing(sample):
        tensor = encode_pattern(sample.pattern)
        content = _content(sample, tensor)
        meta = _meta(sample, tensor) | {"crc32": {member: zlib.crc32(content[member]) for member in MEMBERS[1:]}}
        content["meta.json"] = _json(meta)
    return {member: content[member] for member in MEMBERS}


def encode_part(sample: Sample) -> dict[str, bytes]:
    """The members of a sample of which a part alone was read, for whoever reads no more; no CRC-32 in ``meta.json``.

    Raises ``ShardError`` as ``encode_sample`` does.
    """
    with _storing(sample):
        tensor = encode_pattern(sample.pattern)
        return _content(sample, tensor) | {"meta.json": _json(_meta(sample, tensor))}


@contextlib.contextmanager
def _storing(sample: Sample) -> Iterator[None]:
    try:
        yield
    except (ShardError, ValueError, TypeError) as error:
        raise ShardError(f"sample {sample.key} cannot be stored: {error}") from error


def _content(sample: Sample, tensor: PatternTensor) -> dict[str, bytes]:
    """All members but ``meta.json``."""
    pictures = {"front.jpg": sample.front or NO_PICTURE, "back.jpg": sample.back or NO_PICTURE}
    return _json_members(sample) | _array_members(sample, tensor) | pictures


def _json_members(sample: Sample) -> dict[str, bytes]:
    return {
        "spec.json": _json(spec_from_pattern(sample.pattern)),
        "design.json": _json(dict(sample.design)),
        "measures.json": _json(sample.measurements.to_file_values()),
    }


def _array_members(sample: Sample, tensor: PatternTensor) -> dict[str, bytes]:
    mesh = sample.box_mesh
    if mesh is not None and mesh.panel_names != tensor.panel_names:
        raise ShardError("the panels of its mesh are not those of its pattern")
    arrays: dict[str, np.ndarray] = {
        "panels": tensor.panels,
        "edges": tensor.edges,
        "stitches": np.asarray(tensor.stitches, np.int32),
        "body": _floats(None if sample.shape is None else sample.shape.weights, 0),
        **(_no_mesh() if mesh is None else _mesh_arrays(mesh, tensor.edge_labels)),
        "verts": _floats(None if sample.drape is None else sample.drape.vertices, 0, 3),
        "points": _floats(sample.points, 0, 6).astype(np.float16),
    }
    return {FIELDS[field]: write_npy(array) for field, array in arrays.items()}


def _mesh_arrays(mesh: BoxMesh, edge_labels: tuple[str, ...]) -> dict[str, np.ndarray]:
    """The arrays of a box mesh, in the types that are stored. Raises ``ValueError`` for a label that no edge has."""
    vertices, corners = len(mesh.vertices), len(mesh.uv)
    labelled = [
        np.stack([ids, np.full(len(ids), edge_labels.index(label))], axis=1) for label, ids in mesh.labels.items()
    ]
    return {
        "faces": _ids(mesh.faces, vertices, "faces"),
        "uv": _floats(mesh.uv, 0, 2),
        "panel_id": _ids(mesh.panel_id, len(mesh.panel_names), "panel_id", smallest=1),
        "labels": _ids(np.concatenate([np.zeros((0, 2), int), *labelled]), vertices, "labels"),
        "seams": _ids(mesh.seams, vertices, "seams"),
        "corners": _ids(mesh.corners, corners, "corners"),
        "uv_vertex": _ids(mesh.uv_vertex, vertices, "uv_vertex"),
        "box": _floats(mesh.vertices, 0, 3),
    }


def _no_mesh() -> dict[str, np.ndarray]:
    flat, rows = np.zeros((0, 3)), np.zeros((0, 3), int)
    return _mesh_arrays(BoxMesh(flat, rows, flat[:, :2], rows, rows[:, 0], rows[:, 0], (), (), rows[:, :2]), ())


def _floats(array: np.ndarray | None, *shape: int) -> np.ndarray:
    """The array as f32; without rows for a step not taken."""
    return np.zeros(shape, np.float32) if array is None else np.asarray(array, np.float32)


def _ids(rows: Int[np.ndarray, "*n"], count: int, what: str, *, smallest: int = 2) -> np.ndarray:
    """Numbers of ``count`` rows in as few bytes as hold them, ``smallest`` at least."""
    rows = np.asarray(rows)
    # The second column of labels and seams names something else, of which there is never more than vertices.
    if rows.size and not 0 <= rows.min() <= rows.max() < count:
        raise ShardError(f"{what} holds row {rows.max() if rows.min() >= 0 else rows.min()} of {count}")
    size = next(n for n in (1, 2, 4) if n >= smallest and count <= 256**n)
    return rows.astype(f"u{size}")


def _meta(sample: Sample, tensor: PatternTensor) -> dict[str, Any]:
    made, shape = sample.provenance, sample.shape
    return {
        "schema": SCHEMA,
        "key": sample.key,
        "index": made.index,
        "seed": made.seed,
        "attempts": made.attempts,
        "rejects": list(made.rejects),
        "versions": dict(made.versions),
        "recipe": dict(made.recipe),
        "recipe_sha256": recipe_hash(dict(made.recipe)),
        "pattern": sample.pattern.name,
        "body": made.body_name,
        "pose": None if shape is None else {"arm_angle": shape.arm_angle, "legs_apart": shape.legs_apart},
        "panel_names": tensor.panel_names,
        "panel_labels": tensor.panel_labels,
        "edge_labels": tensor.edge_labels,
        "vertex_labels": None if sample.box_mesh is None else list(sample.box_mesh.labels),
        "drape": None if sample.drape is None else _drape_figures(sample.drape),
        **({"source": made.source} if made.source else {}),
    }


def _drape_figures(drape: Drape) -> dict[str, Any]:
    return {
        "outcome": drape.outcome.name,
        "frames": drape.frames,
        "self_crossings": drape.self_crossings,
        "body_crossings": drape.body_crossings,
        # A drape that flew apart has no stretch, and JSON no word for that.
        "stretch_median": drape.stretch_median if np.isfinite(drape.stretch_median) else None,
        "stretch_p99": drape.stretch_p99 if np.isfinite(drape.stretch_p99) else None,
    }


def _json(value: Any) -> bytes:
    """Compact JSON; keys stay in their order, which the records define; floats keep all their digits."""
    return json.dumps(value, separators=(",", ":"), allow_nan=False, ensure_ascii=False).encode()


# ------------------------------------------------------------------------------------------------------------- decoding


def decode_fields(members: Mapping[str, Bytes], fields: Iterable[str] | None = None) -> dict[str, Any]:
    """Field name to array, parsed JSON, or picture as u8 [3, height, width]; all fields for ``None``.

    Floats come as they are stored, ids as int32, both as views of the members where they can. Raises ``ConfigError``
    for a field that does not exist, ``ShardError`` with the member's name for content that is not what it should be.
    """
    return {field: decode_field(field, members[FIELDS[field]]) for field in known_fields(fields)}


def decode_sample(members: Mapping[str, Bytes]) -> Sample:
    """The sample that was encoded, to the precision that is stored; edges have lost the names of their drawing.

    Raises ``ShardError`` or ``SpecError`` for content that is not what it should be.
    """
    pictures = {name: bytes(members[FIELDS[name]]) for name in ("front", "back")}
    field = decode_fields(members, [name for name in FIELDS if name not in pictures])
    meta = field["meta"]
    pattern = pattern_from_spec(field["spec"], meta["pattern"], source=meta["key"])
    return Sample(
        key=meta["key"],
        provenance=_provenance(meta),
        pattern=pattern,
        measurements=Measurements.from_file_values(field["measures"]),
        design=field["design"],
        shape=None if meta["pose"] is None else BodyShape(field["body"].astype(float), **meta["pose"]),
        box_mesh=None if meta["vertex_labels"] is None else _mesh(field, pattern),
        drape=None if meta["drape"] is None else _drape(field),
        points=field["points"].astype(float) if len(field["points"]) else None,
        **{name: data for name, data in pictures.items() if data != NO_PICTURE},
    )


def read_json(data: Bytes) -> Any:
    """Parsed JSON. Raises ``ShardError``."""
    try:
        return json.loads(str(data, "utf-8"))
    except ValueError as error:
        raise ShardError(f"not JSON ({error})") from error


def decode_field(field: str, data: Bytes) -> Any:
    """One of ``FIELDS``, as ``decode_fields`` does it."""
    try:
        return DECODERS[field](data)
    except ShardError as error:
        raise ShardError(
            f"member {FIELDS[field]}: {error}: copy its shard again, or delete that and run gcd generate again"
        ) from error


def _read_ids(data: Bytes) -> np.ndarray:
    """Row numbers as int32: a view of the member if they are stored as such."""
    array = read_npy(data)
    if array.dtype == np.int32:
        return array
    wide = room_for(array.size * 4).view(np.int32).reshape(array.shape)
    np.copyto(wide, array, casting="same_kind")
    return wide


def _picture(data: Bytes) -> np.ndarray:
    """The picture as u8 [3, height, width]; without rows where none was taken."""
    if data == NO_PICTURE:
        return np.zeros((3, 0, 0), np.uint8)
    try:
        with Image.open(io.BytesIO(data)) as image:
            pixels = np.asarray(image.convert("RGB"))
    except OSError as error:
        raise ShardError(f"not a picture ({error})") from error
    return np.ascontiguousarray(pixels.transpose(2, 0, 1))


def _decoder(field: str) -> Callable[[Bytes], Any]:
    if field in IDS:
        return _read_ids
    return {"json": read_json, "jpg": _picture, "npy": read_npy}[FIELDS[field].rpartition(".")[2]]


DECODERS = {field: _decoder(field) for field in FIELDS}


def _provenance(meta: Mapping[str, Any]) -> Provenance:
    return Provenance(
        seed=meta["seed"],
        index=meta["index"],
        attempts=meta["attempts"],
        rejects=tuple(meta["rejects"]),
        versions=meta["versions"],
        recipe=meta["recipe"],
        body_name=meta["body"],
        source=meta.get("source", ""),
    )


def _mesh(field: Mapping[str, Any], pattern: Pattern) -> BoxMesh:
    meta, labels = field["meta"], field["labels"].astype(np.int64)
    ids = {name: field[name].astype(np.int64) for name in ("faces", "corners", "uv_vertex", "panel_id", "seams")}
    rows = {label: meta["edge_labels"].index(label) for label in meta["vertex_labels"]}
    return BoxMesh(
        vertices=field["box"].astype(float),
        uv=field["uv"].astype(float),
        panel_names=tuple(panel.name for panel in pattern.panels),
        panel_labels=tuple(panel.label for panel in pattern.panels),
        labels={label: labels[labels[:, 1] == row, 0] for label, row in rows.items()},
        **ids,
    )


def _drape(field: Mapping[str, Any]) -> Drape:
    figures = dict(field["meta"]["drape"])
    stretch = {name: figures.pop(name) for name in ("stretch_median", "stretch_p99")}
    figures |= {name: np.nan if value is None else value for name, value in stretch.items()}
    return Drape(field["verts"].astype(float), Outcome[figures.pop("outcome")], **figures)
