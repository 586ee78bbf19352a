"""Tops: lengths computed from the measures, and the reference's fronts, backs and sleeves."""

from collections.abc import Iterable
from dataclasses import replace
from math import tan
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import shapely
from jaxtyping import Float

from gcd_dataset.curves import curve_length, sample_curve
from gcd_dataset.errors import PatternError
from gcd_dataset.generator.body import read_measurements
from gcd_dataset.generator.garments import design_from_dict, draw_garment
from gcd_dataset.generator.garments.design import read_design
from gcd_dataset.generator.garments.mends import ALL_MENDS, Mend
from gcd_dataset.generator.pattern import assemble
from gcd_dataset.records import EdgeRef, Measurements, Panel, Pattern, Seam
from gcd_dataset.spec import read_pattern

TOPS = (
    "asymm_circle_skirt_lapel_dress", "asymmetric_top", "dress", "fitted_shirt", "jumpsuit", "shirt_sleeves_hood",
    "strapless_dress",
)  # fmt: skip
EXACT = 0.01  # cm between closed forms and the reference's solvers
SLEEVE = 0.6  # cm: the reference's fit of an opening stops up to a third of a centimetre from the minimum
PLACED = 1.0  # cm: the reference shifts a panel by the fractional part of its first corner (a truncated pivot)

FITTED = {"upper": "FittedShirt"}
SHIRT = {"upper": "Shirt"}
STRAPLESS = {"meta": FITTED, "shirt": {"strapless": True}}
TORSOS = ("right_ftorso", "left_ftorso", "right_btorso", "left_btorso")


def lengths(pattern: Pattern, panels: Iterable[str], edge: str) -> float:
    """Length of all edges named ``edge`` in the panels [cm]."""
    return sum(sum(edge_lengths(pattern.panel(name), edge)) for name in panels)


def edge_lengths(panel: Panel, name: str) -> list[float]:
    return [curve_length(*panel.edge_ends(i), edge.curve) for i, edge in enumerate(panel.edges) if edge.name == name]


def labels(pattern: Pattern, panel: str) -> set[str]:
    return {edge.label for edge in pattern.panel(panel).edges} - {""}


def contour(panel: Panel) -> Float[np.ndarray, "n 2"]:
    """Points along the outline, from its first corner [cm]."""
    edges = [sample_curve(*panel.edge_ends(i), edge.curve, 60) for i, edge in enumerate(panel.edges)]
    return np.concatenate(edges) - panel.vertices[0]


def apart(a: Panel, b: Panel) -> float:
    """Largest distance of a point of one outline from the other, both ways [cm]."""
    return float(shapely.hausdorff_distance(shapely.LineString(contour(a)), shapely.LineString(contour(b))))


def seams(pattern: Pattern, panels: set[str]) -> set[frozenset[tuple[str, int]]]:
    """The seams among these panels, the edges by their numbers."""

    def inside(seam: Seam) -> bool:
        return {seam.left.panel, seam.right.panel} <= panels

    def key(ref: EdgeRef) -> tuple[str, int]:
        return ref.panel, ref.edge

    return {frozenset({key(seam.left), key(seam.right)}) for seam in pattern.seams if inside(seam)}


# ------------------------------------------------------------------------------------------------------- the reference


@pytest.mark.parametrize("body", ["default_body", "random_body"])
@pytest.mark.parametrize("top", TOPS)
def test_tops_equal_the_references(examples: Path, top: str, body: str) -> None:
    folder = examples / "patterns" / top / body
    size, design = read_measurements(folder / "body_measurements.yaml"), read_design(folder / "design_params.yaml")
    assert design.meta.upper is not None
    ours = assemble(design.meta.upper.garment.draw(size, design, mends=frozenset()), "top")
    reference = read_pattern(folder / f"{top}_specification.json")
    names = {panel.name for panel in ours.panels}
    assert names == {p.name for p in reference.panels if p.label != "leg" and not p.name.startswith("wb_")}
    assert seams(ours, names) == seams(reference, names)
    for name in (name for name in names if "torso" in name or "sleeve" in name):
        panel, theirs = ours.panel(name), reference.panel(name)
        assert apart(panel, theirs) < (EXACT if "torso" in name else SLEEVE)
        assert np.abs(panel.placement.translation - theirs.placement.translation).max() < PLACED
        assert panel.placement.rotation == pytest.approx(theirs.placement.rotation, abs=1e-3)
        assert panel.label == theirs.label


@pytest.mark.parametrize("top", TOPS)
def test_labels_include_the_references(examples: Path, top: str) -> None:
    folder = examples / "patterns" / top / "default_body"
    size, design = read_measurements(folder / "body_measurements.yaml"), read_design(folder / "design_params.yaml")
    ours, reference = draw_garment(size, design), read_pattern(folder / f"{top}_specification.json")
    for name in TORSOS:
        # The reference loses the label of an edge that a seam divides; this package keeps it.
        assert labels(ours, name) >= labels(reference, name)


# -------------------------------------------------------------------------------------------------------------- shirts


def test_a_shirt_is_as_wide_as_the_bust_and_as_long_as_asked(woman: Measurements) -> None:
    design = design_from_dict({"meta": SHIRT, "shirt": {"width": 1.1, "flare": 1.0, "length": 1.3}})
    pattern = draw_garment(woman, design)
    assert lengths(pattern, TORSOS, "bottom") == pytest.approx(1.1 * woman.bust)
    # The armhole hangs from the shoulder line, which rises from the side's upper end to the shoulder's.
    rise = tan(woman.shoulder_incl) * (0.5 * 1.1 * woman.back_width - 0.5 * woman.sleeve_balance)
    side = 1.3 * woman.waist_line + rise - 1.2 * woman.eased_armscye_depth
    assert lengths(pattern, ("right_btorso",), "side") == pytest.approx(side)


def test_a_neckline_is_as_wide_as_asked(woman: Measurements) -> None:
    panel = draw_garment(woman, design_from_dict({"meta": SHIRT, "collar": {"width": 0.0}})).panel("right_ftorso")
    (neck,) = (i for i, edge in enumerate(panel.edges) if edge.name == "neck")
    start, end = panel.edge_ends(neck)
    assert abs(start[0] - end[0]) == pytest.approx(0.5 * woman.neck_w)


def test_a_neckline_wider_than_the_shirt_is_refused(woman: Measurements) -> None:
    broad = replace(woman, neck_w=60.0)
    with pytest.raises(PatternError, match=r"narrow collar\.width"):
        draw_garment(broad, design_from_dict({"meta": SHIRT, "collar": {"width": 0.0}}))


def test_shoulders_wider_than_the_shirt_are_refused(woman: Measurements) -> None:
    broad = replace(woman, shoulder_w=70.0)
    with pytest.raises(PatternError, match=r"has no room for armholes 34\.0 cm from the centre: raise shirt\.width"):
        draw_garment(broad, design_from_dict({"meta": SHIRT}))


@pytest.mark.parametrize("kind", ["ArmholeSquare", "ArmholeAngle", "ArmholeCurve"])
@pytest.mark.parametrize("meta", [SHIRT, FITTED])
def test_armholes_of_all_shapes_end_at_the_same_places(woman: Measurements, meta: dict[str, str], kind: str) -> None:
    plain = draw_garment(woman, design_from_dict({"meta": meta}))
    shaped = draw_garment(woman, design_from_dict({"meta": meta, "sleeve": {"armhole_shape": kind}}))
    for name in TORSOS:
        for edge in ("side", "shoulder", "centre"):
            assert lengths(shaped, (name,), edge) == pytest.approx(lengths(plain, (name,), edge))


def test_a_square_armhole_goes_in_and_then_up(woman: Measurements) -> None:
    pattern = draw_garment(woman, design_from_dict({"meta": SHIRT, "sleeve": {"armhole_shape": "ArmholeSquare"}}))
    inwards, upwards = sorted(edge_lengths(pattern.panel("left_btorso"), "armhole"))
    assert inwards == pytest.approx(0.5 * (1.05 * woman.back_width - woman.sleeve_balance))
    assert upwards == pytest.approx(1.2 * woman.eased_armscye_depth)


# -------------------------------------------------------------------------------------------------------- fitted shirts


def test_a_fitted_shirt_closes_around_the_waist(wearer: Measurements) -> None:
    pattern = draw_garment(wearer, design_from_dict({"meta": FITTED}))
    fronts, backs = TORSOS[:2], TORSOS[2:]
    assert lengths(pattern, fronts, "bottom") == pytest.approx(wearer.waist - wearer.waist_back_width)
    # The back's waist is curved, and so a little longer than a straight line.
    assert lengths(pattern, backs, "bottom") == pytest.approx(wearer.waist_back_width, rel=0.02)


def test_the_legs_of_every_dart_are_sewn_to_each_other(wearer: Measurements) -> None:
    pattern = draw_garment(wearer, design_from_dict({"meta": FITTED}))
    for name in TORSOS:
        panel = pattern.panel(name)
        legs = {
            (panel.edges[s.left.edge].name, panel.edges[s.right.edge].name)
            for s in pattern.seams
            if s.left.panel == s.right.panel == name
        }
        darts = ("waist_dart", "side_dart") if "ftorso" in name else ("outer_dart", "inner_dart")
        assert legs == {(f"{dart}.0", f"{dart}.1") for dart in darts}
        for dart in darts:
            assert edge_lengths(panel, f"{dart}.0") == pytest.approx(edge_lengths(panel, f"{dart}.1"))


def test_the_side_dart_points_at_the_bust(woman: Measurements) -> None:
    panel = draw_garment(woman, design_from_dict({"meta": FITTED})).panel("left_ftorso")
    legs = [i for i, edge in enumerate(panel.edges) if edge.name.startswith("side_dart")]
    tip = panel.edge_ends(min(legs))[1]
    under, over = panel.edge_ends(min(legs))[0], panel.edge_ends(max(legs))[1]
    assert tip[1] == pytest.approx(0.5 * (under[1] + over[1]))
    assert abs(over[1] - under[1]) == pytest.approx(woman.waist_over_bust_line - woman.waist_line)


def test_a_waist_as_wide_as_the_bust_needs_no_dart(woman: Measurements) -> None:
    stout = replace(woman, waist=woman.bust + 4.0, waist_back_width=woman.back_width + 1.0)
    pattern = draw_garment(stout, design_from_dict({"meta": FITTED}))
    assert {edge.name for name in TORSOS for edge in pattern.panel(name).edges if "dart" in edge.name} == {
        "side_dart.0",
        "side_dart.1",
    }
    assert lengths(pattern, TORSOS[:2], "bottom") == pytest.approx(stout.waist - stout.waist_back_width)


def test_measures_without_room_for_a_side_dart_are_refused(woman: Measurements) -> None:
    flat = replace(woman, waist_over_bust_line=woman.waist_line)
    with pytest.raises(PatternError, match=r"right_ftorso: waist_over_bust_line of 35\.8 cm leaves no side dart"):
        draw_garment(flat, design_from_dict({"meta": FITTED}))


@pytest.mark.parametrize("sleeveless", [True, False])
@pytest.mark.parametrize("meta", [SHIRT, FITTED])
def test_the_deepest_armhole_leaves_side_to_sew(wearer: Measurements, meta: dict[str, str], sleeveless: bool) -> None:
    arm = {"connecting_width": 2.0, "sleeveless": sleeveless}
    pattern = draw_garment(wearer, design_from_dict({"meta": meta, "sleeve": arm, "shirt": {"length": 0.7}}))
    for name in TORSOS:
        assert min(edge_lengths(pattern.panel(name), "side")) >= 1.0 - 1e-9


def test_the_reference_cuts_through_the_side_of_a_back(woman: Measurements) -> None:
    design, left_out = design_from_dict({"meta": FITTED, "sleeve": {"connecting_width": 2.0}}), Mend.ARMHOLE_ROOM
    with pytest.raises(
        PatternError, match=r"an armhole 22\.9 cm deep .* room for 22\.8 cm: lower sleeve\.connecting_width"
    ):
        draw_garment(woman, design, mends=ALL_MENDS - {left_out})


# ---------------------------------------------------------------------------------------------------- strapless, uneven


def test_sides_of_a_strapless_top_are_equally_long(wearer: Measurements) -> None:
    pattern = draw_garment(wearer, design_from_dict(STRAPLESS))
    front, back = (lengths(pattern, (name,), "side") for name in ("right_ftorso", "right_btorso"))
    assert front == pytest.approx(back)
    assert all(labels(pattern, name) == {"strapless_top"} for name in TORSOS)
    assert not {edge.name for name in TORSOS for edge in pattern.panel(name).edges} & {"neck", "shoulder", "armhole"}


def test_a_strapless_back_without_depth_ends_at_the_level_of_the_shoulder(woman: Measurements) -> None:
    panel = draw_garment(woman, design_from_dict(STRAPLESS | {"collar": {"bc_depth": 0.0}})).panel("right_btorso")
    level = woman.waist_line - tan(woman.shoulder_incl) * 0.5 * (woman.back_width - woman.shoulder_w)
    hollow = 0.25 * tan(woman.shoulder_incl) * 0.5 * woman.back_width
    assert sum(edge_lengths(panel, "centre")) == pytest.approx(level - hollow)


def test_only_fitted_shirts_are_strapless(woman: Measurements) -> None:
    plain, asked = (
        draw_garment(woman, design_from_dict({"meta": SHIRT, "shirt": {"strapless": s}})) for s in (False, True)
    )
    assert plain == asked


def test_halves_of_one_design_are_mirror_images(wearer: Measurements) -> None:
    for meta in (SHIRT, FITTED):
        pattern = draw_garment(wearer, design_from_dict({"meta": meta, "sleeve": {"sleeveless": False}}))
        for name in (panel.name for panel in pattern.panels if panel.name.startswith("right")):
            right, left = (pattern.panel(n) for n in (name, name.replace("right", "left")))
            # Both run counter-clockwise as seen from outside, so the image's loop runs the other way.
            image = np.roll(left.vertices[::-1], 1, axis=0) * (-1.0, 1.0)
            assert right.vertices == pytest.approx(image, abs=1e-9)


@pytest.mark.parametrize("side", ["right", "left"])
def test_a_top_may_be_strapless_on_one_side(woman: Measurements, side: str) -> None:
    bare: dict[str, Any] = {"strapless": True}
    left = {"enable_asym": True, "shirt": bare if side == "left" else {}}
    values = {"meta": FITTED, "shirt": bare if side == "right" else {}, "collar": {"bc_depth": 0.5}, "left": left}
    pattern = draw_garment(woman, design_from_dict(values))
    other = "left" if side == "right" else "right"
    assert labels(pattern, f"{side}_ftorso") == {"strapless_top"}
    assert labels(pattern, f"{other}_ftorso") == {f"{other}_armhole", f"{other}_collar"}
    centres = {sum(edge_lengths(pattern.panel(f"{s}_btorso"), "centre")) for s in ("left", "right")}
    assert len(centres) == 2  # different lengths, sewn nevertheless
    joined = {frozenset((seam.left.panel, seam.right.panel)) for seam in pattern.seams}
    assert {frozenset(("left_ftorso", "right_ftorso")), frozenset(("left_btorso", "right_btorso"))} <= joined


def test_an_uneven_shirt_is_drawn_from_both_designs(woman: Measurements) -> None:
    values = {"width": 1.2, "flare": 1.0}
    left = {"enable_asym": True, "shirt": values, "collar": {"f_collar": "VNeckHalf", "width": 0.2}}
    pattern = draw_garment(
        woman, design_from_dict({"meta": SHIRT, "shirt": {"width": 1.0, "flare": 1.0}, "left": left})
    )
    assert lengths(pattern, ("right_ftorso", "right_btorso"), "bottom") == pytest.approx(0.5 * woman.bust)
    assert lengths(pattern, ("left_ftorso", "left_btorso"), "bottom") == pytest.approx(0.6 * woman.bust)
    kinds = {
        side: {edge.curve.kind for edge in pattern.panel(f"{side}_ftorso").edges if edge.name == "neck"}
        for side in ("left", "right")
    }
    assert kinds == {"left": {"line"}, "right": {"circle"}}


def test_an_uneven_top_wears_no_collar(woman: Measurements) -> None:
    values = {"meta": SHIRT, "collar": {"component": {"style": "Turtle"}}, "left": {"enable_asym": True}}
    assert not any("collar" in panel.name for panel in draw_garment(woman, design_from_dict(values)).panels)


@pytest.mark.parametrize("upper_kind", ["Shirt", "FittedShirt"])
def test_the_hem_goes_round_the_wearer(woman: Measurements, upper_kind: str) -> None:
    pattern = draw_garment(woman, design_from_dict({"meta": {"upper": upper_kind, "wb": "StraightWB"}}))
    sewn = {
        (seam.left.panel, seam.right.panel) for seam in pattern.seams if seam.right.panel.startswith("wb_")
    }  # fmt: skip
    assert {pair for pair in sewn if "torso" in pair[0]} == {
        ("right_ftorso", "wb_front"),
        ("left_ftorso", "wb_front"),
        ("right_btorso", "wb_back"),
        ("left_btorso", "wb_back"),
    }
