"""Meshes as networks see them: nothing depends on the order of vertices; distances follow the surface."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from benchmarks.reconstruction.derived import MIRRORED
from benchmarks.reconstruction.drapes import DrapedVertices, counted, redraped, score_drapes
from benchmarks.reconstruction.garments import GarmentSet, Ragged
from benchmarks.reconstruction.labelled_surfaces import true_labels
from benchmarks.reconstruction.models.baselines import box_mesh, solver
from benchmarks.reconstruction.models.drape_surrogate import SMALL as SMALL_SURROGATE
from benchmarks.reconstruction.models.drape_surrogate import build as build_surrogate
from benchmarks.reconstruction.models.drape_surrogate import depth, nearest_skin
from benchmarks.reconstruction.models.segmentation import SMALL, build, set_loss
from benchmarks.reconstruction.surface_net import of_neighbours
from benchmarks.reconstruction.surfaces import NEIGHBOURS, SurfaceStore, drawn_turn, surface_of
from gcd_dataset.metrics import TrueLabels, VertexLabels, VertexScore, score_labels
from gcd_dataset.metrics.answers import PANEL_CLASSES, panel_class
from gcd_dataset.tensors import EDGE_LABELS

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


def test_the_angle_defects_of_a_closed_mesh_sum_to_two_turns() -> None:
    """Gauss-Bonnet, on an octahedron; each of its vertices has four neighbours."""
    points = np.concatenate([np.eye(3), -np.eye(3)])
    faces = np.array([[0, 1, 2], [1, 3, 2], [3, 4, 2], [4, 0, 2], [1, 0, 5], [3, 1, 5], [4, 3, 5], [0, 4, 5]])
    shape = surface_of(points, faces, clusters=2).shape
    assert shape[:, 4].sum() == pytest.approx(4 * np.pi, rel=1e-5)
    assert shape[:, 0] == pytest.approx(4 / 6)
    assert shape[:, 1:4] == pytest.approx(1.0)
    assert not shape[:, 5].any()


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
    entries = found.reverse.ravel()
    assert np.array_equal(np.sort(entries), np.arange(len(entries)))
    own = np.repeat(np.arange(len(found.neighbours)), NEIGHBOURS)
    assert np.array_equal(found.neighbours.ravel()[entries], own)
    assert found.lengths.ravel()[entries] == pytest.approx(found.lengths.ravel())


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


# -------------------------------------------------------------------------------------------------------- vertex labels


def strip() -> TrueLabels:
    """Ten vertices in a row on two panels; vertex 4 is on the seam between them, vertex 0 on a labelled edge."""
    panels = np.zeros((10, 2), bool)
    panels[:5, 0] = panels[4:, 1] = True
    classes, edges = np.zeros((10, len(PANEL_CLASSES)), bool), np.zeros((10, len(EDGE_LABELS)), bool)
    classes[:5, 3] = classes[4:, 7] = True
    edges[0, 2] = edges[1:, 0] = True
    seams = np.zeros((10, 1), bool)
    seams[4] = True
    return TrueLabels(panels, classes, seams, edges)


PERFECT = dict.fromkeys(VertexScore.__dataclass_fields__, 1.0)
PANELS, ON_SEAM = np.array([0, 0, 0, 0, 1, 1, 1, 1, 1, 1]), np.arange(10) == 4
EDGES = np.where(np.arange(10) == 0, 2, 0)
RIGHT = {"panels": PANELS, "classes": np.where(PANELS, 7, 3), "seams": np.where(ON_SEAM, 0, -1), "edges": EDGES}


@pytest.mark.parametrize(
    ("changed", "expected"),
    [
        ({}, PERFECT),
        ({"panels": np.where(ON_SEAM, 0, PANELS)}, PERFECT),  # a seam vertex may have either panel
        ({"panels": 3 - 4 * PANELS, "seams": np.where(ON_SEAM, 77, -1)}, PERFECT),  # only numbers
        ({"panels": np.repeat([0, 1, 5], [4, 3, 3])}, {"panel_label": 0.7, "panel_count_acc": 0, "panels_exact": 0}),
        ({"panels": np.zeros(10, int)}, {"panel_label": 0.6}),
        ({"seams": np.where(np.arange(10) == 5, 0, -1)}, {"seam_label": 0.8, "on_seam_label": 0, "seam_f1": 0}),
        ({"edges": np.zeros(10, int)}, {"edge_label": 0.9, "on_edge_label": 0}),
    ],
)
def test_labels_are_scored(changed: dict[str, np.ndarray], expected: dict[str, float]) -> None:
    found = vars(score_labels(VertexLabels(**{**RIGHT, **changed}), strip()))
    assert {name: found[name] for name in expected} == pytest.approx(expected)


def test_mirrored_classes_name_the_other_side() -> None:
    left, right_class = panel_class("left_sleeve_f"), panel_class("right_sleeve_f")
    assert MIRRORED[left] == right_class
    assert MIRRORED[panel_class("pant_l_cuff_f")] == panel_class("pant_r_cuff_f")
    assert MIRRORED[panel_class("wb_front")] == panel_class("wb_front")
    assert [MIRRORED[row] for row in MIRRORED] == list(range(len(PANEL_CLASSES)))


def test_all_vertices_of_a_garment_have_labels(draped: GarmentSet) -> None:
    for k in range(len(draped)):
        true = true_labels(draped, k)
        assert true.panels.any(axis=1).all() and true.classes.any(axis=1).all() and true.edges.any(axis=1).all()
        assert true.panels.any(axis=0).all()
        # A vertex of several panels is on a seam.
        assert true.seams[true.panels.sum(axis=1) > 1].any(axis=1).all()


INSIDE = torch.ones(1, 6)


def members(*numbers: int) -> torch.Tensor:
    return torch.eye(3, dtype=torch.bool)[list(numbers)][None]


def test_the_loss_of_sets_does_not_depend_on_their_numbering() -> None:
    logits = torch.randn(1, 6, 4, generator=torch.Generator().manual_seed(0))
    one, other = members(0, 0, 1, 1, 2, 2), members(2, 2, 0, 0, 1, 1)
    for a, b in zip(set_loss(logits, one, INSIDE), set_loss(logits, other, INSIDE), strict=True):
        assert torch.allclose(a, b)


def test_shuffled_meshes_get_the_same_labels_shuffled(draped: GarmentSet) -> None:
    torch.manual_seed(0)
    learner = build(SMALL).eval()
    garment = draped.select([0])
    order = np.random.default_rng(0).permutation(len(garment.ragged["verts"][0]))
    place = np.argsort(order)
    ragged = dict(garment.ragged)
    ragged["verts"] = Ragged.of([garment.ragged["verts"][0][order]])
    ragged["faces"] = Ragged.of([place[garment.ragged["faces"][0]].astype(np.int32)[::-1]])
    ragged["panel_id"] = Ragged.of([garment.ragged["panel_id"][0][::-1]])
    for name in ("seams", "labels"):
        pairs = garment.ragged[name][0].copy()
        pairs[:, 0] = place[pairs[:, 0]]
        ragged[name] = Ragged.of([pairs])
    other = replace(garment, ragged=ragged)
    (one,), (two,) = (
        learner.predict(learner.prepare(g, device=CPU).batch(torch.tensor([0]))) for g in (garment, other)
    )
    assert np.mean(one.panels[order] == two.panels) > 0.99  # up to rounding
    assert np.mean(one.classes[order] == two.classes) > 0.99
    assert score_labels(one, true_labels(garment, 0)).panel_label == pytest.approx(
        score_labels(two, true_labels(other, 0)).panel_label, abs=0.02
    )


# --------------------------------------------------------------------------------------------------------------- drapes


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
    [[(_, few, _)]] = counted([vertices], one, device="cpu")
    [[(_, many, through)]] = counted([vertices - [8, 0, 8]], one, device="cpu")
    assert few < 5 < many
    assert through > 5


def test_the_solver_drapes_a_garment_as_before(draped: GarmentSet) -> None:
    one = draped.select([0])
    (score,) = score_drapes(solver(one, one, device=CPU), one, crossings=False)
    (unmoved,) = score_drapes(box_mesh(one, one, device=CPU), one, crossings=False)
    assert score.error_cm < 2 < unmoved.error_cm
    assert score.ms > 0


def test_a_network_on_coarse_drapes_begins_with_them(draped: GarmentSet) -> None:
    one = draped.select([0])
    network = build_surrogate({**SMALL_SURROGATE, "coarse": 8}).eval()
    batch = network.prepare(one, device=CPU).batch(torch.arange(1))
    [answer] = network.predict(batch)
    [coarse] = redraped(one, spacing=8.0, device=CPU)
    assert np.abs(answer.vertices - coarse.vertices).max() < 1e-3
    assert answer.ms > batch.ms.item() > 0  # the network's time is added


def test_depth_is_measured_below_the_skin(draped: GarmentSet) -> None:
    examples = build_surrogate({**SMALL_SURROGATE, "body": 64}).prepare(draped, device=CPU)
    batch = examples.batch(torch.tensor([0]))
    points, normals = batch.body[0, :5, :3], batch.body[0, :5, 3:]
    surface = replace(
        batch.surface, counts=torch.tensor([5]), garments=torch.zeros(5, dtype=torch.int64), slots=torch.arange(5)
    )
    assert torch.allclose(depth(points - 0.001 * normals, surface, batch.body), torch.full((5,), 0.004), atol=1e-5)
    assert not depth(points + 0.01 * normals, surface, batch.body).any()
    assert torch.allclose(nearest_skin(points, surface, batch.body)[:, :3], torch.zeros(5, 3), atol=1e-5)


def test_a_turned_batch_is_the_same_drape(draped: GarmentSet) -> None:
    """A turn and a mirror image move cloth, body and drape together: distances between them stay."""
    examples = build_surrogate({**SMALL_SURROGATE, "body": 64}).prepare(draped, device=CPU)
    rows = torch.arange(2)
    plain, moved = examples.batch(rows), examples.batch(rows, torch.Generator().manual_seed(3))
    first = slice(0, 50)
    for one, other in ((plain.draped, moved.draped), (plain.surface.positions, moved.surface.positions)):
        before, after = (torch.cdist(a[first], b[0, :, :3]) for a, b in ((one, plain.body), (other, moved.body)))
        assert torch.allclose(before, after, atol=1e-4)
    assert not torch.allclose(plain.draped, moved.draped)
