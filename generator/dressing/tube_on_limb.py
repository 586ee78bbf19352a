"""A sleeve round an arm or a trouser leg round a leg, as the start of sewing.

Box meshes put the vertices of a seam at the midpoint of the points that it joins. A sleeve of one panel, its two long
edges sewn to each other, would begin folded flat, with the limb on one side of it: it is rolled round the limb.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.spatial.transform import Rotation

from gcd_dataset.generator.body.limbs import Limb
from gcd_dataset.generator.dressing.flat_cloth import FlatCloth
from gcd_dataset.generator.mesh.rows import distinct
from gcd_dataset.records import BoxMesh

SECTION = 2.0  # median edges: length of a cross section along the tube; shorter ones would miss a side of it
ROOT = 10.0  # cm: nearer to its root a tube may lie beside the limb's axis
GAP = 1.0  # cm that a cross section must reach beyond the limb on either side
BEFORE_END = 1.0  # cm between the end of a tube and that of the limb
LEAST_LENGTH = 0.4  # share of its length to which a tube may be compressed
MOST_OVERLAP = 0.5  # share of a panel's length that lies beside the previous piece: more, and it belongs to that piece
LEAST_RING = 6  # vertices of a cross section; fewer may lie on one side of the limb
RINGS = 40  # level sets on which the distance from the root is averaged


def put_on_limb(
    mesh: BoxMesh,
    tube: Bool[np.ndarray, " f"],
    limb: Limb,
    placed: Float[np.ndarray, "v 3"],
    *,
    gap: float = GAP,
    loose: float = np.inf,
) -> bool:
    """Move the cross sections of a tube of cloth, in ``placed``, so that each surrounds a limb.

    ``tube`` marks the faces of a sleeve or a trouser leg; ``limb``: the arm without the hand, or the leg without the
    foot. The root of a tube is its seam with other cloth. The tube is turned to the direction of the limb. Each cross
    section is centred on the limb's axis, at its distance from the root, and widened where the limb is wider. A tube
    longer than the limb is compressed to the limb's length: sewn round a hand or foot, the cloth would be too narrow to
    slip off. A tube keeps its positions if it is placed round the limb and is not longer than the limb, or has at least
    the girth ``loose`` [cm] everywhere beyond the limb's end. ``gap``: cm by which each cross section must reach beyond
    the limb.

    Returns whether the tube was moved.
    """
    cloth = _Tube.of(mesh, tube)
    if cloth is None or (
        cloth.surrounds(limb.skin, gap) and (cloth.ends_on(limb) or cloth.is_loose_beyond(limb, loose))
    ):
        return False
    placed[cloth.rows] = cloth.moved_to(limb)
    return True


@dataclass(frozen=True, eq=False)
class _Tube:
    """The vertices of a sleeve or trouser leg, at the positions in the box mesh."""

    rows: Int[np.ndarray, " n"]
    points: Float[np.ndarray, "n 3"]  # positions [cm]
    distance: Float[np.ndarray, " n"]
    """Distance from the root [cm], averaged over each level set of a harmonic function, such as the open end."""
    piece: Int[np.ndarray, " n"]
    """Number of the piece of each vertex, from the root: sleeve, cuff, cuff's skirt; on their seam the piece nearer to
    the root."""
    section: float  # length of a cross section along the tube [cm]
    frame: Float[np.ndarray, "3 3"]  # unit vectors across the tube, along it away from the root, and to the front

    @staticmethod
    def of(mesh: BoxMesh, own: Bool[np.ndarray, " f"]) -> "_Tube | None":
        """The tube of the marked faces; ``None`` without a root, cloth near the root, an open end or a direction."""
        cloth = FlatCloth.of(mesh, own)
        sewn = np.zeros(len(mesh.vertices), bool)
        sewn[mesh.faces[~own]] = True
        root, end = cloth.vertices[sewn[cloth.vertices]], cloth.border[~sewn[cloth.border]]
        if not (len(root) and len(end)):
            return None
        rows = cloth.vertices
        level = cloth.harmonic(np.concatenate([root, end]), np.repeat([0.0, 1.0], [len(root), len(end)]))[rows]
        distance = _averaged(level, cloth.distance_from(root)[rows])
        points = np.array(mesh.vertices[rows], float)
        along = mesh.vertices[end, :2].mean(axis=0) - mesh.vertices[root, :2].mean(axis=0)
        length = float(np.linalg.norm(along))
        section = SECTION * float(np.median(cloth.edges[1]))
        if length < 1e-6 or distance.min() >= section:
            return None
        x, y = along / length
        piece = _pieces(mesh.faces[own], mesh.panel_id[own], rows, distance)
        return _Tube(rows, points, distance, piece, section, np.array([[-y, x, 0.0], [x, y, 0.0], [0.0, 0.0, 1.0]]))

    def surrounds(self, skin: Float[np.ndarray, "s 3"], gap: float) -> bool:
        """Whether every cross section beyond ``ROOT`` surrounds the limb's skin at the same height, ``GAP`` apart."""
        across, along, depth = (self.points @ self.frame.T).T
        skin_across, skin_along, skin_depth = (skin @ self.frame.T).T
        for here in self._sections:
            low, high = along[here].min() - self.section, along[here].max() + self.section
            beside = (skin_along > low) & (skin_along < high)
            if self.distance[here].mean() > ROOT and beside.any():
                for cloth, body in ((across[here], skin_across[beside]), (depth[here], skin_depth[beside])):
                    if cloth.min() > body.min() - gap or cloth.max() < body.max() + gap:
                        return False
        return True

    def ends_on(self, limb: Limb) -> bool:
        """Whether the end of the tube lies before the end of the limb."""
        return bool(((self.points - limb.origin) @ limb.axis).max() <= _end_of(limb))

    def is_loose_beyond(self, limb: Limb, loose: float) -> bool:
        """Whether every cross section beyond the end of the limb has at least the girth ``loose`` [cm]."""
        across, along = (self.points @ self.frame.T)[:, 0], (self.points - limb.origin) @ limb.axis
        beyond = [here for here in self._sections if along[here].mean() > _end_of(limb)]
        return all(2.0 * np.ptp(across[here]) >= loose for here in beyond)

    def moved_to(self, limb: Limb) -> Float[np.ndarray, "n 3"]:
        """The positions round a limb [cm]; the root does not move."""
        frame = self.frame @ Rotation.align_vectors(limb.axis[None], self.frame[1:2])[0].as_matrix().T
        skin_across, skin_along, _ = ((limb.skin - limb.origin) @ frame.T).T
        at_root = self.distance < self.section
        root = float(((self.points[at_root] - limb.origin) @ limb.axis).mean())
        across, _, depth = (self.points @ self.frame.T).T
        longest = float(self.distance.max())
        shrink = np.clip((_end_of(limb) - root) / longest, LEAST_LENGTH, 1.0) if longest > ROOT else 1.0
        middle, factor = np.empty(len(self.rows)), np.empty(len(self.rows))
        found: dict[int, list[tuple[float, float, float]]] = {}
        for here in self._sections:
            distance = float(self.distance[here].mean())
            beside = np.abs(skin_along - root - shrink * distance) < self.section
            low, high = float(across[here].min()), float(across[here].max())
            need = float(np.abs(skin_across[beside]).max(initial=0.0)) + GAP if beside.any() else 0.0
            widened = max(1.0, 2.0 * need / max(high - low, self.section))
            found.setdefault(int(self.piece[here[0]]), []).append((distance, 0.5 * (low + high), widened))
        for piece, sections in found.items():  # a gathered sleeve and its cuff lie beside each other in the box mesh
            own = self.piece == piece
            distances, middles, factors = zip(*sections, strict=True)
            middle[own] = np.interp(self.distance[own], distances, middles)
            factor[own] = np.interp(self.distance[own], distances, factors)
        local = np.stack([factor * (across - middle), root + shrink * self.distance, depth], axis=1)
        share = np.minimum(self.distance / ROOT, 1.0)[:, None]
        return self.points + share * (limb.origin + local @ frame - self.points)

    @cached_property
    def _sections(self) -> list[Int[np.ndarray, " k"]]:
        """The vertices of each cross section of each piece, from the root to the end; without incomplete sections."""
        return [section for number in np.unique(self.piece) for section in self._sections_of(number)]

    def _sections_of(self, piece: int) -> list[Int[np.ndarray, " k"]]:
        own = np.flatnonzero(self.piece == piece)
        numbers = np.floor(self.distance[own] / self.section).astype(int)
        sections = [own[numbers == number] for number in distinct(numbers, numbers.max() + 1)]
        return [section for section in sections if len(section) >= LEAST_RING] or [own]


def _pieces(
    faces: Int[np.ndarray, "f 3"],
    panel_id: Int[np.ndarray, " f"],
    rows: Int[np.ndarray, " n"],
    distance: Float[np.ndarray, " n"],
) -> Int[np.ndarray, " n"]:
    """See ``_Tube.piece``: panels at the same distances from the root form a piece."""
    at = np.empty(rows[-1] + 1, int)
    at[rows] = np.arange(len(rows))
    panels = [distinct(at[faces[panel_id == panel]], len(rows)) for panel in distinct(panel_id, panel_id.max() + 1)]
    panels.sort(key=lambda own: float(distance[own].mean()))
    piece = np.full(len(rows), len(panels))
    number, reach = -1, -np.inf
    for own in panels:
        first, last = float(distance[own].min()), float(distance[own].max())
        if reach - first < MOST_OVERLAP * (last - first):
            number += 1
        reach = max(reach, last)
        piece[own] = np.minimum(piece[own], number)
    return piece


def _end_of(limb: Limb) -> float:
    """Farthest position of a tube's end along the limb's axis, from the limb's origin [cm]."""
    return float(((limb.skin - limb.origin) @ limb.axis).max()) - BEFORE_END


def _averaged(level: Float[np.ndarray, " n"], distance: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
    """The mean ``distance`` over the level set of each vertex; increases with ``level``, which is from 0 to 1."""
    ring = np.round(level * RINGS).astype(int)
    count = np.bincount(ring, minlength=RINGS + 1)
    mean = np.bincount(ring, distance, minlength=RINGS + 1)[count > 0] / count[count > 0]
    return np.interp(level * RINGS, np.flatnonzero(count), np.maximum.accumulate(mean))


ROLL_SECTION = 2.0  # cm, length of a cross section


def roll_round_limb(mesh: BoxMesh, tube: Bool[np.ndarray, " f"], limb: Limb, placed: Float[np.ndarray, "v 3"]) -> bool:
    """Roll a panel that is sewn to itself round a limb, in ``placed``; returns whether the tube is such a panel.

    ``tube`` marks the faces of a sleeve or a trouser leg. The panel's middle stays on the side of the limb on which it
    hangs, and its seam comes to the opposite side. A cross section becomes a circle of its own girth about the limb's
    axis, larger where the limb is wider.
    """
    panel = _Panel.of(mesh, tube)
    if panel is None:
        return False
    placed[panel.vertex] = panel.rolled(mesh, limb)
    return True


@dataclass(frozen=True, eq=False)
class _Panel:
    """A panel sewn to itself; rows are its seam-split vertices."""

    vertex: Int[np.ndarray, " n"]  # vertex of the box mesh of each row
    around: Float[np.ndarray, " n"]
    """-1 on the left edge of the panel's own seam, 1 on the right edge, harmonic between them."""
    distance: Float[np.ndarray, " n"]  # distance from the panel's root along its axis [cm]
    across: Float[np.ndarray, " n"]  # flat coordinate at right angles to its axis [cm]
    right: Float[np.ndarray, "2"]  # unit vector of ``across`` in the panel's plane

    @staticmethod
    def of(mesh: BoxMesh, tube: Bool[np.ndarray, " f"]) -> "_Panel | None":
        """The panel of the marked faces; ``None`` for several panels, or one that is not sewn to itself."""
        if len(distinct(mesh.panel_id[tube], len(mesh.panel_names))) != 1:
            return None
        rows = distinct(mesh.corners[tube], len(mesh.uv))
        vertex, uv = mesh.uv_vertex[rows], mesh.uv[rows]
        root = np.isin(vertex, mesh.faces[~tube])
        _, inverse, count = np.unique(vertex, return_inverse=True, return_counts=True)
        own_seam = (count[inverse] > 1) & ~root
        if not own_seam.any() or not root.any():
            return None
        middle = uv[own_seam].mean(axis=0)
        axis = middle - uv[root].mean(axis=0)
        axis /= max(float(np.linalg.norm(axis)), 1e-9)
        right = np.array([-axis[1], axis[0]])  # the axis runs down a panel that hangs upright
        across = (uv - middle) @ right
        ends = np.flatnonzero(own_seam)
        around = FlatCloth.of_panel(mesh, tube).harmonic(rows[ends], np.sign(across[ends]))[rows]
        along = (uv - uv[root].mean(axis=0)) @ axis
        return _Panel(vertex, around, np.maximum(along, 0.0), across, right)

    def rolled(self, mesh: BoxMesh, limb: Limb) -> Float[np.ndarray, "n 3"]:
        """The positions of the rows round a limb [cm]."""
        points = np.array(mesh.vertices[self.vertex], float)
        normal, sideways = self._directions(points, limb.axis)
        near = self.distance < ROLL_SECTION
        root = float(((points[near] - limb.origin) @ limb.axis).mean()) if near.any() else 0.0
        room = float(((limb.skin - limb.origin) @ limb.axis).max()) - BEFORE_END - root
        shrink = np.clip(room / max(float(self.distance.max()), ROLL_SECTION), LEAST_LENGTH, 1.0)
        radius, angle = self._radii(limb, normal, sideways, root, shrink), np.pi * self.around
        round_limb = (
            limb.origin
            + (root + shrink * self.distance)[:, None] * limb.axis
            + (radius * np.cos(angle))[:, None] * normal
            + (radius * np.sin(angle))[:, None] * sideways
        )
        share = np.minimum(self.distance / ROOT, 1.0)[:, None]
        return points + share * (round_limb - points)

    def _directions(
        self, points: Float[np.ndarray, "n 3"], axis: Float[np.ndarray, "3"]
    ) -> tuple[Float[np.ndarray, "3"], Float[np.ndarray, "3"]]:
        """Unit vectors at right angles to the limb: to the panel's right in space, and out of its right side."""
        inner = np.abs(self.around) < 0.9
        centred = self.across[inner] - self.across[inner].mean()
        sideways = centred @ (points[inner] - points[inner].mean(axis=0))
        sideways -= (sideways @ axis) * axis
        sideways /= max(float(np.linalg.norm(sideways)), 1e-9)
        return np.cross(axis, sideways), sideways

    def _radii(
        self, limb: Limb, normal: Float[np.ndarray, "3"], sideways: Float[np.ndarray, "3"], root: float, shrink: float
    ) -> Float[np.ndarray, " n"]:
        """Radius of the cross section of each row [cm]; ``root``: position of the panel's root along the limb."""
        skin = limb.skin - limb.origin
        reach = np.hypot(skin @ normal, skin @ sideways)
        number = np.floor(self.distance / ROLL_SECTION).astype(int)
        skin_number = np.floor((skin @ limb.axis - root) / shrink / ROLL_SECTION).astype(int)
        middles, radii = [0.0], [0.0]
        for section in np.unique(number):
            own = number == section
            centred = self.around[own] - self.around[own].mean()
            slope = float(centred @ self.across[own] / max(float(centred @ centred), 1e-9))  # of the regression line
            girth = slope * 2.0  # ``around`` increases by 2 over the girth
            limbs_own = reach[np.abs(skin_number - section) <= 1].max(initial=0.0)
            middles.append((section + 0.5) * ROLL_SECTION)
            radii.append(max(girth / (2.0 * np.pi), limbs_own + GAP))
        radii[0] = radii[1]
        return np.interp(self.distance, middles, radii)
