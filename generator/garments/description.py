"""Descriptions: the facts of a drawn garment in a tailor's words, for its tags and for the sentences of ``captions``.

Each garment's record describes it (``Garment.describe``), in the file that draws it. A description names only what is
drawn: a slit that a godet skirt leaves out is not in its description, though its base's section declares one.

Tags state what is drawn too. ``garment_tags`` collects those of the garments and adds those of the garment as a whole.
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from enum import Enum
from typing import Self

from gcd_dataset.records import Measurements

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
    PLEATED = "pleated skirt", "a skirt with knife, box or inverted pleats, pressed from waist to hem"
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
    OPEN_FRONT = "open front", "fronts that are not joined, as of a cardigan"
    ZIP = "zip", "fronts joined by a zip"
    BUTTONS = "buttons", "fronts that overlap, joined by buttons"
    POCKETS = "pockets", "patch or welt pockets on the chest of a shirt or on the back of trousers"
    ASYMMETRIC = "asymmetric", "halves of a shirt that differ, a slanted hem, or an off-centre skirt or tier"
    RUFFLED = "ruffled", f"gathers of {RUFFLES} or more at waist, levels, sleeves or cuffs"


TAGS: tuple[str, ...] = tuple(tag.value for tag in Tag)
"""All words that ``Sample.tags`` of a generated garment can hold, in their order there."""


Words = tuple[str, ...]
"""Wordings of one fact; a caption chooses one of them."""
NO_WORDS: Words = ()
ASYMMETRIC: Words = ("asymmetric",)

NUMBERS = (
    "no", "one", "two", "three", "four", "five", "six", "seven", "eight", "nine", "ten", "eleven", "twelve",
    "thirteen", "fourteen", "fifteen", "sixteen",
)  # fmt: skip
SOUNDS_LIKE_A_CONSONANT = ("one", "U-")
"""Beginnings with a vowel's letter that are spoken with a consonant: a one-shoulder top, a U-shaped neckline."""


class Zone(Enum):
    """The zone of a garment that a detail belongs to, in the order of a full caption."""

    NECK = "neck"
    SLEEVES = "sleeves"
    BODY = "body"
    WAIST = "waist"
    LOWER = "lower"
    HEM = "hem"


@dataclass(frozen=True, slots=True)
class Detail:
    """A visible detail, as noun phrases that may follow "with": ``("a slit in the back", "a back slit")``."""

    place: Zone
    words: Words
    main: bool = False
    """Whether captions of medium length mention it."""
    sided: bool = False
    """Whether it makes the left and the right half differ."""


@dataclass(frozen=True, slots=True)
class CuffGathers:
    """The gathers of a cuff as drawn: ratios of lengths at its seams."""

    limb: float = 1.0
    """The sleeve's or leg's end over the cuff's top."""
    frill: float = 1.0
    """The top of the cuff's skirt over what it hangs from: the band, or the limb's end."""


UNGATHERED = CuffGathers()


@dataclass(frozen=True, slots=True)
class Setting:
    """The wearer, and how a bottom is sewn in its garment."""

    size: Measurements
    rise: float = 1.0
    """Position of its top: 0 at the hips, 1 at the waist."""
    gather: float = 1.0
    """Length of its top over the hem or waistband that it is sewn to; 1 without either."""
    cuffs: Mapping[str, CuffGathers] = field(default_factory=dict)
    """The cuffs of the "right" and the "left" limb; none for limbs without."""


@dataclass(frozen=True, slots=True)
class Description:
    """A garment in words."""

    noun: Words
    """Its name, without article or length: "circle skirt"."""
    cut: tuple[Words, ...] = ()
    """Adjectives of its cut, for before the noun: "flared"."""
    details: tuple[Detail, ...] = ()
    traits: tuple[Words, ...] = ()
    """Adjectives for the garment that it is part of: "sleeveless"."""
    tags: tuple[Tag, ...] = ()
    """The tags of the same facts; ``garment_tags`` adds those of the garment as a whole."""

    def adding(self, *details: Detail) -> Self:
        """The description with more details."""
        return replace(self, details=(*self.details, *details))


def number_word(count: int) -> str:
    """A number in letters, up to sixteen.

    >>> number_word(8), number_word(20)
    ('eight', '20')
    """
    return NUMBERS[count] if count < len(NUMBERS) else str(count)


def with_article(phrase: str) -> str:
    """The phrase after "a" or "an".

    >>> with_article("A-line skirt"), with_article("one-shoulder top")
    ('an A-line skirt', 'a one-shoulder top')
    """
    vowel = phrase[0] in "aeiouAEIOU" and not phrase.startswith(SOUNDS_LIKE_A_CONSONANT)
    return f"{'an' if vowel else 'a'} {phrase}"


def joined(phrases: Iterable[str]) -> str:
    """Phrases as a list in a sentence.

    >>> joined(["a hood", "long sleeves", "cuffs"])
    'a hood, long sleeves and cuffs'
    >>> joined(["a hood", "gathers at bust and waist"])
    'a hood, and gathers at bust and waist'
    """
    *first, last = phrases
    if not first:
        return last
    comma = "," if any(" and " in phrase for phrase in (*first, last)) else ""
    return f"{', '.join(first)}{comma} and {last}"
