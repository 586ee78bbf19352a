"""A skin made fit for cloth: split seams joined, all faces outward, small holes closed."""

from dataclasses import dataclass
from typing import Self

import numpy as np
import trimesh
from jaxtyping import Bool, Float, Int, UInt8
from scipy.sparse import coo_matrix, csr_matrix
from scipy.sparse.csgraph import connected_components

from gcd_dataset.errors import BodyError
from gcd_dataset.generator.body.holes import Holes, half_edges_of
from gcd_dataset.generator.body.scan import coincident_vertices
from gcd_dataset.records import BodyPart, Record

__all__ = ["WIDEST_HOLE", "ClosedSkin"]

WIDEST_HOLE = 10.0  # cm across, as they are closed by flat patches: up to 1.3 cm off a limb or chest of 10 cm radius


@dataclass(frozen=True, eq=False)
class ClosedSkin(Record):
    """A body's mesh without holes, counter-clockwise seen from outside; pieces that are all internal as they came."""

    vertices: Float[np.ndarray, "v 3"]
    """Those that came, then the middles of the patches [cm]."""
    faces: Int[np.ndarray, "f 3"]
    parts: UInt8[np.ndarray, " v"]
    closed: Float[np.ndarray, " h"]
    """Distance across each hole that was closed [cm]."""
    turned: bool
    """Whether faces that looked inwards were turned."""

    @classmethod
    def of(
        cls,
        vertices: Float[np.ndarray, "u 3"],
        faces: Int[np.ndarray, "g 3"],
        parts: UInt8[np.ndarray, " u"],
        name: str,
    ) -> Self:
        """A mesh [cm], closed. Raises ``BodyError`` where a hole is too wide, or inside and outside are not known."""
        internal = _internal_pieces(faces, parts)
        skin = _joined(vertices, faces[~internal])
        wound = _wound(skin, name)
        holes = Holes.of(vertices, wound)
        _refuse_wide(holes, name)
        middle_parts = [parts[np.unique(holes.rims[holes.hole == hole])] for hole in range(len(holes.middles))]
        whole = np.concatenate([vertices, holes.middles])
        outward = _outward(whole, np.concatenate([wound, holes.patches(len(vertices))]))
        return cls(
            whole,
            np.concatenate([outward, faces[internal]]),
            np.concatenate([parts, [np.bincount(around).argmax() for around in middle_parts]]).astype(np.uint8),
            holes.widths,
            not np.array_equal(outward[: len(skin)], skin),
        )


def _internal_pieces(faces: Int[np.ndarray, "f 3"], parts: UInt8[np.ndarray, " v"]) -> Bool[np.ndarray, " f"]:
    """Faces of pieces all of whose corners are internal: loose eyes."""
    piece = _pieces(faces, len(parts))
    internal = np.ones(len(parts), bool)
    np.logical_and.at(internal, piece[faces], (parts == BodyPart.INTERNAL.value)[faces])
    return internal[piece[faces[:, 0]]]


def _pieces(faces: Int[np.ndarray, "f 3"], size: int) -> Int[np.ndarray, " v"]:
    """Which connected piece each vertex is of."""
    ends = np.concatenate([faces[:, :2], faces[:, 1:]])
    graph = csr_matrix((np.ones(len(ends)), ends.T), shape=(size, size))
    return connected_components(graph, directed=False)[1]


def _joined(vertices: np.ndarray, faces: Int[np.ndarray, "f 3"]) -> Int[np.ndarray, "g 3"]:
    """The faces with one vertex for all at the same place on the rims, where they do not hang together as they are.

    Only rims: skins that touch elsewhere, such as closed lips, are no seam.
    """
    sides, times = half_edges_of(faces)
    rims = np.unique(sides[times == 1])
    if not len(rims):
        return faces
    joined = coincident_vertices(vertices, rims)[faces]
    return joined[(joined != np.roll(joined, 1, axis=1)).all(axis=1)]


def _wound(faces: Int[np.ndarray, "f 3"], name: str) -> Int[np.ndarray, "f 3"]:
    """The faces of each piece all to the same side, as most of them look. Raises ``BodyError`` where none is."""
    sides, times = half_edges_of(faces)
    if (times > 2).any():
        raise BodyError(
            f"{name}: {int((times > 2).sum())} sides of faces are shared by three and more, so inside and outside are "
            "not known: export one skin without inner walls"
        )
    order = np.lexsort(np.sort(sides, axis=1).T[::-1])
    order = order[times[order] == 2]
    first, second = order[::2], order[1::2]
    alike = (sides[first] == sides[second]).all(axis=1)  # neighbours run along a shared side to opposite ends
    if not alike.any():
        return faces
    # Each face twice, as it is and turned: what must look alike is joined.
    count = len(faces)
    a, b = first // 3, second // 3
    ends = np.concatenate([[a, b + count * alike], [a + count, b + count * ~alike]], axis=1)
    graph = coo_matrix((np.ones(ends.shape[1]), ends), shape=(2 * count, 2 * count))
    label = connected_components(graph, directed=False)[1]
    kept, turned = label[:count], label[count:]
    if (kept == turned).any():
        raise BodyError(f"{name}: its skin has one side only, like a Möbius strip: export the mesh again")
    groups = np.minimum(kept, turned)
    turn = kept > turned
    mostly = np.bincount(groups, turn, minlength=2 * count) > np.bincount(groups, ~turn, minlength=2 * count)
    return np.where((turn ^ mostly[groups])[:, None], faces[:, ::-1], faces)


def _refuse_wide(holes: Holes, name: str) -> None:
    if holes.widths.max(initial=0.0) > WIDEST_HOLE:
        widest = int(holes.widths.argmax())
        x, y, z = holes.middles[widest]
        raise BodyError(
            f"{name}: the skin is not closed: it has a hole {holes.widths[widest]:.1f} cm across about "
            f"({x:.0f}, {y:.0f}, {z:.0f}) cm, and up to {WIDEST_HOLE:.0f} cm are closed here: fill it in the mesh"
        )


def _outward(vertices: np.ndarray, faces: Int[np.ndarray, "f 3"]) -> Int[np.ndarray, "f 3"]:
    """The faces turned, if they enclose what is outside."""
    with np.errstate(all="ignore"):  # trimesh divides by the volume, which may be 0
        volume = trimesh.Trimesh(vertices, faces, process=False).volume
    return faces if volume > 0 else faces[:, ::-1]
