"""Triangle meshes of garments as batches on a device: vertices one after the other, neighbours, geodesic clusters.

Nothing here depends on the order of vertices or faces, which in generated garments follows the pattern: seams come
first, then panel after panel. A mesh with shuffled vertices gets the same neighbours, clusters and normals, shuffled.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
from jaxtyping import Bool, Float, Int
from scipy.sparse import csr_array
from scipy.sparse.csgraph import dijkstra
from scipy.spatial import cKDTree
from torch import Tensor
from torch.nn import functional

from benchmarks.reconstruction.derived import CENTRE
from gcd_dataset.generator.render.figure import vertex_normals
from gcd_dataset.meshedges import mesh_edges

METRE = 100.0  # cm: unit of positions in networks
NEIGHBOURS = 10  # of a vertex, the nearest along edges; in a mesh of ours 6 on average
SHAPE = 6  # numbers of ``SurfaceArrays.shape``
MOST_YAW = 0.3  # rad, of the augmentation
MOST_GROWTH = 0.05  # share, of the augmentation
JITTER = 0.001  # metres, of the augmentation
JITTERED = 4096  # rows of jitter


@dataclass(frozen=True, eq=False)
class SurfaceArrays:
    """A mesh, prepared for a network."""

    positions: Float[np.ndarray, "v 3"]
    """Relative to ``CENTRE`` [m]."""
    normals: Float[np.ndarray, "v 3"]
    neighbours: Int[np.ndarray, "v k"]
    """Vertices along edges. The relation is symmetric; entries without a neighbour hold the vertex itself."""
    reverse: Int[np.ndarray, "v k"]
    """Row of the reverse edge in the flattened ``neighbours``; an entry without a neighbour is its own."""
    lengths: Float[np.ndarray, "v k"]
    """Lengths of the edges to the neighbours [m]; 0 where a neighbour is missing."""
    shape: Float[np.ndarray, "v 6"]
    """Number of neighbours over 6; shortest, mean and longest edge over the median edge of the mesh; angle defect
    [rad], 0 on the border; whether on the border."""
    clusters: Int[np.ndarray, " v"]
    """Cluster of each vertex: the centre nearest along edges."""


def surface_of(
    vertices: Float[np.ndarray, "v 3"],
    faces: Int[np.ndarray, "f 3"],
    *,
    clusters: int,
    lengths: Float[np.ndarray, "f 3"] | None = None,
) -> SurfaceArrays:
    """A mesh with ``vertices`` [cm], prepared. ``lengths``: of the edges after each corner of a face, if they are not
    the distances of ``vertices`` [cm].
    """
    place = np.asarray(vertices, np.float64)
    pairs, borders, edge_of_corner = _edges(faces)
    rest = np.linalg.norm(place[pairs[:, 0]] - place[pairs[:, 1]], axis=1)
    if lengths is not None:
        rest = np.bincount(edge_of_corner, lengths.ravel()) / np.bincount(edge_of_corner)
    table, reverse, along = _mutual(*_neighbours(pairs, rest + 1e-6, len(vertices)))
    on_border = np.zeros(len(vertices), bool)
    on_border[pairs[borders].ravel()] = True
    return SurfaceArrays(
        positions=((vertices - CENTRE) / METRE).astype(np.float32),
        normals=vertex_normals(vertices, faces).astype(np.float32),
        neighbours=table,
        reverse=reverse,
        lengths=along,
        shape=_shape(vertices, faces, pairs, on_border),
        clusters=_clusters(place, pairs, rest + 1e-6, clusters),
    )


def _edges(
    faces: Int[np.ndarray, "f 3"],
) -> tuple[Int[np.ndarray, "e 2"], Bool[np.ndarray, " e"], Int[np.ndarray, " c"]]:
    """The edges of the faces, whether each is of one face only, and the edge after each corner of each face."""
    edges = mesh_edges(faces)
    return edges.ends, edges.counts == 1, edges.of_faces.ravel()


def _shape(
    vertices: Float[np.ndarray, "v 3"],
    faces: Int[np.ndarray, "f 3"],
    pairs: Int[np.ndarray, "e 2"],
    on_border: Bool[np.ndarray, " v"],
) -> Float[np.ndarray, "v 6"]:
    count = len(vertices)
    ends, lengths = pairs.T.ravel(), np.linalg.norm(vertices[pairs[:, 0]] - vertices[pairs[:, 1]], axis=1)
    both = np.concatenate([lengths, lengths]) / max(float(np.median(lengths)), 1e-6)
    valence = np.bincount(ends, minlength=count)
    least, most = np.full(count, np.inf), np.zeros(count)
    np.minimum.at(least, ends, both)
    np.maximum.at(most, ends, both)
    mean = np.bincount(ends, both, count) / np.maximum(valence, 1)
    corner = np.asarray(vertices, np.float64)[faces]
    turned = np.zeros(count)
    for k in range(3):
        a, b = corner[:, (k + 1) % 3] - corner[:, k], corner[:, (k + 2) % 3] - corner[:, k]
        angles = np.arctan2(np.linalg.norm(np.cross(a, b), axis=1), (a * b).sum(axis=1))
        turned += np.bincount(faces[:, k], angles, count)
    defect = np.where(on_border, 0.0, 2 * np.pi - turned)
    columns = [valence / 6, np.where(valence > 0, least, 0), mean, most, defect, on_border]
    return np.clip(np.stack(columns, axis=1), -5, 5).astype(np.float32)


def _neighbours(
    pairs: Int[np.ndarray, "e 2"], lengths: Float[np.ndarray, " e"], count: int
) -> tuple[Int[np.ndarray, "v k"], Float[np.ndarray, "v k"]]:
    """The nearest ``NEIGHBOURS`` along edges, padded with the vertex itself, and the lengths of these edges [m]."""
    start = np.concatenate([pairs[:, 0], pairs[:, 1]])
    end = np.concatenate([pairs[:, 1], pairs[:, 0]])
    both = np.concatenate([lengths, lengths])
    order = np.lexsort((both, start))
    start, end, both = start[order], end[order], both[order]
    first = np.searchsorted(start, np.arange(count))
    rank = np.arange(len(start)) - first[start]
    table = np.repeat(np.arange(count)[:, None], NEIGHBOURS, axis=1)
    kept = rank < NEIGHBOURS
    table[start[kept], rank[kept]] = end[kept]
    along = np.zeros(table.shape, np.float32)
    along[start[kept], rank[kept]] = both[kept] / METRE
    return table, along


def _mutual(
    table: Int[np.ndarray, "v k"], lengths: Float[np.ndarray, "v k"]
) -> tuple[Int[np.ndarray, "v k"], Int[np.ndarray, "v k"], Float[np.ndarray, "v k"]]:
    """``SurfaceArrays.neighbours``, ``reverse`` and ``lengths``, with the edges that the table has both ways."""
    count, columns = table.shape
    own = np.arange(count)[:, None]
    entries = own * columns + np.arange(columns)
    there, back = own * count + table, table * count + own
    order = np.argsort(there, axis=None)
    ordered = there.ravel()[order]
    found = np.minimum(np.searchsorted(ordered, back), len(ordered) - 1)
    is_mutual = (ordered[found] == back) & (table != own)
    kept = np.where(is_mutual, table, own).astype(np.int32)
    reverse = np.where(is_mutual, order[found], entries).astype(np.int32)
    return kept, reverse, np.where(is_mutual, lengths, 0.0).astype(np.float32)


def _clusters(
    place: Float[np.ndarray, "v 3"], pairs: Int[np.ndarray, "e 2"], lengths: Float[np.ndarray, " e"], count: int
) -> Int[np.ndarray, " v"]:
    """The nearest of ``count`` centres along edges, for each vertex; centres are chosen farthest first."""
    graph = csr_array((lengths, (pairs[:, 0], pairs[:, 1])), shape=(len(place), len(place)))
    centres = farthest_points(place, min(count, len(place)))
    _, _, sources = dijkstra(graph, directed=False, indices=centres, min_only=True, return_predecessors=True)
    row = np.zeros(len(place), np.int64)
    row[centres] = np.arange(len(centres))
    lost = sources < 0  # in pieces without a centre
    found = row[np.where(lost, 0, sources)]
    if lost.any():
        found[lost] = cKDTree(place[centres]).query(place[lost])[1]
    return found.astype(np.int32)


def farthest_points(points: Float[np.ndarray, "n 3"], count: int) -> Int[np.ndarray, " k"]:
    """Rows of points, each the farthest from those before it; the first is the farthest from the mean."""
    chosen = np.empty(count, np.int64)
    chosen[0] = np.argmax(((points - points.mean(axis=0)) ** 2).sum(axis=1))
    nearest = ((points - points[chosen[0]]) ** 2).sum(axis=1)
    for k in range(1, count):
        chosen[k] = nearest.argmax()
        np.minimum(nearest, ((points - points[chosen[k]]) ** 2).sum(axis=1), out=nearest)
    return chosen


# ---------------------------------------------------------------------------------------------------------- the batches


@dataclass(frozen=True)
class SurfaceBatch:
    """The vertices of several garments, one garment after the other."""

    positions: Float[Tensor, "v 3"]
    normals: Float[Tensor, "v 3"]
    neighbours: Int[Tensor, "v k"]
    """Rows of the batch."""
    reverse: Int[Tensor, "v k"]
    """``SurfaceArrays.reverse``, for the table of the batch."""
    lengths: Float[Tensor, "v k"]
    """``SurfaceArrays.lengths``."""
    shape: Float[Tensor, "v 6"]
    """``SurfaceArrays.shape``."""
    clusters: Int[Tensor, " v"]
    """``garment * tokens + cluster``."""
    garments: Int[Tensor, " v"]
    slots: Int[Tensor, " v"]
    """Number of the vertex in its garment."""
    counts: Int[Tensor, " b"]
    """Vertices of each garment."""
    tokens: int
    """Clusters of a garment."""

    @property
    def size(self) -> int:
        """Garments."""
        return len(self.counts)

    def padded(self, values: Float[Tensor, "v *d"]) -> Float[Tensor, "b n *d"]:
        """Values of the vertices, one row for each garment, filled with 0."""
        room = values.new_zeros((self.size, int(self.counts.max()), *values.shape[1:]))
        return room.index_put((self.garments, self.slots), values)

    @property
    def exists(self) -> Bool[Tensor, "b n"]:
        """Mask of the entries of ``padded`` that are vertices."""
        numbers = torch.arange(int(self.counts.max()), device=self.counts.device)
        return numbers < self.counts[:, None]


class SurfaceStore:
    """Meshes on a device, from which batches are gathered."""

    def __init__(self, surfaces: Sequence[SurfaceArrays], *, tokens: int, device: torch.device) -> None:
        def joined(name: str, kind: torch.dtype) -> Tensor:
            rows = np.concatenate([getattr(surface, name) for surface in surfaces])
            return torch.from_numpy(rows).to(device=device, dtype=kind)

        lengths = torch.tensor([len(surface.positions) for surface in surfaces])
        self.starts = torch.cat([torch.zeros(1, dtype=torch.int64), lengths.cumsum(0)]).to(device)
        self.positions, self.normals = joined("positions", torch.float32), joined("normals", torch.float32)
        self.neighbours, self.clusters = joined("neighbours", torch.int32), joined("clusters", torch.int32)
        self.reverse = joined("reverse", torch.int32)
        self.shape, self.lengths = joined("shape", torch.float32), joined("lengths", torch.float32)
        self.tokens = tokens

    def __len__(self) -> int:
        return len(self.starts) - 1

    def batch(self, rows: Int[Tensor, " b"]) -> tuple[SurfaceBatch, Int[Tensor, " v"]]:
        """The meshes ``rows``, and the row of the store for each of their vertices."""
        chosen, garments, slots = packed_rows(self.starts, rows.to(self.starts.device))
        counts = torch.bincount(garments, minlength=len(rows))
        first = (counts.cumsum(0) - counts)[garments]
        return SurfaceBatch(
            positions=self.positions[chosen],
            normals=self.normals[chosen],
            neighbours=self.neighbours[chosen].long() + first[:, None],
            reverse=self.reverse[chosen].long() + first[:, None] * self.reverse.shape[1],
            lengths=self.lengths[chosen],
            shape=self.shape[chosen],
            clusters=self.clusters[chosen].long() + garments * self.tokens,
            garments=garments,
            slots=slots,
            counts=counts,
            tokens=self.tokens,
        ), chosen


def packed_rows(
    starts: Int[Tensor, "g+1"], rows: Int[Tensor, " b"]
) -> tuple[Int[Tensor, " n"], Int[Tensor, " n"], Int[Tensor, " n"]]:
    """The entries of the ragged arrays ``rows``: row of the store, number of the array in ``rows``, and in the array.

    >>> [column.tolist() for column in packed_rows(torch.tensor([0, 2, 5]), torch.tensor([1, 0]))]
    [[2, 3, 4, 0, 1], [0, 0, 0, 1, 1], [0, 1, 2, 0, 1]]
    """
    counts = starts[rows + 1] - starts[rows]
    owners = torch.arange(len(rows), device=rows.device).repeat_interleave(counts)
    numbers = torch.arange(len(owners), device=rows.device) - (counts.cumsum(0) - counts)[owners]
    return starts[rows][owners] + numbers, owners, numbers


# ----------------------------------------------------------------------------------------------------- the augmentation


@dataclass(frozen=True)
class Turn:
    """Turns about the vertical, mirror images and growth, one for each garment of a batch, and jitter."""

    matrices: Float[Tensor, "b 3 3"]
    """Orthogonal, times the growth."""
    mirrored: Bool[Tensor, " b"]
    jitter: Float[Tensor, "n 3"]
    """Jitter of vertex k: row k modulo n [m]."""

    def of(self, batch: SurfaceBatch) -> SurfaceBatch:
        """The batch, moved."""
        matrices = self.matrices[batch.garments]
        positions = (matrices @ batch.positions[..., None])[..., 0] + self.jitter[batch.slots % len(self.jitter)]
        normals = functional.normalize((matrices @ batch.normals[..., None])[..., 0], dim=-1)
        return replace(batch, positions=positions, normals=normals)


def drawn_turn(
    rows: Int[Tensor, " b"],
    count: int,
    chance: torch.Generator,
    device: torch.device,
    *,
    growth: float = MOST_GROWTH,
    jitter: float = JITTER,
) -> Turn:
    """A turn for each garment ``rows`` of ``count``: yaw, growth, and for every second a mirror image.

    ``growth``: largest share; ``jitter``: standard deviation [m]. A garment's turn does not
    depend on the others in the batch.
    """
    draws = torch.rand(count, 3, generator=chance)[rows].T
    yaw, mirror = (2 * draws[0] - 1) * MOST_YAW, torch.where(draws[1] < 0.5, -1.0, 1.0)
    scale = 1 + growth * (2 * draws[2] - 1)
    zero, one = torch.zeros_like(yaw), torch.ones_like(yaw)
    columns = [yaw.cos() * mirror, zero, yaw.sin(), zero, one, zero, -yaw.sin() * mirror, zero, yaw.cos()]
    matrices = torch.stack(columns, dim=1).reshape(-1, 3, 3) * scale[:, None, None]
    return Turn(
        matrices.to(device),
        (draws[1] < 0.5).to(device),
        (jitter * torch.randn(JITTERED, 3, generator=chance)).to(device),
    )
