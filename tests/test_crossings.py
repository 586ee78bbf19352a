"""Self-intersections of outlines: the broad phase misses none and clears common outlines without sampling."""

import tracemalloc
from collections.abc import Mapping
from itertools import combinations

import numpy as np
import pytest
import shapely
from hypothesis import assume, example, given, settings
from hypothesis import strategies as st

from gcd_dataset import crossings
from gcd_dataset.crossings import edge_hulls, find_crossings
from gcd_dataset.curves import LINE, Arc, Cubic, Curve, Quadratic, curve_length, sample_curve
from gcd_dataset.records import Edge, Panel, Placement

HERE = Placement(np.zeros(3), np.zeros(3))

coordinate = st.integers(-8, 8).map(lambda n: n / 2)  # a coarse grid: edges often touch, overlap and run back
control = st.tuples(coordinate, coordinate)
curves = st.one_of(
    st.just(LINE),
    st.builds(Quadratic, control),
    st.builds(Cubic, control, control),
    st.builds(Arc, st.floats(12.0, 40.0), st.booleans(), st.booleans()),
)
loops = st.lists(st.tuples(coordinate, coordinate, curves), min_size=2, max_size=6)


def panel(corners: list[tuple[float, float]], bent: Mapping[int, Curve] | None = None) -> Panel:
    count = len(corners)
    edges = tuple(Edge(i, (i + 1) % count, (bent or {}).get(i, LINE)) for i in range(count))
    return Panel("front", np.array(corners, float), edges, HERE)


def drawn(loop: list[tuple[float, float, Curve]]) -> Panel:
    shape = panel([(x, y) for x, y, _ in loop], {i: curve for i, (_, _, curve) in enumerate(loop)})
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
    shape = drawn(loop)
    for index, hull in enumerate(edge_hulls(shape)):
        assert hull[[0, 3]].tolist() == [complex(*end) for end in shape.edge_ends(index)]
        around = shapely.MultiPoint(np.stack([hull.real, hull.imag], axis=1)).convex_hull
        assert shapely.distance(around, shapely.points(sampled(shape, index))).max() < 1e-6


@given(loops)
@example([(0.0, 0.0, LINE), (-1.5, -3.0, Quadratic((-0.5, 0.0))), (-1.0, -3.5, LINE)])
def test_the_broad_phase_misses_no_crossing(loop: list[tuple[float, float, Curve]]) -> None:
    """Cleared pairs meet in a shared corner at most; cleared edges do not meet themselves."""
    shape = drawn(loop)
    hulls = edge_hulls(shape)
    lines = [shapely.LineString(sampled(shape, index)) for index in range(len(loop))]
    assert all(lines[index].is_simple for index in np.flatnonzero(crossings._monotone(hulls)))
    proposed = {(i, j) for _, _, pairs in crossings._broad_phase([hulls]) for i, j in pairs.tolist()}
    for i, j in set(combinations(range(len(loop)), 2)) - proposed:
        met = shapely.get_coordinates(shapely.intersection(lines[i], lines[j]))
        corner = shape.vertices[sorted({i, (i + 1) % len(loop)} & {j, (j + 1) % len(loop)})]
        assert len(corner) == 1 or not len(met)
        assert np.abs(met - corner[:1]).max(initial=0) < 1e-9  # rounding may split it into two points


def test_a_common_outline_is_not_sampled(monkeypatch: pytest.MonkeyPatch) -> None:
    """A shirt's front: hem, side, armhole, shoulder, neckline, middle."""

    def refuse(*_: object) -> None:
        raise AssertionError("sampled")

    monkeypatch.setattr(crossings, "_polyline", refuse)
    corners = [(0.0, 0.0), (26.0, 0.0), (27.0, 36.0), (18.0, 57.0), (8.0, 60.0), (0.0, 50.0)]
    bent: dict[int, Curve] = {2: Cubic((0.3, 0.25), (0.7, 0.3)), 4: Arc(11.0, False, False)}
    assert found(panel(corners, bent)) == []


def test_edges_that_run_back_over_themselves_and_each_other() -> None:
    there_and_back = [(0.0, 0.0), (10.0, 0.0), (4.0, 0.0), (4.0, 5.0)]
    assert found(panel(there_and_back)) == [(0, 1), (0, 2)]
    too_far = {0: Quadratic((1.5, 0.0))}  # runs along its chord, beyond the end, and back
    assert (0, 0) in found(panel([(0.0, 0.0), (10.0, 0.0), (5.0, 8.0)], too_far))


def test_a_curve_that_runs_round_its_own_end_meets_the_next_edge() -> None:
    round_the_end = {0: Cubic((1.3, -0.9), (1.3, 0.9))}  # passes through (-1, 0) before it ends at (0, 0)
    assert (0, 1) in found(panel([(10.0, 0.0), (0.0, 0.0), (-4.0, 0.0), (3.0, -20.0)], round_the_end))


@pytest.mark.parametrize("right", [True, False])
def test_a_large_arc_is_tested_beyond_its_chord(right: bool) -> None:
    """A keyhole: a large arc, 10 cm across, over a 2 cm gap; it clears the panel on one side only."""
    corners = [(0.0, 0.0), (4.0, 0.0), (6.0, 0.0), (10.0, 0.0), (10.0, 4.0), (0.0, 4.0)]
    assert (found(panel(corners, {1: Arc(5.0, True, right)})) == []) is right


def test_the_hull_of_a_line_lies_on_the_line() -> None:
    (hull, *_) = edge_hulls(panel([(0.0, 0.0), (9.0, 3.0), (0.0, 9.0)]))
    assert hull == pytest.approx(np.array([0, 3 + 1j, 6 + 2j, 9 + 3j]))


@given(st.lists(loops, min_size=2, max_size=4))
def test_a_batch_of_panels_gives_the_same_candidates_as_each_panel_alone(
    drawn_loops: list[list[tuple[float, float, Curve]]],
) -> None:
    shapes = [drawn(loop) for loop in drawn_loops]
    hulls = [edge_hulls(shape) for shape in shapes]
    alone = [candidates([hull]).get(0, ([], [])) for hull in hulls]
    together = candidates(hulls)
    assert [together.get(number, ([], [])) for number in range(len(shapes))] == alone


def candidates(hulls: list[np.ndarray]) -> dict[int, tuple[list[int], list[list[int]]]]:
    """Panel number to the candidates of the broad phase: single edges, and pairs of edges."""
    return {number: (singles.tolist(), pairs.tolist()) for number, singles, pairs in crossings._broad_phase(hulls)}


@settings(max_examples=30)
@given(st.lists(loops, min_size=1, max_size=3), st.sampled_from([1, 12]))
def test_a_sweep_finds_the_same_pairs_as_all_comparisons(
    drawn_loops: list[list[tuple[float, float, Curve]]], copies: int
) -> None:
    """Each outline alone, and repeated twelve times in one loop, where edges coincide; in chunks of a few pairs."""
    hulls = [edge_hulls(drawn(loop * copies)) for loop in drawn_loops]
    at_once = candidates(hulls)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(crossings, "AT_ONCE", 50)
        patch.setattr(crossings, "FEW", 0)
        assert candidates(hulls) == at_once
        patch.setattr(crossings, "FEW", 10**6)
        assert candidates(hulls) == at_once
    for hull in hulls:
        one, other = np.triu_indices(len(hull), k=1)
        near = ~crossings._boxes_apart(hull, one, other)
        assert crossings._sweep(hull).T.tolist() == np.stack([one[near], other[near]], axis=1).tolist()


def test_two_thousand_edges_take_little_memory() -> None:
    """A comb: its teeth lie side by side, and the boxes of neighbouring edges overlap."""
    count = 1000
    top = [(0.5 * i, 100.0 * (i % 2) + 50.0) for i in range(count)]
    comb = panel([*top, (0.5 * count, 0.0), (0.0, 0.0)])
    tracemalloc.start()
    assert found(comb) == []
    assert tracemalloc.get_traced_memory()[1] < 30e6
    tracemalloc.stop()


def test_at_most_a_hundred_crossings_of_a_panel_are_reported() -> None:
    scribble = panel([(float(x), float(y)) for x, y in np.random.default_rng(0).uniform(0, 100, (300, 2))])
    assert len(found(scribble)) == crossings.MOST_CROSSINGS


@pytest.mark.filterwarnings("error")
def test_edges_of_almost_no_length_cross_nothing_without_warnings() -> None:
    tiny = 5e-324
    assert found(panel([(0, 0), (tiny, 0), (9, 9), (0, 1)])) == []
