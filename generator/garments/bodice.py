"""The fitted bodice: halves that end at the waist, fitted to bust and waist by darts."""

from dataclasses import replace
from math import pi, tan

from gcd_dataset.errors import PatternError
from gcd_dataset.generator.garments.mends import Mend, folds
from gcd_dataset.generator.garments.torso import TorsoHalf
from gcd_dataset.generator.pattern import Outline, chain_from, cut_into, dart, tangent_quadratic
from gcd_dataset.records import Measurements

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
