"""The shirt: ``right_ftorso``, ``right_btorso`` and their mirror images, with or without sleeves."""

from dataclasses import dataclass, replace
from math import cos, pi, sin, tan

import shapely
import shapely.affinity

from gcd_dataset.generator.garments.neckline import Neckline, NecklineDesign, neckline, neckline_width
from gcd_dataset.generator.garments.sleeve import SleeveDesign, armhole_curve, sleeve
from gcd_dataset.generator.garments.space import Design, real
from gcd_dataset.generator.garments.trunk import waist_back, waist_front
from gcd_dataset.generator.pattern import Component, Outline, Piece, Stroke, backwards, cut_corner
from gcd_dataset.records import Measurements

__all__ = ["ShirtDesign", "shirt"]

SEAM_LEFT = 1.0  # cm of side or centre edge left beside an armhole or neckline, GarmentCode
FRONT, BACK = 30.0, -25.0  # cm before and behind the axis, GarmentCode
SLEEVE_GAP = 1.0  # cm into the armhole, GarmentCode
OVERLAP = 150.0  # cm² of sleeve before the trunk with which plain shirts are sewn together cleanly
DRAWN_OUT = 24  # cm by which a sleeve may start further out for it
SLEEVE_GAP_BY_ANGLE = 18 / pi  # cm/rad: a tenth of a centimetre a degree, GarmentCode


@dataclass(frozen=True)
class ShirtDesign(Design):
    """The body of a straight shirt."""

    length: float = real(1.2, 0.5, 3.5, keep=0.7)
    """As a fraction of nape to waist."""
    width: float = real(1.05, 1.0, 1.3, keep=0.4)
    """Chest, as a fraction of the bust."""
    flare: float = real(1.0, 0.7, 1.6, keep=0.4)
    """Hem, as a fraction of the chest."""


@dataclass(frozen=True, slots=True)
class _Half:
    """Half a front or back before its cuts: upright at the centre, sloping at the shoulder [cm]."""

    chest: float
    hem: float
    side: float
    """Height of the shoulder's outer end over the hem."""
    slope: float
    """Of the shoulder, as a tangent."""

    @property
    def neck_base(self) -> float:
        """Height of the shoulder line's inner end, at the centre, over the hem."""
        return self.side + self.slope * self.chest

    def width_below_shoulder(self, depth: float) -> float:
        """From the centre to the side, ``depth`` cm under the shoulder's outer end."""
        return self.chest + depth * (self.hem - self.chest) / self.side

    def outline(self) -> Outline:
        """The right half: from the centre of the hem to the side, up to the shoulder and back."""
        return (
            Outline.start(0, 0)
            .line(-self.hem, 0, name="bottom")
            .line(-self.chest, self.side, name="side")
            .line(0, self.neck_base, name="shoulder")
            .close(name="centre")
        )


def shirt(size: Measurements, body: ShirtDesign, neck: NecklineDesign, arms: SleeveDesign) -> Component:
    """Two halves sewn at the centres; offers ``bottom`` [ring]."""
    right = _right_half(size, body, neck, arms)
    left = right.mirrored("right", "left")
    return (
        Component.of(right, left)
        .sewn(right.interface("front_centre"), left.interface("front_centre"))
        .sewn(right.interface("back_centre"), left.interface("back_centre"))
        .offering(
            bottom=backwards(right.interface("front_bottom"))
            + left.interface("front_bottom")
            + backwards(left.interface("back_bottom"))
            + right.interface("back_bottom")
        )
        .labelled("body")
    )


def _right_half(size: Measurements, body: ShirtDesign, neck: NecklineDesign, arms: SleeveDesign) -> Component:
    """Front, back and sleeve of the right side, each edge that meets the left side offered."""
    drawn_front, drawn_back = _front(size, body), _back(size, body)
    depth = _armhole_depth(size, arms, drawn_front, drawn_back)
    front_neck = _neckline(size, drawn_front, neck, neck.f_collar, neck.fc_depth)
    back_neck = _neckline(size, drawn_back, neck, neck.b_collar, neck.bc_depth)
    front = _hung(size, drawn_front, FRONT, "right_ftorso", _cut(size, drawn_front, depth, front_neck))
    back = _hung(size, drawn_back, BACK, "right_btorso", _cut(size, drawn_back, depth, back_neck))
    half = (
        Component.of(front, back)
        .sewn(front.along("side"), back.along("side"))
        .sewn(front.along("shoulder"), back.along("shoulder"))
        .offering(
            armhole=front.along("armhole") + back.against("armhole"),
            front_centre=front.along("centre"),
            back_centre=back.along("centre"),
            front_bottom=front.along("bottom", ruffle=drawn_front.hem / (0.5 * waist_front(size))),
            back_bottom=back.along("bottom", ruffle=drawn_back.hem / (0.5 * waist_back(size))),
        )
    )
    return half if arms.sleeveless else _with_sleeve(size, arms, half)


def _front(size: Measurements, body: ShirtDesign) -> _Half:
    slope, chest = tan(size.shoulder_incl), 0.5 * body.width * (size.bust - size.back_width)
    # The front is drawn shorter where it is wider than the back, so that both shoulders end at one height.
    side = body.length * size.waist_line - slope * (0.5 * size.bust - size.back_width)
    return _Half(chest, body.flare * chest, side, slope)


def _back(size: Measurements, body: ShirtDesign) -> _Half:
    slope, chest = tan(size.shoulder_incl), 0.5 * body.width * size.back_width
    return _Half(chest, body.flare * chest, body.length * size.waist_line, slope)


def _armhole_depth(size: Measurements, arms: SleeveDesign, *halves: _Half) -> float:
    """Height of the armhole, leaving a centimetre of side seam [cm]."""
    shortest = min(half.outline().edge("side").length for half in halves)
    return min(size.eased_armscye_depth * (1 + arms.connecting_width), shortest - SEAM_LEFT)


def _cut(size: Measurements, half: _Half, armhole_depth: float, neck: tuple[Stroke, ...]) -> Outline:
    """The half with armhole and neckline cut; the armhole first, since it shortens the shoulder."""
    armhole = armhole_curve(half.width_below_shoulder(armhole_depth) - 0.5 * size.sleeve_balance, armhole_depth)
    outline = cut_corner(half.outline(), "side", "shoulder", (armhole,))
    return cut_corner(outline, "shoulder", "centre", neck)


def _hung(size: Measurements, half: _Half, z: float, name: str, outline: Outline) -> Piece:
    """The outline of a half as a piece, hung by the base of its neck."""
    return Piece(name, outline).at(0, size.height - size.head_l - half.neck_base, z)


def _neckline(
    size: Measurements, half: _Half, neck: NecklineDesign, kind: Neckline, depth: float
) -> tuple[Stroke, ...]:
    """The neckline, its depth counted from the level of the shoulder's outer end."""
    half_width = 0.5 * neckline_width(size, neck)
    below = min(depth * size.drawn_bust_line, half.side - SEAM_LEFT)
    strokes = neckline(kind, half_width, below + half.slope * (half.chest - half_width))
    return tuple(replace(stroke, label="right_collar") for stroke in strokes)


def _with_sleeve(size: Measurements, arms: SleeveDesign, half: Component) -> Component:
    """The half with a sleeve in its armhole."""
    front, back = (half.piece(name).outline.edge("armhole") for name in ("right_ftorso", "right_btorso"))
    gap = SLEEVE_GAP + SLEEVE_GAP_BY_ANGLE * size.arm_pose_angle
    arm = sleeve(size, arms, front, back).placed_by("opening", half, "armhole", gap=-gap, top=True)
    arm = _clear_of(half, arm, size.arm_pose_angle)
    return Component.of(arm, half).sewn(arm.interface("opening"), half.interface("armhole")).offering(**half.interfaces)


def _clear_of(half: Component, arm: Component, angle: float) -> Component:
    """The sleeve drawn out along the arm until it hangs no further over the trunk than that of a plain shirt does.

    Wide sides and gathered sleeves that start one in the other are sewn together tangled.
    """
    trunk = shapely.union_all([_silhouette(piece) for piece in half.pieces])
    silhouette = shapely.union_all([_silhouette(piece) for piece in arm.pieces])
    along = (-cos(angle), -sin(angle))
    for step in range(DRAWN_OUT):
        moved = shapely.affinity.translate(silhouette, step * along[0], step * along[1])
        if moved.intersection(trunk).area <= OVERLAP:
            return arm.moved((step * along[0], step * along[1], 0.0))
    return arm.moved((DRAWN_OUT * along[0], DRAWN_OUT * along[1], 0.0))


def _silhouette(piece: Piece) -> shapely.Polygon:
    """A piece as seen from the front [cm]."""
    return shapely.Polygon(piece.points()[:, :2]).buffer(0)
