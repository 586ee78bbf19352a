"""Faults of GarmentCode's programs that ours mend; each can be put back, to compare patterns with GarmentCode's."""

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
