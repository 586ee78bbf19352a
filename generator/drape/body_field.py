"""A body as the drape sees it: a signed-distance field with the nearest body part, and the skin itself.

What is marked as internal (eyes, sockets, mouth) is left out, and the openings it leaves are closed: there the body is
solid, and cloth finds neither a cavity nor a second skin behind the first.
"""

import hashlib
import threading
import weakref
from collections import OrderedDict
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import Self
from weakref import WeakValueDictionary

import numpy as np
import warp as wp
from jaxtyping import Float, Int, UInt8

from gcd_dataset.generator.body.holes import VisibleSkin, half_edges_of
from gcd_dataset.generator.drape.kernels.field import BLOCK, Voxels, fill_fields, measure_blocks
from gcd_dataset.records import Body, BodyPart

__all__ = ["AXES", "FOREARM", "BodyField", "HostField", "body_field", "body_fields"]

CELL = 1.0  # cm; the field's error is about cell² / (8 × radius): 0.04 cm on a wrist
BAND = 4.0  # cm outside the skin in which distances are exact
KEPT = 8  # fields kept for bodies that are dressed again
FOREARM = 30  # what the drape calls an arm from the elbow on, with the hand; no ``BodyPart``
ELBOW = 0.42  # of the way from the shoulder to the finger tips

FEW_FACES = 8  # every eighth face tells where a part lies
AXES = {
    "trunk": (BodyPart.TRUNK,),
    "left arm": (BodyPart.LEFT_ARM,),
    "right arm": (BodyPart.RIGHT_ARM,),
    "left leg": (BodyPart.LEFT_LEG,),
    "right leg": (BodyPart.RIGHT_LEG,),
    "legs": (BodyPart.LEFT_LEG, BodyPart.RIGHT_LEG),
}

_digested: dict[int, tuple[weakref.ref[Body], tuple[bytes, bytes]]] = {}
_in_use: WeakValueDictionary[tuple[str, bytes], "BodyField"] = WeakValueDictionary()
_kept: OrderedDict[tuple[str, bytes], "BodyField"] = OrderedDict()
_skins: OrderedDict[bytes, "_KnownSkin"] = OrderedDict()
_skins_lock = threading.Lock()


@dataclass(frozen=True)
class BodyField:
    """Signed distances round one body, on a device."""

    distance: wp.array
    """(x, y, z) signed distance of the voxels' centres [cm], positive outside."""
    part: wp.array
    """(x, y, z) ``BodyPart`` value of the nearest skin, or ``FOREARM``."""
    origin: tuple[float, float, float]
    """Centre of the first voxel [cm]."""
    cell: float
    axes: Float[np.ndarray, "2 axes 3"]
    """Ends of the axes of ``AXES``, the upper one first [cm]."""
    mesh: wp.Mesh
    """The skin without what is internal, in cm."""
    edges: wp.array
    """(e) the two vertices of every edge of the skin, in the mesh's numbering; without the lids over openings."""


def body_field(body: Body, device: str) -> BodyField:
    """The field of a body on a device."""
    return body_fields([body], device)[0]


def body_fields(
    bodies: Sequence[Body], device: str, hosts: "Sequence[HostField | None] | None" = None
) -> tuple[BodyField, ...]:
    """The fields of bodies on a device: made once for each body, from ``hosts`` where given, and kept while in use."""
    keys = [(device, b"".join(_digests(body))) for body in bodies]
    fields = {key: field for key in keys if (field := _in_use.get(key)) is not None}
    given = dict(zip(keys, zip(bodies, hosts or [None] * len(bodies), strict=True), strict=True))
    missing = {key: host or HostField.of(body) for key, (body, host) in given.items() if key not in fields}
    fields |= zip(missing, _make_fields(list(missing.values()), device), strict=True)
    for key in keys:
        _in_use[key] = _kept[key] = fields[key]
        _kept.move_to_end(key)
    while len(_kept) > KEPT:
        _kept.popitem(last=False)
    return tuple(fields[key] for key in keys)


@dataclass(frozen=True)
class HostField:
    """What of a field needs no device, and may be worked out by any thread."""

    triangles: Int[np.ndarray, " 3g"]
    """The skin's faces."""
    edges: Int[np.ndarray, "e 2"]
    """Its edges, without those of the lids over openings."""
    points: Float[np.ndarray, "w 3"]
    """Single precision [cm]."""
    parts: UInt8[np.ndarray, " g"]
    """Of the faces, with ``FOREARM``."""
    low: Float[np.ndarray, "3"]
    """Centre of the first voxel [cm]."""
    shape: tuple[int, ...]
    patched: float
    """Height below which there is no patch over an opening [cm]."""
    axes: Float[np.ndarray, "2 axes 3"]

    @classmethod
    def of(cls, body: Body) -> Self:
        known = _skin(_digests(body)[0], body)
        points = known.skin.points(body.vertices)
        seen = points[known.vertices].T.copy()  # numpy finds the least of a row three times as fast as of a column
        low = seen.min(axis=1) - BAND - CELL
        size = np.ceil((seen.max(axis=1) + BAND + CELL - low) / CELL).astype(int) + 1
        return cls(
            triangles=known.triangles,
            edges=known.edges,
            points=np.asarray(points, np.float32),
            parts=_with_forearms(points, known),
            low=low,
            shape=tuple(int(n) for n in size),
            patched=min((float(points[rim, 1].min()) for rim in known.skin.rims), default=np.inf) - BAND,
            axes=_axes(points, known),
        )


def _digests(body: Body) -> tuple[bytes, bytes]:
    """What tells a body's faces and parts from others', and its shape; worked out once for each object."""
    same, found = _digested.get(id(body), (None, None))
    if found is None or same is None or same() is not body:
        skin = hashlib.sha256(np.ascontiguousarray(body.faces, np.int32).tobytes())
        skin.update(np.ascontiguousarray(body.parts, np.uint8).tobytes())
        shape = hashlib.sha256(np.ascontiguousarray(body.vertices, np.float32).tobytes())
        found = skin.digest(), shape.digest()
        forget = partial(_digested.pop, id(body), None)
        _digested[id(body)] = (weakref.ref(body, lambda _: forget()), found)
    return found


@dataclass(frozen=True)
class _KnownSkin:
    """A skin with what is the same for all bodies that have it."""

    skin: VisibleSkin
    triangles: Int[np.ndarray, " 3g"]
    """Its faces as the device has them."""
    edges: Int[np.ndarray, "e 2"]
    """Its edges, as the device has them."""
    vertices: Int[np.ndarray, " v"]
    """The vertices that faces have."""
    arms: tuple[Int[np.ndarray, " l"], Int[np.ndarray, " r"]]
    """The faces of the left and the right arm, without hands."""
    hands: Int[np.ndarray, " h"]
    along: tuple[Int[np.ndarray, " a"], ...]
    """A corner of every eighth face of the parts of each of ``AXES``; of all parts where it has none."""

    @classmethod
    def of(cls, skin: VisibleSkin) -> "_KnownSkin":
        corner, parts = skin.faces[::FEW_FACES, 0], skin.parts[::FEW_FACES]
        along = (corner[np.isin(parts, [part.value for part in own])] for own in AXES.values())
        left, right, hands = (
            np.flatnonzero(skin.parts == part.value) for part in (BodyPart.LEFT_ARM, BodyPart.RIGHT_ARM, BodyPart.HANDS)
        )
        return cls(
            skin,
            np.asarray(skin.faces, np.int32).ravel(),
            _edges_of_body(skin),
            np.unique(skin.faces),
            (left, right),
            hands,
            tuple(own if len(own) else corner for own in along),
        )


def _skin(digest: bytes, body: Body) -> _KnownSkin:
    """The skin of bodies with these faces and parts; the last few are kept, since most bodies have the same."""
    with _skins_lock:
        if digest not in _skins:
            _skins[digest] = _KnownSkin.of(VisibleSkin.of(body.faces, body.parts))
            if len(_skins) > KEPT:
                _skins.popitem(last=False)
        _skins.move_to_end(digest)
        return _skins[digest]


def _edges_of_body(skin: VisibleSkin) -> Int[np.ndarray, "e 2"]:
    """Edges between vertices of the body: lids have one more vertex each, the last in the skin's numbering."""
    sides, _ = half_edges_of(skin.faces)
    low, high = np.sort(sides, axis=1).astype(np.int64).T
    edges = np.unique((low << 32) + high)
    edges = np.stack([edges >> 32, edges & 0xFFFFFFFF], axis=1)
    of_body = edges[:, 1] < skin.faces.max() + 1 - len(skin.rims)
    return edges[of_body].astype(np.int32)


def _make_fields(hosts: Sequence[HostField], device: str) -> list[BodyField]:
    """All in one launch each of two kernels."""
    if not hosts:
        return []
    triangles = {id(host.triangles): wp.array(host.triangles, dtype=int, device=device) for host in hosts}
    edges = {id(host.edges): wp.array(host.edges, dtype=wp.vec2i, device=device) for host in hosts}
    voxels, made = [], []
    for host in hosts:
        points = wp.array(host.points, dtype=wp.vec3, device=device)
        mesh = wp.Mesh(points=points, indices=triangles[id(host.triangles)], support_winding_number=True)
        entry = Voxels()
        entry.mesh, entry.low, entry.patched_above = mesh.id, wp.vec3(*host.low), host.patched
        entry.face_parts = wp.array(host.parts, dtype=wp.uint8, device=device)
        entry.blocks = wp.empty([-(-size // int(BLOCK)) for size in host.shape], dtype=wp.vec4, device=device)
        entry.distance = wp.empty(host.shape, dtype=float, device=device)
        entry.part = wp.zeros(host.shape, dtype=wp.uint8, device=device)
        voxels.append(entry)
        x, y, z = host.low.tolist()
        made.append(BodyField(entry.distance, entry.part, (x, y, z), CELL, host.axes, mesh, edges[id(host.edges)]))
    bodies = wp.array(voxels, dtype=Voxels, device=device)
    most = max(entry.blocks.size for entry in voxels)
    for kernel, threads in ((measure_blocks, most), (fill_fields, most * int(BLOCK) ** 3)):
        wp.launch(kernel, dim=(len(hosts), threads), inputs=[bodies, CELL, BAND], device=device)
    return made


def _axes(points: Float[np.ndarray, "w 3"], known: _KnownSkin) -> Float[np.ndarray, "2 axes 3"]:
    """From the middle of each part's highest tenth of faces to that of its lowest; of all faces for a missing part."""
    axes = np.zeros((2, len(AXES), 3))
    for number, corners in enumerate(known.along):
        own = points[corners]
        own = own[np.argsort(-own[:, 1], kind="stable")]
        tenth = max(len(own) // 10, 1)
        axes[:, number] = own[:tenth].mean(axis=0), own[-tenth:].mean(axis=0)
    return axes


def _with_forearms(points: Float[np.ndarray, "w 3"], known: _KnownSkin) -> UInt8[np.ndarray, " g"]:
    """The part of each face, where arms end at the elbow."""
    parts, faces = known.skin.parts.copy(), known.skin.faces
    beside = points[faces[known.hands, 0], 0]
    for arm, side in zip(known.arms, (1.0, -1.0), strict=True):
        limb = np.concatenate([arm, known.hands[side * beside > 0]])
        if not len(limb):
            continue
        corner = points[faces[limb, 0]]
        axis = np.linalg.eigh(np.cov(corner[::FEW_FACES].T))[1][:, -1]
        reach = corner @ (axis * np.sign(side * axis[0]))
        parts[limb[reach > reach.min() + ELBOW * np.ptp(reach)]] = FOREARM
    return parts
