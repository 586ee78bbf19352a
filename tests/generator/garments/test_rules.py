"""Garments that cannot be worn are rejected with figures: shapes, the weight of cloth, tight rings."""

from collections.abc import Mapping
from dataclasses import replace
from math import inf
from typing import Any

import numpy as np
import pytest

from gcd_dataset.crossings import edge_hulls
from gcd_dataset.curves import signed_area
from gcd_dataset.generator.body import build_body, measure, neutral_shape
from gcd_dataset.generator.body.section import girth, section
from gcd_dataset.generator.drape import DrapeConfig
from gcd_dataset.generator.drape.fabrics import STIFFEST, Fabric
from gcd_dataset.generator.garments import (
    DrawnGarment,
    GarmentDesign,
    Reject,
    check_design,
    design_from_dict,
    draw_garment,
    try_on,
)
from gcd_dataset.generator.garments.pants import cuff_and_leg_girth
from gcd_dataset.generator.garments.rules import broken_by_weight, is_too_tight
from gcd_dataset.generator.garments.sewable import (
    CLOTH_GIVES,
    CLOTH_OFF_SKIN,
    NARROWEST_STRAP,
    SHORTEST_SHOULDER,
    corner_angles,
    girth_of_cloth,
    strap_width,
    widest_neckline,
)
from gcd_dataset.generator.garments.tightness import FRICTION, STIFFNESS, hip_load, rings, strap_stretch, trunk_rings
from gcd_dataset.generator.garments.trunk import girth_below_waist
from gcd_dataset.records import BodyPart, Measurements
from tests.generator.garments.conftest import SHIRT, SKIRT, WEARERS
from tests.generator.garments.measured import contour, edge_lengths, lengths
from tests.generator.mesh.shapes import panel


def reasons(size: Measurements, values: Mapping[str, Any]) -> list[str]:
    return [reject.rule for reject in check_design(DrawnGarment.of(size, design_from_dict(values)))]


@pytest.mark.parametrize("wb", [None, "StraightWB"])
def test_a_waistband_alone_is_rejected(woman: Measurements, wb: str | None) -> None:
    found = try_on(woman, design_from_dict({"meta": {"wb": wb}}))
    assert isinstance(found, Reject)
    assert str(found).startswith("empty: a garment without upper and bottom")


LONG_DRESS = {"meta": {"upper": "Shirt", "bottom": "SkirtCircle"}, "flare-skirt": {"length": 0.9}}
FIRM = {"meta": SKIRT | {"wb": "StraightWB"}, "waistband": {"width": 0.3}}
BAND = {"type": "CuffBand", "cuff_len": 0.05, "top_ruffle": 2.0}
TAPERED = {"length": 1.5, "width": 1.0, "flare": 0.7}
NARROW = {"meta": {"bottom": "PencilSkirt"}, "pencil-skirt": {"flare": 0.6, "length": 0.3}}


def sleeved(length: float, **values: Any) -> dict[str, Any]:
    return {"meta": SHIRT, "sleeve": {"sleeveless": False, "length": length, **values}}


@pytest.mark.parametrize(
    ("values", "broken"),
    [
        (LONG_DRESS | {"shirt": {"length": 1.0}}, []),
        (LONG_DRESS | {"shirt": {"length": 2.0}}, ["reaches_floor"]),
        # A heavy skirt needs a firm band.
        ({"meta": SKIRT, "flare-skirt": {"length": 0.7}}, ["too_heavy"]),
        ({"meta": SKIRT, "flare-skirt": {"suns": 1.5}}, ["too_heavy"]),
        (FIRM | {"flare-skirt": {"length": 0.7}}, []),
        (FIRM | {"flare-skirt": {"suns": 1.5}}, []),
        # A deep round neckline runs into the armhole.
        ({"meta": SHIRT, "collar": {"width": 0.6, "fc_depth": 1.8}, "shirt": {"length": 2.0}}, ["self_crossing"]),
        # A narrow band fits the wrist, but not the upper arm; the top of a cuff that is a skirt binds like a band.
        (sleeved(0.1, end_width=0.8, cuff=BAND), ["tight_cuff"]),
        (sleeved(1.0, end_width=0.8, cuff=BAND), []),
        (sleeved(0.3, cuff={"type": "CuffSkirt", "top_ruffle": 3.0}), ["tight_cuff"]),
        (sleeved(0.3, cuff={"type": "CuffSkirt", "top_ruffle": 1.0}), []),
        # A sleeve less than half as wide at its end as at the armhole fits the wrist, but not the upper arm.
        (sleeved(0.37, end_width=0.46), ["tight_cuff"]),
        (sleeved(1.0, end_width=0.46), []),
        # A shirt that narrows to the hem is too tight for the hips, a pencil skirt without a slit for the knees.
        ({"meta": SHIRT, "shirt": TAPERED}, ["too_tight"]),
        ({"meta": SHIRT, "shirt": TAPERED | {"width": 1.2, "flare": 0.9}}, []),
        (NARROW, ["too_tight"]),
        (NARROW | {"pencil-skirt": {"flare": 0.6, "length": 0.3, "back_slit": 0.7}}, []),
    ],
)
def test_a_design_breaks_these_rules(woman: Measurements, values: dict[str, Any], broken: list[str]) -> None:
    found = reasons(woman, values)
    assert set(broken) <= set(found) if broken in (["reaches_floor"], ["self_crossing"]) else found == broken


@pytest.mark.parametrize("bottom", ["SkirtCircle", "PencilSkirt", "Pants"])
def test_a_bottom_wider_than_the_trunk_slides(woman: Measurements, bottom: str) -> None:
    meta = {"bottom": bottom, "wb": "StraightWB"}
    assert "slides_off" in reasons(woman, {"meta": meta, "waistband": {"waist": 1.6}})
    assert "slides_off" not in reasons(woman, {"meta": meta, "waistband": {"waist": 1.1}})


@pytest.mark.parametrize(
    "skirt",
    [
        {"meta": {"bottom": "Skirt2"}},
        {"meta": {"bottom": "GodetSkirt"}, "godet-skirt": {"base": "Skirt2", "insert_depth": 10}},
        {"meta": {"bottom": "SkirtLevels"}, "levels-skirt": {"base": "Skirt2"}},
    ],
)
def test_gathers_need_a_snug_band(woman: Measurements, skirt: dict[str, Any]) -> None:
    gathered = skirt | {"skirt": {"ruffle": 1.5}}
    assert "loose_gathers" in reasons(woman, gathered)
    assert "loose_gathers" not in reasons(woman, skirt | {"skirt": {"ruffle": 1.0}})
    assert "loose_gathers" not in reasons(woman, gathered | {"meta": gathered["meta"] | {"wb": "FittedWB"}})


def test_an_edge_too_short_to_sew_is_rejected(woman: Measurements) -> None:
    # A skirt of 5.9 cm with a cut 0.3 cm wide and as deep: legs of √(0.15² + 0.3²) cm.
    cut = {"add": True, "depth": 0.05, "width": 0.05}
    design = design_from_dict({"meta": SKIRT, "flare-skirt": {"length": -0.2, "cut": cut}})
    (reject,) = check_design(DrawnGarment.of(woman, design))
    assert str(reject).startswith("short_edge: panel skirt_back, edge 3: warning: edge under 0.5 cm: it is 0.3")


def test_sides_that_differ_without_gathers_are_rejected(woman: Measurements) -> None:
    """The centre seam of an asymmetric top is rejected only after one of its sides is scaled to 80 %."""
    design = {
        "meta": {"upper": "FittedShirt"},
        "collar": {"fc_depth": 0.3, "f_collar": "VNeckHalf"},
        "left": {"enable_asym": True},
    }
    found = DrawnGarment.of(woman, design_from_dict(design))
    assert not any(reject.rule == "mismatched_seam" for reject in check_design(found))
    (centre,) = [sewn for sewn in found.joins if sewn.join.left[0].edge == "centre" and "ftorso" in str(sewn.join.left)]
    joins = tuple(replace(sewn, left_length=0.8 * sewn.left_length) if sewn is centre else sewn for sewn in found.joins)
    (reason,) = [str(r) for r in check_design(replace(found, joins=joins)) if r.rule == "mismatched_seam"]
    left, right = 0.8 * centre.left_length, centre.right_length
    assert f"{left:.1f} cm of right_ftorso centre on {right:.1f} cm of left_ftorso centre" in reason


def test_the_corners_of_known_shapes(woman: Measurements) -> None:
    triangle = panel("triangle", [(0, 0), (4, 0), (0, 3)])
    # Clockwise, and with a reflex corner.
    crown = panel("crown", [(0, 0), (0, 2), (1, 1), (2, 2), (2, 0)])
    angles = corner_angles([edge_hulls(triangle), edge_hulls(crown)])
    assert angles == pytest.approx([90.0, 36.87, 53.13, 90, 45, 270, 45, 90], abs=0.01)
    # Its corners alone, without its arcs, run the other way round.
    skirt = design_from_dict({"meta": {"bottom": "SkirtCircle"}, "flare-skirt": {"suns": 1.9}})
    front = draw_garment(woman, skirt).panel("skirt_front")
    assert corner_angles([edge_hulls(front)]) == pytest.approx([90.0] * 4, abs=1.0)


@pytest.mark.parametrize(("top_ruffle", "tight"), [(1.0, False), (2.0, True)])
def test_a_cuff_too_tight_for_the_leg_is_rejected(woman: Measurements, top_ruffle: float, tight: bool) -> None:
    """A band from the knee down, as wide as the leg of the trousers or half as wide."""
    cuff = {"type": "CuffBand", "cuff_len": 0.5, "top_ruffle": top_ruffle}
    design = {"meta": {"upper": None, "bottom": "Pants"}, "pants": {"length": 0.9, "cuff": cuff}}
    assert reasons(woman, design) == (["tight_cuff"] if tight else [])
    pattern = draw_garment(woman, design_from_dict(design))
    top = lengths(pattern, "top", ("pant_r_cuff_f", "pant_r_cuff_b"))
    assert cuff_and_leg_girth(woman, design_from_dict(design).pants, 1.0)[0] == pytest.approx(top)


@pytest.mark.parametrize("upper", ["Shirt", "FittedShirt"])
def test_a_shoulder_seam_under_three_centimetres_is_rejected(woman: Measurements, upper: str) -> None:
    """A neckline of full width leaves a strap of a centimetre or two."""
    wide = {"meta": {"upper": upper}, "collar": {"width": 1.0}}
    reject = next(iter(check_design(DrawnGarment.of(woman, design_from_dict(wide)))))
    assert reject.rule == "narrow_shoulder"
    assert 0.8 < reject.numbers["shoulder_cm"] < 2.0
    assert reasons(woman, wide | {"collar": {"width": 0.6}}) == []
    assert reasons(woman, wide | {"shirt": {"strapless": True}, "meta": {"upper": "FittedShirt"}}) == []


@pytest.mark.parametrize("upper", ["Shirt", "FittedShirt"])
def test_the_widest_neckline_leaves_three_centimetres_of_shoulder(woman: Measurements, upper: str) -> None:
    wide = design_from_dict({"meta": {"upper": upper}, "collar": {"width": 1.0}, "shirt": {"width": 1.3}})
    width = widest_neckline(woman, wide, wide.right_half())
    pattern = draw_garment(woman, replace(wide, collar=replace(wide.collar, width=width)))
    shortest = min(width for panel in pattern.panels for width in edge_lengths(panel, "shoulder"))
    assert shortest == pytest.approx(SHORTEST_SHOULDER, abs=1e-5)
    assert shortest >= SHORTEST_SHOULDER


@pytest.mark.parametrize("upper", ["Shirt", "FittedShirt"])
@pytest.mark.parametrize("flare", [0.7, 1.0, 1.6])
def test_a_neckline_is_narrowed_if_and_only_if_its_shoulder_seam_is_too_short(
    woman: Measurements, upper: str, flare: float
) -> None:
    """The length computed before drawing agrees with the drawn one, on sides that lean either way."""
    for width in np.linspace(0.3, 0.85, 12):
        values = {"meta": {"upper": upper}, "collar": {"width": width}, "shirt": {"flare": flare}}
        design, is_short = design_from_dict(values), "narrow_shoulder" in reasons(woman, values)
        assert (widest_neckline(woman, design, design.right_half()) < inf) == is_short


def test_a_straight_band_from_waist_to_hips_is_too_tight_for_the_hips(woman: Measurements) -> None:
    """A rectangle as long as the waist, whose lower edge lies at the hips."""
    high = {"meta": {"bottom": "SkirtCircle", "wb": "StraightWB"}, "waistband": {"width": 1.0}}
    size = replace(woman, hips=1.3 * woman.waist, hip_back_width=0.65 * woman.waist)
    (reject,) = check_design(DrawnGarment.of(size, design_from_dict(high)))
    assert reject.rule == "too_tight"
    assert reject.numbers == pytest.approx({"ring_cm": size.waist, "body_cm": size.hips})
    assert "too_tight" not in reasons(size, high | {"waistband": {"width": 0.5}})


def test_a_band_under_a_long_shirt_is_worn_at_the_hips(woman: Measurements) -> None:
    size = replace(woman, hips=1.3 * woman.waist, hip_back_width=0.65 * woman.waist)
    waist_to_hips = 1 + size.hips_line / size.waist_line
    band = {"meta": {"upper": "Shirt", "wb": "StraightWB"}, "shirt": {"length": waist_to_hips - 0.1}}
    assert "too_tight" in reasons(size, band)
    assert "too_tight" not in reasons(size, band | {"shirt": {"length": 1.0}})


def test_a_neckline_near_the_armhole_leaves_no_strap(woman: Measurements) -> None:
    """A round neckline bulges as it gets deeper, until it runs into the armhole; before that it leaves a thread."""
    found = [(depth, reasons(woman, deep_back(depth))) for depth in np.linspace(0.5, 1.9, 29)]
    first = next(number for number, (_, rules) in enumerate(found) if rules)
    assert found[first][1] == ["narrow_strap"]
    assert all(rules for _, rules in found[first:])
    pattern = draw_garment(woman, design_from_dict(deep_back(found[first][0])))
    assert 0.0 < strap_width(pattern.panel("right_btorso")) < NARROWEST_STRAP


def deep_back(depth: float) -> dict[str, Any]:
    return {"meta": SHIRT, "collar": {"width": 0.6, "bc_depth": depth}, "shirt": {"length": 2.0}}


PANELLED = {"upper": "Shirt", "bottom": "SkirtManyPanels"}
BANDED = {"upper": None, "wb": "StraightWB", "bottom": "SkirtCircle"}


def designed(meta: dict[str, Any], **sections: dict[str, Any]) -> GarmentDesign:
    return design_from_dict({"meta": meta, **{name.replace("_", "-"): values for name, values in sections.items()}})


def test_the_limits_are_those_of_the_drape() -> None:
    usual = Fabric()
    assert usual.pull.warp / usual.density == pytest.approx(STIFFNESS)
    assert STIFFNESS == STIFFEST
    assert usual.friction == FRICTION
    assert DrapeConfig().body_gap == CLOTH_OFF_SKIN


def test_a_strap_is_stretched_by_weight_over_width_and_stiffness(woman: Measurements) -> None:
    """Hooke's law: all of the cloth hangs from the shoulder edges of four panels; a skirt alone from none."""
    design = designed(PANELLED, flare_skirt={"length": 0.5})
    drawn = draw_garment(woman, design)
    straps = [width for panel in drawn.panels for width in edge_lengths(panel, "shoulder")]
    square_metres = 1e-4 * sum(abs(signed_area(contour(panel))) for panel in drawn.panels)
    newtons, width = Fabric().density * 9.81 * square_metres, 0.01 * sum(straps)
    assert len(straps) == 4
    assert strap_stretch(woman, design) - 1 == pytest.approx(newtons / (Fabric().pull.warp * width), rel=1e-3)
    assert strap_stretch(woman, designed(BANDED)) == 1.0


def test_a_band_as_wide_as_the_hips_holds_nothing(woman: Measurements) -> None:
    """Unstretched cloth does not press on the body; the hips of the cloth are 2 cm wider than those of the skin."""
    column = replace(woman, hips=woman.waist, hip_back_width=woman.waist_back_width)
    top = {"rise": 1.0, "suns": 0.2}
    loads = [
        hip_load(size, designed(BANDED, waistband={"waist": wide}, flare_skirt=top))
        for size, wide in ((woman, 1.0), (column, 1.0), (column, 1.1))
    ]
    held = [load.held for load in loads if load is not None]
    # The top of the skirt is as long as the waist: it grips even under a loose band.
    assert held[0] / held[1] == pytest.approx((girth_of_cloth(woman.hips) - woman.waist) / (2.2), rel=0.01)
    assert held[2] == held[1]


STRAPLESS: dict[str, Any] = {"meta": {"upper": "FittedShirt", "bottom": "SkirtCircle"}, "shirt": {"strapless": True}}


@pytest.mark.parametrize(
    ("sections", "loaded"),
    [
        ({"meta": BANDED}, True),
        ({"meta": {**BANDED, "bottom": "Pants"}}, False),  # the crotch holds trousers
        ({"meta": {**BANDED, "bottom": "PencilSkirt"}}, False),
        ({"meta": {"upper": "Shirt", "bottom": "SkirtCircle"}}, False),  # the shoulders hold a dress
        (STRAPLESS, True),
        (STRAPLESS | {"left": {"enable_asym": True, "shirt": {"strapless": False}}}, False),  # one strap holds it
    ],
)
def test_the_hips_hold_flared_skirts_without_an_upper_or_straps(
    woman: Measurements, sections: dict[str, Any], loaded: bool
) -> None:
    assert (hip_load(woman, designed(**sections)) is not None) == loaded


def test_a_strapless_dress_must_stay_above_the_hips(woman: Measurements) -> None:
    """A skirt may sink to the hips; a dress that sinks as far has left the bust."""
    skirt = hip_load(woman, designed(SKIRT, flare_skirt={"rise": 1.0}))
    dress = hip_load(woman, designed(**STRAPLESS))
    assert skirt is not None
    assert dress is not None
    assert dress.held < 0.6 * skirt.held
    assert dress.cloth > skirt.cloth


def test_wide_cloth_slides_from_a_man_without_hips() -> None:
    """7 m² of cloth weigh 14 N; a band a few per cent shorter than the hips presses on them with a few newtons."""
    man = WEARERS["man"]
    straight = replace(man, waist=man.hips - 5.0, waist_back_width=man.hip_back_width - 2.0)
    wide = designed(BANDED, waistband={"width": 0.3}, flare_skirt={"suns": 1.9, "length": 0.8})
    assert broken_by_weight(straight, wide) == "overloaded_hips"
    light = designed(BANDED, waistband={"width": 0.3}, flare_skirt={"suns": 0.3, "length": 0.05})
    assert not broken_by_weight(straight, light)


def test_the_girth_below_the_waist_is_that_of_a_tape() -> None:
    body = build_body(neutral_shape())
    size, arms = measure(body), [BodyPart.LEFT_ARM.value, BodyPart.RIGHT_ARM.value, BodyPart.HANDS.value]
    trunk = body.faces[~np.isin(body.parts, arms)[body.faces].any(axis=1)]
    for share in np.linspace(0.0, 1.0, 6):
        depth = float(share * size.hips_line)
        tape = girth(section(body.vertices, trunk, 1, size.waist_level - depth)[:, 0, [0, 2]])
        assert girth_below_waist(size, depth) == pytest.approx(tape, rel=0.02)


def test_a_tapered_shirt_below_the_hips_is_measured_at_the_hips(woman: Measurements) -> None:
    """Between chest and hem the side is straight: at a share of its length the girth is the same share between."""
    shirt = designed({"upper": "Shirt"}, shirt={"length": 2.2, "width": 1.0, "flare": 0.7})
    (ring,) = [ring for ring in rings(woman, shirt) if ring.name == "a shirt"]
    assert 0.7 * woman.bust < ring.cloth < woman.bust
    assert ring.body == woman.hips


def test_tight_trouser_legs_are_no_ring_of_the_trunk(woman: Measurements) -> None:
    """A shorter shirt does not widen them."""
    tight = designed({"upper": "Shirt", "bottom": "Pants"}, pants={"flare": 0.5, "width": 1.0, "length": 0.9})
    others = {ring.name for ring in rings(woman, tight)} - {ring.name for ring in trunk_rings(woman, tight)}
    assert others == {"a trouser leg"}
    assert is_too_tight(woman, tight) == any(ring.stretch > CLOTH_GIVES for ring in trunk_rings(woman, tight))


GODETS = {"insert_w": 11, "insert_depth": 19, "num_inserts": 4, "cuts_distance": 5}
TIGHT = {
    "a hem with godets": designed(
        {"wb": "FittedWB", "bottom": "GodetSkirt"},
        godet_skirt={"base": "Skirt2", **GODETS},
        skirt={"length": 0.4, "ruffle": 1.8},
    ),
    "a pencil skirt": designed(
        {"wb": "FittedWB", "bottom": "SkirtLevels"},
        levels_skirt={"base": "PencilSkirt", "length": 0.7, "base_length_frac": 0.6},
        pencil_skirt={"flare": 0.6},
    ),
    "a skirt": designed({"wb": "FittedWB", "bottom": "Skirt2"}, skirt={"length": 0.3, "ruffle": 1.0, "flare": 0}),
}
"""Name of the ring that is too tight to the design."""


@pytest.mark.parametrize("name", TIGHT)
def test_a_skirt_too_narrow_for_hips_or_legs_is_rejected(woman: Measurements, name: str) -> None:
    found = try_on(woman, TIGHT[name])
    assert isinstance(found, Reject)
    assert found.rule == "too_tight"
    assert name in found.figures


def test_the_hem_with_godets_is_what_is_left_of_the_hem_and_the_godets(woman: Measurements) -> None:
    design = TIGHT["a hem with godets"]
    (ring,) = [ring for ring in rings(woman, design) if ring.name == "a hem with godets"]
    drawn = draw_garment(woman, design)
    godets = [panel.name for panel in drawn.panels if panel.name.startswith("ins_")]
    assert ring.cloth == pytest.approx(lengths(drawn, "bottom") + lengths(drawn, "hem", godets))


def test_the_narrowest_ring_of_a_tapered_base_is_its_hem(woman: Measurements) -> None:
    design = TIGHT["a pencil skirt"]
    cloth = [ring.cloth for ring in rings(woman, design) if ring.name == "a pencil skirt"]
    assert min(cloth) == pytest.approx(lengths(draw_garment(woman, design), "bottom"), rel=1e-3)


def test_a_skirt_without_gathers_is_as_wide_as_the_waist(woman: Measurements) -> None:
    design = TIGHT["a skirt"]
    (ring,) = set(rings(woman, design)) - set(trunk_rings(woman, design))
    assert ring.cloth == pytest.approx(lengths(draw_garment(woman, design), "bottom"))
    assert ring.body == woman.hips
