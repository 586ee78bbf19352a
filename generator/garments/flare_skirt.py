"""The design section of flared skirts: skirts cut from circles of cloth, or from widening panels."""

from dataclasses import dataclass

from gcd_dataset.generator.garments.skirt import SHORTEST, length_below_waist
from gcd_dataset.generator.garments.space import Design, choice, flag, integer, part, real
from gcd_dataset.generator.garments.tags import Tag
from gcd_dataset.records import Measurements

VERY_FULL = 1.5  # suns
CIRCLES = ((0.375, Tag.A_LINE), (0.75, Tag.HALF_CIRCLE))  # upper bounds of a skirt's suns


@dataclass(frozen=True)
class PanelSkirtDesign(Design):
    """The division of a flared skirt into panels."""

    n_panels: int = integer(4, 4, 15)
    panel_curve: float = choice(0, -0.35, -0.25, -0.15, 0, 0.15, 0.25, 0.35, 0.45)
    """Bulge of each panel's hem: sagitta over chord, positive outwards."""


@dataclass(frozen=True)
class HemCutDesign(Design):
    """A triangular cut in the hem."""

    add: bool = flag(False, keep=0.6)
    depth: float = real(0.5, 0.05, 0.95, keep=0.6)
    """Depth of the cut, as a fraction of the skirt's length."""
    width: float = real(0.1, 0.05, 0.4)
    """Width of the cut at the hem, as a fraction of the skirt's length."""
    place: float = real(-0.5, -1.0, 1.0)
    """Centre of the cut: if positive, in the front, as a fraction of its hem from the wearer's right; if negative, in
    the back, as a fraction of its hem from the wearer's left."""


@dataclass(frozen=True)
class AsymmetricSkirtDesign(Design):
    """A circle skirt with its waist cut off centre."""

    front_length: float = real(0.5, 0.1, 0.9, keep=0.5)
    """Length at the middle of the front, as a fraction of the length behind."""


@dataclass(frozen=True)
class FlareSkirtDesign(Design):
    """A skirt cut from circles of cloth, or of panels that widen downwards."""

    length: float = real(0.2, -0.2, 0.95)
    """Depth of the hem below the hips as worn, with or without a waistband, as a fraction of hips to floor."""
    rise: float = real(1.0, 0.5, 1.0, keep=0.3)
    """Where the top sits: 0 at the hips, 1 at the waist."""
    suns: float = real(0.75, 0.1, 1.95)
    """Number of full circles that front and back together are cut from."""
    skirt_many_panels: PanelSkirtDesign = part(PanelSkirtDesign, key="skirt-many-panels")
    asymm: AsymmetricSkirtDesign = part(AsymmetricSkirtDesign)
    cut: HemCutDesign = part(HemCutDesign)


def flare_tag(design: FlareSkirtDesign) -> Tag:
    """The tag of a flared skirt by its share of a circle."""
    return next((tag for most, tag in CIRCLES if design.suns < most), Tag.CIRCLE)


def flare_nouns(design: FlareSkirtDesign) -> tuple[str, ...]:
    """Names of a flared skirt by its share of a circle: the tag, and for over a circle and a half its fullness."""
    tag = flare_tag(design)
    if tag is Tag.A_LINE:
        return ("A-line skirt",)
    return ("very full circle skirt",) if design.suns >= VERY_FULL else (tag.value,)


def flare_skirt_length(size: Measurements, design: FlareSkirtDesign, rise: float) -> float:
    """Length from the top to the hem along the cloth [cm]; along the back if the front is shorter."""
    return max(length_below_waist(size, design.length, rise=rise), SHORTEST)
