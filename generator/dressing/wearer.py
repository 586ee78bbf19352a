"""What dressing must know of a wearer: heights on the trunk, and where the arms are."""

from dataclasses import dataclass

from gcd_dataset.generator.drape.limbs import Limb, limbs_of
from gcd_dataset.records import Body, BodyPart, Measurements

__all__ = ["Wearer", "wearer_of"]


@dataclass(frozen=True, eq=False)
class Wearer:
    """Heights over the floor [cm], trunk and arms."""

    nape: float
    armpit: float
    waist: float
    hips: float
    crotch: float
    limbs: dict[BodyPart, Limb]
    body: Body


def wearer_of(body: Body, size: Measurements) -> Wearer:
    """The wearer of that body. Raises ``BodyError`` where a measure is missing, or the body has no trunk."""
    size.require("height", "head_l", "waist_line", "hips_line", "armscye_depth", "crotch_hip_diff")
    nape, hips = size.height - size.head_l, size.waist_level - size.hips_line
    return Wearer(
        nape=nape,
        armpit=nape - size.armscye_depth,
        waist=size.waist_level,
        hips=hips,
        crotch=hips - size.crotch_hip_diff,
        limbs=limbs_of(body),
        body=body,
    )
