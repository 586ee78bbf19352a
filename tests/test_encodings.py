"""Patterns survive the encodings of published models, up to what each says that it does not hold."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from math import pi
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from gcd_dataset.curves import LINE, Arc, Cubic, Curve, Quadratic, curve_length, sample_curve
from gcd_dataset.encodings import aipparel, garmentdiffusion, neuraltailor, sewformer, sewingldm
from gcd_dataset.encodings.rows import Scaling, arc_through, middle_of, pair_edges, seam_tags, top_of
from gcd_dataset.errors import PatternError
from gcd_dataset.generator.maker import make
from gcd_dataset.generator.recipe import MakeConfig
from gcd_dataset.records import Edge, EdgeRef, EdgeRole, Panel, Pattern, Placement, Seam
from gcd_dataset.spec import read_pattern

CONFIG = MakeConfig(bodies="neutral", stage="pattern")
ROOM: dict[str, Any] = {"max_panels": 40, "max_edges": 40}
ALL_EDGES = 1e-6  # cm


@dataclass(frozen=True)
class Encoding:
    again: Callable[[Pattern], Pattern]
    """Encode and decode."""
    exact: tuple[type, ...]
    """Kinds of curve that it holds."""
    turned: bool = False
    """Whether it holds ``right_wrong``."""


ENCODINGS = {
    "neuraltailor": Encoding(
        lambda p: neuraltailor.decode(neuraltailor.encode(p, **ROOM), padding=ALL_EDGES), (Quadratic,)
    ),
    "sewformer": Encoding(lambda p: sewformer.decode(sewformer.encode(p, **ROOM), padding=ALL_EDGES), (Quadratic,)),
    "sewformer_7": Encoding(
        lambda p: sewformer.decode(sewformer.encode(p, numbers=7, **ROOM)), (Quadratic, Cubic, Arc)
    ),
    "sewingldm": Encoding(
        lambda p: sewingldm.decode(sewingldm.encode(p, **ROOM)), (Quadratic, Cubic, Arc), turned=True
    ),
    "garmentdiffusion": Encoding(
        lambda p: garmentdiffusion.decode(garmentdiffusion.encode(p, **ROOM)), (Quadratic, Cubic, Arc)
    ),
    "aipparel": Encoding(lambda p: aipparel.decode(aipparel.encode(p)), (Quadratic, Cubic, Arc)),
}


def outline(panel: Panel) -> np.ndarray:
    """Points of the placed outline [cm]."""
    pieces = [sample_curve(*panel.edge_ends(i), edge.curve, 9)[:-1] for i, edge in enumerate(panel.edges)]
    return panel.placement.apply(np.concatenate(pieces))


def sewn(pattern: Pattern) -> set[frozenset[tuple[int, int]]]:
    """Seams by places of panels."""
    place = {panel.name: number for number, panel in enumerate(pattern.panels)}
    return {frozenset((place[ref.panel], ref.edge) for ref in (s.left, s.right)) for s in pattern.seams}


def without(pattern: Pattern, held: tuple[type, ...]) -> Pattern:
    """The pattern with straight edges in place of curves that are not held."""

    def straightened(panel: Panel) -> Panel:
        edges = tuple(e if isinstance(e.curve, (*held, type(LINE))) else replace(e, curve=LINE) for e in panel.edges)
        return replace(panel, edges=edges)

    return replace(pattern, panels=tuple(map(straightened, pattern.panels)))


def in_slots(pattern: Pattern) -> Pattern:
    """The pattern with its panels in the order of SewingLDM's slots."""
    slots = sewingldm.panel_slots([panel.name for panel in pattern.panels], 40)
    order = sorted(range(len(slots)), key=lambda i: slots[i])
    return replace(pattern, panels=tuple(pattern.panels[i] for i in order))


def assert_same(found: Pattern, pattern: Pattern, tolerance: float = 1e-6) -> None:
    assert [len(p.edges) for p in found.panels] == [len(p.edges) for p in pattern.panels]
    for ours, theirs in zip(found.panels, pattern.panels, strict=True):
        np.testing.assert_allclose(outline(ours), outline(theirs), atol=tolerance, err_msg=theirs.name)
    assert sewn(found) == sewn(pattern)


@pytest.fixture(scope="module")
def sampled() -> list[Pattern]:
    return [make(11, index, CONFIG).pattern for index in range(6)]


@pytest.mark.parametrize("name", ENCODINGS)
def test_sampled_patterns_survive(name: str, sampled: list[Pattern]) -> None:
    encoding = ENCODINGS[name]
    for pattern in sampled:
        true = without(pattern, encoding.exact)
        assert_same(encoding.again(true), in_slots(true) if name == "sewingldm" else true)


@pytest.mark.parametrize("name", ENCODINGS)
def test_real_patterns_survive(name: str, examples: Path) -> None:
    encoding = ENCODINGS[name]
    for kind in ("fitted_shirt", "godet_skirt", "jumpsuit", "levels_skirt", "asymm_circle_skirt_lapel_dress"):
        path = next((examples / "patterns" / kind / "default_body").glob("*_specification.json"))
        true = without(read_pattern(path), encoding.exact)
        # SewingLDM stores the radius of a nearly straight arc as 950 cm.
        tolerance = 0.05 if name == "sewingldm" else 1e-6
        assert_same(encoding.again(true), in_slots(true) if name == "sewingldm" else true, tolerance)


# --------------------------------------------------------------------------------------------------------- small cases


def square(name: str = "front", curve: Curve = LINE, label: EdgeRole | str = "") -> Panel:
    corners = np.array([[2.0, 1.0], [12.0, 1.0], [12.0, 11.0], [2.0, 11.0]])
    edges = tuple(Edge(i, (i + 1) % 4, *((curve, label) if i == 0 else ())) for i in range(4))
    return Panel(name, corners, edges, Placement(np.array([1.0, 100.0, 12.0]), np.array([0.1, 0.4, -0.2])))


def pair(curve: Curve = LINE, *, right_wrong: bool = False) -> Pattern:
    front, back = square("front", curve), square("back")
    back = replace(back, placement=Placement(np.array([-1.0, 100.0, -12.0]), np.array([0.0, pi - 0.1, 0.0])))
    return Pattern("napkins", (front, back), (Seam(EdgeRef("front", 1), EdgeRef("back", 3), right_wrong),))


finite = st.floats(-0.9, 0.9, allow_nan=False)
curves = st.one_of(
    st.builds(Quadratic, st.tuples(finite, finite.filter(lambda b: abs(b) > 0.05))),
    st.builds(Cubic, st.tuples(finite, finite), st.tuples(finite, finite.filter(lambda b: abs(b) > 0.05))),
    st.builds(Arc, st.floats(5.01, 200.0), st.booleans(), st.booleans()),
)


@given(curve=curves)
@pytest.mark.parametrize("name", ENCODINGS)
def test_any_curve_survives_or_keeps_its_ends_and_middle(name: str, curve: Curve) -> None:
    pattern = pair(curve)
    assume(abs(middle_of((0.0, 0.0), (1.0, 0.0), curve)[1]) > 1e-3)  # with its middle on the chord it is straight
    found = ENCODINGS[name].again(pattern)
    if isinstance(curve, ENCODINGS[name].exact):
        assert_same(found, in_slots(pattern) if name == "sewingldm" else pattern, 1e-5)
        return
    np.testing.assert_allclose(sample_middle(found.panels[0]), sample_middle(pattern.panels[0]), atol=1e-6)


def sample_middle(panel: Panel) -> np.ndarray:
    start, end = panel.edge_ends(0)
    a, b = middle_of(start, end, panel.edges[0].curve)
    step = np.subtract(end, start)
    return panel.placement.apply(start + a * step + b * np.array([-step[1], step[0]]))


def test_neuraltailor_holds_a_square_by_hand() -> None:
    arrays = neuraltailor.encode(pair(Quadratic((0.5, 0.2))))
    assert arrays.outlines.shape == (23, 14, 4)
    expected: list[list[float]] = [[10, 0, 0.5, 0.2], [0, 10, 0, 0], [-10, 0, 0, 0], [0, -10, 0, 0]]
    np.testing.assert_allclose(arrays.outlines[0, :4], expected, atol=1e-12)
    assert not arrays.outlines[0, 4:].any() and not arrays.outlines[2:].any()
    panel = pair().panels[0]
    np.testing.assert_allclose(arrays.translations[0], panel.placement.apply(np.array([7.0, 11.0])))
    # w of Rz Ry Rx: the product of the half angles' cosines plus that of their sines.
    c, s = np.cos([0.05, 0.2, -0.1]), np.sin([0.05, 0.2, -0.1])
    assert arrays.rotations[0, 3] == pytest.approx(c.prod() + s.prod())
    assert (arrays.free_edges < 0).sum() == 2
    np.testing.assert_allclose(arrays.stitch_tags[0, 1], seam_tags(pair())[0])
    np.testing.assert_allclose(arrays.stitch_tags[1, 3], seam_tags(pair())[0])


def test_neuraltailor_takes_short_edges_for_padding() -> None:
    corners = np.array([[0.0, 0.0], [10.0, 0.0], [10.0, 9.0], [9.0, 10.0], [0.0, 10.0]])
    edges = tuple(Edge(i, (i + 1) % 5) for i in range(5))
    cut = Panel("cut", corners, edges, Placement(np.zeros(3), np.zeros(3)))
    found = neuraltailor.decode(neuraltailor.encode(Pattern("", (cut,), (Seam(EdgeRef("cut", 2), EdgeRef("cut", 0)),))))
    assert len(found.panels[0].edges) == 4  # the gap of 1 cm in x and y is closed
    assert not found.seams  # one of its edges is gone


def test_a_wide_gap_takes_one_more_edge() -> None:
    arrays = neuraltailor.encode(Pattern("", (square(),), ()))
    outlines = arrays.outlines.copy()
    outlines[0, 3] = [0.0, -5.0, 0.0, 0.0]
    found = neuraltailor.decode(replace(arrays, outlines=outlines), names=["front"])
    assert found.panels[0].name == "front"
    assert [edge.end for edge in found.panels[0].edges] == [1, 2, 3, 4, 0]


def test_the_nearest_tags_are_paired_first_and_an_odd_edge_is_left_out() -> None:
    # Edges at 0, 1, 1.4 and 9 on a line: 1 and 1.4 are nearest, which leaves 0 to 9; the free edge at 0.1 is no edge.
    at = np.array([0.0, 1.0, 1.4, 9.0, 0.1])
    distances = np.abs(at[:, None] - at[None])
    free = np.array([False, False, False, False, True])
    assert pair_edges(distances, free, np.zeros(5)) == [(1, 2), (0, 3)]
    likeliest = np.array([-3.0, -2.0, -0.1, -2.0, 1.0])
    free[1] = True
    assert pair_edges(distances, free, likeliest) == [(0, 3)]


def test_sewformer_pairs_the_most_similar_edges_that_are_sewn() -> None:
    arrays = sewformer.encode(pair(), max_panels=2, max_edges=4)
    similarity = arrays.edge_similarity.copy()
    similarity[1, 5] = similarity[5, 1] = 9.0  # edge 5 has no seam
    found = sewformer.decode(replace(arrays, edge_similarity=similarity))
    assert sewn(found) == {frozenset({(0, 1), (1, 3)})}


def test_sewingldm_holds_labels_seams_turned_over_and_arcs() -> None:
    pattern = pair(Arc(7.0, True, False), right_wrong=True)
    labelled = replace(
        pattern, panels=(square("front", Arc(7.0, True, False), EdgeRole.LEFT_COLLAR), pattern.panels[1])
    )
    array = sewingldm.encode(labelled)
    assert array.shape == (39, 37, 29)
    found = sewingldm.decode(array, names=sewingldm.SLOT_NAMES)
    assert found.seams[0].right_wrong
    assert found.panels[0].edges[0].label == EdgeRole.LEFT_COLLAR
    assert found.panels[0].edges[0].curve == Arc(7.0, True, False)


def test_sewingldm_has_a_slot_for_each_panel_of_garmentcode() -> None:
    assert len(sewingldm.SLOT_NAMES) == 39 == len(set(sewingldm.SLOT_NAMES))
    assert sewingldm.PANEL_SLOTS["pant_b_l"] == sewingldm.PANEL_SLOTS["skirt_back"] == 25
    assert sewingldm.panel_slots(["skirt_back", "pant_b_l", "sporran"], 39) == [25, 0, 1]


def test_garmentdiffusion_holds_points_in_space() -> None:
    pattern = pair(Quadratic((0.5, 0.3)))
    array = garmentdiffusion.encode(pattern)
    assert array.shape == (37, 39, 16)
    place = pattern.panels[0].placement
    np.testing.assert_allclose(array[0, 0, :3], place.apply(np.array([2.0, 1.0])))
    np.testing.assert_allclose(array[0, 0, 3:6], place.apply(np.array([2.0 + 10 / 3, 3.0])))
    assert not array[0, 1, 3:9].any()
    assert array[0, 1, 15] == 1.0


def test_aipparel_writes_these_tokens() -> None:
    garment = aipparel.encode(Pattern("", (square("wb_front", Arc(10.0, False, True)),), ()))
    assert garment.tokens[:6] == (
        "<pattern_start>", "<panel_start>", "wb_front", "<pattern_cmd_MOVE>", "<pattern_cmd_ARC>", "<stitch_tag_null>"
    )  # fmt: skip
    assert garment.tokens[-4:] == ("<pattern_cmd_CLINE>", "<stitch_tag_null>", "<panel_end>", "<pattern_end>")
    # The arc of radius 10 over a chord of 10 bulges by 10 - √75 to the right, downwards.
    np.testing.assert_allclose(garment.values["<pattern_cmd_ARC>"], [[10.0, 0.0, 5.0, np.sqrt(75) - 10]], atol=1e-12)
    np.testing.assert_allclose(garment.values["<pattern_cmd_LINE>"], [[10.0, 10.0], [0.0, 10.0]])
    assert "<pattern_cmd_CLINE>" not in garment.values


def test_aipparel_reads_an_arc_through_any_of_its_points() -> None:
    garment = aipparel.encode(Pattern("", (square("wb_front", Arc(10.0, True, False)),), ()))
    start, end = (0.0, 0.0), (10.0, 0.0)
    third = sample_curve(start, end, Arc(10.0, True, False), 4)[1]
    values = {**garment.values, "<pattern_cmd_ARC>": np.array([[*end, *third]])}
    found = aipparel.decode(replace(garment, values=values)).panels[0].edges[0].curve
    assert isinstance(found, Arc)
    assert found.radius == pytest.approx(10.0)
    assert found.large and not found.right


def test_aipparel_closes_a_panel_without_a_closing_edge() -> None:
    garment = aipparel.encode(Pattern("", (square("wb_front"),), ()))
    words = [word for word in garment.tokens if word != "<pattern_cmd_CLINE>"]
    found = aipparel.decode(replace(garment, tokens=tuple(words)))
    assert [edge.end for edge in found.panels[0].edges] == [1, 2, 3, 0]


@given(chord=st.floats(1.0, 100.0), ratio=st.floats(0.51, 50.0), large=st.booleans(), right=st.booleans())
def test_an_arc_is_that_through_its_middle(chord: float, ratio: float, large: bool, right: bool) -> None:
    start, end, arc = (0.0, 0.0), (chord, 0.0), Arc(ratio * chord, large, right)
    found = arc_through(start, end, middle_of(start, end, arc))
    assert isinstance(found, Arc)
    assert curve_length(start, end, found) == pytest.approx(curve_length(start, end, arc), rel=1e-6)
    assert (found.large, found.right) == (large, right)


def test_the_top_of_a_panel_on_its_side_is_its_right_side() -> None:
    quarter = Placement(np.zeros(3), np.array([0.0, 0.0, pi / 2])).matrix  # x points up
    corners = np.array([[0.0, 0.0], [4.0, 0.0], [4.0, 2.0], [0.0, 2.0]])
    assert top_of(corners, quarter).tolist() == [4.0, 1.0]
    level = Placement(np.zeros(3), np.array([pi / 2, 0.0, 0.0])).matrix  # all sides are equally high
    assert top_of(corners, level).tolist() == [2.0, 2.0]


@pytest.mark.parametrize(
    "scaling",
    [*neuraltailor.SCALINGS.values(), *sewformer.SCALINGS.values(), *aipparel.SCALINGS.values(), sewingldm.SCALING],
)
def test_scalings_are_undone(scaling: Scaling) -> None:
    values = np.random.default_rng(0).normal(size=(3, len(scaling.shift)))
    np.testing.assert_allclose(scaling.undo(scaling.apply(values)), values)
    np.testing.assert_allclose(scaling.apply(np.array(scaling.shift)), 0.0)


# -------------------------------------------------------------------------------------------------------------- errors


@pytest.mark.parametrize(
    ("encode", "room"),
    [
        (neuraltailor.encode, "NeuralTailor's arrays hold 1"),
        (partial(sewformer.encode, numbers=7), "SewFormer's arrays hold 1"),
        (sewingldm.encode, "SewingLDM's arrays hold 1"),
        (garmentdiffusion.encode, "GarmentDiffusion's arrays hold 1"),
    ],
)
def test_too_many_panels_are_named(encode: Callable[..., object], room: str) -> None:
    with pytest.raises(PatternError, match=f"napkins: 2 panels, {room}: raise max_panels"):
        encode(pair(), max_panels=1)
    with pytest.raises(PatternError, match=r"panel front: 4 edges, .* hold 3: raise max_edges"):
        encode(pair(), max_edges=3)


def test_aipparel_has_108_stitch_tags() -> None:
    pattern = pair()
    with pytest.raises(PatternError, match="109 seams, AIpparel has 108 stitch tags"):
        aipparel.encode(replace(pattern, seams=pattern.seams * 109))


def test_faulty_arrays_are_named_by_place() -> None:
    arrays = neuraltailor.encode(pair())
    outlines = arrays.outlines.copy()
    outlines[1, 2, 0] = np.nan
    with pytest.raises(PatternError, match=r"outlines\[1, 2, 0\] is nan: give finite numbers"):
        neuraltailor.decode(replace(arrays, outlines=outlines))
    with pytest.raises(PatternError, match=r"outlines have shape \(14, 4\), not \(panels, edges, 4\)"):
        neuraltailor.decode(replace(arrays, outlines=arrays.outlines[0]))
    with pytest.raises(PatternError, match="panel panel_0: its quaternion is zero"):
        neuraltailor.decode(replace(arrays, rotations=np.zeros((23, 4))))
    with pytest.raises(PatternError, match=r"not \(panels, edges, 29\): give one garment"):
        sewingldm.decode(np.zeros((39, 37, 28)))
    with pytest.raises(PatternError, match=r"not \(panels, edges, 16\): give one garment"):
        garmentdiffusion.decode(np.zeros((37, 39, 15)))


def test_faulty_tokens_are_named() -> None:
    garment = aipparel.encode(pair())
    with pytest.raises(PatternError, match="no <pattern_start> and <pattern_end> among 3 tokens"):
        aipparel.decode(replace(garment, tokens=garment.tokens[1:4]))
    with pytest.raises(PatternError, match="2 <panel_start> and 1 <panel_end> tokens"):
        aipparel.decode(replace(garment, tokens=(*garment.tokens[:-2], "<pattern_end>")))
    with pytest.raises(PatternError, match="no numbers are left for <pattern_cmd_LINE>: give 2 for each"):
        aipparel.decode(replace(garment, values={k: v for k, v in garment.values.items() if "LINE" not in k}))
    with pytest.raises(PatternError, match="no such command: give one of"):
        aipparel.decode(replace(garment, values={**garment.values, "<pattern_cmd_HEXAGON>": np.zeros((1, 2))}))
