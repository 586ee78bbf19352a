"""Strokes keep their geometry when they are divided, turned and mirrored."""

import numpy as np
import pytest

from gcd_dataset.curves import LINE, Arc, Cubic, Curve, Quadratic
from gcd_dataset.errors import PatternError
from gcd_dataset.generator.pattern import Stroke

CURVES: list[Curve] = [
    LINE,
    Quadratic((0.3, 0.4)),
    Cubic((0.2, -0.35), (0.5, -0.2)),
    Arc(20.0, large=False, right=True),
    Arc(20.0, large=True, right=False),
]


@pytest.mark.parametrize("curve", CURVES)
def test_parts_add_up_to_the_whole(curve: Curve) -> None:
    stroke = Stroke((1.0, 2.0), (25.0, 20.0), curve, "side", "held")
    pieces = stroke.split([0.2, 0.75])
    assert [piece.length / stroke.length for piece in pieces] == pytest.approx([0.2, 0.55, 0.25], abs=1e-7)
    assert {(piece.name, piece.label) for piece in pieces} == {("side", "held")}
    assert pieces[0].end == pieces[1].start
    assert pieces[-1].end == stroke.end


@pytest.mark.parametrize("curve", CURVES)
def test_parts_lie_on_the_whole(curve: Curve) -> None:
    stroke = Stroke((1.0, 2.0), (25.0, 20.0), curve)
    first, second = stroke.split_at([0.4])
    assert first.at(0.5) == pytest.approx(stroke.at(0.2))
    assert second.at(0.5) == pytest.approx(stroke.at(0.7))


@pytest.mark.parametrize("curve", CURVES)
def test_rotation_keeps_the_length_and_rotates_the_points(curve: Curve) -> None:
    stroke = Stroke((1.0, 2.0), (25.0, 20.0), curve)
    turned = stroke.rotated(0.5 * np.pi, about=(1.0, 2.0))
    x, y = stroke.at(0.3)
    assert turned.length == pytest.approx(stroke.length)
    assert turned.at(0.3) == pytest.approx((1.0 - (y - 2.0), 2.0 + (x - 1.0)))


@pytest.mark.parametrize("curve", CURVES)
def test_reversal_and_mirroring_map_points(curve: Curve) -> None:
    stroke = Stroke((1.0, 2.0), (25.0, 20.0), curve)
    x, y = stroke.at(0.3)
    assert stroke.reversed().at(0.7) == pytest.approx((x, y))
    assert stroke.mirrored().at(0.3) == pytest.approx((-x, y))


def test_an_arc_has_no_control_points() -> None:
    with pytest.raises(PatternError, match="hem: an arc has no control points"):
        Stroke((0.0, 0.0), (1.0, 0.0), Arc(1.0, large=False, right=True), "hem").control_points()
