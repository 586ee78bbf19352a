"""Turtlenecks, lapels and hoods on their necklines."""

from collections.abc import Mapping
from dataclasses import replace
from math import atan2, degrees, hypot, pi
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import shapely
from jaxtyping import Float

from gcd_dataset.curves import Arc, curve_length, curve_points
from gcd_dataset.generator.body import read_measurements
from gcd_dataset.generator.garments import design_from_dict, draw_garment
from gcd_dataset.generator.garments.collar import RAISED, Collar, hood_outline
from gcd_dataset.generator.garments.design import read_design
from gcd_dataset.generator.pattern import s_shaped_cubic
from gcd_dataset.records import EdgeRef, Measurements, Panel, Pattern, Seam
from gcd_dataset.spec import read_pattern

STYLES = pytest.mark.parametrize("style", [style.value for style in Collar])
STANDING = pytest.mark.parametrize("standing", [True, False])
SIDES = pytest.mark.parametrize("side", ["right", "left"])
BODIES = pytest.mark.parametrize("body", ["default_body", "random_body"])
NECKLINE: Mapping[str, Any] = {"f_collar": "CircleNeckHalf"}
DRAWN = 0.01  # cm
FITTED = 0.3  # cm between this package's fit of a hood's neckline and the reference's, whose minimiser stops early


def top(
    size: Measurements, style: str, *, upper: str = "Shirt", collar: Mapping[str, Any] = NECKLINE, **component: Any
) -> Pattern:
    """A sleeveless top; its collar has the given style and parameters."""
    neckline = {**collar, "component": {**component, "style": style}}
    return draw_garment(size, design_from_dict({"meta": {"upper": upper}, "collar": neckline}))


def round_length(half_width: float, depth: float) -> float:
    """Length of half a round neckline: radius times angle [cm]."""
    return (half_width**2 + depth**2) / (2 * depth) * 2 * atan2(depth, half_width)


def length(pattern: Pattern, ref: EdgeRef) -> float:
    panel = pattern.panel(ref.panel)
    return curve_length(*panel.edge_ends(ref.edge), panel.edges[ref.edge].curve)


def seams(pattern: Pattern, one: str, other: str) -> list[Seam]:
    """The seams between two panels."""
    return [seam for seam in pattern.seams if {seam.left.panel, seam.right.panel} == {one, other}]


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
            assert length(pattern, seam.left) == pytest.approx(length(pattern, seam.right), abs=1e-4)


@STYLES
@SIDES
def test_the_whole_neckline_is_sewn_to_the_collar(woman: Measurements, style: str, side: str) -> None:
    pattern = top(woman, style)
    for torso in (f"{side}_ftorso", f"{side}_btorso"):
        for edge in named(pattern.panel(torso), "neck"):
            (partner,) = [
                seam.right if seam.left == EdgeRef(torso, edge) else seam.left
                for seam in pattern.seams
                if EdgeRef(torso, edge) in (seam.left, seam.right)
            ]
            assert partner.panel in (f"{side}_hood", f"{side}_collar_front", f"{side}_collar_back")


@STYLES
@STANDING
def test_seams_join_matching_ends(woman: Measurements, style: str, standing: bool) -> None:
    # Shoulder meets shoulder and centre meets centre: sewing merges no two corners of one panel.
    pattern = top(woman, style, lapel_standing=standing)
    corner: dict[tuple[str, int], tuple[str, int]] = {}

    def root(key: tuple[str, int]) -> tuple[str, int]:
        while corner.get(key, key) != key:
            key = corner[key]
        return key

    for seam in pattern.seams:
        left, right = (pattern.panel(ref.panel).edges[ref.edge] for ref in (seam.left, seam.right))
        ends = (right.start, right.end) if seam.right_wrong else (right.end, right.start)
        for mine, other in zip((left.start, left.end), ends, strict=True):
            corner[root((seam.left.panel, mine))] = root((seam.right.panel, other))
    for panel in pattern.panels:
        met = [root((panel.name, edge.start)) for edge in panel.edges]
        assert len(set(met)) == len(met)


@pytest.mark.parametrize(("depth", "width"), [(2, -0.5), (5, 0.0), (8, 1.0)])
def test_a_turtleneck_is_a_band_closed_all_round(wearer: Measurements, depth: int, width: float) -> None:
    pattern = top(wearer, "Turtle", collar={"width": width}, depth=depth)
    for part in ("front", "back"):
        right = pattern.panel(f"right_collar_{part}")
        x, y = right.vertices.T
        assert np.ptp(y) == pytest.approx(depth)
        assert np.ptp(x) == pytest.approx(length(pattern, EdgeRef(right.name, named(right, "bottom")[0])))
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
    (neck,) = [torso.edges[i].curve for i in named(torso, "neck")]
    inner, outer = (collar.edges[named(collar, name)[0]].curve for name in ("top", "bottom"))
    assert isinstance(neck, Arc) and isinstance(inner, Arc) and isinstance(outer, Arc)
    assert inner.radius == pytest.approx(neck.radius)
    assert outer.radius == pytest.approx(neck.radius + 6.0)


def test_a_lying_collar_lies_flat_with_its_outside_up(woman: Measurements) -> None:
    for side in ("right", "left"):
        collar = top(woman, "SimpleLapel", lapel_standing=False).panel(f"{side}_collar_back")
        assert abs(collar.placement.matrix[1, 2]) == pytest.approx(1.0)
        x, y = contour(collar).T
        area = 0.5 * np.sum(x * np.roll(y, -1) - y * np.roll(x, -1))  # positive where the loop is counter-clockwise
        assert area * collar.placement.matrix[1, 2] > 0


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
        depth = share * half_width
        length = round_length(half_width, depth)
        front, back = (
            ((half_width, depth), length),
            ((half_width, 0.2 * half_width), round_length(half_width, 0.2 * half_width)),
        )
        outline = hood_outline(*front, *back, top=1.0, height=25.0)
        assert shapely.Polygon(outline.points()).is_valid


def test_a_hood_leaves_and_reaches_the_centre_about_level(woman: Measurements) -> None:
    hood = top(woman, "Hood2Panels").panel("right_hood")
    for name in ("front_neck", "back_neck"):
        z, y = edge_in_space(hood, name)[:, [2, 1]].T
        for a, b in ((0, 1), (-2, -1)):
            assert abs(degrees(atan2(y[b] - y[a], abs(z[b] - z[a])))) < 6.0


@STYLES
def test_collars_are_mirror_images(woman: Measurements, style: str) -> None:
    pattern = top(woman, style)
    for panel in pattern.panels:
        if panel.name.startswith("right_"):
            twin = pattern.panel(panel.name.replace("right", "left"))
            mine = np.sort(panel.placement.apply(panel.vertices) * (-1, 1, 1), axis=0)
            assert mine == pytest.approx(np.sort(twin.placement.apply(twin.vertices), axis=0), abs=1e-9)


def test_an_asymmetric_top_has_no_collar(woman: Measurements) -> None:
    values = {"meta": {"upper": "Shirt"}, "left": {"enable_asym": True}, "collar": {"component": {"style": "Turtle"}}}
    assert all("torso" in panel.name for panel in draw_garment(woman, design_from_dict(values)).panels)


@BODIES
@pytest.mark.parametrize("example", ["asymm_circle_skirt_lapel_dress", "shirt_sleeves_hood"])
def test_collars_of_the_reference(examples: Path, example: str, body: str) -> None:
    folder = examples / "patterns" / example / body
    design = read_design(folder / "design_params.yaml")
    design = replace(
        design, meta=replace(design.meta, wb=None, bottom=None), sleeve=replace(design.sleeve, sleeveless=True)
    )
    ours = draw_garment(read_measurements(folder / "body_measurements.yaml"), design)
    theirs = read_pattern(next(folder.glob("*_specification.json")))
    for panel in (panel for panel in ours.panels if "collar" in panel.name or "hood" in panel.name):
        other = theirs.panel(panel.name)
        lines = [shapely.LineString(contour(p)) for p in (panel, other)]
        assert shapely.hausdorff_distance(*lines) < (FITTED if "hood" in panel.name else DRAWN)
        apart = panel.placement.apply(panel.vertices) - other.placement.apply(other.vertices)
        assert np.linalg.norm(apart, axis=1).max() < 1.0
        sewn = {seam.right_wrong for seam in ours.seams if panel.name in (seam.left.panel, seam.right.panel)}
        assert sewn == {seam.right_wrong for seam in theirs.seams if panel.name in (seam.left.panel, seam.right.panel)}


def contour(panel: Panel) -> Float[np.ndarray, "n 2"]:
    edges = [(panel.edge_ends(i), edge.curve) for i, edge in enumerate(panel.edges)]
    flat = np.concatenate([curve_points(*ends, curve, np.linspace(0, 1, 100)) for ends, curve in edges])
    return flat - panel.vertices[0]


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
