"""Words for the height of a hem on a wearer.

A depth is the distance of a hem below the hips, as a fraction of hips to floor, as ``style.hem_depth``. Words divide
the classes of the tags (``tags.HEMS``) further at the wearer's knee: a "mini", "midi" or "maxi" skirt has that tag.
"""

from gcd_dataset.generator.garments.description import HEMS, Words
from gcd_dataset.records import Measurements

KNEE_HEIGHT = 0.285  # of the body's height: R. Drillis and R. Contini, Body Segment Parameters, 1966
AT_KNEE = 0.05  # of hips to floor: a hem nearer to the knee than this, four to five centimetres, is at the knee
WAIST = (-0.08, 0.4)  # depth of a shirt's hem below the waist, of waist to hips: largest of cropped and of waist-length
HIPS = 0.1  # of hips to floor: largest depth of hip length


def knee_depth(size: Measurements) -> float:
    """Depth of the knee, by the mean proportions of adults: height of the knee 0.285 of the body's."""
    return 1.0 - KNEE_HEIGHT * size.height / size.leg_length


def skirt_words(size: Measurements, depth: float) -> Words:
    """Adjectives for the length of a skirt or dress."""
    knee = knee_depth(size)
    if depth <= min(_mid_thigh(size), HEMS[0]):
        return ("mini",)
    if depth < knee - AT_KNEE:
        return ("above-the-knee",)
    if depth <= knee + AT_KNEE:
        return ("knee-length",)
    if depth <= HEMS[1]:
        return ("below-the-knee",)
    return ("midi", "mid-calf") if depth <= HEMS[2] else ("maxi", "full-length")


def leg_words(size: Measurements, depth: float) -> tuple[Words, Words]:
    """Adjectives for the length of trousers, and names of trousers of this length."""
    knee = knee_depth(size)
    if depth < knee - AT_KNEE:
        return (("very short",) if depth <= _mid_thigh(size) else ("above-the-knee",)), ("shorts",)
    if depth <= knee + AT_KNEE:
        return ("knee-length",), ("shorts",)
    if depth <= HEMS[2]:
        return ("cropped", "calf-length"), ("trousers",)
    return ("long", "full-length"), ("trousers",)


def shirt_words(size: Measurements, below_waist: float) -> tuple[Words, Words]:
    """Adjectives for the length of a shirt, and its names at this length; ``below_waist``: depth of its hem [cm]."""
    if below_waist <= WAIST[0] * size.hips_line:
        return ("cropped",), ("top",)
    if below_waist <= WAIST[1] * size.hips_line:
        return ("waist-length",), ("top",)
    depth = (below_waist - size.hips_line) / size.leg_length
    if depth <= HIPS:
        return ("hip-length",), ("top",)
    if depth <= _mid_thigh(size):
        return ("thigh-length",), ("tunic",)
    return skirt_words(size, depth), ("tunic",)


def _mid_thigh(size: Measurements) -> float:
    """Depth of the middle between crotch and knee."""
    return 0.5 * (size.crotch_hip_diff / size.leg_length + knee_depth(size))
