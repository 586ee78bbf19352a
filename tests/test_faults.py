"""Each rule finds its fault and names panel and edge; the search for crossings misses none."""

import tracemalloc
from collections.abc import Mapping
from dataclasses import replace
from itertools import combinations
from math import cos, sin
from pathlib import Path

import numpy as np
import pytest
import shapely
from hypothesis import assume, example, given
from hypothesis import strategies as st

from gcd_dataset import crossings
from gcd_dataset.crossings import edge_hulls, find_crossings
from gcd_dataset.curves import LINE, Arc, Cubic, Curve, Quadratic, curve_length, sample_curve, to_frame
from gcd_dataset.errors import PatternError
from gcd_dataset.faults import Rule, Severity, check_pattern, require_valid
from gcd_dataset.generator import make
from gcd_dataset.generator.recipe import MakeConfig
from gcd_dataset.records import Edge, EdgeRef, InnerLine, LineRole, Panel, Pattern, Placement, Seam
from gcd_dataset.spec import read_pattern
from tests.generator.mesh import shapes
from tests.pleats import pleated_square


def polygon(*corners: tuple[float, float], curves: Mapping[int, Curve] | None = None, name: str = "front") -> Panel:
    return shapes.panel(name, corners, curves=curves)


def square(name: str = "front", side: float = 10.0, *, below: Curve = LINE) -> Panel:
    return polygon((0, 0), (side, 0), (side, side), (0, side), curves={0: below}, name=name)


def rounded(count: int, name: str = "front") -> Panel:
    """A nearly round panel of many straight edges."""
    return polygon(*((50 * cos(i / 320), 50 * sin(i / 320)) for i in range(count)), name=name)


def hung(name: str, z: float, y: float = 100.0) -> Panel:
    return replace(square(name), placement=Placement(np.array([0.0, y, z]), np.zeros(3)))


def with_edge(panel: Panel, index: int, *edges: Edge) -> Panel:
    return replace(panel, edges=panel.edges[:index] + edges + panel.edges[index + 1 :])


def labelled(panel: Panel, index: int, label: str) -> Panel:
    return with_edge(panel, index, replace(panel.edges[index], label=label))


def alone(*panels: Panel) -> Pattern:
    return Pattern("p", panels, ())


def named(*names: str) -> Pattern:
    return alone(*map(square, names))


SIDE = Seam(EdgeRef("front", 1), EdgeRef("back", 3))


def sewn(*seams: Seam, front: Panel | None = None, back: Panel | None = None) -> Pattern:
    return Pattern("p", (front or square(), back or square("back")), seams)


def sewn_unequally() -> Pattern:
    return sewn(SIDE, back=square("back", side=15.0))


def alone_sewn(panel: Panel, *pairs: tuple[int, int]) -> Pattern:
    """A panel alone, with pairs of its own edges sewn together."""
    seams = [Seam(EdgeRef(panel.name, left), EdgeRef(panel.name, right)) for left, right in pairs]
    return Pattern("p", (panel,), tuple(seams))


WITH_DART = polygon((0, 0), (20, 0), (20, 20), (10.2, 20), (10, 8), (9.8, 20), (0, 20))


def lined(*ends: tuple[float, float]) -> Pattern:
    """The square of 10 cm with a line from each vertex after its corners to the next but one."""
    lines = tuple(InnerLine(4 + i, 5 + i) for i in range(0, len(ends), 2))
    return alone(replace(square(), vertices=np.concatenate([square().vertices, ends]), lines=lines))


def creased(*lines: InnerLine) -> Pattern:
    return alone(replace(square(), lines=lines))


def folded(angle: float, role: str = LineRole.FOLD) -> Pattern:
    return creased(InnerLine(0, 2, role=role, angle=angle))


def closing(closure: str, start: float = 0.0, end: float = 1.0) -> Pattern:
    return sewn(replace(SIDE, closure=closure, closed=(start, end)))


def dipping(depth: float) -> Pattern:
    """A triangle whose slanting edge dips ``depth`` [cm] under the base and rises through it near the corner."""
    start, end = (50.0, 0.0), (-10.0, 30.0)
    dip = {1: Quadratic(to_frame(start, end, (40.0, -depth)))}
    return alone(polygon((0, 0), start, end, curves=dip))


CROSSWISE = Seam(EdgeRef("front", 1), EdgeRef("back", 1))
LOST = replace(named(*map(str, range(100, 300))), seams=(Seam(EdgeRef("100", 0), EdgeRef("q", 0)),))
COLLARS = sewn(SIDE, front=labelled(square(), 1, "left_collar"), back=labelled(square("back"), 3, "right_collar"))
CURVED = creased(InnerLine(0, 2, Quadratic((0.5, 0.1)), LineRole.FOLD, 180.0))
STRIP = polygon((0, 0), (30, 0), (15, 0.8), name="strip")
SMALL = alone(square(side=7.0))
DECLARED = replace(SMALL, extra={"properties": {"original_units_in_meter": 1000}})  # drawn in cm, declared as mm
UNPLACED = alone(square(side=700.0), square("back", side=650.0))
SUNK = alone(hung("front", 9.0, y=-60.0), hung("back", -9.0, y=-60.0))
HANGING = sewn(CROSSWISE, front=hung("front", 2.0), back=hung("back", -2.0))
FAR_ENDS = "back, edge 1: the start of one meets the end of the other, 10.8 cm apart as the panels hang, "
BULGING = polygon((0, 0), (10, 0), (10, 4), (0, 4), curves={0: Quadratic((0.5, 1.2))})
LOOPED = polygon((0, 0), (10, 0), (10, -10), (0, -10), curves={0: Cubic((1.6, 0.8), (-0.6, 0.8))})
FAULTS: list[tuple[Rule, str, int | None, str, Pattern]] = [
    (Rule.NO_PANEL, "", None, "nothing", alone()),
    (Rule.MANY_PANELS, "", None, "201, more than 200: leave one garment in the file", named(*map(str, range(201)))),
    (Rule.PANEL_NAME, "", None, "panel 1 of 2 has no name", named("front", "")),
    (Rule.PANEL_NAME, "", None, "panel 1 of 2 has no name", named("front", " ")),
    (Rule.PANEL_NAME, "left\nsleeve", None, "an unprintable character", named("front", "left\nsleeve")),
    (Rule.PANEL_NAME, "cape\ud800", None, "an unprintable character", named("front", "cape\ud800")),
    (Rule.PANEL_NAME, "front", None, "3 panels have this name", named("front", "back", "front", "front")),
    (Rule.TOO_LARGE, "front", None, "1000.1 cm across", alone(square(side=1000.1))),
    (Rule.TOO_LARGE, "front", None, "e+07 cm across", alone(square(below=Quadratic((1e7, 1e7))))),
    (Rule.TOO_LARGE, "front", None, "1e+08 cm across", alone(square(below=Cubic((0.3, 0.1), (-1e7, 0.0))))),
    (Rule.TOO_LARGE, "front", None, "1200 cm across", alone(square(below=Arc(600.0, True, True)))),
    (Rule.FEW_EDGES, "front", None, "2 straight", alone(polygon((0, 0), (9, 0)))),
    (Rule.MANY_EDGES, "front", None, "2001, more than 2000: draw curves", alone(rounded(2001))),
    # A file may hold 200 panels of 2,000 edges: half a minute of checks.
    (Rule.MANY_EDGES, "", None, "12000, more than 10000", alone(*(rounded(2000, f"p{i}") for i in range(6)))),
    (Rule.VERTEX_RANGE, "front", 1, "vertex 7 of 4", alone(with_edge(square(), 1, Edge(1, 7)))),
    (Rule.OPEN_LOOP, "front", 2, "edge 1 ends at 2", alone(with_edge(square(), 2))),
    (Rule.NO_LENGTH, "front", 1, "coincide", alone(polygon((0, 0), (9, 0), (9, 0), (0, 9)))),
    (Rule.ARC_RADIUS, "front", 0, "radius 4.9 cm, chord 10 cm", alone(square(below=Arc(4.9, False, True)))),
    (Rule.SELF_CROSSING, "front", 0, "edge 2 at (5.00, 5", alone(polygon((0, 0), (10, 10), (10, 0), (0, 10)))),
    # The middle of the lower edge is 6 cm high, above the top edge at 4 cm; a loop within one edge.
    (Rule.SELF_CROSSING, "front", 0, "it meets edge 2", alone(BULGING)),
    (Rule.SELF_CROSSING, "front", 0, "it crosses itself", alone(LOOPED)),
    # By distance: the base is crossed 0.6 cm from its corner, at 1 % of its length.
    (Rule.SELF_CROSSING, "front", 0, "edge 1 at (49.38", dipping(0.45)),
    (Rule.NO_SUCH_EDGE, "side", 3, "stitch 0: there is", sewn(Seam(EdgeRef("front", 1), EdgeRef("side", 3)))),
    (Rule.NO_SUCH_EDGE, "q", 0, "139 and 160 more", LOST),
    (Rule.STITCHED_TWICE, "front", 1, "one of 2", sewn(SIDE, CROSSWISE)),
    (Rule.LABELS_DIFFER, "front", 1, "left_collar and right_collar", COLLARS),
    (Rule.LINE, "front", None, "line 0, from vertex 4 to 5: correct its ends", lined((2, 2), (2, 2))),
    (Rule.LINE, "front", None, "role pleat: give one of fold, placement, stitch", folded(0.0, "pleat")),
    (Rule.LINE_CROSSING, "front", None, "meets the outline at (10.00, 2.80) cm: part them", lined((2, 2), (12, 3))),
    (Rule.LINE_CROSSING, "front", None, "line 1 meets line 0 at (5.00, 5", lined((2, 2), (8, 8), (2, 8), (8, 2))),
    (Rule.LINE_CROSSING, "front", None, "line 1 meets line 0", creased(InnerLine(0, 2), InnerLine(1, 3))),
    (Rule.LINE_OUTSIDE, "front", None, "line 0: draw it inside the outline", lined((12, 2), (12, 9))),
    (Rule.FOLD, "front", None, "of 180°: draw it straight, from the outline to the outline", CURVED),
    (Rule.FOLD, "front", None, "its role is stitch, give it the role fold", folded(90.0, LineRole.STITCH)),
    (Rule.FOLD, "front", None, "give -180 to 180", folded(270.0)),
    (Rule.FOLD, "front", None, "give -180 to 180", folded(float("nan"))),
    (Rule.CLOSURE, "front", 1, "stitch 0: closed from 0.8 to 0.2: give two shares", closing("sewn", 0.8, 0.2)),
    (Rule.CLOSURE, "front", 1, "two shares of its length, in ascending order from 0 to 1", closing("zip", -0.1)),
    (Rule.CLOSURE, "front", 1, "velcro: give one of sewn, open, zip, buttons", closing("velcro")),
    (Rule.SHORT_EDGE, "front", 1, "0.3 cm", alone(polygon((0, 0), (10, 0), (10, 0.3), (0, 9)))),
    (Rule.NARROW_DART, "front", 3, "with edge 4 it is 0.4 cm wide: leave", alone_sewn(WITH_DART, (3, 4))),
    (Rule.SMALL_PANEL, "strip", None, "12 cm² over a length of 30 cm: join it", alone(square(), STRIP)),
    (Rule.SEAM_LENGTHS, "front", 1, "10.00 and 15.00 cm, ratio 1.500", sewn_unequally()),
    (Rule.UNLIKELY_SIZE, "", None, "its largest panel is 7 cm: ", SMALL),
    (Rule.UNLIKELY_SIZE, "", None, "in centimetres it would be 70 cm: set properties.units_in_meter to 100", DECLARED),
    (Rule.UNLIKELY_SIZE, "", None, "in millimetres it would be 70 cm", UNPLACED),
    (Rule.UNLIKELY_HEIGHT, "", None, "its top is -50 cm above the floor: correct the translations", SUNK),
    (Rule.SEWN_CROSSWISE, "front", 1, FAR_ENDS + "and 4.0 cm the other way", HANGING),
]
GOOD = [
    sewn(SIDE),
    closing("buttons", 0.25, 0.75),
    closing("open"),
    sewn(SIDE, front=square(side=16.0), back=square("back", side=16.8 + 1e-14)),  # eased by 1.05, but for rounding
    sewn(CROSSWISE),  # on one sheet
    named("front left", "Rücken", "袖", "前\u3000片", "نیم\u200cتنه", "👩\u200d🦰", "panel-2 (copy)"),
    alone(polygon((0, 0), (10, 0), curves={0: Arc(8.0, False, True), 1: Arc(8.0, False, True)})),
    alone(square(below=Arc(1e6, False, True))),  # flat, though of a great circle
    lined((2, 2), (8, 8), (2, 8), (4, 6)),
    creased(InnerLine(0, 2)),
    folded(0.0),
    dipping(0.002),  # crossed 0.003 cm from the corner
]


@pytest.mark.parametrize(("rule", "panel", "edge", "figure", "pattern"), FAULTS)
def test_each_rule_names_its_place_and_figure(
    rule: Rule, panel: str, edge: int | None, figure: str, pattern: Pattern
) -> None:
    [fault] = check_pattern(pattern)
    assert (fault.rule, fault.panel, fault.edge) == (rule, panel, edge)
    assert figure in fault.figure
    assert repr(panel)[1:-1] in str(fault)
    assert str(fault).isprintable()


def test_each_rule_has_a_pattern_that_breaks_it() -> None:
    assert {rule for rule, *_ in FAULTS} == {*Rule}


@pytest.mark.parametrize("pattern", GOOD)
def test_a_good_pattern_has_no_faults(pattern: Pattern) -> None:
    assert check_pattern(pattern) == ()


def test_a_seam_may_join_a_line_that_is_there() -> None:
    [front] = lined((2, 1), (2, 9.5)).panels
    for line, rules in ((4, []), (5, [Rule.NO_SUCH_EDGE])):
        found = check_pattern(sewn(Seam(EdgeRef("front", line), EdgeRef("back", 3), right_wrong=True), front=front))
        assert [fault.rule for fault in found if fault.severity is Severity.ERROR] == rules


def test_a_narrow_dart_is_found_whole_and_a_wide_one_is_none() -> None:
    """Its legs may be divided, and the loop may run clockwise."""
    corners = ((0, 0), (20, 0), (20, 20), (10.2, 20), (10.1, 14), (10, 8), (9.9, 14), (9.8, 20), (0, 20))
    divided = alone_sewn(polygon(*corners), (4, 5), (6, 3))
    clockwise = alone_sewn(polygon(*corners[::-1]), (4, 1), (2, 3))
    figures = [[fault.figure.partition(":")[0] for fault in check_pattern(each)] for each in (divided, clockwise)]
    assert figures == [["with edge 6 it is 0.4 cm wide"], ["with edge 4 it is 0.4 cm wide"]]
    wide = polygon((0, 0), (20, 0), (20, 20), (12, 20), (10, 8), (8, 20), (0, 20))
    assert not check_pattern(alone_sewn(wide, (3, 4)))


def test_a_pattern_in_other_units_than_it_says_is_too_large() -> None:
    """Its curves are not sampled: the mesh and the search for crossings would take terabytes."""
    faults = check_pattern(sewn(SIDE, front=square(side=1e6), back=square("back", side=1e6)))
    assert [(fault.rule, fault.panel) for fault in faults] == [(Rule.TOO_LARGE, "front"), (Rule.TOO_LARGE, "back")]
    assert "1e+06 cm across" in faults[0].figure
    assert "units_in_meter" in faults[0].figure


def scaled(pattern: Pattern, factor: float) -> Pattern:
    """The pattern as read from a file in another unit that declares centimetres."""

    def larger(edge: Edge) -> Edge:
        curve = edge.curve
        return replace(edge, curve=replace(curve, radius=curve.radius * factor)) if isinstance(curve, Arc) else edge

    panels = tuple(
        replace(
            panel,
            vertices=panel.vertices * factor,
            edges=tuple(map(larger, panel.edges)),
            placement=replace(panel.placement, translation=panel.placement.translation * factor),
        )
        for panel in pattern.panels
    )
    return replace(pattern, panels=panels)


@pytest.fixture(scope="module")
def drawn() -> list[Pattern]:
    """Sampled garments."""
    return [make(11, index, MakeConfig(stage="pattern")).pattern for index in (19, 71, 107, 144, 217, 285, 288, 326)]


@pytest.mark.parametrize(("factor", "unit"), [(10.0, "to 1000"), (0.01, "to 1")])
def test_a_garment_in_another_unit_than_it_says_is_reported_with_the_probable_one(
    factor: float, unit: str, drawn: list[Pattern]
) -> None:
    """Millimetres, and metres, read as centimetres."""
    for pattern in drawn:
        message = [fault for fault in check_pattern(scaled(pattern, factor)) if "set properties.units" in fault.figure]
        assert {fault.rule for fault in message} <= {Rule.UNLIKELY_SIZE, Rule.TOO_LARGE}
        assert any(fault.figure.endswith(unit) for fault in message)


def test_wide_and_short_skirts_have_a_likely_size_and_are_sewn_straight(drawn: list[Pattern]) -> None:
    """The samples include a ruffle of 7 m, a skirt of 15 panels of 15 cm, and nearly crosswise stitches."""
    for pattern in drawn:
        assert not {fault.rule for fault in check_pattern(pattern)} & {Rule.UNLIKELY_SIZE, Rule.SEWN_CROSSWISE}
    largest = [max(float(np.ptp(panel.vertices, axis=0).max()) for panel in pattern.panels) for pattern in drawn]
    assert max(largest) > 600.0
    assert min(largest) < 15.0


def test_a_stitch_turned_round_is_identified_where_the_panels_hang(drawn: list[Pattern]) -> None:
    """Turns the side seams of a skirt, which run from waist to hem."""
    for pattern in drawn:
        turned = [replace(seam, right_wrong=not seam.right_wrong) for seam in pattern.seams]
        message = {fault.rule for fault in check_pattern(replace(pattern, seams=tuple(turned)))}
        assert Rule.SEWN_CROSSWISE in message


def test_an_outline_of_kilometres_in_a_small_panel_is_not_searched() -> None:
    """Four hundred curves that run out a metre and back would take 500,000 sample points."""
    there_and_back: dict[int, Curve] = {i: Cubic((100.0, 0.0), (-100.0, 0.0)) for i in range(400)}
    corners = [(20 * cos(i / 64), 20 * sin(i / 64)) for i in range(400)]
    faults = check_pattern(alone(polygon(*corners, curves=there_and_back)))
    assert {fault.rule for fault in faults if fault.severity is Severity.ERROR} == {Rule.TOO_LARGE}
    assert "its outline is" in next(fault.figure for fault in faults if fault.rule is Rule.TOO_LARGE)


def test_only_errors_forbid_sewing() -> None:
    severities = [rule.severity for rule in (Rule.PANEL_NAME, Rule.TOO_LARGE, Rule.UNLIKELY_SIZE)]
    assert severities == [Severity.ERROR, Severity.ERROR, Severity.WARNING]
    gathered = sewn_unequally()
    assert require_valid(gathered) is gathered
    with pytest.raises(PatternError, match=r"a\.json: panel front, edge 1: error: vertex out of range: vertex 7 of 4"):
        require_valid(alone(with_edge(square(), 1, Edge(1, 7))), source="a.json")


def test_the_reference_patterns_can_be_sewn(examples: Path) -> None:
    for path in sorted((examples / "patterns").rglob("*_specification.json")):
        faults = check_pattern(read_pattern(path))
        assert {fault.rule for fault in faults} <= {Rule.SHORT_EDGE, Rule.SEAM_LENGTHS}, path


coordinate = st.integers(-8, 8).map(lambda n: n / 2)  # a coarse grid: edges often touch, overlap and run back
control = st.tuples(coordinate, coordinate)
curves = st.one_of(
    st.just(LINE),
    st.builds(Quadratic, control),
    st.builds(Cubic, control, control),
    st.builds(Arc, st.floats(12.0, 40.0), st.booleans(), st.booleans()),
)
loops = st.lists(st.tuples(coordinate, coordinate, curves), min_size=2, max_size=6)


def bent_panel(loop: list[tuple[float, float, Curve]]) -> Panel:
    shape = polygon(*((x, y) for x, y, _ in loop), curves={i: curve for i, (_, _, curve) in enumerate(loop)})
    steps = np.roll(shape.vertices, -1, axis=0) - shape.vertices
    assume((np.abs(steps).max(axis=1) > 0).all())
    return shape


def sampled(shape: Panel, index: int, count: int = 129) -> np.ndarray:
    return sample_curve(*shape.edge_ends(index), shape.edges[index].curve, count)


def found(shape: Panel) -> list[tuple[int, int]]:
    lengths = [curve_length(*shape.edge_ends(i), edge.curve) for i, edge in enumerate(shape.edges)]
    return [(crossing.edge, crossing.other) for _, crossing in find_crossings([shape], [edge_hulls(shape)], [lengths])]


@given(loops)
def test_an_edge_stays_within_its_hull(loop: list[tuple[float, float, Curve]]) -> None:
    shape = bent_panel(loop)
    for index, hull in enumerate(edge_hulls(shape)):
        assert hull[[0, 3]].tolist() == [complex(*end) for end in shape.edge_ends(index)]
        around = shapely.MultiPoint(np.stack([hull.real, hull.imag], axis=1)).convex_hull
        assert shapely.distance(around, shapely.points(sampled(shape, index))).max() < 1e-6


@given(loops)
@example([(0.0, 0.0, LINE), (-1.5, -3.0, Quadratic((-0.5, 0.0))), (-1.0, -3.5, LINE)])
def test_the_broad_phase_misses_no_crossing(loop: list[tuple[float, float, Curve]]) -> None:
    """Cleared pairs meet in a shared corner at most; cleared edges do not meet themselves."""
    shape = bent_panel(loop)
    hulls = edge_hulls(shape)
    lines = [shapely.LineString(sampled(shape, index)) for index in range(len(loop))]
    assert all(lines[index].is_simple for index in np.flatnonzero(crossings._monotone(hulls)))
    proposed = {(i, j) for _, _, pairs in crossings._broad_phase([hulls]) for i, j in pairs.tolist()}
    for i, j in set(combinations(range(len(loop)), 2)) - proposed:
        met = shapely.get_coordinates(shapely.intersection(lines[i], lines[j]))
        corner = shape.vertices[sorted({i, (i + 1) % len(loop)} & {j, (j + 1) % len(loop)})]
        assert len(corner) == 1 or not len(met)
        assert np.abs(met - corner[:1]).max(initial=0) < 1e-9  # rounding may split it into two points


def test_edges_that_touch_or_run_back_over_themselves_and_each_other() -> None:
    hourglass = polygon((0, 0), (10, 0), (5, 5), (10, 10), (0, 10), (5, 5))  # its neck has no width
    assert found(hourglass) == [(1, 4), (1, 5), (2, 4), (2, 5)]
    there_and_back = [(0.0, 0.0), (10.0, 0.0), (4.0, 0.0), (4.0, 5.0)]
    assert found(polygon(*there_and_back)) == [(0, 1), (0, 2)]
    too_far = {0: Quadratic((1.5, 0.0))}  # runs along its chord, beyond the end, and back
    assert (0, 0) in found(polygon((0.0, 0.0), (10.0, 0.0), (5.0, 8.0), curves=too_far))


def test_a_curve_that_runs_round_its_own_end_meets_the_next_edge() -> None:
    round_the_end = {0: Cubic((1.3, -0.9), (1.3, 0.9))}  # passes through (-1, 0) before it ends at (0, 0)
    assert (0, 1) in found(polygon((10.0, 0.0), (0.0, 0.0), (-4.0, 0.0), (3.0, -20.0), curves=round_the_end))


@pytest.mark.parametrize("right", [True, False])
def test_a_large_arc_is_tested_beyond_its_chord(right: bool) -> None:
    """A keyhole: a large arc, 10 cm across, over a 2 cm gap; it clears the corners on one side only."""
    corners = [(0.0, 0.0), (4.0, 0.0), (6.0, 0.0), (10.0, 0.0), (10.0, 4.0), (0.0, 4.0)]
    assert (found(polygon(*corners, curves={1: Arc(5.0, True, right)})) == []) is right


def test_two_thousand_edges_take_little_memory() -> None:
    """A comb: its teeth lie side by side, and the boxes of neighbouring edges overlap."""
    count = 1000
    top = [(0.5 * i, 100.0 * (i % 2) + 50.0) for i in range(count)]
    comb = polygon(*top, (0.5 * count, 0.0), (0.0, 0.0))
    tracemalloc.start()
    assert found(comb) == []
    assert tracemalloc.get_traced_memory()[1] < 30e6
    tracemalloc.stop()


def test_at_most_a_hundred_crossings_of_a_panel_are_reported() -> None:
    scribble = polygon(*np.random.default_rng(0).uniform(0, 100, (300, 2)).tolist())
    assert len(found(scribble)) == crossings.MOST_CROSSINGS


@pytest.mark.filterwarnings("error")
def test_edges_of_almost_no_length_cross_nothing_without_warnings() -> None:
    tiny = 5e-324
    assert found(polygon((0, 0), (tiny, 0), (9, 9), (0, 1))) == []


def test_an_edge_is_in_one_seam_beside_those_of_its_stack() -> None:
    """The layers of a pleat are sewn to each other and to a band; without its fold they would be sewn twice."""
    whole = pleated_square()
    assert Rule.STITCHED_TWICE not in {fault.rule for fault in check_pattern(whole)}
    flat = replace(whole, panels=tuple(replace(panel, lines=()) for panel in whole.panels))
    assert Rule.STITCHED_TWICE in {fault.rule for fault in check_pattern(flat)}
