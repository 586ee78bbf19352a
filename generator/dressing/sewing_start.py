"""Start positions of sewing: wide skirts on a cone, wide bodices between the arms, sleeves round the arms.

A pattern places panels flat before and behind the wearer. Closing seams from there tangles three kinds of cloth:

- A skirt of large discs, or of several rings one below the other, reaches above its own top and lies before the arms.
- A bodice wider than the room between the arms is sewn round the arms.
- A sleeve placed beside its arm is not sewn round it.

Here such skirts and bodices start compressed where they belong, and such sleeves start round the arms. The rest lengths
of the springs grow from the start lengths to the flat lengths while the seams close, which spreads the cloth.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.sparse import coo_array, csr_array, diags_array
from scipy.sparse.csgraph import connected_components, dijkstra
from scipy.sparse.linalg import spsolve

from gcd_dataset.errors import BodyError
from gcd_dataset.generator.body.limbs import Limb, limbs_of
from gcd_dataset.records import Body, BodyPart, BoxMesh, EdgeRole, PanelRole
from gcd_dataset.spec import is_trouser_leg

__all__ = ["sewing_start"]

RISE = 5.0  # cm above its top: a skirt that reaches higher starts on a cone
HALF_WIDTH = 60.0  # cm from the middle: a skirt that reaches further to a side starts on a cone
CLEARANCE = 2.0  # cm from the ellipse round the trunk to the top of the cone
HIPS = 30.0  # cm below the skirt's top: the ellipse contains the trunk down to here, the waves reach full amplitude
SINES = (0.15, 0.6)  # least and largest sine of the angle between the cone and its axis
WAVE, WAVES = 0.4, 17.0  # cm, amplitude; periods round the cone: small waves that determine where folds form
ARM_GAP = 1.5  # cm between a bodice and the inside of an arm
ARMPIT = 22.0  # cm below the top of the arm's skin: the armhole surrounds the arm above this height
SLICE = 2.0  # cm, height of the slices in which the widths of bodice and room are compared
SECTION = 2.0  # cm of distance from the armhole that make a cross section of a sleeve
SLEEVE_ROOT = 10.0  # cm from the armhole, where a sleeve may lie beside the arm's axis
SLEEVE_GAP = 1.0  # cm that a cross section of a sleeve must reach beyond the arm or hand on either side


def sewing_start(mesh: BoxMesh, body: Body) -> Float[np.ndarray, "v 3"]:
    """The start positions of a garment's vertices on a body [cm]: ``mesh.vertices`` except in the cases above."""
    roles = np.array([str(role) for role in mesh.panel_labels])
    skirts = (roles == PanelRole.LEG) & ~np.array([is_trouser_leg(name) for name in mesh.panel_names])
    skirt = _Skirt.of(mesh, skirts) if skirts.any() else None
    on_cone = skirt is not None and skirt.is_wide
    bodice, sleeves = (roles == PanelRole.BODY).any(), (roles == PanelRole.ARM).any()
    if not (on_cone or bodice or sleeves):
        return mesh.vertices
    try:
        limbs = limbs_of(body)
    except BodyError:  # a body without a trunk, such as a ball
        return mesh.vertices
    placed = np.array(mesh.vertices, float)
    if skirt is not None and on_cone:
        skirt.place_on_cone(limbs[BodyPart.TRUNK], placed)
    if bodice:
        for part, side in ((BodyPart.LEFT_ARM, 1.0), (BodyPart.RIGHT_ARM, -1.0)):
            if part in limbs:
                _fit_between_arms(mesh, roles, limbs[part], side, placed)
    if sleeves:
        for part, side in ((BodyPart.LEFT_ARM, 1.0), (BodyPart.RIGHT_ARM, -1.0)):
            if part in limbs:
                _put_on_arm(mesh, roles, body, limbs[part], side, placed)
    return placed


def _flat_sides(
    faces: Int[np.ndarray, "f 3"], uv: Float[np.ndarray, "f 3 2"], vertices: int
) -> tuple[Int[np.ndarray, "e 2"], Float[np.ndarray, " e"]]:
    """The ends of each edge of the faces, and its flat length [cm]: the shorter one where two panels differ."""
    ends = np.concatenate([faces[:, [k, (k + 1) % 3]] for k in range(3)])
    length = np.concatenate([np.linalg.norm(uv[:, (k + 1) % 3] - uv[:, k], axis=1) for k in range(3)])
    low, high = np.sort(ends, axis=1).T
    order = np.lexsort((length, high, low))
    first = order[np.diff(low[order] * np.int64(vertices) + high[order], prepend=-1) != 0]
    return np.stack([low[first], high[first]], axis=1), length[first]


def _distance_from(
    start: Int[np.ndarray, " s"], ends: Int[np.ndarray, "e 2"], length: Float[np.ndarray, " e"], vertices: int
) -> Float[np.ndarray, " v"]:
    """(v) distance of each vertex from the ``start`` vertices along edges [cm]; 0 where no edges lead there."""
    graph = csr_array((length, (ends[:, 0], ends[:, 1])), shape=(vertices, vertices))
    distance = dijkstra(graph, directed=False, indices=start, min_only=True)
    return np.where(np.isfinite(distance), distance, 0.0)


# --------------------------------------------------------------------------------------------------------------- skirt


@dataclass(frozen=True, eq=False)
class _Skirt:
    """The faces of a skirt, its top, front and side seams."""

    mesh: BoxMesh
    faces: Int[np.ndarray, "f 3"]
    uv: Float[np.ndarray, "f 3 2"]
    """Flat positions of the faces' corners [cm]."""
    top: Int[np.ndarray, " t"]
    """Vertices sewn to a bodice or waistband, or held at the waist."""
    front: Bool[np.ndarray, " v"]
    """Marks vertices that belong to front panels only."""
    side: Int[np.ndarray, " s"]
    """Vertices of the side seams, which join front panels and back panels."""

    @staticmethod
    def of(mesh: BoxMesh, skirts: Bool[np.ndarray, " p"]) -> "_Skirt | None":
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
        depth = np.bincount(panel, mesh.vertices[faces].mean(axis=1)[:, 2], minlength=len(skirts))
        ahead = (depth > 0.0)[panel]
        front, back = np.zeros((2, len(mesh.vertices)), bool)
        front[faces[ahead]] = True
        back[faces[~ahead]] = True
        return _Skirt(
            mesh, faces, mesh.uv[mesh.corners[own]], np.flatnonzero(top), front & ~back, np.flatnonzero(front & back)
        )

    @property
    def is_wide(self) -> bool:
        """Whether the skirt reaches further above its top than ``RISE``, or further to a side than ``HALF_WIDTH``."""
        points = self.mesh.vertices[self._vertices]
        return bool(points[:, 1].max() > self._level + RISE or np.abs(points[:, 0]).max() > HALF_WIDTH)

    def place_on_cone(self, trunk: Limb, placed: Float[np.ndarray, "v 3"]) -> None:
        """Set the skirt's rows of ``placed`` to positions on a cone round the trunk [cm].

        The distance of a vertex from the top, along the cloth, becomes its distance down the cone. Its position between
        the side seams becomes its angle round the cone. A skirt without side seams on both sides stays flat.
        """
        if not ((self._aside > 0.0).any() and (self._aside < 0.0).any()):
            return
        rows = self._vertices
        down, turn = self._distance_from_top()[rows], self._turns()[rows]
        trunk = trunk.section(self._level - HIPS, self._level + CLEARANCE)
        sine = self._sine(float(np.percentile(down, 95)))
        out = CLEARANCE + sine * down + WAVE * np.sin(WAVES * turn) * np.minimum(down / HIPS, 1.0)
        placed[rows, 0] = trunk.origin[0] + (trunk.wide + out) * np.sin(turn)
        placed[rows, 1] = self._level - np.sqrt(1.0 - sine**2) * down
        forward = np.where(self.front[rows], 1.0, -1.0)
        placed[rows, 2] = trunk.origin[2] + forward * (trunk.deep + out) * np.cos(turn)

    @cached_property
    def _vertices(self) -> Int[np.ndarray, " n"]:
        return np.unique(self.faces)

    @cached_property
    def _level(self) -> float:
        """Height of the top [cm]."""
        return float(self.mesh.vertices[self.top, 1].mean())

    @cached_property
    def _aside(self) -> Float[np.ndarray, " s"]:
        """1 for vertices of the left side seam, -1 for vertices of the right."""
        return np.sign(self.mesh.vertices[self.side, 0])

    @cached_property
    def _sides(self) -> tuple[Int[np.ndarray, "e 2"], Float[np.ndarray, " e"]]:
        return _flat_sides(self.faces, self.uv, len(self.mesh.vertices))

    def _distance_from_top(self) -> Float[np.ndarray, " v"]:
        return _distance_from(self.top, *self._sides, len(self.mesh.vertices))

    def _turns(self) -> Float[np.ndarray, " v"]:
        """(v) angle of each vertex from the middle of the front or back [rad].

        π/2 on the left side seam, -π/2 on the right; harmonic in the flat cloth between the side seams. The lower limit
        of the cotangent weights is positive, so that no angle exceeds those of the seams.
        """
        n = len(self.mesh.vertices)
        start, end, weight = [], [], []
        for k in range(3):
            a, b = self.uv[:, (k + 1) % 3] - self.uv[:, k], self.uv[:, (k + 2) % 3] - self.uv[:, k]
            twice_area = np.abs(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0])
            start += [self.faces[:, (k + 1) % 3], self.faces[:, (k + 2) % 3]]
            end += [self.faces[:, (k + 2) % 3], self.faces[:, (k + 1) % 3]]
            weight += 2 * [np.maximum((a * b).sum(axis=1) / np.maximum(twice_area, 1e-9), 0.01)]
        i, j, w = (np.concatenate(part) for part in (start, end, weight))
        weights = coo_array((w, (i, j)), shape=(n, n)).tocsr()
        _, piece = connected_components(weights, directed=False)
        bounded = np.isin(piece[self._vertices], piece[self.side])
        laplacian = diags_array(np.asarray(weights.sum(axis=1)).ravel()).tocsr() - weights
        turn = np.zeros(n)
        turn[self.side] = 0.5 * np.pi * self._aside
        free = np.setdiff1d(self._vertices[bounded], self.side)
        turn[free] = spsolve(laplacian[free][:, free].tocsc(), -(laplacian[free][:, self.side] @ turn[self.side]))
        return turn

    def _sine(self, length: float) -> float:
        """Sine of the angle between cone and axis, for a skirt of the given length [cm].

        The mean girth of the skirt is its area over its length. The girth grows twice as much from top to hem as from
        top to mean.
        """
        a, b = self.uv[:, 1] - self.uv[:, 0], self.uv[:, 2] - self.uv[:, 0]
        area = 0.5 * float(np.abs(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]).sum())
        ends, flat = self._sides
        on_top = np.isin(ends, self.top).all(axis=1)
        growth = 2.0 * (area / length - float(flat[on_top].sum()))
        return float(np.clip(growth / (2.0 * np.pi * length), *SINES))


# -------------------------------------------------------------------------------------------------------------- bodice


def _fit_between_arms(
    mesh: BoxMesh, roles: np.ndarray, arm: Limb, side: float, placed: Float[np.ndarray, "v 3"]
) -> None:
    """Compress one side of a bodice below the armhole, in ``placed``, to the room inside the arm.

    The room is the distance from the body's middle to the arm's skin, less ``ARM_GAP``, at the height of each slice.
    ``side``: 1 for the left side, -1 for the right.
    """
    bodice = np.unique(mesh.faces[(roles == PanelRole.BODY)[mesh.panel_id]])
    bodice = bodice[side * mesh.vertices[bodice, 0] > 0.0]
    bodice = np.setdiff1d(bodice, mesh.faces[(roles == PanelRole.ARM)[mesh.panel_id]])
    bodice = bodice[(placed[bodice] == mesh.vertices[bodice]).all(axis=1)]  # without vertices of a skirt on a cone
    height, reach = mesh.vertices[bodice, 1], side * mesh.vertices[bodice, 0]
    slices, arm_slices = (np.floor(y / SLICE).astype(int) for y in (height, arm.skin[:, 1]))
    armhole = mesh.labels.get(EdgeRole.LEFT_ARMHOLE if side > 0.0 else EdgeRole.RIGHT_ARMHOLE)
    armpit = float(arm.skin[:, 1].max()) - ARMPIT
    if armhole is not None and len(armhole):
        armpit = min(armpit, float(mesh.vertices[armhole, 1].min()))
    for number in np.unique(slices[height < armpit]):
        beside = np.abs(arm_slices - number) <= 1
        here = (slices == number) & (height < armpit)
        if beside.any():
            room = float((side * arm.skin[beside, 0]).min()) - ARM_GAP
            if 0.0 < room < reach[here].max():
                placed[bodice[here], 0] *= room / reach[here].max()


# -------------------------------------------------------------------------------------------------------------- sleeve


def _put_on_arm(
    mesh: BoxMesh, roles: np.ndarray, body: Body, arm: Limb, side: float, placed: Float[np.ndarray, "v 3"]
) -> None:
    """Shift and widen the cross sections of a sleeve, in ``placed``, so that each surrounds the arm and the hand.

    A section is the vertices at one distance from the armhole along the cloth. Its middle, in the frontal plane, moves
    to the point of the arm's axis that is as far from the armhole. Sleeves that surround the arm stay as they are.
    """
    own = (roles == PanelRole.ARM)[mesh.panel_id] & (side * mesh.vertices[mesh.faces].mean(axis=1)[:, 0] > 0.0)
    faces = mesh.faces[own]
    armhole = np.intersect1d(faces, mesh.faces[(roles == PanelRole.BODY)[mesh.panel_id]])
    if not len(armhole):
        return
    rows, n = np.unique(faces), len(mesh.vertices)
    away = _distance_from(armhole, *_flat_sides(faces, mesh.uv[mesh.corners[own]], n), n)[rows]
    axis = arm.axis[:2] / np.linalg.norm(arm.axis[:2])
    frame = np.stack([axis, [-axis[1], axis[0]]], axis=1)
    along, across = ((mesh.vertices[rows, :2] - arm.origin[:2]) @ frame).T
    skin = body.vertices[np.isin(body.parts, [BodyPart.HANDS.value]) & (side * body.vertices[:, 0] > 0.0)]
    skin_along, skin_across = ((np.concatenate([arm.skin, skin])[:, :2] - arm.origin[:2]) @ frame).T
    root = float(along[away <= SECTION].mean())
    numbers = np.floor(away / SECTION).astype(int)
    moved, surrounds = np.zeros((len(rows), 2)), True
    for number in np.unique(numbers):
        here, distance = numbers == number, (number + 0.5) * SECTION
        beside = np.abs(skin_along - root - distance) < SECTION
        need = float(np.abs(skin_across[beside]).max(initial=0.0)) + SLEEVE_GAP if beside.any() else 0.0
        low, high = float(across[here].min()), float(across[here].max())
        if distance > SLEEVE_ROOT:
            surrounds &= low <= -need and high >= need
        middle, share = 0.5 * (low + high), min(1.0, distance / SLEEVE_ROOT)
        wider = max(1.0, 2.0 * need / max(high - low, SECTION))
        moved[here, 0] = share * (root + distance - along[here].mean())
        moved[here, 1] = share * (wider * (across[here] - middle) - across[here])
    if not surrounds:
        placed[rows, :2] += moved @ frame.T
