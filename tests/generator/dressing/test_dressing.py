"""Dressing: placements and labels inferred for bare patterns agree with those in GarmentCode's own files."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from gcd_dataset.errors import PatternError
from gcd_dataset.generator.body import named_body
from gcd_dataset.generator.dressing import dress, has_legs
from gcd_dataset.generator.dressing.frame import wearer_of
from gcd_dataset.generator.dressing.hanging import hang_from_lay_plan
from gcd_dataset.generator.dressing.openings import openings_of
from gcd_dataset.generator.garments import design_from_dict, draw_garment
from gcd_dataset.records import Body, Edge, EdgeRef, Measurements, Panel, Pattern, Placement, Seam
from gcd_dataset.spec import pattern_from_spec, read_pattern, spec_from_pattern
from tests.generator.dressing.test_openings import rectangle, tube

DESIGNS = (
    "asymm_circle_skirt_lapel_dress", "asymmetric_top", "circle_skirt", "dress", "fitted_shirt", "godet_skirt",
    "jumpsuit", "levels_skirt", "pants_cuff", "pencil_skirt", "shirt_sleeves_hood", "strapless_dress",
)  # fmt: skip
UNPLACED = Placement(np.zeros(3), np.zeros(3))
HELD = ("left_collar", "right_collar", "strapless_top")


@pytest.fixture(scope="module")
def wearer() -> tuple[Body, Measurements]:
    return named_body("neutral")[:2]


def pattern_of(examples: Path, name: str) -> Pattern:
    return read_pattern(examples / "patterns" / name / "default_body" / f"{name}_specification.json")


def bare(panel: Panel, *, placed: bool = True) -> Panel:
    """A panel as in older files: without labels, and without a placement if not ``placed``."""
    edges = tuple(replace(edge, label="") for edge in panel.edges)
    return replace(panel, label="", edges=edges, placement=panel.placement if placed else UNPLACED)


def bared(pattern: Pattern, *, placed: bool = True) -> Pattern:
    return replace(pattern, panels=tuple(bare(panel, placed=placed) for panel in pattern.panels))


def labels(pattern: Pattern, *kinds: str) -> set[tuple[str, int, str]]:
    return {
        (panel.name, index, edge.label)
        for panel in pattern.panels
        for index, edge in enumerate(panel.edges)
        if edge.label in kinds
    }


def side(panel: Panel) -> tuple[bool, int]:
    """Whether a panel hangs in front, and its side: 1 left, -1 right, 0 in the middle."""
    x, _, z = panel.placement.apply(panel.vertices).mean(axis=0)
    return bool(z > 0), 0 if abs(x) < 5 else int(np.sign(x))


@pytest.mark.parametrize("name", DESIGNS)
def test_removed_labels_are_found_again(examples: Path, wearer: tuple[Body, Measurements], name: str) -> None:
    pattern = pattern_of(examples, name)
    dressed = dress(bared(pattern), *wearer).pattern
    assert [panel.label for panel in dressed.panels] == [panel.label for panel in pattern.panels]
    assert labels(dressed, *HELD) == labels(pattern, *HELD)
    if not labels(pattern, *HELD):
        assert labels(dressed, "lower_interface") == labels(pattern, "lower_interface")


@pytest.mark.parametrize("name", DESIGNS)
def test_panels_from_a_lay_plan_return_to_their_placement_or_are_refused(
    examples: Path, wearer: tuple[Body, Measurements], name: str
) -> None:
    """Seams alone do not determine the placement of four skirt panels round the body, nor of a hood."""
    pattern = pattern_of(examples, name)
    unplaced = bared(pattern, placed=False)
    if name in ("dress", "shirt_sleeves_hood"):
        with pytest.raises(PatternError, match=rf"{name}: its panels lie in one plane.*give each panel a translation"):
            dress(unplaced, *wearer)
        return
    dressed = dress(unplaced, *wearer)
    assert "lay in one plane" in dressed.assumed[0]
    for given, found in zip(map(side, pattern.panels), map(side, dressed.pattern.panels), strict=True):
        assert found[0] == given[0]
        assert found[1] * given[1] >= 0
    if name != "asymm_circle_skirt_lapel_dress":  # its lapels lie on the chest, and their rim looks like a neckline
        assert labels(dressed.pattern, *HELD) == labels(pattern, *HELD)


def test_a_complete_pattern_is_unchanged(examples: Path, wearer: tuple[Body, Measurements]) -> None:
    pattern = pattern_of(examples, "fitted_shirt")
    assert dress(pattern, *wearer) == dress(pattern, *wearer)
    assert dress(pattern, *wearer).pattern == pattern
    assert dress(pattern, *wearer).assumed == ()


def test_panels_in_the_body_are_moved_out_of_it(wearer: tuple[Body, Measurements]) -> None:
    near = tube(50.0, 40.0, y=wearer[1].waist_level - 40.0)
    inside = replace(
        near, panels=tuple(_at_depth(panel, 0.1 * panel.placement.translation[2]) for panel in near.panels)
    )
    dressed = dress(inside, *wearer)
    depths = {panel.name: panel.placement.translation[2] for panel in dressed.pattern.panels}
    assert depths["front"] > 10.0 > -10.0 > depths["back"]
    assert sum("inside the body: moved out" in sentence for sentence in dressed.assumed) == 2
    assert labels(dressed.pattern, "lower_interface") == {
        ("front", 2, "lower_interface"),
        ("back", 1, "lower_interface"),
    }


def test_a_garment_over_the_head_comes_down_to_the_waist(wearer: tuple[Body, Measurements]) -> None:
    dressed = dress(tube(50.0, 40.0, y=200.0), *wearer)
    top = max(panel.placement.apply(panel.vertices)[:, 1].max() for panel in dressed.pattern.panels)
    assert top == pytest.approx(wearer[1].waist_level)
    assert "top edge hung 240 cm high" in dressed.assumed[0]


def test_a_panel_without_seams_is_refused_by_name(wearer: tuple[Body, Measurements]) -> None:
    pair = (replace(rectangle("one", 50.0, 40.0, z=0.0), name="one"), rectangle("two", 50.0, 40.0, z=0.0))
    with pytest.raises(PatternError, match=r"no seam joins (one|two) to the rest"):
        dress(Pattern("pair", pair, ()), *wearer)


def test_a_lone_panel_gets_no_held_edge(wearer: tuple[Body, Measurements]) -> None:
    cloth = Pattern("cloth", (rectangle("cloth", 50.0, 40.0, z=30.0, y=100.0),), ())
    dressed = dress(cloth, *wearer)
    assert any("hold" in sentence for sentence in dressed.assumed)


def test_trousers_are_recognised_by_their_openings(examples: Path) -> None:
    for name in DESIGNS:
        spec = spec_from_pattern(pattern_of(examples, name))
        text = {f"piece_{i}": panel for i, panel in enumerate(spec["pattern"]["panels"])}
        renamed = {old: new for new, old in text.items()}
        spec["pattern"]["panels"] = {renamed[old]: panel for old, panel in spec["pattern"]["panels"].items()}
        spec["pattern"]["panel_order"] = [renamed[old] for old in spec["pattern"]["panel_order"]]
        for stitch in spec["pattern"]["stitches"]:
            for ref in stitch[:2]:
                ref["panel"] = renamed[ref["panel"]]
        assert has_legs(pattern_from_spec(spec, name)) is (name in ("jumpsuit", "pants_cuff"))


def test_a_skirt_with_panels_centred_about_a_seam_is_placed(wearer: tuple[Body, Measurements]) -> None:
    """The outer panels of the skirt are taken for sleeves with the zero vector as direction."""
    section = {"suns": 0.5, "length": 0.5, "skirt-many-panels": {"n_panels": 13}}
    design = design_from_dict({"meta": {"upper": None, "bottom": "SkirtManyPanels"}, "flare-skirt": section})
    skirt = bared(draw_garment(wearer[1], design), placed=False)
    assert np.isfinite([panel.placement.translation for panel in dress(skirt, *wearer).pattern.panels]).all()


def _at_depth(panel: Panel, z: float) -> Panel:
    x, y, _ = panel.placement.translation
    return replace(panel, placement=Placement(np.array([x, y, z]), panel.placement.rotation))


def test_a_net_of_a_hundred_openings_is_placed(wearer: tuple[Body, Measurements]) -> None:
    """A hundred strips in a row, each sewn to the next above and below a slit."""
    corners = np.array([[0, 0], [1, 0], [1, 4], [1, 6], [1, 10], [0, 10], [0, 6], [0, 4]], float)
    edges = tuple(Edge(i, (i + 1) % 8) for i in range(8))
    panels = tuple(Panel(f"strip_{i}", corners, edges, UNPLACED) for i in range(100))
    seams = tuple(
        Seam(EdgeRef(f"strip_{i}", right), EdgeRef(f"strip_{i + 1}", left))
        for i in range(99)
        for right, left in ((1, 7), (3, 5))
    )
    net = Pattern("net", panels, seams)
    hung, _ = hang_from_lay_plan(net, wearer_of(*wearer))
    assert len(openings_of(hung)) > 90
    places = np.concatenate([panel.placement.apply(panel.vertices) for panel in hung.panels])
    assert np.isfinite(places).all()
