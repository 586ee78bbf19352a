"""Labels of vertices: answers do not depend on the order of vertices, nor the loss on the numbering of sets."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from benchmarks.reconstruction.garments import GarmentSet, Ragged
from benchmarks.reconstruction.models.baselines import nearest_labels
from benchmarks.reconstruction.models.segmentation import any_of_loss, build, set_loss
from benchmarks.reconstruction.vertex_labels import score_labels, true_labels
from gcd_dataset.errors import ConfigError

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


def test_unknown_sizes_are_refused() -> None:
    with pytest.raises(ConfigError, match="no size depth of segmentation"):
        build(smoke=True, options={"depth": 3})
    with pytest.raises(ConfigError, match="token_width 10 is no multiple of heads 8"):
        build(smoke=False, options={"token_width": 10})
