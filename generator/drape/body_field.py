"""A body as the drape sees it: a signed-distance field with the nearest body part, and the skin itself."""

import hashlib
from collections import OrderedDict
from dataclasses import dataclass

import numpy as np
import warp as wp

from gcd_dataset.generator.drape.kernels.field import fill_field
from gcd_dataset.records import Body

__all__ = ["BodyField", "body_field"]

CELL = 1.0  # cm; the field's error is about cell² / (8 × radius): 0.04 cm on a wrist
BAND = 4.0  # cm outside the skin in which distances are exact
KEPT = 8  # fields kept for bodies that are dressed again

_kept: OrderedDict[tuple[str, bytes], "BodyField"] = OrderedDict()


@dataclass(frozen=True)
class BodyField:
    """Signed distances round one body, on a device."""

    distance: wp.array
    """(x, y, z) signed distance of the voxels' centres [cm], positive outside."""
    part: wp.array
    """(x, y, z) ``BodyPart`` value of the nearest skin."""
    origin: tuple[float, float, float]
    """Centre of the first voxel [cm]."""
    cell: float
    mesh: wp.Mesh
    """The skin, in cm."""


def body_field(body: Body, device: str) -> BodyField:
    """The field of a body on a device; made once for each body and kept while it is in use."""
    digest = hashlib.sha256(np.ascontiguousarray(body.vertices, np.float32).tobytes())
    digest.update(np.ascontiguousarray(body.faces, np.int32).tobytes())
    digest.update(body.parts.tobytes())
    key = (device, digest.digest())
    if key not in _kept:
        _kept[key] = _make_field(body, device)
        if len(_kept) > KEPT:
            _kept.popitem(last=False)
    _kept.move_to_end(key)
    return _kept[key]


def _make_field(body: Body, device: str) -> BodyField:
    low = body.vertices.min(axis=0) - BAND - CELL
    size = np.ceil((body.vertices.max(axis=0) + BAND + CELL - low) / CELL).astype(int) + 1
    mesh = wp.Mesh(
        points=wp.array(np.asarray(body.vertices, np.float32), dtype=wp.vec3, device=device),
        indices=wp.array(np.asarray(body.faces, np.int32).ravel(), dtype=int, device=device),
    )
    shape = tuple(int(n) for n in size)
    distance = wp.empty(shape, dtype=float, device=device)
    part = wp.zeros(shape, dtype=wp.uint8, device=device)
    wp.launch(
        fill_field,
        dim=shape,
        inputs=[mesh.id, wp.array(_face_parts(body), dtype=wp.uint8, device=device), wp.vec3(*low), CELL, BAND],
        outputs=[distance, part],
        device=device,
    )
    return BodyField(distance, part, (float(low[0]), float(low[1]), float(low[2])), CELL, mesh)


def _face_parts(body: Body) -> np.ndarray:
    """The part of each face: what two of its corners say, else what the first says."""
    a, b, c = body.parts[body.faces].T
    return np.where(b == c, b, a).astype(np.uint8)
