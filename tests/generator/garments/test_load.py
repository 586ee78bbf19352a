"""The weight of cloth: what shoulder seams and hips carry."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from gcd_dataset.curves import sample_curve
from gcd_dataset.errors import PatternError
from gcd_dataset.generator.body import build_body, measure, neutral_shape
from gcd_dataset.generator.body.section import girth, section
from gcd_dataset.generator.drape import DrapeConfig
from gcd_dataset.generator.drape.fabrics import STIFFEST, Fabric
from gcd_dataset.generator.garments import GarmentDesign, design_from_dict, draw_garment
from gcd_dataset.generator.garments.rules import broken_by_weight, is_too_tight
from gcd_dataset.generator.garments.sampling import attempted_design
from gcd_dataset.generator.garments.sewable import CLOTH_GIVES, CLOTH_OFF_SKIN, girth_of_cloth
from gcd_dataset.generator.garments.tightness import FRICTION, STIFFNESS, hip_load, rings, strap_stretch, trunk_rings
from gcd_dataset.generator.garments.trunk import girth_below_waist
from gcd_dataset.generator.garments.wardrobe import Upper
from gcd_dataset.records import BodyPart, Measurements, Panel
from tests.generator.garments.conftest import WEARERS

DRESS = {"upper": "Shirt", "bottom": "SkirtManyPanels"}
BANDED = {"upper": None, "wb": "StraightWB", "bottom": "SkirtCircle"}
SAMPLED = 60


def designed(meta: dict[str, Any], **sections: dict[str, Any]) -> GarmentDesign:
    return design_from_dict({"meta": meta, **{name.replace("_", "-"): values for name, values in sections.items()}})


def area(panel: Panel) -> float:
    """Area of a panel [m²], by the shoelace formula on its sampled edges."""
    loop = np.concatenate(
        [sample_curve(*panel.edge_ends(i), edge.curve, 200)[:-1] for i, edge in enumerate(panel.edges)]
    )
    x, y = loop.T
    return 1e-4 * 0.5 * abs(float(np.sum(x * np.roll(y, -1) - np.roll(x, -1) * y)))


def test_the_limits_are_those_of_the_drape() -> None:
    usual = Fabric()
    assert usual.pull.warp / usual.density == pytest.approx(STIFFNESS)
    assert STIFFNESS == STIFFEST
    assert usual.friction == FRICTION
    assert DrapeConfig().body_gap == CLOTH_OFF_SKIN


def test_a_strap_is_stretched_by_weight_over_width_and_stiffness(woman: Measurements) -> None:
    """Hooke's law: all of the cloth hangs from the shoulder edges of four panels."""
    design = designed(DRESS, flare_skirt={"length": 0.5})
    drawn = draw_garment(woman, design)
    edges = [(panel, i) for panel in drawn.panels for i, edge in enumerate(panel.edges) if edge.name == "shoulder"]
    width = 0.01 * sum(float(panel.edge_lengths()[i]) for panel, i in edges)
    newtons = Fabric().density * 9.81 * sum(map(area, drawn.panels))
    assert len(edges) == 4
    assert strap_stretch(woman, design) - 1 == pytest.approx(newtons / (Fabric().pull.warp * width), rel=1e-3)


def test_a_skirt_alone_hangs_from_no_strap(woman: Measurements) -> None:
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


@pytest.mark.parametrize(
    ("meta", "loaded"),
    [
        (BANDED, True),
        ({**BANDED, "bottom": "Pants"}, False),  # the crotch holds trousers
        ({**BANDED, "bottom": "PencilSkirt"}, False),
        ({"upper": "Shirt", "bottom": "SkirtCircle"}, False),  # the shoulders hold a dress
    ],
)
def test_the_hips_hold_flared_skirts_without_an_upper(woman: Measurements, meta: dict[str, Any], loaded: bool) -> None:
    assert (hip_load(woman, designed(meta)) is not None) == loaded


def test_the_hips_hold_a_strapless_dress_but_not_one_with_one_strap(woman: Measurements) -> None:
    meta, strapless = {"upper": "FittedShirt", "bottom": "SkirtCircle"}, {"strapless": True}
    assert hip_load(woman, designed(meta, shirt=strapless)) is not None
    one_strap = {"enable_asym": True, "shirt": {"strapless": False}}
    assert hip_load(woman, designed(meta, shirt=strapless, left=one_strap)) is None


def test_a_strapless_dress_must_stay_above_the_hips(woman: Measurements) -> None:
    """A skirt may sink to the hips; a dress that sinks as far has left the bust."""
    skirt = hip_load(woman, designed({"upper": None, "bottom": "SkirtCircle"}, flare_skirt={"rise": 1.0}))
    dress = hip_load(woman, designed({"upper": "FittedShirt", "bottom": "SkirtCircle"}, shirt={"strapless": True}))
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


def test_sampled_parts_under_a_shirt_are_not_too_tight_for_the_hips() -> None:
    size = measure(build_body(neutral_shape()))
    joined = 0
    for number in range(SAMPLED):
        design = attempted_design(3, number, 0, (size,)).design
        if design.meta.upper is Upper.SHIRT and (design.meta.wb or design.meta.bottom):
            try:
                found = list(rings(size, design))
            except PatternError:
                continue
            assert all(ring.stretch <= CLOTH_GIVES for ring in found if ring.name in ("a waist seam", "a hem"))
            joined += 1
    assert joined > 10
