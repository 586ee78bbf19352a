"""Stand-ins for other body models: our bodies with their vertex count, pose, origin, axes, unit, eyes and mouth.

SMPL (6,890 vertices, closed mouth, T-pose, metres, origin at the pelvis) and SMPL-X (10,475 vertices, open mouth, two
separate eyeballs) may not be redistributed; the stand-ins have the properties that make them hard to measure.
"""

from dataclasses import replace

import numpy as np
import trimesh
from scipy.sparse import csr_matrix

from gcd_dataset.generator.body import build_body
from gcd_dataset.generator.body.repair import VisibleSkin
from gcd_dataset.generator.body.shape import T_POSE
from gcd_dataset.generator.body.surface import SkinSurface
from gcd_dataset.meshedges import mesh_edges
from gcd_dataset.records import BodyPart, BodyShape

SMPL_VERTICES = 6890
SMPLX_VERTICES = 10475
EYE = 642  # vertices of an eyeball; SMPL-X has 546
BIN = 0.25  # cm: edges within a bin collapse in random order, so that many collapse per round
PELVIS = 0.53  # height of the pelvis over the height of the body

_Mesh = tuple[np.ndarray, np.ndarray]  # vertices, faces


def like_smpl(shape: BodyShape, *, arm: float = T_POSE) -> _Mesh:
    """A body in SMPL's form [m]: one closed skin, y up, facing +z, origin at the pelvis."""
    body = build_body(replace(shape, arm_angle=arm))
    skin = VisibleSkin.of(body.faces, body.parts)
    return _from_pelvis(coarser(skin.points(body.vertices), skin.faces, SMPL_VERTICES))


def like_smplx(shape: BodyShape, *, arm: float = T_POSE) -> _Mesh:
    """A body in SMPL-X's form [m]: the mouth open to a cavity, eyeballs as separate components."""
    body = build_body(replace(shape, arm_angle=arm))
    sockets = (body.parts == BodyPart.INTERNAL.value) & (body.vertices[:, 1] > 0.92 * body.vertices[:, 1].max())
    parts = np.where(sockets, BodyPart.INTERNAL.value, BodyPart.HEAD.value).astype(np.uint8)
    seen = VisibleSkin.of(body.faces, parts)
    skin = coarser(seen.points(body.vertices), seen.faces, SMPLX_VERTICES - 2 * EYE)
    eyes = [_eye(body.vertices[sockets & (side * body.vertices[:, 0] > 0)]) for side in (1, -1)]
    both = trimesh.util.concatenate([trimesh.Trimesh(*skin, process=False), *eyes])
    return _from_pelvis((np.asarray(both.vertices), np.asarray(both.faces)))


def _eye(socket: np.ndarray) -> trimesh.Trimesh:
    ball = trimesh.creation.icosphere(subdivisions=3, radius=1.2)
    ball.apply_translation(socket.mean(axis=0))
    return ball


def _from_pelvis(mesh: _Mesh) -> _Mesh:
    vertices, faces = mesh
    return (vertices - [0.0, PELVIS * vertices[:, 1].max(), 0.0]) / 100.0, faces


def coarser(vertices: np.ndarray, faces: np.ndarray, count: int) -> _Mesh:
    """The mesh simplified to ``count`` vertices on its surface, by collapsing the shortest edges.

    An edge may collapse if its ends share exactly two neighbours, which keeps the topology (Dey et al., 1999); each
    round collapses the locally shortest edges.
    """
    surface = SkinSurface.of(vertices, faces)
    while len(vertices) > count:
        collapsing = _shortest_around(vertices, faces)[: len(vertices) - count]
        moved, target = vertices.copy(), np.arange(len(vertices))
        moved[collapsing[:, 0]] = vertices[collapsing].mean(axis=1)
        target[collapsing[:, 1]] = collapsing[:, 0]
        # Keep edges whose collapse would flip a face; collapsing edges are far apart, so one edge flips a face.
        flipped = np.unique(faces[_flipped(vertices, moved[target], faces, target)])
        collapsing = collapsing[~np.isin(collapsing, flipped).any(axis=1)]
        if not len(collapsing):
            break
        target = np.arange(len(vertices))
        target[collapsing[:, 1]] = collapsing[:, 0]
        vertices = vertices.copy()
        vertices[collapsing[:, 0]] = surface.nearest(vertices[collapsing].mean(axis=1)).points
        faces = target[faces]
        faces = faces[(faces != np.roll(faces, 1, axis=1)).all(axis=1)]
        used, renumbered = np.unique(faces, return_inverse=True)
        vertices, faces = vertices[used], renumbered.reshape(-1, 3)
    return vertices, faces


def _shortest_around(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Collapsible edges that are shorter than all others near their ends, shortest first."""
    edges = mesh_edges(faces).ends
    size = len(vertices)
    graph = csr_matrix((np.ones(len(edges)), edges.T), shape=(size, size))
    graph = graph + graph.T
    common = np.asarray(graph[edges[:, 0]].multiply(graph[edges[:, 1]]).sum(axis=1)).ravel()
    edges = np.random.default_rng(0).permutation(edges[common == 2])
    length = np.linalg.norm(vertices[edges[:, 0]] - vertices[edges[:, 1]], axis=1)
    edges = edges[np.argsort(np.round(length / BIN), kind="stable")]
    rank = np.arange(len(edges), dtype=float)
    least = np.full(size, np.inf)
    for end in edges.T:
        np.minimum.at(least, end, rank)
    first, second = graph.nonzero()
    wider = least.copy()
    np.minimum.at(wider, first, least[second])
    return edges[(wider[edges] == rank[:, None]).all(axis=1)]


def _flipped(before: np.ndarray, after: np.ndarray, faces: np.ndarray, target: np.ndarray) -> np.ndarray:
    """Whether each remaining face is flipped by a collapse."""
    normals = [np.cross(p[faces[:, 1]] - p[faces[:, 0]], p[faces[:, 2]] - p[faces[:, 0]]) for p in (before, after)]
    moved = target[faces]
    stays = (moved != np.roll(moved, 1, axis=1)).all(axis=1)
    return stays & (np.einsum("fi,fi->f", *normals) <= 0)
