"""Sections, tapes, shortest paths, nearest points and subdivision, on shapes with known answers."""

import numpy as np
import pytest
import trimesh

from gcd_dataset.errors import BodyError
from gcd_dataset.generator.body.geodesic import GeodesicGraph, graph_between
from gcd_dataset.generator.body.measuring import narrowest_ring
from gcd_dataset.generator.body.repair import BodyScan
from gcd_dataset.generator.body.section import clipped, contour_length, girth, loops, rough_girths, section, tape
from gcd_dataset.generator.body.surface import SkinSurface, refine
from gcd_dataset.generator.body.tailor import larger_thigh, over_back
from tests.helpers import patch


def test_nearest_points_of_a_box_with_large_triangles() -> None:
    box = trimesh.creation.box((40.0, 100.0, 20.0))
    points = np.array([(30.0, 11.0, 3.0), (1.0, 60.0, 2.0), (25.0, 55.0, 13.0), (19.0, 0.0, 0.0)])
    near = SkinSurface.of(box.vertices, box.faces).nearest(points)
    expected = np.array([(20.0, 11.0, 3.0), (1.0, 50.0, 2.0), (20.0, 50.0, 10.0), (20.0, 0, 0)])
    assert near.points == pytest.approx(expected)
    assert near.distances == pytest.approx([10.0, 10.0, np.hypot(np.hypot(5, 5), 3), 1.0])
    assert np.all(near.faces < len(box.faces))


def test_subdivision_of_slivers_is_bounded() -> None:
    column = trimesh.creation.cylinder(20.0, 170.0, sections=1000)
    surface = SkinSurface.of(column.vertices, column.faces)
    assert len(surface.corners) < 400_000
    near = surface.nearest(np.array([(30.0, 0.0, 10.0), (0.0, 24.0, -50.0)]))
    assert near.distances == pytest.approx([10.0, 4.0], abs=0.1)


def test_two_loops_of_a_torus_are_distinguished() -> None:
    """A ring of radius 20 and thickness 2 · 5, standing in the plane z = 0."""
    shape = trimesh.creation.torus(20.0, 5.0, major_sections=256, minor_sections=128)
    cut = section(shape.vertices, shape.faces, 1, 0.01)
    loop = loops(cut)
    assert len(np.unique(loop)) == 2
    for each in (0, 1):
        assert contour_length(cut[loop == each]) == pytest.approx(2 * np.pi * 5.0, rel=1e-3)
    assert larger_thigh(cut, 0.0) == pytest.approx(2 * np.pi * 5.0, rel=1e-3)
    assert girth(cut[:, 0][:, [0, 2]]) == pytest.approx(2 * np.pi * 5.0 + 80.0, rel=1e-3)  # a tape round both loops


def test_girths_of_an_ellipse_and_a_box() -> None:
    angle = np.linspace(0.0, 2 * np.pi, 2000, endpoint=False)
    ellipse = np.stack([15.0 * np.cos(angle), 0.0 * angle, 10.0 * np.sin(angle)], axis=1)
    ramanujan = np.pi * (3 * 25.0 - np.sqrt((3 * 15.0 + 10.0) * (15.0 + 3 * 10.0)))
    assert girth(ellipse[:, [0, 2]]) == pytest.approx(ramanujan, rel=1e-4)
    box = np.array([(x, 0.0, z) for x in (-12.0, 12.0) for z in (-7.0, 7.0)])
    assert girth(box[:, [0, 2]]) == pytest.approx(2 * (24.0 + 14.0))
    left, right = np.array([12.0, 0.0, 0.0]), np.array([-12.0, 0.0, 0.0])
    assert over_back(box, left, right) == pytest.approx(24.0 + 2 * 7.0)


def test_a_geodesic_between_any_two_points_of_a_ball() -> None:
    ball = trimesh.creation.icosphere(subdivisions=4, radius=10.0)
    surface = SkinSurface.of(ball.vertices, ball.faces)
    start, end = surface.nearest(np.array([(1.0, 9.0, 3.0), (9.0, 1.0, -2.0)])).points
    graph, vertices = graph_between(ball.vertices, ball.faces, start, end)
    angle = np.arccos(start @ end / np.linalg.norm(start) / np.linalg.norm(end))
    assert graph.length(vertices) == pytest.approx(10.0 * angle, rel=0.01)


def test_the_narrowest_ring_of_an_hourglass() -> None:
    y = np.linspace(-10.0, 10.0, 81)
    glass = trimesh.creation.revolve(np.stack([4.0 + 0.05 * (y - 1.0) ** 2, y], axis=1), sections=200)
    glass.apply_transform(trimesh.transformations.rotation_matrix(-np.pi / 2, [1, 0, 0]))
    angle = np.linspace(0, 2 * np.pi, 20, endpoint=False)
    ring = np.stack([4.0 * np.cos(angle), 0 * angle, 4.0 * np.sin(angle)], axis=1)
    skin = np.zeros(len(glass.faces), bool)
    found = narrowest_ring(glass.vertices, glass.faces, ring, np.arange(-6, 7) * 0.5, skin)
    assert np.linalg.norm(np.roll(found, -1, axis=0) - found, axis=1).sum() == pytest.approx(2 * np.pi * 4.0, rel=1e-3)
    assert found[:, 1] == pytest.approx(found[0, 1])


def test_a_flat_limb_has_no_ring() -> None:
    strip = np.array([[-3.0, -9.0, 0.0], [3.0, -9.0, 0.0], [3.0, 9.0, 0.0], [-3.0, 9.0, 0.0]])
    ring = np.array([[-3.0, 0.0, -1.0], [3.0, 0.0, -1.0], [0.0, 0.0, 1.0]])
    faces = np.array([[0, 1, 2], [0, 2, 3]])
    with pytest.raises(BodyError, match="no skin goes all round the right wrist"):
        narrowest_ring(strip, faces, ring, np.array([-1.0, 0.0, 1.0]), np.zeros(2, bool))


def test_a_scan_is_welded_and_its_holes_are_patched() -> None:
    ball = trimesh.creation.icosphere(subdivisions=3, radius=50.0)
    open_faces = ball.faces[ball.vertices[ball.faces][:, :, 1].max(axis=1) < 45.0]
    scan = BodyScan.of(ball.vertices[open_faces].reshape(-1, 3), np.arange(open_faces.size).reshape(-1, 3), "ball")
    mesh = trimesh.Trimesh(scan.vertices, scan.faces, process=False)
    assert mesh.is_watertight
    assert mesh.is_winding_consistent
    skin = trimesh.triangles.area(ball.vertices[open_faces]).sum()
    assert mesh.area_faces[~scan.patched].sum() == pytest.approx(skin)
    assert scan.vertices[scan.source[5 * 3 + 1]] == pytest.approx(ball.vertices[open_faces[5, 1]])


def test_an_empty_scan_and_one_with_an_invalid_vertex_are_errors() -> None:
    with pytest.raises(BodyError, match="0 triangles with an area"):
        BodyScan.of(np.zeros((3, 3)), np.array([[0, 1, 2]]), "flat")
    for odd in (3, -7, 10**6):
        with pytest.raises(BodyError, match=f"flat: a face names vertex {odd} of 3"):
            BodyScan.of(np.zeros((3, 3)), np.array([[0, 1, 2], [0, odd, 2]]), "flat")


@pytest.mark.parametrize("share", [0.0, 0.3, 1.0])
def test_a_refined_closed_mesh_stays_closed_and_keeps_its_vertices(share: float) -> None:
    ball = trimesh.creation.icosphere(subdivisions=3, radius=5.0)
    marked = np.random.default_rng(0).random(len(ball.faces)) < share
    matrix, faces = refine(np.asarray(ball.faces), marked, len(ball.vertices))
    finer = trimesh.Trimesh(matrix @ ball.vertices, faces, process=False)
    assert finer.is_watertight
    assert finer.is_winding_consistent
    assert finer.volume == pytest.approx(ball.volume, rel=0.02)
    assert np.abs(finer.vertices[: len(ball.vertices)] - ball.vertices).max() < 0.1
    assert len(faces) >= len(ball.faces) + 3 * marked.sum()


def test_a_flat_sheet_is_refined_evenly() -> None:
    """In a regular flat lattice Loop's weights keep the plane and put new vertices at the midpoints of edges."""
    lattice = patch(6, 6, place=np.array([(1.0, -0.5), (0.0, 0.5 * np.sqrt(3)), (0.0, 0.0)]))
    vertices, faces = lattice.vertices, lattice.faces
    middle = np.linalg.norm(vertices[faces].mean(axis=1) - vertices.mean(axis=0), axis=1).argmin()
    matrix, _ = refine(faces, np.arange(len(faces)) == middle, 49)
    middles = (vertices[faces[middle]] + vertices[np.roll(faces[middle], -1)]) / 2
    assert {tuple(p) for p in (matrix @ vertices)[49:].round(9)} == {tuple(p) for p in middles.round(9)}


def cylinder(radius: float) -> trimesh.Trimesh:
    """A cylinder along y, 20 cm long, centred at the origin."""
    shape = trimesh.creation.cylinder(radius, 20.0, sections=512)
    shape.apply_transform(trimesh.transformations.rotation_matrix(np.pi / 2, [1, 0, 0]))
    return shape


def test_girth_of_a_cylinder_which_has_none_above_its_end() -> None:
    shape = cylinder(12.0)
    cut = section(shape.vertices, shape.faces, 1, 3.0)
    assert girth(cut[:, 0][:, [0, 2]]) == pytest.approx(2 * np.pi * 12.0, rel=1e-4)
    assert contour_length(cut) == pytest.approx(2 * np.pi * 12.0, rel=1e-4)
    assert section(shape.vertices, shape.faces, 1, 10.5).shape == (0, 2, 3)


def test_a_tape_bridges_hollows_on_its_side_and_a_contour_does_not() -> None:
    corners = np.array([(0, 0), (4, 0), (4, 3), (2, 1), (0, 3)], float)
    notched = np.stack([corners, np.roll(corners, -1, axis=0)], axis=1)
    in_space = np.stack([notched[..., 0], np.zeros((5, 2)), notched[..., 1]], axis=-1)
    assert girth(corners) == pytest.approx(14.0)
    assert contour_length(in_space) == pytest.approx(10.0 + 2 * np.sqrt(8.0))
    wedge = np.array([(0.0, 0.0), (3.0, 0.0), (0.0, 4.0), (1.0, 1.0)])
    assert tape(wedge, (0.0, -1.0)) == pytest.approx(3.0)
    assert tape(wedge, (-1.0, 0.0)) == pytest.approx(4.0)
    assert tape(wedge, (1.0, 1.0)) == pytest.approx(5.0)
    assert tape(wedge, (1.0, 1.0), over=-1.1) == pytest.approx(12.0)


def test_rough_girths_are_close_to_girths() -> None:
    angle = np.linspace(0, 2 * np.pi, 300, endpoint=False)
    rings = [np.stack([a * np.cos(angle), b * np.sin(angle)], axis=1) for a, b in ((10, 10), (13, 8), (9, 9.5))]
    quick = rough_girths(np.concatenate(rings), np.repeat([1.0, 2.0, 3.0], 300))
    assert quick == pytest.approx([girth(ring) for ring in rings], rel=2e-3)


def test_half_a_circle_is_clipped_from_a_circle() -> None:
    shape = cylinder(5.0)
    cut = section(shape.vertices, shape.faces, 1, 3.0)
    half = clipped(cut, (0.0, 0.0, 1.0), np.array([0.0, 0.0, 0.001]))
    assert half[:, :, 2].min() >= 0.001 - 1e-12
    assert contour_length(half) == pytest.approx(np.pi * 5.0, abs=0.01)


def test_a_path_over_a_flat_sheet_is_straight_across_edges() -> None:
    sheet = patch(10, 7)
    graph = GeodesicGraph.over(sheet.faces, 0, 87, points_per_edge=4)
    length = graph.length(sheet.vertices)
    assert length == pytest.approx(np.hypot(10.0, 7.0), rel=0.005)
    assert graph.without_detours(sheet.vertices, least=0.8).length(sheet.vertices) == pytest.approx(length, rel=1e-9)
    path = graph.path(sheet.vertices)
    assert np.linalg.norm(np.diff(path, axis=0), axis=1).sum() == pytest.approx(length)
