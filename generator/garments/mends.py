"""Mends: faults of GarmentCode's programs that this package corrects. Each can be switched off to compare patterns.

Faults corrected without a switch, since they change neither outlines nor placements:

- every part of an edge that a seam divides keeps the edge's label;
- the order of panels and seams is the same in every run;
- designs are written with all digits, not with three digits;
- crossings are found by distance: edges that touch where both start do not cross, and arcs are tested in full;
- seams do not depend on the path of a solver: curves are closed forms, or solved to rounding;
- a design without upper and bottom, a waistband alone included, is rejected with a reason.

For some curves GarmentCode runs an underdetermined minimiser: a quadratic with one end tangent, the cap of a sleeve,
the seam of a hood. This package meets length and tangents exactly, and otherwise follows the minimiser's results
(``pattern/tangent.py``, ``pattern/cubic_fit.py``).
"""

from enum import Enum

__all__ = ["ALL_MENDS", "Mend"]


class Mend(Enum):
    """A corrected fault; its value describes the drawing of this package and that of GarmentCode."""

    SLIT_LENGTH = (
        "skirt.bottom_cut is a fraction of the skirt below the hips; GarmentCode takes that fraction, "
        "times skirt.length, for centimetres, so slits vanish"
    )
    LEVEL_GIRTH = (
        "a level is as wide as the hem above times level_ruffle; GarmentCode mixes that with the hips by the rise of "
        "the level's own section, and takes a rise that the fitted shirt overrides for the base's length"
    )
    SLEEVE_START = (
        "sleeves start clear of the trunk, drawn out along the arm; GarmentCode's start inside wide or gathered shirts"
    )
    ARMHOLE_ROOM = (
        "an armhole leaves a centimetre of side seam in front and behind; GarmentCode looks at the front alone, along "
        "its slope, and leaves slivers or cuts through a fitted back"
    )
    SLEEVE_SURPLUS = (
        "the surplus of a sleeve's front half over its back moves to the back if it is long enough to sew; GarmentCode "
        "moves any surplus over two millimetres"
    )
    EXPORT_PIVOT = (
        "a panel hangs in the file where it hung in the drawing; GarmentCode moves the drawing's origin to the first "
        "corner by whole centimetres, and the panel by the rest"
    )


ALL_MENDS = frozenset(Mend)
