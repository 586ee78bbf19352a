"""Sections and tapes on shapes with known girths."""

import numpy as np
import pytest
import trimesh

from gcd_dataset.generator.body.section import (
    clipped,
    contour_length,
    girth,
    rough_girths,
    section,
    section_points,
    tape,
)

XZ = [0, 2]


def cylinder(radius: float, *, sides: int = 512) -> trimesh.Trimesh:
    """A cylinder along y, 20 cm long, centred at the origin."""
    shape = trimesh.creation.cylinder(radius, 20.0, sections=sides)
    shape.apply_transform(trimesh.transformations.rotation_matrix(np.pi / 2, [1, 0, 0]))
    return shape


def test_girth_of_a_cylinder() -> None:
    shape = cylinder(12.0)
    cut = section(shape.vertices, shape.faces, 1, 3.0)
    assert girth(cut[:, 0][:, XZ]) == pytest.approx(2 * np.pi * 12.0, rel=1e-4)
    assert contour_length(cut) == pytest.approx(2 * np.pi * 12.0, rel=1e-4)


@pytest.mark.parametrize("level", [0.37, 0.0])  # 0.0 runs through vertices
def test_first_points_of_a_sections_segments_are_all_its_points(level: float) -> None:
    shape = trimesh.creation.icosphere(subdivisions=4, radius=7.0)
    cut = section(shape.vertices, shape.faces, 1, level)
    assert {tuple(p) for p in cut[:, 0].round(9) + 0.0} == {tuple(p) for p in cut[:, 1].round(9) + 0.0}
    assert np.abs(cut[:, :, 1] - level).max() < 1e-12


def test_points_of_several_sections_equal_those_of_each() -> None:
    shape = trimesh.creation.icosphere(subdivisions=3, radius=7.0)
    levels = np.array([-3.1, 0.2, 5.5])
    points, at = section_points(shape.vertices, shape.edges_unique, 1, levels)
    for level in levels:
        one = section(shape.vertices, shape.faces, 1, level)[:, 0]
        assert {tuple(p) for p in points[at == level].round(9)} == {tuple(p) for p in one.round(9)}


def test_a_level_off_the_mesh_has_an_empty_section() -> None:
    shape = trimesh.creation.box((1.0, 1.0, 1.0))
    assert section(shape.vertices, shape.faces, 1, 9.0).shape == (0, 2, 3)


def test_a_tape_bridges_hollows_and_a_contour_does_not() -> None:
    corners = np.array([(0, 0), (4, 0), (4, 3), (2, 1), (0, 3)], float)
    notched = np.stack([corners, np.roll(corners, -1, axis=0)], axis=1)
    in_space = np.stack([notched[..., 0], np.zeros((5, 2)), notched[..., 1]], axis=-1)
    assert girth(corners) == pytest.approx(14.0)
    assert contour_length(in_space) == pytest.approx(10.0 + 2 * np.sqrt(8.0))


def test_tape_over_one_side_of_a_wedge() -> None:
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
