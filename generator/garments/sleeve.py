"""Armholes and the sleeves set into them: ``right_sleeve_f`` and ``right_sleeve_b``; the left one is their mirror."""

from dataclasses import dataclass, replace
from math import atan2, hypot, pi

import numpy as np

from gcd_dataset.curves import Cubic, Point
from gcd_dataset.errors import PatternError
from gcd_dataset.generator.garments.space import Design, flag, integer, real
from gcd_dataset.generator.pattern import Component, Outline, Piece, Stroke, chain_from, rotate, smooth_cubic
from gcd_dataset.records import Measurements

__all__ = ["SleeveDesign", "armhole_curve", "sleeve"]

ARMHOLE = Cubic((0.2, -0.35), (0.5, -0.2))  # edge frame, from underarm to shoulder, GarmentCode
SHORTEST = 5.0  # cm of sleeve under the arm, GarmentCode
NO_SURPLUS = 0.6  # cm moved between the openings: less would make edges too short to sew
FRONT, BACK = 15.0, -15.0  # cm before and behind the arm, GarmentCode
DOWN: Point = (0.0, -1.0)


@dataclass(frozen=True)
class SleeveDesign(Design):
    """A sleeve, or an armhole without one."""

    sleeveless: bool = flag(False, keep=0.6)
    length: float = real(0.3, 0.1, 1.15)
    """As a fraction of armhole to wrist."""
    connecting_width: float = real(0.2, 0.0, 2.0, keep=0.6)
    """How much deeper the armhole is than the armscye with its ease, as a fraction of that."""
    end_width: float = real(1.0, 0.2, 2.0, keep=0.4)
    """Width at the sleeve's end, as a fraction of its width at the armhole."""
    sleeve_angle: int = integer(10, 10, 50)
    """How far the sleeve hangs from the shoulder line at rest [degrees]; never less than the shoulder's slope."""
    opening_dir_mix: float = real(0.1, -0.9, 0.8, keep=1.0)
    """Direction in which the opening reaches the underarm: 0 along its chord, 1 straight down."""
    connect_ruffle: float = real(1.0, 1.0, 2.0, keep=0.4)
    """Gathers at the armhole: opening over armhole."""


def armhole_curve(width: float, depth: float) -> Stroke:
    """From the underarm up to the shoulder, ``width`` inwards and ``depth`` upwards [cm]."""
    return Stroke((0.0, 0.0), (width, depth), ARMHOLE, name="armhole", label="right_armhole")


def sleeve(size: Measurements, design: SleeveDesign, front_armhole: Stroke, back_armhole: Stroke) -> Component:
    """The right sleeve for two armholes, lying along the arm; offers ``opening`` [front up, back down] and ``end``."""
    rest = max(design.sleeve_angle * pi / 180, size.shoulder_incl)
    openings = [_opening(armhole, rest, design.opening_dir_mix) for armhole in (front_armhole, back_armhole)]
    front_opening, back_opening = _equalised(*openings)
    front = _half(size, design, "right_sleeve_f", front_opening).at(0, 0, FRONT)
    back = _half(size, design, "right_sleeve_b", back_opening).at(0, 0, BACK)
    gather = design.connect_ruffle
    return (
        Component.of(front, back)
        .sewn(front.along("upper"), back.along("upper"))
        .sewn(front.along("under"), back.along("under"))
        .offering(
            opening=front.along("opening", ruffle=gather) + back.against("opening", ruffle=gather),
            end=front.along("end") + back.against("end"),
        )
        .turned(size.arm_pose_angle)
        .labelled("arm")
    )


def _opening(armhole: Stroke, rest: float, mix: float) -> Stroke:
    """The sleeve's edge for an armhole: as long, leaving the shoulder straight down, lowered by ``rest`` [rad].

    It runs from the underarm up to the shoulder, which is the origin.
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


def _equalised(front: Stroke, back: Stroke) -> tuple[tuple[Stroke, ...], tuple[Stroke, ...]]:
    """Both openings with chords of one length and slope, so that the sleeve's halves match along the arm.

    Laid flat, the opening is the front and then, turned over, the back. The crease where the halves meet is where the
    perpendicular bisector of the whole crosses it; what lies beyond moves from the wider half to the other.
    """
    if hypot(*front.chord) < hypot(*back.chord):
        from_back, from_front = _equalised(back, front)
        return from_front, from_back
    front_under, back_under = front.start, _turned_over(back).start
    span = (back_under[0] - front_under[0], back_under[1] - front_under[1])
    tilt = atan2(span[0], span[1])
    crease = _crease(front, back_under, span)
    if hypot(*front.at(crease)) < NO_SURPLUS:
        return (front.rotated(tilt),), (back.rotated(-tilt),)
    kept, surplus = front.split_at([crease])
    return (kept.rotated(tilt),), (back.rotated(-tilt), _turned_over(surplus.reversed()).rotated(-tilt))


def _crease(front: Stroke, back_under: Point, span: Point) -> float:
    """Parameter of the front opening where both underarm points are equally far away: the root of a cubic."""
    middle = (0.5 * (front.start[0] + back_under[0]), 0.5 * (front.start[1] + back_under[1]))
    heights = [(x - middle[0]) * span[0] + (y - middle[1]) * span[1] for x, y in front.control_points()]
    p, q, r, s = heights
    roots = np.roots([s - 3 * r + 3 * q - p, 3 * (r - 2 * q + p), 3 * (q - p), p])
    inside = [root.real for root in roots if abs(root.imag) < 1e-9 and 0 < root.real <= 1 + 1e-9]
    if not inside:
        raise PatternError("sleeve: front and back openings differ so much that no crease makes them equal")
    return float(min(max(inside), 1.0))


def _turned_over(stroke: Stroke) -> Stroke:
    """The mirror image about the x axis."""
    return stroke.mirrored().rotated(pi)


def _half(size: Measurements, design: SleeveDesign, name: str, opening: tuple[Stroke, ...]) -> Piece:
    """Half a sleeve: wrist at x = 0, its upper edge on the x axis."""
    plain_height = abs(opening[-1].end[1] - opening[0].start[1])
    gathered = _stretched(opening, design.connect_ruffle)
    width, height = (abs(gathered[-1].end[axis] - gathered[0].start[axis]) for axis in (0, 1))
    end = max(design.end_width * plain_height, 0.5 * size.wrist)
    length = max(design.length * (size.arm_length - width), SHORTEST)
    outline = (
        Outline.start(0, 0)
        .line(0, -end, name="end")
        .line(length, -height, name="under")
        .then(*(replace(stroke, name="opening") for stroke in chain_from((length, -height), *gathered)))
        .close(name="upper")
    )
    return Piece(name, outline)


def _stretched(strokes: tuple[Stroke, ...], factor: float) -> tuple[Stroke, ...]:
    """Bézier strokes stretched along the chord of the whole."""
    (x0, y0), (x1, y1) = strokes[0].start, strokes[-1].end
    chord = hypot(x1 - x0, y1 - y0)
    ux, uy = (x1 - x0) / chord, (y1 - y0) / chord

    def moved(point: Point) -> Point:
        along = (factor - 1) * ((point[0] - x0) * ux + (point[1] - y0) * uy)
        return (point[0] + along * ux, point[1] + along * uy)

    return tuple(stroke.through([moved(point) for point in stroke.control_points()]) for stroke in strokes)
