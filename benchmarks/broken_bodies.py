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
    content = obj_bytes(vertices, faces)
    if kind == "truncated file":
        content = content[: int(rng.uniform(0.0, 0.95) * len(content))]
    if kind == "empty file":
        content = b""
    truth = None if true_body is None else measure(replace(true_body, faces=np.roll(true_body.faces, -1, axis=0)))
    return BrokenBody(kind, content, truth)


def obj_bytes(vertices: np.ndarray, faces: np.ndarray) -> bytes:
    """Encode a mesh as an OBJ file; row numbers in ``faces`` start at 0."""
    lines = ["v %.9g %.9g %.9g" % tuple(v) for v in vertices] + ["f %d %d %d" % tuple(f) for f in faces + 1]  # noqa: UP031
    return ("\n".join(lines) + "\n").encode()


# ---------------------------------------------------------------------------------------------------------------- skin


def _without_faces(body: Body, gone: np.ndarray) -> _Mesh:
    """The body without the faces that have a vertex of ``gone``."""
    return body.vertices, body.faces[~gone[body.faces].any(axis=1)]


def _hole(low: float, high: float) -> _Damage:
    def hole(body: Body, rng: np.random.Generator) -> _Mesh:
        middle = body.vertices[rng.integers(len(body.vertices))]
        return _without_faces(body, np.linalg.norm(body.vertices - middle, axis=1) < rng.uniform(low, high))

    return _changed(hole)


def _some_flipped(body: Body, rng: np.random.Generator) -> _Mesh:
    flipped = rng.random(len(body.faces)) < rng.uniform(0.01, 0.5)
    return body.vertices, np.where(flipped[:, None], body.faces[:, ::-1], body.faces)


def _renumbered(body: Body, rng: np.random.Generator) -> _Mesh:
    order = rng.permutation(len(body.vertices))
    return body.vertices[order], np.argsort(order)[body.faces]


def _not_finite(value: float) -> _Damage:
    def damage(body: Body, rng: np.random.Generator) -> _Mesh:
        vertices = body.vertices.copy()
        vertices[rng.integers(len(vertices), size=rng.integers(1, 50))] = value
        return vertices, body.faces

    return _changed(damage, known=False)


def _out_of_range(body: Body, rng: np.random.Generator) -> _Mesh:
    faces = body.faces.copy()
    faces[rng.integers(len(faces))] = len(body.vertices) + 7
    return body.vertices, faces


def _spike(body: Body, rng: np.random.Generator) -> _Mesh:
    vertices = body.vertices.copy()
    vertices[rng.integers(len(vertices))] += rng.uniform(30, 200) * rng.choice([-1, 1]) * np.eye(3)[rng.integers(3)]
    return vertices, body.faces


# ----------------------------------------------------------------------------------------------------- units and turns


def _scaled(factor: float, *, known: bool = True) -> _Damage:
    return _changed(lambda body, rng: (body.vertices * factor, body.faces), known=known)


def _turned(*degrees: float) -> _Damage:
    turn = Rotation.from_rotvec(np.radians(degrees)).as_matrix()
    return _changed(lambda body, rng: (body.vertices @ turn.T, body.faces))


def _stretched(factors: Callable[[np.random.Generator], np.ndarray]) -> _Damage:
    """A body of other size, whose measures are its own."""

    def damage(body: Body, rng: np.random.Generator) -> tuple[_Mesh, Body]:
        other = replace(body, vertices=body.vertices * factors(rng))
        return (other.vertices, other.faces), other

    return damage


# ------------------------------------------------------------------------------------------------- too much, too little


def _joined(*meshes: _Mesh) -> _Mesh:
    offsets = np.cumsum([0, *(len(vertices) for vertices, _ in meshes)])
    faces = [faces + offset for (_, faces), offset in zip(meshes, offsets, strict=False)]
    return np.concatenate([vertices for vertices, _ in meshes]), np.concatenate(faces)


def _mesh_of(shape: trimesh.Trimesh) -> _Mesh:
    return np.asarray(shape.vertices, float), np.asarray(shape.faces, int)


def _two_bodies(body: Body, rng: np.random.Generator) -> _Mesh:
    beside = body.vertices + [rng.choice([-1, 1]) * rng.uniform(20, 90), 0.0, rng.uniform(-20, 20)]
    return _joined((body.vertices, body.faces), (beside, body.faces))


def _floor(body: Body, rng: np.random.Generator) -> _Mesh:
    floor = trimesh.creation.box((rng.uniform(60, 200), 2.0, rng.uniform(60, 200)))
    floor.apply_translation([0.0, -1.0, 0.0])
    return _joined((body.vertices, body.faces), _mesh_of(floor))


def _scrap(body: Body, rng: np.random.Generator) -> _Mesh:
    ball = trimesh.creation.icosphere(subdivisions=2, radius=rng.uniform(0.5, 12.0))
    ball.apply_translation(rng.uniform([-60, 5, -40], [60, 190, 40]))
    return _joined((body.vertices, body.faces), _mesh_of(ball))


def _without(*parts: BodyPart) -> _Damage:
    values = [part.value for part in parts]
    return _changed(lambda body, rng: _without_faces(body, np.isin(body.parts, values)))


def _upper_half(body: Body, rng: np.random.Generator) -> _Mesh:
    height = body.vertices[:, 1]
    return _without_faces(body, height < rng.uniform(0.2, 0.6) * np.ptp(height))


def _twelve_vertices(body: Body, rng: np.random.Generator) -> _Mesh:
    vertices, faces = _mesh_of(trimesh.creation.icosahedron())
    return vertices * [20.0, 85.0, 12.0], faces


def _no_body(body: Body, rng: np.random.Generator) -> _Mesh:
    shapes = (
        trimesh.creation.icosphere(subdivisions=4, radius=85.0),
        trimesh.creation.box((50.0, 170.0, 30.0)).subdivide().subdivide().subdivide().subdivide(),
        trimesh.creation.cylinder(20.0, 170.0, sections=1000),
        trimesh.creation.torus(60.0, 20.0),
    )
    return _mesh_of(shapes[rng.integers(len(shapes))])


# ------------------------------------------------------------------------------------------------------ grown together


def _arms_down(body: Body, rng: np.random.Generator) -> _Mesh:
    shape = replace(draw_shape(rng, group="pooled"), arm_angle=-np.radians(rng.uniform(32, 42)))
    return fused_by_scanner(build_body(shape), rng.uniform(1.2, 2.0))


def fused_by_scanner(body: Body, cell: float) -> _Mesh:
    """The body as scanned by depth fusion: the surface of filled cells of ``cell`` cm, one vertex per cell corner.

    Surface nets (Gibson, 1998); parts that touch fuse together.
    """
    low = body.vertices.min(axis=0) - 2 * cell
    shape = np.ceil((body.vertices.max(axis=0) + 2 * cell - low) / cell).astype(int)
    solid = _filled(body, low, shape, cell)
    quads, corners = [], np.full(tuple(shape + 1), -1)
    for axis in range(3):
        beyond = np.roll(solid, -1, axis=axis)
        for inside, flip in ((solid & ~beyond, False), (~solid & beyond, True)):
            at = np.argwhere(inside)
            u, v = np.eye(3, dtype=int)[(axis + 1) % 3], np.eye(3, dtype=int)[(axis + 2) % 3]
            base = at + np.eye(3, dtype=int)[axis]
            quad = np.stack([base, base + u, base + u + v, base + v], axis=1)
            quads.append(quad[:, ::-1] if flip else quad)
    grid = np.concatenate(quads)
    keys, index = np.unique(grid.reshape(-1, 3), axis=0, return_inverse=True)
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


def _filled(body: Body, low: np.ndarray, shape: np.ndarray, cell: float) -> np.ndarray:
    """Mark the cells inside the body: a ray from the centre leaves more faces than it enters."""
    corners = body.vertices[body.faces]
    depth = np.zeros(tuple(shape), int)
    nx, _, nz = shape
    a, b, c = corners[:, 0], corners[:, 1], corners[:, 2]
    for x in range(nx):
        px = low[0] + (x + 0.5) * cell
        near = (corners[:, :, 0].min(axis=1) <= px) & (corners[:, :, 0].max(axis=1) > px)
        for i in np.flatnonzero(near):
            y0, y1 = corners[i, :, 1].min(), corners[i, :, 1].max()
            rows = np.arange(
                max(int(np.ceil((y0 - low[1]) / cell - 0.5)), 0), int(np.floor((y1 - low[1]) / cell - 0.5)) + 1
            )
            if not len(rows):
                continue
            py = low[1] + (rows + 0.5) * cell
            d = (b[i, 0] - a[i, 0]) * (c[i, 1] - a[i, 1]) - (c[i, 0] - a[i, 0]) * (b[i, 1] - a[i, 1])
            if d == 0:
                continue
            s = ((px - a[i, 0]) * (c[i, 1] - a[i, 1]) - (c[i, 0] - a[i, 0]) * (py - a[i, 1])) / d
            t = ((b[i, 0] - a[i, 0]) * (py - a[i, 1]) - (px - a[i, 0]) * (b[i, 1] - a[i, 1])) / d
            hit = (s >= 0) & (t > 0) & (s + t <= 1)
            z = a[i, 2] + s * (b[i, 2] - a[i, 2]) + t * (c[i, 2] - a[i, 2])
            for row, height in zip(rows[hit], z[hit], strict=True):
                first = int(np.clip(np.ceil((height - low[2]) / cell - 0.5), 0, nz))
                depth[x, row, first:] += -1 if d > 0 else 1
    return depth > 0


KINDS: Mapping[str, _Damage] = {
    "whole": _changed(lambda body, rng: (body.vertices, body.faces)),
    "pinholes": _changed(lambda body, rng: (body.vertices, body.faces[rng.random(len(body.faces)) > 0.01])),
    "small hole": _hole(1.0, 3.0),
    "large hole": _hole(4.0, 15.0),
    "some faces flipped": _changed(_some_flipped),
    "faces inward": _changed(lambda body, rng: (body.vertices, body.faces[:, ::-1])),
    "unwelded": _changed(
        lambda body, rng: (body.vertices[body.faces].reshape(-1, 3), np.arange(body.faces.size).reshape(-1, 3))
    ),
    "renumbered": _changed(_renumbered),
    "noisy": _changed(lambda body, rng: (body.vertices + rng.normal(0.0, 0.05, body.vertices.shape), body.faces)),
    "not a number": _not_finite(np.nan),
    "infinite": _not_finite(np.inf),
    "face out of range": _changed(_out_of_range, known=False),
    "collapsed": _changed(lambda body, rng: (body.vertices * [0.0, 1.0, 0.0], body.faces), known=False),
    "spike": _changed(_spike),
    "metres": _scaled(0.01),
    "millimetres": _scaled(10.0),
    "inches": _scaled(1 / 2.54, known=False),
    "kilometres": _scaled(1e-5, known=False),
    "on its back": _turned(-90, 0, 0),
    "on its face": _turned(90, 0, 0),
    "on its side": _turned(0, 0, 90),
    "upside down": _turned(0, 0, 180),
    "facing away": _turned(0, 180, 0),
    "facing aside": _turned(0, 90, 0),
    "skewed": lambda body, rng: _turned(*rng.uniform(-25, 25, size=3))(body, rng),
    "moved": _changed(lambda body, rng: (body.vertices + rng.uniform(-500, 500, size=3), body.faces)),
    "larger": _stretched(lambda rng: rng.choice([0.6, 0.8, 1.1, 1.4])),
    "squashed": _stretched(lambda rng: np.exp(rng.uniform(-0.5, 0.5, size=3))),
    "two bodies": _changed(_two_bodies),
    "on a floor": _changed(_floor),
    "with a scrap": _changed(_scrap),
    "no head": _without(BodyPart.HEAD, BodyPart.INTERNAL),
    "no arm": _without(BodyPart.RIGHT_ARM),
    "no leg": _without(BodyPart.LEFT_LEG),
    "no hands": _without(BodyPart.HANDS),
    "no feet": _without(BodyPart.FEET),
    "upper half": _changed(_upper_half),
    "twelve vertices": _changed(_twelve_vertices, known=False),
    "no body": _changed(_no_body, known=False),
    "arms grown to the trunk": _changed(_arms_down, known=False),
    "fused": _changed(lambda body, rng: fused_by_scanner(body, rng.uniform(0.6, 0.8))),
    "empty file": _changed(lambda body, rng: (body.vertices, body.faces)),
    "truncated file": _hole(0.0, 0.0),
}
"""Kind of damage to the function that applies it."""
