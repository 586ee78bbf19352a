"""The ease of a garment: girths and lengths of its cloth, as cut and as worn, beside those of its wearer.

A figure of cloth is the length of a section with a plane, measured in the panels' planes: each crossed triangle
contributes the length of the cut in ``BoxMesh.uv``, so neither stretch nor folds count, nor the extensions of a
buttoned front. As cut, the plane cuts the panels where the pattern has them, see ``placed_as_cut``. A section of a
drape rises and falls in its folds, so it is longer than the cloth is wide. As worn, therefore, a panel counts by the
way across it, with the net rise over it: folds rise and fall again, a tilted section does not.

Planes are level at the trunk, and normal to the axis of the limb at arms and legs: of the right one, or of the left one
if no cloth goes round the right one. A skirt goes round both legs, in a level plane.
"""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import astuple, replace

import numpy as np
from jaxtyping import Float

from gcd_dataset.generator.body.limbs import FRONT, UP, along_arm, leg_of, limbs_of
from gcd_dataset.generator.body.section import Plane, Skin, loops, loose_ends, section, skin_of, unit
from gcd_dataset.generator.dressing.as_cut import placed_as_cut
from gcd_dataset.generator.dressing.flat_cloth import uphill
from gcd_dataset.generator.garments.rules import NECKLINE, neckline_girth
from gcd_dataset.records import EASE, Body, BodyPart, BoxMesh, Ease, Measurements, PanelRole, Pattern
from gcd_dataset.spec import is_trouser_leg

WAIST_SEARCH = np.arange(-3.0, 4.01, 0.5)  # cm about ``waist_level``, which is 0.3 to 2 cm below the waist
NECK_SEARCH = np.arange(0.0, 6.01)  # cm above the nape: the neck is narrowest there
NECK_LEAN = np.radians(20.0)  # slope of the neck's section, down from nape to throat
UPPER_ARM, ELBOW, WRIST = 0.28, 0.56, 1.0  # between shoulder and wrist; the elbow: Drillis and Contini (1966)
KNEE, CALF = 0.6, 0.48  # heights over that of the crotch; the calf of drawn bodies is fullest at 0.46 to 0.5
BELOW_CROTCH = 2.0  # cm: place of the thigh's section
REACH = (-1.0, 1.0, -2.0, 2.0)  # cm: where cloth round bust or waist is looked for, lower and higher
LEGS = (BodyPart.RIGHT_LEG, BodyPart.LEFT_LEG)
ARMS = (BodyPart.RIGHT_ARM, BodyPart.LEFT_ARM)
DECIMALS = 2
NEAR = 2.0  # cm: a seam so near counts by its shorter side, a hem so near as cloth at the landmark
AROUND = 1.99 * np.pi  # rad, about the body: a section over a smaller angle is open, as in a slit or at a sloping hem
RIGHT = np.array([-1.0, 0.0, 0.0])


def ease_of(
    pattern: Pattern, mesh: BoxMesh, body: Body, size: Measurements, vertices: Float[np.ndarray, "v 3"] | None = None
) -> dict[str, Ease]:
    """The ease at each of ``EASE``, with NaN for missing figures; ``vertices``: the drape [cm], ``None`` for none.

    ``body`` is the body that the garment is draped on, ``size`` its measures with the legs together.
    """
    planes, found = planes_of(body, size), dict[str, Ease]()
    as_cut = placed_as_cut(mesh, pattern, body, size, waist=float(planes["waist"][0].centre[1]))
    cut, is_worn = _Cloth(mesh, as_cut, as_cut), vertices is not None and np.isfinite(vertices).all()
    worn = _Cloth(mesh, np.asarray(vertices, float)[mesh.uv_vertex], as_cut) if is_worn else None
    for name, tried in planes.items():
        for plane in tried:
            own = Ease(cut.girth(plane.as_cut), plane.girth(), worn.girth(plane) if worn else np.nan)
            found.setdefault(name, own)
            if np.isfinite([own.cloth, own.worn]).any():
                found[name] = own
                break
    neckline = neckline_girth(pattern) or np.nan
    found["neck"] = replace(found["neck"], cloth=neckline, worn=neckline if worn else np.nan)
    found |= _lengths(cut, planes, mesh, size)
    figures = {name: astuple(found.get(name, Ease())) for name in EASE}
    return {name: Ease(*(round(float(length), DECIMALS) for length in lengths)) for name, lengths in figures.items()}


def _lengths(cut: "_Cloth", planes: Mapping[str, list[Plane]], mesh: BoxMesh, size: Measurements) -> dict[str, Ease]:
    """The lengths of ``EASE`` that such a garment has: halves of sections along the body."""

    def length(plane: Plane, keeps: Callable[[np.ndarray], np.ndarray]) -> float:
        """Length of the cloth at the points (x, y, z) that ``keeps`` accepts [cm]."""
        found = cut.section(plane)
        middle = found[:, :, :3].mean(axis=1) @ plane.frame.T + plane.centre
        return float(_flat_lengths(found)[keeps(middle.T)].sum()) or np.nan

    centre, leg = planes["waist"][0].centre, planes["knee"][0].centre
    waist, crotch = float(centre[1]), float(planes["thigh"][-1].centre[1]) + BELOW_CROTCH
    found, nape = dict[str, Ease](), size.height - size.head_l
    sagittal, frontal = Plane(centre, RIGHT), Plane(centre, FRONT)
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
        up, side = unit(UP - (UP @ arm) * arm), np.sign(elbow[0])
        along = Plane(elbow, np.cross(arm, up), on_arm=True)
        above = length(along, lambda at: (up @ at > up @ elbow) & (side * at[0] > 0.0))
        found["sleeve"] = Ease(above, size.arm_length)
    return found


def planes_of(body: Body, size: Measurements) -> dict[str, list[Plane]]:
    """The planes of each girth, in the order in which they are tried."""
    limbs = limbs_of(body)
    trunk, whole = limbs[BodyPart.TRUNK], skin_of(body, BodyPart.TRUNK, *LEGS)

    def level(height: float, skin: Skin = whole, reach: tuple[float, ...] = ()) -> Plane:
        return Plane(trunk.at_height(height), UP, skin, reach=reach)

    nape = size.height - size.head_l
    waist = _nearest([level(size.waist_level + by) for by in WAIST_SEARCH], size.waist).centre[1]
    bust, hips = nape - size.vert_bust_line, waist - size.hips_line
    behind = np.array([trunk.origin[0], nape, trunk.origin[2] - 0.5 * trunk.deep])
    lean = np.array([0.0, np.cos(NECK_LEAN), np.sin(NECK_LEAN)])
    neck = Plane(behind, lean, skin_of(body, BodyPart.TRUNK, BodyPart.HEAD))
    found = {
        "neck": [_nearest([neck.moved(by) for by in NECK_SEARCH], 0.0)],
        "bust": [level(bust, reach=REACH)],
        "underbust": [level(0.5 * (bust + waist))],
        "waist": [level(waist, reach=REACH)],
        "hips": [level(hips)],
    }
    crotch = hips - size.crotch_hip_diff
    legs = [(part, leg) for part in LEGS if (leg := leg_of(body, part))]
    skins, both = [skin_of(body, part) for part, _ in legs], skin_of(body, *LEGS)
    for name, height in {"thigh": crotch - BELOW_CROTCH, "knee": KNEE * crotch, "calf": CALF * crotch}.items():
        centres = [leg.at_height(height) for _, leg in legs]
        others = centres[::-1] if len(legs) > 1 else [None]
        found[name] = [
            Plane(centre, -leg.axis, skin, beside=other)
            for (_, leg), skin, centre, other in zip(legs, skins, centres, others, strict=False)
        ]
        found[name].append(level(height, both))
    arms = [(limbs[part], skin_of(body, part)) for part in ARMS if part in limbs]
    for name, place in {"upper_arm": UPPER_ARM, "elbow": ELBOW, "wrist": WRIST}.items():
        found[name] = [Plane(along_arm(arm, place), arm.axis, skin, on_arm=True) for arm, skin in arms]
    return found


def _nearest(planes: list[Plane], wanted: float) -> Plane:
    """The plane in which the tape's length is nearest to a girth [cm]."""
    return planes[int(np.argmin(np.nan_to_num([abs(plane.girth() - wanted) for plane in planes], nan=np.inf)))]


class _Cloth:
    """A garment's mesh with a position of each row of ``uv`` [cm], cut or worn, and its position as cut."""

    def __init__(self, mesh: BoxMesh, corners: Float[np.ndarray, "c 3"], as_cut: Float[np.ndarray, "c 3"]) -> None:
        sleeves = np.array([label == PanelRole.ARM for label in mesh.panel_labels])[mesh.panel_id]
        faces = {on_arms: np.flatnonzero(sleeves == on_arms) for on_arms in (False, True)}
        self._faces = {on_arms: (own, mesh.corners[own].T.copy()) for on_arms, own in faces.items()}
        self._mesh, self._corners, self._as_cut = mesh, corners, as_cut

    def section(self, plane: Plane) -> Float[np.ndarray, "s 2 6"]:
        """The section with a plane: segments with their places in its frame, in the panel, and their face."""
        (faces, corners), height = self._faces[plane.on_arm], self._corners @ plane.normal - plane.centre @ plane.normal
        first, second, third = (height > 0.0).take(corners)
        crossed = np.flatnonzero((first != second) | (first != third))
        rows = corners[:, crossed].T.ravel()
        in_frame = (self._corners[rows] - plane.centre) @ plane.frame
        in_frame[:, 0] = height[rows]
        columns = np.column_stack([in_frame, self._mesh.uv[rows], np.repeat(faces[crossed], 3)])
        return section(columns, np.arange(len(rows)).reshape(-1, 3), 0, 0.0)

    def girth(self, plane: Plane) -> float:
        """Girth of the cloth in a plane [cm], NaN where no cloth goes round.

        Where a seam or the hem is within ``NEAR``, that of the side with less cloth: gathers are folded.
        """
        by_panels = dict[frozenset[int], float]()
        for ring in self.rings(plane):
            face, step = ring[:, 0, 5].astype(int), ring[:, 1, 3:5] - ring[:, 0, 3:5]
            panel, corners = self._mesh.panel_id[face], self._mesh.corners[face]
            up = uphill(self._mesh.uv[corners], self._as_cut[corners] @ plane.as_cut.normal)
            across = np.bincount(panel, step[:, 0] * up[:, 1] - step[:, 1] * up[:, 0])
            rise = np.bincount(panel, (step * up).sum(axis=1))
            by_panels.setdefault(frozenset(panel), float(np.hypot(across, rise).sum()))
        return min(by_panels.values(), default=np.nan)

    def rings(self, plane: Plane) -> Iterator[Float[np.ndarray, "s 2 6"]]:
        """The rings in a plane, and ``NEAR`` above and below it; where there are none, those within its reach."""
        for away in (0.0, *plane.reach):
            tried = (self.ring(plane.moved(away + by)) for by in (0.0, NEAR, -NEAR))
            found = (ring for ring in tried if ring is not None)
            if (first := next(found, None)) is not None:
                yield first
                yield from found
                return

    def ring(self, plane: Plane) -> Float[np.ndarray, "s 2 6"] | None:
        """The shortest closed section round the plane's centre; ``None`` where there is none."""
        cut = self.section(plane)
        cut = cut[~loose_ends(cut[:, :, :3])]
        if not len(cut):
            return None
        loop = loops(cut[:, :, :3])
        around = np.abs(np.bincount(loop, _angles(cut, np.zeros(2)))) > AROUND
        if plane.beside is not None:
            around &= np.abs(np.bincount(loop, _angles(cut, ((plane.beside - plane.centre) @ plane.frame)[1:]))) < np.pi
        if not around.any():
            return None
        return cut[loop == np.where(around, np.bincount(loop, _flat_lengths(cut)), np.inf).argmin()]


def _angles(cut: Float[np.ndarray, "s 2 6"], centre: Float[np.ndarray, "2"]) -> Float[np.ndarray, " s"]:
    """The angle over which a point in the plane sees each segment, signed [rad]."""
    (x0, y0), (x1, y1) = (cut[:, end, 1:3].T - centre[:, None] for end in (0, 1))
    return np.arctan2(x0 * y1 - y0 * x1, x0 * x1 + y0 * y1)


def _flat_lengths(cut: Float[np.ndarray, "s 2 6"]) -> Float[np.ndarray, " s"]:
    return np.linalg.norm(cut[:, 1, 3:5] - cut[:, 0, 3:5], axis=1)
