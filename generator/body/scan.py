"""A mesh as it comes, made measurable: seams between equal positions welded, slivers dropped, holes patched."""

from dataclasses import dataclass
from typing import Self

import numpy as np
import trimesh
from jaxtyping import Bool, Float, Int
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from gcd_dataset.errors import BodyError
from gcd_dataset.generator.body.holes import Holes
from gcd_dataset.generator.body.surface import subdivide_long_edges
from gcd_dataset.records import Record

__all__ = ["Scan", "coincident_vertices"]

FEWEST_FACES = 500  # with fewer a body's girths are off by more than a centimetre: see the case `measures`
BODY_SHARE = 0.8  # of all area: the least by which the largest piece is taken for the body
LONGEST = 0.02  # of the mesh's size: longer edges are halved, so that a tape's band has triangles that lie in it whole
WELD = 1e-5  # of the mesh's size: positions nearer than this are one


@dataclass(frozen=True, eq=False)
class Scan(Record):
    """Triangles of one closed skin, and what of them is patches over holes."""

    vertices: Float[np.ndarray, "v 3"]
    """[cm]; the middles of patches and of divided edges come last."""
    faces: Int[np.ndarray, "f 3"]
    patched: Bool[np.ndarray, " f"]
    """Faces that are patches."""
    source: Int[np.ndarray, " u"]
    """The vertex here of each vertex of the mesh as it came."""
    loose: Bool[np.ndarray, " u"]
    """Vertices of the mesh as it came that are of pieces left out: eyes, scraps."""
    holes: Float[np.ndarray, " h"]
    """Distance across each hole that is patched [cm of the mesh as it came]."""
    edge: float
    """Mean length of an edge [cm of the mesh as it came]."""
    sagitta: float
    """How far triangles lie under a smooth skin on average, as their neighbours are turned [cm, likewise]."""

    @classmethod
    def of(cls, vertices: Float[np.ndarray, "u 3"], faces: Int[np.ndarray, "g 3"], name: str) -> Self:
        """The mesh, welded and patched. Raises ``BodyError`` where it can be no body."""
        if len(faces) and (faces.min() < 0 or faces.max() >= len(vertices)):
            raise BodyError(f"{name}: a face names vertex {faces.max()} of {len(vertices)}: export the mesh again")
        used = np.unique(faces)
        if not np.isfinite(vertices[used]).all():
            bad = used[~np.isfinite(vertices[used]).all(axis=1)]
            raise BodyError(f"{name}: vertex {bad[0]} and {len(bad) - 1} more have positions that are no numbers")
        welded, source = _welded(vertices, used)
        faces = source[faces]
        faces = faces[_solid(welded, faces)]
        if len(faces) < FEWEST_FACES:
            raise BodyError(
                f"{name}: {len(faces)} triangles with an area, a body has {FEWEST_FACES} and more: give a finer mesh"
            )
        welded, faces, source, loose = _largest_piece(welded, faces, source)
        holes = Holes.of(welded, faces)
        patched = np.concatenate([faces, holes.patches(len(welded))])
        longest = LONGEST * float(np.ptp(welded, axis=0).max())
        fine, pieces, owners = subdivide_long_edges(np.concatenate([welded, holes.middles]), patched, longest)
        return cls(
            fine,
            pieces,
            owners >= len(faces),
            source,
            loose & np.isin(np.arange(len(vertices)), used),
            holes.widths,
            *_coarseness(welded, faces),
        )


def coincident_vertices(vertices: Float[np.ndarray, "v 3"], used: Int[np.ndarray, " u"]) -> Int[np.ndarray, " v"]:
    """For each vertex the first of those used at its place; unused ones stay by themselves."""
    size = WELD * max(float(np.ptp(vertices[used], axis=0).max(initial=0.0)), 1e-9)
    _, first, back = np.unique(np.round(vertices[used] / size), axis=0, return_index=True, return_inverse=True)
    same = np.arange(len(vertices))
    same[used] = used[first[back.ravel()]]
    return same


def _welded(vertices: np.ndarray, used: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Used vertices without doubles, and which of them each vertex is; unused ones are the first."""
    same = coincident_vertices(vertices, used)
    kept = np.unique(same[used])
    source = np.zeros(len(vertices), int)
    source[used] = np.searchsorted(kept, same[used])
    return vertices[kept], source


def _solid(vertices: np.ndarray, faces: np.ndarray) -> Bool[np.ndarray, " f"]:
    """Whether each face has an area."""
    a, b, c = vertices[faces].transpose(1, 0, 2)
    return np.linalg.norm(np.cross(b - a, c - a), axis=1) > 1e-12


def _largest_piece(
    vertices: np.ndarray, faces: np.ndarray, source: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """The mesh without its loose pieces (eyes, scraps); all of it, where no piece is clearly the body.

    What came from a vertex that is gone is its nearest one. With it comes whether it is gone.
    """
    ends = np.concatenate([faces[:, :2], faces[:, 1:]])
    graph = csr_matrix((np.ones(len(ends)), ends.T), shape=(len(vertices), len(vertices)))
    piece = connected_components(graph, directed=False)[1]
    a, b, c = vertices[faces].transpose(1, 0, 2)
    areas = np.bincount(piece[faces[:, 0]], np.linalg.norm(np.cross(b - a, c - a), axis=1), minlength=piece.max() + 1)
    largest = int(areas.argmax())
    own = (piece == largest) if areas[largest] > BODY_SHARE * areas.sum() else np.isin(piece, piece[faces[:, 0]])
    number = np.full(len(vertices), -1)
    number[own] = np.arange(own.sum())
    number[~own] = cKDTree(vertices[own]).query(vertices[~own])[1]
    return vertices[own], number[faces[own[faces[:, 0]]]], number[source], ~own[source]


def _coarseness(vertices: np.ndarray, faces: np.ndarray) -> tuple[float, float]:
    """Mean edge, and mean sagitta of arcs laid through neighbouring triangles, weighed by their areas."""
    mesh = trimesh.Trimesh(vertices, faces, process=False)
    ends = vertices[mesh.face_adjacency_edges]
    edges = np.linalg.norm(ends[:, 0] - ends[:, 1], axis=1)
    areas = mesh.area_faces[mesh.face_adjacency].sum(axis=1)
    turn = np.minimum(mesh.face_adjacency_angles, np.pi - mesh.face_adjacency_angles)  # faces may look either way
    sagitta = areas / edges * turn / 8  # the triangles' mean height, an eighth of the turn: an arc over a chord
    return float(edges.mean()), float(sagitta @ areas / areas.sum())
