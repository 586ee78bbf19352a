"""Cut pieces: allowances, corners, folds, darts, notches."""

from dataclasses import replace

import numpy as np
import pytest
import shapely

from gcd_dataset.curves import signed_area
from gcd_dataset.errors import ConfigError, PatternError
from gcd_dataset.exports.pieces import cut_pieces
from gcd_dataset.records import Closure, EdgeRef, Pattern, Seam
from tests.exports.patterns import DART_DEPTH, DART_MOUTH, RADIUS, SIDE, darted, quarter_circle, square, squares
from tests.generator.mesh.shapes import panel


def test_a_square_with_allowance_is_a_larger_square() -> None:
    (piece, _) = cut_pieces(squares(), seam_allowance=1.5)
    assert abs(signed_area(piece.cut)) == pytest.approx((SIDE + 3.0) ** 2)
    assert abs(signed_area(piece.sew)) == pytest.approx(SIDE**2)
    assert piece.cut_corner.sum() == 4


def test_the_allowance_of_a_quarter_circle() -> None:
    """Radii and arc move outward by 1 cm; the corners are mitred, the one at the centre by a square."""
    (piece,) = cut_pieces(quarter_circle(), seam_allowance=1.0)
    cut, sew = shapely.Polygon(piece.cut), shapely.Polygon(piece.sew)
    assert sew.area == pytest.approx(np.pi * RADIUS**2 / 4, rel=1e-3)
    strip = cut.area - sew.area
    assert strip == pytest.approx(2 * RADIUS + np.pi / 2 * (RADIUS + 0.5) + 3.0, rel=0.01)
    assert shapely.LineString(piece.sew).distance(shapely.LinearRing(piece.cut)) == pytest.approx(1.0, abs=0.02)


def test_without_allowance_both_lines_are_one() -> None:
    (piece, _) = cut_pieces(squares(), seam_allowance=0.0)
    assert shapely.Polygon(piece.cut).equals(shapely.Polygon(piece.sew))


def test_a_sharp_corner_is_bevelled() -> None:
    """The mitre of a corner of 11° would reach 10 cm; it ends at two and a half allowances."""
    (piece,) = cut_pieces(Pattern("thorn", (panel("thorn", [(0, 0), (50, 0), (50, 10)]),), ()))
    near = np.linalg.norm(piece.cut - [0.0, 0.0], axis=1)[piece.cut[:, 0] < 0]
    assert 1.0 < near.max() < 3.0


@pytest.mark.parametrize("fold", range(4))
def test_a_fold_gets_no_allowance(fold: int) -> None:
    (piece,) = cut_pieces(Pattern("folded", (square("half", fold=fold),), ()), seam_allowance=2.0)
    assert abs(signed_area(piece.cut)) == pytest.approx((SIDE + 4.0) * (SIDE + 2.0))
    start, end = piece.folds[0]
    assert shapely.LinearRing(piece.cut).distance(shapely.Point(0.5 * (start + end))) < 1e-9


def test_the_cut_line_crosses_a_dart() -> None:
    """Folded over, the cap of the dart lies along the straight upper edge."""
    (piece,) = cut_pieces(darted(), seam_allowance=0.0)
    wedge = DART_MOUTH * DART_DEPTH / 2
    assert abs(signed_area(piece.sew)) == pytest.approx(SIDE**2 - wedge)
    top = piece.cut[:, 1].max()
    mouth = np.array([SIDE / 2 - DART_MOUTH / 2, SIDE])
    tip, summit = np.array([SIDE / 2, SIDE - DART_DEPTH]), np.array([SIDE / 2, top])
    axis = (mouth - tip) / np.linalg.norm(mouth - tip)
    mirrored = tip + 2 * ((summit - tip) @ axis) * axis - (summit - tip)
    assert mirrored[1] == pytest.approx(SIDE, abs=1e-6)
    assert mirrored[0] < mouth[0]
    assert SIDE < top < SIDE + 1.0


def test_a_dart_has_notches_at_its_mouth_and_a_drill_hole_before_its_tip() -> None:
    (piece,) = cut_pieces(darted(), seam_allowance=1.0)
    assert len(piece.notches) == 2
    assert all(notch.point[1] > SIDE for notch in piece.notches)
    assert piece.drills == pytest.approx(np.array([[SIDE / 2, SIDE - DART_DEPTH + 1.0]]))


def test_a_cone_is_no_dart() -> None:
    """Neighbouring edges sewn together round a corner of the cloth itself: the cloth lies between them."""
    cone = panel("cone", [(0, 0), (20, 0), (25, 25), (0, 20)])
    (piece,) = cut_pieces(Pattern("cone", (cone,), (Seam(EdgeRef("cone", 0), EdgeRef("cone", 3)),)))
    assert not len(piece.drills)
    assert abs(signed_area(piece.cut)) > abs(signed_area(piece.sew))


@pytest.mark.parametrize("degrees", [0, 52, 130, 232])
def test_a_slit_is_not_left_as_a_crack(degrees: int) -> None:
    """Two allowances fill a slit of 2.4 cm but for a crack of 0.4 cm, which nobody cuts.

    In a turned panel the borders of crack and cut line differ by roundings.
    """
    angle = np.radians(degrees)
    turn = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
    corners = np.array([(0, 0), (18.8, 0), (20, 15), (21.2, 0), (40, 0), (40, 30), (0, 30)]) @ turn
    (piece,) = cut_pieces(Pattern("slit", (panel("slit", corners.tolist()),), ()))
    assert piece.cut_corner.sum() == 4
    assert abs(signed_area(piece.cut)) == pytest.approx(42.0 * 32.0)


def test_notches_of_a_seam_meet() -> None:
    """The first of two notches is double; sewn together, those of both edges lie on each other."""
    one, two = cut_pieces(squares(), seam_allowance=1.0)
    left = sorted(notch.point[1] for notch in one.notches)
    right = sorted(notch.point[1] for notch in two.notches)
    assert left == pytest.approx([SIDE / 3 - 0.3, SIDE / 3 + 0.3, 2 * SIDE / 3])
    assert right == pytest.approx(left)  # the squares lie side by side, so sewn points have the same height
    assert all(notch.point[0] == pytest.approx(SIDE + 1.0) for notch in one.notches)
    assert all(notch.inward == pytest.approx([-1.0, 0.0]) and notch.depth == 0.5 for notch in one.notches)


def test_an_open_seam_has_no_notches_and_the_same_cut_line() -> None:
    opened = replace(squares(), seams=(replace(squares().seams[0], closure=Closure.OPEN),))
    for piece, closed in zip(cut_pieces(opened), cut_pieces(squares()), strict=True):
        assert not piece.notches
        assert np.array_equal(piece.cut, closed.cut)


def test_a_wrong_side_seam_has_its_notches_at_the_same_ends() -> None:
    seam = replace(squares().seams[0], right_wrong=True)
    one, two = cut_pieces(replace(squares(), seams=(seam,)), seam_allowance=1.0)
    assert min(notch.point[1] for notch in one.notches) == pytest.approx(SIDE / 3 - 0.3)
    # The left edge of the second square runs downwards: a third from its start is two thirds up.
    assert max(notch.point[1] for notch in two.notches) == pytest.approx(2 * SIDE / 3 + 0.3)


def test_seams_that_meet_along_an_edge_have_a_notch_there() -> None:
    band = panel("band", [(0, 0), (40, 0), (40, 5), (40, 10), (0, 10)])
    other = panel("other", [(0.0, 0.0), (5.0, 0.0), (5.0, 5.0), (0.0, 5.0)])
    seam = Seam(EdgeRef("band", 1), EdgeRef("other", 3))
    piece, _ = cut_pieces(Pattern("band", (band, other), (seam,)), seam_allowance=1.0)
    assert [notch.point.tolist() for notch in piece.notches] == [pytest.approx([41.0, 5.0])]


def test_a_panel_drawn_with_its_wrong_side_up_is_mirrored() -> None:
    corners = [(0.0, 0.0), (40.0, 0.0), (10.0, 20.0)]
    turned = panel("turned", [(-x, y) for x, y in corners])
    plain, mirrored = (cut_pieces(Pattern("p", (one,), ()))[0] for one in (panel("plain", corners), turned))
    assert mirrored.sew == pytest.approx(plain.sew)
    assert shapely.LinearRing(mirrored.sew).is_ccw
    assert mirrored.grain == pytest.approx(plain.grain)


@pytest.mark.parametrize("allowance", [-0.5, 11.0, float("nan")])
def test_impossible_allowances_are_refused(allowance: float) -> None:
    with pytest.raises(ConfigError, match="from 0 to 10 cm"):
        cut_pieces(squares(), seam_allowance=allowance)


def test_a_pattern_that_cannot_be_sewn_is_refused() -> None:
    crossed = panel("bow", [(0.0, 0.0), (40.0, 40.0), (40.0, 0.0), (0.0, 40.0)])
    with pytest.raises(PatternError, match="crosses itself"):
        cut_pieces(Pattern("bow", (crossed,), ()))
