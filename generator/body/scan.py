"""Prepares any mesh for measuring: welds coincident vertices, drops degenerate faces, patches holes."""

from dataclasses import dataclass
from typing import Self

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import connected_components
from scipy.spatial import ConvexHull, QhullError, cKDTree

from gcd_dataset.errors import BodyError
from gcd_dataset.generator.body.holes import Holes
from gcd_dataset.generator.body.surface import subdivide_long_edges
from gcd_dataset.records import Record

MIN_FACES = 500  # fewer give girths off by more than a centimetre: see the benchmark case `measures`
BODY_SHARE = 0.8  # share of the area above which the largest piece is taken for the body
OBJECT_SHARE = 0.02  # share of the area above which a convex piece, such as a floor or a box, is left out of that share
CONVEX = 0.02  # deepest vertex under the convex hull of a convex piece, as a fraction of its size; a body has over 0.05
HULL_POINTS = 2000  # vertices of a piece whose hull is computed
LONGEST_EDGE = 0.02  # fraction of the mesh's size; longer edges are halved: faces must be small against tape bands
FLAT = 1e-16  # double area of a degenerate face, as a fraction of the square of the mesh's size
WELD = 1e-5  # grid of coinciding positions, as a fraction of the mesh's size


@dataclass(frozen=True, eq=False)
class Scan(Record):
    """A closed skin made from any mesh, with its patches over holes marked."""

    vertices: Float[np.ndarray, "v 3"]
    """Centres of patches and midpoints of divided edges come last."""
    faces: Int[np.ndarray, "f 3"]
    patched: Bool[np.ndarray, " f"]
    """Whether each face is part of a patch."""
    source: Int[np.ndarray, " u"]
    """The vertex of the skin for each vertex of the input mesh."""
    loose: Bool[np.ndarray, " u"]
    """Whether each vertex of the input mesh belongs to a dropped piece, such as an eye."""
    outside: Bool[np.ndarray, " u"]
    """Whether it is unused, or belongs to a dropped piece beyond the body's bounding box, such as a floor."""
    holes: Float[np.ndarray, " h"]
    """Distance across each patched hole [unit of the input]."""
    mean_edge: float
    """Mean length of the input's edges [unit of the input]."""
    sagitta: float
    """Mean depth of the triangles under a smooth skin, from their dihedral angles [unit of the input]."""

    @classmethod
    def of(cls, vertices: Float[np.ndarray, "u 3"], faces: Int[np.ndarray, "g 3"], name: str) -> Self:
        """Weld and patch a mesh. Raises ``BodyError`` for invalid indices and positions, and too few faces."""
        if len(faces) and (faces.min() < 0 or faces.max() >= len(vertices)):
            odd = faces.min() if faces.min() < 0 else faces.max()
            raise BodyError(f"{name}: a face names vertex {odd} of {len(vertices)}: export the mesh again")
        used = np.unique(faces)
        if not np.isfinite(vertices[used]).all():
            bad = used[~np.isfinite(vertices[used]).all(axis=1)]
            raise BodyError(f"{name}: vertex {bad[0]} and {len(bad) - 1} more have positions that are not numbers")
        welded, source = _welded(vertices, used)
        faces = source[faces]
        faces = faces[_has_area(welded, faces)]
        if len(faces) < MIN_FACES:
            raise BodyError(
                f"{name}: {len(faces)} triangles with an area, a body needs at least {MIN_FACES}: give a finer mesh"
            )
        welded, faces, source, loose, beyond = _largest_piece(welded, faces, source)
        if not np.ptp(welded[np.unique(faces)], axis=0).all():
            raise BodyError(f"{name}: flat: give the closed skin of a body")
        unused = ~np.isin(np.arange(len(vertices)), used)
        holes = Holes.of(welded, faces)
        patched = np.concatenate([faces, holes.patches(len(welded))])
        longest = LONGEST_EDGE * float(np.ptp(welded, axis=0).max())
        fine, pieces, owners = subdivide_long_edges(np.concatenate([welded, holes.centres]), patched, longest)
        return cls(
            fine,
            pieces,
            owners >= len(faces),
            source,
            loose & ~unused,
            beyond | unused,
            holes.widths,
            *_coarseness(welded, faces, name),
        )


def coincident_vertices(vertices: Float[np.ndarray, "v 3"], used: Int[np.ndarray, " u"]) -> Int[np.ndarray, " v"]:
    """For each vertex the first used vertex at its position; unused vertices map to themselves."""
    size = WELD * max(float(np.ptp(vertices[used], axis=0).max(initial=0.0)), 1e-9)
    _, first, back = np.unique(np.round(vertices[used] / size), axis=0, return_index=True, return_inverse=True)
    same = np.arange(len(vertices))
    same[used] = used[first[back.ravel()]]
    return same


def kept_mesh(
    vertices: Float[np.ndarray, "v 3"], faces: Int[np.ndarray, "f 3"], kept: Bool[np.ndarray, " v"]
) -> tuple[Float[np.ndarray, "w 3"], Int[np.ndarray, "g 3"]]:
    """The mesh of some of the vertices, in their order."""
    return vertices[kept], (np.cumsum(kept) - 1)[faces[kept[faces].all(axis=1)]]


def _welded(vertices: np.ndarray, used: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Used vertices without duplicates, and for each input vertex its row in them; 0 for unused vertices."""
    same = coincident_vertices(vertices, used)
    distinct = np.unique(same[used])
    source = np.zeros(len(vertices), int)
    source[used] = np.searchsorted(distinct, same[used])
    return vertices[distinct], source


def _has_area(vertices: np.ndarray, faces: np.ndarray) -> Bool[np.ndarray, " f"]:
    a, b, c = vertices[faces].transpose(1, 0, 2)
    return np.linalg.norm(np.cross(b - a, c - a), axis=1) > FLAT * np.ptp(vertices, axis=0).max() ** 2


def _largest_piece(
    vertices: np.ndarray, faces: np.ndarray, source: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """The mesh without loose pieces (eyes, scraps, a floor); all of it if no piece is clearly the body.

    Returns vertices, faces, ``source`` with dropped vertices mapped to their nearest remaining one, and for each input
    vertex whether it was dropped, and whether its piece reaches beyond the bounding box of the rest.
    """
    ends = np.concatenate([faces[:, :2], faces[:, 1:]])
    graph = csr_matrix((np.ones(len(ends)), ends.T), shape=(len(vertices), len(vertices)))
    piece = connected_components(graph, directed=False)[1]
    a, b, c = vertices[faces].transpose(1, 0, 2)
    areas = np.bincount(piece[faces[:, 0]], np.linalg.norm(np.cross(b - a, c - a), axis=1), minlength=piece.max() + 1)
    for large in np.flatnonzero(areas > OBJECT_SHARE * areas.sum()):
        if is_convex(vertices[piece == large]):
            areas[large] = 0.0
    largest = int(areas.argmax())
    kept = (piece == largest) if areas[largest] > BODY_SHARE * areas.sum() else np.isin(piece, piece[faces[:, 0]])
    low, high = vertices[kept].min(axis=0), vertices[kept].max(axis=0)
    beyond = np.bincount(piece, ((vertices < low) | (vertices > high)).any(axis=1))[piece] > 0
    number = np.full(len(vertices), -1)
    number[kept] = np.arange(kept.sum())
    number[~kept] = cKDTree(vertices[kept]).query(vertices[~kept])[1]
    return vertices[kept], number[faces[kept[faces[:, 0]]]], number[source], ~kept[source], beyond[source]


def is_convex(points: Float[np.ndarray, "v 3"]) -> bool:
    """Whether the vertices of a piece lie about on their convex hull: a floor, a box, an eyeball, but no body."""
    points = points[:: 1 + len(points) // HULL_POINTS]
    try:
        hull = ConvexHull(points)
    except QhullError:  # flat
        return True
    depth = -(points @ hull.equations[:, :3].T + hull.equations[:, 3]).max(axis=1)
    return bool(depth.max() < CONVEX * np.ptp(points, axis=0).max())


def _coarseness(vertices: np.ndarray, faces: np.ndarray, name: str) -> tuple[float, float]:
    """Mean edge length, and area-weighted mean sagitta of the arcs through neighbouring triangles.

    Raises ``BodyError`` without neighbours.
    """
    import trimesh

    mesh = trimesh.Trimesh(vertices, faces, process=False)
    if not len(mesh.face_adjacency):
        raise BodyError(f"{name}: triangles that do not touch each other: give the closed skin of a body")
    ends = vertices[mesh.face_adjacency_edges]
    edges = np.linalg.norm(ends[:, 0] - ends[:, 1], axis=1)
    areas = mesh.area_faces[mesh.face_adjacency].sum(axis=1)
    turn = np.minimum(mesh.face_adjacency_angles, np.pi - mesh.face_adjacency_angles)  # windings may differ
    sagitta = areas / edges * turn / 8  # of an arc: chord · angle / 8, the chord being the triangles' mean height
    return float(edges.mean()), float(sagitta @ areas / areas.sum())
