"""Darts, notches and corners cut into outlines."""

from math import hypot

import pytest

from gcd_dataset.curves import Arc, Cubic, Curve
from gcd_dataset.errors import PatternError
from gcd_dataset.generator.pattern import Outline, Stroke, cut_corner, cut_end, cut_into, dart, notch


def rectangle(*, clockwise: bool = False) -> Outline:
    drawn = Outline.start(0, 0).line(60, 0, name="hem").line(60, 40, name="side").line(0, 40, name="top")
    return drawn.close().mirrored() if clockwise else drawn.close()


@pytest.mark.parametrize("clockwise", [False, True])
def test_a_notch_takes_its_triangle_out_of_the_area(clockwise: bool) -> None:
    before = rectangle(clockwise=clockwise)
    after = cut_into(before, "hem", notch(4.0, 10.0), at=20.0)
    assert abs(after.area) == pytest.approx(abs(before.area) - 20.0)
    assert [piece.length for piece in after.run("hem")] == pytest.approx([18.0, 38.0])


def test_the_legs_of_a_dart_have_the_asked_length() -> None:
    left, right = dart(6.0, 12.0)
    assert (left.length, right.length) == pytest.approx((12.0, 12.0))
    assert right.end == (6.0, 0.0)


def test_legs_too_short_to_meet_are_an_error() -> None:
    with pytest.raises(PatternError, match=r"legs of 2.00 cm do not meet over an opening of 6.00 cm"):
        dart(6.0, 2.0)


@pytest.mark.parametrize("curve", [Arc(70.0, large=False, right=True), Cubic((0.2, -0.3), (0.5, -0.1))])
def test_a_mouth_on_a_curve_is_centred_and_as_wide_as_asked(curve: Curve) -> None:
    outline = Outline.start(0, 0).curve(60, 0, curve, name="hem").line(60, 40).line(0, 40).close()
    stroke = outline.edge("hem")
    middle = stroke.at(stroke.parameter(25.0 / stroke.length))
    first, second = cut_into(outline, "hem", notch(8.0, 10.0), at=25.0).run("hem")
    low, high = first.end, second.start
    assert hypot(high[0] - low[0], high[1] - low[1]) == pytest.approx(8.0)
    assert hypot(low[0] - middle[0], low[1] - middle[1]) == pytest.approx(
        hypot(high[0] - middle[0], high[1] - middle[1])
    )


def test_a_mouth_over_the_end_of_its_edge_is_an_error() -> None:
    with pytest.raises(PatternError, match=r"edge hem of 60.00 cm: an opening of 8.00 cm centred at 58.00 cm"):
        cut_into(rectangle(), "hem", notch(8.0, 10.0), at=58.0)


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


def test_a_corner_cut_larger_than_its_edges_is_an_error() -> None:
    with pytest.raises(PatternError, match="a cut from side to top does not fit the corner"):
        cut_corner(rectangle(), "side", "top", (Stroke((0.0, 0.0), (-10.0, 45.0)),))


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


def test_a_cut_wider_than_its_edge_is_an_error() -> None:
    with pytest.raises(PatternError, match=r"an opening of 90\.00 cm does not fit"):
        cut_end(rectangle(), "hem", notch(90.0, 3.0), last=True)
