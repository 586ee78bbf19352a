"""The figure without clothes: masks for underwear, lips and eyes on the body, and a shell of hair over the scalp."""

from dataclasses import dataclass
from functools import cache

import numpy as np
from jaxtyping import Float, Int

from gcd_dataset.generator.render.scene import HairStyle
from gcd_dataset.records import Body, BodyPart, Record

__all__ = ["BodyMasks", "HairShell", "body_masks", "hair_shell"]

BRIEFS_HEIGHT = 0.115  # of the figure's height, from the crotch to the top of the briefs
TOP_HEIGHTS = (0.655, 0.775)  # of the figure's height: lower and upper end of the top; the bust is at 0.72
LEG_OPENING = 0.55  # slope of the leg openings
HAIR_DEPTH = {HairStyle.NONE: 0.0, HairStyle.CROPPED: 0.7, HairStyle.SHORT: 1.8, HairStyle.FULL: 3.0}  # cm


@dataclass(frozen=True, eq=False)
class BodyMasks(Record):
    """Signed fields on the body's vertices, positive inside: their zero lines are smooth between the vertices."""

    briefs: Float[np.ndarray, " v"]
    """[cm]"""
    top: Float[np.ndarray, " v"]
    """[cm]"""
    scalp: Float[np.ndarray, " v"]
    """[cm]; 0 and below: no hair."""
    inner: Float[np.ndarray, " v"]
    """1 on eyes and mouth."""


@dataclass(frozen=True, eq=False)
class HairShell(Record):
    """A mesh over the scalp; empty without hair."""

    vertices: Float[np.ndarray, "h 3"]
    faces: Int[np.ndarray, "g 3"]


def body_masks(body: Body) -> BodyMasks:
    """The masks of a body; those of the body model are found once, on the neutral body, and kept by vertex."""
    if len(body.parts) == _model_vertices():
        return _model_masks()
    return _masks_of(body)


def hair_shell(body: Body, style: HairStyle) -> HairShell:
    """The scalp moved outwards by the depth of the hair, thinner towards its edge."""
    depth = HAIR_DEPTH[style]
    scalp = body_masks(body).scalp
    kept = (scalp[body.faces] > 0.0).all(axis=1)
    if depth == 0.0 or not kept.any():
        return HairShell(np.zeros((0, 3)), np.zeros((0, 3), int))
    rows, faces = np.unique(body.faces[kept], return_inverse=True)
    faces = faces.reshape(-1, 3)
    normals = _vertex_normals(body.vertices[rows], faces)
    # A quarter circle at the edge, as cut hair stands off the skin.
    share = np.clip(scalp[rows] / (1.5 * depth), 0.0, 1.0)
    rise = depth * np.sqrt(1.0 - (1.0 - share) ** 2) + 0.05
    return HairShell(body.vertices[rows] + rise[:, None] * normals, faces)


# ------------------------------------------------------------------------------------------------------------- helpers


@cache
def _model_vertices() -> int:
    from gcd_dataset.generator.body.asset import body_model

    return len(body_model().parts)


@cache
def _model_masks() -> BodyMasks:
    from gcd_dataset.generator.body import build_body, neutral_shape

    return _masks_of(build_body(neutral_shape()))


def _masks_of(body: Body) -> BodyMasks:
    x, y, z = body.vertices.T.astype(float)
    height = float(y.max())
    trunk, head = body.parts == BodyPart.TRUNK.value, body.parts == BodyPart.HEAD.value
    legs = (body.parts == BodyPart.LEFT_LEG.value) | (body.parts == BodyPart.RIGHT_LEG.value)
    crotch = float(y[trunk].min()) if trunk.any() else 0.47 * height
    briefs = np.minimum(crotch + BRIEFS_HEIGHT * height - y, y - crotch + 1.0 - LEG_OPENING * (np.abs(x) - 4.0))
    low, high = TOP_HEIGHTS
    top = np.minimum(y - low * height, high * height - y)
    far = -10.0
    inner = np.where(body.parts == BodyPart.INTERNAL.value, 1.0, 0.0)
    return BodyMasks(
        briefs=np.where(trunk | legs, briefs, far),
        top=np.where(trunk, top, far),
        scalp=np.where(head, _scalp(x, y, z, head), far),
        inner=inner,
    )


def _scalp(x: np.ndarray, y: np.ndarray, z: np.ndarray, head: np.ndarray) -> Float[np.ndarray, " v"]:
    """Height above a plane from the hairline over the ears to the nape [cm]."""
    if not head.any():
        return np.full(len(y), -10.0)
    crown, chin = float(y[head].max()), float(y[head].min())
    length = crown - chin
    middle = 0.5 * float(z[head].min() + z[head].max())
    # The face reaches up to 0.83 of the head in front; the nape is at a quarter of it.
    forehead, nape = crown - 0.17 * length, crown - 0.72 * length
    front = np.clip((z - middle) / (0.30 * length) + 0.45, 0.0, 1.0)
    line = nape + (forehead - nape) * front**0.8
    return np.asarray(y - line)


def _vertex_normals(points: Float[np.ndarray, "h 3"], faces: Int[np.ndarray, "g 3"]) -> Float[np.ndarray, "h 3"]:
    a, b, c = (points[faces[:, k]] for k in range(3))
    flat = np.cross(b - a, c - a)
    total = np.zeros_like(points)
    for k in range(3):
        for axis in range(3):
            total[:, axis] += np.bincount(faces[:, k], flat[:, axis], minlength=len(points))
    return total / np.maximum(np.linalg.norm(total, axis=1, keepdims=True), 1e-12)
