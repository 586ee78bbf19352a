"""The pencil skirt: fitted to the hips with darts. Panels ``skirt_front`` and ``skirt_back``."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from enum import Enum
from math import radians, tan

import numpy as np

from gcd_dataset.curves import LINE, Point
from gcd_dataset.errors import PatternError
from gcd_dataset.generator.garments.description import ASYMMETRIC, Description, Detail, Setting, Tag, Zone
from gcd_dataset.generator.garments.garment import BottomGarment, Cutting, Ring
from gcd_dataset.generator.garments.mends import ALL_MENDS, Mend
from gcd_dataset.generator.garments.skirt import hem_ring, length_below_waist, waist_ring
from gcd_dataset.generator.garments.space import Design, choice, integer, real
from gcd_dataset.generator.garments.trunk import (
    Quarter,
    WaistDart,
    back_quarter,
    drawn_rise,
    front_quarter,
    girth_below_waist,
)
from gcd_dataset.generator.pattern import (
    Component,
    Interface,
    Outline,
    Piece,
    Stroke,
    cut_into,
    dart,
    notch,
    tangent_quadratic,
)
from gcd_dataset.records import Measurements

MEASURES_USED = ("hips_line", "bust_points", "bum_points", "hip_inclination")
FRONT, BACK = 25.0, -20.0  # cm: z of front and back before sewing, GarmentCode
BACK_EASE = 1.05  # height from hips to top behind, over the height in front, GarmentCode
FRONT_DART = 0.8  # dart leg over the height from hips to top, in front, GarmentCode
BACK_DART = 0.85  # dart leg of the back over the height in front, before ``BACK_EASE - 1`` is added, GarmentCode
SLIT_WIDTH = 2.0  # cm, GarmentCode
SIDE_BEND = 0.75  # position of a flared side's control point along its chord, GarmentCode
RINGS = 9  # levels below the hips at which the skirt's girth is compared with the legs
VISIBLE_SLIT, HIGH_SLIT = 4.0, 0.6  # cm, least slit in a description; share of the length of a high slit
EVEN_SLITS = 0.1  # share of the length by which two side slits may differ and be called a pair
VISIBLE_TILT = 5  # degrees
SLIGHTLY_FLARED = 1.08  # girth of the hem over the hips
UP, DOWN = (0.0, 1.0), (0.0, -1.0)


class StyleCut(Enum):
    """Ornaments cut into a side seam: read from design files, but never sampled, and rejected by ``pencil_skirt``."""

    SUN = "Sun"
    SIGGRAPH_LOGO = "SIGGRAPH_logo"


@dataclass(frozen=True)
class PencilSkirtDesign(Design):
    """A narrow skirt."""

    length: float = real(0.4, 0.2, 0.95)
    """Depth of the hem below the hips as worn, with or without a waistband, as a fraction of hips to floor."""
    rise: float = real(1.0, 0.5, 1.0, keep=0.3)
    """Where the top sits: 0 at the hips, 1 at the waist."""
    flare: float = real(1.0, 0.6, 1.5, keep=0.3)
    """Girth of the hem, as a fraction of the hips."""
    low_angle: int = integer(0, -30, 30, keep=0.7)
    """Tilt of the hem [degrees]."""
    front_slit: float = real(0.0, 0.0, 0.9, keep=0.4)
    """Height of the notch in the middle of the front hem, as a fraction of the length."""
    back_slit: float = real(0.0, 0.0, 0.9, keep=0.4)
    """Height of the notch in the middle of the back hem, as a fraction of the length."""
    left_slit: float = real(0.0, 0.0, 0.9, keep=0.6)
    """Height of the slit in the left side seam, as a fraction of the seam below the hips."""
    right_slit: float = real(0.0, 0.0, 0.9, keep=0.6)
    """Height of the slit in the right side seam, as a fraction of the seam below the hips."""
    style_side_cut: StyleCut | None = choice(None, *StyleCut, None, keep=1.0)
    """Ornament in a side seam: read from GarmentCode's files, never sampled; a design that names one is not drawn."""


def pencil_skirt(size: Measurements, design: PencilSkirtDesign, cutting: Cutting) -> Component:
    """Front and back; the front has the length of ``cutting``. Offers the rings ``top`` and ``bottom``.

    Raises ``PatternError`` for a skirt that ends above the hips, and for an ornament; ``BodyError`` for missing
    measures.
    """
    if design.style_side_cut is not None:
        raise PatternError(
            f"pencil-skirt.style_side_cut is {design.style_side_cut.value}, but ornaments are not drawn: set it to null"
        )
    rise = drawn_rise(size.require(*MEASURES_USED), cutting.rise)
    below = cutting.length - rise * size.hips_line
    if below <= 0:
        raise PatternError(f"a pencil skirt ends {-below:.1f} cm above the hips: lengthen it, or choose another skirt")
    names = (f"skirt_front{cutting.suffix}", f"skirt_back{cutting.suffix}")
    shapes = dict(zip(names, _quarters(size, rise, cutting.mends), strict=True))
    front, back = (_panel(size, design, name, shape, below) for name, shape in shapes.items())
    front = _slit(front, design.front_slit * below).at(0, size.waist_level, FRONT)
    back = _slit(back, design.back_slit * below).at(0, size.waist_level, BACK)
    skirt = Component.of(front, back)
    for piece in skirt.pieces:
        for number in range(2 * len(shapes[piece.name].darts)):
            skirt = skirt.sewn(piece.along(f"dart_{number}.0"), piece.against(f"dart_{number}.1"))
    return (
        skirt.sewn(_side(front.along, "right", ease=1.0), _side(back.along, "right", ease=BACK_EASE))
        .sewn(_side(front.against, "left", ease=1.0), _side(back.against, "left", ease=BACK_EASE))
        .offering(top=waist_ring(size, front, back), bottom=hem_ring(front, back))
    )


def _quarters(size: Measurements, rise: float, mends: frozenset[Mend]) -> tuple[Quarter, Quarter]:
    """Half of the front and half of the back."""
    leg = (BACK_DART + BACK_EASE - 1) * rise * size.hips_line
    return front_quarter(size, rise, mends, leg=FRONT_DART), back_quarter(size, rise, mends, raise_=BACK_EASE, leg=leg)


def _panel(size: Measurements, design: PencilSkirtDesign, name: str, shape: Quarter, below: float) -> Piece:
    """The panel below the origin, the middle of its top; drawn from the right end of its hem up."""
    hem = _hem_width(size, shape, design)
    tilt = tan(radians(design.low_angle)) * hem
    bottom, top = -shape.height - below, shape.hips - shape.lean
    right, left = (-shape.hips, -shape.height), (shape.hips, -shape.height)
    right_seam = _below_hips((-hem, bottom + tilt), right, design, "right", design.right_slit)
    left_seam = _below_hips((hem, bottom - tilt), left, design, "left", design.left_slit)
    outline = (
        Outline.start(-hem, bottom + tilt)
        .then(*right_seam)
        .curve(-top, 0, tangent_quadratic(right, (-top, 0), start_tangent=UP), name="right_hip")
        .then(*_darted(name, -top, top, shape.darts))
        .curve(*left, tangent_quadratic((top, 0), left, end_tangent=DOWN), name="left_hip")
        .then(*(stroke.reversed() for stroke in reversed(left_seam)))
        .close(name="bottom")
    )
    return Piece(name, outline)


def _hem_width(size: Measurements, shape: Quarter, design: PencilSkirtDesign) -> float:
    """Half of a panel's width at the hem [cm]."""
    return shape.hips + 0.25 * size.hips * (design.flare - 1)


def _below_hips(hem: Point, hip: Point, design: PencilSkirtDesign, name: str, open_share: float) -> tuple[Stroke, ...]:
    """A side from the hem up to the hips; its lower ``open_share`` is a slit."""
    curve = LINE if design.flare == 1 else tangent_quadratic(hem, hip, end_tangent=UP, at=SIDE_BEND)
    side = Stroke(hem, hip, curve, name)
    if not open_share:
        return (side,)
    slit, sewn = side.split([open_share])
    return replace(slit, name=f"{name}_slit"), sewn


def _darted(panel: str, right: float, left: float, darts: Sequence[WaistDart]) -> tuple[Stroke, ...]:
    """A straight top between two ends, with pairs of darts about its middle."""
    top = Outline.start(right, 0)
    both = [(-fold.from_centre, fold) for fold in reversed(darts)] + [(fold.from_centre, fold) for fold in darts]
    for number, (middle, fold) in enumerate(both):
        first, last = middle - 0.5 * fold.width, middle + 0.5 * fold.width
        if not top.pen[0] < first < last < left:
            figures = f"a dart of {fold.width:.2f} cm, {abs(middle):.2f} cm from the middle"
            raise PatternError(f"{panel}: {figures}, does not fit a top of {left - right:.2f} cm: correct the measures")
        _, tip = dart(fold.width, fold.leg, name=f"{panel}.{number}")[0].end
        top = top.line(first, 0, name="top").line(middle, -tip, name=f"dart_{number}.0")
        top = top.line(last, 0, name=f"dart_{number}.1")
    return top.line(left, 0, name="top").strokes


def _slit(piece: Piece, depth: float) -> Piece:
    """The piece with a slit in the middle of its hem, ``depth`` cm deep."""
    if not depth:
        return piece
    middle = 0.5 * piece.outline.length("bottom")
    return replace(piece, outline=cut_into(piece.outline, "bottom", notch(SLIT_WIDTH, depth, name="slit"), at=middle))


def _side(walk: Callable[..., Interface], side: str, *, ease: float) -> Interface:
    """The sewn part of a side, from the hem up; ``ease`` gathers it above the hips."""
    return walk(side) + walk(f"{side}_hip", ruffle=ease)


def _rings(
    size: Measurements, design: PencilSkirtDesign, rise: float, length: float, wearer: Measurements
) -> Iterator[Ring]:
    """The skirt's cloth below the hips, above its highest slit, the hem's tilt left out."""
    below = length - rise * size.hips_line
    lower = rise * (size.hips_line - wearer.hips_line)  # its hips below the wearer's
    slit = max(design.front_slit, design.back_slit, design.left_slit, design.right_slit)
    shapes = _quarters(size, rise, ALL_MENDS)
    hems = [(-_hem_width(size, shape, design), -below) for shape in shapes]
    sides = [_below_hips(hem, (-shape.hips, 0.0), design, "", 0.0)[0] for hem, shape in zip(hems, shapes, strict=True)]
    for share in np.linspace(0.0, 1.0, RINGS):
        (front, y), (back, _) = (side.at(share) for side in sides)
        if -y <= (1 - slit) * below:
            body = girth_below_waist(wearer, wearer.hips_line + lower - y)
            yield Ring("a pencil skirt", -2 * (front + back), body, "raise pencil-skirt.flare, or a slit")


def _describe(setting: Setting, design: PencilSkirtDesign) -> Description:
    below = design.length * setting.size.leg_length
    shares = {
        "front": design.front_slit,
        "back": design.back_slit,
        "right": design.right_slit,
        "left": design.left_slit,
    }
    slits = {name: share for name, share in shares.items() if share * below >= VISIBLE_SLIT}
    details = [Detail(Zone.HEM, words, main=True, sided=sided) for words, sided in _slit_words(slits)]
    tags = [Tag.PENCIL if design.flare <= 1 else Tag.A_LINE, *([Tag.SLIT] if slits else [])]
    is_tilted = abs(design.low_angle) >= VISIBLE_TILT
    if is_tilted:
        tags.append(Tag.ASYMMETRIC)
        side, other = ("left", "right") if design.low_angle > 0 else ("right", "left")
        words = (f"a hem that slants down to the {side}", f"a slanted hem that is higher on the {other}")
        details.append(Detail(Zone.HEM, words, main=True, sided=True))
    if design.flare <= 1:
        nouns: tuple[str, ...] = ("pencil skirt",)
    else:
        nouns = ("A-line skirt",) if design.flare > SLIGHTLY_FLARED else ("slightly flared skirt",)
    return Description(nouns, (), tuple(details), (ASYMMETRIC,) if is_tilted else (), tuple(tags))


def _slit_words(slits: Mapping[str, float]) -> Iterator[tuple[tuple[str, ...], bool]]:
    """The wordings of slits, name to share of the length, and whether they make the halves differ."""
    if {"right", "left"} <= slits.keys() and abs(slits["right"] - slits["left"]) < EVEN_SLITS:
        high = "high " if slits["right"] > HIGH_SLIT else ""
        yield (f"{high}slits in both side seams", f"{high}side slits"), False
        slits = {name: share for name, share in slits.items() if name not in ("right", "left")}
    for name, share in slits.items():
        high = "high " if share > HIGH_SLIT else ""
        if name in ("front", "back"):
            yield (f"a {high}{name} slit", f"a {high}slit in the middle of the {name}"), False
        else:
            yield (f"a {high}slit in the {name} side seam", f"a {high}slit on the {name}"), True


PENCIL_SKIRT = BottomGarment(
    name="PencilSkirt",
    section="pencil-skirt",
    design=PencilSkirtDesign,
    mends=frozenset({Mend.FOLDED_DART}),
    cut=pencil_skirt,
    length_of=lambda size, design, rise: length_below_waist(size, design.length, rise=rise),
    description_of=_describe,
    rings_of=_rings,
    without_slits=lambda design: replace(design, front_slit=0.0, back_slit=0.0, left_slit=0.0, right_slit=0.0),
    hem_tilt=lambda design: design.low_angle,
    widened_by="flare",
    remedies=("low_angle", "flare", "left_slit-", "right_slit-"),
)
