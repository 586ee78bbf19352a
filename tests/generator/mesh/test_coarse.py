"""A coarse mesh has the panels and seams of the fine mesh, and interpolates to it."""

from dataclasses import replace

import numpy as np
import pytest

from gcd_dataset.errors import MeshError
from gcd_dataset.generator.mesh import build_box_mesh
from gcd_dataset.generator.mesh.coarse import CoarseMesh, coarsen
from gcd_dataset.records import Pattern
from tests.generator.mesh.shapes import areas, euler_characteristic, panel, rectangle, sewn, sides, tube
from tests.generator.mesh.test_box_mesh import DART, darted, patchwork

PATTERNS = [darted(), patchwork(), tube(), sewn(panel("a", rectangle(20.0, 13.0)))]


@pytest.mark.parametrize("pattern", PATTERNS)
def test_panels_keep_their_area_and_seams_their_joins_and_edges_are_twice_as_long(pattern: Pattern) -> None:
    fine = build_box_mesh(pattern, spacing=1.0)
    coarse = coarsen(fine).mesh
    for number in range(len(fine.panel_names)):
        was, now = (areas(m.uv, m.corners[m.panel_id == number]).sum() for m in (fine, coarse))
        assert now == pytest.approx(was, rel=1e-9)
    assert euler_characteristic(coarse) == euler_characteristic(fine)
    assert set(coarse.seams[:, 1]) == set(fine.seams[:, 1])
    assert len(coarse.vertices) < 0.4 * len(fine.vertices)
    length, coarse_length = (sides(m.uv, m.corners) for m in (fine, coarse))
    assert np.median(coarse_length) == pytest.approx(2 * np.median(length), rel=0.15)
    assert coarse_length.max() < 2 * 1.6


@pytest.mark.parametrize("pattern", PATTERNS)
def test_coarse_vertices_interpolate_linear_functions_exactly(pattern: Pattern) -> None:
    """A linear function in the plane of a panel is interpolated exactly."""
    fine = build_box_mesh(pattern, spacing=1.0)
    coarse = coarsen(fine)
    assert coarse.weights.min() >= 0
    assert coarse.weights.sum(axis=1) == pytest.approx(np.ones(len(fine.vertices)))
    for number in range(len(fine.panel_names)):
        rows, coarse_rows = (np.unique(m.corners[m.panel_id == number]) for m in (fine, coarse.mesh))
        field = np.full((len(coarse.mesh.vertices), 3), np.nan)
        field[coarse.mesh.uv_vertex[coarse_rows]] = _linear(coarse.mesh.uv[coarse_rows])
        own = fine.uv_vertex[rows]
        free = np.bincount(own, minlength=len(fine.vertices))[own] == 1
        free &= ~_beside_a_dart(coarse, own)
        found = np.einsum("vk,vkd->vd", coarse.weights, field[coarse.corners])[own[free]]
        inside = np.isfinite(found).all(axis=1)  # seam points may get their weights from the other panel
        assert inside.sum() > 0.5 * len(own)
        assert found[inside] == pytest.approx(_linear(fine.uv[rows[free]][inside]), abs=1e-6)


def _beside_a_dart(coarse: CoarseMesh, own: np.ndarray) -> np.ndarray:
    """Flags of the vertices interpolated from vertices with two ``uv`` positions, as on the legs of a dart."""
    rows = np.bincount(coarse.mesh.uv_vertex, minlength=len(coarse.mesh.vertices))
    return (rows[coarse.corners[own]] > 1).any(axis=1)


def _linear(flat: np.ndarray) -> np.ndarray:
    return np.column_stack([2.0 + flat[:, 0] - 0.3 * flat[:, 1], 0.5 * flat[:, 0], flat[:, 1]])


def test_labels_and_places_are_kept() -> None:
    fine = build_box_mesh(sewn(panel("a", DART, labels={5: "lower_interface"})), spacing=1.0)
    coarse = coarsen(fine).mesh
    assert fine.vertices[fine.labels["lower_interface"], 1] == pytest.approx(20.0)
    assert coarse.vertices[coarse.labels["lower_interface"], 1] == pytest.approx(20.0)
    flat = coarse.vertices[coarse.uv_vertex][:, :2]
    free = np.flatnonzero(coarse.uv_vertex >= coarse.n_seam_vertices)
    assert flat[free] == pytest.approx(coarse.uv[free], abs=1e-6)


def test_congruent_panels_get_congruent_triangles() -> None:
    """Panels of one shape, turned over or not, have as many triangles, of the same areas."""
    shape = [(0.0, 0.0), (18.0, 0.0), (24.0, 15.0), (5.0, 20.0)]
    mirrored = [(-x, y) for x, y in shape]
    coarse = coarsen(build_box_mesh(sewn(panel("a", shape), panel("b", mirrored), panel("c", shape)), spacing=1.0)).mesh
    a, b, c = (np.sort(areas(coarse.uv, coarse.corners[coarse.panel_id == number])) for number in range(3))
    assert a == pytest.approx(c, abs=1e-5)
    assert -b[::-1] == pytest.approx(a, abs=1e-5)


def test_a_panel_that_touches_itself_or_has_a_hole_is_refused() -> None:
    """Of the triangles round a point, two without a common side: the loops round both pass through the point."""
    fine = build_box_mesh(sewn(panel("ring", rectangle(20.0, 20.0))), spacing=1.0)
    middle = np.linalg.norm(fine.uv - 10.0, axis=1).argmin()
    around = np.flatnonzero((fine.corners == middle).any(axis=1))
    shared = [len(np.intersect1d(fine.corners[around[0]], fine.corners[other])) for other in around]
    cuts = [(np.array([around[0], other]), "touches itself at a point") for other in around[np.array(shared) == 1]]
    assert len(cuts) == 3
    for left, fault in [*cuts, (np.setdiff1d(np.arange(len(fine.faces)), around), "ring has a hole")]:
        cut = replace(fine, faces=fine.faces[left], corners=fine.corners[left], panel_id=fine.panel_id[left])
        with pytest.raises(MeshError, match=fault):
            coarsen(cut)
