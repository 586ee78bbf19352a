"""The lattice inside a panel, triangulations, and edge flips."""

from concurrent.futures import ThreadPoolExecutor, wait

import numpy as np
import pytest
import shapely
from jaxtyping import Float, Int

from gcd_dataset.errors import MeshError
from gcd_dataset.generator.device import launch_lock
from gcd_dataset.generator.mesh.triangulate import LONGEST, triangulator
from gcd_dataset.meshedges import mesh_edges
from tests.generator.mesh.shapes import angles, areas, directed_edges, loop, rectangle, sides, star

NARROW_SLIT = [(0.0, 0.0), (20.0, 0.0), (20.0, 8.0), (4.0, 8.05), (20.0, 8.1), (20.0, 16.0), (0.0, 16.0)]
"""A slit from the right edge nearly to the left, narrower than the spacing of its points."""

OUTLINES: dict[str, list[tuple[float, float]]] = {
    "square": rectangle(12.0, 12.0),
    "band": rectangle(40.0, 1.0),
    "narrower than a spacing": rectangle(30.0, 0.4),
    "L": [(0.0, 0.0), (15.0, 0.0), (15.0, 5.0), (5.0, 5.0), (5.0, 15.0), (0.0, 15.0)],
    "dart": [(0.0, 0.0), (9.0, 0.0), (10.0, 12.0), (11.0, 0.0), (20.0, 0.0), (20.0, 20.0), (0.0, 20.0)],
    "slit": NARROW_SLIT,
    "wedge": [(0.0, 0.0), (30.0, 0.0), (30.0, 6.0)],
    "one triangle": [(0.0, 0.0), (1.0, 0.0), (0.5, 0.8)],
    **{f"star {seed}": star(seed) for seed in range(6)},
}


@pytest.mark.parametrize("name", OUTLINES)
def test_triangles_fill_the_outline_once(name: str) -> None:
    """Faces are counter-clockwise and have the outline's area; their border is exactly its segments; no edge flips."""
    assert_filled_once(loop(OUTLINES[name], 1.0))


def triangles_in(border: np.ndarray, spacing: float = 1.0) -> tuple[Float[np.ndarray, "p 2"], Int[np.ndarray, "f 3"]]:
    """The points of an outline and of its lattice, and the faces between them."""
    seeds, faces = triangulator().fill(border, spacing)
    return np.concatenate([border, seeds]), faces


def assert_filled_once(border: np.ndarray) -> None:
    """And the two angles opposite an inner edge add up to at most 180°."""
    points, faces = triangles_in(border)
    assert (areas(points, faces) > 0).all()
    assert areas(points, faces).sum() == pytest.approx(shapely.Polygon(border).area)
    assert len(np.unique(faces)) == len(points)
    sides_by_corner = map(tuple, directed_edges(np.roll(faces, -1, axis=1)).tolist())
    opposite = dict(zip(sides_by_corner, angles(points, faces).ravel().tolist(), strict=True))
    assert len(opposite) == 3 * len(faces)
    n = len(border)
    assert {(u, v) for u, v in opposite if (v, u) not in opposite} == {(i, (i + 1) % n) for i in range(n)}
    inner = [angle + opposite[v, u] for (u, v), angle in opposite.items() if (v, u) in opposite]
    assert max(inner, default=0.0) < 180.0 + 1e-3


@pytest.mark.parametrize("width", [0.01, 0.2])
@pytest.mark.parametrize("gathered", [1.5, 3.0])
def test_a_slit_with_a_gathered_side_is_filled_once(width: float, gathered: float) -> None:
    """Grading from the dense side of a slit does not cross to the other side."""
    corners = [(0.0, 0.0), (20.0, 0.0), (20.0, 7.0), (12.6, 8.6), (20.0, 7.0 + width), (20.0, 16.0), (0.0, 16.0)]
    plain, dense = loop(corners, 1.0), loop(corners, 1.0 / gathered)
    ends, dense_ends = ([int(np.argmin(np.linalg.norm(x - c, axis=1))) for c in corners] for x in (plain, dense))
    border = np.concatenate([plain[: ends[2]], dense[dense_ends[2] : dense_ends[3]], plain[ends[3] :]])
    assert_filled_once(border)


@pytest.mark.parametrize("name", OUTLINES)
@pytest.mark.parametrize("spacing", [0.7, 1.6])
def test_triangles_are_well_shaped(name: str, spacing: float) -> None:
    """An angle under 20° is opposite a short side of the outline, where no seed can help."""
    border = loop(OUTLINES[name], spacing)
    points, faces = triangles_in(border, spacing)
    over_border = (np.roll(faces, -1, axis=1) < len(border)) & (np.roll(faces, 1, axis=1) < len(border))
    assert (angles(points, faces)[~over_border] > 20.0).all()
    assert sides(points, faces).max() <= LONGEST * spacing


def test_a_disc_is_meshed_as_regularly_as_its_inside() -> None:
    turn = np.linspace(0.0, 2 * np.pi, 126, endpoint=False)  # 126 points at most 1 cm apart
    border = 20.0 * np.column_stack([np.cos(turn), np.sin(turn)])
    points, faces = triangles_in(border)
    assert angles(points, faces).min() > 28.0
    assert np.median(sides(points, faces)) == pytest.approx(0.97, abs=1e-6)
    assert len(points) - len(mesh_edges(faces).ends) + len(faces) == 1  # Euler


@pytest.mark.parametrize("gathered", [1.5, 2.0, 3.0])
def test_a_gathered_edge_is_graded(gathered: float) -> None:
    """One side of a square has points ``gathered`` times as dense; triangles grow from it into the square."""
    dense = loop(rectangle(20.0, 20.0), 1.0 / gathered)[: int(20 * gathered)]
    points, faces = triangles_in(np.concatenate([dense, loop(rectangle(20.0, 20.0), 1.0)[20:]]))
    assert angles(points, faces).min() > 20.0
    assert sides(points, faces).max() <= LONGEST
    assert areas(points, faces).sum() == pytest.approx(400.0)


def test_points_of_the_lattice_are_numbered_row_by_row() -> None:
    """Rows and places in them ascend: a stored mesh is half as large as with its points in the order of insertion."""
    seeds, _ = triangulator().fill(loop(rectangle(30.0, 20.0), 1.0), 1.0)
    lattice = seeds[:500]  # those of the refinement follow all of the lattice
    assert (np.lexsort((lattice[:, 0], lattice[:, 1].round(6))) == np.arange(500)).all()


def test_an_outline_with_a_spike_of_no_width_or_through_its_own_corner_is_refused() -> None:
    spike = [(0.0, 0.0), (20, 0), (20, 5), (30, 5 + 1e-11), (20, 5 + 2e-11), (20, 10), (0, 10)]
    through = np.array([(0, 0), (2, 0), (2, -2), (0, -2), (1, 0)], float)
    for border in (loop(spike, 1.0), through):
        with pytest.raises(MeshError, match=r"the outline touches itself near \(.*\) cm: move its edges apart"):
            triangulator().fill(border, 1.0)


@pytest.mark.parametrize("width", [1e-9, 1e-6, 1e-3])
def test_a_narrow_slit_is_left_open(width: float) -> None:
    corners = [(0.0, 0.0), (20, 0), (20, 5), (7, 5 + 0.5 * width), (20, 5 + width), (20, 10), (0, 10)]
    assert_filled_once(loop(corners, 1.0))


def test_an_outline_whose_corners_lie_on_a_line_is_filled() -> None:
    """Of a skirt with slits whose tips lie on a line but for rounding; such corners were left without a triangle."""
    border = np.array(
        [
            (6.453446904533337, 43.70709385756989),  # on a line with the next corner and the fifth
            (29.208660835774463, 43.30990012094459),
            (40.497443607016415, 41.12104736),
            (40.54185570420572, 42.116175305210646),
            (40.58626780139503, 43.11130325263195),
            (43.444193492629466, 101.43056171130208),
            (2.5155341923941754, 38.45688064783383),
        ]
    )
    assert_filled_once(border)


@pytest.mark.parametrize("seed", range(3))
def test_each_point_is_found_in_the_triangle_that_holds_it(seed: int) -> None:
    """Means of three corners with positive weights; a point beside the outline is found in the triangle there."""
    border, random = loop(star(seed), 1.0), np.random.default_rng(seed)
    points, faces = triangles_in(border)
    inside = np.einsum("fk,fkd->fd", random.dirichlet(np.ones(3), size=len(faces)), points[faces])
    order = random.permutation(len(faces))
    assert (triangulator().holding(inside[order]) == order).all()
    middle = 0.5 * (border[0] + border[1])
    outward = (border[1] - border[0])[::-1] * [1.0, -1.0]
    found = faces[triangulator().holding(middle[None] + 0.01 * outward)[0]]
    assert {0, 1} <= set(found.tolist())


def test_an_outline_is_not_filled_while_another_thread_captures_a_graph() -> None:
    """Warp's capture is one for all threads: a launch in another one would look it up while it ends."""
    border = loop(rectangle(8.0, 5.0), 1.0)
    seeds, _ = triangulator().fill(border, 1.0)
    with ThreadPoolExecutor(1) as pool:
        pool.submit(triangulator).result()
        with launch_lock:
            filling = pool.submit(triangulator().fill, border, 1.0)
            assert not wait([filling], timeout=0.2).done
        assert (filling.result()[0] == seeds).all()
