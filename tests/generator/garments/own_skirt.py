"""A skirt outside the wardrobe, written as the docstring of ``generator.garments`` describes."""

from dataclasses import dataclass

from gcd_dataset.generator.garments.garment import Cutting, SimpleBottom
from gcd_dataset.generator.garments.panel_shapes import skirt_panel
from gcd_dataset.generator.garments.skirt import length_below_waist, waist_ring
from gcd_dataset.generator.garments.space import Design, real
from gcd_dataset.generator.garments.trunk import back_at_rise, girth_at_rise
from gcd_dataset.generator.pattern import Component
from gcd_dataset.records import Measurements


@dataclass(frozen=True)
class OwnSkirtDesign(Design):
    """A skirt that widens to its hem."""

    length: float = real(0.3, 0.1, 0.9)
    """Below the hips, as a fraction of hips to floor."""
    rise: float = real(1.0, 0.5, 1.0)
    """Position of the top: 0 at the hips, 1 at the waist."""
    spread: float = real(0.3, 0.0, 0.6)
    """Width added to each side of the hem, as a fraction of the length."""


def own_skirt(size: Measurements, design: OwnSkirtDesign, cutting: Cutting) -> Component:
    """Two trapezoids sewn at the sides; offers the ring ``top``."""
    width, length = back_at_rise(size, cutting.rise), cutting.length
    widths = {"front": girth_at_rise(size, cutting.rise) - width, "back": width}
    front, back = (
        skirt_panel(f"own_skirt_{name}", widths[name], length, flare=design.spread * length).at(0, size.waist_level, z)
        for name, z in (("front", 25.0), ("back", -20.0))
    )
    return (
        Component.of(front, back)
        .sewn(front.along("right"), back.along("right"))
        .sewn(front.along("left"), back.along("left"))
        .offering(top=waist_ring(size, front, back))
    )


OWN_SKIRT = SimpleBottom(
    name="OwnSkirt",
    section="own-skirt",
    design=OwnSkirtDesign,
    cut=own_skirt,
    length_of=lambda size, design, rise: length_below_waist(size, design.length, rise=rise),
)
