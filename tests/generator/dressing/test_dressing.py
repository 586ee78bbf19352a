"""Dressing: placements, labels, frames and openings inferred for bare patterns, and sleeves turned to other arms."""

from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from benchmarks.draping.other_bodies import OTHER_BODIES
from gcd_dataset.errors import PatternError
from gcd_dataset.generator.dressing import Dressing, dress, has_legs
from gcd_dataset.generator.dressing.frame import Wearer, in_body_frame, moved, placed_outline, wearer_of
from gcd_dataset.generator.dressing.hanging import hang_from_lay_plan
from gcd_dataset.generator.dressing.openings import openings_of, panel_outline
from gcd_dataset.generator.garments import design_from_dict, draw_garment
from gcd_dataset.generator.pipeline import prepare
from gcd_dataset.generator.recipe import MakeConfig
from gcd_dataset.records import Body, BodyPart, Closure, Edge, EdgeRef, Panel, PanelRole, Pattern, Placement, Seam
from gcd_dataset.spec import read_pattern
from tests.generator.drape.garments import neutral
from tests.generator.garments.measured import EXAMPLES
from tests.helpers import renamed

UNPLACED = Placement(np.zeros(3), np.zeros(3))
HELD = ("left_collar", "right_collar", "strapless_top")


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


@pytest.mark.parametrize("name", EXAMPLES)
def test_removed_labels_are_found_again(examples: Path, name: str) -> None:
    pattern = pattern_of(examples, name)
    dressed = dress(bared(pattern), *neutral()).pattern
    assert [panel.label for panel in dressed.panels] == [panel.label for panel in pattern.panels]
    assert labels(dressed, *HELD) == labels(pattern, *HELD)
    if not labels(pattern, *HELD):
        assert labels(dressed, "lower_interface") == labels(pattern, "lower_interface")


@pytest.mark.parametrize("name", EXAMPLES)
def test_panels_from_a_lay_plan_return_to_their_placement_or_are_refused(examples: Path, name: str) -> None:
    """Seams alone do not determine the placement of four skirt panels round the body, nor of a hood."""
    pattern = pattern_of(examples, name)
    unplaced = bared(pattern, placed=False)
    if name in ("dress", "shirt_sleeves_hood"):
        with pytest.raises(PatternError, match=rf"{name}: its panels lie in one plane.*give each panel a translation"):
            dress(unplaced, *neutral())
        return
    dressed = dress(unplaced, *neutral())
    assert "lay in one plane" in dressed.assumed[0]
    for given, found in zip(map(side, pattern.panels), map(side, dressed.pattern.panels), strict=True):
        assert found[0] == given[0]
        assert found[1] * given[1] >= 0
    if name != "asymm_circle_skirt_lapel_dress":  # its lapels lie on the chest, and their rim looks like a neckline
        assert labels(dressed.pattern, *HELD) == labels(pattern, *HELD)


def test_a_complete_pattern_is_unchanged(examples: Path) -> None:
    pattern = pattern_of(examples, "fitted_shirt")
    assert dress(pattern, *neutral()) == Dressing(pattern, assumed=())


def test_panels_in_the_body_are_moved_out_of_it() -> None:
    near = tube(50.0, 40.0, y=neutral()[1].waist_level - 40.0)
    inside = replace(near, panels=tuple(moved(p, p.placement.translation * [0, 0, -0.9]) for p in near.panels))
    dressed = dress(inside, *neutral())
    depths = {panel.name: panel.placement.translation[2] for panel in dressed.pattern.panels}
    assert depths["front"] > 10.0 > -10.0 > depths["back"]
    assert sum("inside the body: moved out" in sentence for sentence in dressed.assumed) == 2
    assert labels(dressed.pattern, "lower_interface") == {
        ("front", 2, "lower_interface"),
        ("back", 1, "lower_interface"),
    }


def test_a_garment_over_the_head_comes_down_to_the_waist() -> None:
    dressed = dress(tube(50.0, 40.0, y=200.0), *neutral())
    top = max(panel.placement.apply(panel.vertices)[:, 1].max() for panel in dressed.pattern.panels)
    assert top == pytest.approx(neutral()[1].waist_level)
    assert "top edge hung 240 cm high" in dressed.assumed[0]


def test_a_panel_without_seams_is_refused_by_name_unless_it_is_alone() -> None:
    pair = (rectangle("one", 50.0, 40.0, z=0.0), rectangle("two", 50.0, 40.0, z=0.0))
    with pytest.raises(PatternError, match=r"no seam joins (one|two) to the rest"):
        dress(Pattern("pair", pair, ()), *neutral())
    dressed = dress(Pattern("cloth", (rectangle("cloth", 50.0, 40.0, z=30.0, y=100.0),), ()), *neutral())
    assert any("hold" in sentence for sentence in dressed.assumed)


def test_trousers_are_recognised_by_their_openings(examples: Path) -> None:
    for name in EXAMPLES:
        assert has_legs(nameless(pattern_of(examples, name))) is (name in ("jumpsuit", "pants_cuff"))


def test_a_skirt_with_panels_centred_about_a_seam_is_placed() -> None:
    """The outer panels of the skirt are taken for sleeves with the zero vector as direction."""
    section = {"suns": 0.5, "length": 0.5, "skirt-many-panels": {"n_panels": 13}}
    design = design_from_dict({"meta": {"upper": None, "bottom": "SkirtManyPanels"}, "flare-skirt": section})
    skirt = bared(draw_garment(neutral()[1], design), placed=False)
    assert np.isfinite([panel.placement.translation for panel in dress(skirt, *neutral()).pattern.panels]).all()


def test_a_net_of_forty_openings_is_placed() -> None:
    """Forty strips in a row, each sewn to the next above and below a slit."""
    corners = np.array([[0, 0], [1, 0], [1, 4], [1, 6], [1, 10], [0, 10], [0, 6], [0, 4]], float)
    edges = tuple(Edge(i, (i + 1) % 8) for i in range(8))
    panels = tuple(Panel(f"strip_{i}", corners, edges, UNPLACED) for i in range(40))
    seams = tuple(
        Seam(EdgeRef(f"strip_{i}", right), EdgeRef(f"strip_{i + 1}", left))
        for i in range(39)
        for right, left in ((1, 7), (3, 5))
    )
    hung, _ = hang_from_lay_plan(Pattern("net", panels, seams), wearer_of(*neutral()))
    assert len(openings_of(hung)) > 35
    places = np.concatenate([panel.placement.apply(panel.vertices) for panel in hung.panels])
    assert np.isfinite(places).all()


def rectangle(name: str, wide: float, tall: float, *, z: float, y: float = 0.0, back: bool = False) -> Panel:
    """A panel in the plane ``z``; its edges are bottom, right, top, left as seen from the front."""
    corners = np.array([[-wide / 2, 0], [wide / 2, 0], [wide / 2, tall], [-wide / 2, tall]], float)
    loop = [(0, 1), (1, 2), (2, 3), (3, 0)]
    edges = tuple(Edge(b, a) for a, b in reversed(loop)) if back else tuple(Edge(a, b) for a, b in loop)
    return Panel(name, corners, edges, Placement(np.array([0.0, y, z]), np.zeros(3)))


def tube(wide: float, tall: float, *, y: float = 0.0) -> Pattern:
    """Two rectangles sewn at their sides; the back's edges are left, top, right, bottom."""
    front, back = rectangle("front", wide, tall, z=20.0, y=y), rectangle("back", wide, tall, z=-20.0, y=y, back=True)
    seams = (Seam(EdgeRef("front", 1), EdgeRef("back", 2)), Seam(EdgeRef("front", 3), EdgeRef("back", 0)))
    return Pattern("tube", (front, back), seams)


def test_openings_of_a_tube_a_bag_and_a_lone_panel() -> None:
    top, bottom = openings_of(tube(50.0, 30.0, y=60.0))
    assert {ref.edge for ref in top.edges if ref.panel == "front"} == {2}
    assert [top.length, bottom.length] == pytest.approx([100.0, 100.0])
    assert np.allclose(top.centre, [0.0, 90.0, 0.0])
    assert np.allclose(bottom.centre, [0.0, 60.0, 0.0])
    pattern = tube(50.0, 30.0)
    bag = replace(pattern, seams=(*pattern.seams, Seam(EdgeRef("front", 0), EdgeRef("back", 3))))
    assert len(openings_of(bag)) == 1
    [outline] = openings_of(Pattern("cloth", pattern.panels[:1], ()))
    assert outline.length == pytest.approx(2 * (50.0 + 30.0))
    assert len(outline.edges) == 4


def test_an_open_seam_joins_the_openings_at_its_ends() -> None:
    """As the front of a cardigan, from neck to hem: one opening, with both edges of the seam in it."""
    pattern = tube(50.0, 30.0)
    seams = (replace(pattern.seams[0], closure=Closure.OPEN), pattern.seams[1])
    [round_all] = openings_of(replace(pattern, seams=seams))
    assert round_all.length == pytest.approx(2 * 100.0 + 2 * 30.0)


def test_the_fronts_of_an_open_vest_are_no_neckline() -> None:
    design = design_from_dict({"meta": {"upper": "Shirt"}, "front": {"closure": "open"}})
    pattern = draw_garment(neutral()[1], design)
    found = dress(bared(pattern), *neutral()).pattern
    collars = {name for panel, _, name in labels(found, "left_collar", "right_collar")}
    assert labels(found, "left_collar", "right_collar") == labels(pattern, "left_collar", "right_collar")
    assert collars == {"left_collar", "right_collar"}


def test_the_fronts_of_a_buttoned_shirt_are_joined_and_hung_along_their_lines() -> None:
    """Never placed and without labels, its fronts are hung as those with a zip, and overlap by the stand."""
    overlaps = []
    for closure in ("zip", "buttons"):
        design = design_from_dict({"meta": {"upper": "Shirt"}, "front": {"closure": closure, "stand": 4.0}})
        hung = dress(bared(draw_garment(neutral()[1], design), placed=False), *neutral()).pattern
        right, left = (placed_outline(hung.panel(f"{side}_ftorso")) for side in ("right", "left"))
        overlaps.append(right[:, 0].max() - left[:, 0].min())
        assert right[:, 2] == pytest.approx(left[0, 2])
    assert overlaps[1] - overlaps[0] == pytest.approx(4.0, abs=0.1)
    assert len(openings_of(draw_garment(neutral()[1], design))) == 3  # two armholes; neckline, fronts and hem in one


def test_a_seam_of_right_to_wrong_side_reverses_the_walk() -> None:
    """A ribbon sewn to itself with a half twist has one edge, a plain ring two."""
    ribbon = rectangle("ribbon", 40.0, 5.0, z=0.0)
    ends = (EdgeRef("ribbon", 1), EdgeRef("ribbon", 3))
    assert len(openings_of(Pattern("ring", (ribbon,), (Seam(*ends),)))) == 2
    assert len(openings_of(Pattern("moebius", (ribbon,), (Seam(*ends, right_wrong=True),)))) == 1


Form = Callable[[Pattern], Pattern]
KINDS = 8  # designs: dresses, tops, hoods, skirts, trousers and jumpsuits


def shifted(pattern: Pattern, *by: float) -> Pattern:
    return replace(pattern, panels=tuple(moved(panel, np.array(by)) for panel in pattern.panels))


def numbered(pattern: Pattern, prefix: str) -> Pattern:
    return renamed(pattern, {panel.name: f"{prefix}_{number}" for number, panel in enumerate(pattern.panels)})


def nameless(pattern: Pattern) -> Pattern:
    return numbered(bared(pattern), "piece")


@pytest.fixture(scope="module")
def worn() -> list[tuple[Pattern, Wearer]]:
    """Sampled garments on the bodies that they are drawn for, women and men, small and tall."""
    config = MakeConfig(stage="pattern", bodies="random")
    dressed = [one for number in range(KINDS) for one in prepare(3, number, config).dressed]
    return [(one.pattern, wearer_of(one.body, one.size)) for one in dressed]


@pytest.mark.parametrize(
    "form", [lambda pattern: pattern, bared, nameless], ids=["labelled", "without_labels", "nameless"]
)
def test_garments_that_are_placed_on_the_body_stay(worn: list[tuple[Pattern, Wearer]], form: Form) -> None:
    for pattern, wearer in worn:
        assert in_body_frame(form(pattern), wearer) == (form(pattern), ())


@pytest.mark.parametrize("by", [(0, -85, 0), (0, 55, 0), (0, -110, -150)])
@pytest.mark.parametrize("form", [lambda pattern: pattern, bared], ids=["labelled", "without_labels"])
def test_a_frame_at_the_pelvis_at_the_neck_or_beside_the_body_is_recognised(
    worn: list[tuple[Pattern, Wearer]], form: Form, by: tuple[float, ...]
) -> None:
    """Each garment returns to within 10 cm of its place."""
    for pattern, wearer in worn:
        found, sentences = in_body_frame(shifted(form(pattern), *by), wearer)
        assert "moved" in sentences[0]
        for panel, placed in zip(found.panels, pattern.panels, strict=True):
            assert panel.placement.translation == pytest.approx(placed.placement.translation, abs=10.0)


def side_by_side(pattern: Pattern) -> Pattern:
    """One for each leg."""
    right, left = (numbered(shifted(pattern, x, 0, 0), side) for x, side in ((-10.0, "right"), (10.0, "left")))
    return Pattern("pair", right.panels + left.panels, right.seams + left.seams)


def test_garments_of_other_kinds_stay_where_they_are() -> None:
    wearer = wearer_of(*neutral())
    kinds = {
        "low skirt": tube(48.0, 25.0, y=wearer.hips - 26.0),
        "high skirt": tube(40.0, 60.0, y=wearer.waist - 46.0),
        "gown with a train": tube(46.0, 190.0, y=wearer.armpit - 190.0),
        "hat": tube(29.0, 18.0, y=wearer.nape + 8.0),
        "leg warmers": side_by_side(tube(18.0, 35.0, y=10.0)),
        "apron": Pattern("apron", (rectangle("apron", 60.0, 90.0, z=22.0, y=45.0),), ()),
    }
    assert [kind for kind, pattern in kinds.items() if in_body_frame(pattern, wearer)[1]] == []


def test_the_sentence_tells_edge_heights_and_shift() -> None:
    wearer = wearer_of(*neutral())
    skirt = tube(50.0, 40.0, y=wearer.waist - 140.0)
    found, [sentence] = in_body_frame(shifted(skirt, 0, 0, 100.0), wearer)
    top = max(float(placed_outline(panel)[:, 1].max()) for panel in found.panels)
    assert top == pytest.approx(wearer.waist)
    assert f"hung {wearer.waist - 100:.0f} cm high, and is worn at {wearer.waist:.0f} cm" in sentence
    assert "moved 100 cm up and" in sentence


@cache
def shirt() -> Pattern:
    """A shirt with sleeves, placed round the arms of the A-pose."""
    design = {"meta": {"upper": "Shirt"}, "sleeve": {"sleeveless": False, "length": 0.8}}
    return draw_garment(neutral()[1], design_from_dict(design))


def sleeve_middle(pattern: Pattern) -> np.ndarray:
    """The centroid of the left sleeve's outlines [cm]."""
    middles = [p.placement.apply(panel_outline(p)).mean(axis=0) for p in pattern.panels if p.label == PanelRole.ARM]
    return np.mean([middle for middle in middles if middle[0] > 0], axis=0)


def off_axis(pattern: Pattern, body: Body) -> float:
    """Distance of the left sleeve's middle from the axis of the left arm [cm]."""
    arm = body.vertices[body.parts == BodyPart.LEFT_ARM.value]
    axis = np.linalg.svd(arm - arm.mean(axis=0), full_matrices=False)[2][0]
    offset = sleeve_middle(pattern) - arm.mean(axis=0)
    return float(np.linalg.norm(offset - (offset @ axis) * axis))


@pytest.mark.parametrize("pose", ["t_pose", "arms_forward"])
def test_sleeves_of_the_a_pose_are_turned_to_other_arms(pose: str) -> None:
    body = OTHER_BODIES[pose]().body
    assert off_axis(shirt(), body) > 12.0
    dressing = dress(shirt(), body, neutral()[1])
    assert off_axis(dressing.pattern, body) < 6.0
    assert sum("sleeve points" in sentence and "turned to it" in sentence for sentence in dressing.assumed) == 2


def test_turned_sleeves_keep_their_shape_and_stay_mirror_images() -> None:
    turned = dress(shirt(), OTHER_BODIES["arms_forward"]().body, neutral()[1]).pattern
    for before, after in zip(shirt().panels, turned.panels, strict=True):
        assert np.array_equal(before.vertices, after.vertices)
    middles = [p.placement.apply(panel_outline(p)).mean(axis=0) for p in turned.panels if p.label == PanelRole.ARM]
    assert np.sum(middles, axis=0)[0] == pytest.approx(0.0, abs=0.5)


def test_sleeves_on_the_arms_stay() -> None:
    body, size = neutral()
    dressing = dress(shirt(), body, size)
    assert sleeve_middle(dressing.pattern) == pytest.approx(sleeve_middle(shirt()))
    assert not any("sleeve points" in sentence for sentence in dressing.assumed)


@pytest.mark.parametrize("name", ["arms_up", "legs_wide", "arms_forward"])
def test_posed_bodies_have_the_measures_of_the_a_pose(name: str) -> None:
    _, size = neutral()
    posed = OTHER_BODIES[name]().size.to_file_values()
    expected = size.to_file_values()
    for measure_name in ("shoulder_w", "arm_length", "bust", "hips", "leg_circ"):
        assert posed[measure_name] == pytest.approx(expected[measure_name], rel=0.01), measure_name
