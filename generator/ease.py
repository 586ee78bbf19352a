"""The ease of a garment: girths and lengths of its cloth, as cut and as worn, beside those of its wearer.

Every figure of cloth is the length of a section with a plane, measured in the panels' planes: each crossed triangle
contributes the length of the cut in ``BoxMesh.uv``, so neither stretch nor folds count. As worn, the plane cuts the
drape. As cut, it cuts the panels where they are placed before sewing, moved in the frontal plane until their seams meet
as well as rigid panels can, and skirts at one distance from their upper edge.

Planes are level at the trunk, and normal to the axis of the limb at arms and legs: of the right one, or of the left one
if no cloth goes round the right one. A skirt goes round both legs, in a level plane.
"""

from collections.abc import Callable, Mapping
from dataclasses import astuple, dataclass, field, replace
from functools import cached_property
from typing import Self

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial.distance import cdist

from gcd_dataset.generator.body.limbs import FRONT, UP, Limb, leg_of, limbs_of
from gcd_dataset.generator.body.section import girth, loops, section
from gcd_dataset.records import EASE, Body, BodyPart, BoxMesh, Ease, EdgeRole, Measurements, PanelRole, Pattern
from gcd_dataset.spec import is_trouser_leg

WAIST_SEARCH = np.arange(-3.0, 4.01, 0.5)  # cm about ``waist_level``, which is 0.3 to 2 cm below the waist
NECK_SEARCH = np.arange(0.0, 6.01)  # cm above the nape: the neck is narrowest there
NECK_WIDTH = 0.8  # straight width of the neck over neck_w, which is measured round the back of the neck
NECK_LEAN = np.radians(20.0)  # slope of the neck's section, down from nape to throat
ARM_ENDS = (0.015, 0.963)  # shoulder and wrist, as shares of the length of the body part
UPPER_ARM, ELBOW, WRIST = 0.28, 0.56, 1.0  # between shoulder and wrist; the elbow: Drillis and Contini (1966)
KNEE, CALF = 0.6, 0.48  # heights over that of the crotch; the calf of drawn bodies is fullest at 0.46 to 0.5
DECIMALS = 2
BELOW_CROTCH = 2.0  # cm: place of the thigh's section
NEAR = 2.0  # cm: a seam so near counts by its shorter side, a hem so near as cloth at the landmark
LOWERED = 2.0  # cm: how far a section at bust or waist may be lowered; with NEAR, cloth counts to 4 cm below
AROUND = 1.9 * np.pi  # rad, about the body: a section over a smaller angle is open, as in a slit or at a sloping hem
RIGHT = np.array([-1.0, 0.0, 0.0])
LEGS = (BodyPart.RIGHT_LEG, BodyPart.LEFT_LEG)
ARMS = (BodyPart.RIGHT_ARM, BodyPart.LEFT_ARM)
NECKLINE = frozenset({EdgeRole.LEFT_COLLAR, EdgeRole.RIGHT_COLLAR})


def ease_of(
    pattern: Pattern, mesh: BoxMesh, body: Body, size: Measurements, vertices: Float[np.ndarray, "v 3"] | None = None
) -> dict[str, Ease]:
    """The ease at each of ``EASE``, with NaN for missing figures; ``vertices``: the drape [cm], ``None`` for none.

    ``body`` is the body that the garment is draped on, ``size`` its measures with the legs together.
    """
    cut = _Cloth(mesh, hung(mesh, pattern, size))
    is_worn = vertices is not None and np.isfinite(vertices).all()
    worn = _Cloth(mesh, np.asarray(vertices, float)[mesh.uv_vertex]) if is_worn else None
    planes, found = _planes(body, size), dict[str, Ease]()
    for name, tried in planes.items():
        for plane in tried:
            on_panels = replace(plane, normal=plane.drawn)
            own = Ease(cut.girth(on_panels), plane.girth(), worn.girth(plane) if worn else np.nan)
            found.setdefault(name, own)
            if np.isfinite([own.cloth, own.worn]).any():
                found[name] = own
                break
    edges = [edge for panel in pattern.panels for edge in zip(panel.edges, panel.edge_lengths(), strict=True)]
    neckline = sum(length for edge, length in edges if edge.label in NECKLINE) or np.nan
    found["neck"] = replace(found["neck"], cloth=neckline, worn=neckline if worn else np.nan)
    found |= _lengths(cut, planes, mesh, size)
    figures = {name: astuple(found.get(name, Ease())) for name in EASE}
    return {name: Ease(*(round(float(length), DECIMALS) for length in lengths)) for name, lengths in figures.items()}


def hung(mesh: BoxMesh, pattern: Pattern, size: Measurements) -> Float[np.ndarray, "c 3"]:
    """Each row of ``mesh.uv`` in space, before sewing [cm]: panels as placed, moved in x and y so that seams meet best.

    Programs place the parts of a garment with gaps. A garment with a neckline hangs from the sides of the neck, a
    strapless one from the armpits, any other keeps the height of its largest part. Sleeves begin at the shoulder seam.
    """
    sleeves, panel, placed = _on_sleeves(mesh), _panel_of_rows(mesh), np.empty((len(mesh.uv), 3))
    for row, each in enumerate(pattern.panels):
        placed[panel == row] = each.placement.apply(mesh.uv[panel == row])
    # Sleeves and the rest are two garments, since the flat trunk is wider than the body.
    ends = np.unique(2 * mesh.uv_vertex + sleeves[panel], return_inverse=True)[1]
    count = np.bincount(ends)

    def joined(values: Float[np.ndarray, " c"]) -> Float[np.ndarray, " c"]:
        return (np.bincount(ends, values) / count)[ends]

    shares = np.eye(len(pattern.panels))[panel].T  # of each panel in the place of each row
    apart = np.stack([share - joined(share) for share in shares], axis=1)
    seams = count[ends] > 1
    anchor = _anchor(mesh, sleeves)
    for axis in (0, 1):
        gaps = placed[:, axis] - joined(placed[:, axis])
        moves = np.linalg.lstsq(apart[seams], -gaps[seams], rcond=None)[0]
        placed[:, axis] += (moves - moves[anchor])[panel]
    placed = np.stack([joined(column) for column in placed.T], axis=1)
    placed[:, 1] = _heights(mesh, placed, panel == anchor, size)
    placed[:, 1] = joined(_below_top(mesh, placed[:, 1]))
    for side in (-1.0, 1.0):
        own = sleeves[panel] & (side * placed[:, 0] > 0.0)
        shoulders = ~sleeves[panel] & np.isin(mesh.uv_vertex, mesh.uv_vertex[own])
        if shoulders.any():
            top = np.flatnonzero(shoulders)[placed[shoulders, 1].argmax()]
            cap = np.flatnonzero(own & (mesh.uv_vertex == mesh.uv_vertex[top]))[0]
            placed[own, :2] += placed[top, :2] - placed[cap, :2]
    return placed


def _anchor(mesh: BoxMesh, sleeves: np.ndarray) -> int:
    """The panel of the trunk, or of all where none is labelled, with the most faces."""
    on_trunk = np.array([label == PanelRole.BODY for label in mesh.panel_labels])
    faces = np.bincount(mesh.panel_id, minlength=len(on_trunk))
    return int(np.argmax(np.where(on_trunk if on_trunk.any() else ~sleeves, faces, 0)))


def _heights(
    mesh: BoxMesh, placed: Float[np.ndarray, "c 3"], on_anchor: np.ndarray, size: Measurements
) -> Float[np.ndarray, " c"]:
    """Heights of the rows of ``mesh.uv`` on the body [cm]: moved up to hang from neck or armpits.

    From the side of the neck to the waist, cloth is as long as the way over the bust, and longer than their difference
    in height.
    """
    nape, height = size.height - size.head_l, placed[:, 1]
    for labels in (NECKLINE, {EdgeRole.STRAPLESS_TOP}):
        held = np.concatenate([np.zeros(0, int), *(ids for label, ids in mesh.labels.items() if label in labels)])
        rows = np.flatnonzero(np.isin(mesh.uv_vertex, held) & on_anchor)
        if len(rows):
            beside, top, _ = placed[rows[height[rows].argmax()]]
            if labels is not NECKLINE:
                return height + (nape - size.armscye_depth - top)
            start = nape - max(abs(beside) - 0.5 * NECK_WIDTH * size.neck_w, 0.0) * np.tan(size.shoulder_incl)
            excess = size.waist_over_bust_line - (nape - size.waist_level)
            share = ((top - height) / size.waist_over_bust_line).clip(0.0, 1.0)
            return start - (top - height) + share * excess
    return height


def _below_top(mesh: BoxMesh, heights: Float[np.ndarray, " c"]) -> Float[np.ndarray, " c"]:
    """The heights, in skirts those of the nearest place of the upper edge less the distance from it [cm].

    So a section of a circle skirt is an arc. The upper edge of a skirt is sewn to the trunk's panels or labelled, that
    of a tier or godet is sewn to the panels above.
    """
    panel, heights = _panel_of_rows(mesh), heights.copy()
    waiting = {
        row
        for row, (name, label) in enumerate(zip(mesh.panel_names, mesh.panel_labels, strict=True))
        if label == PanelRole.LEG and not is_trouser_leg(name)
    }
    top = np.zeros(len(mesh.vertices), bool)
    top[np.asarray(mesh.labels.get(EdgeRole.LOWER_INTERFACE, ()), int)] = True
    beside = np.unique(mesh.faces[top[mesh.faces].any(axis=1)])
    top[beside[beside < mesh.n_seam_vertices]] = True  # the ends of the edge, on seams, have no label
    known = np.full(len(mesh.vertices), np.nan)
    for own in (~np.isin(panel, list(waiting)), top[mesh.uv_vertex]):
        known[mesh.uv_vertex[own]] = heights[own]
    sides = np.concatenate([mesh.corners[:, [k, (k + 1) % 3]] for k in range(3)])
    while waiting:
        upper = np.isfinite(known)[mesh.uv_vertex]
        edges = sides[upper[sides].all(axis=1) & np.isin(panel[sides[:, 0]], list(waiting))]
        found = waiting & set(panel[edges[:, 0]].tolist())
        if not found:
            break
        for each in found:
            (start, end), rows = edges[panel[edges[:, 0]] == each].T, np.flatnonzero(panel == each)
            ends = np.column_stack([mesh.uv, known[mesh.uv_vertex]])
            along = np.concatenate([(1 - t) * ends[start] + t * ends[end] for t in np.linspace(0.0, 1.0, 9)])
            heights[rows] = (along[:, 2] - cdist(mesh.uv[rows], along[:, :2])).max(axis=1)
        for each in found:
            known[mesh.uv_vertex[panel == each]] = heights[panel == each]
        waiting -= found
    return heights


def _panel_of_rows(mesh: BoxMesh) -> np.ndarray:
    """(c) the panel of each row of ``mesh.uv``."""
    panel = np.zeros(len(mesh.uv), int)
    panel[mesh.corners] = mesh.panel_id[:, None]
    return panel


def _on_sleeves(mesh: BoxMesh) -> np.ndarray:
    """(p) whether each panel belongs to a sleeve."""
    return np.array([label == PanelRole.ARM for label in mesh.panel_labels])


# -------------------------------------------------------------------------------------------------------------- planes


@dataclass(frozen=True, eq=False)
class _Plane:
    """The plane of a girth."""

    centre: Float[np.ndarray, "3"]
    """A point inside the part of the body that the tape goes round [cm]."""
    normal: Float[np.ndarray, "3"]
    skin: "_Skin | None" = None
    """The parts of the body that the tape goes round."""
    on_arm: bool = False
    beside: Float[np.ndarray, "3"] | None = None
    """A point that the cloth must not go round: inside the other leg."""
    drawn: Float[np.ndarray, "3"] = field(default_factory=lambda: UP)
    """The normal on placed panels: trousers are placed upright, sleeves along the arm in the frontal plane."""
    lower: float = 0.0
    """How far down cloth is looked for that goes all round: below an armhole, or on a body wider than the band [cm]."""

    @cached_property
    def frame(self) -> Float[np.ndarray, "3 3"]:
        """Columns: the normal, and two unit vectors in the plane."""
        across = _unit(np.cross(self.normal, np.eye(3)[np.abs(self.normal).argmin()]))
        return np.stack([self.normal, across, np.cross(self.normal, across)], axis=1)

    def moved(self, by: float) -> Self:
        """The plane moved along its normal [cm]."""
        return replace(self, centre=self.centre + by * self.normal)

    def girth(self) -> float:
        """Length of a tape round the skin [cm]; NaN where there is none."""
        assert self.skin is not None
        vertices, faces = self.skin
        cut = section((vertices - self.centre) @ self.frame, faces, 0, 0.0)
        return girth(cut.reshape(-1, 3)[:, 1:]) if len(cut) else np.nan


_Skin = tuple[Float[np.ndarray, "v 3"], Int[np.ndarray, "f 3"]]  # vertices and faces of parts of a body


def _skin(body: Body, *parts: BodyPart) -> _Skin:
    own = np.isin(body.parts, [part.value for part in parts])
    a, b, c = body.faces.T
    return np.asarray(body.vertices[own], float), (np.cumsum(own) - 1)[body.faces[own[a] & own[b] & own[c]]]


def _planes(body: Body, size: Measurements) -> dict[str, list[_Plane]]:
    """The planes of each girth, in the order in which they are tried."""
    limbs = limbs_of(body)
    trunk, whole = limbs[BodyPart.TRUNK], _skin(body, BodyPart.TRUNK, *LEGS)

    def level(height: float, skin: _Skin = whole, lower: float = 0.0) -> _Plane:
        return _Plane(_at_height(trunk, height), UP, skin, lower=lower)

    nape = size.height - size.head_l
    waist = _nearest([level(size.waist_level + by) for by in WAIST_SEARCH], size.waist).centre[1]
    bust, hips = nape - size.vert_bust_line, waist - size.hips_line
    behind = np.array([trunk.origin[0], nape, trunk.origin[2] - 0.5 * trunk.deep])
    lean = np.array([0.0, np.cos(NECK_LEAN), np.sin(NECK_LEAN)])
    neck = _Plane(behind, lean, _skin(body, BodyPart.TRUNK, BodyPart.HEAD))
    found = {
        "neck": [_nearest([neck.moved(by) for by in NECK_SEARCH], 0.0)],
        "bust": [level(bust, lower=LOWERED)],
        "underbust": [level(0.5 * (bust + waist))],
        "waist": [level(waist, lower=LOWERED)],
        "hips": [level(hips)],
    }
    crotch = hips - size.crotch_hip_diff
    legs = [(part, leg) for part in LEGS if (leg := leg_of(body, part))]
    skins, both = [_skin(body, part) for part, _ in legs], _skin(body, *LEGS)
    for name, height in {"thigh": crotch - BELOW_CROTCH, "knee": KNEE * crotch, "calf": CALF * crotch}.items():
        centres = [_at_height(leg, height) for _, leg in legs]
        others = centres[::-1] if len(legs) > 1 else [None]
        found[name] = [
            _Plane(centre, -leg.axis, skin, beside=other)
            for (_, leg), skin, centre, other in zip(legs, skins, centres, others, strict=False)
        ]
        found[name].append(level(height, both))
    arms = [(limbs[part], _skin(body, part)) for part in ARMS if part in limbs]
    for name, place in {"upper_arm": UPPER_ARM, "elbow": ELBOW, "wrist": WRIST}.items():
        found[name] = [
            _Plane(_along(arm, place), arm.axis, skin, on_arm=True, drawn=_unit(arm.axis * (1.0, 1.0, 0.0)))
            for arm, skin in arms
        ]
    return found


def _nearest(planes: list[_Plane], wanted: float) -> _Plane:
    """The plane in which the tape's length is nearest to a girth [cm]."""
    return planes[int(np.argmin(np.nan_to_num([abs(plane.girth() - wanted) for plane in planes], nan=np.inf)))]


def _unit(vector: Float[np.ndarray, "3"]) -> Float[np.ndarray, "3"]:
    return vector / np.linalg.norm(vector)


def _at_height(limb: Limb, height: float) -> Float[np.ndarray, "3"]:
    """The point of a limb's axis at a height [cm]."""
    return limb.origin + (height - limb.origin[1]) / limb.axis[1] * limb.axis


def _along(arm: Limb, place: float) -> Float[np.ndarray, "3"]:
    """The point of an arm's axis at a place between shoulder, 0, and wrist, 1 [cm]."""
    along = (arm.skin - arm.origin) @ arm.axis
    start, end = along.min() + np.array(ARM_ENDS) * np.ptp(along)
    return arm.origin + (start + place * (end - start)) * arm.axis


def _lengths(cut: "_Cloth", planes: Mapping[str, list[_Plane]], mesh: BoxMesh, size: Measurements) -> dict[str, Ease]:
    """The lengths of ``EASE`` that such a garment has: halves of sections along the body."""

    def length(plane: _Plane, keeps: Callable[[np.ndarray], np.ndarray]) -> float:
        """Length of the cloth at the points (x, y, z) that ``keeps`` accepts [cm]."""
        found = cut.section(plane)
        middle = found[:, :, :3].mean(axis=1) @ plane.frame.T + plane.centre
        return float(_flat_lengths(found)[keeps(middle.T)].sum()) or np.nan

    centre, leg = planes["waist"][0].centre, planes["knee"][0].centre
    waist, crotch = float(centre[1]), float(planes["thigh"][-1].centre[1]) + BELOW_CROTCH
    found, nape = dict[str, Ease](), size.height - size.head_l
    sagittal, frontal = _Plane(centre, RIGHT), _Plane(centre, FRONT)
    has_legs = any(map(is_trouser_leg, mesh.panel_names))
    if NECKLINE & mesh.labels.keys() and not has_legs:
        behind = length(sagittal, lambda at: (at[2] < centre[2]) & (at[1] < nape + NEAR))
        found["back"] = Ease(behind, size.waist_line)
    if PanelRole.LEG in mesh.panel_labels:
        found["outseam"] = Ease(length(frontal, lambda at: (at[0] < leg[0]) & (at[1] < waist + NEAR)), waist)
    if has_legs:
        inside = length(frontal, lambda at: (at[0] > leg[0]) & (at[0] < 0.0) & (at[1] < crotch))
        found["inseam"] = Ease(inside, crotch)
    if planes["elbow"]:
        elbow, arm = planes["elbow"][0].centre, planes["elbow"][0].normal
        up, side = _unit(UP - (UP @ arm) * arm), np.sign(elbow[0])
        along = _Plane(elbow, np.cross(arm, up), on_arm=True)
        above = length(along, lambda at: (up @ at > up @ elbow) & (side * at[0] > 0.0))
        found["sleeve"] = Ease(above, size.arm_length)
    return found


# --------------------------------------------------------------------------------------------------------------- cloth


class _Cloth:
    """A garment's mesh with a position of each row of ``uv`` [cm]: cut or worn."""

    def __init__(self, mesh: BoxMesh, corners: Float[np.ndarray, "c 3"]) -> None:
        sleeves = _on_sleeves(mesh)[mesh.panel_id]
        self._faces = {on_arms: mesh.corners[sleeves == on_arms] for on_arms in (False, True)}
        self._corners, self._flat = corners, np.column_stack([mesh.uv, _panel_of_rows(mesh)])

    def section(self, plane: _Plane) -> Float[np.ndarray, "s 2 6"]:
        """The section with a plane: segments with the coordinates in its frame, in the panel, and the panel's row."""
        faces, height = self._faces[plane.on_arm], self._corners @ plane.normal - plane.centre @ plane.normal
        first, second, third = (height > 0.0)[faces].T
        rows = faces[(first != second) | (first != third)].ravel()
        in_frame = (self._corners[rows] - plane.centre) @ plane.frame
        in_frame[:, 0] = height[rows]
        cut = np.concatenate([in_frame, self._flat[rows]], axis=1)
        return section(cut, np.arange(len(rows)).reshape(-1, 3), 0, 0.0)

    def girth(self, plane: _Plane) -> float:
        """Girth of the cloth in a plane [cm], NaN where no cloth goes round.

        Where a seam or the hem is within ``NEAR``, that of the side with less cloth: gathers are folded.
        """
        for lowered in np.arange(0.0, plane.lower + NEAR, NEAR):
            here, *beside = (self._ring(plane.moved(by - lowered)) for by in (0.0, NEAR, -NEAR))
            found = [here[0], *(length for length, panels in beside if panels != here[1])]
            if np.isfinite(found).any():
                return float(np.nanmin(found))
        return np.nan

    def _ring(self, plane: _Plane) -> tuple[float, frozenset[int]]:
        """Length of the shortest closed section round the plane's centre, and the panels that it runs over."""
        cut = self.section(plane)
        if not len(cut):
            return np.nan, frozenset()
        loop, length = loops(cut[:, :, :3]), _flat_lengths(cut)
        around = np.abs(np.bincount(loop, _angles(cut, np.zeros(2)))) > AROUND
        if plane.beside is not None:
            around &= np.abs(np.bincount(loop, _angles(cut, ((plane.beside - plane.centre) @ plane.frame)[1:]))) < np.pi
        lengths = np.where(around, np.bincount(loop, length), np.inf)
        shortest = int(lengths.argmin())
        if not around[shortest]:
            return np.nan, frozenset()
        return float(lengths[shortest]), frozenset(cut[loop == shortest, 0, 5].astype(int).tolist())


def _angles(cut: Float[np.ndarray, "s 2 6"], centre: Float[np.ndarray, "2"]) -> Float[np.ndarray, " s"]:
    """The angle over which a point in the plane sees each segment, signed [rad]."""
    (x0, y0), (x1, y1) = (cut[:, end, 1:3].T - centre[:, None] for end in (0, 1))
    return np.arctan2(x0 * y1 - y0 * x1, x0 * x1 + y0 * y1)


def _flat_lengths(cut: Float[np.ndarray, "s 2 6"]) -> Float[np.ndarray, " s"]:
    return np.linalg.norm(cut[:, 1, 3:5] - cut[:, 0, 3:5], axis=1)
