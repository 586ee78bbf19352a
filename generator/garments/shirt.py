"""The shirt: its design, and the half front and half back of a straight shirt."""

from dataclasses import dataclass, replace
from functools import lru_cache
from math import pi, tan
from typing import NamedTuple, Self, TypeAlias

from gcd_dataset.errors import PatternError
from gcd_dataset.generator.garments.collar import with_collar
from gcd_dataset.generator.garments.front import with_extension
from gcd_dataset.generator.garments.mends import ALL_MENDS, Mend, folds
from gcd_dataset.generator.garments.neckline import NecklineDesign, half_neckline, neckline_drop, worn_neckline
from gcd_dataset.generator.garments.sleeve import Armhole, SleeveDesign, armhole, with_sleeve
from gcd_dataset.generator.garments.space import Design, flag, real
from gcd_dataset.generator.garments.trunk import waist_front
from gcd_dataset.generator.pattern import (
    Component,
    Outline,
    Piece,
    Stroke,
    chain_from,
    cut_corner,
    cut_into,
    dart,
    tangent_quadratic,
)
from gcd_dataset.records import EdgeRole, Measurements, PanelRole


@dataclass(frozen=True, slots=True)
class TorsoHalf:
    """Half a front or back: upright at the centre, sloping at the shoulder."""

    outline: Outline
    """Drawn from the centre of the hem to the side, up to the shoulder and back: bottom, side, shoulder, centre."""
    shoulder: float
    """Distance from the centre to the shoulder's outer end [cm]."""
    level: float
    """Height of the shoulder's outer end over the origin of the drawing [cm]."""
    rise: float
    """Height of the base of the neck over the shoulder's outer end [cm]."""
    lean: float = 0.0
    """Increase of the half's width per cm below the shoulder's outer end."""
    gather: float = 1.0
    """Length of the hem over its projected length in the waist seam."""
    darts: tuple[str, ...] = ()
    """Names of the darts; their legs are the edges NAME.0 and NAME.1."""

    @property
    def upper_side(self) -> float:
        """Length of the uppermost part of the side: from the shoulder or armhole to the next dart or the hem [cm]."""
        return self.outline.run("side")[-1].length

    @property
    def room(self) -> float:
        """Length of the centre edge below the level of the shoulder's outer end, before a neckline is cut [cm]."""
        return self.outline.length("centre") - self.rise

    def armhole_room(self, shoulder_end: float) -> float:
        """Largest depth of an armhole with its upper end ``shoulder_end`` cm from the centre [cm].

        The upper end lies on the shoulder seam, ``over`` cm above the shoulder's outer end. This rise adds to the
        depth, and moves the upper end inwards by ``lean * over`` cm.
        """
        slope = self.rise / self.shoulder
        over = slope * (self.shoulder - shoulder_end) / (1 - slope * self.lean)
        return self.level - self.outline.run("side")[-1].start[1] + over

    def width_below_shoulder(self, depth: float) -> float:
        """Width from the centre to the side, ``depth`` cm below the shoulder's outer end [cm]."""
        return self.shoulder + depth * self.lean


@dataclass(frozen=True)
class ShirtDesign(Design):
    """The body of a shirt; a fitted shirt ignores length, width and flare."""

    strapless: bool = flag(False, keep=0.8)
    """Whether a fitted shirt ends above the bust."""
    length: float = real(1.2, 0.5, 3.5, keep=0.7)
    """Length, as a fraction of nape to waist."""
    width: float = real(1.05, 1.0, 1.3, keep=0.4)
    """Girth of the chest, as a fraction of the bust."""
    flare: float = real(1.0, 0.7, 1.6, keep=0.4)
    """Girth of the hem, as a fraction of the chest."""


@dataclass(frozen=True)
class LeftShirtDesign(Design):
    """The left half of a shirt that differs from the right one; both have the same length."""

    strapless: bool = flag(False, keep=0.8)
    """Whether the left half of a fitted shirt ends above the bust."""
    width: float = real(1.0, 1.0, 1.3, keep=0.4)
    """Width of the left half's chest, as a fraction of half the bust."""
    flare: float = real(1.0, 0.7, 1.6, keep=0.4)
    """Width of the left half's hem, as a fraction of its chest."""

    def beside(self, right: ShirtDesign) -> ShirtDesign:
        """The complete design of the left half: length from the right one."""
        return ShirtDesign(strapless=self.strapless, length=right.length, width=self.width, flare=self.flare)


def straight_front(size: Measurements, design: ShirtDesign) -> TorsoHalf:
    """Half a front; if wider than the back it is drawn shorter, so that both shoulders end at the same height."""
    slope, chest = tan(size.shoulder_incl), 0.5 * design.width * (size.bust - size.back_width)
    side = design.length * size.waist_line - slope * (0.5 * size.bust - size.back_width)
    return _straight(chest, design.flare * chest, side, slope, waist=0.5 * waist_front(size))


def straight_back(size: Measurements, design: ShirtDesign) -> TorsoHalf:
    """Half a back."""
    slope, chest, waist = tan(size.shoulder_incl), 0.5 * design.width * size.back_width, 0.5 * size.waist_back_width
    return _straight(chest, design.flare * chest, design.length * size.waist_line, slope, waist=waist)


def _straight(chest: float, hem: float, side: float, slope: float, *, waist: float) -> TorsoHalf:
    """A half with its shoulder ``side`` cm over the hem; ``waist``: projected length of the hem in its seam [cm]."""
    rise = slope * chest
    outline = (
        Outline.start(0, 0)
        .line(-hem, 0, name="bottom")
        .line(-chest, side, name="side")
        .line(0, side + rise, name="shoulder")
        .close(name="centre")
    )
    return TorsoHalf(outline, chest, side, rise, lean=(hem - chest) / side, gather=hem / waist)


WAIST_DART_SHARE = 2 / 3  # share of the front's waist excess in the dart; the rest at the side, GarmentCode
WAIST_DART_LEG = 0.9  # dart leg over waist to bust, GarmentCode
SIDE_DART_LEG = 0.75  # dart leg over side to bust point, GarmentCode
OUTER_DART_LEG = 0.9  # outer over inner dart leg of the back, GarmentCode
DARTS_APART = 0.25  # offset of the back's darts from the bum points over half the distance of these, GarmentCode
SIDE_SHARE = 1 / 6  # share of the back's waist excess at the side seam, GarmentCode
SIDE_STRAIGHT = 4.0  # cm of waist excess below which the side stays straight, GarmentCode
WAIST_RISE = 0.25  # rise of the back's waist at the centre over its shoulder rise, GarmentCode
LEFTWARDS = pi  # heading of the hem [rad]
UPWARDS = pi / 2  # heading of the side [rad]


def fitted_front(size: Measurements, mends: frozenset[Mend]) -> TorsoHalf:
    """Half a front, with a side dart at the bust and a waist dart under the bust.

    Without a side dart the front is as long over the bust as beside it, so that its side matches the back's.
    """
    bust, waist = 0.5 * (size.bust - size.back_width), 0.5 * (size.waist - size.waist_back_width)
    shoulder = 0.5 * size.shoulder_w
    rise = tan(size.shoulder_incl) * shoulder
    point, to_bust = 0.5 * size.bust_points, size.waist_line - size.drawn_bust_line
    intake = max(WAIST_DART_SHARE * (bust - waist), 0.0)
    opening = size.waist_over_bust_line - size.waist_line
    if opening <= 0.0:
        raise PatternError(
            f"right_ftorso: waist_over_bust_line of {size.waist_over_bust_line:.1f} cm leaves no side dart over a "
            f"waist_line of {size.waist_line:.1f} cm: correct the measures"
        )
    intake, opening = (0.0 if folds(width, mends) else width for width in (intake, opening))
    level = size.waist_line + opening  # height of the shoulder's outer end
    drawn = Outline.start(0, 0)
    if intake > 0.0:
        drawn = drawn.line(-point, 0, name="bottom")
        drawn = _with_dart(drawn, LEFTWARDS, intake, WAIST_DART_LEG * to_bust, "waist_dart")
    drawn = drawn.line(-(waist + intake), 0, name="bottom").line(-bust, to_bust, name="side")
    if opening > 0.0:
        drawn = _with_dart(drawn, UPWARDS, opening, SIDE_DART_LEG * (bust - point), "side_dart")
    under = drawn.pen[1]
    outline = drawn.line(-shoulder, level, name="side").line(0, level + rise, name="shoulder").close(name="centre")
    darts = tuple(name for name, width in (("waist_dart", intake), ("side_dart", opening)) if width > 0.0)
    return TorsoHalf(outline, shoulder, level, rise, lean=(bust - shoulder) / (level - under), darts=darts)


def fitted_back(size: Measurements, mends: frozenset[Mend]) -> TorsoHalf:
    """Half a back with two waist darts; its waist curves up towards the centre."""
    width, waist = 0.5 * size.back_width, 0.5 * size.waist_back_width
    slope = tan(size.shoulder_incl)
    level, rise = size.waist_line - slope * (width - 0.5 * size.shoulder_w), slope * width
    hollow, side = (0.0, WAIST_RISE * rise), (-max(width, waist), 0.0)
    outline = (
        Outline.start(*hollow)
        .curve(*side, tangent_quadratic(hollow, side, start_tangent=(-1.0, 0.0), at=0.5), name="bottom")
        .line(-width, size.waist_line - size.drawn_bust_line, name="side")
        .line(-width, level, name="side")
        .line(0, level + rise, name="shoulder")
        .close(name="centre")
    )
    half = TorsoHalf(outline, width, level, rise)
    if waist >= width:
        return half
    return _taken_in(size, half, mends, excess=width - waist, leg=level - size.drawn_bust_line)


def _taken_in(size: Measurements, back: TorsoHalf, mends: frozenset[Mend], *, excess: float, leg: float) -> TorsoHalf:
    """The back narrowed at the waist by two darts of equal width, and at the side for a large excess."""
    at_side = 0.0 if excess < SIDE_STRAIGHT else SIDE_SHARE * excess
    width, point = 0.5 * (excess - at_side), 0.5 * size.bum_points
    outer, inner = (1 + DARTS_APART) * point + 1.5 * width, (1 - DARTS_APART) * point + 0.5 * width
    outline, is_darted = back.outline, not folds(width, mends)
    if is_darted:
        outline = cut_into(outline, "bottom", dart(width, OUTER_DART_LEG * leg, name="outer_dart"), at=outer)
        outline = cut_into(outline, "bottom", dart(width, leg, name="inner_dart"), at=inner)
    waist, side = outline.run("bottom")[-1], outline.run("side")[0]
    corner = (waist.end[0] + (at_side if is_darted else excess), waist.end[1])
    outline = outline.with_strokes((waist, side), (replace(waist, end=corner), replace(side, start=corner)))
    return replace(back, outline=outline, darts=("outer_dart", "inner_dart") if is_darted else ())


def _with_dart(drawn: Outline, heading: float, width: float, leg: float, name: str) -> Outline:
    """The outline extended by a dart in an edge of this heading [rad]; the tip lies to the right of the edge."""
    legs = (stroke.mirrored().rotated(heading - pi) for stroke in dart(width, leg, name=name))
    return drawn.then(*chain_from(drawn.pen, *legs))


SEAM_LEFT = 1.0  # cm of side or centre edge left beside an armhole or neckline, GarmentCode
FRONT, BACK = 30.0, -25.0  # cm: z of front and back before sewing, GarmentCode
FRONT_NAME, BACK_NAME = "right_ftorso", "right_btorso"

UpperHalf: TypeAlias = tuple[ShirtDesign, NecklineDesign, SleeveDesign]
"""The design of one half of the upper body."""


@lru_cache(maxsize=8)
def right_half(
    size: Measurements,
    shirt: ShirtDesign,
    neck: NecklineDesign,
    arm: SleeveDesign,
    *,
    fitted: bool,
    mends: frozenset[Mend],
    extension: float = 0.0,
) -> Component:
    """Front, back, sleeve and collar of the right side, the front ``extension`` cm wider at the centre.

    Offers the edges that meet the left half as ``*_centre``, the hem as ``front_bottom`` and ``back_bottom``, each
    walked away from the centre, and the narrowest ring of a sleeve's cuff as ``band``.
    """
    half = right_torso(size, shirt, neck, arm, fitted=fitted, mends=mends)
    if extension:
        half = half.with_piece(with_extension(half.piece(FRONT_NAME), "centre", extension))
    if not (fitted and shirt.strapless):
        half = half if arm.sleeveless else with_sleeve(size, arm, half, mends=mends)
        half = with_collar(size, neck.component, half)
    return half.labelled(PanelRole.BODY)


@lru_cache(maxsize=8)  # sampling draws it for the sewability check, then the garment draws it again
def right_torso(
    size: Measurements,
    shirt: ShirtDesign,
    neck: NecklineDesign,
    arm: SleeveDesign,
    *,
    fitted: bool,
    mends: frozenset[Mend] = ALL_MENDS,
) -> Component:
    """Front and back of the right side with armhole and neckline, without sleeve and collar.

    Offers the interfaces of ``right_half``, except ``band``.
    """
    if fitted and shirt.strapless:
        return _strapless(size, neck, arm, mends=mends)
    worn = worn_neckline(neck)
    front, back = _with_armholes(size, shirt, _Armholes.of(arm), fitted=fitted, mends=mends)
    front, back = _with_neckline(size, worn, front, front=True), _with_neckline(size, worn, back, front=False)
    half = _with_sides_sewn(size, front, back)
    return half.sewn(half.piece(FRONT_NAME).along("shoulder"), half.piece(BACK_NAME).along("shoulder"))


def _with_sides_sewn(size: Measurements, front: TorsoHalf, back: TorsoHalf) -> Component:
    """Front and back placed with the base of the neck at the nape, their darts and sides sewn."""
    front_piece, back_piece = _placed(size, FRONT_NAME, front, FRONT), _placed(size, BACK_NAME, back, BACK)
    half = Component.of(front_piece, back_piece).sewn(front_piece.along("side"), back_piece.along("side"))
    for piece, torso in ((front_piece, front), (back_piece, back)):
        for name in torso.darts:
            half = half.sewn(piece.along(f"{name}.0"), piece.against(f"{name}.1"))
    return half.offering(
        front_centre=front_piece.along("centre"),
        back_centre=back_piece.along("centre"),
        front_bottom=front_piece.along("bottom", ruffle=front.gather),
        back_bottom=back_piece.along("bottom", ruffle=back.gather),
    )


def _placed(size: Measurements, name: str, half: TorsoHalf, z: float) -> Piece:
    neck_base = half.level + half.rise  # height of the shoulder line's inner end, at the centre
    return Piece(name, half.outline).at(0, size.height - size.head_l - neck_base, z)


def armhole_from_centre(size: Measurements, shirt: ShirtDesign, arm: SleeveDesign, *, fitted: bool) -> float:
    """Horizontal distance of the armhole from the centre, the smaller one of front and back [cm].

    Raises ``PatternError`` for armholes that cannot be cut.
    """
    halves = _with_armholes(size, shirt, _Armholes.of(arm), fitted=fitted, mends=ALL_MENDS)
    return min(_shoulder_end(half) for half in halves)


def _shoulder_end(half: TorsoHalf) -> float:
    """Horizontal distance of the shoulder's outer end from the centre [cm]."""
    return -half.outline.edge("shoulder").start[0]


class _Armholes(NamedTuple):
    """The part of a sleeve's design on which the armholes depend."""

    kind: Armhole
    connecting_width: float
    corner: float

    @classmethod
    def of(cls, arm: SleeveDesign) -> Self:
        """Armholes of a sleeve are curved."""
        return cls(arm.armhole_shape if arm.sleeveless else Armhole.CURVE, arm.connecting_width, arm.smoothing_coeff)


@lru_cache(maxsize=8)  # necklines, collars and cuffs are drawn again and again on the same halves
def _with_armholes(
    size: Measurements, shirt: ShirtDesign, arm: _Armholes, *, fitted: bool, mends: frozenset[Mend]
) -> tuple[TorsoHalf, TorsoHalf]:
    """Front and back with their armholes, without necklines."""
    front = fitted_front(size, mends) if fitted else straight_front(size, shirt)
    back = fitted_back(size, mends) if fitted else straight_back(size, shirt)
    depth = _armhole_depth(size, arm.connecting_width, front, back, mends=mends)
    return _with_armhole(size, arm, front, depth), _with_armhole(size, arm, back, depth)


def _armhole_depth(
    size: Measurements, connecting_width: float, front: TorsoHalf, back: TorsoHalf, *, mends: frozenset[Mend]
) -> float:
    """Depth of the armhole [cm], limited so that a centimetre of side seam is left."""
    depth = min(size.eased_armscye_depth * (1 + connecting_width), front.upper_side - SEAM_LEFT)
    if Mend.ARMHOLE_ROOM not in mends:
        return depth
    return min(depth, *(half.armhole_room(0.5 * size.sleeve_balance) - SEAM_LEFT for half in (front, back)))


def _with_armhole(size: Measurements, arm: _Armholes, half: TorsoHalf, depth: float) -> TorsoHalf:
    """The half with its armhole cut."""
    shoulder_end = 0.5 * size.sleeve_balance
    width, room = half.width_below_shoulder(depth) - shoulder_end, half.armhole_room(shoulder_end)
    if width <= 0.0:
        raise PatternError(
            f"a shirt of {half.width_below_shoulder(depth):.1f} cm from centre to side has no room for armholes "
            f"{shoulder_end:.1f} cm from the centre: raise shirt.width"
        )
    if depth >= room:
        raise PatternError(
            f"an armhole {depth:.1f} cm deep in a side with room for {room:.1f} cm: lower sleeve.connecting_width"
        )
    shape = armhole(arm.kind, width, depth, corner=arm.corner)
    return replace(half, outline=cut_corner(half.outline, "side", "shoulder", shape))


def _with_neckline(size: Measurements, neck: NecklineDesign, half: TorsoHalf, *, front: bool) -> TorsoHalf:
    """The half with its neckline cut into the shoulder beside the armhole."""
    shape = half_neckline(size, neck, front=front, shoulder=half.shoulder, room=half.room)
    width, left = shape[-1].end[0] - shape[0].start[0], _shoulder_end(half)
    if width >= left:
        raise PatternError(
            f"a neckline {width:.1f} cm from the centre leaves no shoulder beside an armhole at {left:.1f} cm: narrow "
            "collar.width"
        )
    return replace(half, outline=cut_corner(half.outline, "shoulder", "centre", shape))


def _strapless(size: Measurements, neck: NecklineDesign, arm: SleeveDesign, *, mends: frozenset[Mend]) -> Component:
    """Front and back of a fitted half that end in a line from the underarm to the lowest point of the neckline."""
    front, back = fitted_front(size, mends), fitted_back(size, mends)
    side = back.armhole_room(0.5 * size.sleeve_balance) - _armhole_depth(
        size, arm.connecting_width, front, back, mends=mends
    )
    cropped_back = _cropped(size, neck, back, side, front=False)
    side = cropped_back.outline.length("side") - (front.outline.length("side") - front.upper_side)
    return _with_sides_sewn(size, _cropped(size, neck, front, side, front=True), cropped_back)


def _cropped(size: Measurements, neck: NecklineDesign, half: TorsoHalf, kept: float, *, front: bool) -> TorsoHalf:
    """The half cut off by a line from the side, ``kept`` cm above the start of its uppermost part, to the centre."""
    side, shoulder, centre = half.outline.run("side")[-1], half.outline.edge("shoulder"), half.outline.edge("centre")
    inner = (0.0, half.level - neckline_drop(size, neck, front=front, room=half.room))
    if not 0.0 < kept < side.length:
        raise PatternError(
            f"{FRONT_NAME if front else BACK_NAME}: a strapless top would leave {kept:.1f} of {side.length:.1f} cm of "
            "side: change sleeve.connecting_width"
        )
    under, _ = side.split([kept / side.length])
    top = Stroke(under.end, inner, name="top", label=EdgeRole.STRAPLESS_TOP)
    cropped = half.outline.with_strokes((side, shoulder, centre), (under, top, replace(centre, start=inner)))
    return replace(half, outline=cropped)
