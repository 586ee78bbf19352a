"""The planes in which a tape goes round a body, for its girths and for those of the cloth on it.

Planes are level at the trunk, and normal to the axis of the limb at arms and legs: of the right one, or of the left one
if no cloth goes round the right one. A skirt goes round both legs, in a level plane.
"""

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Self

import numpy as np
from jaxtyping import Float, Int

from gcd_dataset.generator.body.limbs import UP, Limb, leg_of, limbs_of
from gcd_dataset.generator.body.section import girth, section
from gcd_dataset.records import Body, BodyPart, Measurements

WAIST_SEARCH = np.arange(-3.0, 4.01, 0.5)  # cm about ``waist_level``, which is 0.3 to 2 cm below the waist
NECK_SEARCH = np.arange(0.0, 6.01)  # cm above the nape: the neck is narrowest there
NECK_LEAN = np.radians(20.0)  # slope of the neck's section, down from nape to throat
ARM_ENDS = (0.015, 0.963)  # shoulder and wrist, as shares of the length of the body part
UPPER_ARM, ELBOW, WRIST = 0.28, 0.56, 1.0  # between shoulder and wrist; the elbow: Drillis and Contini (1966)
KNEE, CALF = 0.6, 0.48  # heights over that of the crotch; the calf of drawn bodies is fullest at 0.46 to 0.5
BELOW_CROTCH = 2.0  # cm: place of the thigh's section
REACH = (-1.0, 1.0, -2.0, 2.0)  # cm: where cloth round bust or waist is looked for, lower and higher
LEGS = (BodyPart.RIGHT_LEG, BodyPart.LEFT_LEG)
ARMS = (BodyPart.RIGHT_ARM, BodyPart.LEFT_ARM)


@dataclass(frozen=True, eq=False)
class Plane:
    """The plane of a girth."""

    centre: Float[np.ndarray, "3"]
    """A point inside the part of the body that the tape goes round [cm]."""
    normal: Float[np.ndarray, "3"]
    skin: "_Skin | None" = None
    """The parts of the body that the tape goes round."""
    on_arm: bool = False
    beside: Float[np.ndarray, "3"] | None = None
    """A point that the cloth must not go round: inside the other leg."""
    reach: tuple[float, ...] = ()
    """How far from it cloth is looked for that goes all round: below an armhole, above a sloping hem [cm]."""

    @cached_property
    def frame(self) -> Float[np.ndarray, "3 3"]:
        """Columns: the normal, and two unit vectors in the plane."""
        across = unit(np.cross(self.normal, np.eye(3)[np.abs(self.normal).argmin()]))
        return np.stack([self.normal, across, np.cross(self.normal, across)], axis=1)

    @property
    def as_cut(self) -> Self:
        """The plane for cloth as cut: trousers are cut upright."""
        return self if self.on_arm else replace(self, normal=UP)

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


def planes_of(body: Body, size: Measurements) -> dict[str, list[Plane]]:
    """The planes of each girth, in the order in which they are tried."""
    limbs = limbs_of(body)
    trunk, whole = limbs[BodyPart.TRUNK], _skin(body, BodyPart.TRUNK, *LEGS)

    def level(height: float, skin: _Skin = whole, reach: tuple[float, ...] = ()) -> Plane:
        return Plane(_at_height(trunk, height), UP, skin, reach=reach)

    nape = size.height - size.head_l
    waist = _nearest([level(size.waist_level + by) for by in WAIST_SEARCH], size.waist).centre[1]
    bust, hips = nape - size.vert_bust_line, waist - size.hips_line
    behind = np.array([trunk.origin[0], nape, trunk.origin[2] - 0.5 * trunk.deep])
    lean = np.array([0.0, np.cos(NECK_LEAN), np.sin(NECK_LEAN)])
    neck = Plane(behind, lean, _skin(body, BodyPart.TRUNK, BodyPart.HEAD))
    found = {
        "neck": [_nearest([neck.moved(by) for by in NECK_SEARCH], 0.0)],
        "bust": [level(bust, reach=REACH)],
        "underbust": [level(0.5 * (bust + waist))],
        "waist": [level(waist, reach=REACH)],
        "hips": [level(hips)],
    }
    crotch = hips - size.crotch_hip_diff
    legs = [(part, leg) for part in LEGS if (leg := leg_of(body, part))]
    skins, both = [_skin(body, part) for part, _ in legs], _skin(body, *LEGS)
    for name, height in {"thigh": crotch - BELOW_CROTCH, "knee": KNEE * crotch, "calf": CALF * crotch}.items():
        centres = [_at_height(leg, height) for _, leg in legs]
        others = centres[::-1] if len(legs) > 1 else [None]
        found[name] = [
            Plane(centre, -leg.axis, skin, beside=other)
            for (_, leg), skin, centre, other in zip(legs, skins, centres, others, strict=False)
        ]
        found[name].append(level(height, both))
    arms = [(limbs[part], _skin(body, part)) for part in ARMS if part in limbs]
    for name, place in {"upper_arm": UPPER_ARM, "elbow": ELBOW, "wrist": WRIST}.items():
        found[name] = [Plane(along_arm(arm, place), arm.axis, skin, on_arm=True) for arm, skin in arms]
    return found


def _nearest(planes: list[Plane], wanted: float) -> Plane:
    """The plane in which the tape's length is nearest to a girth [cm]."""
    return planes[int(np.argmin(np.nan_to_num([abs(plane.girth() - wanted) for plane in planes], nan=np.inf)))]


def unit(vector: Float[np.ndarray, "3"]) -> Float[np.ndarray, "3"]:
    return vector / np.linalg.norm(vector)


def _at_height(limb: Limb, height: float) -> Float[np.ndarray, "3"]:
    """The point of a limb's axis at a height [cm]."""
    return limb.origin + (height - limb.origin[1]) / limb.axis[1] * limb.axis


def along_arm(arm: Limb, place: float) -> Float[np.ndarray, "3"]:
    """The point of an arm's axis at a place between shoulder, 0, and wrist, 1 [cm]."""
    along = (arm.skin - arm.origin) @ arm.axis
    start, end = along.min() + np.array(ARM_ENDS) * np.ptp(along)
    return arm.origin + (start + place * (end - start)) * arm.axis
