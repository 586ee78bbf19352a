"""The facts of an outfit in words, from its design, its wearer and its drawn pattern."""

from collections.abc import Iterable
from dataclasses import dataclass, replace
from math import hypot

import numpy as np
from jaxtyping import Float

from gcd_dataset.generator.captions.lengths import leg_words, shirt_words, skirt_words
from gcd_dataset.generator.garments.description import ASYMMETRIC, NO_WORDS, Description, Detail, Place, Setting, Words
from gcd_dataset.generator.garments.design import OutfitDesign
from gcd_dataset.generator.garments.outfit import bottom_rise
from gcd_dataset.generator.garments.shirt_words import ONE_SHOULDER
from gcd_dataset.generator.garments.tags import RUFFLES
from gcd_dataset.generator.garments.waistband import Waistband, band_rise
from gcd_dataset.records import Measurements, Panel, PanelRole, Pattern

__all__ = ["OutfitFacts", "outfit_facts"]

NARROW, WIDE = 4.0, 9.0  # cm: largest height of a narrow and least of a wide waistband
LOOSE = 1.15  # least girth of a loose waistband over the body's
AT_WAIST, BELOW_WAIST = 0.95, 0.7  # least rise of a top at the waist, and of one just below it
SEAM_RAISED, SEAM_DROPPED = 0.92, 1.1  # depth of a waist seam over nape to waist: raised below, dropped above
SAME = 0.5  # cm: halves whose panels differ by less are symmetrical
KNEE_LENGTH: Words = ("knee-length",)
PLAIN_HEM: Words = ("a plain hem", "an even hem")
PLAIN_LEGS: Words = ("plain leg ends", "plain hems")
TORSO, BAND = ("right_ftorso", "right_btorso", "left_ftorso", "left_btorso"), ("wb_front", "wb_back")


@dataclass(frozen=True, slots=True)
class OutfitFacts:
    """An outfit in words."""

    length: Words
    """Adjectives for its length; empty if no word fits."""
    noun: Words
    traits: tuple[Words, ...]
    """Adjectives for the whole, before the length: sleeveless, asymmetric."""
    cut: tuple[Words, ...]
    """Adjectives of the cut, after the length: fitted, flared; of a dress or jumpsuit they are in ``parts``."""
    parts: tuple[Words, ...]
    """Nouns for bodice and bottom of a dress or jumpsuit, or for the bottom alone; empty for other outfits."""
    lower: str
    """The name of the bottom in a sentence: skirt, trousers or shorts; empty without one."""
    details: tuple[Detail, ...]
    """In the order of ``Place``."""
    is_symmetrical: bool
    """Whether left and right halves are drawn as mirror images."""

    @property
    def is_plural(self) -> bool:
        """Whether the noun is a plural: trousers, shorts."""
        return self.noun[0].endswith("s") and not self.noun[0].endswith("ss")


def outfit_facts(size: Measurements, design: OutfitDesign, pattern: Pattern) -> OutfitFacts:
    """The facts of a design as drawn for a wearer in ``pattern``. Raises ``PatternError`` as ``outfit`` does."""
    meta, rise = design.meta, bottom_rise(design)
    upper = meta.upper.garment.describe(Setting(size), design) if meta.upper else None
    setting = Setting(size, rise, _gather_below(pattern))
    bottom = meta.bottom.garment.describe(setting, design) if meta.bottom else None
    facts = _kind(size, design, upper, bottom)
    found = [*facts.details, *_darts(pattern), *_waist(size, design, pattern)]
    if not any(detail.place is Place.HEM for detail in found):
        found.append(Detail(Place.HEM, PLAIN_LEGS if facts.lower in ("trousers", "shorts") else PLAIN_HEM))
    order = list(Place)
    details = sorted(found, key=lambda detail: order.index(detail.place))
    symmetrical = not any(detail.sided for detail in details) and _is_symmetrical(pattern)
    traits = facts.traits if symmetrical or len(design.halves()) < 2 else (*facts.traits, ASYMMETRIC)
    if ONE_SHOULDER in traits:  # says so itself
        traits = tuple(words for words in traits if words != ASYMMETRIC)
    return replace(facts, traits=tuple(dict.fromkeys(traits)), details=tuple(details), is_symmetrical=symmetrical)


def _kind(
    size: Measurements, design: OutfitDesign, upper: Description | None, bottom: Description | None
) -> OutfitFacts:
    """Names, lengths and parts, with the details of upper and bottom."""
    if bottom is None:
        assert upper is not None
        length, tops = shirt_words(size, _hem_below_waist(size, design))
        tops = tops if upper.noun == ("top",) else upper.noun
        return OutfitFacts(length, tops, upper.traits, upper.cut, (), "", upper.details, False)
    depth = (_hem_below_waist(size, design) - size.hips_line) / size.leg_length
    legs = bottom.noun == ("trousers",)
    length, names = leg_words(size, depth) if legs else (skirt_words(size, depth), bottom.noun)
    lower = names[0] if legs else "skirt"
    if upper is None:
        return OutfitFacts(length, names, bottom.traits, bottom.cut, (), lower, bottom.details, False)
    parts: tuple[Words, ...] = (_prefixed(bottom.cut, names),)
    if upper.cut:  # halves of different cut have no common word
        parts = (_prefixed(upper.cut, ("bodice",)), *parts)
    nouns: Words = ("jumpsuit",) if legs else ("dress",)
    if lower == "shorts" and length != KNEE_LENGTH:
        length, nouns = NO_WORDS, ("playsuit", "short jumpsuit")
    traits, details = (*upper.traits, *bottom.traits), (*upper.details, *bottom.details)
    return OutfitFacts(length, nouns, traits, (), parts, lower, details, False)


def _prefixed(traits: Iterable[Words], nouns: Words) -> Words:
    """The nouns after the first wording of each trait."""
    before = " ".join(words[0] for words in traits)
    return tuple(f"{before} {noun}".strip() for noun in nouns)


def _hem_below_waist(size: Measurements, design: OutfitDesign) -> float:
    """Depth of the lowest hem below the waist, the parts hung one under the other, as ``style.hem_depth`` [cm]."""
    meta, rise = design.meta, bottom_rise(design)
    band = design.waistband.width * size.hips_line if meta.wb else 0.0
    if meta.upper:
        start = meta.upper.garment.length(size, design) - size.waist_line + band
    else:
        start = (1.0 - rise) * size.hips_line
    return start + (meta.bottom.garment.drawn_length(size, design, rise) if meta.bottom else 0.0)


# ------------------------------------------------------------------------------------------------------- drawn pattern


def _part(panel: Panel) -> str:
    """The part of an outfit that a panel belongs to: torso, band, bottom or other."""
    if panel.label == PanelRole.LEG:
        return "bottom"
    return "torso" if panel.name in TORSO else "band" if panel.name in BAND else "other"


def _gather(pattern: Pattern, above: str, below: str) -> float:
    """Length of the lower part's edges over the upper part's, over all seams between them; 1 without such seams."""
    lengths = {panel.name: panel.edge_lengths() for panel in pattern.panels}
    parts = {panel.name: _part(panel) for panel in pattern.panels}
    up = down = 0.0
    for seam in pattern.seams:
        sides = {parts[ref.panel]: lengths[ref.panel][ref.edge] for ref in (seam.left, seam.right)}
        if set(sides) == {above, below}:
            up, down = up + sides[above], down + sides[below]
    return down / up if up else 1.0


def _gather_below(pattern: Pattern) -> float:
    """Gathers of the bottom: on the waistband, or else on the shirt's hem."""
    return _gather(pattern, "band" if any(panel.name in BAND for panel in pattern.panels) else "torso", "bottom")


def _darts(pattern: Pattern) -> tuple[Detail, ...]:
    """The darts: seams between two edges of one panel."""
    panels = [pattern.panel(seam.left.panel) for seam in pattern.seams if seam.left.panel == seam.right.panel]
    bust = sum(panel.name == "right_ftorso" for panel in panels)
    waist = [panel for panel in panels if _part(panel) == "bottom"]
    found = []
    if bust:
        words: Words = ("bust and waist darts", "darts at bust and waist") if bust > 1 else ("bust darts",)
        found.append(Detail(Place.BODY, words))
    if waist:
        in_front = any(panel.placement.translation[2] > 0 for panel in waist)
        words = ("waist darts", "darts at the waist") if in_front else ("darts at the back waist",)
        found.append(Detail(Place.LOWER, words))
    return tuple(found)


def _waist(size: Measurements, design: OutfitDesign, pattern: Pattern) -> tuple[Detail, ...]:
    """Waistband, waist seam and position of the top."""
    meta, found = design.meta, []
    if meta.wb:
        found.append(_band(size, design, meta.wb))
        if meta.upper and _gather(pattern, "band", "torso") >= RUFFLES:
            found.append(Detail(Place.WAIST, ("a bodice gathered into the band",)))
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
        found.append(Detail(Place.WAIST, words))
        if not meta.wb:
            found.append(Detail(Place.WAIST, ("no waistband",)))
    elif meta.bottom and meta.upper:
        seam = meta.upper.garment.length(size, design) / size.waist_line
        if seam < SEAM_RAISED:
            found.append(Detail(Place.WAIST, ("a raised waistline",), main=True))
        elif seam > SEAM_DROPPED:
            found.append(Detail(Place.WAIST, ("a dropped waistline",), main=True))
        else:
            found.append(Detail(Place.WAIST, ("a seam at the natural waist",)))
    return tuple(found)


def _band(size: Measurements, design: OutfitDesign, kind: Waistband) -> Detail:
    height, meta = design.waistband.width * size.hips_line, design.meta
    high = "narrow " if height <= NARROW else "wide " if height >= WIDE else ""
    cut = "loose" if design.waistband.waist >= LOOSE else "fitted" if kind is Waistband.FITTED else "straight"
    if meta.bottom is None:
        return Detail(Place.HEM, (f"a {high}{cut} band at the hem",), main=True)
    return Detail(Place.WAIST, (f"a {high}{cut} waistband",), main=True)


# ------------------------------------------------------------------------------------------------------------ symmetry


def _is_symmetrical(pattern: Pattern) -> bool:
    """Whether every panel is its own mirror image or has one on the other side of the body.

    Godets, bands and the panels of a panelled skirt are alike on all sides; their edges may be divided unevenly, where
    a seam of another part ends.
    """
    panels = {panel.name: panel for panel in pattern.panels}
    for name, panel in panels.items():
        if name.startswith(("ins_", "wb_", "skirt_panel_")):
            continue
        other = _mirror_name(name, panels)
        if not _mirrored_alike(panel, panels[other]):
            return False
    return True


def _mirror_name(name: str, panels: dict[str, Panel]) -> str:
    """The panel on the other side of the body; the panel itself if there is none."""
    swapped = (
        ("right", "left"), ("left", "right"), ("pant_r_", "pant_l_"), ("pant_l_", "pant_r_"),
        ("pant_f_r", "pant_f_l"), ("pant_f_l", "pant_f_r"), ("pant_b_r", "pant_b_l"), ("pant_b_l", "pant_b_r"),
    )  # fmt: skip
    return next((other for a, b in swapped if a in name and (other := name.replace(a, b)) in panels), name)


def _mirrored_alike(panel: Panel, other: Panel) -> bool:
    """Whether the corners of one panel are the mirror images of the other's, wherever they lie."""
    mine, theirs = _centred(panel.vertices * [-1.0, 1.0]), _centred(other.vertices)
    if len(mine) != len(theirs):
        return False
    return all(min(hypot(x - a, y - b) for a, b in theirs.tolist()) < SAME for x, y in mine.tolist())


def _centred(corners: Float[np.ndarray, "v 2"]) -> Float[np.ndarray, "v 2"]:
    """The corners about the middle of their bounding box."""
    return corners - 0.5 * (corners.min(axis=0) + corners.max(axis=0))
