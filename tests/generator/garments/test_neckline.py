"""Necklines against independent geometry, and turtlenecks, lapels and hoods on them."""

from collections.abc import Mapping
from dataclasses import replace
from itertools import pairwise
from math import atan2, degrees, hypot, pi, radians, tan
from typing import Any

import numpy as np
import pytest
import shapely
from jaxtyping import Float

from gcd_dataset.curves import Arc, curve_points, signed_area
from gcd_dataset.errors import PatternError
from gcd_dataset.generator.garments import design_from_dict, draw_garment
from gcd_dataset.generator.garments.collar import RAISED, Collar, CollarDesign, hood_outline
from gcd_dataset.generator.garments.neckline import (
    LeftNecklineDesign,
    Neckline,
    NecklineDesign,
    half_neckline,
    neckline_drop,
    neckline_shape,
    neckline_width,
    worn_neckline,
)
from gcd_dataset.generator.pattern import Stroke, s_shaped_cubic
from gcd_dataset.records import EdgeRef, Measurements, Panel, Pattern
from tests.generator.garments.measured import contour, ref_length, seams

SIZES = pytest.mark.parametrize(("half_width", "depth"), [(9.0, 1.5), (9.0, 9.0), (5.0, 30.0), (17.0, 20.0)])
FLIPPED = pytest.mark.parametrize("flip", [False, True])
FRONT = pytest.mark.parametrize("front", [True, False])


def shape(kind: Neckline, half_width: float, depth: float, *, front: bool = True, **changes: float) -> list[Stroke]:
    """A half neckline of a kind, in front or behind; names of ``changes`` lack the prefix f_ or b_."""
    side = "f" if front else "b"
    names = {"angle": f"{side}c_angle", "flip": f"{side}_flip_curve", "x": f"{side}_bezier_x", "y": f"{side}_bezier_y"}
    design = NecklineDesign(**{f"{side}_collar": kind, **{names[name]: value for name, value in changes.items()}})  # type: ignore[arg-type]
    return list(neckline_shape(design, front=front, half_width=half_width, depth=depth))


def points(strokes: list[Stroke]) -> Float[np.ndarray, "n 2"]:
    return np.concatenate([curve_points(s.start, s.end, s.curve, np.linspace(0, 1, 101)) for s in strokes])


def direction(stroke: Stroke, t: float) -> float:
    x, y = stroke.velocity(t)
    return atan2(y, x)


@SIZES
@FRONT
@pytest.mark.parametrize("kind", Neckline)
def test_a_half_neckline_runs_from_the_shoulder_to_the_centre(
    kind: Neckline, half_width: float, depth: float, front: bool
) -> None:
    strokes = shape(kind, half_width, depth, front=front)
    assert strokes[0].start == (0.0, 0.0)
    assert strokes[-1].end == pytest.approx((half_width, -depth))
    assert all(one.end == pytest.approx(other.start) for one, other in pairwise(strokes))


@SIZES
def test_a_round_neckline_is_part_of_the_circle_through_both_shoulders_and_its_lowest_point(
    half_width: float, depth: float
) -> None:
    (arc,) = shape(Neckline.CIRCLE, half_width, depth)
    # The centre is as far from the lowest point as from the shoulder, and lies above the lowest point.
    up = (hypot(half_width, depth) / 2) / (depth / hypot(half_width, depth))
    from_centre = points([arc]) - (half_width, up - depth)
    assert np.linalg.norm(from_centre, axis=1) == pytest.approx(np.full(101, up))
    assert direction(arc, 1.0) == pytest.approx(0.0, abs=1e-9)  # level where the other half begins
    assert points([arc])[:, 1].max() == pytest.approx(0.0)
    widest = half_width - points([arc])[:, 0].min()
    assert widest == pytest.approx(up if depth > half_width else half_width, rel=1e-3)


@SIZES
@FLIPPED
@pytest.mark.parametrize("angle", [70, 95, 110])
def test_an_arc_turns_by_its_angle(half_width: float, depth: float, flip: bool, angle: int) -> None:
    (arc,) = shape(Neckline.ARC, half_width, depth, angle=angle, flip=flip)
    turn = (direction(arc, 1.0) - direction(arc, 0.0)) % (2 * pi)
    assert turn == pytest.approx(2 * pi - radians(angle) if flip else radians(angle))


@pytest.mark.parametrize("kind", [Neckline.CURVY, Neckline.ARC, Neckline.BEZIER])
def test_flipped_necklines_are_images_about_their_chord(kind: Neckline) -> None:
    plain, flipped = (shape(kind, 9.0, 14.0, flip=flip) for flip in (False, True))
    along = np.array([9.0, -14.0]) / hypot(9.0, 14.0)
    assert points(flipped) == pytest.approx(2 * (points(plain) @ along)[:, None] * along - points(plain))


@SIZES
def test_a_curvy_neckline_swings_to_both_sides_of_its_chord(half_width: float, depth: float) -> None:
    (curve,) = shape(Neckline.CURVY, half_width, depth)
    chord, t = hypot(half_width, depth), np.linspace(0, 1, 101)
    across = (points([curve]) @ (depth, half_width)) / chord**2
    along = (points([curve]) @ (half_width, -depth)) / chord**2
    # Bernstein's form of a curve whose control points stand 0.3 chords off, at 0.4 and 0.8 of the chord.
    assert across == pytest.approx(0.9 * t * (1 - t) * (1 - 2 * t))
    assert along == pytest.approx(1.2 * t * (1 - t) ** 2 + 2.4 * t**2 * (1 - t) + t**3)


@SIZES
@FLIPPED
@FRONT
def test_a_bezier_neckline_starts_towards_its_control_point(
    half_width: float, depth: float, flip: bool, front: bool
) -> None:
    x, y = 0.3, 0.55
    (curve,) = shape(Neckline.BEZIER, half_width, depth, front=front, flip=flip, x=x, y=y)
    off = y if flip else -y
    control = np.array([x * half_width + off * depth, -x * depth + off * half_width])
    assert np.array(curve.velocity(0.0)) == pytest.approx(2 * control)
    assert np.array(curve.velocity(1.0)) == pytest.approx(2 * (np.array([half_width, -depth]) - control))


@pytest.mark.parametrize("angle", [70, 80, 90, 95, 110])
def test_the_sides_of_a_trapezoid_slope_by_its_angle(angle: int) -> None:
    side, bottom = shape(Neckline.TRAPEZOID, 9.0, 12.0, angle=angle)
    assert direction(side, 0.5) == pytest.approx(radians(angle) - pi)
    assert bottom.start[1] == pytest.approx(bottom.end[1])


def test_a_trapezoid_whose_sides_meet_before_the_bottom_is_a_v_and_a_square_goes_down_and_across() -> None:
    down, across = shape(Neckline.SQUARE, 9.0, 12.0)
    assert (down.chord, across.chord) == ((0.0, -12.0), (9.0, 0.0))
    meet = 9.0 * tan(radians(70))  # the depth at which sides of 110 degrees meet in the middle
    assert len(shape(Neckline.TRAPEZOID, 9.0, 0.99 * meet, angle=110)) == 2
    assert shape(Neckline.TRAPEZOID, 9.0, 1.01 * meet, angle=110) == shape(Neckline.V, 9.0, 1.01 * meet)


def test_neckline_widths_run_from_half_the_neck_to_the_shoulders(wearer: Measurements) -> None:
    widths = [neckline_width(wearer, NecklineDesign(width=width)) for width in (-0.5, -0.25, 0.0, 0.5, 1.0)]
    assert widths[0] == pytest.approx(0.5 * wearer.neck_w)
    assert widths[2] == pytest.approx(wearer.neck_w)
    assert widths[4] == pytest.approx(wearer.sleeve_balance - 2.0)  # a centimetre of shoulder left on each side
    assert widths[1] == pytest.approx(0.5 * (widths[0] + widths[2]))
    assert widths[3] == pytest.approx(0.5 * (widths[2] + widths[4]))


def test_depths_are_counted_from_the_shoulders_outer_end(woman: Measurements) -> None:
    design = NecklineDesign(fc_depth=0.5, width=0.3)
    half_width = 0.5 * neckline_width(woman, design)
    strokes = half_neckline(woman, design, front=True, shoulder=18.0, room=60.0)
    rise = tan(woman.shoulder_incl) * (18.0 - half_width)  # rise of the shoulder from its outer end to the neckline
    assert strokes[-1].end == pytest.approx((half_width, -0.5 * woman.drawn_bust_line - rise))
    assert {(stroke.name, stroke.label) for stroke in strokes} == {("neck", "right_collar")}


@FRONT
def test_the_deepest_necklines_leave_a_centimetre_of_centre(wearer: Measurements, front: bool) -> None:
    design = NecklineDesign(fc_depth=2.0, bc_depth=2.0)
    deepest = min(2.0 * wearer.drawn_bust_line, 19.0)
    assert neckline_drop(wearer, design, front=front, room=20.0) == pytest.approx(deepest)


def test_a_neckline_too_wide_for_the_shirt_is_an_error(woman: Measurements) -> None:
    with pytest.raises(PatternError, match=r"a neckline of .* cm is wider than the shirt: narrow collar\.width"):
        half_neckline(woman, NecklineDesign(width=1.0, bc_depth=0.0), front=False, shoulder=12.0, room=40.0)


def test_a_collar_changes_the_neckline_under_it() -> None:
    drawn = NecklineDesign(f_collar=Neckline.BEZIER, b_collar=Neckline.V, f_bezier_x=0.9, f_bezier_y=0.8)
    worn = {style: worn_neckline(replace(drawn, component=CollarDesign(style=style))) for style in (None, *Collar)}
    assert worn[None] == drawn
    assert {worn[style].f_collar for style in (Collar.TURTLENECK, Collar.HOOD)} == {Neckline.CIRCLE}
    assert {worn[style].b_collar for style in Collar} == {Neckline.CIRCLE}
    lapel = worn[Collar.LAPEL]
    assert (lapel.f_collar, lapel.f_bezier_x, lapel.f_bezier_y) == (Neckline.BEZIER, 0.5, 0.3)


def test_a_left_neckline_is_as_deep_as_the_right_one_and_has_no_collar() -> None:
    right = NecklineDesign(fc_depth=1.2, bc_depth=0.7, component=CollarDesign(style=Collar.HOOD))
    left = LeftNecklineDesign(f_collar=Neckline.V, width=0.9).beside(right)
    assert (left.fc_depth, left.bc_depth, left.component.style) == (1.2, 0.7, None)
    assert (left.f_collar, left.width) == (Neckline.V, 0.9)


STYLES = pytest.mark.parametrize("style", [style.value for style in Collar])
STANDING = pytest.mark.parametrize("standing", [True, False])
NECKLINE: Mapping[str, Any] = {"f_collar": "CircleNeckHalf"}


def top(
    size: Measurements, style: str, *, upper: str = "Shirt", collar: Mapping[str, Any] = NECKLINE, **component: Any
) -> Pattern:
    """A sleeveless top; its collar has the given style and parameters."""
    neckline = {**collar, "component": {**component, "style": style}}
    return draw_garment(size, design_from_dict({"meta": {"upper": upper}, "collar": neckline}))


def round_length(half_width: float, depth: float) -> float:
    """Length of half a round neckline: radius times angle [cm]."""
    return (half_width**2 + depth**2) / (2 * depth) * 2 * atan2(depth, half_width)


def named(panel: Panel, name: str) -> list[int]:
    return [i for i, edge in enumerate(panel.edges) if edge.name == name]


def edge_in_space(panel: Panel, name: str) -> Float[np.ndarray, "n 3"]:
    edges = [(panel.edge_ends(i), panel.edges[i].curve) for i in named(panel, name)]
    flat = np.concatenate([curve_points(*ends, curve, np.linspace(0, 1, 50)) for ends, curve in edges])
    return np.asarray(panel.placement.apply(flat))


@STYLES
@STANDING
@pytest.mark.parametrize("upper", ["Shirt", "FittedShirt"])
def test_collars_are_as_long_as_the_necklines_they_are_sewn_to(
    woman: Measurements, style: str, standing: bool, upper: str
) -> None:
    pattern = top(woman, style, upper=upper, collar={"f_collar": "TrapezoidNeckHalf"}, lapel_standing=standing)
    extra = [panel.name for panel in pattern.panels if "torso" not in panel.name]
    assert len(extra) == (2 if style == "Hood2Panels" else 4)
    for seam in pattern.seams:
        if {seam.left.panel, seam.right.panel} & set(extra):
            assert ref_length(pattern, seam.left) == pytest.approx(ref_length(pattern, seam.right), abs=1e-4)


@pytest.mark.parametrize(("depth", "width"), [(2, -0.5), (5, 0.0), (8, 1.0)])
def test_a_turtleneck_is_a_band_closed_all_round(wearer: Measurements, depth: int, width: float) -> None:
    pattern = top(wearer, "Turtle", collar={"width": width}, depth=depth)
    for part in ("front", "back"):
        right = pattern.panel(f"right_collar_{part}")
        x, y = right.vertices.T
        assert np.ptp(y) == pytest.approx(depth)
        assert np.ptp(x) == pytest.approx(ref_length(pattern, EdgeRef(right.name, named(right, "bottom")[0])))
        (closing,) = seams(pattern, right.name, f"left_collar_{part}")
        assert not closing.right_wrong
    assert len(seams(pattern, "right_collar_front", "right_collar_back")) == 1


@STANDING
def test_a_lapel_stays_open_in_front_and_shows_its_wrong_side(woman: Measurements, standing: bool) -> None:
    pattern = top(woman, "SimpleLapel", collar={"f_collar": "SquareNeckHalf"}, lapel_standing=standing)
    assert not seams(pattern, "right_collar_front", "left_collar_front")
    assert seams(pattern, "right_ftorso", "left_ftorso")  # the shirt under the lapel is closed
    (at_nape,) = seams(pattern, "right_collar_back", "left_collar_back")
    assert not at_nape.right_wrong
    front = seams(pattern, "right_collar_front", "right_ftorso")
    assert [seam.right_wrong for seam in front] == [True, True]
    # A lying back collar is turned over like the lapel; a standing one is not, so the seam between them turns over.
    (behind,) = seams(pattern, "right_collar_back", "right_btorso")
    (between,) = seams(pattern, "right_collar_front", "right_collar_back")
    assert (behind.right_wrong, between.right_wrong) == ((False, True) if standing else (True, False))


@pytest.mark.parametrize("bc_depth", [0.0, 0.3, 0.8])
def test_a_lying_collar_continues_the_circle_of_the_neckline(woman: Measurements, bc_depth: float) -> None:
    pattern = top(woman, "SimpleLapel", collar={"bc_depth": bc_depth}, lapel_standing=False, depth=6)
    torso, collar = pattern.panel("right_btorso"), pattern.panel("right_collar_back")
    sides = ((torso, "neck"), (collar, "top"), (collar, "bottom"))
    neck, inner, outer = (panel.edges[index].curve for panel, name in sides for index in named(panel, name))
    assert isinstance(neck, Arc) and isinstance(inner, Arc) and isinstance(outer, Arc)
    assert (inner.radius, outer.radius) == pytest.approx((neck.radius, neck.radius + 6.0))


def test_a_lying_collar_lies_flat_with_its_outside_up(woman: Measurements) -> None:
    for side in ("right", "left"):
        collar = top(woman, "SimpleLapel", lapel_standing=False).panel(f"{side}_collar_back")
        assert abs(collar.placement.matrix[1, 2]) == pytest.approx(1.0)
        assert signed_area(contour(collar)) * collar.placement.matrix[1, 2] > 0


@pytest.mark.parametrize(
    ("hood_depth", "hood_length", "width", "fc_depth"),
    [(1.0, 1.0, -0.5, 0.3), (2.0, 1.5, 0.0, 1.2), (1.0, 1.5, 1.0, 0.3), (2.0, 1.0, 1.0, 2.0)],
)
def test_hoods_from_the_smallest_to_the_largest(
    wearer: Measurements, hood_depth: float, hood_length: float, width: float, fc_depth: float
) -> None:
    collar = {"width": width, "fc_depth": fc_depth}
    hood = top(wearer, "Hood2Panels", collar=collar, hood_depth=hood_depth, hood_length=hood_length).panel("right_hood")
    half_width = abs(hood.placement.translation[0])
    shoulder = wearer.height - wearer.head_l + RAISED
    top_edge, opening = edge_in_space(hood, "top"), edge_in_space(hood, "opening")
    assert np.ptp(top_edge[:, 2]) == pytest.approx(hood_depth * half_width)
    assert opening[:, 1].max() - shoulder == pytest.approx(hood_length * wearer.head_l + 0.5 * half_width)
    assert shapely.Polygon(contour(hood)).is_valid


@pytest.mark.parametrize("half_width", [4.0, 8.0, 16.0])
def test_a_hood_does_not_cross_itself_above_four_half_widths(half_width: float) -> None:
    """In lower hoods a deep front neckline bulges past the edge of the opening."""
    for share in (0.3, 1.0, 2.0, 4.0):
        depths = (share * half_width, 0.2 * half_width)
        front, back = (((half_width, depth), round_length(half_width, depth)) for depth in depths)
        assert shapely.Polygon(hood_outline(*front, *back, top=1.0, height=25.0).points()).is_valid


def test_a_hood_leaves_and_reaches_the_centre_about_level(woman: Measurements) -> None:
    hood = top(woman, "Hood2Panels").panel("right_hood")
    for name in ("front_neck", "back_neck"):
        z, y = edge_in_space(hood, name)[:, [2, 1]].T
        for a, b in ((0, 1), (-2, -1)):
            assert abs(degrees(atan2(y[b] - y[a], abs(z[b] - z[a])))) < 6.0


@pytest.mark.parametrize(
    ("width", "depth"), [(4.0, 3.0), (9.0, 6.0), (11.0, 33.0), (4.0, 40.0), (19.0, 1.0), (3.0, 70.0)]
)
def test_an_s_shaped_curve_is_its_own_image_under_a_half_turn(width: float, depth: float) -> None:
    length = round_length(width, depth)
    curve = s_shaped_cubic((0.0, 0.0), (width, -depth), tangent=(1.0, 0.0), length=length)
    points = curve_points(curve.start, curve.end, curve.curve, np.linspace(0, 1, 51))
    assert points + points[::-1] == pytest.approx(np.broadcast_to(curve.end, points.shape))
    assert curve.length == pytest.approx(length, abs=1e-3)
    assert curve.end[0] * depth == pytest.approx(-curve.end[1] * width)  # on the chord, perhaps farther along
    assert abs(atan2(*reversed(curve.velocity(0.0)))) < 0.1 * pi
    assert hypot(*curve.end) < 1.35 * hypot(width, depth)
