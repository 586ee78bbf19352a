"""Bodies of ours that come as those of other body models do: their mesh, pose, origin, axes, unit, eyes and mouth.

SMPL (6,890 vertices, closed mouth, T-pose, metres, origin at the pelvis) and SMPL-X (10,475 vertices, an open mouth,
two eyeballs of their own) may not be shipped; these have what makes them hard to measure.
"""

from dataclasses import replace

import numpy as np
import trimesh
from scipy.sparse import csr_matrix

from gcd_dataset.generator.body import build_body
from gcd_dataset.generator.body.holes import VisibleSkin
from gcd_dataset.generator.body.pose import T_POSE
from gcd_dataset.generator.body.surface import SkinSurface
from gcd_dataset.records import BodyPart, BodyShape

__all__ = ["SMPLX_VERTICES", "SMPL_VERTICES", "coarser", "like_smpl", "like_smplx"]

SMPL_VERTICES = 6890
SMPLX_VERTICES = 10475
EYE = 642  # vertices of an eyeball; of SMPL-X 546
ALIKE = 0.25  # cm by which edges differ that may go in any order: many in one round
PELVIS = 0.53  # of the height

_Mesh = tuple[np.ndarray, np.ndarray]  # vertices, faces


def like_smpl(shape: BodyShape, *, arm: float = T_POSE) -> _Mesh:
    """A body [m] as SMPL gives it: one closed skin, y up, facing +z, the origin at the pelvis."""
    body = build_body(replace(shape, arm_angle=arm))
    skin = VisibleSkin.of(body.faces, body.parts)
    return _from_pelvis(coarser(skin.points(body.vertices), skin.faces, SMPL_VERTICES))


def like_smplx(shape: BodyShape, *, arm: float = T_POSE) -> _Mesh:
    """A body [m] as SMPL-X gives it: the mouth open to a cavity, eyeballs as pieces of their own."""
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
    """The mesh with its shortest edges drawn together until ``count`` vertices are left, all on the surface.

    An edge goes where its ends share two neighbours and no more, so a closed skin stays one (Dey et al., 1999); in each
    round those that are the shortest far and wide.
    """
    surface = SkinSurface.of(vertices, faces)
    while len(vertices) > count:
        going = _shortest_around(vertices, faces)[: len(vertices) - count]
        points, target = vertices.copy(), np.arange(len(vertices))
        points[going[:, 0]] = vertices[going].mean(axis=1)
        target[going[:, 1]] = going[:, 0]
        # Edges whose going would turn a face over stay; they are far apart, so each face tells of one.
        turned = np.unique(faces[_turned(vertices, points[target], faces, target)])
        going = going[~np.isin(going, turned).any(axis=1)]
        if not len(going):
            break
        target = np.arange(len(vertices))
        target[going[:, 1]] = going[:, 0]
        vertices = vertices.copy()
        vertices[going[:, 0]] = surface.nearest(vertices[going].mean(axis=1)).points
        faces = target[faces]
        faces = faces[(faces != np.roll(faces, 1, axis=1)).all(axis=1)]
        used, renumbered = np.unique(faces, return_inverse=True)
        vertices, faces = vertices[used], renumbered.reshape(-1, 3)
    return vertices, faces


def _shortest_around(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Edges that may go and are shorter than all others near their ends, the shortest first."""
    sides = np.sort(np.concatenate([faces[:, :2], faces[:, 1:], faces[:, ::2]]), axis=1)
    edges = np.unique(sides, axis=0)
    size = len(vertices)
    graph = csr_matrix((np.ones(len(edges)), edges.T), shape=(size, size))
    graph = graph + graph.T
    common = np.asarray(graph[edges[:, 0]].multiply(graph[edges[:, 1]]).sum(axis=1)).ravel()
    edges = np.random.default_rng(0).permutation(edges[common == 2])
    length = np.linalg.norm(vertices[edges[:, 0]] - vertices[edges[:, 1]], axis=1)
    edges = edges[np.argsort(np.round(length / ALIKE), kind="stable")]
    rank = np.arange(len(edges), dtype=float)
    least = np.full(size, np.inf)
    for end in edges.T:
        np.minimum.at(least, end, rank)
    first, second = graph.nonzero()
    wider = least.copy()
    np.minimum.at(wider, first, least[second])
    return edges[(wider[edges] == rank[:, None]).all(axis=1)]


def _turned(before: np.ndarray, after: np.ndarray, faces: np.ndarray, target: np.ndarray) -> np.ndarray:
    """Whether each face that stays looks the other way afterwards."""
    normals = [np.cross(p[faces[:, 1]] - p[faces[:, 0]], p[faces[:, 2]] - p[faces[:, 0]]) for p in (before, after)]
    moved = target[faces]
    stays = (moved != np.roll(moved, 1, axis=1)).all(axis=1)
    return stays & (np.einsum("fi,fi->f", *normals) <= 0)
