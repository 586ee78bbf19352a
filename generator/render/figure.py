"""The figure without clothes: masks for underwear, brows and lips, eyeballs, and a shell of hair."""

from dataclasses import dataclass
from functools import cache

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial import KDTree

from gcd_dataset.generator.render.scene import HairStyle, Scene
from gcd_dataset.records import Body, BodyPart, Record

BRIEFS_HEIGHT = 0.115  # of the figure's height, from the crotch to the top of the briefs
TOP_HEIGHTS = (0.655, 0.775)  # of the figure's height: lower and upper end of the top; the bust is at 0.72
LEG_OPENING = 0.55  # slope of the leg openings
HAIR_DEPTH = {HairStyle.NONE: 0.0, HairStyle.CROPPED: 0.6, HairStyle.SHORT: 1.6, HairStyle.FULL: 2.4}  # cm
UNDER_CLOTH = 0.3  # cm; least distance of hair from cloth
SAMPLES = 0.7  # cm; greatest distance of neighbouring points at which cloth is looked for
FAR = -10.0  # cm; value of a field far outside
EYE_RINGS, EYE_SECTORS = 7, 12  # faces of an eyeball


@dataclass(frozen=True, eq=False)
class BodyMasks(Record):
    """Signed fields on the body's vertices, positive inside: their zero lines are smooth between the vertices."""

    briefs: Float[np.ndarray, " v"]
    """[cm]"""
    top: Float[np.ndarray, " v"]
    """[cm]"""
    brows: Float[np.ndarray, " v"]
    """[cm]"""
    lips: Float[np.ndarray, " v"]
    """0 to 1 on the lips, 2 in the mouth and in the eye sockets."""
    scalp: Float[np.ndarray, " v"]
    """Above the line of short hair [cm]."""
    mane: Float[np.ndarray, " v"]
    """Above the line of full hair, which covers the nape [cm]."""
    sockets: tuple[Int[np.ndarray, " a"], Int[np.ndarray, " b"]]
    """Vertices of the right and the left eye socket."""


@dataclass(frozen=True, eq=False)
class Shell(Record):
    """A mesh that is added to the body; may be empty."""

    vertices: Float[np.ndarray, "h 3"]
    """[cm]"""
    faces: Int[np.ndarray, "g 3"]


@dataclass(frozen=True, eq=False)
class _HairPlan(Record):
    """The scalp of a body, and how far hair stands off it."""

    rows: Int[np.ndarray, " h"]
    """Vertices of the body."""
    faces: Int[np.ndarray, "g 3"]
    """Rows of ``rows``."""
    rise: Float[np.ndarray, " h"]
    """[cm]"""


@dataclass(frozen=True, eq=False)
class Eyes(Shell):
    """Both eyeballs."""

    centres: Float[np.ndarray, "2 3"]
    """Of the right and the left eye [cm]; far away for a body without eye sockets."""
    radius: float
    """[cm]"""


def body_masks(body: Body) -> BodyMasks:
    """The masks of a body; those of the body model are found once, on the neutral body, and kept by vertex."""
    return _model_masks() if len(body.parts) == len(_model_body().parts) else _masks_of(body)


def hair_shell(scene: Scene) -> Shell:
    """The scalp moved outwards by the depth of the hair, and into the skin past its edge.

    Cloth on the head, such as a hood, presses the hair down: hair rises to ``UNDER_CLOTH`` below the next cloth.
    """
    body, style = scene.body, scene.hair
    plan = _model_hair(style) if len(body.parts) == len(_model_body().parts) else _hair_plan(body, style)
    points = body.vertices[plan.rows]
    if not len(points):
        return Shell(points, plan.faces)
    rise = np.minimum(plan.rise, _room_under_cloth(points, plan.faces, scene, HAIR_DEPTH[style]))
    return Shell(points + rise[:, None] * vertex_normals(points, plan.faces), plan.faces)


def eyeballs(body: Body) -> Eyes:
    """Balls in the eye sockets."""
    sockets = body_masks(body).sockets
    if not all(len(rows) for rows in sockets):
        return Eyes(np.zeros((0, 3)), np.zeros((0, 3), int), np.full((2, 3), 1e6), 1.0)
    # C-ordered rows: NumPy reduces them 5 times as fast as columns.
    points = [np.ascontiguousarray(body.vertices[rows].T) for rows in sockets]
    corners = [(socket.min(axis=1), socket.max(axis=1)) for socket in points]
    radius = float(np.mean([EYE_SIZE * (high[0] - low[0]) for low, high in corners]))
    centres = np.array(
        [
            [0.5 * (low[0] + high[0]), low[1] + EYE_LEVEL * (high[1] - low[1]), high[2] - EYE_DEPTH * radius]
            for low, high in corners
        ]
    )
    ball, faces = _ball()
    vertices = np.concatenate([centre + radius * ball for centre in centres])
    return Eyes(vertices, np.concatenate([faces, faces + len(ball)]), centres, radius)


def vertex_normals(vertices: Float[np.ndarray, "n 3"], faces: Int[np.ndarray, "m 3"]) -> Float[np.ndarray, "n 3"]:
    """Unit vertex normals: face normals weighted by area."""
    a, b, c = vertices.astype(float)[faces].transpose(1, 0, 2)
    normal = np.repeat(np.cross(b - a, c - a), 3, axis=0)
    corner = faces.ravel()
    total = np.stack([np.bincount(corner, normal[:, k], minlength=len(vertices)) for k in range(3)], axis=1)
    return total / np.maximum(np.linalg.norm(total, axis=1, keepdims=True), 1e-12)


@cache
def _model_body() -> Body:
    from gcd_dataset.generator.body import build_body, neutral_shape

    return build_body(neutral_shape())


@cache
def _model_masks() -> BodyMasks:
    return _masks_of(_model_body())


@cache
def _model_hair(style: HairStyle) -> _HairPlan:
    return _hair_plan(_model_body(), style)


def _hair_plan(body: Body, style: HairStyle) -> _HairPlan:
    depth, masks = HAIR_DEPTH[style], body_masks(body)
    field = masks.mane if style is HairStyle.FULL else masks.scalp
    kept = (field[body.faces] > 0.0).any(axis=1)
    if depth == 0.0 or not kept.any():
        return _HairPlan(np.zeros(0, int), np.zeros((0, 3), int), np.zeros(0))
    rows, faces = np.unique(body.faces[kept], return_inverse=True)
    # A quarter circle at the edge, as cut hair stands off the skin; outside, the shell dips under the skin.
    share = np.clip(field[rows] / (1.5 * depth), 0.0, 1.0)
    rise = np.where(field[rows] > 0.0, depth * np.sqrt(1.0 - (1.0 - share) ** 2), np.maximum(field[rows], -1.0))
    return _HairPlan(rows, faces.reshape(-1, 3), rise)


def _room_under_cloth(
    points: Float[np.ndarray, "h 3"], faces: Int[np.ndarray, "g 3"], scene: Scene, depth: float
) -> Float[np.ndarray, " h"]:
    """Greatest rise of each point of the scalp below the cloth [cm]; no more than that of its neighbours."""
    reach = depth + UNDER_CLOTH
    low, high = points.min(axis=0) - reach, points.max(axis=0) + reach
    above = scene.vertices[:, 1] > low[1]  # few faces are, so that the others need no further test
    faces_above = scene.faces.take(np.flatnonzero(above.take(scene.faces.T).any(axis=0)), axis=0)
    a, b, c = (scene.vertices.take(rows, axis=0) for rows in faces_above.T)
    highest, lowest = np.maximum(np.maximum(a, b), c), np.minimum(np.minimum(a, b), c)
    near = ((highest > low) & (lowest < high)).all(axis=1)
    if not near.any():
        return np.full(len(points), np.inf)
    # Queries are few: cells that are split at their middle make the tree in a third of a balanced one's time.
    tree = KDTree(_spread(a[near], b[near], c[near]), balanced_tree=False, compact_nodes=False)
    distance, _ = tree.query(points, distance_upper_bound=reach)
    # Between the points the shell is flat: no corner of a face rises above the room of another.
    room = np.maximum(distance - UNDER_CLOTH, -1.0)
    least = room.copy()
    np.minimum.at(least, faces, room[faces].min(axis=1, keepdims=True))
    return least


def _spread(
    a: Float[np.ndarray, "f 3"], b: Float[np.ndarray, "f 3"], c: Float[np.ndarray, "f 3"]
) -> Float[np.ndarray, "n 3"]:
    """Points on the triangles of corners a, b, c, ``SAMPLES`` apart or less along the edges."""
    longest = np.sqrt(max(float(((one - other) ** 2).sum(axis=1).max()) for one, other in ((a, b), (b, c), (c, a))))
    steps = max(1, int(np.ceil(longest / SAMPLES)))
    shares = [(i / steps, j / steps) for i in range(steps + 1) for j in range(steps + 1 - i)]
    return np.concatenate([i * a + j * b + (1.0 - i - j) * c for i, j in shares])


# In multiples of the eye socket's size on the body model, found by eye in close-ups.
EYE_SIZE, EYE_LEVEL, EYE_DEPTH = 0.42, 0.72, 1.2


def _masks_of(body: Body) -> BodyMasks:
    x, y, z = body.vertices.T.astype(float)
    height = float(y.max())
    trunk, head = body.parts == BodyPart.TRUNK.value, body.parts == BodyPart.HEAD.value
    inner = body.parts == BodyPart.INTERNAL.value
    legs = (body.parts == BodyPart.LEFT_LEG.value) | (body.parts == BodyPart.RIGHT_LEG.value)
    crotch = float(y[trunk].min()) if trunk.any() else 0.47 * height
    briefs = np.minimum(crotch + BRIEFS_HEIGHT * height - y, y - crotch + 1.0 - LEG_OPENING * (np.abs(x) - 4.0))
    low, high = TOP_HEIGHTS
    top = np.minimum(y - low * height, high * height - y)
    face = _Face(x, y, z, head, inner)
    return BodyMasks(
        briefs=np.where(trunk | legs, briefs, FAR),
        top=np.where(trunk, top, FAR),
        brows=face.brows(),
        lips=face.lips(),
        scalp=face.hairline(nape=0.72),
        mane=face.hairline(nape=0.90),
        sockets=(np.flatnonzero(face.socket & (x < 0)), np.flatnonzero(face.socket & (x > 0))),
    )


class _Face:
    """Places on a head that looks along z, by its eye sockets and mouth; a head without them has no face."""

    def __init__(self, x: np.ndarray, y: np.ndarray, z: np.ndarray, head: np.ndarray, inner: np.ndarray) -> None:
        self._x, self._y, self._z, self._head, self._inner = np.abs(x), y, z, head, inner
        self.socket, self._mouth = np.zeros(len(x), bool), np.zeros(len(x), bool)
        if head.any() and inner.any():
            crown, chin = float(y[head].max()), float(y[head].min())
            between = crown - 0.60 * (crown - chin)  # the mouth lies at 0.72 from the crown, the eyes at 0.48
            self.socket = inner & (y > between)
            self._mouth = inner & (y < between) & (z > z[inner].max() - 1.0)

    def brows(self) -> Float[np.ndarray, " v"]:
        """An arch above each eye."""
        if not self.socket.any():
            return np.full(len(self._x), FAR)
        top, middle = float(self._y[self.socket].max()), float(self._x[self.socket].mean())
        aside = self._x - middle
        arch = top + 1.05 - 0.10 * (aside - 0.3) ** 2
        field = np.minimum(0.34 - np.abs(self._y - arch), 2.0 - np.abs(aside))
        return np.where(self._head & (self._z > 6.0), field, FAR)

    def lips(self) -> Float[np.ndarray, " v"]:
        """An ellipse round the mouth."""
        field = np.full(len(self._x), FAR)
        if self._mouth.any():
            level, half = float(self._y[self._mouth].mean()), float(self._x[self._mouth].max())
            front = self._z > float(self._z[self._mouth].min()) - 1.0
            ellipse = 1.0 - (self._x / (1.1 * half)) ** 2 - ((self._y - level) / 0.95) ** 2
            field = np.where(self._head & front, ellipse, FAR)
        return np.where(self._inner, 2.0, field)

    def hairline(self, *, nape: float) -> Float[np.ndarray, " v"]:
        """Height above a plane from the forehead to the nape [cm]; the nape is ``nape`` heads below the crown."""
        x, y, z, head = self._x, self._y, self._z, self._head
        if not head.any():
            return np.full(len(y), FAR)
        crown, chin = float(y[head].max()), float(y[head].min())
        length, middle = crown - chin, 0.5 * float(z[head].min() + z[head].max())
        forehead, low = crown - 0.17 * length, crown - nape * length
        front = np.clip((z - middle) / (0.30 * length) + 0.45, 0.0, 1.0)
        field = y - low - (forehead - low) * front**0.8
        # Round the ear: outside the skull's half width, below the ear's upper end.
        skull = 0.82 * float(x[head].max())
        field = np.minimum(field, np.maximum(skull - x, y - (crown - 0.36 * length)))
        return np.where(head, field, FAR)


@cache
def _ball() -> tuple[Float[np.ndarray, "n 3"], Int[np.ndarray, "m 3"]]:
    """A unit ball of ``EYE_RINGS`` rings."""
    polar = np.pi * np.arange(1, EYE_RINGS) / EYE_RINGS
    angle = 2 * np.pi * np.arange(EYE_SECTORS) / EYE_SECTORS
    ring = np.sin(polar)[:, None]
    rows = np.stack([ring * np.sin(angle), np.cos(polar)[:, None] + 0 * angle, ring * np.cos(angle)], axis=-1)
    points = np.concatenate([[[0.0, 1.0, 0.0]], rows.reshape(-1, 3), [[0.0, -1.0, 0.0]]])
    last = len(points) - 1
    faces = []
    for k in range(EYE_SECTORS):
        after = (k + 1) % EYE_SECTORS
        faces.append((0, 1 + k, 1 + after))
        for ring_number in range(EYE_RINGS - 2):
            a, b = 1 + ring_number * EYE_SECTORS + k, 1 + ring_number * EYE_SECTORS + after
            faces += [(a, a + EYE_SECTORS, b), (b, a + EYE_SECTORS, b + EYE_SECTORS)]
        faces.append((last, last - EYE_SECTORS + after, last - EYE_SECTORS + k))
    return points, np.array(faces)
