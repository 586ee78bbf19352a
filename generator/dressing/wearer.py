"""The body data that dressing uses: levels of the trunk, and axes of trunk and limbs."""

from collections.abc import Mapping
from dataclasses import dataclass

from gcd_dataset.generator.body.limbs import Limb, limbs_of
from gcd_dataset.records import Body, BodyPart, Measurements


@dataclass(frozen=True, eq=False)
class Wearer:
    """A body with levels above the floor [cm] and limbs."""

    nape: float
    armpit: float
    waist: float
    hips: float
    crotch: float
    limbs: Mapping[BodyPart, Limb]
    body: Body


def wearer_of(body: Body, size: Measurements) -> Wearer:
    """The levels and limbs of a body. Raises ``BodyError`` for a missing measure or a body without a trunk."""
    size.require("height", "head_l", "waist_line", "hips_line", "armscye_depth", "crotch_hip_diff")
    nape = size.height - size.head_l
    return Wearer(
        nape=nape,
        armpit=nape - size.armscye_depth,
        waist=size.waist_level,
        hips=size.waist_level - size.hips_line,
        crotch=size.waist_level - size.hips_line - size.crotch_hip_diff,
        limbs=limbs_of(body),
        body=body,
    )
