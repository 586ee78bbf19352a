"""Signed distance field of a body on a grid, with the nearest body part of each voxel, and the skin as a mesh.

Internal faces (eyes, sockets, mouth) are left out and the openings closed with lids, so that the body is solid, with
neither a cavity nor a second skin behind the first. Hands, toes and the head above the mouth are convex hulls: a voxel
is as wide as a finger or an ear, and both would pierce cloth that slips behind them.
"""

import hashlib
import threading
from collections import Counter, OrderedDict
from collections.abc import Iterator, Sequence
from concurrent.futures import Future
from dataclasses import dataclass
from typing import TYPE_CHECKING, Self
from weakref import WeakValueDictionary

import numpy as np
import warp as wp
from jaxtyping import Float, Float32, Int, UInt8
from scipy.spatial import ConvexHull

from gcd_dataset.generator.body.repair import VisibleSkin
from gcd_dataset.generator.body.surface import kept_per_body
from gcd_dataset.generator.device import native_builds
from gcd_dataset.generator.drape.kernels.field import BLOCK, LID, Hull, Voxels, add_hulls, fill_fields, measure_blocks
from gcd_dataset.meshedges import mesh_edges
from gcd_dataset.records import Body, BodyPart

if TYPE_CHECKING:
    from gcd_dataset.generator.drape.dressed import WornGarments

CELL = 1.0  # cm; the field's error is about cell² / (8 × radius): 0.04 cm on a wrist
BAND = 4.0  # cm outside the skin in which distances are exact
LEAF = 1  # faces in a leaf of the BVH on a GPU: fields take a quarter less time than with Warp's default of 4
CACHED = 8  # fields and skins kept for later drapes
HOSTS_CACHED = 32  # host fields kept, 0.1 MB each
FOREARM = 30  # part number of an arm from the elbow to the finger tips; no value of ``BodyPart``
ARMS = 1 << FOREARM | sum(1 << part.value for part in (BodyPart.LEFT_ARM, BodyPart.RIGHT_ARM, BodyPart.HANDS))
"""Bit set of the parts of arms."""
ELBOW = 0.42  # share of the way from the shoulder to the finger tips
TOES = 4.0  # cm above the sole
CRANIUM = 0.7  # share of the head's height, from the top down to the mouth: contains the ears
OVER_NECK = 0.9  # the same share of what lies above the neck, where the parts have no head: the chin is lower
HAND = 0.22  # share of an arm that is its hand, where the parts have no hands
NECK_SLICE = 2.0  # cm, height of the slices among which the neck is the narrowest, where the parts have no head
NECK_BELOW = 0.5  # share of the way from the arms to the crown, below which the neck lies
HEAD_OVER_NECK = 1.1  # least width of a head, as a multiple of the width of its neck
MIN_POINTS = 8  # fewer points on a part have no extent
FACE_SAMPLE = 8  # every eighth face is sampled to find the axis of a part
AXES = {
    "trunk": (BodyPart.TRUNK,),
    "left arm": (BodyPart.LEFT_ARM,),
    "right arm": (BodyPart.RIGHT_ARM,),
    "left leg": (BodyPart.LEFT_LEG,),
    "right leg": (BodyPart.RIGHT_LEG,),
    "legs": (BodyPart.LEFT_LEG, BodyPart.RIGHT_LEG),
}
"""The parts that cloth may cover, each with an axis from top to bottom; skirts cover both legs."""

_in_use: WeakValueDictionary[tuple[str, bytes], "BodyField"] = WeakValueDictionary()
_recent: OrderedDict[tuple[str, bytes], "BodyField"] = OrderedDict()
_hosts: "OrderedDict[tuple[bytes, bytes], Future[HostField]]" = OrderedDict()
_hosts_lock = threading.Lock()
_skins: OrderedDict[bytes, "SkinTopology"] = OrderedDict()
_skins_lock = threading.Lock()


@dataclass(frozen=True, eq=False)
class BodyField:
    """Signed distance field of one body on a device."""

    distance: wp.array
    """(x, y, z) signed distance of the voxels' centres [cm], positive outside."""
    part: wp.array
    """(x, y, z) ``BodyPart`` value of the nearest skin, or ``FOREARM``."""
    origin: tuple[float, float, float]
    """Centre of the first voxel [cm]."""
    cell: float
    """Side of a voxel [cm]."""
    axes: Float[np.ndarray, "2 axes 3"]
    """Upper and lower end of each of ``AXES`` [cm]."""
    mesh: wp.Mesh
    """The closed skin without internal faces [cm]."""
    edges: wp.array
    """(e) vertices of ``mesh`` at the ends of each edge of the skin; without edges of the lids."""
    face_parts: wp.array
    """(g) the part of each face of ``mesh``, see ``HostField.parts``."""
    worn: "WornGarments | None" = None
    """The garments on the body."""


def body_fields(
    bodies: Sequence[Body], device: str, hosts: "Sequence[HostField | None] | None" = None
) -> tuple[BodyField, ...]:
    """The fields of bodies on a device; equal bodies share one cached field. ``hosts``: precomputed host data."""
    hosts = hosts or [None] * len(bodies)
    keys = [
        (device, b"".join(host.digests if host else _digests(body))) for body, host in zip(bodies, hosts, strict=True)
    ]
    fields = {key: field for key in keys if (field := _in_use.get(key)) is not None}
    given = dict(zip(keys, zip(bodies, hosts, strict=True), strict=True))
    missing = {key: (body, host or host_field(body)) for key, (body, host) in given.items() if key not in fields}
    fields |= zip(missing, _make_fields(list(missing.values()), device), strict=True)
    for key, _ in reversed(Counter(keys).most_common()):  # the bodies that most garments wear are kept longest
        _in_use[key] = _recent[key] = fields[key]
        _recent.move_to_end(key)
    while len(_recent) > CACHED:
        _recent.popitem(last=False)
    return tuple(fields[key] for key in keys)


@dataclass(frozen=True)
class HostField:
    """The part of a field's data that needs no device, so any thread or process may compute it."""

    digests: tuple[bytes, bytes]
    """See ``_digests``."""
    parts: UInt8[np.ndarray, " g"]
    """Body part of each face, with ``FOREARM``, and with the bit ``LID`` where it shares a vertex with a lid."""
    low: Float[np.ndarray, "3"]
    """Centre of the first voxel [cm]."""
    shape: tuple[int, ...]
    """Voxels along x, y, z."""
    axes: Float[np.ndarray, "2 axes 3"]
    """See ``BodyField.axes``."""
    hulls: "tuple[HostHull, ...]"
    """Of each hand, of each foot up to the height of its toes, and of the head above the mouth."""

    @classmethod
    def of(cls, body: Body) -> Self:
        known = _skin(_digests(body)[0], body)
        points = known.skin.points(body.vertices)
        used = points[known.vertices].T.copy()  # NumPy reduces rows three times as fast as columns
        low = used.min(axis=1) - BAND - CELL
        size = np.ceil((used.max(axis=1) + BAND + CELL - low) / CELL).astype(int) + 1
        return cls(
            digests=_digests(body),
            parts=_with_forearms(points, known) | known.lids,
            low=low,
            shape=tuple(int(n) for n in size),
            axes=axes_at(points, axis_ends(body)),
            hulls=tuple(HostHull.of(vertices, low, size) for vertices in _extremities(points, known)),
        )


@dataclass(frozen=True)
class HostHull:
    """A convex hull, and the voxels within ``BAND`` of it."""

    planes: Float32[np.ndarray, "p 4"]
    """Half-spaces: outward normal [1] and offset [cm]."""
    first: tuple[int, ...]
    """The first voxel along x, y, z."""
    size: tuple[int, ...]
    """Voxels along x, y, z."""

    @classmethod
    def of(cls, points: Float[np.ndarray, "h 3"], low: Float[np.ndarray, "3"], shape: Int[np.ndarray, "3"]) -> Self:
        """The hull of points [cm] in a field of ``shape`` voxels from ``low`` on."""
        first = np.maximum(np.floor((points.min(axis=0) - BAND - low) / CELL), 0).astype(int)
        end = np.minimum(np.ceil((points.max(axis=0) + BAND - low) / CELL) + 1, shape).astype(int)
        planes = ConvexHull(points).equations.astype(np.float32)
        return cls(planes, tuple(first.tolist()), tuple((end - first).tolist()))


@kept_per_body
def _digests(body: Body) -> tuple[bytes, bytes]:
    """Hashes of a body's topology (faces and parts) and of its vertices."""
    skin = hashlib.sha256(np.ascontiguousarray(body.faces, np.int32).tobytes())
    skin.update(np.ascontiguousarray(body.parts, np.uint8).tobytes())
    shape = hashlib.sha256(np.ascontiguousarray(body.vertices, np.float32).tobytes())
    return skin.digest(), shape.digest()


def host_field(body: Body) -> HostField:
    """``HostField.of`` a body, from a cache of the last few; a thread waits for another that computes the same."""
    key = _digests(body)
    with _hosts_lock:
        begun = _hosts.get(key)
        field = begun or Future()
        _hosts[key] = field
        _hosts.move_to_end(key)
        while len(_hosts) > HOSTS_CACHED:
            _hosts.popitem(last=False)
    if begun is None:
        try:
            field.set_result(HostField.of(body))
        except BaseException as error:
            field.set_exception(error)
            with _hosts_lock:
                _hosts.pop(key, None)
            raise
    return field.result()


@dataclass(frozen=True)
class SkinTopology:
    """A skin's topology and the data derived from it, shared by all bodies of that topology."""

    skin: VisibleSkin
    triangles: Int[np.ndarray, " 3g"]  # vertex indices of the skin's faces, flattened
    edges: Int[np.ndarray, "e 2"]  # the skin's edges, without edges of the lids
    lids: UInt8[np.ndarray, " g"]  # ``LID`` at each face that shares a vertex with a lid
    vertices: Int[np.ndarray, " v"]  # vertices that belong to a face
    arms: tuple[Int[np.ndarray, " l"], Int[np.ndarray, " r"]]  # faces of the left and the right arm, without hands
    hands: Int[np.ndarray, " h"]  # faces of both hands
    extremities: tuple[Int[np.ndarray, " h"], Int[np.ndarray, " f"], Int[np.ndarray, " c"]]
    """Vertices of the faces of both hands, of both feet, and of the head. Without feet: of both legs."""
    limbs: tuple[Int[np.ndarray, " l"], Int[np.ndarray, " r"], Int[np.ndarray, " t"]]
    """Vertices of the faces of the left arm, the right arm and the trunk."""
    axis_vertices: tuple[Int[np.ndarray, " a"], ...]
    """For each of ``AXES`` a vertex of every eighth face of its parts; of the whole body if it lacks the parts."""

    @classmethod
    def of(cls, skin: VisibleSkin) -> "SkinTopology":
        corner, parts = skin.faces[::FACE_SAMPLE, 0], skin.parts[::FACE_SAMPLE]
        sampled = (corner[np.isin(parts, [part.value for part in own])] for own in AXES.values())
        left, right, hands, feet, head = (
            np.flatnonzero(skin.parts == part.value)
            for part in (BodyPart.LEFT_ARM, BodyPart.RIGHT_ARM, BodyPart.HANDS, BodyPart.FEET, BodyPart.HEAD)
        )
        trunk, *legs = (
            np.flatnonzero(skin.parts == part.value) for part in (BodyPart.TRUNK, BodyPart.LEFT_LEG, BodyPart.RIGHT_LEG)
        )
        feet = feet if len(feet) else np.concatenate(legs)
        near_lid = np.isin(skin.faces, np.concatenate([np.zeros(0, int), *skin.rims])).any(axis=1)
        return cls(
            skin,
            np.asarray(skin.faces, np.int32).ravel(),
            _edges_without_lids(skin),
            np.where(near_lid, LID, 0).astype(np.uint8),
            np.unique(skin.faces),
            (left, right),
            hands,
            (np.unique(skin.faces[hands]), np.unique(skin.faces[feet]), np.unique(skin.faces[head])),
            (np.unique(skin.faces[left]), np.unique(skin.faces[right]), np.unique(skin.faces[trunk])),
            tuple(own if len(own) else corner for own in sampled),
        )


def closed_skin(body: Body) -> SkinTopology:
    """The skin without internal faces, its openings closed, from a cache of the last few topologies."""
    return _skin(_digests(body)[0], body)


def _skin(digest: bytes, body: Body) -> SkinTopology:
    with _skins_lock:
        if digest not in _skins:
            _skins[digest] = SkinTopology.of(VisibleSkin.of(body.faces, body.parts))
            if len(_skins) > CACHED:
                _skins.popitem(last=False)
        _skins.move_to_end(digest)
        return _skins[digest]


def _edges_without_lids(skin: VisibleSkin) -> Int[np.ndarray, "e 2"]:
    """Edges between vertices of the body; each lid adds one vertex, numbered after the body's."""
    edges = mesh_edges(skin.faces).ends
    of_body = edges[:, 1] < skin.faces.max() + 1 - len(skin.rims)
    return edges[of_body].astype(np.int32)


def _make_fields(given: Sequence[tuple[Body, HostField]], device: str) -> list[BodyField]:
    """Fields of all bodies with two kernel launches: a launch for one body would not fill a GPU."""
    if not given:
        return []
    hosts = [host for _, host in given]
    known = [_skin(host.digests[0], body) for body, host in given]
    triangles = {id(one): wp.array(one.triangles, dtype=int, device=device) for one in known}
    edges = {id(one): wp.array(one.edges, dtype=wp.vec2i, device=device) for one in known}
    voxels, made = [], []
    points = [
        wp.array(one.skin.points(body.vertices).astype(np.float32), dtype=wp.vec3, device=device)
        for one, (body, _) in zip(known, given, strict=True)
    ]
    leaf = None if device == "cpu" else LEAF
    with native_builds(device):
        meshes = [
            wp.Mesh(at, triangles[id(one)], support_winding_number=True, bvh_leaf_size=leaf)
            for at, one in zip(points, known, strict=True)
        ]
    for host, mesh, one in zip(hosts, meshes, known, strict=True):
        entry = Voxels()
        entry.mesh, entry.low = mesh.id, wp.vec3(*host.low)
        entry.face_parts = wp.array(host.parts, dtype=wp.uint8, device=device)
        entry.blocks = wp.empty([-(-size // int(BLOCK)) for size in host.shape], dtype=wp.vec4, device=device)
        entry.distance = wp.empty(host.shape, dtype=float, device=device)
        entry.part = wp.zeros(host.shape, dtype=wp.uint8, device=device)
        voxels.append(entry)
        x, y, z = host.low.tolist()
        arrays = entry.distance, entry.part
        made.append(BodyField(*arrays, (x, y, z), CELL, host.axes, mesh, edges[id(one)], entry.face_parts))
    bodies = wp.array(voxels, dtype=Voxels, device=device)
    most_blocks = max(entry.blocks.size for entry in voxels)
    for kernel, threads in ((measure_blocks, most_blocks), (fill_fields, most_blocks * int(BLOCK) ** 3)):
        wp.launch(kernel, dim=(len(hosts), threads), inputs=[bodies, CELL, BAND], device=device)
    hulls = [hull for host, entry in zip(hosts, voxels, strict=True) for hull in _hulls(host, entry, device)]
    if hulls:
        largest = max(int(np.prod(hull.size)) for hull in hulls)
        inputs = [wp.array(hulls, dtype=Hull, device=device), CELL]
        wp.launch(add_hulls, dim=(len(hulls), largest), inputs=inputs, device=device)
    return made


def _extremities(points: Float[np.ndarray, "w 3"], known: SkinTopology) -> tuple[Float[np.ndarray, "h 3"], ...]:
    """The vertices of ``HostField.hulls`` [cm]; a body without hands, feet or head gets fewer than five.

    Some segmentations, such as GarmentCode's, count hands as arms, feet as legs and the head as trunk.
    """
    hands, feet, head = (points[part] for part in known.extremities)
    *arms, trunk = (points[limb] for limb in known.limbs)
    if not len(hands):
        hands = np.concatenate([_hand_of(arm) for arm in arms])
    cranium = CRANIUM if len(head) else OVER_NECK
    if not len(head):
        head = _head_of(trunk, np.concatenate(arms))
    toes = feet[feet[:, 1] < feet[:, 1].min(initial=np.inf) + TOES]
    sides = [part[side] for part in (hands, toes) for side in (part[:, 0] > 0.0, part[:, 0] <= 0.0)]
    if len(head):
        top, chin = head[:, 1].max(), head[:, 1].min()
        sides.append(head[head[:, 1] > top - cranium * (top - chin)])
    return tuple(side for side in sides if len(side) and np.linalg.matrix_rank(side - side[0], tol=1e-3) == 3)


def _hand_of(arm: Float[np.ndarray, "a 3"]) -> Float[np.ndarray, "h 3"]:
    """The end of an arm away from the body's middle, ``HAND`` of its length."""
    if len(arm) < MIN_POINTS:
        return arm[:0]
    axis = np.linalg.eigh(np.cov(arm.T))[1][:, -1]
    reach = arm @ (axis * np.sign(axis[0] * arm[:, 0].mean()))
    return arm[reach > reach.max() - HAND * np.ptp(reach)]


def _head_of(trunk: Float[np.ndarray, "t 3"], arms: Float[np.ndarray, "a 3"]) -> Float[np.ndarray, "h 3"]:
    """The trunk above the neck, its narrowest slice above the arms; empty if nothing wider lies above that slice."""
    above = trunk[trunk[:, 1] > arms[:, 1].max(initial=-np.inf)]
    if not len(arms) or len(above) < MIN_POINTS:
        return above[:0]
    shoulders, crown = float(above[:, 1].min()), float(above[:, 1].max())
    slices = np.floor((above[:, 1] - shoulders) / NECK_SLICE).astype(int)
    low = [n for n in np.unique(slices) if n * NECK_SLICE < NECK_BELOW * (crown - shoulders)]
    widths = [float(np.ptp(above[slices == number, 0])) for number in low]
    narrowest = int(np.argmin(widths))
    head = above[slices > low[narrowest]]
    return head if len(head) and np.ptp(head[:, 0]) > HEAD_OVER_NECK * widths[narrowest] else above[:0]


def _hulls(host: HostField, voxels: Voxels, device: str) -> Iterator[Hull]:
    """The hulls of ``host`` on a device."""
    for given in host.hulls:
        hull = Hull()
        hull.planes = wp.array(given.planes, dtype=wp.vec4, device=device)
        hull.first, hull.size = wp.vec3i(*given.first), wp.vec3i(*given.size)
        hull.low, hull.distance = voxels.low, voxels.distance
        yield hull


def axis_ends(body: Body) -> list[tuple[Int[np.ndarray, " u"], Int[np.ndarray, " l"]]]:
    """For each of ``AXES`` the highest tenth of the sampled vertices of ``closed_skin``, and the lowest tenth."""
    known = closed_skin(body)
    heights, ends = known.skin.points(body.vertices)[:, 1], []
    for corners in known.axis_vertices:
        sorted_down = corners[np.argsort(-heights[corners], kind="stable")]
        tenth = max(len(corners) // 10, 1)
        ends.append((sorted_down[:tenth], sorted_down[-tenth:]))
    return ends


def axes_at(
    points: Float[np.ndarray, "w 3"], ends: Sequence[tuple[Int[np.ndarray, " u"], Int[np.ndarray, " l"]]]
) -> Float[np.ndarray, "2 axes 3"]:
    """Upper and lower end of each of ``AXES``, the centroids of ``ends`` [cm]."""
    return np.array([[points[side].mean(axis=0) for side in sides] for sides in zip(*ends, strict=True)])


def _with_forearms(points: Float[np.ndarray, "w 3"], known: SkinTopology) -> UInt8[np.ndarray, " g"]:
    """The part of each face, with ``FOREARM`` from the elbows to the finger tips."""
    parts, faces = known.skin.parts.copy(), known.skin.faces
    hand_x = points[faces[known.hands, 0], 0]
    for arm, side in zip(known.arms, (1.0, -1.0), strict=True):
        limb = np.concatenate([arm, known.hands[side * hand_x > 0]])
        if not len(limb):
            continue
        corner = points[faces[limb, 0]]
        axis = np.linalg.eigh(np.cov(corner[::FACE_SAMPLE].T))[1][:, -1]
        reach = corner @ (axis * np.sign(side * axis[0]))
        parts[limb[reach > reach.min() + ELBOW * np.ptp(reach)]] = FOREARM
    return parts
