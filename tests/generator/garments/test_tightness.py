"""Rings of cloth round hips and legs: their length in the drawn pattern, and skirts too tight to be worn."""

from typing import Any

import pytest

from gcd_dataset.generator.body import build_body, measure, neutral_shape
from gcd_dataset.generator.garments import GarmentDesign, design_from_dict, draw_garment
from gcd_dataset.generator.garments.rules import Reject, has_tight_bottom, try_on
from gcd_dataset.generator.garments.sampling import attempted_design
from gcd_dataset.generator.garments.tightness import rings, trunk_rings
from gcd_dataset.records import Measurements, Pattern

SAMPLED = 60
GODETS = {"insert_w": 11, "insert_depth": 19, "num_inserts": 4, "cuts_distance": 5}
TIGHT: dict[str, dict[str, Any]] = {
    "a hem with godets": {
        "meta": {"upper": None, "wb": "FittedWB", "bottom": "GodetSkirt"},
        "godet-skirt": {"base": "Skirt2", **GODETS},
        "skirt": {"length": 0.4, "ruffle": 1.8},
    },
    "a pencil skirt": {
        "meta": {"upper": None, "wb": "FittedWB", "bottom": "SkirtLevels"},
        "levels-skirt": {"base": "PencilSkirt", "length": 0.7, "base_length_frac": 0.6},
        "pencil-skirt": {"flare": 0.6},
    },
    "a skirt": {
        "meta": {"upper": None, "wb": "FittedWB", "bottom": "Skirt2"},
        "skirt": {"length": 0.3, "ruffle": 1.0, "flare": 0},
    },
}
"""Name of the ring that is too tight to the design."""


def tight(name: str) -> GarmentDesign:
    return design_from_dict(TIGHT[name])


def lengths(drawn: Pattern, panels: str, edges: str) -> float:
    """Length of the edges of a name, of panels whose names begin with ``panels`` [cm]."""
    chosen = [panel for panel in drawn.panels if panel.name.startswith(panels)]
    return sum(
        float(panel.edge_lengths()[i]) for panel in chosen for i, edge in enumerate(panel.edges) if edge.name == edges
    )


@pytest.mark.parametrize("name", TIGHT)
def test_a_skirt_too_narrow_for_hips_or_legs_is_rejected(woman: Measurements, name: str) -> None:
    found = try_on(woman, tight(name))
    assert isinstance(found, Reject)
    assert found.rule == "too_tight"
    assert name in found.figures


def test_the_hem_with_godets_is_what_is_left_of_the_hem_and_the_godets(woman: Measurements) -> None:
    design = tight("a hem with godets")
    (ring,) = [ring for ring in rings(woman, design) if ring.name == "a hem with godets"]
    drawn = draw_garment(woman, design)
    assert ring.cloth == pytest.approx(lengths(drawn, "skirt_", "bottom") + lengths(drawn, "ins_skirt_", "hem"))


def test_the_narrowest_ring_of_a_tapered_base_is_its_hem(woman: Measurements) -> None:
    design = tight("a pencil skirt")
    cloth = [ring.cloth for ring in rings(woman, design) if ring.name == "a pencil skirt"]
    drawn = draw_garment(woman, design)
    base = sum(lengths(drawn, f"skirt_{side}", "bottom") for side in ("front", "back"))
    levels = sum(lengths(drawn, f"skirt_{side}_0", "bottom") for side in ("front", "back"))
    assert min(cloth) == pytest.approx(base - levels, rel=1e-3)


def test_a_skirt_without_gathers_is_as_wide_as_the_waist(woman: Measurements) -> None:
    design = tight("a skirt")
    own = set(rings(woman, design)) - set(trunk_rings(woman, design))
    (ring,) = own
    assert ring.cloth == pytest.approx(lengths(draw_garment(woman, design), "skirt_", "bottom"))
    assert ring.body == woman.hips


def test_sampled_bottoms_are_wide_enough() -> None:
    size = measure(build_body(neutral_shape()))
    designs = (attempted_design(77, number, 0, (size,)).design for number in range(SAMPLED))
    assert not any(has_tight_bottom(size, design) for design in designs)
