"""Points merged along seams."""

import numpy as np
import pytest

from gcd_dataset.errors import MeshError
from gcd_dataset.generator.mesh.stitch import SewnPoints, mean_positions, merge_points, stitch_points
from gcd_dataset.records import Seam
from tests.generator.mesh.shapes import seam

A, B = ("a", 0), ("b", 0)


def points(*numbers: int) -> np.ndarray:
    return np.array(numbers)


def test_right_sides_meet_end_to_start() -> None:
    sewn = stitch_points((seam(A, B),), [(points(0, 1, 2), points(5, 6, 7))])
    assert list(zip(sewn.left.tolist(), sewn.right.tolist(), strict=True)) == [(0, 7), (1, 6), (2, 5)]


def test_right_and_wrong_side_meet_start_to_start() -> None:
    sewn = stitch_points((seam(A, B, right_wrong=True),), [(points(0, 1, 2), points(5, 6, 7))])
    assert list(zip(sewn.left.tolist(), sewn.right.tolist(), strict=True)) == [(0, 5), (1, 6), (2, 7)]


def test_seam_vertices_come_first_in_the_order_of_the_seams() -> None:
    """Panel a has points 0-4, b 5-9; first 3, 4 are sewn to 9, 8, then 0, 1 to 6, 5."""
    seams = (seam(A, B), seam(("a", 1), ("b", 1)))
    sewn = stitch_points(seams, [(points(3, 4), points(8, 9)), (points(0, 1), points(5, 6))])
    vertex = merge_points(sewn, np.repeat([0, 1], 5), seams)
    assert vertex.tolist() == [2, 3, 4, 0, 1, 3, 2, 5, 1, 0]
    assert sewn.seam.tolist() == [0, 0, 1, 1]


def test_a_chain_of_seams_is_one_vertex() -> None:
    """Four panels round one point: a-b, b-c and c-d are sewn, so d's corner is a's."""
    seams = tuple(seam((left, 0), (right, 1)) for left, right in ("ab", "bc", "cd"))
    sewn = stitch_points(
        seams, [(points(0, 1), points(4, 3)), (points(3, 5), points(7, 6)), (points(6, 8), points(10, 9))]
    )
    vertex = merge_points(sewn, points(0, 0, 0, 1, 1, 1, 2, 2, 2, 3, 3, 3), seams)
    assert len(set(vertex[[0, 3, 6, 9]].tolist())) == 1
    assert vertex.max() + 1 == 12 - 6


def test_a_vertex_is_the_mean_of_its_points() -> None:
    positions = np.array([(0, 0, 0), (4, 2, 0), (2, 1, 9), (7, 7, 7)], float)
    assert mean_positions(positions, points(0, 0, 0, 1)) == pytest.approx(np.array([(2, 1, 3), (7, 7, 7)]))


def test_a_pattern_without_seams_merges_no_points() -> None:
    assert merge_points(stitch_points((), []), np.zeros(4, int), ()).tolist() == [0, 1, 2, 3]


def test_a_seam_that_closes_on_itself_is_an_error() -> None:
    """Both ends of the edge 0-1-2 are sewn to the point 3."""
    seams = (seam(A, B), seam(("a", 1), ("b", 1)))
    sewn = SewnPoints(points(0, 1, 2, 2), points(3, 4, 5, 3), points(0, 0, 0, 1))
    with pytest.raises(MeshError, match=r"seam 0 \(a edge 0 to b edge 0\): its two ends fall together"):
        merge_points(sewn, points(0, 0, 0, 1, 1, 1), seams)


def two_points_of_a_joined_through_b() -> tuple[tuple[Seam, ...], SewnPoints]:
    """Points 0-1 and 2-3 of panel a are both sewn to 4 of panel b, which brings 1 and 2 together."""
    seams = (seam(A, B), seam(("a", 1), ("b", 1)))
    return seams, stitch_points(seams, [(points(0, 1), points(4, 5)), (points(2, 3), points(6, 4))])


def test_a_panel_joined_to_itself_without_a_dart_is_an_error() -> None:
    seams, sewn = two_points_of_a_joined_through_b()
    with pytest.raises(MeshError, match=r"seam 1 \(a edge 1 to b edge 1\) joins two points of one panel"):
        merge_points(sewn, points(0, 0, 0, 0, 1, 1, 1), seams)


def test_a_dart_may_bring_points_of_a_panel_together() -> None:
    """As in the test above, but 1 and 2 are also the mouth of a dart 1-7-2 within panel a."""
    seams, sewn = two_points_of_a_joined_through_b()
    dart = stitch_points((seam(("a", 2), ("a", 3)),), [(points(1, 7), points(7, 2))])
    both = SewnPoints(
        np.concatenate([sewn.left, dart.left]),
        np.concatenate([sewn.right, dart.right]),
        np.concatenate([sewn.seam, dart.seam + 2]),
    )
    vertex = merge_points(both, points(0, 0, 0, 0, 1, 1, 1, 0), (*seams, seam(("a", 2), ("a", 3))))
    assert vertex[1] == vertex[2] == vertex[4]
    assert vertex[7] not in vertex[:7]
