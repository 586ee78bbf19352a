"""The right half of the upper body: with armhole, neckline, sleeve and collar, or strapless."""

from dataclasses import replace
from functools import lru_cache
from typing import NamedTuple, Self, TypeAlias

from gcd_dataset.errors import PatternError
from gcd_dataset.generator.garments.armhole import Armhole, armhole
from gcd_dataset.generator.garments.bodice import fitted_back, fitted_front
from gcd_dataset.generator.garments.collar import with_collar
from gcd_dataset.generator.garments.mends import ALL_MENDS, Mend
from gcd_dataset.generator.garments.neckline import NecklineDesign, half_neckline, neckline_drop, worn_neckline
from gcd_dataset.generator.garments.shirt import ShirtDesign, straight_back, straight_front
from gcd_dataset.generator.garments.sleeve import SleeveDesign
from gcd_dataset.generator.garments.sleeve_start import with_sleeve
from gcd_dataset.generator.garments.torso import TorsoHalf
from gcd_dataset.generator.pattern import Component, Piece, Stroke, cut_corner
from gcd_dataset.records import EdgeRole, Measurements, PanelRole

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
) -> Component:
    """Front, back, sleeve and collar of the right side.

    Offers the edges that meet the left half as ``*_centre``, the hem as ``front_bottom`` and ``back_bottom``, each
    walked away from the centre, and the narrowest ring of a sleeve's cuff as ``band``.
    """
    half = right_torso(size, shirt, neck, arm, fitted=fitted, mends=mends)
    if not (fitted and shirt.strapless):
        half = half if arm.sleeveless else with_sleeve(size, arm, half, mends=mends)
        half = with_collar(size, neck.component, half)
    return half.labelled(PanelRole.BODY)


@lru_cache(maxsize=8)  # sampling draws it for the sewability check, then the outfit draws it again
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
    return Piece(name, half.outline).at(0, size.height - size.head_l - half.neck_base, z)


def armhole_from_centre(
    size: Measurements, shirt: ShirtDesign, arm: SleeveDesign, *, fitted: bool, mends: frozenset[Mend] = ALL_MENDS
) -> float:
    """Horizontal distance of the armhole from the centre, the smaller one of front and back [cm].

    Raises ``PatternError`` for armholes that cannot be cut.
    """
    halves = _with_armholes(size, shirt, _Armholes.of(arm), fitted=fitted, mends=mends)
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
    return half.cut_to(cut_corner(half.outline, "side", "shoulder", shape))


def _with_neckline(size: Measurements, neck: NecklineDesign, half: TorsoHalf, *, front: bool) -> TorsoHalf:
    """The half with its neckline cut into the shoulder beside the armhole."""
    shape = half_neckline(size, neck, front=front, shoulder=half.shoulder, room=half.room)
    width, left = shape[-1].end[0] - shape[0].start[0], _shoulder_end(half)
    if width >= left:
        raise PatternError(
            f"a neckline {width:.1f} cm from the centre leaves no shoulder beside an armhole at {left:.1f} cm: narrow "
            "collar.width"
        )
    return half.cut_to(cut_corner(half.outline, "shoulder", "centre", shape))


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
    return half.cut_to(half.outline.with_strokes((side, shoulder, centre), (under, top, replace(centre, start=inner))))
