"""Strokes, outlines, darts and corners cut into them, and cubics fitted to tangents."""

from collections.abc import Callable
from math import cos, dist, hypot, pi, radians, sin

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gcd_dataset.curves import LINE, Arc, Cubic, Curve, Quadratic, curve_points
from gcd_dataset.errors import FitError, PatternError
from gcd_dataset.generator.pattern import (
    Outline,
    Stroke,
    cut_corner,
    cut_end,
    cut_into,
    dart,
    notch,
    rotate,
    smooth_cubic,
    tangent_quadratic,
)
from gcd_dataset.generator.pattern.piece import shared_breaks

CURVES: list[Curve] = [
    LINE,
    Quadratic((0.3, 0.4)),
    Cubic((0.2, -0.35), (0.5, -0.2)),
    Arc(20.0, large=False, right=True),
    Arc(20.0, large=True, right=False),
]


@pytest.mark.parametrize("curve", CURVES)
def test_parts_lie_on_the_whole_and_add_up_to_it(curve: Curve) -> None:
    stroke = Stroke((1.0, 2.0), (25.0, 20.0), curve, "side", "held")
    pieces = stroke.split([0.2, 0.75])
    assert [piece.length / stroke.length for piece in pieces] == pytest.approx([0.2, 0.55, 0.25], abs=1e-7)
    assert {(piece.name, piece.label) for piece in pieces} == {("side", "held")}
    assert pieces[0].end == pieces[1].start
    first, second = stroke.split_at([0.4])
    assert first.at(0.5) == pytest.approx(stroke.at(0.2))
    assert second.at(0.5) == pytest.approx(stroke.at(0.7))
    assert pieces[-1].end == stroke.end


@pytest.mark.parametrize("curve", CURVES)
def test_rotation_reversal_and_mirroring_map_points(curve: Curve) -> None:
    stroke = Stroke((1.0, 2.0), (25.0, 20.0), curve)
    turned = stroke.rotated(0.5 * np.pi, about=(1.0, 2.0))
    x, y = stroke.at(0.3)
    assert turned.length == pytest.approx(stroke.length)
    assert turned.at(0.3) == pytest.approx((1.0 - (y - 2.0), 2.0 + (x - 1.0)))
    assert stroke.reversed().at(0.7) == pytest.approx((x, y))
    assert stroke.mirrored().at(0.3) == pytest.approx((-x, y))


START, END = (3.0, -2.0), (5.0, 38.0)
UP = (0.0, 1.0)


def direction(stroke: Stroke, t: float) -> tuple[float, float]:
    x, y = stroke.velocity(t)
    return (x / hypot(x, y), y / hypot(x, y))


@given(st.floats(-95, 95))
def test_a_tangent_at_the_start_or_the_end_is_met(angle: float) -> None:
    wanted = (cos(radians(90 + angle)), sin(radians(90 + angle)))
    curve = tangent_quadratic(START, END, start_tangent=wanted)
    assert direction(Stroke(START, END, curve), 0.0) == pytest.approx(wanted, abs=1e-9)
    for at in (0.75, 0.3):
        curve = tangent_quadratic(START, END, end_tangent=wanted, at=at)
        assert direction(Stroke(START, END, curve), 1.0) == pytest.approx(wanted, abs=1e-9)


def test_a_slight_angle_keeps_the_control_point_near_its_start_on_the_chord() -> None:
    for at in (0.75, 0.3):
        control = tangent_quadratic(START, END, end_tangent=UP, at=at).control
        assert control[0] == pytest.approx(at, abs=0.005)


@given(st.floats(-3, 3))
def test_a_curve_turns_with_its_ends_and_tangent(angle: float) -> None:
    turned = tangent_quadratic(rotate(START, angle), rotate(END, angle), start_tangent=rotate(UP, angle))
    assert turned.control == pytest.approx(tangent_quadratic(START, END, start_tangent=UP).control, abs=1e-9)


def test_control_points_equal_the_references() -> None:
    """Control points of GarmentCode's jumpsuit: the back's hip (one tangent) and the crotch (two)."""
    hip = tangent_quadratic((-5.0, 68.231), (-2.771, 94.063), start_tangent=UP)
    assert hip.control == pytest.approx((0.498, 0.043), abs=0.003)
    crotch = tangent_quadratic((22.412, 79.855), (29.795, 59.417), start_tangent=(0.0, -1.0), end_tangent=(1.0, 0.0))
    assert crotch.control == pytest.approx((0.8846, -0.3195), abs=1e-4)


DOWN = (0.0, -1.0)


@pytest.mark.parametrize("size", [0.5, 1.0, 1.5])
@pytest.mark.parametrize("angle", [0.2, 0.6, 0.9])
def test_tangents_and_length_are_met(size: float, angle: float) -> None:
    end = (-23 * size * sin(angle), -23 * size * cos(angle))
    towards = (-sin(0.9 * angle), -cos(0.9 * angle))
    fitted = smooth_cubic((0.0, 0.0), end, start_tangent=DOWN, end_tangent=towards, length=26 * size)
    assert fitted.length == pytest.approx(26 * size, abs=1e-4)
    assert direction(fitted, 0.0) == pytest.approx(DOWN, abs=1e-9)
    assert direction(fitted, 1.0) == pytest.approx(towards, abs=1e-9)


def test_the_end_slides_along_the_chord_only() -> None:
    fitted = smooth_cubic((0.0, 0.0), (-12.0, -20.0), start_tangent=DOWN, end_tangent=(-0.6, -0.8), length=26.0)
    x, y = fitted.end
    assert x * 20.0 == pytest.approx(y * 12.0)


def test_the_fit_to_tangents_of_a_quarter_circle_is_nearly_circular() -> None:
    # Of all curves of a given length that turn by a right angle, the circle has the least peak curvature.
    radius = 15.0
    fitted = smooth_cubic(
        (radius, 0.0), (0.0, radius), start_tangent=(0.0, 1.0), end_tangent=(-1.0, 0.0), length=0.5 * pi * radius
    )
    points = curve_points(fitted.start, fitted.end, fitted.curve, np.linspace(0, 1, 50))
    assert np.linalg.norm(points, axis=1) == pytest.approx(np.full(50, radius), abs=0.15)


def test_an_impossible_length_is_an_error() -> None:
    with pytest.raises(FitError, match=r"a smooth curve of 1\.00 cm over 20\.00 cm: .* cm are missing"):
        smooth_cubic((0.0, 0.0), (0.0, -20.0), start_tangent=(1.0, 0.0), end_tangent=(1.0, 0.0), length=1.0)


def rectangle(*, clockwise: bool = False) -> Outline:
    drawn = Outline.start(0, 0).line(60, 0, name="hem").line(60, 40, name="side").line(0, 40, name="top")
    return drawn.close().mirrored() if clockwise else drawn.close()


LENGTHS = st.lists(st.floats(0.1, 100.0), min_size=1, max_size=5)


def positions(lengths: list[float], divisions: list[list[float]]) -> list[float]:
    """All breaks of a divided interface, as shares of its length."""
    total, reached, found = sum(lengths), 0.0, []
    for length, shares in zip(lengths, divisions, strict=True):
        found += [(reached + share * length) / total for share in shares]
        reached += length
        found.append(reached / total)
    return found


def test_an_edge_sewn_to_two_edges_is_divided() -> None:
    left, right = shared_breaks([30.0], [10.0, 20.0])
    assert left == [[pytest.approx(1 / 3)]]
    assert right == [[], []]


def test_breaks_closer_than_a_hundredth_are_merged() -> None:
    left, right = shared_breaks([50.0, 50.0], [50.4, 30.0, 19.6])
    assert left == [[], [pytest.approx((0.804 - 0.5) / 0.5)]]
    assert right == [[], [], []]


def test_a_break_in_the_middle_of_a_short_edge_is_sewn_to_one_of_its_ends() -> None:
    left, right = shared_breaks([50.0, 50.0], [49.75, 0.5, 49.75])
    assert sum(map(len, left)) + 2 == sum(map(len, right)) + 3


@given(LENGTHS, LENGTHS)
def test_both_sides_end_with_equally_many_edges_and_the_same_breaks(left: list[float], right: list[float]) -> None:
    ours, theirs = (positions(*side) for side in zip((left, right), shared_breaks(left, right), strict=True))
    assert len(ours) == len(theirs)
    assert ours == pytest.approx(theirs, abs=0.051)
    assert ours == sorted(ours)


@pytest.mark.parametrize("clockwise", [False, True])
def test_a_notch_takes_its_triangle_out_of_the_area(clockwise: bool) -> None:
    before = rectangle(clockwise=clockwise)
    after = cut_into(before, "hem", notch(4.0, 10.0), at=20.0)
    assert abs(after.area) == pytest.approx(abs(before.area) - 20.0)
    assert [piece.length for piece in after.run("hem")] == pytest.approx([18.0, 38.0])


@pytest.mark.parametrize("curve", [Arc(70.0, large=False, right=True), Cubic((0.2, -0.3), (0.5, -0.1))])
def test_a_mouth_on_a_curve_is_centred_and_as_wide_as_asked(curve: Curve) -> None:
    outline = Outline.start(0, 0).curve(60, 0, curve, name="hem").line(60, 40).line(0, 40).close()
    stroke = outline.edge("hem")
    middle = stroke.at(stroke.parameter(25.0 / stroke.length))
    first, second = cut_into(outline, "hem", notch(8.0, 10.0), at=25.0).run("hem")
    low, high = first.end, second.start
    assert dist(low, high) == pytest.approx(8.0)
    assert dist(low, middle) == pytest.approx(dist(high, middle))


def test_a_corner_cut_keeps_the_shape_and_shortens_both_edges() -> None:
    curve = Cubic((0.2, -0.35), (0.5, -0.2))
    shape = Stroke((0.0, 0.0), (-10.0, 15.0), curve, name="armhole")
    cut = cut_corner(rectangle(), "side", "top", (shape,))
    armhole = cut.edge("armhole")
    assert armhole.curve == curve
    assert armhole.chord == pytest.approx((-10.0, 15.0))
    assert armhole.start == pytest.approx((60.0, 25.0))
    assert armhole.end == pytest.approx((50.0, 40.0))
    assert (cut.edge("side").length, cut.edge("top").length) == pytest.approx((25.0, 50.0))
    assert cut.closed


def test_a_second_notch_is_positioned_along_the_edge_left_by_the_first() -> None:
    once = cut_into(rectangle(), "hem", notch(4.0, 10.0), at=40.0)
    before = cut_into(once, "hem", notch(2.0, 5.0, name="second"), at=10.0)
    behind = cut_into(once, "hem", notch(2.0, 5.0, name="second"), at=48.0)
    assert [piece.length for piece in before.run("hem")] == pytest.approx([9.0, 27.0, 18.0])
    assert [piece.length for piece in behind.run("hem")] == pytest.approx([38.0, 9.0, 7.0])


def test_a_corner_cut_of_divided_edges_shortens_the_parts_at_the_corner() -> None:
    corner = (Stroke((0.0, 0.0), (-10.0, 8.0), name="round"),)
    cut = cut_corner(cut_into(rectangle(), "side", notch(4.0, 10.0), at=20.0), "side", "top", corner)
    assert [piece.length for piece in cut.run("side")] == pytest.approx([18.0, 10.0])
    assert cut.edge("top").length == pytest.approx(50.0)


@pytest.mark.parametrize("clockwise", [False, True])
@pytest.mark.parametrize("last", [False, True])
def test_a_cut_at_the_end_of_an_edge_begins_in_its_corner(last: bool, clockwise: bool) -> None:
    whole = rectangle(clockwise=clockwise)
    hem = whole.edge("hem")
    cut = cut_end(whole, "hem", notch(4.0, 10.0), last=last)
    (rest,) = cut.run("hem")
    assert rest.length == pytest.approx(hem.length - 4.0)
    assert (rest.start == hem.start) is last and (rest.end == hem.end) is not last
    assert abs(cut.area) == pytest.approx(abs(whole.area) - 20.0)


def test_a_cut_at_the_end_of_an_arc_is_as_wide_as_asked() -> None:
    disk = Outline.start(-10, 0).curve(10, 0, Arc(10.0, large=False, right=True), name="hem").close()
    (rest,) = cut_end(disk, "hem", notch(5.0, 3.0), last=False).run("hem")
    assert hypot(rest.start[0] + 10, rest.start[1]) == pytest.approx(5.0)
    assert hypot(*rest.start) == pytest.approx(10.0)


WRONG: dict[str, Callable[[], object]] = {
    "hem: an arc has no control points": Stroke(
        (0.0, 0.0), (1.0, 0.0), Arc(1.0, large=False, right=True), "hem"
    ).control_points,
    "no edge named sleeve: there are hem, side, top": lambda: rectangle().edge("sleeve"),
    r"begins at \(11.00, 0.00\), but the pen is at \(10.00, 0.00\)": lambda: (
        Outline.start(0, 0).line(10, 0).then(Stroke((11.0, 0.0), (12.0, 0.0)))
    ),
    "legs of 2.00 cm do not meet over an opening of 6.00 cm": lambda: dart(6.0, 2.0),
    "edge hem of 60.00 cm: an opening of 8.00 cm centred at 58.00 cm": lambda: cut_into(
        rectangle(), "hem", notch(8.0, 10.0), at=58.0
    ),
    "a cut from side to top does not fit the corner": lambda: cut_corner(
        rectangle(), "side", "top", (Stroke((0.0, 0.0), (-10.0, 45.0)),)
    ),
    r"an opening of 90\.00 cm does not fit": lambda: cut_end(rectangle(), "hem", notch(90.0, 3.0), last=True),
    "divided into 2 pieces": lambda: cut_into(rectangle(), "hem", notch(4.0, 10.0), at=20.0).edge("hem"),
    "do not cross": lambda: tangent_quadratic((0.0, 0.0), (0.0, 9.0), start_tangent=(1.0, 1.0), end_tangent=(1.0, 1.0)),
    "one point twice": lambda: tangent_quadratic(START, START, start_tangent=UP),
    "needs one": lambda: tangent_quadratic(START, END),
}


@pytest.mark.parametrize("message", WRONG)
def test_what_cannot_be_drawn_or_cut_is_an_error(message: str) -> None:
    with pytest.raises(PatternError, match=message):
        WRONG[message]()
