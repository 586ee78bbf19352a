"""Patterns as arrays survive encoding and decoding; their hash differs between patterns and agrees between machines."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gcd_dataset.curves import LINE, Arc, Cubic, Curve, Quadratic, sample_curve
from gcd_dataset.errors import PatternError
from gcd_dataset.patternhash import STEP, PatternHash, hash_pattern
from gcd_dataset.records import (
    Closure,
    Edge,
    EdgeRef,
    EdgeRole,
    InnerLine,
    LineRole,
    Panel,
    PanelRole,
    Pattern,
    Placement,
    Seam,
)
from gcd_dataset.tensors import (
    EDGE_LABELS,
    PANEL_LABELS,
    EdgeColumn,
    LineColumn,
    PanelColumn,
    PatternTensor,
    StitchColumn,
    area_centroid,
    decode_pattern,
    encode_pattern,
    sewn_rows,
)
from tests.generator.mesh import shapes
from tests.helpers import napkins
from tests.test_metrics import moved_origin

LOSSLESS = 1e-4  # cm


def loop(name: str, corners: np.ndarray, curves: list[Curve], *, place: np.ndarray | None = None) -> Panel:
    edges = tuple(Edge(i, (i + 1) % len(corners), curve) for i, curve in enumerate(curves))
    numbers = np.zeros(6) if place is None else place
    return Panel(name, corners, edges, Placement(numbers[:3], numbers[3:]), "body")


def square(side: float = 20.0, curve: Curve = LINE) -> Panel:
    corners = side * np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])
    return loop("square", corners, [curve, LINE, LINE, LINE])


def outline(panel: Panel) -> np.ndarray:
    """Points of the placed edges in space [cm]."""
    flat = [sample_curve(*panel.edge_ends(i), edge.curve, 9) for i, edge in enumerate(panel.edges)]
    return panel.placement.apply(np.concatenate(flat))


def again(pattern: Pattern) -> Pattern:
    return decode_pattern(encode_pattern(pattern))


def test_closures_survive_and_leave_the_stitches_alone() -> None:
    sewn = Pattern("tent", (square(),), (Seam(EdgeRef("square", 0), EdgeRef("square", 1)),))
    assert encode_pattern(sewn).closures.tolist() == [[0.0, 0.0, 1.0]]
    for kind, closure in enumerate(Closure):
        closed = replace(sewn, seams=(replace(sewn.seams[0], closure=closure, closed=(0.3, 1.0)),))
        tensor = encode_pattern(closed)
        assert tensor.closures.tolist() == [[kind, 0.3, 1.0]]
        assert decode_pattern(tensor).seams == closed.seams
        assert np.array_equal(tensor.stitches, encode_pattern(sewn).stitches)


def test_lines_survive_and_seams_name_them_after_the_edges() -> None:
    """Patterns without lines have the arrays that they had."""
    lines = (InnerLine(0, 4, Cubic((0.2, 0.1), (0.7, -0.1)), LineRole.FOLD), InnerLine(4, 6, Arc(9.0, False, True)))
    vertices = np.concatenate([square().vertices, [[7.0, 5.0], [99.0, 99.0], [12.0, 9.0]]])
    bare = Pattern("tent", (square(),), (Seam(EdgeRef("square", 0), EdgeRef("square", 1)),))
    own = replace(square(), vertices=vertices, lines=lines)
    pattern = replace(bare, panels=(own,), seams=(*bare.seams, Seam(EdgeRef("square", 5), EdgeRef("square", 2))))
    tensor, plain = encode_pattern(pattern), encode_pattern(bare)
    assert tensor.stitches.tolist() == [[0, 1, 0], [5, 2, 0]]
    assert len(plain.lines) == 0
    assert all(np.array_equal(getattr(tensor, name), getattr(plain, name)) for name in ("panels", "edges"))
    read = decode_pattern(tensor)
    assert read.seams == pattern.seams
    [panel] = read.panels
    assert [(line.start, line.end, line.role) for line in panel.lines] == [(0, 4, LineRole.FOLD), (4, 5, "stitch")]
    for index in (4, 5):
        before, after = (sample_curve(*p.edge_ends(index), p.edge(index).curve, 9) for p in (own, panel))
        assert np.allclose(before, after, rtol=0, atol=LOSSLESS)
    folded = replace(own, lines=(replace(lines[0], angle=-90.5), lines[1]))
    pressed = encode_pattern(replace(pattern, panels=(folded,)))
    assert [line.angle for line in decode_pattern(pressed).panels[0].lines] == [-90.5, 0.0]
    assert hash_pattern(0, tensor).value != hash_pattern(0, pressed).value
    moved = tensor.lines.copy()
    moved[1, LineColumn.END_X] += 1.0
    assert hash_pattern(0, tensor).value != hash_pattern(0, replace(tensor, lines=moved)).value
    with pytest.raises(PatternError, match="panel square, line 0: role pleat: give one of fold, placement, stitch"):
        encode_pattern(replace(pattern, panels=(replace(own, lines=(InnerLine(0, 2, role="pleat"),)),), seams=()))


def assert_same(ours: Pattern, theirs: Pattern) -> None:
    assert ours.name == theirs.name
    assert ours.seams == theirs.seams
    assert [panel.name for panel in ours.panels] == [panel.name for panel in theirs.panels]
    for a, b in zip(ours.panels, theirs.panels, strict=True):
        assert a.label == b.label
        assert [(e.start, e.end, e.label, e.curve.kind) for e in a.edges] == [
            (e.start, e.end, e.label, e.curve.kind) for e in b.edges
        ]
        assert np.array_equal(a.placement.rotation, b.placement.rotation)
        assert np.allclose(a.vertices, b.vertices, rtol=0, atol=LOSSLESS)
        assert np.allclose(outline(a), outline(b), rtol=0, atol=LOSSLESS)


share = st.floats(-3, 3, allow_nan=False)
pair = st.tuples(share, share)
bezier: st.SearchStrategy[Curve] = st.just(LINE) | st.builds(Quadratic, pair) | st.builds(Cubic, pair, pair)


@st.composite
def panels(draw: st.DrawFn, name: str) -> Panel:
    """Any star-shaped panel with any curves, anywhere, at any angle."""
    count = draw(st.integers(3, 9))
    radii = np.array(draw(st.lists(st.floats(0.05, 100), min_size=count, max_size=count)))
    turns = 2 * np.pi * np.arange(count) / count
    corners = radii[:, None] * np.stack([np.cos(turns), np.sin(turns)], axis=1) + draw(share) * 50
    chords = np.linalg.norm(np.roll(corners, -1, axis=0) - corners, axis=1)
    arcs = st.builds(Arc, st.floats(0.5, 40), st.booleans(), st.booleans())
    curves = [
        replace(curve, radius=curve.radius * chord) if isinstance(curve, Arc) else curve
        for curve, chord in zip(draw(st.lists(bezier | arcs, min_size=count, max_size=count)), chords, strict=True)
    ]
    place = np.array(draw(st.lists(st.floats(-3, 3), min_size=6, max_size=6))) * [60, 60, 60, 1, 1, 1]
    label = draw(st.sampled_from(["", "body", "leg", "arm", "a sail"]))
    edge_label = draw(st.sampled_from(["", "lower_interface", "strapless_top", "hem"]))
    panel = replace(loop(name, corners, curves, place=place), label=label)
    return replace(panel, edges=(replace(panel.edges[0], label=edge_label), *panel.edges[1:]))


@given(panels("one"), panels("two"), st.booleans())
def test_any_pattern_survives(one: Panel, two: Panel, right_wrong: bool) -> None:
    seam = Seam(EdgeRef("two", 0), EdgeRef("one", len(one.edges) - 1), right_wrong)
    pattern = Pattern("pair", (two, one), (seam,))
    assert_same(again(pattern), pattern)


@pytest.mark.parametrize("chord", [1.0, 1e-2, 1e-4, 1e-6])
def test_a_circle_that_all_but_closes_survives(chord: float) -> None:
    """The ends of a circular skirt's hem nearly touch, far from the origin; their direction fixes the far side."""
    corners = np.array([[0.0, 0.0], [chord, 0.0], [chord, 12.0], [0.0, 12.0]]) + [173.0, -91.0]
    hem = loop("skirt", corners, [Arc(80.0, large=True, right=True), LINE, LINE, LINE])
    assert_same(again(Pattern("skirt", (hem,), ())), Pattern("skirt", (hem,), ()))


def test_corners_may_be_numbered_otherwise_than_the_loop() -> None:
    corners = np.array([[9.0, 9.0], [0.0, 0.0], [0.0, 9.0], [9.0, 0.0]])
    edges = (Edge(1, 3), Edge(3, 0), Edge(0, 2), Edge(2, 1))
    panel = Panel("napkin", corners, edges, Placement(np.zeros(3), np.zeros(3)))
    assert again(Pattern("p", (panel,), ())).panels == (panel,)


def test_centroids_of_a_half_disc_a_triangle_and_a_strip_without_area() -> None:
    """4 r / 3 π from the straight side."""
    corners = np.array([[-6.0, 0.0], [6.0, 0.0]])
    disc = loop("half", corners, [LINE, Arc(6.0, large=False, right=True)])
    assert np.allclose(area_centroid(disc), [0.0, 4 * 6 / (3 * np.pi)], atol=1e-9)
    corners = np.array([[1.0, 2.0], [7.0, 3.0], [4.0, 11.0]])
    assert np.allclose(area_centroid(loop("t", corners, [LINE] * 3)), corners.mean(axis=0))
    corners = np.array([[0.0, 0.0], [4.0, 0.0], [8.0, 0.0]])
    assert np.allclose(area_centroid(loop("t", corners, [LINE] * 3)), [4.0, 0.0])


def test_rows_do_not_depend_on_the_local_origin() -> None:
    place = np.array([5.0, 90.0, 20.0, 0.3, -0.8, 0.1])
    panel = loop("p", square().vertices, [Quadratic((0.4, 0.2)), LINE, Arc(15, False, True), LINE], place=place)
    ours, theirs = (encode_pattern(Pattern("p", (p,), ())) for p in (panel, moved_origin(panel)))
    assert np.allclose(ours.panels[:, : PanelColumn.CENTROID_X], theirs.panels[:, : PanelColumn.CENTROID_X])
    assert np.allclose(ours.edges, theirs.edges)


def test_the_quaternion_turns_as_the_placement_does() -> None:
    panel = loop("p", square().vertices, [LINE] * 4, place=np.array([0, 0, 0, 2.9, -0.4, 1.7]))
    w, x, y, z = encode_pattern(Pattern("p", (panel,), ())).panels[0, 3:7]
    third = [2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)]
    assert w >= 0
    assert np.allclose(panel.placement.matrix[:, 2], third)


def test_stitches_name_rows_of_edges() -> None:
    one, two = square(), replace(square(), name="other")
    seams = (Seam(EdgeRef("square", 3), EdgeRef("other", 1)), Seam(EdgeRef("other", 0), EdgeRef("square", 2), True))
    stitches = encode_pattern(Pattern("p", (one, two), seams)).stitches
    assert stitches[:, [StitchColumn.LEFT, StitchColumn.RIGHT]].tolist() == [[3, 5], [4, 2]]
    assert stitches[:, StitchColumn.RIGHT_WRONG].tolist() == [0, 1]


def test_broken_patterns_are_named() -> None:
    panel = square()
    open_loop = replace(panel, edges=panel.edges[:3])
    for pattern, message in (
        (Pattern("p", (open_loop,), ()), "panel square, edge 0: does not start where the edge before ends"),
        (Pattern("p", (panel,), (Seam(EdgeRef("square", 0), EdgeRef("square", 9)),)), "square has no edge 9"),
        (
            Pattern("p", (panel,), (Seam(EdgeRef("square", 0), EdgeRef("square", 1), closure="velcro"),)),
            "seam 0: closure velcro: give one of sewn, open, zip, buttons",
        ),
        (Pattern("p", (square(20.0, Arc(9.0, False, True)),), ()), "cannot span"),
        (Pattern("p", (replace(panel, lines=(InnerLine(0, 9),)),), ()), "panel square, line 0: no vertex 0 or 9"),
        (Pattern("p", (replace(panel, lines=(InnerLine(-1, 1),)),), ()), "panel square, line 0: no vertex -1 or 1"),
    ):
        with pytest.raises(PatternError, match=message):
            encode_pattern(pattern)


def test_broken_arrays_are_named() -> None:
    tensor = encode_pattern(Pattern("p", (square(),), ()))
    for broken, message in (
        (replace(tensor, edges=tensor.edges[:, :5]), "edges has shape"),
        (replace(tensor, edges=tensor.edges[:3]), "correct N_EDGES"),
        (replace(tensor, panel_names=()), "0 panel names for 1 panels"),
        (replace(tensor, closures=np.zeros((1, 3))), "1 closures for 0 stitches"),
        (
            replace(tensor, stitches=np.array([[0, 7, 0]]), closures=sewn_rows(1)),
            "stitches refer to edges 0 to 7, but there are 4",
        ),
        (changed("edges", 0, EdgeColumn.KIND, 9), "edges refer to kinds"),
        (changed("edges", 0, EdgeColumn.LABEL, 40), "edges refer to labels"),
    ):
        with pytest.raises(PatternError, match=message):
            decode_pattern(broken)


def test_roles_have_the_numbers_that_stored_tensors_have() -> None:
    assert PANEL_LABELS == ("", "body", "leg", "arm")
    assert EDGE_LABELS == (
        "", "lower_interface", "left_collar", "right_collar", "left_armhole", "right_armhole", "strapless_top",
    )  # fmt: skip


def test_labels_come_back_as_roles_and_other_texts_as_they_are() -> None:
    panel = replace(shapes.panel("front", shapes.rectangle(9, 9), labels={1: "left_collar", 2: "pocket"}), label="arm")
    (read,) = decode_pattern(encode_pattern(Pattern("shirt", (panel,), ()))).panels
    assert read.label is PanelRole.ARM
    assert sorted(edge.label for edge in read.edges) == ["", "", "left_collar", "pocket"]
    assert [edge.label for edge in read.edges if isinstance(edge.label, EdgeRole)] == [EdgeRole.LEFT_COLLAR]
    assert EdgeRole.LEFT_COLLAR.mirrored is EdgeRole.RIGHT_COLLAR
    assert EdgeRole.STRAPLESS_TOP.mirrored is EdgeRole.STRAPLESS_TOP


NAPKINS = encode_pattern(napkins())


def changed(array: str, row: int, column: int, by: float) -> PatternTensor:
    """The napkins with ``by`` added to one entry."""
    moved = getattr(NAPKINS, array).copy()
    moved[row, column] += by
    return replace(NAPKINS, **{array: moved})


def hash_text(*patterns: PatternTensor) -> str:
    return PatternHash.of(enumerate(patterns)).text


PANEL_COLUMNS = (PanelColumn.X, PanelColumn.QUATERNION_X, PanelColumn.CENTROID_Y, PanelColumn.LABEL)
EDGE_COLUMNS = (EdgeColumn.START_X, EdgeColumn.KIND, EdgeColumn.CONTROL0_X, EdgeColumn.RIGHT)


def test_another_panel_edge_stitch_name_or_index_is_another_pattern() -> None:
    for column in PANEL_COLUMNS:
        assert hash_text(changed("panels", 1, column, 1.0)) != hash_text(NAPKINS)
    for edge in EDGE_COLUMNS:
        assert hash_text(changed("edges", 2, edge, 1.0)) != hash_text(NAPKINS)
    assert hash_text(changed("stitches", 0, 2, 1)) != hash_text(NAPKINS)
    assert hash_text(replace(NAPKINS, panel_names=("one", "three"))) != hash_text(NAPKINS)
    assert hash_pattern(1, NAPKINS).text != hash_pattern(0, NAPKINS).text


def test_the_last_digits_the_sign_of_nothing_angles_and_radii_do_not_count() -> None:
    """At 90 degrees about y only the sum of the angles about x and z is determined (gimbal lock)."""
    assert hash_text(changed("edges", 1, EdgeColumn.START_X, 2e-11)) == hash_text(NAPKINS)
    assert hash_text(changed("edges", 0, EdgeColumn.CONTROL0_X, -0.0)) == hash_text(NAPKINS)
    assert hash_text(changed("edges", 0, EdgeColumn.CONTROL0_X, -2e-11)) == hash_text(NAPKINS)
    assert hash_text(changed("panels", 0, PanelColumn.ANGLE_X, 0.5)) == hash_text(NAPKINS)
    assert hash_text(changed("edges", 0, EdgeColumn.RADIUS, 10.0)) == hash_text(NAPKINS)


def test_half_a_turn_is_one_rotation() -> None:
    """For a rotation by 180 degrees W is 0 up to rounding, so its sign is arbitrary."""
    panels = NAPKINS.panels.copy()
    panels[0, PanelColumn.QUATERNION_W : PanelColumn.QUATERNION_Z + 1] = [6e-17, 0.0, 1.0, 0.0]
    other = panels.copy()
    other[0, PanelColumn.QUATERNION_W : PanelColumn.QUATERNION_Z + 1] = [6e-17, 0.0, -1.0, 0.0]
    assert hash_text(replace(NAPKINS, panels=panels)) == hash_text(replace(NAPKINS, panels=other))


def test_the_order_does_not_matter() -> None:
    parts = [hash_pattern(index, NAPKINS) for index in range(5)]
    assert sum(parts, PatternHash()).text == sum(parts[::-1], PatternHash()).text == hash_text(*[NAPKINS] * 5)
    assert sum(parts, PatternHash()).count == 5


def test_a_number_between_two_steps_may_be_rounded_either_way() -> None:
    """The coordinates of two machines differ by 2e-12 cm, across a rounding tie."""
    place = 0.5 * STEP - NAPKINS.edges[1, EdgeColumn.START_X] % STEP
    below = changed("edges", 1, EdgeColumn.START_X, place - 1e-12)
    above = changed("edges", 1, EdgeColumn.START_X, place + 1e-12)
    one, other = (PatternHash.of([(0, NAPKINS), (1, moved)]) for moved in (below, above))
    assert one.text != other.text
    assert one.agrees(other.text)
    assert other.agrees(one.text)
    assert not one.agrees(hash_text(NAPKINS, changed("edges", 1, EdgeColumn.START_X, 1e-3)))


def test_two_patterns_and_mirrored_numbers_may_be_rounded_otherwise() -> None:
    """Mirrored panels hold a coordinate with both signs; another machine rounds both the other way."""

    def napkins_at(offset: float) -> PatternTensor:
        edges = NAPKINS.edges.copy()
        for row, sign in ((1, 1), (5, -1)):
            edges[row, EdgeColumn.START_X] = sign * (10.0 + 0.5 * STEP + offset)
        return replace(NAPKINS, edges=edges)

    one, other = (PatternHash.of(enumerate([napkins_at(offset)] * 2)) for offset in (-1e-12, 1e-12))
    assert one.text != other.text
    assert one.agrees(other.text)


@pytest.mark.parametrize("wrong", [np.nan, np.inf, 1e300])
def test_numbers_that_cannot_be_rounded_are_rejected(wrong: float) -> None:
    with pytest.raises(PatternError, match="a number is NaN"):
        hash_pattern(0, changed("edges", 0, EdgeColumn.START_X, wrong))
