"""The lattice inside a panel, triangulations, and edge flips."""

import numpy as np
import pytest
import shapely
from scipy.spatial import Delaunay, cKDTree

from gcd_dataset.errors import MeshError
from gcd_dataset.generator.mesh.lattice import PITCH, build_lattice
from gcd_dataset.generator.mesh.triangulate import LONGEST, Loops, restore_segments, triangulate, triangulate_loops
from tests.generator.mesh.shapes import (
    angles,
    areas,
    circle,
    directed_edges,
    loop,
    rectangle,
    sides,
    star,
    undirected_edges,
)

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
    assert_delaunay(loop(OUTLINES[name], 1.0))


def assert_filled_once(border: np.ndarray) -> None:
    seeds, faces = triangulate(border, 1.0)
    points = np.concatenate([border, seeds])
    assert (areas(points, faces) > 0).all()
    assert areas(points, faces).sum() == pytest.approx(shapely.Polygon(border).area)
    once = set(map(tuple, directed_edges(faces).tolist()))
    assert len(once) == 3 * len(faces)
    n = len(border)
    assert {(u, v) for u, v in once if (v, u) not in once} == {(i, (i + 1) % n) for i in range(n)}
    assert len(np.unique(faces)) == len(points)


def test_loops_in_one_plane_are_filled_once_each() -> None:
    """Of two outlines side by side, with the same lattice, each is filled, and the gap between them is not."""
    first, second = loop(OUTLINES["dart"], 1.0), loop(OUTLINES["star 3"], 1.0)
    second = second - second.min(axis=0) + [first[:, 0].max() + 3.0, 0.0]
    loops = Loops.numbered(np.concatenate([first, second]), np.repeat([0, 1], [len(first), len(second)]))
    made = triangulate_loops(loops, 1.0, build_lattice(loops.points, 1.0, after=loops.after))
    once = set(map(tuple, directed_edges(made.faces).tolist()))
    assert {(u, v) for u, v in once if (v, u) not in once} == set(enumerate(loops.after.tolist()))
    in_second = made.points[made.faces].mean(axis=1)[:, 0] > first[:, 0].max()
    for own, border in ((~in_second, first), (in_second, second)):
        assert areas(made.points, made.faces[own]).sum() == pytest.approx(shapely.Polygon(border).area)
        assert (areas(made.points, made.faces[own]) > 0.0).all()


def assert_delaunay(border: np.ndarray) -> None:
    """The two angles opposite an inner edge add up to at most 180°."""
    seeds, faces = triangulate(border, 1.0)
    looks = angles(np.concatenate([border, seeds]), faces)
    opposite = {
        (int(face[i - 2]), int(face[i - 1])): float(look[i])
        for face, look in zip(faces, looks, strict=True)
        for i in range(3)
    }
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
    assert_delaunay(border)


@pytest.mark.parametrize("name", OUTLINES)
@pytest.mark.parametrize("spacing", [0.7, 1.6])
def test_triangles_are_well_shaped(name: str, spacing: float) -> None:
    """An angle under 20° is opposite a short side of the outline, where no seed can help."""
    border = loop(OUTLINES[name], spacing)
    seeds, faces = triangulate(border, spacing)
    points = np.concatenate([border, seeds])
    over_border = (np.roll(faces, -1, axis=1) < len(border)) & (np.roll(faces, 1, axis=1) < len(border))
    assert (angles(points, faces)[~over_border] > 20.0).all()
    assert sides(points, faces).max() <= LONGEST * spacing


def test_a_disc_is_meshed_as_regularly_as_its_inside() -> None:
    border = circle(20.0, 1.0)
    seeds, faces = triangulate(border, 1.0)
    points = np.concatenate([border, seeds])
    assert angles(points, faces).min() > 28.0
    assert np.median(sides(points, faces)) == pytest.approx(0.97, abs=1e-6)
    assert len(points) - len(undirected_edges(faces)[0]) + len(faces) == 1  # Euler


@pytest.mark.parametrize("gathered", [1.5, 2.0, 3.0])
def test_a_gathered_edge_is_graded(gathered: float) -> None:
    """One side of a square has points ``gathered`` times as dense; triangles grow from it into the square."""
    dense = loop(rectangle(20.0, 20.0), 1.0 / gathered)[: int(20 * gathered)]
    border = np.concatenate([dense, loop(rectangle(20.0, 20.0), 1.0)[20:]])
    seeds, faces = triangulate(border, 1.0)
    points = np.concatenate([border, seeds])
    assert angles(points, faces).min() > 20.0
    assert sides(points, faces).max() <= LONGEST
    assert areas(points, faces).sum() == pytest.approx(400.0)


def test_the_mesh_scales_with_the_outline() -> None:
    border = loop(star(4), 1.0)
    seeds, faces = triangulate(border, 1.0)
    larger, same = triangulate(2.0 * border, 2.0)
    assert np.array_equal(faces, same)
    assert larger == pytest.approx(2.0 * seeds, abs=1e-9)


SLIT = np.array([(0, 0), (6, 0), (6, 2), (2, 2.1), (6, 2.2), (6, 4), (0, 4)], float)
"""A slit 0.2 cm wide. Its sides are not edges of the Delaunay triangulation: the points across are nearer."""


def triangles(points: np.ndarray) -> np.ndarray:
    faces = Delaunay(points).simplices
    return np.where(areas(points, faces)[:, None] < 0, faces[:, ::-1], faces)


def loop_of(n: int) -> np.ndarray:
    """The next point of each on a loop of n points."""
    return np.roll(np.arange(n), -1)


def has_segments(faces: np.ndarray, n: int) -> bool:
    edges, _ = undirected_edges(faces)
    loop = np.sort(np.stack([np.arange(n), (np.arange(n) + 1) % n], axis=1), axis=1)
    return set(map(tuple, loop.tolist())) <= set(map(tuple, edges.tolist()))


def dense_slit(random: np.random.Generator) -> tuple[np.ndarray, int]:
    """Random points, and a polygon through some of them with sides close to others."""
    border = SLIT + random.uniform(-0.02, 0.02, SLIT.shape)
    inside = random.uniform(0.05, 1.9, (40, 2)) * [3.0, 1.0]
    return np.concatenate([border, inside, inside + [0.0, 2.15]]), len(border)


@pytest.mark.parametrize("seed", range(4))
def test_every_segment_is_an_edge_afterwards(seed: int) -> None:
    points, n = dense_slit(np.random.default_rng(seed))
    before = triangles(points)
    assert not has_segments(before, n)
    after = restore_segments(points, before, loop_of(n))
    assert has_segments(after, n)
    assert (areas(points, after) > 0).all()
    assert areas(points, after).sum() == pytest.approx(areas(points, before).sum())
    assert len(np.unique(directed_edges(after), axis=0)) == 3 * len(after)  # no face lies on another


@pytest.mark.parametrize("seed", range(4))
def test_all_edges_except_segments_are_delaunay(seed: int) -> None:
    """The two angles opposite every other edge add up to at most half a turn."""
    points, n = dense_slit(np.random.default_rng(seed))
    faces = restore_segments(points, triangles(points), loop_of(n))
    opposite = {(int(f[k]), int(f[k - 2])): int(f[k - 1]) for f in faces for k in range(3)}
    for (u, v), apex in opposite.items():
        if (v, u) in opposite and not (max(u, v) < n and (v - u) % n in (1, n - 1)):
            assert angle(points, u, apex, v) + angle(points, u, opposite[v, u], v) <= np.pi + 1e-6


def angle(points: np.ndarray, a: int, apex: int, b: int) -> float:
    to_a, to_b = points[a] - points[apex], points[b] - points[apex]
    return float(np.arccos(to_a @ to_b / np.linalg.norm(to_a) / np.linalg.norm(to_b)))


def test_a_triangulation_with_all_segments_is_unchanged() -> None:
    points = np.array([(0, 0), (2, 0), (2, 1.1), (0, 1)], float)
    faces = triangles(points)
    assert restore_segments(points, faces, loop_of(4)) is faces


def test_a_point_on_a_segment_is_an_error() -> None:
    """The outline 0-1-2-3 runs through its own corner 3 on the way from 0 to 1."""
    points = np.array([(0, 0), (4, 0), (2, 3), (2, 0), (2, -3)], float)
    with pytest.raises(MeshError, match=r"the outline touches itself near \(0.00, 0.00\) cm"):
        restore_segments(points, triangles(points), loop_of(4))


SPACING = 0.8


def test_all_triangles_are_equilateral_and_counter_clockwise() -> None:
    lattice = build_lattice(circle(12.0, SPACING), SPACING)
    assert len(lattice.faces) > 500
    assert sides(lattice.points, lattice.faces) == pytest.approx(PITCH * SPACING)
    assert areas(lattice.points, lattice.faces) == pytest.approx(np.sqrt(3) / 4 * (PITCH * SPACING) ** 2)


@pytest.mark.parametrize("seed", range(5))
def test_seeds_lie_inside_and_off_the_border(seed: int) -> None:
    border = loop(star(seed), SPACING)
    lattice = build_lattice(border, SPACING)
    assert shapely.contains_xy(shapely.Polygon(border), *lattice.points.T).all()
    distance, _ = cKDTree(border).query(lattice.points)
    assert distance.min() >= 0.6 * PITCH * SPACING


@pytest.mark.parametrize("seed", range(5))
def test_filled_triangles_hold_no_other_point_in_their_circles(seed: int) -> None:
    """The triangles are therefore Delaunay; the border does not cross them either."""
    border = loop(star(seed), SPACING)
    lattice = build_lattice(border, SPACING)
    centres = lattice.points[lattice.faces].mean(axis=1)
    radius = PITCH * SPACING / np.sqrt(3)
    nearest, _ = cKDTree(np.concatenate([border, lattice.points])).query(centres)
    assert nearest.min() > radius * (1 - 1e-9)
    filled = shapely.union_all(shapely.polygons(lattice.points[lattice.faces]))
    assert not filled.intersects(shapely.LinearRing(border))


def test_covers_is_true_only_in_filled_triangles() -> None:
    """At random points in and around the panel, and at the centre of each filled triangle."""
    lattice = build_lattice(loop(star(3), SPACING), SPACING)
    filled = shapely.union_all(shapely.polygons(lattice.points[lattice.faces])).buffer(1e-9)
    asked = np.random.default_rng(0).uniform(-30.0, 30.0, (4000, 2))
    assert np.array_equal(lattice.covers(asked), shapely.contains_xy(filled, *asked.T))
    assert lattice.covers(lattice.points[lattice.faces].mean(axis=1)).all()


def test_points_of_a_face_are_found_in_it() -> None:
    lattice = build_lattice(loop(star(4), 1.0), 1.0)
    shares = np.random.default_rng(0).dirichlet(np.ones(3), size=len(lattice.faces))
    points = np.einsum("fk,fkd->fd", shares, lattice.points[lattice.faces])
    assert (lattice.faces_at(points) == np.arange(len(lattice.faces))).all()
    assert (lattice.faces_at(loop(star(4), 1.0)) == -1).all()


def test_a_point_removes_the_triangles_with_the_point_in_their_circumcircle() -> None:
    lattice = build_lattice(loop(rectangle(14.0, 9.0), SPACING), SPACING)
    points = np.random.default_rng(1).uniform((1.0, 1.0), (13.0, 8.0), (7, 2))
    left = lattice.without(points)
    centres = lattice.points[lattice.faces].mean(axis=1)
    radius = PITCH * SPACING / np.sqrt(3)
    free = cKDTree(points).query(centres)[0] > radius
    assert np.array_equal(left.faces, lattice.faces[free])


def test_the_rim_has_all_seeds_that_filled_triangles_do_not_surround() -> None:
    """The filled triangles round a seed off the rim have six outer edges, a closed ring."""
    lattice = build_lattice(circle(9.0, SPACING), SPACING)
    edges, faces_of_edge = undirected_edges(lattice.faces)
    outer = np.unique(edges[faces_of_edge == 1])
    unused = np.setdiff1d(np.arange(len(lattice.points)), lattice.faces)
    assert np.array_equal(lattice.rim, np.union1d(outer, unused))


def test_a_panel_too_small_for_seeds_has_none() -> None:
    lattice = build_lattice(loop(rectangle(1.0, 1.0), 1.0), 1.0)
    assert len(lattice.points) == len(lattice.faces) == len(lattice.rim) == 0
