"""What a box mesh's triangles say about its edges and hinges: lengths, stiffness shares and bending weights.

Everything is taken from the flat corner coordinates of the faces, so it does not matter where the panels stand.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int
from scipy import sparse

from gcd_dataset.records import BoxMesh

__all__ = ["Topology", "build_topology"]

LARGEST_BEND_WEIGHT = 8.0  # about two corners of 14°: hinges of sharper slivers bend more easily than they should


@dataclass(frozen=True)
class Topology:
    """A box mesh seen by its edges; ``e`` counts edges, each with the one or two faces on its sides."""

    edges: Int[np.ndarray, "e 2"]
    opposite: Int[np.ndarray, "e 2"]
    """The vertex across from the edge in its first and second face; -1 for no second face."""
    edge_face: Int[np.ndarray, " e"]
    """The first face of each edge."""
    face_edges: Int[np.ndarray, "f 3"]
    """Edges (0, 1), (1, 2), (2, 0) of each face."""
    flat_length: Float[np.ndarray, " e"]
    """Length in the flat [cm]; where a gathered seam joins two lengths, the shorter."""
    start_length: Float[np.ndarray, " e"]
    """Length before sewing [cm]."""
    spread: Float[np.ndarray, " e"]
    """Area over squared length, summed over the faces of each edge [1]."""
    area: Float[np.ndarray, " v"]
    """A third of the area of the faces round each vertex [cm²]."""
    bending: sparse.csr_array
    """Quadratic bending energy as a (v, v) matrix: ``E = rigidity / 2 xᵀ Q x`` [1/cm²]."""


def build_topology(mesh: BoxMesh) -> Topology:
    """Edges, hinges and flat shape of a box mesh."""
    n = len(mesh.vertices)
    flat = mesh.uv[mesh.corners].astype(float)
    sides = np.roll(flat, -1, axis=1) - flat
    lengths = np.linalg.norm(sides, axis=2)
    areas = 0.5 * np.abs(sides[:, 0, 0] * sides[:, 1, 1] - sides[:, 0, 1] * sides[:, 1, 0])
    edges, face_edges = _number_edges(mesh.faces, n)
    count = len(edges)
    flat_length = np.full(count, np.inf)
    np.minimum.at(flat_length, face_edges.ravel(), lengths.ravel())
    spread = np.bincount(face_edges.ravel(), (areas[:, None] / lengths**2).ravel(), minlength=count)
    opposite, edge_face, corner_of = _sides_of_edges(mesh.faces, face_edges, count)
    return Topology(
        edges=edges,
        opposite=opposite,
        edge_face=edge_face,
        face_edges=face_edges,
        flat_length=flat_length,
        start_length=np.linalg.norm(mesh.vertices[edges[:, 1]] - mesh.vertices[edges[:, 0]], axis=1),
        spread=spread,
        area=np.bincount(mesh.faces.ravel(), np.repeat(areas / 3, 3), minlength=n),
        bending=_bending_matrix(mesh.faces, edges, opposite, corner_of, _cotangents(flat), areas, n),
    )


def _number_edges(faces: Int[np.ndarray, "f 3"], n: int) -> tuple[Int[np.ndarray, "e 2"], Int[np.ndarray, "f 3"]]:
    ends = np.stack([faces, np.roll(faces, -1, axis=1)], axis=-1).astype(np.int64)
    keys = ends.min(axis=-1) * n + ends.max(axis=-1)
    unique, inverse = np.unique(keys.ravel(), return_inverse=True)
    return np.stack([unique // n, unique % n], axis=1), inverse.reshape(-1, 3)


def _sides_of_edges(
    faces: Int[np.ndarray, "f 3"], face_edges: Int[np.ndarray, "f 3"], count: int
) -> tuple[Int[np.ndarray, "e 2"], Int[np.ndarray, " e"], Int[np.ndarray, "e 2"]]:
    """Opposite vertices, first face, and (first, second) flat index ``3 face + corner`` of every edge's sides.

    Where more than two panels meet along an edge, the first two faces make the hinge.
    """
    order = np.argsort(face_edges.ravel(), kind="stable")
    edge_of = face_edges.ravel()[order]
    rank = np.arange(len(order)) - np.searchsorted(edge_of, edge_of)
    sides = np.full((count, 2), -1)
    for side in (0, 1):
        sides[edge_of[rank == side], side] = order[rank == side]
    across = np.roll(faces, -2, axis=1).ravel()
    opposite = np.where(sides >= 0, across[sides], -1)
    return opposite, sides[:, 0] // 3, sides


def _cotangents(flat: Float[np.ndarray, "f 3 2"]) -> Float[np.ndarray, "f 3"]:
    """Cotangent of the angle at each corner."""
    out = np.roll(flat, -1, axis=1) - flat
    back = np.roll(flat, 1, axis=1) - flat
    dot = (out * back).sum(axis=2)
    cross = np.abs(out[..., 0] * back[..., 1] - out[..., 1] * back[..., 0])
    return dot / np.maximum(cross, 1e-12)


def _bending_matrix(
    faces: Int[np.ndarray, "f 3"],
    edges: Int[np.ndarray, "e 2"],
    opposite: Int[np.ndarray, "e 2"],
    sides: Int[np.ndarray, "e 2"],
    cotangents: Float[np.ndarray, "f 3"],
    areas: Float[np.ndarray, " f"],
    n: int,
) -> sparse.csr_array:
    """Bergou et al., A Quadratic Bending Model for Inextensible Surfaces (2006): 3 / (A0 + A1) KᵀK over hinges."""
    hinges = np.flatnonzero(opposite[:, 1] >= 0)
    at_ends = np.zeros((len(hinges), 2))
    across = np.zeros((len(hinges), 2))
    hinge_area = np.zeros(len(hinges))
    for side in (0, 1):
        face, corner = np.divmod(sides[hinges, side], 3)
        here, there = cotangents[face, corner], cotangents[face, (corner + 1) % 3]
        across[:, side] = -(here + there)
        starts_low = faces[face, corner] == edges[hinges, 0]
        at_ends[:, 0] += np.where(starts_low, there, here)
        at_ends[:, 1] += np.where(starts_low, here, there)
        hinge_area += areas[face]
    rows = np.repeat(np.arange(len(hinges)), 4)
    columns = np.concatenate([edges[hinges], opposite[hinges]], axis=1).ravel()
    values = np.concatenate([at_ends, across], axis=1).ravel()
    steepest = np.abs(np.concatenate([at_ends, across], axis=1)).max(axis=1)
    softer = np.minimum(LARGEST_BEND_WEIGHT / np.maximum(steepest, 1e-12), 1.0)
    K = sparse.csr_array((values, (rows, columns)), shape=(len(hinges), n))
    Q = sparse.csr_array(K.T @ sparse.diags_array(3.0 * softer**2 / hinge_area) @ K)
    Q.sum_duplicates()
    return Q
