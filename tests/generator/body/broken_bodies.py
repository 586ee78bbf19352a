"""Damaged body meshes, each with the measures of the intact body where they are still defined."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import trimesh
from scipy.spatial.transform import Rotation

from gcd_dataset.generator.body import build_body, draw_shape, measure
from gcd_dataset.records import Body, BodyPart, Measurements

SMOOTHING = 10 * (0.5, -0.53)
"""Smoothing steps of alternating sign, which remove the steps between cells without shrinking (Taubin, 1995)."""


@dataclass(frozen=True)
class BrokenBody:
    """A damaged OBJ file, and the true measures of the body in it."""

    kind: str
    content: bytes
    truth: Measurements | None
    """``None`` if the damaged mesh has no defined measures."""

    def write(self, folder: Path) -> Path:
        """Write the OBJ file. Returns its path."""
        path = folder / f"{self.kind}.obj"
        path.write_bytes(self.content)
        return path


_Mesh = tuple[np.ndarray, np.ndarray]  # vertices [cm], faces
_Damage = Callable[[Body, np.random.Generator], tuple[_Mesh, Body | None]]


def _changed(change: Callable[[Body, np.random.Generator], _Mesh], *, known: bool = True) -> _Damage:
    """Damage that leaves the body's measures as they are, or, unless ``known``, undefined."""
    return lambda body, rng: (change(body, rng), body if known else None)


def broken_body(kind: str, rng: np.random.Generator) -> BrokenBody:
    """Draw a body and damage it; ``kind``: a key of ``KINDS``."""
    body = build_body(draw_shape(rng, group="pooled"))
    # With faces in another order the mesh is not recognised as ours, so landmarks must be found.
    body = replace(body, faces=np.roll(body.faces, 1, axis=0))
    (vertices, faces), true_body = KINDS[kind](body, rng)
    content = (
        b""
        if kind == "empty file"
        else trimesh.Trimesh(vertices, faces, process=False).export(file_type="obj").encode()
    )
    truth = None if true_body is None else measure(replace(true_body, faces=np.roll(true_body.faces, -1, axis=0)))
    return BrokenBody(kind, content, truth)


def _without_faces(body: Body, gone: np.ndarray) -> _Mesh:
    """The body without the faces that have a vertex of ``gone``."""
    return body.vertices, body.faces[~gone[body.faces].any(axis=1)]


def _some_flipped(body: Body, rng: np.random.Generator) -> _Mesh:
    flipped = rng.random(len(body.faces)) < rng.uniform(0.01, 0.5)
    return body.vertices, np.where(flipped[:, None], body.faces[:, ::-1], body.faces)


def _not_a_number(body: Body, rng: np.random.Generator) -> _Mesh:
    vertices = body.vertices.copy()
    vertices[rng.integers(len(vertices), size=rng.integers(1, 50))] = np.nan
    return vertices, body.faces


def _turned(*degrees: float) -> _Damage:
    turn = Rotation.from_rotvec(np.radians(degrees)).as_matrix()
    return _changed(lambda body, rng: (body.vertices @ turn.T, body.faces))


def _stretched(factors: Callable[[np.random.Generator], np.ndarray]) -> _Damage:
    """A body of other size, whose measures are its own."""

    def damage(body: Body, rng: np.random.Generator) -> tuple[_Mesh, Body]:
        other = replace(body, vertices=body.vertices * factors(rng))
        return (other.vertices, other.faces), other

    return damage


def _joined(*meshes: _Mesh) -> _Mesh:
    offsets = np.cumsum([0, *(len(vertices) for vertices, _ in meshes)])
    faces = [faces + offset for (_, faces), offset in zip(meshes, offsets, strict=False)]
    return np.concatenate([vertices for vertices, _ in meshes]), np.concatenate(faces)


def _mesh_of(shape: trimesh.Trimesh) -> _Mesh:
    return np.asarray(shape.vertices, float), np.asarray(shape.faces, int)


def _floor(body: Body, rng: np.random.Generator) -> _Mesh:
    floor = trimesh.creation.box((rng.uniform(60, 200), 2.0, rng.uniform(60, 200)))
    floor.apply_translation([0.0, -1.0, 0.0])
    return _joined((body.vertices, body.faces), _mesh_of(floor))


def _without(*parts: BodyPart) -> _Damage:
    values = [part.value for part in parts]
    return _changed(lambda body, rng: _without_faces(body, np.isin(body.parts, values)))


def _twelve_vertices(body: Body, rng: np.random.Generator) -> _Mesh:
    vertices, faces = _mesh_of(trimesh.creation.icosahedron())
    return vertices * [20.0, 85.0, 12.0], faces


def _arms_down(body: Body, rng: np.random.Generator) -> _Mesh:
    shape = replace(draw_shape(rng, group="pooled"), arm_angle=-np.radians(rng.uniform(32, 42)))
    return fused_by_scanner(build_body(shape), rng.uniform(1.2, 2.0))


def fused_by_scanner(body: Body, cell: float) -> _Mesh:
    """The body as scanned by depth fusion: the surface of the cells of ``cell`` cm that it fills or touches.

    Surface nets (Gibson, 1998), one vertex per cell corner; parts that touch fuse together.
    """
    grown = trimesh.Trimesh(body.vertices, body.faces, process=False).voxelized(cell).fill()
    solid, low = np.pad(grown.matrix, 1), grown.translation - 1.5 * cell
    quads = []
    for axis in range(3):
        beyond = np.roll(solid, -1, axis=axis)
        for inside, flip in ((solid & ~beyond, False), (~solid & beyond, True)):
            at = np.argwhere(inside)
            u, v = np.eye(3, dtype=int)[(axis + 1) % 3], np.eye(3, dtype=int)[(axis + 2) % 3]
            base = at + np.eye(3, dtype=int)[axis]
            quad = np.stack([base, base + u, base + u + v, base + v], axis=1)
            quads.append(quad[:, ::-1] if flip else quad)
    keys, index = np.unique(np.concatenate(quads).reshape(-1, 3), axis=0, return_inverse=True)
    faces4 = index.reshape(-1, 4)
    corners = low + keys * cell
    for share in SMOOTHING:
        corners = _smoothed(corners, faces4, share)
    return corners, np.concatenate([faces4[:, [0, 1, 2]], faces4[:, [0, 2, 3]]])


def _smoothed(corners: np.ndarray, quads: np.ndarray, share: float) -> np.ndarray:
    sides = np.stack([quads, np.roll(quads, -1, axis=1)], axis=-1).reshape(-1, 2)
    ends = np.concatenate([sides, sides[:, ::-1]])
    count = np.bincount(ends[:, 0], minlength=len(corners))[:, None]
    mean = np.stack([np.bincount(ends[:, 0], corners[ends[:, 1], i], len(corners)) for i in range(3)], axis=1) / count
    return corners + share * (mean - corners)


KINDS: Mapping[str, _Damage] = {
    "pinholes": _changed(lambda body, rng: (body.vertices, body.faces[rng.random(len(body.faces)) > 0.01])),
    "some faces flipped": _changed(_some_flipped),
    "not a number": _changed(_not_a_number, known=False),
    "collapsed": _changed(lambda body, rng: (body.vertices * [0.0, 1.0, 0.0], body.faces), known=False),
    "facing away": _turned(0, 180, 0),
    "squashed": _stretched(lambda rng: np.exp(rng.uniform(-0.5, 0.5, size=3))),
    "on a floor": _changed(_floor),
    "no hands": _without(BodyPart.HANDS),
    "twelve vertices": _changed(_twelve_vertices, known=False),
    "arms grown to the trunk": _changed(_arms_down, known=False),
    "empty file": _changed(lambda body, rng: (body.vertices, body.faces)),
}
"""Kind of damage to the function that applies it."""
