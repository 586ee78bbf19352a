"""Predicted drapes: scores, crossings, the solver as a peer, and the surrogate's examples."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from benchmarks.reconstruction.drapes import (
    DrapedVertices,
    counted,
    score_drapes,
    transferred,
)
from benchmarks.reconstruction.garments import GarmentSet
from benchmarks.reconstruction.models.baselines import box_mesh, solver
from benchmarks.reconstruction.models.drape_surrogate import build, depth, nearest_rows, nearest_skin
from benchmarks.reconstruction.wearers import body_points, box_mesh_of, measurements_of, wearer_of
from gcd_dataset.generator.mesh.box_mesh import build_box_mesh
from gcd_dataset.measurements import MEASURES

CPU = torch.device("cpu")


def true_drapes(garments: GarmentSet) -> list[DrapedVertices]:
    return [DrapedVertices(garments.ragged["verts"][k].astype(float), 1.0) for k in range(len(garments))]


def test_a_drape_moved_by_2_cm_has_an_error_of_2_cm(draped: GarmentSet) -> None:
    moved = [replace(answer, vertices=answer.vertices + [0, 2, 0]) for answer in true_drapes(draped)]
    for score in score_drapes(moved, draped, crossings=False):
        assert score.error_cm == pytest.approx(2)
        assert score.error_p95_cm == pytest.approx(2)
        assert score.stretch_error == pytest.approx(0, abs=1e-6)
        assert (score.within_1cm, score.ms) == (0, 1)


def test_crossings_are_counted_on_the_wearer(draped: GarmentSet) -> None:
    one = draped.select([0])
    vertices = true_drapes(one)[0].vertices
    ((_, few, _),) = counted([vertices], one, device="cpu")
    ((_, many, through),) = counted([vertices - [8, 0, 8]], one, device="cpu")
    assert few < 5 < many
    assert through > 5


def test_the_mesh_of_the_pattern_is_that_of_the_garment(draped: GarmentSet) -> None:
    mesh = build_box_mesh(draped.pattern(0), spacing=6.0)
    own = box_mesh_of(draped, 0)
    assert np.array_equal(mesh.faces, own.faces)
    assert np.allclose(mesh.vertices, own.vertices, atol=1e-3)
    assert np.allclose(transferred(mesh.vertices, mesh, draped, 0), own.vertices, atol=2e-3)


def test_a_finer_mesh_carries_a_linear_map_exactly(draped: GarmentSet) -> None:
    """Positions that are linear in a panel's plane survive the transfer; seam vertices take the mean of two panels."""
    fine, own = build_box_mesh(draped.pattern(0), spacing=3.0), box_mesh_of(draped, 0)
    inner = ~np.isin(np.arange(len(own.vertices)), own.seams[:, 0])
    found = transferred(fine.vertices, fine, draped, 0)
    away = np.linalg.norm(found - own.vertices, axis=1)[inner]
    assert np.median(away) < 0.1


def test_the_solver_drapes_a_garment_as_before(draped: GarmentSet) -> None:
    one = draped.select([0])
    (score,) = score_drapes(solver(one, one, device=CPU), one, crossings=False)
    (unmoved,) = score_drapes(box_mesh(one, one, device=CPU), one, crossings=False)
    assert score.error_cm < 2 < unmoved.error_cm
    assert score.ms > 0


def test_wearers_have_the_measures_of_their_garments(draped: GarmentSet) -> None:
    for k in range(len(draped)):
        height = np.ptp(wearer_of(draped, k).vertices[:, 1])
        assert height == pytest.approx(draped.measures[k, MEASURES.index("height")], abs=0.5)
        assert measurements_of(draped, k).height == pytest.approx(height, abs=0.5)


def test_depth_is_measured_below_the_skin(draped: GarmentSet) -> None:
    examples = build(smoke=True, options={"body": 64}).prepare(draped, device=CPU)
    batch = examples.batch(torch.tensor([0]))
    points, normals = batch.body[0, :5, :3], batch.body[0, :5, 3:]
    surface = replace(
        batch.surface, counts=torch.tensor([5]), garments=torch.zeros(5, dtype=torch.int64), slots=torch.arange(5)
    )
    assert torch.allclose(depth(points - 0.001 * normals, surface, batch.body), torch.full((5,), 0.004), atol=1e-5)
    assert not depth(points + 0.01 * normals, surface, batch.body).any()
    assert torch.allclose(nearest_skin(points, surface, batch.body)[:, :3], torch.zeros(5, 3), atol=1e-5)


def test_each_garment_is_compared_with_its_own_body(draped: GarmentSet) -> None:
    batch = build(smoke=True, options={"body": 64}).prepare(draped, device=CPU).batch(torch.tensor([1, 0]))
    counts = batch.surface.counts.tolist()
    assert counts[0] != counts[1]
    found = nearest_rows(batch.surface.positions, batch.surface, batch.body)
    parts = torch.split(batch.surface.positions, counts)
    expected = [torch.cdist(part, body[:, :3]).argmin(dim=1) for part, body in zip(parts, batch.body, strict=True)]
    assert torch.equal(found, torch.cat([expected[0], expected[1] + 64]))


def test_bodies_are_the_same_vertices_of_each_wearer(draped: GarmentSet) -> None:
    points = body_points(draped, 32)
    assert {part.shape for part in points} == {(32, 6)}
    assert np.linalg.norm(points[0][:, 3:], axis=1) == pytest.approx(1, abs=1e-4)


def test_a_turned_batch_is_the_same_drape(draped: GarmentSet) -> None:
    """A turn and a mirror image move cloth, body and drape together: distances between them stay."""
    examples = build(smoke=True, options={"body": 64}).prepare(draped, device=CPU)
    rows = torch.arange(2)
    plain, moved = examples.batch(rows), examples.batch(rows, torch.Generator().manual_seed(3))
    first = slice(0, 50)
    for one, other in ((plain.draped, moved.draped), (plain.surface.positions, moved.surface.positions)):
        before, after = (torch.cdist(a[first], b[0, :, :3]) for a, b in ((one, plain.body), (other, moved.body)))
        assert torch.allclose(before, after, atol=1e-4)
    assert not torch.allclose(plain.draped, moved.draped)
