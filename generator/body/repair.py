"""Repairs meshes of bodies: welds, closes holes, orients faces, and removes folds and self-intersections.

``BodyScan`` is any mesh prepared for measuring, ``ClosedSkin`` one prepared for cloth; ``SkinMesh`` removes folds from
drawn bodies.

A body far from the mean may have inverted patches of skin: a nipple pushed in, the fold between the thighs, an armpit
under a lowered arm. Such patches, whose normals oppose those of the mean body, are smoothed until the normals agree.
Creases whose sides intersect, as beside the crotch, are smoothed until the sides are apart. Other bodies are unchanged.
"""

from dataclasses import dataclass
from typing import NamedTuple, Self

import numpy as np
from jaxtyping import Bool, Float, Int, UInt8
from scipy.sparse import coo_matrix, csr_matrix, diags_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import ConvexHull, QhullError, cKDTree
from scipy.spatial.distance import pdist

from gcd_dataset.errors import BodyError
from gcd_dataset.generator.body.surface import subdivide_long_edges
from gcd_dataset.meshedges import mesh_edges
from gcd_dataset.records import BodyPart, Record

MAX_PAIRWISE = 2000  # points of a rim; with more, its width is the diagonal of its bounding box


@dataclass(frozen=True, eq=False)
class Holes(Record):
    """The holes of a mesh, each closed by a fan of triangles."""

    rims: Int[np.ndarray, "r 2"]
    """Boundary edges, directed as in their face."""
    hole_of_rim: Int[np.ndarray, " r"]
    """The hole of each boundary edge."""
    centres: Float[np.ndarray, "h 3"]
    """Mean of each rim's vertices [cm]."""
    widths: Float[np.ndarray, " h"]
    """Largest distance across each hole [cm]."""

    @classmethod
    def of(cls, vertices: Float[np.ndarray, "v 3"], faces: Int[np.ndarray, "f 3"]) -> "Holes":
        """The holes of a mesh, one for each connected rim."""
        edges, uses = half_edges_of(faces)
        rims = edges[uses == 1]
        if not len(rims):
            return cls(rims, np.empty(0, int), np.empty((0, 3)), np.empty(0))
        corners, ends = np.unique(rims, return_inverse=True)
        ends = ends.reshape(-1, 2)
        graph = csr_matrix((np.ones(len(ends)), ends.T), shape=(len(corners), len(corners)))
        count, hole = connected_components(graph, directed=False)
        points = [vertices[corners[hole == number]] for number in range(count)]
        centres = np.stack([each.mean(axis=0) for each in points])
        return cls(rims, hole[ends[:, 0]], centres, np.array([_width(each) for each in points]))

    def patches(self, first: int) -> Int[np.ndarray, "r 3"]:
        """Triangles from the rims to the centres, numbered from ``first`` on; wound like the adjacent faces."""
        return np.concatenate([self.rims[:, ::-1], first + self.hole_of_rim[:, None]], axis=1)


@dataclass(frozen=True, eq=False)
class VisibleSkin(Record):
    """The visible skin of bodies with the same faces: internal parts removed, and their openings closed."""

    faces: Int[np.ndarray, "g 3"]
    """Triangles of the body's vertices, then patches, which also use the centres of the openings."""
    parts: UInt8[np.ndarray, " g"]
    """``BodyPart`` of each face."""
    rims: tuple[Int[np.ndarray, " r"], ...]
    """The vertices on the rim of each opening."""

    @classmethod
    def of(cls, faces: Int[np.ndarray, "f 3"], parts: UInt8[np.ndarray, " v"]) -> "VisibleSkin":
        """The visible skin of a mesh with the ``BodyPart`` of each vertex."""
        skin = faces[~(parts == BodyPart.INTERNAL.value)[faces].any(axis=1)]
        openings = Holes.of(np.zeros((len(parts), 3)), skin)
        whole = np.concatenate([skin, openings.patches(len(parts))])
        # A face takes the part of at least two of its corners; for a patch these are corners on the rim.
        a, b, c = np.concatenate([parts, np.full(len(openings.centres), BodyPart.HEAD.value)])[whole].T
        rims = tuple(np.unique(openings.rims[openings.hole_of_rim == hole]) for hole in range(len(openings.centres)))
        return cls(whole, np.where(b == c, b, a).astype(np.uint8), rims)

    def points(self, vertices: Float[np.ndarray, "v 3"]) -> Float[np.ndarray, "w 3"]:
        """The vertices that ``faces`` refer to: a body's, then the centres of its openings [cm]."""
        return np.concatenate([vertices, *(vertices[rim].mean(axis=0, keepdims=True) for rim in self.rims)])


def half_edges_of(faces: Int[np.ndarray, "f 3"]) -> tuple[Int[np.ndarray, "s 2"], Int[np.ndarray, " s"]]:
    """The three directed edges of each face (s = 3 f), and the number of faces on each, in either direction."""
    edges = np.stack([faces, np.roll(faces, -1, axis=1)], axis=-1).reshape(-1, 2)
    _, of_faces, uses = mesh_edges(faces)
    return edges, uses[of_faces.ravel()]


def _width(points: np.ndarray) -> float:
    if len(points) > MAX_PAIRWISE:
        return float(np.linalg.norm(np.ptp(points, axis=0)))
    return float(pdist(points).max(initial=0.0))


MIN_FACES = 500  # fewer give girths off by more than a centimetre: see the benchmark case `measures`
BODY_SHARE = 0.8  # share of the area above which the largest piece is taken for the body
OBJECT_SHARE = 0.02  # share of the area above which a convex piece, such as a floor or a box, is left out of that share
CONVEX = 0.02  # deepest vertex under the convex hull of a convex piece, as a fraction of its size; a body has over 0.05
HULL_POINTS = 2000  # vertices of a piece whose hull is computed
LONGEST_EDGE = 0.02  # fraction of the mesh's size; longer edges are halved: faces must be small against tape bands
FLAT = 1e-16  # double area of a degenerate face, as a fraction of the square of the mesh's size
WELD = 1e-5  # grid of coinciding positions, as a fraction of the mesh's size


@dataclass(frozen=True, eq=False)
class BodyScan(Record):
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
        same = coincident_vertices(vertices, used)
        distinct, source = np.unique(same[used]), np.zeros(len(vertices), int)
        welded, source[used] = vertices[distinct], np.searchsorted(distinct, same[used])
        faces = source[faces]
        a, b, c = welded[faces].transpose(1, 0, 2)
        least = FLAT * np.ptp(welded, axis=0).max() ** 2
        faces = faces[np.linalg.norm(np.cross(b - a, c - a), axis=1) > least]
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


def _largest_piece(
    vertices: np.ndarray, faces: np.ndarray, source: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """The mesh without loose pieces (eyes, scraps, a floor); all of it if no piece is clearly the body.

    Returns vertices, faces, ``source`` with dropped vertices mapped to their nearest remaining one, and for each input
    vertex whether it was dropped, and whether its piece reaches beyond the bounding box of the rest.
    """
    piece = pieces_of(faces, len(vertices))
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


WIDEST_HOLE = 10.0  # cm across; a flat patch over it lies up to 1.3 cm below the skin of a limb of 10 cm radius


@dataclass(frozen=True, eq=False)
class ClosedSkin(Record):
    """A body's mesh without holes, counter-clockwise from outside; internal pieces (loose eyes) are unchanged."""

    vertices: Float[np.ndarray, "v 3"]
    """The input vertices, then the centre of each patch [cm]."""
    faces: Int[np.ndarray, "f 3"]
    parts: UInt8[np.ndarray, " v"]
    hole_widths: Float[np.ndarray, " h"]
    """Distance across each closed hole [cm]."""
    flipped: bool
    """Whether any face was flipped."""

    @classmethod
    def of(
        cls,
        vertices: Float[np.ndarray, "u 3"],
        faces: Int[np.ndarray, "g 3"],
        parts: UInt8[np.ndarray, " u"],
        name: str,
    ) -> Self:
        """Close a mesh [cm]. Raises ``BodyError`` for a hole wider than ``WIDEST_HOLE`` or a skin without an inside."""
        piece, internal = pieces_of(faces, len(parts)), np.ones(len(parts), bool)
        np.logical_and.at(internal, piece[faces], (parts == BodyPart.INTERNAL.value)[faces])
        internal = internal[piece[faces[:, 0]]]  # faces of pieces with internal vertices only, such as a loose eye
        skin = _welded_rims(vertices, faces[~internal])
        consistent = _consistently_wound(skin, name)
        holes = Holes.of(vertices, consistent)
        if holes.widths.max(initial=0.0) > WIDEST_HOLE:
            widest = int(holes.widths.argmax())
            x, y, z = holes.centres[widest]
            raise BodyError(
                f"{name}: the skin is not closed: it has a hole {holes.widths[widest]:.1f} cm across about ({x:.0f}, "
                f"{y:.0f}, {z:.0f}) cm, and only holes up to {WIDEST_HOLE:.0f} cm are closed: fill it in the mesh"
            )
        rim_parts = [parts[np.unique(holes.rims[holes.hole_of_rim == hole])] for hole in range(len(holes.centres))]
        whole = np.concatenate([vertices, holes.centres])
        outward = _outward(whole, np.concatenate([consistent, holes.patches(len(vertices))]))
        return cls(
            whole,
            np.concatenate([outward, faces[internal]]),
            np.concatenate([parts, [np.bincount(around).argmax() for around in rim_parts]]).astype(np.uint8),
            holes.widths,
            not np.array_equal(outward[: len(skin)], skin),
        )


def pieces_of(faces: Int[np.ndarray, "f 3"], size: int) -> Int[np.ndarray, " v"]:
    """Number of the connected piece of each vertex."""
    ends = np.concatenate([faces[:, :2], faces[:, 1:]])
    graph = csr_matrix((np.ones(len(ends)), ends.T), shape=(size, size))
    return connected_components(graph, directed=False)[1]


def _welded_rims(vertices: np.ndarray, faces: Int[np.ndarray, "f 3"]) -> Int[np.ndarray, "g 3"]:
    """The faces with coincident vertices on rims merged; faces that collapse are dropped.

    Rims only: other surfaces that touch, such as closed lips, are not seams.
    """
    edges, uses = half_edges_of(faces)
    rims = np.unique(edges[uses == 1])
    if not len(rims):
        return faces
    welded = coincident_vertices(vertices, rims)[faces]
    return welded[(welded != np.roll(welded, 1, axis=1)).all(axis=1)]


def _consistently_wound(faces: Int[np.ndarray, "f 3"], name: str) -> Int[np.ndarray, "f 3"]:
    """The faces of each piece, all wound as most of them. Raises ``BodyError`` for a non-manifold or one-sided skin."""
    edges, uses = half_edges_of(faces)
    if (uses > 2).any():
        raise BodyError(
            f"{name}: {int((uses > 2).sum())} sides of faces are shared by three or more faces, so the inside is "
            "ambiguous: export one skin without inner walls"
        )
    order = np.lexsort(np.sort(edges, axis=1).T[::-1])
    order = order[uses[order] == 2]
    first, second = order[::2], order[1::2]
    # Consistently wound neighbours traverse their shared edge in opposite directions.
    alike = (edges[first] == edges[second]).all(axis=1)
    if not alike.any():
        return faces
    # A graph with two nodes for each face, unflipped and flipped; links join consistently wound neighbours.
    count = len(faces)
    a, b = first // 3, second // 3
    ends = np.concatenate([[a, b + count * alike], [a + count, b + count * ~alike]], axis=1)
    graph = coo_matrix((np.ones(ends.shape[1]), ends), shape=(2 * count, 2 * count))
    label = connected_components(graph, directed=False)[1]
    unflipped, flipped = label[:count], label[count:]
    if (unflipped == flipped).any():
        raise BodyError(f"{name}: its skin has one side only, like a Möbius strip: export the mesh again")
    groups = np.minimum(unflipped, flipped)
    flip = unflipped > flipped
    mostly = np.bincount(groups, flip, minlength=2 * count) > np.bincount(groups, ~flip, minlength=2 * count)
    return np.where((flip ^ mostly[groups])[:, None], faces[:, ::-1], faces)


def _outward(vertices: np.ndarray, faces: Int[np.ndarray, "f 3"]) -> Int[np.ndarray, "f 3"]:
    """The faces, flipped if they enclose a negative volume."""
    import trimesh

    with np.errstate(all="ignore"):  # trimesh divides by the volume, which may be 0
        volume = trimesh.Trimesh(vertices, faces, process=False).volume
    return faces if volume > 0 else faces[:, ::-1]


ROUNDS = 20  # most rounds of smoothing; one to five suffice
PASSES = 4  # smoothing passes in a round
RINGS = 2  # rings of neighbours that are smoothed with a folded face
CREASED = -0.9  # cosine of the normals at an edge below which its faces are tested; intersecting ones are below -0.97
TURNED = 0.7  # cosine to its reference normal below which a face is tested for a crease


class Smoothed(NamedTuple):
    """A smoothed body."""

    vertices: Float[np.ndarray, "v 3"]
    rounds: int
    """Rounds of smoothing that are left."""
    normals: Float[np.ndarray, "3 f"]
    """Normals of the skin's faces, not normalised."""


@dataclass(frozen=True, eq=False)
class SkinMesh(Record):
    """The part of a mesh to keep free of folds, with reference normals."""

    faces: Int[np.ndarray, "f 3"]
    normals: Float[np.ndarray, "3 f"]
    """Unit normals of the reference body."""
    adjacent: Int[np.ndarray, "f 3"]
    """The face across each edge of a face; on the boundary the face itself."""
    neighbour_means: csr_matrix
    """(v, v): maps vertices to the means of their neighbours; the identity off the skin."""

    @classmethod
    def of(cls, reference: Float[np.ndarray, "v 3"], faces: Int[np.ndarray, "f 3"]) -> Self:
        """The skin ``faces`` of a reference body without folds."""
        edges, face_edges, _ = mesh_edges(faces)
        ends = np.concatenate([edges, edges[:, ::-1]]).T
        adjacency = csr_matrix((np.ones(ends.shape[1]), (ends[0], ends[1])), shape=(len(reference), len(reference)))
        count = np.asarray(adjacency.sum(axis=1)).ravel()
        isolated = diags_array((count == 0).astype(float))
        means = csr_matrix(diags_array(1 / np.maximum(count, 1)) @ adjacency + isolated)
        normals = skin_normals(reference, faces)
        return cls(faces, normals / np.linalg.norm(normals, axis=0), _adjacent_faces(face_edges), means)

    def smoothed(
        self,
        vertices: Float[np.ndarray, "v 3"],
        rounds: int,
        *,
        resolve_creases: bool,
        normals: Float[np.ndarray, "3 f"] | None = None,
    ) -> "Smoothed":
        """The vertices with folds, and on request self-intersecting creases, smoothed in at most ``rounds`` rounds.

        ``normals``: those of the vertices, from an earlier call.
        """
        normals = skin_normals(vertices, self.faces) if normals is None else normals
        while rounds:
            wrong = np.flatnonzero(_dot(normals, self.normals) < 0.0)
            if resolve_creases and not len(wrong):
                wrong = self._intersecting(vertices, normals)
            if not len(wrong):
                break
            patch = self._around(wrong, len(vertices))
            vertices, normals, means = vertices.copy(), normals.copy(), self.neighbour_means[patch]
            for _ in range(PASSES):
                vertices[patch] = means @ vertices
            moved = self._faces_at(patch, len(vertices))
            normals[:, moved] = skin_normals(vertices, self.faces[moved])
            rounds -= 1
        return Smoothed(vertices, rounds, normals)

    def _intersecting(self, vertices: np.ndarray, normals: Float[np.ndarray, "3 f"]) -> Int[np.ndarray, " n"]:
        # Every crease has a face turned from its reference normal: a cheaper test than pairs of faces.
        turned = np.flatnonzero(_dot(normals, self.normals) < TURNED * np.sqrt(_dot(normals, normals)))
        normal, other = normals[:, turned, None], normals[:, self.adjacent[turned]]
        creased = _dot(normal, other) < CREASED * np.sqrt(_dot(normal, normal) * _dot(other, other))
        if not creased.any():
            return turned[:0]
        nearby = self._faces_at(self._around(turned[creased.any(axis=1)], len(vertices)), len(vertices))
        return nearby[_intersect(vertices, self.faces[nearby])]

    def _faces_at(self, corners: Int[np.ndarray, " n"], n_vertices: int) -> Int[np.ndarray, " m"]:
        marked = np.zeros(n_vertices, bool)
        marked[corners] = True
        return np.flatnonzero(marked[self.faces[:, 0]] | marked[self.faces[:, 1]] | marked[self.faces[:, 2]])

    def _around(self, faces: Int[np.ndarray, " n"], n_vertices: int) -> Int[np.ndarray, " m"]:
        """The corners of some faces, with ``RINGS`` rings of neighbours."""
        region = np.zeros(n_vertices)
        region[self.faces[faces]] = 1.0
        for _ in range(RINGS):
            region += self.neighbour_means @ region
        return np.flatnonzero(region)


def skin_normals(vertices: Float[np.ndarray, "v 3"], faces: Int[np.ndarray, "f 3"]) -> Float[np.ndarray, "3 f"]:
    """Face normals, not normalised. Written out by coordinates: a sixth of the time of ``np.cross``."""
    a, b, c = np.ascontiguousarray(faces.T)
    axes = [(axis.take(a), axis.take(b), axis.take(c)) for axis in np.ascontiguousarray(vertices.T)]
    (ux, uy, uz), (wx, wy, wz) = ([ends[end] - ends[0] for ends in axes] for end in (1, 2))
    normals = np.empty((3, len(faces)))
    for normal, p, q, r, s in zip(normals, (uy, uz, ux), (wz, wx, wy), (uz, ux, uy), (wy, wz, wx), strict=True):
        np.multiply(p, q, out=normal)
        normal -= r * s
    return normals


def _dot(a: Float[np.ndarray, "3 *n"], b: Float[np.ndarray, "3 *n"]) -> Float[np.ndarray, "*n"]:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def _adjacent_faces(face_edges: Int[np.ndarray, "f 3"]) -> Int[np.ndarray, "f 3"]:
    """The face across each edge of each face."""
    order = np.argsort(face_edges, axis=None, kind="stable")
    first = np.flatnonzero(face_edges.ravel()[order][1:] == face_edges.ravel()[order][:-1])
    adjacent = np.repeat(np.arange(len(face_edges)), 3)
    adjacent[order[first]], adjacent[order[first + 1]] = order[first + 1] // 3, order[first] // 3
    return adjacent.reshape(-1, 3)


def _intersect(vertices: Float[np.ndarray, "v 3"], faces: Int[np.ndarray, "f 3"]) -> Bool[np.ndarray, " f"]:
    """Whether each face crosses an edge of another, or has an edge crossed; tests all pairs of few faces."""
    edges, face_edges, _ = mesh_edges(faces)
    apart = ~(edges[:, None, :, None] == faces[None, :, None, :]).any(axis=(2, 3))
    edge, face = np.nonzero(apart)
    start, along = vertices[edges[edge, 0]], vertices[edges[edge, 1]] - vertices[edges[edge, 0]]
    corner, u, w = (vertices[faces[face, i]] for i in range(3))
    u, w, to = u - corner, w - corner, start - corner
    # Möller and Trumbore (1997): barycentric coordinates of the intersection of edge and plane.
    turned, lifted = np.cross(along, w), np.cross(to, u)
    flat = np.einsum("ni,ni->n", u, turned)
    scale = np.divide(1.0, flat, out=np.full(len(flat), np.nan), where=flat != 0.0)
    beta, gamma = np.einsum("ni,ni->n", to, turned) * scale, np.einsum("ni,ni->n", along, lifted) * scale
    share = np.einsum("ni,ni->n", w, lifted) * scale
    met = (beta >= 0) & (gamma >= 0) & (beta + gamma <= 1) & (share >= 0) & (share <= 1)
    through = np.zeros(len(edges), bool)
    through[edge[met]] = True
    hit = through[face_edges].any(axis=1)
    hit[face[met]] = True
    return hit
