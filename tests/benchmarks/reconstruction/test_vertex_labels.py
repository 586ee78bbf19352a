"""Scores of vertex labels: hand-counted, and the same for every numbering of panels and seams."""

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.reconstruction.derived import MIRRORED, PANEL_CLASSES, panel_class
from benchmarks.reconstruction.garments import GarmentSet
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
