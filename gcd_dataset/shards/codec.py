"""Encodes a sample as the members of a shard (``MEMBERS``), and decodes it.

``docs/format.md`` describes the members, ``gcd_dataset.loaders.GarmentFields`` the fields in them, one row per panel,
edge, seam, vertex, …, and ``gcd_dataset.shards.meta`` the keys of ``meta.json``. Members of free JSON are named
``.txt``: their keys differ between samples, so readers that infer types would fail.

``.z`` members are containers of named arrays (``gcd_dataset.shards.sections``). ``faces``, ``panel_id``, ``box`` and
the order of ``points`` follow from the stored sections; a mesh in which they do not follow has the sections ``faces``,
``panel_id`` or ``box``. A pattern without the section ``closures`` is sewn from end to end, one without ``lines``
has none. Positions are stored to within half a ``POSITION_STEP``, ``uv`` half a ``UV_STEP``, normals as octahedral
coordinates (Cigolle et al., JCGT 2014) within 0.23°. An array of a skipped step has no rows.
"""

import contextlib
import io
import math
import zlib
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence, Sized
from dataclasses import astuple, replace
from dataclasses import fields as dataclass_fields
from typing import TYPE_CHECKING, Any, overload

import numpy as np
from jaxtyping import Float, Float32, Int

from gcd_dataset.errors import GcdError, ShardError
from gcd_dataset.jsonfile import found
from gcd_dataset.meshedges import fold_edges
from gcd_dataset.records import (
    BONES,
    MEASURES,
    NO_MESH,
    POSITION_STEP,
    UV_STEP,
    BoxMesh,
    Drape,
    Ease,
    Fit,
    FitLabel,
    GarmentMotion,
    Grade,
    Layer,
    Maps,
    Measurements,
    NamedFabric,
    Outcome,
    Outfit,
    Pattern,
    Provenance,
    Rejected,
    Sample,
    StoredView,
    Strain,
    WornGarment,
    as_stored,
)
from gcd_dataset.shards.layout import (
    ARRAYS,
    CAPTION,
    JOINT,
    LARGEST_SAMPLE,
    MAPS,
    MEMBERS,
    MOST_GARMENTS,
    MOST_PIXELS,
    MOST_VIEWS,
    MOTION,
    POSE,
    SCHEMA,
    Bytes,
    fields_of,
    joint_fields,
    member_of,
    members_of,
    of_each_garment,
    of_garment,
    recipe_hash,
    select_fields,
    split_worn,
    worn_name,
)
from gcd_dataset.shards.meta import (
    COUNTS,
    NO_DRAPE,
    NO_FABRIC,
    NO_LAYER,
    NO_LENGTH,
    NO_POSE,
    NO_REDRAW,
    NO_REJECT,
    NO_STRAIN,
    STRETCHES,
    decode_object,
    fit_entry,
    json_bytes,
    json_text,
    motion_entry,
    pose_entry,
    read_meta,
    read_rejects,
    reject_entry,
    sealed,
    shape_of,
)
from gcd_dataset.shards.motion import decode_motion, encode_motion
from gcd_dataset.shards.sections import Coding, pack, unpack
from gcd_dataset.spec import pattern_from_spec, spec_from_pattern
from gcd_dataset.tensors import COLUMNS, NO_LINES, LineColumn, PanelColumn, PatternTensor, encode_pattern, sewn_rows

if TYPE_CHECKING:
    from PIL import ImageFile

NO_PICTURE = (
    bytes.fromhex("ffd8ffe000104a46494600010100000100010000ffdb004300")
    + 64 * b"\xff"
    + bytes.fromhex("ffc0000b080001000101011100ffc40014000100000000000000000000000000000003")
    + bytes.fromhex("ffc40014100100000000000000000000000000000000ffda0008010100003f0037ffd9")
)
"""A grey JPEG of one pixel: other readers decode every picture, and cannot decode an empty member."""

IDS = frozenset(
    of_each_garment(dict.fromkeys(["faces", "panel_id", "labels", "seams", "corners", "uv_vertex", "stitches"]))
)
"""Fields that hold row numbers, int32."""
DOUBLE = frozenset(of_each_garment(dict.fromkeys(["panels", "edges", "closures", "lines"])))
"""Fields of float64."""

_WIDTHS: Mapping[str, tuple[int, ...]] = {
    **{field: (len(columns),) for field, columns in COLUMNS.items()}, "body": (),
    "faces": (3,), "uv": (2,), "panel_id": (), "labels": (2,), "seams": (2,), "corners": (3,), "uv_vertex": (),
    "box": (3,), "verts": (3,), "points": (6,), "stretch": (2,), "gap": (), "pressure": (), "pose": (3,),
    "motion_verts": (3,), "motion_pose": (3,),
}  # fmt: skip
WIDTHS = of_each_garment(_WIDTHS)
"""Field to the shape of one row of its array."""

_SECTIONS: Mapping[str, tuple[str, ...]] = {
    **{field: (field,) for field in _WIDTHS},
    "closures": ("closures", "stitches"),
    "faces": ("faces", "corners", "uv_vertex"),
    "panel_id": ("panel_id", "faces_of"),
    "box": ("box", "uv", "uv_vertex", "rows_of", "panels"),
    "points": ("points", "xyz", "normals"),
}
SECTIONS = of_each_garment(_SECTIONS)
"""Field to the sections of ``.z`` members that it is decoded from."""

NORMAL_STEPS = 511  # of an octahedral coordinate, from 0 to 1
POSITION_POWER, UV_POWER = round(math.log2(POSITION_STEP)), round(math.log2(UV_STEP))
POSITION = Coding(2, POSITION_POWER)
MESH_CODINGS = {"corners": Coding(3), "uv": Coding(1, UV_POWER), "box": Coding(1, POSITION_POWER)} | dict.fromkeys(
    ("uv_vertex", "labels", "seams", "faces", "panel_id"), Coding(1)
)
QUATERNION = slice(PanelColumn.QUATERNION_W, PanelColumn.QUATERNION_Z + 1)
CENTROID = slice(PanelColumn.CENTROID_X, PanelColumn.CENTROID_Y + 1)
LARGEST_ERROR = 1e-3  # cm: a box further from the derived one is stored
STRIDE = 0x9E3779B1  # of ``spread``: the golden ratio of 2³²

TEXTS = {*(member for member in MEMBERS if member.endswith((".json", ".txt"))), CAPTION} | {
    *of_each_garment(dict.fromkeys(["spec.txt", "design.txt"]))
}
"""The members that are text."""

MISSING_MEASURE = -1.0
"""Marks a missing measure: no length is negative, and no inclination is exactly -1."""
LARGEST_MEASURE = 1e6  # cm

NO_GARMENT = WornGarment(Pattern("", (), ()))
"""In place of a garment that the largest outfit of a data set has, and this one lacks: all its arrays have no rows."""


def encode_sample(sample: Sample, *, garments: int = 1) -> dict[str, bytes]:
    """Member name to bytes; equal samples give equal bytes.

    The members are ``MEMBERS``, caption, views and further garments where the sample has them, and the members of
    ``garments`` garments in any case. Raises ``ShardError`` with the sample's key for content that the format cannot
    hold.
    """
    return _encoded(sample, garments, is_whole=True)


def encode_partial_sample(sample: Sample) -> dict[str, bytes]:
    """Encode a partly read sample, without checksums. Raises ``ShardError`` as ``encode_sample`` does."""
    return _encoded(sample, 1, is_whole=False)


def _encoded(sample: Sample, count: int, *, is_whole: bool) -> dict[str, bytes]:
    try:
        garments = _garments(sample, count)
        tensors = [encode_pattern(garment.pattern) for garment in garments]
        content = _content(sample, garments, tensors)
        crc = {"crc32": {member: zlib.crc32(data) for member, data in content.items()}} if is_whole else {}
        return {MEMBERS[0]: sealed(_meta(sample, garments, tensors) | crc), **content}
    except (ShardError, ValueError, TypeError) as error:
        raise ShardError(f"sample {sample.key} cannot be stored: {error}") from error


def _garments(sample: Sample, count: int) -> list[WornGarment]:
    """The garments of a sample, ``count`` or more. Raises ``ShardError`` for an outfit that the format cannot hold."""
    first = WornGarment(sample.pattern, sample.design, sample.box_mesh, sample.drape, sample.fabric)
    if sample.outfit is None:
        return [first] + [NO_GARMENT] * (count - 1)
    own = sample.outfit.garments
    if not 2 <= len(own) <= MOST_GARMENTS:
        raise ShardError(f"an outfit of {len(own)} garments: give 2 to {MOST_GARMENTS}")
    if own[0] != replace(first, tucked=own[0].tucked, closed=own[0].closed):
        raise ShardError("the first garment of its outfit differs from its own pattern, design, mesh, drape or fabric")
    if wrong := [layer for layer in sample.outfit.layers if not 0 <= layer.inner < layer.outer < len(own)]:
        raise ShardError(f"garment {wrong[0].outer} over {wrong[0].inner}, in an outfit of {len(own)}")
    return [*own, *[NO_GARMENT] * (count - len(own))]


def _content(sample: Sample, garments: Sequence[WornGarment], tensors: Sequence[PatternTensor]) -> dict[str, bytes]:
    """All members except ``meta.json``, in file order."""
    pictures, recipe = {}, sample.provenance.recipe
    is_draped = sample.drape is not None or recipe.get("stage") == "drape"
    if sample.front or sample.back or (is_draped and recipe.get("picture", 1)):
        pictures = {"front.jpg": sample.front or NO_PICTURE, "back.jpg": sample.back or NO_PICTURE}
    views = {
        name: data
        for number, view in enumerate(sample.views)
        for name, data in (
            (f"view_{number}.jpg", view.picture or NO_PICTURE),
            (f"view_{number}.json", json_bytes(dict(view.facts))),
        )
    }
    texts = [
        {"spec.txt": json_bytes(spec_from_pattern(one.pattern)), "design.txt": json_bytes(dict(one.design))}
        for one in garments
    ]
    own = {
        "measures.json": measures_json(sample.measurements),
        **({} if sample.caption is None else {CAPTION: sample.caption.encode()}),
    }
    body = {"body": np.asarray([] if sample.shape is None else sample.shape.weights, np.float32)}
    parts = zip(garments, tensors, [body, *[{}] * (len(garments) - 1)], strict=True)
    arrays = [_arrays(garment, tensor, **extra) for garment, tensor, extra in parts]
    maps = {} if sample.maps is None else {name: _half(array) for name, array in sample.maps.by_vertex.items()}
    _require_rows(maps, () if sample.drape is None else sample.drape.vertices)
    surface = {"points.z": _points(sample.points), **({MAPS: pack(maps)} if maps else {})}
    if sample.shape is not None and sample.shape.pose:
        surface[POSE] = pack({"pose": sample.shape.pose.array.astype(np.float32)})
    if sample.motion is not None:
        surface[MOTION] = encode_motion(sample.motion)
    return {**texts[0], **own, **_further(texts), **arrays[0], **surface, **_further(arrays), **pictures, **views}


def _further(parts: Sequence[Mapping[str, bytes]]) -> dict[str, bytes]:
    """The members of all garments but the first."""
    return {worn_name(k, member): data for k, part in enumerate(parts) if k for member, data in part.items()}


def measures_json(measurements: Measurements) -> bytes:
    """Content of the member ``measures.json``; missing measures are ``MISSING_MEASURE``."""
    return json_bytes({**dict.fromkeys(MEASURES, MISSING_MEASURE), **measurements.to_file_values()})


def _arrays(garment: WornGarment, tensor: PatternTensor, **body: np.ndarray) -> dict[str, bytes]:
    """The ``.z`` members of a garment; ``body``: a further section of ``pattern.z``."""
    mesh, drape = garment.box_mesh, garment.drape
    if mesh is not None and mesh.panel_names != tensor.panel_names:
        raise ShardError("its mesh and its pattern have different panels")
    pattern = {
        "panels": tensor.panels,
        "edges": tensor.edges,
        "stitches": np.asarray(tensor.stitches, np.int32),
        **({} if all(seam.is_plain for seam in garment.pattern.seams) else {"closures": tensor.closures}),
        **_line_arrays(tensor.lines),
        **body,
    }
    vertices = np.zeros((0, 3), np.float32) if drape is None else drape.vertices
    return {
        "pattern.z": pack(pattern),
        "mesh.z": pack(_mesh_arrays(mesh or NO_MESH, tensor), MESH_CODINGS),
        "verts.z": pack({"verts": vertices}, {"verts": POSITION}),
    }


def _half(values: np.ndarray) -> np.ndarray:
    """The values as float16; those beyond its range become its largest or smallest number."""
    largest = np.finfo(np.float16).max
    return np.clip(values, -largest, largest).astype(np.float16)


def _require_rows(maps: Mapping[str, np.ndarray], vertices: Sized) -> None:
    """Raise ``ShardError`` for maps without one row for each vertex."""
    for name, array in maps.items():
        if len(array) != len(vertices):
            raise ShardError(f"{name} has {len(array)} rows for {len(vertices)} vertices")


def _mesh_arrays(mesh: BoxMesh, tensor: PatternTensor) -> dict[str, np.ndarray]:
    """The sections of ``mesh.z``. Raises ``ShardError`` and ``ValueError`` for rows and labels that do not exist."""
    vertices, panels, owner = len(mesh.vertices), len(mesh.panel_names), mesh.panel_of_row
    labelled = [
        np.stack([ids, np.full(len(ids), tensor.edge_labels.index(label))], axis=1)
        for label, ids in mesh.labels.items()
    ]
    arrays = {
        "faces_of": np.bincount(_rows(mesh.panel_id, panels, "panel_id"), minlength=panels).astype(np.uint32),
        "rows_of": np.bincount(owner, minlength=panels).astype(np.uint32),
        "corners": _rows(mesh.corners, len(mesh.uv), "corners"),
        "uv": mesh.uv,
        "uv_vertex": _rows(mesh.uv_vertex, vertices, "uv_vertex"),
        "labels": _rows(np.concatenate([np.zeros((0, 2), int), *labelled]), vertices, "labels"),
        "seams": _rows(mesh.seams, vertices, "seams"),
    }
    if not np.array_equal(mesh.uv_vertex[mesh.corners], mesh.faces):
        arrays["faces"] = _rows(mesh.faces, vertices, "faces")
    if not np.array_equal(_panel_id(arrays), mesh.panel_id):
        arrays["panel_id"] = mesh.panel_id
    stored = {**arrays, "uv": as_stored(mesh.uv, UV_STEP), "panels": tensor.panels}
    derived = _box(stored)
    is_derived = len(derived) == vertices and (np.diff(owner) >= 0).all()
    if not (is_derived and (np.abs(derived - mesh.vertices) <= LARGEST_ERROR).all()):
        arrays["box"] = mesh.vertices
    return arrays


def _rows(rows: Int[np.ndarray, "*n"], count: int, name: str) -> Int[np.ndarray, "*n"]:
    """Row numbers. Raises ``ShardError`` unless they are below ``count``, as in every column of labels and seams."""
    if rows.size and not 0 <= rows.min() <= rows.max() < max(count, 1):
        raise ShardError(f"{name} holds row {rows.max() if rows.min() >= 0 else rows.min()} of {count}")
    return np.asarray(rows, np.int32)


def _points(points: Float32[np.ndarray, "n 6"] | None) -> bytes:
    """The member ``points.z``, in the order before ``spread``; unit normals as octahedral coordinates."""
    points = np.zeros((0, 6)) if points is None else np.asarray(points, float)
    ordered = np.empty_like(points)
    ordered[spread(len(points))] = points
    x, y, z = np.ascontiguousarray(ordered[:, 3:].T)
    with np.errstate(invalid="ignore", divide="ignore"):
        flat = np.stack([x, y]) / (np.abs(x) + np.abs(y) + np.abs(z))
    np.copyto(flat, (1 - np.abs(flat[::-1])) * np.where(flat >= 0, 1, -1), where=z < 0)
    octahedral = np.rint(flat * NORMAL_STEPS)
    edge = np.abs(octahedral[::-1]) == NORMAL_STEPS  # two pairs of numbers mean one normal there
    np.abs(octahedral, out=octahedral, where=edge)
    return pack(
        {"xyz": ordered[:, :3], "normals": octahedral.T}, {"xyz": Coding(1, POSITION_POWER), "normals": Coding(1)}
    )


def spread(count: int) -> Int[np.ndarray, " n"]:
    """The order of the points of an item: rows of ``points.z``, in steps that visit all of them, far apart.

    The step is the first number from n · ``STRIDE`` / 2³² on that has no factor in common with n.

    >>> spread(7).tolist()
    [0, 4, 1, 5, 2, 6, 3]
    """
    step = count * STRIDE >> 32
    while math.gcd(step, count) > 1:
        step += 1
    return np.arange(count, dtype=np.int64) * step % max(count, 1)


def _meta(sample: Sample, garments: Sequence[WornGarment], tensors: Sequence[PatternTensor]) -> dict[str, Any]:
    """The entries of ``meta.json``, without checksums."""
    provenance, shape, outfit = sample.provenance, sample.shape, sample.outfit
    texts = [text.partition(": ") for text in provenance.rejects]
    rejects = provenance.turned_down or [Rejected(provenance.index, rule, reason) for rule, _, reason in texts]
    fit = {} if sample.fit is None else fit_entry(sample.fit)
    if sample.ease:
        fit["ease"] = {
            name: [length if math.isfinite(length) else NO_LENGTH for length in astuple(ease)]
            for name, ease in sample.ease.items()
        }
    worn = [_worn_entry(*pair) for pair in zip(garments, tensors, strict=True) if pair[0] is not NO_GARMENT]
    own, layers = worn[0], [vars(layer) for layer in (outfit.layers if outfit else ())] or [dict(NO_LAYER)]
    return {
        "schema": SCHEMA,
        "key": sample.key,
        "index": provenance.index,
        "seed": provenance.seed,
        "attempts": provenance.attempts,
        "rejects": [reject_entry(reject) for reject in rejects] or [NO_REJECT],
        "redraws": [{"rule": rule, "count": n} for rule, n in provenance.redraws.items()] or [NO_REDRAW],
        "versions": json_text(dict(provenance.versions)),
        "recipe": json_text(dict(provenance.recipe)),
        "recipe_sha256": recipe_hash(dict(provenance.recipe)),
        "pattern": own["pattern"],
        "body": provenance.body_name,
        "holds": {"shape": shape is not None, **own["holds"]},
        "pose": NO_POSE if shape is None else pose_entry(shape),
        **{name: own[name] for name in LABELS},
        "drape": own["drape"],
        "strain": own["strain"],
        "grade": "" if sample.grade is None else sample.grade.value,
        "fabric": own["fabric"],
        "gathers": list(map(float, sample.gathers)) or [-1.0],
        **({"fit": fit} if fit else {}),
        **({} if sample.maps is None else {"softened": float(sample.maps.softened)}),
        **({} if sample.motion is None else {"motion": motion_entry(sample.motion)}),
        **({"outfit": worn, "layers": layers} if len(garments) > 1 else {}),
        "tags": list(sample.tags) or [""],
        "source": provenance.source,
    }


LABELS = ("panel_names", "panel_labels", "edge_labels", "vertex_labels")


def _worn_entry(garment: WornGarment, tensor: PatternTensor) -> dict[str, Any]:
    mesh, drape, fabric = garment.box_mesh, garment.drape, garment.fabric
    strain, figures = None if drape is None else drape.strain, dict(NO_DRAPE)
    if drape is not None:
        figures |= {"outcome": drape.outcome.name, "frames": drape.frames}
        figures |= {name: count for name in COUNTS if (count := getattr(drape, name)) is not None}
        # The stretch of a diverged drape is NaN, which JSON lacks.
        figures |= {name: x for name in STRETCHES if math.isfinite(x := float(getattr(drape, name)))}
    return {
        "pattern": garment.pattern.name,
        "tucked": garment.tucked,
        "closed": garment.closed,
        "holds": {"mesh": mesh is not None, "drape": drape is not None},
        "panel_names": list(tensor.panel_names),
        "panel_labels": list(tensor.panel_labels),
        "edge_labels": list(tensor.edge_labels),
        "vertex_labels": [*(() if mesh is None else mesh.labels)] or [""],
        "drape": figures,
        "strain": NO_STRAIN
        if strain is None
        else {"principal": [*map(float, strain.principal)], "panels": [[*map(float, pair)] for pair in strain.panels]},
        "fabric": NO_FABRIC
        if fabric is None
        else {"name": fabric.name, "parameters": json_text(dict(fabric.parameters))},
    }


def decode_fields(members: Mapping[str, Bytes], fields: Iterable[str] | None = None) -> dict[str, Any]:
    """Field name to array, parsed JSON, text, or picture as u8 [3, height, width]; all fields for ``None``.

    Floats keep their stored type, f64 for panels and edges, f32 for others; ids are int32. Decoding ``box`` needs
    ``pattern.z`` too. Raises ``ConfigError`` for an unknown field, ``ShardError`` with the
    member's name for invalid content.
    """
    names = [member for member in members if not member.startswith("__")]  # webdataset adds __key__
    joint = () if fields is None else joint_fields(names)
    return _decoded(members, select_fields(fields, (*fields_of(names), *joint)))


@overload
def decode(sample: Mapping[str, Any], /) -> dict[str, Any]: ...
@overload
def decode(member: str, data: Bytes, /) -> Any: ...
def decode(sample: Any, data: Bytes | None = None, /) -> Any:
    """Decode a sample of our tars, or a member of it.

    >>> webdataset.WebDataset(tars).decode(decode)  # doctest: +SKIP
    >>> webdataset.WebDataset(tars).map(decode)  # doctest: +SKIP
    >>> datasets.load_dataset("webdataset", data_files=tars, streaming=True)["train"].map(decode)  # doctest: +SKIP

    A sample, member to bytes: returns its fields, see ``GarmentFields``: arrays, parsed JSON, text; ``faces``,
    ``panel_id`` and ``box`` included. Entries of the same names that are no bytes were decoded by the caller, and stay
    as they are. Other entries, such as pictures, are left out.

    A member, such as ``".verts.z"``, and its bytes: returns the fields in it as a dict; for JSON the parsed value, for
    a caption the text. For other members it returns ``None``, and webdataset asks the next handler: pictures are
    decoded by ``.decode(decode, "torchrgb")``. ``box`` needs two members, and is left out.

    Raises ``ShardError`` with the member's name for damaged content.
    """
    if data is None:
        return _all_fields(sample)
    member = sample.removeprefix(".")
    if member in TEXTS:
        return next(iter(decode_fields({member: data}).values()))
    return _all_arrays({member: data}) if member.endswith(".z") else None


def _all_fields(sample: Mapping[str, Any]) -> dict[str, Any]:
    # Others are not even looked up: ``datasets`` would decode a picture.
    ours = {name: sample[name] for name in sample if name in TEXTS or name.endswith(".z")}
    values = dict[str, Any]()
    for name in [name for name, value in ours.items() if not isinstance(value, Bytes)]:
        value = ours.pop(name)
        values |= dict.fromkeys(fields_of([name]), value) if name in TEXTS else value or {}
    texts = {name: ours.pop(name) for name in TEXTS & ours.keys()}
    return values | decode_fields(texts) | _all_arrays(ours)


def _all_arrays(members: Mapping[str, Bytes]) -> dict[str, Any]:
    """The fields in ``.z`` members; the arrays of an unknown member, or one of a person, as they are stored."""
    garment = {member: data for member, data in members.items() if member in ARRAYS}
    member_in = fields_of(garment)
    values = decode_fields(garment, [f for f in member_in if garment.keys() >= {*members_of([f], member_in)}])
    for member in members.keys() - garment.keys():
        with _reading(member):
            values |= unpack(members[member])
    return values


def decode_sample(members: Mapping[str, Bytes]) -> Sample:
    """The inverse of ``encode_sample``, to the stored precision; the names of edges are not stored.

    Raises ``ShardError`` or ``SpecError`` for invalid content.
    """
    member_in = fields_of(members)
    pictures = {field: bytes(members[member]) for field, member in member_in.items() if member.endswith(".jpg")}
    field = decode_fields(members, [f for f in member_in if f not in pictures and f not in ARRAYS[MOTION]])
    meta = field["meta"]
    fit = meta.get("fit", {})
    try:
        worn = enumerate(meta.get("outfit") or [meta])
        garments = tuple(_garment(of_garment(k, field) | {"meta": entry}, meta["key"]) for k, entry in worn)
        first = garments[0]
        return Sample(
            key=meta["key"],
            provenance=_provenance(meta, read_rejects(members["meta.json"])),
            pattern=first.pattern,
            measurements=Measurements.from_file_values(field["measures"]),
            design=first.design,
            shape=None if meta["pose"] is None else shape_of(field["body"].astype(float), meta["pose"]),
            box_mesh=first.box_mesh,
            drape=first.drape,
            maps=Maps(**{f: field[f].astype(float) for f in ARRAYS[MAPS]}, softened=meta["softened"])
            if "gap" in field
            else None,
            motion=replace(decode_motion(members[MOTION]), asked=moved["asked"], ended=Outcome[moved["ended"]])
            if MOTION in members and (moved := meta.get("motion"))
            else None,
            points=field["points"].astype(float) if len(field["points"]) else None,
            grade=Grade(meta["grade"]) if meta["grade"] else None,
            fabric=first.fabric,
            gathers=tuple(meta["gathers"]),
            ease={
                name: Ease(**{key: value for key, value in figures.items() if value is not None})
                for name, figures in fit.get("ease", {}).items()
            },
            tags=tuple(meta["tags"]),
            caption=field.get("caption"),
            views=_views(pictures, field),
            fit=_fit(fit) if "chart" in fit else None,
            **{name: pictures[name] for name in ("front", "back") if pictures.get(name, NO_PICTURE) != NO_PICTURE},
            outfit=Outfit(garments, tuple(Layer(**layer) for layer in meta["layers"])) if len(garments) > 1 else None,
        )
    except (KeyError, ValueError, TypeError) as error:
        if isinstance(error, GcdError):
            raise
        raise ShardError(f"sample {meta['key']}: its members contradict each other ({error}): {REMEDY}") from error


PATTERN_FIELDS = ("meta", *COLUMNS)


def patterns_of(members: Mapping[str, Bytes]) -> Iterator[PatternTensor]:
    """The pattern of an encoded garment, or those of its outfit, from its ``PATTERN_FIELDS``. Raises ``ShardError``."""
    meta = decode_field("meta", members)
    for number, entry in enumerate(meta.get("outfit") or [meta]):
        arrays = of_garment(number, decode_fields(members, [worn_name(number, name) for name in COLUMNS]))
        names: dict[str, Any] = {name: tuple(entry[name]) for name in ("panel_names", "panel_labels", "edge_labels")}
        yield PatternTensor(**arrays, **names, name=meta["key"])


REMEDY = "copy its shard again, or delete the shard and run gcd generate again"


def decode_field(field: str, members: Mapping[str, Bytes]) -> Any:
    """One field, decoded as by ``decode_fields``."""
    return _decoded(members, (field,))[field]


def _decoded(members: Mapping[str, Bytes], fields: Sequence[str]) -> dict[str, Any]:
    numbers = {split_worn(field)[0] for field in fields}
    if numbers <= {0}:
        return _decoded_garment(members, fields)
    values = dict[str, Any]()
    for number in numbers:
        plain = [field for worn, field in map(split_worn, fields) if worn == number]
        try:
            found = _decoded_garment(of_garment(number, members), plain)
        except ShardError as error:
            raise ShardError(str(error).replace("member ", f"member g{number}." if number else "member ", 1)) from error
        values |= {worn_name(number, field): value for field, value in found.items()}
    return {field: values[field] for field in fields}


def _line_arrays(lines: Float[np.ndarray, "n w"]) -> dict[str, np.ndarray]:
    """The sections of the lines: rest angles are one of their own, which earlier versions skip."""
    angles = lines[:, LineColumn.ANGLE]
    return {
        **({"lines": lines[:, : LineColumn.ANGLE]} if len(lines) else {}),
        **({"angles": angles} if angles.any() else {}),
    }


def _with_angles(arrays: Mapping[str, np.ndarray]) -> Mapping[str, np.ndarray]:
    """The arrays with the column that ``_line_arrays`` took off the lines; columns of other files have it still."""
    lines, angles = arrays["lines"], arrays.get("angles")
    if lines.shape[1:] != (LineColumn.ANGLE,):
        return arrays
    angles = np.zeros(len(lines)) if angles is None else angles
    if angles.shape != (len(lines),):
        raise ShardError(f"section angles: shape {angles.shape} for {len(lines)} lines")
    return {**arrays, "lines": np.column_stack([lines, angles])}


def _decoded_garment(members: Mapping[str, Bytes], fields: Sequence[str]) -> dict[str, Any]:
    """The fields of one garment of an outfit, by their names in a single garment."""
    arrays: dict[str, np.ndarray] = {}
    sections = {section for field in fields for section in SECTIONS.get(field, ())}
    if "lines" in sections:
        sections.add("angles")
    stored = {field: member_of(field) for field in fields if field in SECTIONS}
    if MAPS in stored.values() and "verts.z" in members:
        stored, sections = {**stored, "verts": "verts.z"}, {*sections, "verts"}
    for member in members_of(stored, stored):
        with _reading(member):
            if member == MOTION:
                moving = motion_arrays(decode_motion(members[member]))
                arrays |= {name: values.reshape(-1, 3) for name, values in moving.items()}
                continue
            arrays |= unpack(members[member], sections)
            if member == "pattern.z" and "lines" in arrays:
                arrays = dict(_with_angles(arrays))
    if "verts" in arrays:
        with _reading(MAPS):
            _require_rows({name: arrays[name] for name in ARRAYS[MAPS] if name in arrays}, arrays["verts"])
    found = {}
    for field in fields:
        if field in JOINT:
            found[field] = _decode_joint(field, members)
            continue
        with _reading(member := member_of(field)):
            found[field] = _array(field, arrays) if field in SECTIONS else DECODERS[field](members[member])
    return found


@contextlib.contextmanager
def _reading(member: str) -> Iterator[None]:
    try:
        yield
    except ShardError as error:
        raise ShardError(f"member {member}: {error}: {REMEDY}") from error


def _array(field: str, arrays: Mapping[str, np.ndarray]) -> np.ndarray:
    """A field from its sections, its type and row shape checked. Raises ``ShardError``."""
    derive = DERIVED.get(field)
    for section in SECTIONS[field] if derive and field not in arrays else (field,):
        if section in arrays and section in WIDTHS:
            _require_form(section, arrays[section])
        elif section not in arrays and section != field:
            raise ShardError(f"section {section} is missing")
    if field in arrays:
        return arrays[field].astype(np.float32) if field in ARRAYS[MAPS] else arrays[field]
    if derive is None:
        raise ShardError(f"section {field} is missing")
    return derive(arrays)


def _require_form(section: str, array: np.ndarray) -> None:
    """Raise ``ShardError`` for another type or row shape than the section's."""
    is_whole = array.dtype == np.int32 and array.min(initial=0) >= 0
    if array.shape[1:] != WIDTHS[section] or not (is_whole if section in IDS else array.dtype.kind == "f"):
        raise ShardError(f"section {section}: {array.dtype} of shape {array.shape}, expected rows {WIDTHS[section]}")


def _faces(arrays: Mapping[str, np.ndarray]) -> Int[np.ndarray, "f 3"]:
    corners, vertex = arrays["corners"], arrays["uv_vertex"]
    if corners.max(initial=-1) >= len(vertex):
        raise ShardError(f"a corner is row {corners.max()} of {len(vertex)}")
    return vertex.take(corners)


def _panel_id(arrays: Mapping[str, np.ndarray]) -> Int[np.ndarray, " f"]:
    counts = _counts("faces_of", arrays)
    return np.repeat(np.arange(len(counts), dtype=np.int32), counts)


@np.errstate(over="ignore", invalid="ignore")  # in a damaged sample
def _box(arrays: Mapping[str, np.ndarray]) -> Float32[np.ndarray, "v 3"]:
    """Positions before sewing [cm]: the mean of the placed rows of ``uv`` at each vertex."""
    uv, vertex, panels, counts = arrays["uv"], arrays["uv_vertex"], arrays["panels"], _counts("rows_of", arrays)
    if counts.sum() != len(uv) or len(vertex) != len(uv) or len(counts) > len(panels):
        raise ShardError(f"rows_of names {counts.sum()} rows of {len(counts)} panels; there are {len(uv)}")
    if vertex.max(initial=-1) >= len(uv):
        raise ShardError(f"uv_vertex holds row {vertex.max()}, and there are {len(uv)} rows of uv")
    w, x, y, z = panels[:, QUATERNION].T
    right = np.stack([1 - 2 * (y * y + z * z), 2 * (x * y + w * z), 2 * (x * z - w * y)], axis=1)
    up = np.stack([2 * (x * y - w * z), 1 - 2 * (x * x + z * z), 2 * (y * z + w * x)], axis=1)
    flat, spots, end = uv.T.astype(float), np.empty((3, len(uv))), 0
    for turn, panel, count in zip(np.stack([right, up], axis=2), panels, counts.tolist(), strict=False):
        rows = slice(end, end := end + count)
        np.matmul(turn, flat[:, rows] - panel[CENTROID, None], out=spots[:, rows])
        spots[:, rows] += panel[:3, None]
    vertex = vertex.astype(np.int64)
    members = np.maximum(np.bincount(vertex), 1)
    box = np.empty((len(members), 3), np.float32)
    for column, values in enumerate(spots):
        box[:, column] = np.bincount(vertex, values) / members
    return box


def _counts(section: str, arrays: Mapping[str, np.ndarray]) -> Int[np.ndarray, " p"]:
    counts = arrays[section]
    if counts.ndim != 1 or counts.dtype.kind not in "iu" or 4 * counts.sum() > LARGEST_SAMPLE:
        raise ShardError(f"section {section}: {counts.dtype} of shape {counts.shape}, sum {counts.sum()}")
    return counts.astype(np.int64)


@np.errstate(over="ignore", invalid="ignore")  # in a damaged sample
def _read_points(arrays: Mapping[str, np.ndarray]) -> Float32[np.ndarray, "n 6"]:
    """Surface points [cm] and unit normals; NaN for those of a diverged drape."""
    xyz, flat = arrays["xyz"], arrays["normals"].astype(np.float32)
    if xyz.shape[1:] != (3,) or flat.shape != (len(xyz), 2):
        raise ShardError(f"xyz of shape {xyz.shape}, normals of shape {flat.shape}")
    columns = np.empty((6, len(xyz)), np.float32)
    columns[:3], normals = xyz.T, columns[3:]
    x, y, z = normals
    np.divide(flat.T, np.float32(NORMAL_STEPS), out=normals[:2])
    np.subtract(1, np.abs(x) + np.abs(y), out=z)
    below = np.minimum(z, 0)
    normals[:2] += np.where(normals[:2] >= 0, below, -below)
    normals /= np.sqrt(x * x + y * y + z * z)
    return np.ascontiguousarray(columns.T).take(spread(len(xyz)), axis=0)


DERIVED: Mapping[str, Callable[[Mapping[str, np.ndarray]], np.ndarray]] = {
    "closures": lambda arrays: sewn_rows(len(arrays["stitches"])), "lines": lambda arrays: NO_LINES.copy(),
    "faces": _faces, "panel_id": _panel_id, "box": _box, "points": _read_points,
}  # fmt: skip
"""Field to the function that derives it from its sections, unless it is stored itself."""


@contextlib.contextmanager
def opened_picture(data: Bytes) -> "Iterator[ImageFile.ImageFile]":
    """The JPEG in a member; its pixels are decoded inside the block.

    Raises ``ShardError`` for a broken picture, another format, or more than ``MOST_PIXELS`` pixels.
    """
    from PIL import Image

    bombs = (Image.DecompressionBombError, Image.DecompressionBombWarning)
    try:
        with Image.open(io.BytesIO(data), formats=("JPEG",)) as image:
            if image.width * image.height > MOST_PIXELS:
                raise ShardError(f"a picture of {image.width} x {image.height} pixels, over the limit of {MOST_PIXELS}")
            yield image
    except (OSError, ValueError, SyntaxError, EOFError, *bombs) as error:
        raise ShardError(f"not a picture ({error})") from error


def _picture(data: Bytes) -> np.ndarray:
    """The picture as u8 [3, height, width]; [3, 0, 0] for ``NO_PICTURE``."""
    if data == NO_PICTURE:
        return np.zeros((3, 0, 0), np.uint8)
    with opened_picture(data) as image:
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
    matrices = []
    for member, facts in zip(found, decoded, strict=True):
        try:
            matrices.append(np.array(facts["camera"][entry], np.float64).reshape(shape))
        except (KeyError, TypeError, ValueError) as error:
            raise ShardError(f"member {member}: no camera matrix {entry} of shape {shape}: {REMEDY}") from error
    return np.stack(matrices)


def read_measures(data: Bytes) -> dict[str, float]:
    """Measure name to value, without the missing ones. Raises ``ShardError``."""
    values = decode_object(data)
    for name, value in values.items():
        if isinstance(value, bool) or not isinstance(value, int | float) or not abs(value) < LARGEST_MEASURE:
            raise ShardError(f"{name} is {found(value)}, expected a number")
    return {name: value for name, value in values.items() if value != MISSING_MEASURE}


def _caption(data: Bytes) -> str:
    try:
        return str(data, "utf-8")
    except UnicodeDecodeError as error:
        raise ShardError(f"not UTF-8 text ({error})") from error


DECODERS: Mapping[str, Callable[[Bytes], Any]] = {
    "meta": read_meta,
    **of_each_garment({"spec": decode_object, "design": decode_object}),
    "measures": read_measures,
    "front": _picture,
    "back": _picture,
    "caption": _caption,
    **{f"view_{number}": _picture for number in range(MOST_VIEWS)},
    **{f"view_{number}_json": decode_object for number in range(MOST_VIEWS)},
}
"""Field to the decoder of its member."""


def _provenance(meta: Mapping[str, Any], rejects: Sequence[Mapping[str, Any]]) -> Provenance:
    same = ("seed", "index", "attempts", "redraws", "versions", "recipe", "source")
    return Provenance(
        **{name: meta[name] for name in same},
        rejects=tuple(meta["rejects"]),
        turned_down=tuple(
            Rejected(entry["index"], entry["rule"], entry["reason"], decode_object(entry["figures"].encode()))
            for entry in rejects
        ),
        body_name=meta["body"],
    )


def motion_arrays(motion: GarmentMotion) -> dict[str, np.ndarray]:
    """The fields of a motion: positions (t, v, 3) and angles (t, 21, 3)."""
    turns = np.array([pose.array for pose in motion.poses], np.float32)
    return {"motion_verts": motion.vertices, "motion_pose": turns.reshape(-1, len(BONES), 3)}


def _garment(field: Mapping[str, Any], key: str) -> WornGarment:
    """A garment of an outfit, from its fields; ``meta`` is its entry in ``outfit``."""
    meta = field["meta"]
    pattern = pattern_from_spec(field["spec"], meta["pattern"], source=key)
    return WornGarment(
        pattern,
        field["design"],
        box_mesh=None if meta["vertex_labels"] is None else _mesh(field, pattern),
        drape=None if meta["drape"] is None else _drape(field),
        fabric=None if meta["fabric"] is None else NamedFabric(**meta["fabric"]),
        tucked=meta.get("tucked", False),
        closed=meta.get("closed", True),
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
        folds=fold_edges(pattern, field["uv"].astype(float), ids["corners"], ids["panel_id"]),
        **ids,
    )


def _drape(field: Mapping[str, Any]) -> Drape:
    figures, strain = field["meta"]["drape"], field["meta"]["strain"]
    if figures["outcome"] not in Outcome.__members__:
        raise ShardError(f"outcome {figures['outcome']!r}: known are {', '.join(Outcome.__members__)}")
    values = {entry.name: figures[entry.name] for entry in dataclass_fields(Drape) if entry.name in figures}
    values |= {name: np.nan for name in STRETCHES if values[name] is None}
    values["outcome"] = Outcome[figures["outcome"]]
    if strain is not None:
        values["strain"] = Strain(tuple(strain["principal"]), tuple(map(tuple, strain["panels"])))
    return Drape(**values, vertices=field["verts"].astype(float))


def _fit(entry: Mapping[str, Any]) -> Fit:
    sizes = {name: value for name, value in entry.items() if name != "ease"}
    return Fit(**sizes | {"labels": tuple(FitLabel(**label) for label in entry["labels"])})


def _views(pictures: Mapping[str, bytes], field: Mapping[str, Any]) -> tuple[StoredView, ...]:
    names = [f"view_{number}" for number in range(sum(name.startswith("view_") for name in pictures))]
    return tuple(
        StoredView(b"" if pictures[name] == NO_PICTURE else pictures[name], field[f"{name}_json"]) for name in names
    )
