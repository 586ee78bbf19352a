"""A wide skirt on a cone round the trunk, as the start of sewing."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from gcd_dataset.generator.body.limbs import Limb
from gcd_dataset.generator.dressing.flat_cloth import FlatCloth
from gcd_dataset.generator.mesh.rows import distinct
from gcd_dataset.records import BoxMesh, EdgeRole

RISE = 5.0  # cm: a skirt that reaches further above its top starts on a cone
CURL = 15.0  # cm: a panel whose top edge spans more height, as a ring of over half a turn, starts on a cone
HALF_WIDTH = 60.0  # cm: a skirt that reaches further to a side of the middle starts on a cone
SLOPE = 0.5  # cm of descent per cm of distance from a flat panel's top, at least: 60° from the vertical
TOP_BAND = 2.0  # cm, distance from the nearest vertex of a panel within which vertices count as its top
CLEARANCE = 2.0  # cm from the ellipse round the trunk to the top of the cone
HIPS = 30.0  # cm below the skirt's top: down to here the ellipse contains the trunk, and the waves grow
LEAST_FLARE = 1e-3  # cm per cm: a skirt that widens less begins straight
SINES = (0.15, 0.6)  # least and largest sine of the angle between the cone and its axis
WAVE, WAVES = 0.4, 17.0  # amplitude of small waves that start the folds [cm], and their number round the cone


@dataclass(frozen=True, eq=False)
class Skirt:
    """The faces of a skirt, its top, front and side seams."""

    mesh: BoxMesh
    cloth: FlatCloth
    _panel: Int[np.ndarray, " f"]
    """Panel of each face of ``cloth``."""
    top: Int[np.ndarray, " t"]
    """Vertices sewn to a bodice or waistband, or held at the waist."""
    front: Bool[np.ndarray, " v"]
    """Marks vertices that belong to front panels only."""
    side: Int[np.ndarray, " s"]
    """Vertices of the side seams, which join front panels and back panels."""

    @staticmethod
    def of(mesh: BoxMesh, skirts: Bool[np.ndarray, " p"]) -> "Skirt | None":
        """The skirt of the given panels; ``None`` without a top."""
        own = skirts[mesh.panel_id]
        faces, panel = mesh.faces[own], mesh.panel_id[own]
        inside, outside = np.zeros((2, len(mesh.vertices)), bool)
        inside[faces] = True
        outside[mesh.faces[~own]] = True
        top = inside & outside
        if not top.any() and EdgeRole.LOWER_INTERFACE in mesh.labels:
            top[mesh.labels[EdgeRole.LOWER_INTERFACE]] = True
            top &= inside
        if not top.any():
            return None
        depth = np.bincount(panel, mesh.vertices[faces, 2].sum(axis=1), minlength=len(skirts))
        ahead = (depth > 0.0)[panel]
        front, back = np.zeros((2, len(mesh.vertices)), bool)
        front[faces[ahead]] = True
        back[faces[~ahead]] = True
        cloth = FlatCloth.of(mesh, own)
        return Skirt(mesh, cloth, panel, np.flatnonzero(top), front & ~back, np.flatnonzero(front & back))

    @property
    def is_wide(self) -> bool:
        """Whether the skirt or one of its panels reaches ``RISE`` above its top, or the skirt ``HALF_WIDTH`` to a side.

        The height of a panel is taken relative to cloth that descends from the panel's top at ``SLOPE``. This detects
        rings sewn to a hem: their ends point up. In a narrow ring the top's own ends do, see ``CURL``.
        """
        points = self.mesh.vertices[self.cloth.vertices]
        if points[:, 1].max() > self._level + RISE or np.abs(points[:, 0]).max() > HALF_WIDTH:
            return True
        height, down = self.mesh.vertices[:, 1], self._down
        for panel in self._panels:
            own = distinct(self.cloth.faces[self._panel == panel], self.cloth.size)
            first = own[down[own] <= down[own].min() + TOP_BAND]
            if np.ptp(height[first]) > CURL:
                return True
            if (height[own] + SLOPE * (down[own] - down[own].min())).max() > height[first].max() + RISE:
                return True
        return False

    def place_on_cone(self, trunk: Limb, placed: Float[np.ndarray, "v 3"]) -> None:
        """Set the skirt's rows of ``placed`` to positions on a cone round the trunk [cm].

        The distance of a vertex from the top, along the cloth, becomes its distance down the cone. Its position between
        the side seams becomes its angle round the cone. A skirt without side seams on both sides stays flat, and so
        does one that ends at its top, or of which nearly all has no path to the top.
        """
        if not ((self._aside > 0.0).any() and (self._aside < 0.0).any()):
            return
        rows = self.cloth.vertices
        down = self._down[rows]
        length = float(np.percentile(down, 95))
        if length <= 0.0:
            return
        # The angle of each vertex from the middle of front or back: π/2 on the left side seam, -π/2 on the right,
        # harmonic in the flat cloth between them.
        turn = self.cloth.harmonic(self.side, 0.5 * np.pi * self._aside)[rows]
        trunk = trunk.section(self._level - HIPS, self._level + CLEARANCE)
        # The mean girth of a skirt is its area over its length; from top to hem the girth grows by twice the difference
        # of mean girth and top girth.
        ends, flat = self.cloth.edges
        growth = 2.0 * (self.cloth.area / length - float(flat[np.isin(ends, self.top).all(axis=1)].sum()))
        sine = float(np.clip(growth / (2.0 * np.pi * length), *SINES))  # of the angle between cone and axis
        out = CLEARANCE + sine * down + WAVE * np.sin(WAVES * turn) * np.minimum(down / HIPS, 1.0)
        placed[rows, 0] = trunk.origin[0] + (trunk.wide + out) * np.sin(turn)
        placed[rows, 1] = self._level - np.sqrt(1.0 - sine**2) * down
        forward = np.where(self.front[rows], 1.0, -1.0)
        placed[rows, 2] = trunk.origin[2] + forward * (trunk.deep + out) * np.cos(turn)

    def place_folded(self, trunk: Limb, placed: Float[np.ndarray, "v 3"]) -> None:
        """Set the rows of ``placed`` of a skirt that begins folded to positions round the trunk, its layers in order.

        The folded panels are ring sectors about one point, where the lines of the side seams meet. A sector becomes
        half a cone: its radii run down the cone, its arcs round it [cm]. The skirt begins at its top, without the gap
        to its waistband.
        """
        if not len(self.side):
            return
        rows = self.cloth.vertices
        x, y, z = self.mesh.vertices[rows].T
        seam = self.mesh.vertices[self.side]
        slope, half = np.polyfit(seam[:, 1], np.abs(seam[:, 0]), 1)
        apex = half / max(-slope, LEAST_FLARE)
        angle, radius = np.arctan2(x, apex - y), np.hypot(x, apex - y)
        side, top, front = np.isin(rows, self.side), np.isin(rows, self.top), self.front[rows]
        spread, spacing = float(np.abs(angle[side]).mean()), float(np.median(self.cloth.edges[1]))
        radius[top] = radius[~(side | top)].min() - spacing
        trunk = trunk.section(self._level - HIPS, self._level + CLEARANCE)
        out = np.maximum(spread * radius / (0.5 * np.pi) - 0.5 * (trunk.wide + trunk.deep), CLEARANCE)
        forward = np.where(front, 1.0, -1.0)
        for own in (front & ~side & ~top, ~front & ~side & ~top):
            out[own] += forward[own] * (z[own] - np.median(z[own]))
            # The seams lie between the sides of both panels, which differ: each panel reaches its own.
            last = np.abs(angle[own]).argmax()
            angle[own] *= spread / (abs(angle[own][last]) + spacing / radius[own][last])
        turn = np.clip(0.5 * np.pi * angle / spread, -0.5 * np.pi, 0.5 * np.pi)
        placed[rows, 0] = trunk.origin[0] + (trunk.wide + out) * np.sin(turn)
        placed[rows, 1] = self._level - np.sqrt(1.0 - min(spread / (0.5 * np.pi), SINES[1]) ** 2) * (
            radius - radius[top].min()
        )
        placed[rows, 2] = trunk.origin[2] + forward * (trunk.deep + out) * np.cos(turn)

    @cached_property
    def _down(self) -> Float[np.ndarray, " v"]:
        """Distance of each vertex from the top along the cloth [cm]."""
        return self.cloth.distance_from(self.top)

    @property
    def _panels(self) -> Int[np.ndarray, " p"]:
        return distinct(self._panel, len(self.mesh.panel_names))

    @cached_property
    def _level(self) -> float:
        """Height of the top [cm]."""
        return float(self.mesh.vertices[self.top, 1].mean())

    @cached_property
    def _aside(self) -> Float[np.ndarray, " s"]:
        """1 for vertices of a left side seam, -1 for vertices of a right one.

        The side seams of one panel are compared with each other: both seams of nearly a full disc lie above its middle.
        """
        ends, _ = self.cloth.edges
        beside = np.zeros(self.cloth.size, bool)
        beside[self.side] = True
        ends = ends[beside[ends].all(axis=1)]
        graph = coo_array((np.ones(len(ends)), ends.T), shape=(self.cloth.size, self.cloth.size))
        _, numbers = connected_components(graph, directed=False)
        seam = np.unique(numbers[self.side], return_inverse=True)[1]
        x = np.bincount(seam, self.mesh.vertices[self.side, 0]) / np.bincount(seam)
        seam_of = np.full(self.cloth.size, -1)
        seam_of[self.side] = seam
        middle = np.zeros(len(x))
        for panel in self._panels:
            seams = seam_of[self.cloth.faces[self._panel == panel]]
            seams = distinct(seams[seams >= 0], len(x))
            if len(seams) > 1:
                middle[seams] = x[seams].mean()
        return np.sign(x - middle)[seam]
