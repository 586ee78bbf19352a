"""Borders of panels as points, and their merging along the seams."""

from dataclasses import replace

import numpy as np
import pytest

from gcd_dataset.curves import Arc, Cubic, Curve
from gcd_dataset.errors import MeshError
from gcd_dataset.generator.mesh.stitch import SewnPoints, edge_counts, merge_points, sample_border, stitch_points
from gcd_dataset.records import Closure, Edge, EdgeRef, Panel, Placement
from tests.generator.mesh.shapes import panel, rectangle, seam, sewn


def test_edges_get_points_at_most_a_spacing_apart() -> None:
    """At a spacing of 1 cm an edge of 10 cm has 11 points, an edge of 10.01 cm has 12."""
    counts = edge_counts(sewn(panel("a", rectangle(10.0, 10.01))), 1.0)
    assert [counts[EdgeRef("a", edge)] for edge in range(4)] == [11, 12, 11, 12]


def test_an_edge_that_rounding_made_longer_keeps_its_points() -> None:
    width = 0.1 + 0.2 + 0.7  # a little over 1
    assert edge_counts(sewn(panel("a", rectangle(10 * width, 5.0))), width / 1.0)[EdgeRef("a", 0)] == 11


@pytest.mark.parametrize("curve", [Arc(20.0, large=False, right=True), Cubic((0.1, 0.6), (0.3, -0.4))])
def test_points_are_equally_spaced_along_a_curve(curve: Curve) -> None:
    """To two thousandths: the arc length is a quadrature, and steps are measured as chords."""
    bent = panel("a", rectangle(30.0, 30.0), curves={0: curve})
    border = sample_border(bent, edge_counts(sewn(bent), 0.25))
    steps = np.linalg.norm(np.diff(border.points[border.edge(0)], axis=0), axis=1)
    assert steps == pytest.approx(steps.mean(), rel=2e-3)
    assert steps.mean() <= 0.25


FLAT = panel("a", rectangle(10.0, 5.0))
BROKEN = {
    "panel b, edge 0 is in seams 0 and 1: split the edge": sewn(
        FLAT, panel("b", rectangle(10.0, 5.0)), seams=(seam(("a", 0), ("b", 0)), seam(("b", 0), ("a", 2)))
    ),
    "seam 0: there is no edge 4 of panel a": sewn(FLAT, seams=(seam(("a", 0), ("a", 4)),)),
    "panel a, edge 2: arc of radius 3 cm cannot span a chord of 10 cm": sewn(
        panel("a", rectangle(10.0, 5.0), curves={2: Arc(3.0, large=False, right=True)})
    ),
    **{
        f"panel a, edge 0 has a length of {length} cm": sewn(panel("a", [(0.0, 0.0), (length, 0.0), (5.0, 5.0)]))
        for length in (0.0, np.nan, np.inf)
    },
}


@pytest.mark.parametrize("message", BROKEN)
def test_an_edge_that_cannot_be_sewn_is_an_error(message: str) -> None:
    with pytest.raises(MeshError, match=message):
        edge_counts(BROKEN[message], 1.0)


def test_an_open_or_empty_outline_is_an_error() -> None:
    corners = np.array(rectangle(10.0, 5.0))
    placement = Placement(np.zeros(3), np.zeros(3))
    gap = Panel("a", corners, (Edge(0, 1), Edge(2, 3), Edge(3, 0)), placement)
    with pytest.raises(MeshError, match="panel a: edge 0 does not end where the next begins"):
        sample_border(gap, edge_counts(sewn(gap), 1.0))
    with pytest.raises(MeshError, match="panel a has no edges"):
        sample_border(Panel("a", corners, (), placement), {})


A, B = ("a", 0), ("b", 0)


def points(*numbers: int) -> np.ndarray:
    return np.array(numbers)


@pytest.mark.parametrize("right_wrong", [False, True])
@pytest.mark.parametrize("closed", [(0.0, 0.5), (0.32, 0.91), (0.0, 1.0), (0.4, 0.41), (1.0, 1.0)])
def test_a_zip_joins_its_share_of_the_length_within_a_mesh_edge(closed: tuple[float, float], right_wrong: bool) -> None:
    left, right = np.arange(21), np.arange(50, 71)
    zipped = replace(seam(A, B, right_wrong=right_wrong), closure=Closure.ZIP, closed=closed)
    joined = stitch_points((zipped,), [(left, right)])
    assert joined.right.tolist() == [50 + k if right_wrong else 70 - k for k in joined.left.tolist()]
    reached = (joined.left[0] / 20, joined.left[-1] / 20) if len(joined.left) else (closed[0],) * 2
    assert reached == pytest.approx(closed, abs=0.5 / 20)
    assert not len(stitch_points((replace(zipped, closure=Closure.OPEN),), [(left, right)]).left)


def test_a_seam_that_closes_on_itself_is_an_error() -> None:
    """Both ends of the edge 0-1-2 are sewn to the point 3."""
    seams = (seam(A, B), seam(("a", 1), ("b", 1)))
    sewn = SewnPoints(points(0, 1, 2, 2), points(3, 4, 5, 3), points(0, 0, 0, 1))
    with pytest.raises(MeshError, match=r"seam 0 \(a edge 0 to b edge 0\): its two ends fall together"):
        merge_points(sewn, points(0, 0, 0, 1, 1, 1), seams)
    behind = (replace(seam(("a", 2), ("b", 2)), closure=Closure.OPEN), *seams)
    with pytest.raises(MeshError, match=r"seam 1 \(a edge 0 to b edge 0\): its two ends fall together"):
        merge_points(replace(sewn, seam=sewn.seam + 1), points(0, 0, 0, 1, 1, 1), behind)


def test_two_points_of_a_panel_are_joined_through_another_only_at_a_dart() -> None:
    """Points 0-1 and 2-3 of panel a are both sewn to 4 of panel b, which brings 1 and 2 together.

    That is an error, unless 1 and 2 are also the mouth of a dart 1-7-2 within panel a.
    """
    seams = (seam(A, B), seam(("a", 1), ("b", 1)), seam(("a", 2), ("a", 3)))
    ends = [(points(0, 1), points(4, 5)), (points(2, 3), points(6, 4)), (points(1, 7), points(7, 2))]
    with pytest.raises(MeshError, match=r"seam 1 \(a edge 1 to b edge 1\) joins two points of one panel"):
        merge_points(stitch_points(seams[:2], ends[:2]), points(0, 0, 0, 0, 1, 1, 1), seams[:2])
    vertex = merge_points(stitch_points(seams, ends), points(0, 0, 0, 0, 1, 1, 1, 0), seams)
    assert vertex[1] == vertex[2] == vertex[4]
    assert vertex[7] not in vertex[:7]
