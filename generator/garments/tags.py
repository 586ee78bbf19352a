"""Tags: the tailor's names for the style of an outfit, a closed vocabulary.

They state what is drawn. The description of a garment (``Garment.describe``) holds its tags, beside the words of the
same facts for captions. ``style.outfit_tags`` collects them and adds the tags of the outfit as a whole.
"""

from enum import Enum

RUFFLES = 1.2  # least ratio of cloth to its gathered length in a ruffle
HEMS = (0.35, 0.55, 0.8)  # largest hem depths of mini, knee length and midi, as fractions of hips to floor


class Tag(Enum):
    """A word for a style; its value is the word in ``Sample.tags``."""

    meaning: str

    def __new__(cls, word: str, meaning: str) -> "Tag":
        member = object.__new__(cls)
        member._value_, member.meaning = word, meaning
        return member

    TOP = "top", "a shirt or bodice without skirt or trousers"
    DRESS = "dress", "a shirt or bodice with a skirt"
    JUMPSUIT = "jumpsuit", "a shirt or bodice with trousers"
    SKIRT = "skirt", "a skirt without upper"
    TROUSERS = "trousers", "trousers, with or without upper"
    SHIRT = "shirt", "a straight upper without darts"
    FITTED = "fitted bodice", "an upper fitted to bust and waist, usually by darts"
    CAPE = "cape", "a sector of a circle round the neck"
    PONCHO = "poncho", "a rectangle or circle of cloth with a neck opening"
    MINI = "mini", f"the hem at most {HEMS[0]} of the way from hips to floor"
    KNEE = "knee-length", f"the hem over {HEMS[0]} and at most {HEMS[1]} of the way from hips to floor"
    MIDI = "midi", f"the hem over {HEMS[1]} and at most {HEMS[2]} of the way from hips to floor"
    MAXI = "maxi", f"the hem over {HEMS[2]} of the way from hips to floor"
    A_LINE = "a-line skirt", "a skirt that widens from waist or hips to hem, by less than three eighths of a circle"
    HALF_CIRCLE = "half-circle skirt", "from three eighths to less than three quarters of a circle"
    CIRCLE = "circle skirt", "three quarters of a circle or more, or an off-centre circle"
    PENCIL = "pencil skirt", "a skirt fitted to the hips, usually by darts, its hem no wider"
    STRAIGHT = "straight skirt", "a rectangle in front and behind, hardly flared or gathered"
    GATHERED = "gathered skirt", f"a rectangle or trapezoid, gathered by {RUFFLES} or more at the waist"
    PANELLED = "panelled skirt", "four or more panels round the body"
    GODETS = "godet skirt", "triangular inserts in the hem"
    TIERED = "tiered skirt", "skirts sewn one under the other"
    SLIT = "slit", "a skirt with an open seam or a notch in its hem"
    WAISTBAND = "with waistband", "a band at the top of a skirt or trousers"
    STRAPLESS = "strapless", "a bodice that ends above the bust on both sides"
    ONE_SHOULDER = "one-shoulder", "a bodice that ends above the bust on one side, and has a shoulder on the other"
    SLEEVELESS = "sleeveless", "no sleeve on either side"
    SHORT_SLEEVES = "short sleeves", "two sleeves that end at the elbow or above, with their cuffs"
    LONG_SLEEVES = "long sleeves", "two sleeves that end below the elbow, with their cuffs"
    UNEVEN_SLEEVES = "uneven sleeves", "a sleeve on one side only, or a short and a long one"
    CUFFS = "with cuffs", "a cuff at a sleeve or a trouser leg"
    ROUND_NECK = "round neck", "a round neckline in front"
    V_NECK = "v-neck", "a pointed neckline in front, with straight sides"
    SQUARE_NECK = "square neck", "a neckline with corners in front, square or trapezoid"
    CURVED_NECK = "curved neck", "a neckline in front that is a free curve, or an arc that bulges inwards"
    UNEVEN_NECK = "uneven neck", "a front neckline with halves of different shapes"
    TURTLENECK = "turtleneck", "a standing collar"
    LAPEL = "lapel", "a turned collar"
    HOODED = "hooded", "a hood"
    ASYMMETRIC = "asymmetric", "halves of a shirt that differ, a slanted hem, or an off-centre skirt or tier"
    RUFFLED = "ruffled", f"gathers of {RUFFLES} or more at waist, levels, sleeves or cuffs"


TAGS: tuple[str, ...] = tuple(tag.value for tag in Tag)
"""All words that ``Sample.tags`` of a generated garment can hold, in their order there."""
