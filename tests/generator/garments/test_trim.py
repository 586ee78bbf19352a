"""Trim: pin tucks, and the placket of a front with buttons; and which data sets draw them."""

from typing import Any

import numpy as np
import pytest

from gcd_dataset.generator.garments import design_from_dict, design_to_dict, draw_garment, sample_design
from gcd_dataset.generator.garments.drawn import described, sides_match
from gcd_dataset.generator.garments.overlay import Overlay
from gcd_dataset.generator.mesh import build_box_mesh, coarse_start
from gcd_dataset.records import LineRole, Measurements, Pattern

SHIRT: dict[str, Any] = {"meta": {"upper": "Shirt"}}
TUCKS = SHIRT | {"trim": {"tucks": 4, "length": 1.0}}
PLACKET = SHIRT | {"front": {"closure": "buttons", "open_top": 0.2, "stand": 4.0}, "trim": {"buttonholes": 5}}


def lines(pattern: Pattern, panel: str, role: LineRole) -> np.ndarray:
    """Both ends of each line of a role in space, without the lines that are sewn."""
    own = pattern.panel(panel)
    sewn = {ref.edge for seam in pattern.seams for ref in (seam.left, seam.right) if ref.panel == panel}
    free = (i for i, line in enumerate(own.lines, len(own.edges)) if line.role == role and i not in sewn)
    return np.array([own.placement.apply(np.array(own.edge_ends(index))) for index in free])


def test_tucks_are_upright_lines_that_change_neither_outline_nor_seams(woman: Measurements) -> None:
    plain, tucked = (draw_garment(woman, design_from_dict(values)) for values in (SHIRT, TUCKS))
    assert tucked.seams == plain.seams
    for side, sign in (("right", -1.0), ("left", 1.0)):
        drawn = lines(tucked, f"{side}_ftorso", LineRole.STITCH)
        assert drawn.shape == (4, 2, 3)
        assert drawn[:, 0, 0] == pytest.approx(drawn[:, 1, 0])
        assert (sign * drawn[..., 0] > 0.0).all()
        own, edges = tucked.panel(f"{side}_ftorso"), plain.panel(f"{side}_ftorso")
        assert np.array_equal(own.vertices[: len(own.edges)], edges.vertices)
        hem = edges.placement.apply(edges.vertices)[:, 1].min()
        assert drawn[..., 1].min(axis=1) == pytest.approx(hem + 1.0)
    assert coarse_start(build_box_mesh(tucked, spacing=1.5)) is not None


def test_tucks_end_above_a_pocket_on_both_fronts(woman: Measurements) -> None:
    pattern = draw_garment(woman, design_from_dict(TUCKS | {"pocket": {"chest": "left"}}))
    pocket = pattern.panel("left_ftorso_pocket")
    top = pocket.placement.apply(pocket.vertices)[:, 1].max()
    for side in ("right", "left"):
        assert lines(pattern, f"{side}_ftorso", LineRole.STITCH)[..., 1].min() == pytest.approx(top + 1.0)


def test_buttonholes_lie_beside_the_closed_centre_of_the_upper_front(woman: Measurements) -> None:
    bare = draw_garment(woman, design_from_dict(PLACKET | {"trim": {}}))
    pattern = draw_garment(woman, design_from_dict(PLACKET))
    assert pattern.seams == bare.seams
    assert not len(lines(pattern, "right_ftorso", LineRole.PLACEMENT))
    holes, [fold] = (lines(pattern, "left_ftorso", role) for role in (LineRole.PLACEMENT, LineRole.FOLD))
    assert fold[:, 0] == pytest.approx(2.0)  # as far inside the centre front as half of the stand lies outside
    assert np.sort(holes[..., 0]) == pytest.approx(np.tile([0.5, 1.5], (5, 1)))
    panel = pattern.panel("left_ftorso")
    [centre] = [i for i, line in enumerate(panel.lines, len(panel.edges)) if line.name == "centre"]
    low, high = np.sort(panel.placement.apply(np.array(panel.edge_ends(centre)))[:, 1])
    spread = (high - holes[:, 0, 1]) / (high - low)
    assert np.sort(spread) == pytest.approx(0.2 + 0.8 * (np.arange(5) + 0.5) / 5)


def test_trim_has_words_and_leaves_a_shirt_symmetrical(woman: Measurements) -> None:
    design = design_from_dict(PLACKET | {"trim": {"tucks": 3, "buttonholes": 5}})
    pattern = draw_garment(woman, design)
    shirt, _ = described(woman, design, pattern)
    assert shirt is not None
    words = [detail.words[0] for detail in shirt.details[-2:]]
    assert words == ["six pin tucks on the front", "a placket with five buttonholes"]
    assert sides_match(shirt.details, pattern)


def test_trim_is_drawn_on_request_and_written_where_it_is_worn() -> None:
    asked = {"tucks": {"options": [2, 3]}, "buttonholes": {"options": [6]}}
    tops = {"meta": {"upper": {"options": ["Shirt", "FittedShirt"]}}, "trim": asked}
    overlay = Overlay.from_dict(tops | {"front": {"closure": {"options": ["sewn", "buttons"]}}})
    seen = set()
    for seed in range(12):
        design = sample_design(np.random.default_rng(seed), overlay=overlay)
        worn = design.worn_trim()
        seen.add((bool(worn.tucks), bool(worn.buttonholes)))
        assert ("trim" in design_to_dict(design)) == any((worn.tucks, worn.buttonholes))
        assert design_from_dict(design_to_dict(design)) == design
    assert {(True, True), (False, True)} <= seen
