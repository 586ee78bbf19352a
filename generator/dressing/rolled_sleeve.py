"""A sleeve or trouser leg of one panel, rolled into a tube round its limb, as the start of sewing.

Box meshes put the vertices of a seam at the midpoint of the points that it joins. A panel whose two long edges are sewn
to each other would begin folded flat, with the limb on one side of it.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from gcd_dataset.generator.body.limbs import Limb
from gcd_dataset.generator.dressing.flat_cloth import FlatCloth
from gcd_dataset.records import BoxMesh

GAP = 1.0  # cm between a rolled panel and the limb
ROOT = 10.0  # cm: nearer to its root the panel keeps a share of its position
BEFORE_END = 1.0  # cm between the end of the panel and that of the limb
LEAST_LENGTH = 0.4  # share of its length to which a panel may be compressed
SECTION = 2.0  # cm, length of a cross section


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

    vertex: Int[np.ndarray, " n"]
    """Vertex of the box mesh of each row."""
    around: Float[np.ndarray, " n"]
    """-1 on the left edge of the panel's own seam, 1 on the right edge, harmonic between them."""
    distance: Float[np.ndarray, " n"]
    """Distance from the panel's root along its axis [cm]."""
    across: Float[np.ndarray, " n"]
    """Flat coordinate at right angles to its axis [cm]."""
    right: Float[np.ndarray, "2"]
    """Unit vector of ``across`` in the panel's plane."""

    @staticmethod
    def of(mesh: BoxMesh, tube: Bool[np.ndarray, " f"]) -> "_Panel | None":
        """The panel of the marked faces; ``None`` for several panels, or one that is not sewn to itself."""
        numbers = np.unique(mesh.panel_id[tube])
        if len(numbers) != 1:
            return None
        rows = np.unique(mesh.corners[tube])
        vertex, uv = mesh.uv_vertex[rows], mesh.uv[rows]
        root = np.isin(vertex, mesh.faces[~tube])
        own_seam = _repeated(vertex) & ~root
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
        near = self.distance < SECTION
        root = float(((points[near] - limb.origin) @ limb.axis).mean()) if near.any() else 0.0
        room = float(((limb.skin - limb.origin) @ limb.axis).max()) - BEFORE_END - root
        shrink = np.clip(room / max(float(self.distance.max()), SECTION), LEAST_LENGTH, 1.0)
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
        self,
        limb: Limb,
        normal: Float[np.ndarray, "3"],
        sideways: Float[np.ndarray, "3"],
        root: float,
        shrink: float,
    ) -> Float[np.ndarray, " n"]:
        """Radius of the cross section of each row [cm]; ``root``: position of the panel's root along the limb."""
        skin = limb.skin - limb.origin
        reach = np.hypot(skin @ normal, skin @ sideways)
        number = np.floor(self.distance / SECTION).astype(int)
        skin_number = np.floor((skin @ limb.axis - root) / shrink / SECTION).astype(int)
        middles, radii = [0.0], [0.0]
        for section in np.unique(number):
            own = number == section
            girth = _slope(self.around[own], self.across[own]) * 2.0  # ``around`` increases by 2 over the girth
            limbs_own = reach[np.abs(skin_number - section) <= 1].max(initial=0.0)
            middles.append((section + 0.5) * SECTION)
            radii.append(max(girth / (2.0 * np.pi), limbs_own + GAP))
        radii[0] = radii[1]
        return np.interp(self.distance, middles, radii)


def _slope(x: Float[np.ndarray, " n"], y: Float[np.ndarray, " n"]) -> float:
    """Slope of the regression line; 0 without variance."""
    centred = x - x.mean()
    return float(centred @ y / max(float(centred @ centred), 1e-9))


def _repeated(values: Int[np.ndarray, " n"]) -> Bool[np.ndarray, " n"]:
    """Marks the values that occur more than once."""
    _, inverse, count = np.unique(values, return_inverse=True, return_counts=True)
    return count[inverse] > 1
