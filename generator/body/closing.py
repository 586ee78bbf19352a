"""Prepares a skin for cloth: welds split seams, orients all faces outward, closes small holes."""

from dataclasses import dataclass
from typing import Self

import numpy as np
from jaxtyping import Bool, Float, Int, UInt8
from scipy.sparse import coo_matrix, csr_matrix
from scipy.sparse.csgraph import connected_components

from gcd_dataset.errors import BodyError
from gcd_dataset.generator.body.holes import Holes, half_edges_of
from gcd_dataset.generator.body.scan import coincident_vertices
from gcd_dataset.records import BodyPart, Record

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
        internal = _internal_pieces(faces, parts)
        skin = _welded_rims(vertices, faces[~internal])
        consistent = _consistently_wound(skin, name)
        holes = Holes.of(vertices, consistent)
        _require_narrow(holes, name)
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


def _internal_pieces(faces: Int[np.ndarray, "f 3"], parts: UInt8[np.ndarray, " v"]) -> Bool[np.ndarray, " f"]:
    """Whether each face is of a connected piece with internal vertices only, such as a loose eye."""
    piece = _pieces(faces, len(parts))
    internal = np.ones(len(parts), bool)
    np.logical_and.at(internal, piece[faces], (parts == BodyPart.INTERNAL.value)[faces])
    return internal[piece[faces[:, 0]]]


def _pieces(faces: Int[np.ndarray, "f 3"], size: int) -> Int[np.ndarray, " v"]:
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


def _require_narrow(holes: Holes, name: str) -> None:
    if holes.widths.max(initial=0.0) > WIDEST_HOLE:
        widest = int(holes.widths.argmax())
        x, y, z = holes.centres[widest]
        raise BodyError(
            f"{name}: the skin is not closed: it has a hole {holes.widths[widest]:.1f} cm across about "
            f"({x:.0f}, {y:.0f}, {z:.0f}) cm, and only holes up to {WIDEST_HOLE:.0f} cm are closed: fill it in the mesh"
        )


def _outward(vertices: np.ndarray, faces: Int[np.ndarray, "f 3"]) -> Int[np.ndarray, "f 3"]:
    """The faces, flipped if they enclose a negative volume."""
    import trimesh

    with np.errstate(all="ignore"):  # trimesh divides by the volume, which may be 0
        volume = trimesh.Trimesh(vertices, faces, process=False).volume
    return faces if volume > 0 else faces[:, ::-1]
