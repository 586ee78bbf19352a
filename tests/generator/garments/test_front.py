"""Fronts of shirts: closures of the centre seam, button stands, and which data sets draw them."""

from typing import Any

import numpy as np
import pytest

from gcd_dataset.errors import PatternError
from gcd_dataset.generator.garments import (
    GarmentDesign,
    Reject,
    design_from_dict,
    design_to_dict,
    draw_garment,
    sample_design,
    try_on,
)
from gcd_dataset.generator.garments.overlay import Overlay
from gcd_dataset.generator.mesh import build_box_mesh
from gcd_dataset.records import Closure, EdgeRef, LineRole, Measurements, Seam
from tests.generator.garments.measured import TORSOS, edge_lengths, errors, lengths, seams

CLOSED = [Closure.OPEN, Closure.ZIP, Closure.BUTTONS]


def fronted(closure: str, *, upper: str = "Shirt", collar: str | None = None, **front: Any) -> GarmentDesign:
    collars = {"component": {"style": collar}}
    return design_from_dict({"meta": {"upper": upper}, "front": {"closure": closure} | front, "collar": collars})


def front_seams(design: GarmentDesign, size: Measurements) -> list[Seam]:
    """The seams between the right and the left front and between their collars."""
    pattern = draw_garment(size, design)
    return [seam for part in ("ftorso", "collar_front") for seam in seams(pattern, f"right_{part}", f"left_{part}")]


@pytest.mark.parametrize("closure", CLOSED)
@pytest.mark.parametrize("collar", [None, "Turtle"])
def test_the_seam_of_the_fronts_has_the_closure(woman: Measurements, closure: Closure, collar: str | None) -> None:
    closed = [(seam.closure, seam.closed) for seam in front_seams(fronted(closure.value, collar=collar), woman)]
    assert closed == [(closure, (0.0, 1.0))] * (2 if collar else 1)


@pytest.mark.parametrize("bottom", [None, "SkirtCircle"])
@pytest.mark.parametrize("closure", CLOSED)
@pytest.mark.parametrize("upper", ["Shirt", "FittedShirt"])
def test_the_opening_of_a_shirt_goes_through_its_waistband(
    woman: Measurements, upper: str, closure: Closure, bottom: str | None
) -> None:
    meta = {"upper": upper, "wb": "StraightWB", "bottom": bottom}
    pattern = draw_garment(woman, design_from_dict({"meta": meta, "front": {"closure": closure.value}}))
    [seam] = seams(pattern, "wb_front_right", "wb_front_left")
    assert (seam.closure, seam.closed) == (closure, (0.0, 1.0))
    above = {s.left.panel for s in pattern.seams if s.right.panel == "wb_front_left"}
    assert "left_ftorso" in above and "right_ftorso" not in above  # fronts and band open at one place
    assert not errors(pattern)
    assert sum(s.closure == closure for s in pattern.seams) == 2


def test_an_open_vest_has_two_edges_where_a_sewn_one_has_a_seam(woman: Measurements) -> None:
    opened, sewn = (build_box_mesh(draw_garment(woman, fronted(how)), spacing=2.0) for how in ("open", "sewn"))
    assert len(opened.uv) == len(sewn.uv)
    on_seam = len(opened.vertices) - len(sewn.vertices)
    front = lengths(draw_garment(woman, fronted("open")), "centre", ("right_ftorso",))
    assert on_seam == np.ceil(front / 2.0) + 1


def test_a_zip_is_open_at_the_neck_by_its_share(woman: Measurements) -> None:
    design = fronted("zip", open_top=0.25, open_hem=0.125, collar="Turtle")
    pattern = draw_garment(woman, design)
    front, collar = front_seams(design, woman)
    assert collar.closure is Closure.OPEN  # it is above the open part
    assert front.closed[1] - front.closed[0] == pytest.approx(0.625)
    mesh = build_box_mesh(pattern, spacing=1.0)
    closed = mesh.vertices[mesh.seams[mesh.seams[:, 1] == pattern.seams.index(front), 0], 1]
    panel = pattern.panel(front.left.panel)
    edge = panel.placement.apply(np.array(panel.edge_ends(front.left.edge)))[:, 1]
    assert edge.max() - closed.max() == pytest.approx(0.25 * np.ptp(edge), abs=0.5)
    assert closed.min() - edge.min() == pytest.approx(0.125 * np.ptp(edge), abs=0.5)


@pytest.mark.parametrize("upper", ["Shirt", "FittedShirt"])
@pytest.mark.parametrize("collar", [None, "Turtle", "SimpleLapel", "Hood2Panels"])
def test_fronts_with_buttons_overlap_by_the_stand(woman: Measurements, upper: str, collar: str | None) -> None:
    """Beside the extensions they are the fronts with a zip: neckline, hem and collar end at the centre front."""
    buttoned, zipped = (
        draw_garment(woman, fronted(how, upper=upper, collar=collar, stand=4.0)) for how in ("buttons", "zip")
    )
    for edge in ("bottom", "neck"):
        assert lengths(buttoned, edge, TORSOS) == pytest.approx(lengths(zipped, edge, TORSOS))
    right, left = (buttoned.panel(f"{side}_ftorso") for side in ("right", "left"))
    reach = [panel.placement.apply(panel.vertices)[:, 0] for panel in (right, left)]
    assert (reach[0].max(), reach[1].min()) == pytest.approx((2.0, -2.0))
    for panel in (right, left):
        [line] = panel.lines
        assert line.role is LineRole.PLACEMENT
        at = panel.placement.apply(np.array(panel.edge_ends(len(panel.edges))))
        assert at[:, 0] == pytest.approx([0.0, 0.0], abs=1e-9)
        assert np.ptp(at[:, 1]) == pytest.approx(sum(edge_lengths(zipped.panel(panel.name), "centre")))
    sewn = {ref for seam in buttoned.seams for ref in (seam.left, seam.right)}
    free = [edge.name for i, edge in enumerate(right.edges) if EdgeRef(right.name, i) not in sewn]
    assert free.count("extension") == 3


def test_the_upper_front_is_the_left_side_of_the_seam(woman: Measurements) -> None:
    for over in ("left", "right"):
        sewn = front_seams(fronted("buttons", over=over, collar="Turtle"), woman)
        assert [seam.left.panel for seam in sewn] == [f"{over}_ftorso", f"{over}_collar_front"]


def test_a_strapless_top_is_not_open(woman: Measurements) -> None:
    design = {"meta": {"upper": "FittedShirt"}, "shirt": {"strapless": True}, "front": {"closure": "open"}}
    with pytest.raises(PatternError, match=r"falls off: set front\.closure"):
        draw_garment(woman, design_from_dict(design))


def test_only_an_overlay_that_names_a_closure_draws_one() -> None:
    tops = {"meta": {"upper": {"options": ["Shirt", "FittedShirt"]}}}
    fronts = {"front": {"closure": {"options": ["open", "zip", "buttons"]}}}
    plain, closed = Overlay.from_dict(tops), Overlay.from_dict(tops | fronts)
    shut = Overlay.from_dict(tops | {"front": {"closure": "sewn"}})
    assert Overlay.from_dict(closed.to_dict()) == closed
    seen = set()
    for seed in range(24):
        sewn, drawn = (sample_design(np.random.default_rng(seed), overlay=overlay) for overlay in (plain, closed))
        assert "front" not in design_to_dict(sewn)
        assert sewn == sample_design(np.random.default_rng(seed), overlay=shut)
        if drawn.meta.upper:
            seen.add(drawn.front.closure)
            assert design_from_dict(design_to_dict(drawn)) == drawn
    assert seen == set(CLOSED)


def test_an_open_front_gives_way_where_a_zip_is_too_tight(woman: Measurements) -> None:
    narrow = {"meta": {"upper": "Shirt"}, "shirt": {"length": 2.0, "flare": 0.7, "width": 1.0}}
    opened, zipped = (design_from_dict(narrow | {"front": {"closure": closure}}) for closure in ("open", "zip"))
    rejected = try_on(woman, zipped)
    assert isinstance(rejected, Reject)
    assert rejected.rule == "too_tight"
    assert not isinstance(try_on(woman, opened), Reject)
