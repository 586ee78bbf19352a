"""Mends: faults of GarmentCode's programs that this package corrects. Each can be switched off to compare patterns.

Faults corrected without a switch, since they change neither outlines nor placements:

- every part of an edge that a seam divides keeps the edge's label;
- the order of panels and seams is the same in every run;
- designs are written with all digits, not with three digits;
- crossings are found by distance: edges with a common start do not cross there, and whole arcs are tested;
- seam curves do not depend on a solver's path: they are closed forms, or converged to rounding error;
- a design without upper and bottom, a waistband alone included, is rejected with a reason.

For some curves GarmentCode runs an underdetermined minimiser: a quadratic with one end tangent, the cap of a sleeve,
the seam of a hood. This package meets length and tangents exactly, and otherwise follows the minimiser's results
(``pattern/cubic_fit.py``).
"""

from enum import Enum

from gcd_dataset.faults import NARROWEST_DART


class Mend(Enum):
    """A corrected fault; its value compares the drawings of this package and of GarmentCode."""

    SLIT_LENGTH = (
        "skirt.bottom_cut is a fraction of the skirt below the hips; GarmentCode reads "
        "skirt.bottom_cut * skirt.length, a fraction, as centimetres, so slits vanish"
    )
    LEVEL_GIRTH = (
        "a level is as wide as the hem above times level_ruffle; GarmentCode interpolates between that width and the "
        "hips by the rise of the level's own section, and computes the base's length from levels-skirt.rise even where "
        "a fitted shirt overrides it"
    )
    WORN_LENGTH = (
        "a bottom begins at the lower edge of its waistband, so that hips and hem hang where its length says; "
        "GarmentCode lowers a band that would rise above the waist, but draws the bottom from its rise, so that it "
        "hangs lower by up to the band's height"
    )
    FOLDED_DART = (
        "a dart under half a centimetre is left out, and the side seam takes in its width; GarmentCode draws darts of "
        "any width, down to tenths of a millimetre"
    )
    SLEEVE_START = (
        "sleeves start clear of the trunk, moved out along the arm; GarmentCode's sleeves start inside wide or "
        "gathered shirts"
    )
    ARMHOLE_ROOM = (
        "an armhole leaves a centimetre of side seam in front and behind; GarmentCode limits the depth by the front "
        "side's length alone, which leaves slivers, or cuts through a fitted back"
    )
    SLEEVE_SURPLUS = (
        "the surplus of a sleeve's front half over its back moves to the back if it is long enough to sew; GarmentCode "
        "moves any surplus over two millimetres"
    )
    EXPORT_PIVOT = (
        "a panel has the same position in the file as in the drawing; GarmentCode moves the drawing's origin to the "
        "first corner in whole centimetres, so that the panel shifts by the remaining fraction"
    )


ALL_MENDS = frozenset(Mend)


def folds(width: float, mends: frozenset[Mend]) -> bool:
    """Whether a dart of this width [cm] is left out, and its width taken in at the side seam."""
    return Mend.FOLDED_DART in mends and width < NARROWEST_DART
