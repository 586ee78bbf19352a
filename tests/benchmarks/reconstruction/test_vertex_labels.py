"""Labels of vertices (task T4): truth, scores and the network."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from benchmarks.reconstruction.derived import MIRRORED, PANEL_CLASSES, panel_class
from benchmarks.reconstruction.garments import GarmentSet, Ragged
from benchmarks.reconstruction.models.baselines import nearest_labels
from benchmarks.reconstruction.models.segmentation import any_of_loss, build, set_loss
from benchmarks.reconstruction.vertex_labels import TrueLabels, VertexLabels, score_labels, true_labels
from gcd_dataset.tensors import EDGE_LABELS

PANELS = np.array([0, 0, 0, 0, 1, 1, 1, 1, 1, 1])


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


def right() -> VertexLabels:
    seams = np.where(np.arange(10) == 4, 0, -1)
    return VertexLabels(PANELS, np.where(PANELS, 7, 3), seams, np.where(np.arange(10) == 0, 2, 0))


def test_the_truth_scores_one() -> None:
    assert set(vars(score_labels(right(), strip())).values()) == {1.0}


def test_a_seam_vertex_may_have_either_panel() -> None:
    other = PANELS.copy()
    other[4] = 0
    assert score_labels(replace(right(), panels=other), strip()).panel_label == 1.0


def test_numbers_of_panels_and_seams_do_not_matter() -> None:
    answer = right()
    other = replace(answer, panels=np.array([31, 4])[answer.panels], seams=np.where(answer.seams < 0, -1, 77))
    assert score_labels(other, strip()) == score_labels(answer, strip())


def test_the_vertices_of_a_panel_too_many_are_wrong() -> None:
    split = PANELS.copy()
    split[7:] = 5
    score = score_labels(replace(right(), panels=split), strip())
    assert score.panel_label == pytest.approx(0.7)
    assert (score.panel_count_acc, score.panels_exact) == (0, 0)


def test_one_panel_for_all_gets_the_larger_one_right() -> None:
    score = score_labels(replace(right(), panels=np.zeros(10, int)), strip())
    assert score.panel_label == pytest.approx(0.6)


def test_seams_and_edges_are_scored_on_and_off_them() -> None:
    seams = np.full(10, -1)
    seams[5] = 0
    score = score_labels(replace(right(), seams=seams, edges=np.zeros(10, int)), strip())
    assert score.seam_label == pytest.approx(0.8)
    assert score.edge_label == pytest.approx(0.9)
    assert (score.on_seam_label, score.seam_f1, score.on_edge_label) == (0, 0, 0)


def test_labels_of_another_mesh_are_refused() -> None:
    with pytest.raises(ValueError, match="9 labels panels for 10 vertices"):
        score_labels(replace(right(), panels=PANELS[1:]), strip())


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


CPU = torch.device("cpu")
INSIDE = torch.ones(1, 6)


def members(*numbers: int) -> torch.Tensor:
    return torch.eye(3, dtype=torch.bool)[list(numbers)][None]


def test_the_loss_of_sets_does_not_depend_on_their_numbering() -> None:
    logits = torch.randn(1, 6, 4, generator=torch.Generator().manual_seed(0))
    one, other = members(0, 0, 1, 1, 2, 2), members(2, 2, 0, 0, 1, 1)
    for a, b in zip(set_loss(logits, one, INSIDE), set_loss(logits, other, INSIDE), strict=True):
        assert torch.allclose(a, b)


def test_a_perfect_choice_has_no_loss() -> None:
    true = members(0, 0, 1, 1, 2, 2)
    sure = torch.full((1, 6, 4), -50.0)
    sure[0, torch.arange(6), torch.tensor([3, 3, 0, 0, 1, 1])] = 50.0
    entropy, _ = set_loss(sure, true, INSIDE)
    assert entropy == pytest.approx(0, abs=1e-5)
    sure[0, 5] = sure[0, 0]  # now a vertex of the third set is in the first
    assert set_loss(sure, true, INSIDE)[0] > 10


def test_any_allowed_column_is_right_and_unlabelled_vertices_do_not_count() -> None:
    logits = torch.zeros(1, 2, 4)
    allowed = torch.tensor([[[True, True, False, False], [False] * 4]])
    assert any_of_loss(logits, allowed) == pytest.approx(np.log(2))


def test_shuffled_meshes_get_the_same_labels_shuffled(draped: GarmentSet) -> None:
    torch.manual_seed(0)
    learner = build(smoke=True, options={}).eval()
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


def test_without_edges_only_points_and_normals_are_seen(draped: GarmentSet) -> None:
    """Neighbours are the nearest points."""
    learner = build(smoke=True, options={"mesh": 0}).eval()
    one = learner.prepare(draped, device=CPU).batch(torch.tensor([0])).surface
    assert not one.shape.any()
    place = one.positions
    away = torch.cdist(place, place).fill_diagonal_(torch.inf)
    assert torch.allclose(away.amin(dim=1), (place[one.neighbours[:, 0]] - place).norm(dim=1), atol=1e-4)


def test_a_mirror_image_has_the_classes_of_the_other_side(draped: GarmentSet) -> None:
    examples = build(smoke=True, options={}).prepare(draped, device=CPU)
    rows = torch.arange(len(draped))
    plain = examples.batch(rows)
    drawn = [examples.batch(rows, torch.Generator().manual_seed(seed)) for seed in range(4)]
    for batch in drawn:
        assert torch.equal(batch.panels, plain.panels)
        assert torch.equal(batch.classes.sum(dim=-1), plain.classes.sum(dim=-1))
    assert any(not torch.equal(batch.surface.positions, plain.surface.positions) for batch in drawn)


def test_the_nearest_garment_of_a_known_one_has_its_labels(draped: GarmentSet) -> None:
    found = nearest_labels(draped, draped, device=CPU)
    for k, answer in enumerate(found):
        score = score_labels(answer, true_labels(draped, k))
        assert (score.panel_label, score.panel_count_acc, score.seam_f1) == (1, 1, 1)
