"""Necklines: shapes against independent geometry, width and depth, and the necklines under collars."""

from dataclasses import replace
from itertools import pairwise
from math import atan2, hypot, pi, radians, sqrt, tan
from pathlib import Path

import numpy as np
import pytest
from jaxtyping import Float

from gcd_dataset.curves import curve_points, sample_curve
from gcd_dataset.errors import PatternError
from gcd_dataset.generator.body import read_measurements
from gcd_dataset.generator.garments import draw_garment
from gcd_dataset.generator.garments.collar import Collar, CollarDesign
from gcd_dataset.generator.garments.design import read_design
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
from gcd_dataset.generator.pattern import Stroke
from gcd_dataset.records import Measurements, Panel
from gcd_dataset.spec import read_pattern

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


def mirrored_about_chord(line: Float[np.ndarray, "n 2"], chord: tuple[float, float]) -> Float[np.ndarray, "n 2"]:
    along = np.array(chord) / hypot(*chord)
    mirrored: Float[np.ndarray, "n 2"] = 2 * (line @ along)[:, None] * along - line
    return mirrored


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


def test_a_round_neckline_as_deep_as_half_its_width_is_a_quarter_of_a_circle() -> None:
    (arc,) = shape(Neckline.CIRCLE, 8.0, 8.0)
    assert arc.length == pytest.approx(pi * 8.0 / 2)


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
    assert points(flipped) == pytest.approx(mirrored_about_chord(points(plain), (9.0, -14.0)))


def test_a_round_arc_bulges_away_from_the_neck() -> None:
    (arc,) = shape(Neckline.ARC, 9.0, 14.0)
    x, y = arc.at(0.5)
    assert x * 14.0 + y * 9.0 < 0  # left of, and below, the straight line


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


def test_a_trapezoid_whose_sides_meet_before_the_bottom_is_a_v() -> None:
    meet = 9.0 * tan(radians(70))  # the depth at which sides of 110 degrees meet in the middle
    assert len(shape(Neckline.TRAPEZOID, 9.0, 0.99 * meet, angle=110)) == 2
    assert shape(Neckline.TRAPEZOID, 9.0, 1.01 * meet, angle=110) == shape(Neckline.V, 9.0, 1.01 * meet)


def test_a_square_neckline_goes_straight_down_and_across() -> None:
    down, across = shape(Neckline.SQUARE, 9.0, 12.0)
    assert (down.chord, across.chord) == ((0.0, -12.0), (9.0, 0.0))


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
    assert neckline_drop(wearer, design, front=front, room=20.0) == pytest.approx(
        min(2.0 * wearer.drawn_bust_line, 19.0)
    )


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


@pytest.mark.parametrize("body", ["default_body", "random_body"])
@pytest.mark.parametrize(
    "example",
    ["asymm_circle_skirt_lapel_dress", "asymmetric_top", "dress", "fitted_shirt", "jumpsuit", "shirt_sleeves_hood"],
)
def test_necklines_of_the_reference(examples: Path, example: str, body: str) -> None:
    folder = examples / "patterns" / example / body
    design = read_design(folder / "design_params.yaml")
    design = replace(design, meta=replace(design.meta, wb=None, bottom=None))
    ours = draw_garment(read_measurements(folder / "body_measurements.yaml"), design)
    theirs = read_pattern(next(folder.glob("*_specification.json")))
    for name in ("right_ftorso", "right_btorso", "left_ftorso", "left_btorso"):
        assert neck(ours.panel(name)) == pytest.approx(neck(theirs.panel(name)), abs=0.01)


def neck(panel: Panel) -> Float[np.ndarray, "n 2"]:
    """Points along the neckline of a panel, relative to the first point."""
    edges = [i for i, edge in enumerate(panel.edges) if edge.label.endswith("_collar")]
    flat = np.concatenate([sample_curve(*panel.edge_ends(i), panel.edges[i].curve, 20) for i in edges])
    return flat - flat[0]


def test_the_sagitta_of_an_arc() -> None:
    (arc,) = shape(Neckline.ARC, 6.0, 8.0, angle=90)
    x, y = arc.at(0.5)
    assert hypot(x - 3.0, y + 4.0) == pytest.approx(10.0 * (sqrt(2) - 1) / 2)  # quarter circle over a chord of 10
