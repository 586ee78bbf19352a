"""Faults of GarmentCode's programs that ours mend; each can be put back, to compare patterns with GarmentCode's.

Mended without a switch, since no outline or place hangs on them:

- an edge that a seam divides keeps its label on every piece;
- panels and seams have one order, the same in every run;
- designs are written with all their digits, and not three of them;
- crossings are told by distance, so edges that touch at the start of both are no crossing, and arcs are not cut short;
- seams of one design and body never depend on a solver's path: curves are closed forms, or solved to rounding;
- a design without upper and bottom, a belt alone included, is refused with its reason.

In the curves that GarmentCode leaves to a minimiser with too few conditions (one end tangent of a quadratic, the cap of
a sleeve, the seam of a hood), ours meets length and tangents exactly, and follows what the minimiser prefers elsewhere
(``pattern/tangent.py``, ``pattern/cubic_fit.py``).
"""

from enum import Enum

__all__ = ["ALL_MENDS", "Mend"]


class Mend(Enum):
    """One mended fault: what GarmentCode does, and what we do."""

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
        "what a sleeve's front half has over its back moves to the back where it is long enough to sew; GarmentCode "
        "moves all from two millimetres on"
    )
    EXPORT_PIVOT = (
        "a panel hangs in the file where it hung in the drawing; GarmentCode moves the drawing's origin to the first "
        "corner by whole centimetres, and the panel by the rest"
    )


ALL_MENDS = frozenset(Mend)
