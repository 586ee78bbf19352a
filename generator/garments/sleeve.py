"""Sleeves: panels ``right_sleeve_f`` and ``right_sleeve_b``; the left sleeve is a mirrored right sleeve."""

from bisect import bisect_left
from dataclasses import dataclass, replace
from enum import Enum
from functools import lru_cache
from math import atan2, cos, hypot, pi, radians, sin

import numpy as np
import shapely
import shapely.affinity

from gcd_dataset.curves import Cubic, Point
from gcd_dataset.generator.garments.cuff import Cuff, SleeveCuffDesign, sleeve_cuff_length, with_sleeve_cuff
from gcd_dataset.generator.garments.description import RUFFLES, UNGATHERED, CuffGathers, Tag
from gcd_dataset.generator.garments.mends import Mend
from gcd_dataset.generator.garments.space import Design, choice, flag, integer, part, real
from gcd_dataset.generator.pattern import Component, Outline, Piece, Stroke, chain_from, rotate, smooth_cubic
from gcd_dataset.records import EdgeRole, Measurements, PanelRole

CURVE = Cubic((0.2, -0.35), (0.5, -0.2))  # edge frame, from underarm to shoulder, GarmentCode


class Armhole(Enum):
    """Shape of an armhole, by GarmentCode's name."""

    SQUARE = "ArmholeSquare"
    ANGLE = "ArmholeAngle"
    CURVE = "ArmholeCurve"


def armhole(kind: Armhole, width: float, depth: float, *, corner: float) -> tuple[Stroke, ...]:
    """The edge from the underarm at (0, 0) to the shoulder, ``width`` inwards and ``depth`` upwards [cm].

    ``corner``: position of the corner of an angled armhole, as a fraction of its width and height.
    """
    start = Outline.start(0, 0)
    match kind:
        case Armhole.SQUARE:
            drawn = start.line(width, 0).line(width, depth)
        case Armhole.ANGLE:
            drawn = start.line((1 - corner) * width, corner * depth).line(width, depth)
        case Armhole.CURVE:
            drawn = start.curve(width, depth, CURVE)
    return tuple(stroke.called("armhole", EdgeRole.RIGHT_ARMHOLE) for stroke in drawn.strokes)


SHORTEST = 5.0  # cm of sleeve under the arm, GarmentCode
EVEN = 0.2  # cm along the front opening: a crease closer than this to either end is ignored, GarmentCode
SEWABLE = 0.6  # cm: a shorter surplus of the front opening would make edges too short to sew
STANDING_FROM = pi / 36  # rad: least difference of rest angle and shoulder slope for a standing shoulder, GarmentCode
FRONT, BACK = 15.0, -15.0  # cm before and behind the arm, GarmentCode
ELBOW = 0.5  # position of the elbow, as a fraction of armhole to wrist
# Largest length of a sleeve with each word, of armhole to wrist; the tag "short sleeves" ends at ``ELBOW``
LENGTHS: tuple[tuple[float, tuple[str, ...]], ...] = (
    (0.2, ("cap",)),
    (0.4, ("short",)),
    (ELBOW, ("elbow-length",)),
    (0.8, ("three-quarter", "three-quarter-length")),
    (1.05, ("long", "full-length")),
)
LONGEST = ("extra-long",)
END_WIDTHS = ((1.25, "flared "), (0.65, ""))  # least width at the end over the gathered width at the armhole
DOWN: Point = (0.0, -1.0)


@dataclass(frozen=True)
class SleeveDesign(Design):
    """A sleeve, or an armhole without a sleeve."""

    sleeveless: bool = flag(True, keep=0.7)
    """Whether the armhole has no sleeve."""
    armhole_shape: Armhole = choice(Armhole.CURVE, *Armhole, keep=0.7)
    """Shape of an armhole without sleeve; sleeves are set into curved armholes."""
    length: float = real(0.3, 0.1, 1.15)
    """Length, as a fraction of armhole to wrist."""
    connecting_width: float = real(0.2, 0.0, 2.0, keep=0.6)
    """Extra depth of the armhole, as a fraction of the armscye with its ease."""
    end_width: float = real(1.0, 0.2, 2.0, keep=0.4)
    """Width at the sleeve's end, as a fraction of its width at the armhole."""
    sleeve_angle: int = integer(10, 10, 50)
    """Rest angle: slope of the sleeve below the horizontal [degrees]; at least the shoulder's slope."""
    opening_dir_mix: float = real(0.1, -0.9, 0.8, keep=1.0)
    """Tangent of the opening at the underarm: 0 along its chord, 1 straight down."""
    standing_shoulder: bool = flag(False, keep=0.8)
    """Whether the sleeve continues the shoulder before it bends down; requires a rest angle 5 degrees
    over the shoulder's slope."""
    standing_shoulder_len: float = real(5.0, 4.0, 10.0)
    """Length of the part that continues the shoulder [cm]."""
    connect_ruffle: float = real(1.0, 1.0, 2.0, keep=0.4)
    """Gathers at the armhole: ratio of the sleeve's opening to the armhole."""
    smoothing_coeff: float = real(0.25, 0.1, 0.4, keep=0.8)
    """Position of an angled armhole's corner, as a fraction of its width and height."""
    cuff: SleeveCuffDesign = part(SleeveCuffDesign)

    @property
    def has_flared_cuff(self) -> bool:
        """Whether the design has a sleeve with a skirt in its cuff."""
        return not self.sleeveless and self.cuff.type in (Cuff.SKIRT, Cuff.BAND_SKIRT)


@dataclass(frozen=True)
class LeftCuffDesign(SleeveCuffDesign):
    """The cuff of a left sleeve that differs from the right one."""

    top_ruffle: float = real(1.0, 1.0, 2.0)


@dataclass(frozen=True)
class LeftSleeveDesign(SleeveDesign):
    """A left sleeve that differs from the right one."""

    opening_dir_mix: float = real(0.2, -0.9, 0.8, keep=1.0)
    cuff: SleeveCuffDesign = part(LeftCuffDesign)


def sleeve_tag(design: SleeveDesign) -> Tag:
    """The tag of two such sleeves by their length, cuffs included."""
    return Tag.SHORT_SLEEVES if design.length <= ELBOW else Tag.LONG_SLEEVES


def sleeve_words(
    size: Measurements, design: SleeveDesign, gathers: CuffGathers = UNGATHERED, *, pair: bool = True
) -> tuple[str, ...]:
    """Noun phrases for a pair of sleeves or for one, without article; a sleeve's length includes its cuff.

    ``gathers``: of its cuff.
    """
    noun = "sleeves" if pair else "sleeve"
    lengths = next((words for most, words in LENGTHS if design.length <= most), LONGEST)
    gathered = design.connect_ruffle >= RUFFLES
    into_cuff = design.cuff.type in (Cuff.BAND, Cuff.BAND_SKIRT) and gathers.limb >= RUFFLES
    if gathered and into_cuff and design.length <= ELBOW:
        return (f"puffed cap {noun}",) if lengths[0] == "cap" else tuple(f"{length} puff {noun}" for length in lengths)
    share = design.end_width / design.connect_ruffle
    cut = next((word for least, word in END_WIDTHS if share >= least), "tapered ")
    cut = "" if into_cuff and cut == "flared " else cut
    phrases = tuple(f"{length} {cut}{noun}" for length in lengths)
    rest = max(radians(design.sleeve_angle), size.shoulder_incl)
    if gathered:
        return tuple(f"{phrase} gathered at the {'shoulders' if pair else 'shoulder'}" for phrase in phrases)
    if design.standing_shoulder and rest > size.shoulder_incl + STANDING_FROM:
        return tuple(f"{phrase} with {'raised shoulders' if pair else 'a raised shoulder'}" for phrase in phrases)
    return phrases


@lru_cache(maxsize=8)  # sampling draws it to measure its cuff, then the half draws it again
def sleeve(
    size: Measurements, design: SleeveDesign, front_armhole: Stroke, back_armhole: Stroke, *, mends: frozenset[Mend]
) -> Component:
    """The right sleeve for two armholes, along the arm, with its cuff; offers ``opening`` (front up, then back down).

    Both armholes are drawn from the underarm up to the shoulder.
    """
    rest = max(radians(design.sleeve_angle), size.shoulder_incl)
    openings = [_opening(armhole, rest, design.opening_dir_mix) for armhole in (front_armhole, back_armhole)]
    shortest = SEWABLE if Mend.SLEEVE_SURPLUS in mends else 0.0
    front_opening, back_opening = _equalised(*openings, shortest=shortest)
    front = _half(size, design, "right_sleeve_f", front_opening, rest).at(0, 0, FRONT)
    back = _half(size, design, "right_sleeve_b", back_opening, rest).at(0, 0, BACK)
    gather = design.connect_ruffle
    plain = (
        Component.of(front, back)
        .sewn(front.along("upper"), back.along("upper"))
        .sewn(front.along("under"), back.along("under"))
        .offering(
            opening=front.along("opening", ruffle=gather) + back.against("opening", ruffle=gather),
            end=front.along("end") + back.against("end"),
        )
    )
    return with_sleeve_cuff(size, design, plain).turned(size.arm_pose_angle).labelled(PanelRole.ARM)


@lru_cache(maxsize=16)  # sleeves that differ in length or cuff have the same opening
def _opening(armhole: Stroke, rest: float, mix: float) -> Stroke:
    """The sleeve's edge for an armhole, from the underarm up to the shoulder, which is the origin.

    It has the armhole's length, points straight down at the shoulder, and its chord is turned by ``rest`` [rad].
    """
    along = rotate(DOWN, -rest)
    towards = DOWN if mix > 0 else (-1.0, 0.0)
    tangent = ((1 - mix) * along[0] + abs(mix) * towards[0], (1 - mix) * along[1] + abs(mix) * towards[1])
    size = hypot(*tangent)
    chord = hypot(*armhole.chord)
    return smooth_cubic(
        (0.0, 0.0),
        (chord * along[0], chord * along[1]),
        start_tangent=DOWN,
        end_tangent=(tangent[0] / size, tangent[1] / size),
        length=armhole.length,
    ).reversed()


def _equalised(front: Stroke, back: Stroke, *, shortest: float) -> tuple[tuple[Stroke, ...], tuple[Stroke, ...]]:
    """Both openings with chords of equal length and slope, so that the sleeve's halves match along the arm.

    Laid flat, the whole opening is the front followed by the back, turned over. The crease between the halves is the
    intersection of the front with the perpendicular bisector of the two underarm points; the surplus of the front
    beyond the crease moves to the back. A front shorter than its back, or longer by less than ``shortest`` cm, keeps
    its shape.
    """
    front_under, back_under = front.start, back.upside_down().start
    span = (back_under[0] - front_under[0], back_under[1] - front_under[1])
    tilt = atan2(span[0], span[1])
    # The curve parameter of the front that is equally far from both underarm points: the root of a cubic.
    middle = (0.5 * (front_under[0] + back_under[0]), 0.5 * (front_under[1] + back_under[1]))
    p, q, r, s = ((x - middle[0]) * span[0] + (y - middle[1]) * span[1] for x, y in front.control_points())
    roots = np.roots([s - 3 * r + 3 * q - p, 3 * (r - 2 * q + p), 3 * (q - p), p])
    between = (float(root.real) for root in roots if abs(root.imag) < 1e-9 and 0 < root.real < 1)
    crease = max(between, default=None)
    even = EVEN / front.length
    if crease is None or not even < crease < 1 - even or hypot(*front.at(crease)) < shortest:
        return (front.rotated(tilt),), (back.rotated(-tilt),)
    kept, surplus = front.split_at([crease])
    return (kept.rotated(tilt),), (back.rotated(-tilt), surplus.reversed().upside_down().rotated(-tilt))


def _half(size: Measurements, design: SleeveDesign, name: str, opening: tuple[Stroke, ...], rest: float) -> Piece:
    """Half a sleeve of rest angle ``rest`` [rad]: wrist at x = 0, upper edge on the x axis."""
    plain_height = abs(opening[-1].end[1] - opening[0].start[1])
    gathered = _gathered(opening, design.connect_ruffle)
    width, height = (abs(gathered[-1].end[axis] - gathered[0].start[axis]) for axis in (0, 1))
    end = max(design.end_width * plain_height, 0.5 * size.wrist)
    length = max(design.length * (size.arm_length - width) - sleeve_cuff_length(size, design), SHORTEST)
    outline = (
        Outline.start(0, 0)
        .line(0, -end, name="end")
        .line(length, -height, name="under")
        .then(*(replace(stroke, name="opening") for stroke in chain_from((length, -height), *gathered)))
    )
    if design.standing_shoulder and rest > size.shoulder_incl + STANDING_FROM:
        (x, y), angle = outline.pen, rest - size.shoulder_incl  # continues the shoulder's slope towards the wrist
        x, y = x - design.standing_shoulder_len * cos(angle), y + design.standing_shoulder_len * sin(angle)
        outline = outline.line(x, y, name="upper")
    return Piece(name, outline.close(name="upper"))


def _gathered(strokes: tuple[Stroke, ...], factor: float) -> tuple[Stroke, ...]:
    """The strokes scaled about their first point by a factor."""
    x0, y0 = strokes[0].start

    def enlarged(point: Point) -> Point:
        return (x0 + factor * (point[0] - x0), y0 + factor * (point[1] - y0))

    return tuple(replace(stroke, start=enlarged(stroke.start), end=enlarged(stroke.end)) for stroke in strokes)


SLEEVE_GAP = 1.0  # cm by which a sleeve starts inside its armhole, GarmentCode
SLEEVE_GAP_BY_ANGLE = 18 / pi  # cm/rad: a tenth of a centimetre per degree, GarmentCode
OVERLAP = 150.0  # cm²: largest overlap of sleeve and trunk, seen from the front; plain shirts with it drape cleanly
DRAWN_OUT = 24  # cm: upper bound of a sleeve's shift along the arm


def with_sleeve(size: Measurements, design: SleeveDesign, half: Component, *, mends: frozenset[Mend]) -> Component:
    """The right half of an upper body with a sleeve sewn to its armhole; needs ``ArmholeCurve`` in front and behind."""
    front, back = half.piece("right_ftorso"), half.piece("right_btorso")
    half = half.offering(armhole=front.along("armhole") + back.against("armhole"))
    gap = SLEEVE_GAP + SLEEVE_GAP_BY_ANGLE * size.arm_pose_angle
    arm = sleeve_of(size, design, half, mends=mends)
    arm = arm.placed_by("opening", half, "armhole", gap=-gap, top=True)
    if Mend.SLEEVE_START in mends:
        arm = _clear_of(half, arm, size.arm_pose_angle)
    band = {name: ring for name, ring in arm.interfaces.items() if name == "band"}
    sewn = Component.of(arm, half).sewn(arm.interface("opening"), half.interface("armhole"))
    return sewn.offering(**half.interfaces, **band)


def sleeve_of(size: Measurements, design: SleeveDesign, half: Component, *, mends: frozenset[Mend]) -> Component:
    """The right sleeve for the armhole of a half, with its cuff, not yet placed: see ``sleeve``."""
    front, back = (half.piece(name).outline.edge("armhole") for name in ("right_ftorso", "right_btorso"))
    return sleeve(size, design, front, back, mends=mends)


def _clear_of(half: Component, arm: Component, angle: float) -> Component:
    """The sleeve moved out along the arm until it overlaps the trunk by at most ``OVERLAP``, as on a plain shirt.

    Without the shift, shirts with wide sides or gathered sleeves tangle while their seams close.
    """
    trunk = shapely.union_all([_silhouette(piece) for piece in half.pieces])
    silhouette = shapely.union_all([_silhouette(piece) for piece in arm.pieces])
    along = (-cos(angle), -sin(angle))

    def is_clear(step: int) -> bool:
        moved = shapely.affinity.translate(silhouette, step * along[0], step * along[1])
        return bool(moved.intersection(trunk).area <= OVERLAP)

    step = 0 if is_clear(0) else bisect_left(range(DRAWN_OUT), True, lo=1, key=is_clear)
    return arm.moved((step * along[0], step * along[1], 0.0)) if step else arm


def _silhouette(piece: Piece) -> shapely.Polygon:
    """A piece as seen from the front [cm]."""
    return shapely.Polygon(piece.points()[:, :2]).buffer(0)
