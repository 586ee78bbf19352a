"""The facts of a garment in words, from its design, its wearer and its drawn pattern.

A depth is the distance of a hem below the hips, as a fraction of hips to floor, as ``hem_depth``. Words divide
the classes of the tags (``HEMS``) further at the wearer's knee: a "mini", "midi" or "maxi" skirt has that tag.
"""

from collections.abc import Iterable
from dataclasses import dataclass, replace

from gcd_dataset.generator.garments.assembly import bottom_rise
from gcd_dataset.generator.garments.description import (
    ASYMMETRIC,
    HEMS,
    NO_WORDS,
    RUFFLES,
    Description,
    Detail,
    Words,
    Zone,
)
from gcd_dataset.generator.garments.design import GarmentDesign
from gcd_dataset.generator.garments.drawn import described, gather, hem_below_waist, hem_depth, part_of, sides_match
from gcd_dataset.generator.garments.upper import ONE_SHOULDER
from gcd_dataset.generator.garments.waistband import Waistband, band_rise
from gcd_dataset.generator.garments.wardrobe import Bottom
from gcd_dataset.records import Measurements, Pattern

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


NARROW, WIDE = 4.0, 9.0  # cm: largest height of a narrow and least of a wide waistband
LOOSE = 1.15  # least girth of a loose waistband over the body's
AT_WAIST, BELOW_WAIST = 0.95, 0.7  # least rise of a top at the waist, and of one just below it
SEAM_RAISED, SEAM_DROPPED = 0.92 - 1e-6, 1.1 + 1e-6  # of nape to waist; the margin is for rounding errors
KNEE_LENGTH: Words = ("knee-length",)
PLAIN_HEM: Words = ("a plain hem", "an even hem")
PLAIN_LEGS: Words = ("plain leg ends", "plain hems")


@dataclass(frozen=True, slots=True)
class GarmentFacts:
    """A garment in words."""

    length: Words
    """Adjectives for its length; empty if no word fits."""
    noun: Words
    traits: tuple[Words, ...]
    """Adjectives for the whole, before the length: sleeveless, asymmetric."""
    cut: tuple[Words, ...]
    """Adjectives of the cut, after the length: fitted, flared; of a dress or jumpsuit they are in ``parts``."""
    parts: tuple[Words, ...]
    """Nouns for bodice and bottom of a dress or jumpsuit, or for the bottom alone; empty for other garments."""
    lower: str
    """The name of the bottom in a sentence: skirt, trousers or shorts; empty without one."""
    details: tuple[Detail, ...]
    """In the order of ``Zone``."""
    is_symmetrical: bool
    """Whether left and right halves are drawn as mirror images."""

    @property
    def is_plural(self) -> bool:
        """Whether the noun is a plural: trousers, shorts."""
        return self.noun[0].endswith("s") and not self.noun[0].endswith("ss")


def garment_facts(size: Measurements, design: GarmentDesign, pattern: Pattern) -> GarmentFacts:
    """The facts of a design as drawn for a wearer in ``pattern``. Raises ``PatternError`` as ``draw_garment`` does."""
    upper, bottom = described(size, design, pattern)
    facts = _kind(size, design, upper, bottom)
    found = [*facts.details, *_darts(pattern), *_waist(size, design, pattern)]
    if not any(detail.place is Zone.HEM for detail in found):
        found.append(Detail(Zone.HEM, PLAIN_LEGS if facts.lower in ("trousers", "shorts") else PLAIN_HEM))
    order = list(Zone)
    details = sorted(found, key=lambda detail: order.index(detail.place))
    symmetrical = sides_match(details, pattern)
    traits = facts.traits if symmetrical or len(design.halves()) < 2 else (*facts.traits, ASYMMETRIC)
    if ONE_SHOULDER in traits:  # says so itself
        traits = tuple(words for words in traits if words != ASYMMETRIC)
    return replace(facts, traits=tuple(dict.fromkeys(traits)), details=tuple(details), is_symmetrical=symmetrical)


def _kind(
    size: Measurements, design: GarmentDesign, upper: Description | None, bottom: Description | None
) -> GarmentFacts:
    """Names, lengths and parts, with the details of upper and bottom."""
    if bottom is None:
        assert upper is not None
        length, tops = shirt_words(size, hem_below_waist(size, design))
        tops = tops if upper.noun == ("top",) else upper.noun
        return GarmentFacts(length, tops, upper.traits, upper.cut, (), "", upper.details, False)
    depth = hem_depth(size, design)
    legs = bottom.noun == ("trousers",)
    length, names = leg_words(size, depth) if legs else (skirt_words(size, depth), bottom.noun)
    lower = names[0] if legs else "skirt"
    if upper is None:
        return GarmentFacts(length, names, bottom.traits, bottom.cut, (), lower, bottom.details, False)
    parts: tuple[Words, ...] = (_prefixed(bottom.cut, names),)
    if upper.cut:  # halves of different cut have no common word
        parts = (_prefixed(upper.cut, ("bodice",)), *parts)
    nouns: Words = ("jumpsuit",) if legs else ("dress",)
    if lower == "shorts" and length != KNEE_LENGTH:
        length, nouns = NO_WORDS, ("playsuit", "short jumpsuit")
    traits, details = (*upper.traits, *bottom.traits), (*upper.details, *bottom.details)
    return GarmentFacts(length, nouns, traits, (), parts, lower, details, False)


def _prefixed(traits: Iterable[Words], nouns: Words) -> Words:
    """The nouns after the first wording of each trait."""
    before = " ".join(words[0] for words in traits)
    return tuple(f"{before} {noun}".strip() for noun in nouns)


def _darts(pattern: Pattern) -> tuple[Detail, ...]:
    """The darts: seams between two edges of one panel."""
    legs = [seam.left for seam in pattern.seams if seam.left.panel == seam.right.panel]
    names = {pattern.panel(leg.panel).edge(leg.edge).name for leg in legs if leg.panel == "right_ftorso"}
    waist = [panel for leg in legs if part_of(panel := pattern.panel(leg.panel)) == "bottom"]
    bust, below = "side_dart.0" in names, "waist_dart.0" in names
    found = []
    if bust or below:
        words: Words = ("bust and waist darts", "darts at bust and waist") if bust and below else ("bust darts",)
        found.append(Detail(Zone.BODY, words if bust else ("waist darts",)))
    if waist:
        in_front = any(panel.placement.translation[2] > 0 for panel in waist)
        words = ("waist darts", "darts at the waist") if in_front else ("darts at the back waist",)
        found.append(Detail(Zone.LOWER, words))
    return tuple(found)


def _waist(size: Measurements, design: GarmentDesign, pattern: Pattern) -> tuple[Detail, ...]:
    """Waistband, waist seam and position of the top."""
    meta, found = design.meta, []
    if meta.wb:
        found.append(_band(size, design, meta.wb))
        if meta.upper and gather(pattern, "band", "torso") >= RUFFLES:
            found.append(Detail(Zone.WAIST, ("a bodice gathered into the band",)))
    if meta.bottom and meta.upper is None:
        top = (
            band_rise(design.waistband, bottom_rise(design)) + design.waistband.width
            if meta.wb
            else bottom_rise(design)
        )
        if top >= AT_WAIST:
            words: Words = ("a natural waistline", "a top edge at the natural waist")
        elif top >= BELOW_WAIST:
            words = ("a waistline just below the natural waist",)
        else:
            words = ("a low-slung waist", "a top edge low on the hips")
        found.append(Detail(Zone.WAIST, words))
        if not meta.wb:
            found.append(Detail(Zone.WAIST, ("no waistband",)))
    elif meta.bottom and meta.upper:
        seam = meta.upper.garment.length(size, design) / size.waist_line
        if seam < SEAM_RAISED:
            found.append(Detail(Zone.WAIST, ("a raised waistline",), main=True))
        elif seam > SEAM_DROPPED:
            found.append(Detail(Zone.WAIST, ("a dropped waistline",), main=True))
        else:
            found.append(Detail(Zone.WAIST, ("a seam at the natural waist",)))
    return tuple(found)


def _band(size: Measurements, design: GarmentDesign, kind: Waistband) -> Detail:
    height, meta = design.waistband.width * size.hips_line, design.meta
    high = "narrow " if height <= NARROW else "wide " if height >= WIDE else ""
    cut = "loose" if design.waistband.waist >= LOOSE else "fitted" if kind is Waistband.FITTED else "straight"
    if meta.bottom is None:
        return Detail(Zone.HEM, (f"a {high}{cut} band at the hem",), main=True)
    if meta.bottom is Bottom.PLEATED and kind is Waistband.FITTED and height >= WIDE:
        return Detail(Zone.WAIST, ("a hip yoke",), main=True)
    return Detail(Zone.WAIST, (f"a {high}{cut} waistband",), main=True)
