"""Uppers: straight and fitted shirts, sewn of two halves, and their records."""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import lru_cache, partial
from typing import TYPE_CHECKING

from gcd_dataset.errors import PatternError
from gcd_dataset.generator.garments.collar import collar_words
from gcd_dataset.generator.garments.cuff import cuff_words, single_cuff_words, sleeve_cuff_length
from gcd_dataset.generator.garments.description import (
    UNGATHERED,
    Description,
    Detail,
    Setting,
    Tag,
    Words,
    Zone,
    with_article,
)
from gcd_dataset.generator.garments.front import TAGS as FRONT_TAGS
from gcd_dataset.generator.garments.front import FrontDesign, front_details, sewn_fronts
from gcd_dataset.generator.garments.garment import UpperGarment
from gcd_dataset.generator.garments.mends import Mend
from gcd_dataset.generator.garments.neckline import (
    NecklineDesign,
    back_neckline_words,
    neckline_tag,
    neckline_words,
    worn_neckline,
)
from gcd_dataset.generator.garments.shirt import BACK_NAME, FRONT_NAME, ShirtDesign, UpperHalf, right_half, right_torso
from gcd_dataset.generator.garments.sleeve import SleeveDesign, sleeve_tag, sleeve_words
from gcd_dataset.generator.pattern import Component, backwards
from gcd_dataset.records import Closure, Measurements

if TYPE_CHECKING:
    from gcd_dataset.generator.garments.design import GarmentDesign

LOOSE = 1.18  # least girth of the chest over the bust of a loose shirt
FLARED, TAPERED = 1.2, 0.88  # least and largest girth of the hem over the chest of a flared and of a tapered shirt
NEAR_NECK = (0.35, 0.6)  # largest width and front depth, as in ``NecklineDesign``, of a neckline close to the neck
ONE_SHOULDER: Words = ("one-shoulder",)
SIDES = ("right", "left")


def describe_shirt(setting: Setting, halves: tuple[UpperHalf, ...], *, fitted: bool) -> Description:
    """A shirt of one design for both halves, or of two, the right one first."""
    size = setting.size
    bare = [fitted and shirt.strapless for shirt, _, _ in halves]
    traits: tuple[Words, ...] = ()
    details: tuple[Detail, ...] = ()
    if all(bare):
        traits = (("strapless",),)
    elif any(bare):
        traits, details = (ONE_SHOULDER,), _one_shoulder(setting, halves, side=bare.index(False))
    else:
        traits = (("sleeveless",),) if all(arm.sleeveless for _, _, arm in halves) else ()
        details = (*_necks(size, halves, fitted=fitted), *_sleeves(setting, [arm for _, _, arm in halves]))
    cut = _cut([shirt for shirt, _, _ in halves], fitted=fitted)
    return Description(("top",), cut, details, traits, tuple(_tags(size, halves, fitted=fitted)))


def _tags(size: Measurements, halves: tuple[UpperHalf, ...], *, fitted: bool) -> Iterator[Tag]:
    """The tags of the cut and of the halves; half a neckline beside a strapless half has none."""
    yield Tag.FITTED if fitted else Tag.SHIRT
    worn = [half for half in halves if not (fitted and half[0].strapless)]
    if len(worn) < len(halves):
        yield Tag.ONE_SHOULDER if worn else Tag.STRAPLESS
    else:
        fronts = (right_torso(size, *half, fitted=fitted).piece(FRONT_NAME).outline.run("neck") for half in halves)
        necks = {neckline_tag(worn_neckline(half[1]), front) for half, front in zip(halves, fronts, strict=True)}
        yield necks.pop() if len(necks) == 1 else Tag.UNEVEN_NECK
    if not worn:
        return
    sleeves = [arm for _, _, arm in worn if not arm.sleeveless]
    lengths = {sleeve_tag(arm) for arm in sleeves}
    if not sleeves:
        yield Tag.SLEEVELESS
    else:
        yield lengths.pop() if len(sleeves) == len(halves) and len(lengths) == 1 else Tag.UNEVEN_SLEEVES
    if any(arm.cuff.type for arm in sleeves):
        yield Tag.CUFFS


def _cut(shirts: list[ShirtDesign], *, fitted: bool) -> tuple[Words, ...]:
    """The adjective of the cut, if both halves have the same."""
    if fitted:
        return (("fitted",),)
    words = {_straight_cut(shirt) for shirt in shirts}
    return () if len(words) > 1 else ((words.pop(),),)


def _straight_cut(shirt: ShirtDesign) -> str:
    if shirt.flare >= FLARED:
        return "flared"
    if shirt.width >= LOOSE:
        return "loose"
    return "tapered" if shirt.flare <= TAPERED else "straight"


def _necks(size: Measurements, halves: tuple[UpperHalf, ...], *, fitted: bool) -> tuple[Detail, ...]:
    """The neckline or collar, and a low back."""
    if len(halves) == 1:
        ((shirt, neck, arm),) = halves
        front, back = _neck(size, shirt, neck, arm, fitted=fitted)
        near = neck.width <= NEAR_NECK[0] and neck.fc_depth <= NEAR_NECK[1]
        collar = collar_words(neck.component, near_neck=near)
        words = collar or tuple(with_article(noun) for noun in front)
        details = [Detail(Zone.NECK, words, main=True)]
    else:
        necks = [_neck(size, shirt, neck, arm, fitted=fitted) for shirt, neck, arm in halves]
        (right, back), (left, left_back) = necks
        back = back if back == left_back else ()
        if right == left:
            details = [Detail(Zone.NECK, tuple(with_article(noun) for noun in right), main=True)]
        else:
            shapes = [words[0].removesuffix(" neckline").removesuffix("-neckline") for words in (right, left)]
            phrase = f"a neckline that is {_predicate(shapes[0])} on the right and {_predicate(shapes[1])} on the left"
            details = [Detail(Zone.NECK, (phrase,), main=True, sided=True)]
    return (*details, Detail(Zone.NECK, back)) if back else tuple(details)


def _predicate(shape: str) -> str:
    """The adjective after "is": "V" becomes "V-shaped"."""
    return f"{shape}-shaped" if shape.endswith("V") else shape


def _neck(
    size: Measurements, shirt: ShirtDesign, neck: NecklineDesign, arm: SleeveDesign, *, fitted: bool
) -> tuple[Words, Words]:
    """The neckline of a half in front, without article, and behind."""
    worn = worn_neckline(neck)
    torso = right_torso(size, shirt, neck, arm, fitted=fitted)
    front, back = (torso.piece(name).outline.run("neck") for name in (FRONT_NAME, BACK_NAME))
    drops = []
    for piece, neckline in ((FRONT_NAME, front), (BACK_NAME, back)):
        shoulder = torso.piece(piece).outline.edge("shoulder")
        low = min(y for stroke in neckline for _, y in (stroke.start, stroke.end))
        drops.append((min(shoulder.start[1], shoulder.end[1]) - low) / size.drawn_bust_line)
    return neckline_words(worn, front, drop=drops[0]), back_neckline_words(worn, drop=drops[1])


def _sleeves(setting: Setting, arms: list[SleeveDesign]) -> tuple[Detail, ...]:
    """The sleeves and their cuffs; none for a sleeveless shirt, which its trait names."""
    worn = [_Arm(arm, setting, side) for arm, side in zip(arms, SIDES, strict=False) if not arm.sleeveless]
    if not worn:
        return ()
    pairs, singles = worn[0].words(), [arm.words(pair=False)[0] for arm in worn]
    if len(worn) == 1 and len(arms) == 2:
        one = (f"one {singles[0]} on the {worn[0].side} only",)
        return (Detail(Zone.SLEEVES, one, main=True, sided=True), *_single_cuffs(worn, [""]))
    if len(worn) == 2 and singles[0] != singles[1]:
        both = f"{with_article(singles[0])} on the right and {with_article(singles[1])} on the left"
        return (Detail(Zone.SLEEVES, (both,), main=True, sided=True), *_pair_of_cuffs(worn))
    return (Detail(Zone.SLEEVES, pairs, main=True), *_pair_of_cuffs(worn))


def _pair_of_cuffs(arms: list["_Arm"]) -> tuple[Detail, ...]:
    """The cuffs of both sleeves, named one by one if they differ; ``arms``: one design if both are alike."""
    words = {cuff_words(arm.cuff, arm.cuff_length, arm.gathers, limb="sleeve") if arm.cuff else () for arm in arms}
    if len(words) > 1:
        return _single_cuffs(arms, [f" on the {side} sleeve" for side in SIDES])
    found = words.pop()
    return (Detail(Zone.SLEEVES, found),) if found else ()


def _single_cuffs(arms: list["_Arm"], where: list[str]) -> tuple[Detail, ...]:
    """Each cuff by itself; ``where``: words after it."""
    return tuple(
        Detail(Zone.SLEEVES, (single_cuff_words(arm.cuff, arm.cuff_length, arm.gathers) + place,), sided=bool(place))
        for arm, place in zip(arms, where, strict=True)
        if arm.cuff
    )


class _Arm:
    """A sleeve on one side, with its cuff as drawn."""

    def __init__(self, design: SleeveDesign, setting: Setting, side: str) -> None:
        self._design, self._size, self.side = design, setting.size, side
        self.cuff, self.cuff_length = design.cuff.type, sleeve_cuff_length(setting.size, design)
        self.gathers = setting.cuffs.get(side, UNGATHERED)

    def words(self, *, pair: bool = True) -> Words:
        """Noun phrases for the sleeve, or for a pair of such sleeves."""
        return sleeve_words(self._size, self._design, self.gathers, pair=pair)


def _one_shoulder(setting: Setting, halves: tuple[UpperHalf, ...], *, side: int) -> tuple[Detail, ...]:
    """The half with a shoulder of a shirt that is strapless on the other side."""
    arm, name = halves[side][2], SIDES[side]
    if arm.sleeveless:
        return (Detail(Zone.NECK, (f"a shoulder strap on the {name} only",), main=True, sided=True),)
    worn = _Arm(arm, setting, name)
    single = with_article(worn.words(pair=False)[0])
    return (Detail(Zone.SLEEVES, (f"{single} on the {name}",), main=True, sided=True), *_single_cuffs([worn], [""]))


def shirt(size: Measurements, design: "GarmentDesign", *, fitted: bool, mends: frozenset[Mend]) -> Component:
    """Two halves sewn at the centres; offers the ring ``bottom``, and the same ``bottom_from_front``."""
    halves = design.right_half(), design.left_half()
    return _sewn_halves(size, *halves, design.front, fitted=fitted, mends=mends)


@lru_cache(maxsize=8)  # designs that differ in waistband or bottom have the same shirt
def _sewn_halves(
    size: Measurements,
    right_design: UpperHalf,
    left_design: UpperHalf | None,
    front: FrontDesign,
    *,
    fitted: bool,
    mends: frozenset[Mend],
) -> Component:
    """The shirt of two halves; ``left_design``: ``None`` for the mirror image of the right one."""
    drawn = partial(right_half, size, fitted=fitted, mends=mends, extension=front.extension)
    right = drawn(*right_design)
    other = right if left_design is None else drawn(*left_design)
    is_strapless = fitted and any(half is not None and half[0].strapless for half in (right_design, left_design))
    if front.closure is Closure.OPEN and is_strapless:
        raise PatternError(
            "a strapless top with an open front falls off: set front.closure to zip, or shirt.strapless to false"
        )
    left = other.mirrored("right", "left")
    whole = Component.of(right, left)
    for name in sorted(name for name in right.interfaces if name.endswith("_centre")):
        if name == "front_centre":
            whole = sewn_fronts(whole, right.interface(name), left.interface(name), front)
        else:
            whole = whole.sewn(right.interface(name), left.interface(name))
    front_right = backwards(right.interface("front_bottom"))
    others = left.interface("front_bottom") + backwards(left.interface("back_bottom")) + right.interface("back_bottom")
    return whole.offering(bottom=front_right + others, bottom_from_front=others + front_right)


@dataclass(frozen=True, kw_only=True)
class Shirt(UpperGarment[ShirtDesign]):
    """A shirt; its neckline, sleeves and differing left half have sections of their own."""

    section: str = "shirt"
    design: type[ShirtDesign] = ShirtDesign
    mends: frozenset[Mend] = frozenset({Mend.SLEEVE_START, Mend.ARMHOLE_ROOM, Mend.SLEEVE_SURPLUS})
    fitted: bool
    """Whether darts fit the shirt to bust and waist; a fitted shirt ends at the waist."""

    def draw(self, size: Measurements, design: "GarmentDesign", *, mends: frozenset[Mend]) -> Component:
        return shirt(size, design, fitted=self.fitted, mends=mends)

    def length(self, size: Measurements, design: "GarmentDesign") -> float:
        return size.waist_line if self.at_waist else self.section_design(design).length * size.waist_line

    def describe(self, setting: Setting, design: "GarmentDesign") -> Description:
        described = describe_shirt(setting, design.halves(), fitted=self.fitted)
        closure = design.front.closure
        tags = (FRONT_TAGS[closure],) if closure in FRONT_TAGS else ()
        return replace(described, tags=(*described.tags, *tags)).adding(*front_details(design.front))

    def sections_used(self, design: "GarmentDesign") -> tuple[str, ...]:
        left = design.left_half() is not None
        is_closed = design.front.closure is not Closure.SEWN
        return ("shirt", "collar", "sleeve") + (("left",) if left else ()) + (("front",) if is_closed else ())


FITTED_SHIRT = Shirt(name="FittedShirt", fitted=True, at_waist=True, mends=Shirt.mends | {Mend.FOLDED_DART})
STRAIGHT_SHIRT = Shirt(name="Shirt", fitted=False)
