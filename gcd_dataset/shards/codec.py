"""Encodes a sample as the members of a shard (``MEMBERS``), and decodes it.

===================  ===================================================================================================
``meta.json``        seed, index and recipe; names that the arrays refer to by row; figures of the drape; CRC-32 of
                     every other member and its own; all keys: ``gcd_dataset.shards.meta``
``spec.txt``         the pattern as a GarmentCode specification: JSON, but named ``.txt``: its keys differ between
                     samples, so readers that infer types would fail
``design.txt``       the design's parameters: JSON, named ``.txt`` for the same reason
``measures.json``    the tailor's measures, all of ``MEASURES``: cm, inclinations in degrees, as in a GarmentCode
                     measurement file; -1.0 for a missing measure, omitted from items
``panels.npy`` …     arrays, one row per panel, edge, seam, vertex, …: ``gcd_dataset.loaders.GarmentFields`` describes
``verts.npy``        them; f64 for panels and edges, f32 for other floats, ids for rows of other arrays
``points.npy``       i16 [n, 6]: surface points relative to their centroid, and normals; ``meta.json`` holds scale and
                     centre; -32768 for missing points of a diverged drape. Items hold f32 points in cm
``front.jpg``        pictures; one grey pixel if none was rendered
``back.jpg``
``caption.txt``      the garment in English, three lines: short, medium } optional: in every sample of a data set,
                     and full caption, see ``gcd_dataset.captions``     }
``view_K.jpg``       a picture from any side, K = 0, 1, …               } or in none
``view_K.json``      its camera, light, place and materials             }
===================  ===================================================================================================

``view_K.json`` of ``gcd generate --views`` has the same keys and types in every sample: ``camera`` with ``k`` (3 x 3,
pixels), ``rt`` (3 x 4, world to camera, cm), ``focal_mm`` (as on 35 mm film), ``size`` (pixels) and ``convention``;
``light``, ``place`` and ``appearance``: see ``generator.views.view_facts``. The fields ``views``, ``camera_k`` and
``camera_rt`` join all views of a sample. A diverged drape has one grey pixel and cameras of zeros.

An array of a skipped step has no rows. An id is u16 up to 65 536 rows, else u32 (``panel_id``: u8 up to 256 panels);
loaded fields hold ids as int32. Readers that infer types from the first samples need the same type in the whole data
set. The types of ids differ only in a data set in which some garments, but not all, exceed 65 536 vertices or 256
panels.

Samples of schema 1 are decoded too: there specification and design were ``.json`` members, ``measures.json`` held only
the measures taken, and ``points.npy`` was f16 in cm.
"""

import contextlib
import math
import zlib
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import fields as dataclass_fields
from functools import partial
from typing import Any

import numpy as np
from jaxtyping import Float32, Int

from gcd_dataset.errors import GcdError, ShardError
from gcd_dataset.jsonfile import found
from gcd_dataset.records import (
    MEASURES,
    BodyShape,
    BoxMesh,
    Drape,
    Grade,
    Measurements,
    NamedFabric,
    Outcome,
    Pattern,
    Provenance,
    Sample,
    Strain,
    View,
)
from gcd_dataset.shards.buffers import read_buffer
from gcd_dataset.shards.layout import (
    CAPTION,
    FIELDS,
    FIRST_NAMES,
    JOINT,
    MEMBERS,
    MOST_VIEWS,
    SCHEMA,
    Bytes,
    fields_of,
    joint_fields,
    member_content,
    recipe_hash,
    select_fields,
)
from gcd_dataset.shards.meta import (
    NO_QUANTIZATION,
    Quantization,
    decode_json,
    json_bytes,
    read_meta,
    read_quantization,
    write_meta,
)
from gcd_dataset.shards.npy import read_npy, write_npy
from gcd_dataset.shards.picture import opened_picture
from gcd_dataset.spec import pattern_from_spec, spec_from_pattern
from gcd_dataset.tensors import EdgeColumn, PanelColumn, PatternTensor, StitchColumn, encode_pattern

__all__ = [
    "NO_PICTURE",
    "decode_field",
    "decode_fields",
    "decode_json",
    "decode_sample",
    "encode_partial_sample",
    "encode_sample",
    "measures_json",
    "read_measures",
    "read_meta",
]

NO_PICTURE = (
    bytes.fromhex("ffd8ffe000104a46494600010100000100010000ffdb004300")
    + 64 * b"\xff"
    + bytes.fromhex("ffc0000b080001000101011100ffc40014000100000000000000000000000000000003")
    + bytes.fromhex("ffc40014100100000000000000000000000000000000ffda0008010100003f0037ffd9")
)
"""A grey JPEG of one pixel: other readers decode every picture, and cannot decode an empty member."""

IDS = frozenset({"faces", "panel_id", "labels", "seams", "corners", "uv_vertex", "stitches"})
"""Fields that hold row numbers."""

WIDTHS: Mapping[str, tuple[int, ...]] = {
    "panels": (len(PanelColumn),), "edges": (len(EdgeColumn),), "stitches": (len(StitchColumn),), "body": (),
    "faces": (3,), "uv": (2,), "panel_id": (), "labels": (2,), "seams": (2,), "corners": (3,), "uv_vertex": (),
    "box": (3,), "verts": (3,), "points": (6,),
}  # fmt: skip
"""Field to the shape of one row of its array."""

MISSING_MEASURE = -1.0
"""Marks a missing measure: no length is negative, and no inclination is exactly -1."""

INT16_MAX, UNDEFINED = 32767, -32768


# ------------------------------------------------------------------------------------------------------------- encoding


def encode_sample(sample: Sample) -> dict[str, bytes]:
    """Member name to bytes; equal samples give equal bytes.

    The members are ``MEMBERS``, and caption and views where the sample has them. Raises ``ShardError`` with the
    sample's key for content that the format cannot hold.
    """
    with _storing(sample):
        tensor = encode_pattern(sample.pattern)
        content, quantization = _content(sample, tensor)
        crc = {member: zlib.crc32(data) for member, data in content.items()}
        return {MEMBERS[0]: write_meta(_meta(sample, tensor, quantization) | {"crc32": crc}), **content}


def encode_partial_sample(sample: Sample) -> dict[str, bytes]:
    """Encode a partly read sample, without checksums. Raises ``ShardError`` as ``encode_sample`` does."""
    with _storing(sample):
        tensor = encode_pattern(sample.pattern)
        content, quantization = _content(sample, tensor)
        return {MEMBERS[0]: write_meta(_meta(sample, tensor, quantization)), **content}


@contextlib.contextmanager
def _storing(sample: Sample) -> Iterator[None]:
    try:
        yield
    except (ShardError, ValueError, TypeError) as error:
        raise ShardError(f"sample {sample.key} cannot be stored: {error}") from error


def _content(sample: Sample, tensor: PatternTensor) -> tuple[dict[str, bytes], Quantization]:
    """All members except ``meta.json``, in file order, and the quantization of the points."""
    points, quantization = _points(sample.points)
    pictures = {"front.jpg": sample.front or NO_PICTURE, "back.jpg": sample.back or NO_PICTURE}
    views = {
        name: data
        for number, view in enumerate(sample.views)
        for name, data in (
            (f"view_{number}.jpg", view.picture or NO_PICTURE),
            (f"view_{number}.json", json_bytes(dict(view.facts))),
        )
    }
    content = {**_texts(sample), **_arrays(sample, tensor), "points.npy": points, **pictures, **views}
    return content, quantization


def _texts(sample: Sample) -> dict[str, bytes]:
    return {
        "spec.txt": json_bytes(spec_from_pattern(sample.pattern)),
        "design.txt": json_bytes(dict(sample.design)),
        "measures.json": measures_json(sample.measurements),
        **({} if sample.caption is None else {CAPTION: sample.caption.encode()}),
    }


def measures_json(measurements: Measurements) -> bytes:
    """Content of the member ``measures.json``; missing measures are ``MISSING_MEASURE``."""
    return json_bytes({**dict.fromkeys(MEASURES, MISSING_MEASURE), **measurements.to_file_values()})


def _arrays(sample: Sample, tensor: PatternTensor) -> dict[str, bytes]:
    """The members of all arrays except the points."""
    mesh = sample.box_mesh
    if mesh is not None and mesh.panel_names != tensor.panel_names:
        raise ShardError("its mesh and its pattern have different panels")
    arrays: dict[str, np.ndarray] = {
        "panels": tensor.panels,
        "edges": tensor.edges,
        "stitches": np.asarray(tensor.stitches, np.int32),
        "body": _floats(None if sample.shape is None else sample.shape.weights, 0),
        **(_no_mesh() if mesh is None else _mesh_arrays(mesh, tensor.edge_labels)),
        "verts": _floats(None if sample.drape is None else sample.drape.vertices, 0, 3),
    }
    return {FIELDS[field]: write_npy(array) for field, array in arrays.items()}


def _points(points: Float32[np.ndarray, "n 6"] | None) -> tuple[bytes, Quantization]:
    """The member ``points.npy``, and its quantization."""
    if points is None or not len(points):
        return write_npy(np.zeros((0, 6), np.int16)), NO_QUANTIZATION
    points = np.asarray(points, float)
    is_whole = np.isfinite(points).all(axis=1)
    quantization = _quantization(points[is_whole, :3])
    stored = np.full(points.shape, UNDEFINED, np.int16)
    position = (points[is_whole, :3] - quantization.centre) / quantization.scale
    normal = np.clip(points[is_whole, 3:] / quantization.normal, -INT16_MAX, INT16_MAX)
    stored[is_whole] = np.rint(np.concatenate([position, normal], axis=1))
    return write_npy(stored), quantization


def _quantization(positions: Float32[np.ndarray, "n 3"]) -> Quantization:
    """Centroid and step of the points. The step is a power of two, so that decoding multiplies without rounding."""
    centre = np.rint(positions.mean(axis=0)) if len(positions) else np.zeros(3)
    reach = max(float(np.abs(positions - centre).max(initial=0.0)), 1e-3)
    x, y, z = centre.tolist()
    return Quantization(2.0 ** math.ceil(math.log2(reach / INT16_MAX)), 1 / INT16_MAX, (x, y, z))


def _mesh_arrays(mesh: BoxMesh, edge_labels: tuple[str, ...]) -> dict[str, np.ndarray]:
    """The arrays of a box mesh in their stored types. Raises ``ValueError`` for a label that no edge has."""
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
    """The arrays of a skipped mesh, without rows."""
    flat, rows = np.zeros((0, 3)), np.zeros((0, 3), int)
    return _mesh_arrays(BoxMesh(flat, rows, flat[:, :2], rows, rows[:, 0], rows[:, 0], (), (), rows[:, :2]), ())


def _floats(array: np.ndarray | None, *shape: int) -> np.ndarray:
    """The array as f32; for ``None`` an array of ``shape``, which has 0 rows."""
    return np.zeros(shape, np.float32) if array is None else np.asarray(array, np.float32)


def _ids(rows: Int[np.ndarray, "*n"], count: int, name: str, *, smallest: int = 2) -> np.ndarray:
    """Row numbers below ``count`` in the smallest unsigned type of at least ``smallest`` bytes."""
    rows = np.asarray(rows)
    # Column 1 of labels and seams, which holds rows of edge labels or stitches, gets the same limit.
    if rows.size and not 0 <= rows.min() <= rows.max() < count:
        raise ShardError(f"{name} holds row {rows.max() if rows.min() >= 0 else rows.min()} of {count}")
    size = next(n for n in (1, 2, 4) if n >= smallest and count <= 256**n)
    return rows.astype(f"u{size}")


def _meta(sample: Sample, tensor: PatternTensor, quantization: Quantization) -> dict[str, Any]:
    provenance, shape, fabric = sample.provenance, sample.shape, sample.fabric
    mesh, drape = sample.box_mesh, sample.drape
    strain = None if drape is None else drape.strain
    return {
        "schema": SCHEMA,
        "key": sample.key,
        "index": provenance.index,
        "points": {
            "scale": quantization.scale,
            "normal_scale": quantization.normal,
            "centre": list(quantization.centre),
        },
        "seed": provenance.seed,
        "attempts": provenance.attempts,
        "rejects": list(provenance.rejects),
        "redraws": dict(provenance.redraws),
        "versions": dict(provenance.versions),
        "recipe": dict(provenance.recipe),
        "recipe_sha256": recipe_hash(dict(provenance.recipe)),
        "pattern": sample.pattern.name,
        "body": provenance.body_name,
        "holds": {"shape": shape is not None, "mesh": mesh is not None, "drape": drape is not None},
        "pose": None if shape is None else {"arm_angle": float(shape.arm_angle), "legs_apart": bool(shape.legs_apart)},
        "panel_names": list(tensor.panel_names),
        "panel_labels": list(tensor.panel_labels),
        "edge_labels": list(tensor.edge_labels),
        "vertex_labels": None if mesh is None else list(mesh.labels),
        "drape": None if drape is None else _drape_figures(drape),
        "strain": None if strain is None else _strain_figures(strain),
        "grade": "" if sample.grade is None else sample.grade.value,
        "fabric": None if fabric is None else {"name": fabric.name, "parameters": dict(fabric.parameters)},
        "gathers": list(map(float, sample.gathers)),
        "tags": list(sample.tags),
        "source": provenance.source,
    }


def _drape_figures(drape: Drape) -> dict[str, Any]:
    stretch = {name: float(getattr(drape, name)) for name in ("stretch_median", "stretch_p99")}
    return {
        "outcome": drape.outcome.name,
        "frames": drape.frames,
        "self_crossings": drape.self_crossings,
        "body_crossings": drape.body_crossings,
        "body_through": drape.body_through,
        # The stretch of a diverged drape is NaN, which JSON lacks.
        **{name: value if math.isfinite(value) else None for name, value in stretch.items()},
    }


def _strain_figures(strain: Strain) -> dict[str, Any]:
    return {
        "principal": list(map(float, strain.principal)),
        "panels": [list(map(float, pair)) for pair in strain.panels],
    }


# ------------------------------------------------------------------------------------------------------------- decoding


def decode_fields(members: Mapping[str, Bytes], fields: Iterable[str] | None = None) -> dict[str, Any]:
    """Field name to array, parsed JSON, text, or picture as u8 [3, height, width]; all fields for ``None``.

    Floats keep their stored type; points are f32 [cm], ids int32; arrays are views of the members where possible.
    Decoding ``points`` needs ``meta.json`` too. Raises ``ConfigError`` for an unknown field, ``ShardError`` with the
    member's name for invalid content.
    """
    available = fields_of(member for member in members if not member.startswith("__"))  # webdataset adds __key__
    return {field: decode_field(field, members) for field in select_fields(fields, available)}


def decode_sample(members: Mapping[str, Bytes]) -> Sample:
    """The inverse of ``encode_sample``, to the stored precision; the names of edges are not stored.

    Raises ``ShardError`` or ``SpecError`` for invalid content.
    """
    member_of = fields_of(members)
    pictures = {field: bytes(members[member]) for field, member in member_of.items() if member.endswith(".jpg")}
    field = decode_fields(members, [name for name in member_of if name not in pictures])
    meta = field["meta"]
    pattern = pattern_from_spec(field["spec"], meta["pattern"], source=meta["key"])
    try:
        return Sample(
            key=meta["key"],
            provenance=_provenance(meta),
            pattern=pattern,
            measurements=Measurements.from_file_values(field["measures"]),
            design=field["design"],
            shape=None if meta["pose"] is None else _shape(field),
            box_mesh=None if meta["vertex_labels"] is None else _mesh(field, pattern),
            drape=None if meta["drape"] is None else _drape(field),
            points=field["points"].astype(float) if len(field["points"]) else None,
            grade=Grade(meta["grade"]) if meta["grade"] else None,
            fabric=None if meta["fabric"] is None else NamedFabric(**meta["fabric"]),
            gathers=tuple(meta["gathers"]),
            tags=tuple(meta["tags"]),
            caption=field.get("caption"),
            views=_views(pictures, field),
            **{name: pictures[name] for name in ("front", "back") if pictures[name] != NO_PICTURE},
        )
    except (KeyError, ValueError, TypeError) as error:
        if isinstance(error, GcdError):
            raise
        raise ShardError(f"sample {meta['key']}: its members contradict each other ({error}): {REMEDY}") from error


REMEDY = "copy its shard again, or delete the shard and run gcd generate again"


def decode_field(field: str, members: Mapping[str, Bytes]) -> Any:
    """One field, decoded as by ``decode_fields``."""
    member = FIELDS.get(field, field)
    if field in JOINT:
        return _decode_joint(field, members)
    try:
        if field == "points":
            return _read_points(members[member], members[FIELDS["meta"]])
        return DECODERS[field](member_content(field, members))
    except ShardError as error:
        member = next((name for name in (FIRST_NAMES.get(member, member), member) if name in members), member)
        raise ShardError(f"member {member}: {error}: {REMEDY}") from error


def _read_array(field: str, data: Bytes) -> np.ndarray:
    """An array, its type and row shape checked. Raises ``ShardError``."""
    array = read_npy(data)
    if array.shape[1:] != WIDTHS[field] or array.ndim != len(WIDTHS[field]) + 1 or not _has_type(field, array):
        raise ShardError(f"{array.dtype} of shape {array.shape}, expected rows of shape {WIDTHS[field]}")
    return array


def _has_type(field: str, array: np.ndarray) -> bool:
    kind = array.dtype.kind
    return kind in "ui" if field in IDS else kind == "f" or (field == "points" and array.dtype == np.int16)


def _read_points(data: Bytes, meta: Bytes) -> Float32[np.ndarray, "n 6"]:
    """Surface points [cm] and unit normals, f32."""
    stored = _read_array("points", data)
    if stored.dtype.kind == "f":  # schema 1
        return stored.astype(np.float32)
    quantization = read_quantization(meta)
    points = read_buffer(4 * stored.size).view(np.float32)
    np.copyto(points, stored.reshape(-1), casting="unsafe")
    try:
        with np.errstate(over="raise"):
            _by_rows(points, np.multiply, (*3 * (quantization.scale,), *3 * (quantization.normal,)))
            _by_rows(points, np.add, (*quantization.centre, 0.0, 0.0, 0.0))
    except FloatingPointError as error:
        raise ShardError(f"scale {quantization.scale} and centre {quantization.centre} overflow float32") from error
    rows = points.reshape(-1, 6)
    if stored.min(initial=0) == UNDEFINED:
        rows[(stored == UNDEFINED).any(axis=1)] = np.nan
    return rows


def _by_rows(points: Float32[np.ndarray, " n"], operation: np.ufunc, operand: tuple[float, ...]) -> None:
    """Apply an operation to all rows in place, 128 at a time: broadcasting over single rows is much slower."""
    repeated = np.empty((ROWS, len(operand)), np.float32)
    repeated[:] = operand
    flat = repeated.reshape(-1)
    even = len(points) // len(flat) * len(flat)
    blocks, rest = points[:even].reshape(-1, len(flat)), points[even:]
    operation(blocks, flat, out=blocks)
    operation(rest, flat[: len(rest)], out=rest)


ROWS = 128


def _read_ids(field: str, data: Bytes) -> np.ndarray:
    """Row numbers as int32; a view of the member if it is stored as int32."""
    array = _read_array(field, data)
    if array.dtype == np.int32:
        return array
    wide = read_buffer(array.size * 4).view(np.int32).reshape(array.shape)
    np.copyto(wide, array, casting="same_kind")
    return wide


def _picture(data: Bytes) -> np.ndarray:
    """The picture as u8 [3, height, width]; [3, 0, 0] for ``NO_PICTURE``."""
    if data == NO_PICTURE:
        return np.zeros((3, 0, 0), np.uint8)
    with opened_picture(data, ("JPEG",)) as image:
        pixels = np.asarray(image.convert("RGB"))
    return np.ascontiguousarray(pixels.transpose(2, 0, 1))


def _decode_joint(field: str, members: Mapping[str, Bytes]) -> np.ndarray:
    """A field of all views: pictures u8 [n, height, width, 3], cameras f64 [n, 3, 3] and [n, 3, 4].

    Raises ``ShardError`` for views of different sizes.
    """
    found = joint_fields(members)[field]
    decoded = (decode_field(fields_of([member]).popitem()[0], members) for member in found)
    if field == "views":
        pictures = [picture.transpose(1, 2, 0) for picture in decoded]
        if len({picture.shape for picture in pictures}) > 1:
            sizes = ", ".join(f"{picture.shape[1]} x {picture.shape[0]}" for picture in pictures)
            raise ShardError(
                f"its views have the sizes {sizes}, and one array needs equal sizes: read view_0, view_1, …"
            )
        return np.stack(pictures)
    entry, shape = ("k", (3, 3)) if field == "camera_k" else ("rt", (3, 4))
    return np.stack([_matrix(member, facts, entry, shape) for member, facts in zip(found, decoded, strict=True)])


def _matrix(member: str, facts: Mapping[str, Any], entry: str, shape: tuple[int, int]) -> np.ndarray:
    camera: Any = facts.get("camera")
    try:
        return np.array(camera[entry], np.float64).reshape(shape)
    except (KeyError, TypeError, ValueError) as error:
        raise ShardError(f"member {member}: no camera matrix {entry} of shape {shape}: {REMEDY}") from error


def _object(data: Bytes) -> dict[str, Any]:
    value = decode_json(data)
    if not isinstance(value, dict):
        raise ShardError(f"{found(value)}, expected an object")
    return value


def read_measures(data: Bytes) -> dict[str, float]:
    """Measure name to value, without the missing ones. Raises ``ShardError``."""
    values = _object(data)
    for name, value in values.items():
        if isinstance(value, bool) or not isinstance(value, int | float) or not abs(value) < LARGEST_MEASURE:
            raise ShardError(f"{name} is {found(value)}, expected a number")
    return {name: value for name, value in values.items() if value != MISSING_MEASURE}


LARGEST_MEASURE = 1e6  # cm


def _caption(data: Bytes) -> str:
    try:
        return str(data, "utf-8")
    except UnicodeDecodeError as error:
        raise ShardError(f"not UTF-8 text ({error})") from error


def _decoder(field: str) -> Callable[[Bytes], Any]:
    ending = FIELDS[field].rpartition(".")[2]
    if ending == "npy":
        return partial(_read_ids if field in IDS else _read_array, field)
    return {"meta": read_meta, "measures": read_measures}.get(field) or {"txt": _object, "jpg": _picture}[ending]


DECODERS = {
    **{field: _decoder(field) for field in FIELDS},
    "caption": _caption,
    **{f"view_{number}": _picture for number in range(MOST_VIEWS)},
    **{f"view_{number}_json": _object for number in range(MOST_VIEWS)},
}


def _provenance(meta: Mapping[str, Any]) -> Provenance:
    return Provenance(
        seed=meta["seed"],
        index=meta["index"],
        attempts=meta["attempts"],
        rejects=tuple(meta["rejects"]),
        redraws=meta["redraws"],
        versions=meta["versions"],
        recipe=meta["recipe"],
        body_name=meta["body"],
        source=meta["source"],
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


def _shape(field: Mapping[str, Any]) -> BodyShape:
    pose = field["meta"]["pose"]
    return BodyShape(field["body"].astype(float), pose["arm_angle"], pose["legs_apart"])


def _drape(field: Mapping[str, Any]) -> Drape:
    figures, strain = field["meta"]["drape"], field["meta"]["strain"]
    if figures["outcome"] not in Outcome.__members__:
        raise ShardError(f"outcome {figures['outcome']!r}: known are {', '.join(Outcome.__members__)}")
    values = {entry.name: figures[entry.name] for entry in dataclass_fields(Drape) if entry.name in figures}
    values |= {name: np.nan for name in ("stretch_median", "stretch_p99") if values[name] is None}
    principal = None if strain is None else Strain(tuple(strain["principal"]), tuple(map(tuple, strain["panels"])))
    values |= {"vertices": field["verts"].astype(float), "outcome": Outcome[figures["outcome"]], "strain": principal}
    return Drape(**values)


def _views(pictures: Mapping[str, bytes], field: Mapping[str, Any]) -> tuple[View, ...]:
    count = sum(name.startswith("view_") for name in pictures)
    encoded = [pictures[f"view_{number}"] for number in range(count)]
    return tuple(
        View(b"" if picture == NO_PICTURE else picture, field[f"view_{number}_json"])
        for number, picture in enumerate(encoded)
    )
