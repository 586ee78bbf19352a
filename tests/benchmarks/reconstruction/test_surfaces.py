"""Meshes as networks see them: nothing depends on the order of vertices; distances follow the surface."""

import numpy as np
import pytest
import torch

from benchmarks.reconstruction.surface_net import of_neighbours
from benchmarks.reconstruction.surfaces import (
    NEIGHBOURS,
    Surface,
    SurfaceStore,
    cloud_of,
    drawn_turn,
    surface_of,
    vertex_normals,
)

CPU = torch.device("cpu")


def sheet(rows: int = 6, columns: int = 5) -> tuple[np.ndarray, np.ndarray]:
    """A wavy sheet of triangles, uneven, so that no two distances are equal."""
    y, x = np.mgrid[:rows, :columns]
    points = np.stack([x.ravel(), 100.0 + y.ravel(), np.sin(x.ravel())], axis=1).astype(float)
    points += 0.1 * np.random.default_rng(0).random(points.shape)
    corner = (np.arange(rows - 1)[:, None] * columns + np.arange(columns - 1)).ravel()
    faces = np.concatenate([
        np.stack([corner, corner + 1, corner + columns], axis=1),
        np.stack([corner + 1, corner + columns + 1, corner + columns], axis=1),
    ])  # fmt: skip
    return points, faces


def test_shuffled_vertices_get_the_same_surface_shuffled() -> None:
    points, faces = sheet()
    order = np.random.default_rng(1).permutation(len(points))
    place = np.argsort(order)
    one, other = surface_of(points, faces, clusters=4), surface_of(points[order], place[faces][::-1], clusters=4)
    assert np.allclose(one.positions[order], other.positions)
    assert np.allclose(one.normals[order], other.normals, atol=1e-5)
    assert np.array_equal(one.clusters[order], other.clusters)
    assert np.allclose(one.shape[order], other.shape)
    assert np.array_equal(place[one.neighbours[order]], other.neighbours)


def test_clusters_follow_the_surface() -> None:
    """Two sheets a millimetre apart, joined nowhere, share no cluster."""
    points, faces = sheet()
    both = np.concatenate([points, points + [0, 0, 0.1]])
    found = surface_of(both, np.concatenate([faces, faces + len(points)]), clusters=8).clusters
    assert not set(found[: len(points)]) & set(found[len(points) :])


def test_pieces_without_a_centre_have_the_nearest_cluster() -> None:
    """Three triangles and two centres, which are the farthest apart."""
    corner = np.array([[0.0, 100, 0], [1, 100, 0], [0, 101, 0]])
    points = np.concatenate([corner, corner + [9, 0, 0], corner + [40, 0, 0]])
    found = surface_of(points, np.arange(9).reshape(3, 3), clusters=2).clusters
    assert len(set(found[:6])) == 1
    assert len(set(found[6:])) == 1
    assert found[0] != found[6]


def test_neighbours_are_joined_by_edges() -> None:
    points, faces = sheet()
    found = surface_of(points, faces, clusters=4)
    edges = {
        tuple(pair) for face in faces.tolist() for pair in ((face[0], face[1]), (face[1], face[2]), (face[2], face[0]))
    }
    joined = edges | {(b, a) for a, b in edges}
    for vertex, row in enumerate(found.neighbours.tolist()):
        others = set(row) - {vertex}
        assert others == {b for a, b in joined if a == vertex}


def test_the_border_of_a_sheet() -> None:
    found = surface_of(*sheet(4, 4), clusters=2).shape[:, -1].reshape(4, 4)
    assert found.sum() == 12
    assert not found[1:-1, 1:-1].any()


def test_the_angle_defects_of_a_closed_mesh_sum_to_two_turns() -> None:
    """Gauss-Bonnet, on an octahedron; each of its vertices has four neighbours."""
    points = np.concatenate([np.eye(3), -np.eye(3)])
    faces = np.array([[0, 1, 2], [1, 3, 2], [3, 4, 2], [4, 0, 2], [1, 0, 5], [3, 1, 5], [4, 3, 5], [0, 4, 5]])
    shape = surface_of(points, faces, clusters=2).shape
    assert shape[:, 4].sum() == pytest.approx(4 * np.pi, rel=1e-5)
    assert shape[:, 0] == pytest.approx(4 / 6)
    assert shape[:, 1:4] == pytest.approx(1.0)
    assert not shape[:, 5].any()


def test_normals_of_a_flat_sheet_are_upright() -> None:
    points, faces = sheet()
    points[:, 2] = 0.0
    assert np.allclose(vertex_normals(points, faces), [0, 0, 1])


def test_a_batch_holds_its_garments_one_after_the_other() -> None:
    meshes = [sheet(4, 4), sheet(6, 5)]
    store = SurfaceStore([surface_of(*mesh, clusters=3) for mesh in meshes], tokens=3, device=CPU)
    batch, chosen = store.batch(torch.tensor([1, 0]))
    assert batch.counts.tolist() == [30, 16]
    assert chosen.tolist() == [*range(16, 46), *range(16)]
    alone, _ = store.batch(torch.tensor([0]))
    assert torch.equal(batch.neighbours[30:] - 30, alone.neighbours)
    assert torch.equal(batch.clusters[30:] - 3, alone.clusters)
    padded = batch.padded(batch.positions)
    assert torch.equal(padded[1, :16], alone.positions)
    assert torch.equal(batch.exists.sum(dim=1), batch.counts)
    assert not padded[1, 16:].any()


def test_a_turn_keeps_shapes_and_does_not_depend_on_the_batch() -> None:
    store = SurfaceStore([surface_of(*sheet(), clusters=3)] * 3, tokens=3, device=CPU)
    rows = torch.tensor([2, 0])
    turn = drawn_turn(rows, 3, torch.Generator().manual_seed(5), CPU)
    alone = drawn_turn(rows[:1], 3, torch.Generator().manual_seed(5), CPU)
    assert torch.equal(turn.matrices[:1], alone.matrices)
    growth = turn.matrices.det().abs() ** (1 / 3)
    gram = turn.matrices.transpose(1, 2) @ turn.matrices
    assert torch.allclose(gram, growth[:, None, None] ** 2 * torch.eye(3), atol=1e-5)
    assert torch.equal(turn.matrices.det() < 0, turn.mirrored)
    batch, _ = store.batch(rows)
    moved = turn.of(batch)
    assert moved.normals.norm(dim=1).numpy() == pytest.approx(1, abs=1e-5)
    assert moved.positions.shape == batch.positions.shape


def test_neighbours_of_points_are_the_nearest_of_each_other() -> None:
    points, _ = sheet()
    found = cloud_of(points, np.ones_like(points), clusters=4)
    apart = ((points[:, None] - points) ** 2).sum(axis=2)
    nearest = [set(row) for row in np.argsort(apart, axis=1)[:, 1 : 1 + NEIGHBOURS].tolist()]
    for row, others in enumerate(nearest):
        expected = {other for other in others if row in nearest[other]}
        assert set(found.neighbours[row].tolist()) - {row} == expected
    assert_reverse_edges(found)


def test_a_vertex_of_many_neighbours_keeps_the_nearest() -> None:
    """A fan of more triangles than a vertex has neighbours: those that it does not keep do not keep it."""
    count = NEIGHBOURS + 4
    angles = 2 * np.pi * np.arange(count) / count
    radii = 1 + 0.1 * np.arange(count)
    rim = np.stack([radii * np.cos(angles), 100 + radii * np.sin(angles), np.zeros(count)], axis=1)
    rows = np.arange(count) + 1
    faces = np.stack([np.zeros(count, int), rows, np.roll(rows, -1)], axis=1)
    found = surface_of(np.concatenate([[[0, 100, 0]], rim]), faces, clusters=2)
    assert found.neighbours[0].tolist() == list(range(1, NEIGHBOURS + 1))
    knows_centre = (found.neighbours == 0).any(axis=1)
    assert knows_centre[1 : NEIGHBOURS + 1].all()
    assert not knows_centre[NEIGHBOURS + 1 :].any()
    assert_reverse_edges(found)


def assert_reverse_edges(surface: Surface) -> None:
    entries = surface.reverse.ravel()
    assert np.array_equal(np.sort(entries), np.arange(len(entries)))
    own = np.repeat(np.arange(len(surface.neighbours)), NEIGHBOURS)
    assert np.array_equal(surface.neighbours.ravel()[entries], own)
    assert surface.lengths.ravel()[entries] == pytest.approx(surface.lengths.ravel())


def test_the_gradient_of_neighbours_adds_up_what_each_vertex_gave() -> None:
    store = SurfaceStore([surface_of(*sheet(4, 4), clusters=3), surface_of(*sheet(), clusters=3)], tokens=3, device=CPU)
    batch, _ = store.batch(torch.tensor([1, 0, 1]))
    chance = torch.Generator().manual_seed(0)
    values = torch.randn(len(batch.neighbours), 4, generator=chance, dtype=torch.float64, requires_grad=True)
    found = of_neighbours(values, batch)
    assert torch.equal(found, values[batch.neighbours])
    weights = torch.randn(found.shape, generator=chance, dtype=torch.float64)
    (gradient,) = torch.autograd.grad((found * weights).sum(), values)
    (expected,) = torch.autograd.grad((values[batch.neighbours] * weights).sum(), values)
    assert torch.allclose(gradient, expected, atol=1e-12)
