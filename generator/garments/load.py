"""Cloth as a load: the weight that hangs from shoulder seams or rests on the hips, and the strength of the fabric.

Both limits depend on a fabric's tensile stiffness over its density alone. The default fabric has the largest ratio that
the drape simulates, so the figures hold for every fabric.
"""

from math import pi
from typing import NamedTuple

from gcd_dataset.generator.garments.design import GarmentDesign
from gcd_dataset.generator.garments.outfit import parts
from gcd_dataset.generator.garments.sewable import girth_of_cloth
from gcd_dataset.generator.garments.trunk import girth_at_rise
from gcd_dataset.generator.garments.upper import Shirt
from gcd_dataset.generator.pattern import Component
from gcd_dataset.records import Measurements

GRAVITY = 9.81  # m/s²
STIFFNESS = 500.0  # N·m/kg: tensile stiffness over density of the default fabric, ``drape.fabrics.STIFFEST``
FRICTION = 0.5  # Coulomb coefficient of cloth against skin, as in ``Fabric``
M2 = 1e-4  # m² per cm²
STRAPS_GIVE = 1.4  # largest stretch at shoulder seams: a panel of a clean garment is stretched by 1.5 at most
# Of the flared skirts alone and strapless dresses among 1,000 sampled garments, all eight that slid off carried more
# than this height of cloth holds.
GRIP = 0.5  # height of the cloth that grips the hips, as a share of waist to hips
STRAPLESS_RISE = 0.6  # lowest place of a strapless dress's waist seam, as a rise: 8 cm lower its top bares the breasts
SHOULDERS = frozenset({"shoulder", "left_shoulder"})


class HipLoad(NamedTuple):
    """The cloth of an outfit that hangs from the hips, and the most that they hold [m²]."""

    cloth: float
    held: float

    @property
    def slides(self) -> bool:
        """Whether the hips hold less than hangs from them."""
        return self.cloth > self.held


def strap_stretch(size: Measurements, design: GarmentDesign) -> float:
    """Stretch of the cloth at the shoulder seams under the weight of the outfit; 1 for one without shoulder seams.

    A strap of width w [m] that carries an area A [m²] is stretched by A · density · g / (w · stiffness). All seams
    share the weight, and none rests on the hips: the worst case. Raises ``PatternError`` as ``parts``.
    """
    drawn = parts(size, design)
    width = shoulder_width(drawn[0])
    return 1.0 + _area(drawn) * GRAVITY / (STIFFNESS * 0.01 * width) if width else 1.0


def shoulder_width(upper: Component) -> float:
    """Length of all shoulder edges of an upper [cm]: twice its shoulder seams."""
    return sum(stroke.length for piece in upper.pieces for stroke in piece.outline.strokes if stroke.name in SHOULDERS)


def hip_load(size: Measurements, design: GarmentDesign) -> HipLoad | None:
    """The load on the hips of a flared skirt that does not hang from shoulders; ``None`` for any other outfit.

    Trousers hang from the crotch; pencil and gathered skirts touch the hips all round, and did not slide.

    A ring of cloth with a rest length of L that slides to the hips is stretched by e = hips / L - 1. A cloth h high,
    ``GRIP`` of waist to hips, pulls with T = stiffness · h · e and presses on the hips with 2π T in all, of which
    friction holds 2π μ T. The hips' girth is that of the cloth round them, ``girth_of_cloth``. A strapless dress must
    be held above the hips, at ``STRAPLESS_RISE``.
    Raises ``PatternError`` as ``parts``.
    """
    bottom = design.meta.bottom
    if bottom is None or not _is_off_shoulders(design):
        return None
    if not any(part.flared for part in (bottom.garment, *bottom.garment.parts(design))):
        return None
    drawn = parts(size, design)
    tops = [part.length("top") for part in drawn if "top" in part.interfaces]
    hems = [part.length("bottom") for part in drawn[:-1] if "bottom" in part.interfaces]
    held_at = girth_at_rise(size, STRAPLESS_RISE) if design.meta.upper else size.hips
    stretch = max(girth_of_cloth(held_at) / min(tops + hems) - 1.0, 0.0)
    grip = 0.01 * GRIP * size.hips_line  # m
    return HipLoad(_area(drawn), 2 * pi * FRICTION * STIFFNESS * grip * stretch / GRAVITY)


def _is_off_shoulders(design: GarmentDesign) -> bool:
    """Whether no part of the outfit hangs from a shoulder."""
    upper = design.meta.upper
    if upper is None:
        return True
    garment = upper.garment
    halves = design.halves()
    return isinstance(garment, Shirt) and garment.fitted and bool(halves) and all(half[0].strapless for half in halves)


def _area(drawn: tuple[Component, ...]) -> float:
    """Area of the cloth [m²]."""
    return M2 * sum(abs(piece.outline.area) for part in drawn for piece in part.pieces)
