"""Descriptions: the facts of a drawn garment in a tailor's words, for its tags and for the sentences of ``captions``.

Each garment's record describes it (``Garment.describe``), in the file that draws it. A description names only what is
drawn: a slit that a godet skirt leaves out is not in its description, though its base's section declares one.
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from enum import Enum
from typing import Self

from gcd_dataset.generator.garments.tags import Tag
from gcd_dataset.records import Measurements

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


class Place(Enum):
    """The part of a garment that a detail belongs to, in the order of a full caption."""

    NECK = "neck"
    SLEEVES = "sleeves"
    BODY = "body"
    WAIST = "waist"
    LOWER = "lower"
    HEM = "hem"


@dataclass(frozen=True, slots=True)
class Detail:
    """A visible detail, as noun phrases that may follow "with": ``("a slit in the back", "a back slit")``."""

    place: Place
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
    """The wearer, and how a bottom is sewn in its outfit."""

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
    """Adjectives for the outfit that it is part of: "sleeveless"."""
    tags: tuple[Tag, ...] = ()
    """The tags of the same facts; ``style.outfit_tags`` adds those of the outfit as a whole."""

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
