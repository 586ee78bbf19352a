"""The triangular lattice inside a panel."""

import numpy as np
import pytest
import shapely
from scipy.spatial import cKDTree

from gcd_dataset.generator.mesh.lattice import PITCH, build_lattice
from tests.generator.mesh.shapes import areas, circle, loop, rectangle, sides, star, undirected_edges

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
