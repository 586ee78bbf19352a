"""Labels of the vertices of a garment's mesh (task T4), and their scores.

Numbers of panels and seams belong to one garment, and any numbering is as good as another: answers are compared under
the one-to-one assignment of predicted to true numbers that gives most vertices right (Hungarian method). Predicted
panels beyond the true ones are assigned to none, and their vertices are wrong.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Int
from scipy.optimize import linear_sum_assignment

from benchmarks.reconstruction.derived import PANEL_CLASSES
from benchmarks.reconstruction.garments import GarmentSet
from gcd_dataset.tensors import EDGE_LABELS

LEAST_EXACT = 0.99  # share of the vertices of a garment whose panels count as right throughout


@dataclass(frozen=True, eq=False)
class VertexLabels:
    """One label of each kind for every vertex: an answer."""

    panels: Int[np.ndarray, " v"]
    """Number of the panel."""
    classes: Int[np.ndarray, " v"]
    """Row of ``PANEL_CLASSES``."""
    seams: Int[np.ndarray, " v"]
    """Number of the seam; -1 for none."""
    edges: Int[np.ndarray, " v"]
    """Row of ``EDGE_LABELS``: the role of the edge that the vertex is on; 0 for none."""


@dataclass(frozen=True, eq=False)
class TrueLabels:
    """All labels of every vertex: a vertex on a seam belongs to the panels of its faces, where seams meet to each."""

    panels: Bool[np.ndarray, "v p"]
    classes: Bool[np.ndarray, "v c"]
    seams: Bool[np.ndarray, "v s"]
    edges: Bool[np.ndarray, "v l"]
    """Column 0: on no labelled edge."""


@dataclass(frozen=True)
class VertexScore:
    """Scores of the labels of one garment; each in [0, 1]."""

    panel_label: float
    """Share of the vertices whose panel is right; on a seam, one of its panels."""
    panel_count_acc: float
    """1 if as many panels are predicted as there are."""
    panels_exact: float
    """1 if the number of panels is right and the panels of 99 % of the vertices are."""
    panel_class: float
    """Share of the vertices whose class of panel is right."""
    seam_label: float
    """Share of all vertices whose seam, or none, is right."""
    on_seam_label: float
    """The same among the vertices on seams."""
    seam_f1: float
    """F1 of being on any seam."""
    edge_label: float
    """Share of the vertices whose edge label, or none, is right."""
    on_edge_label: float
    """The same among the vertices on labelled edges."""


def true_labels(garments: GarmentSet, k: int) -> TrueLabels:
    """The labels of garment ``k``, from its mesh."""
    ragged = garments.ragged
    count, classes = len(ragged["verts"][k]), ragged["panel_classes"][k]
    vertex, panel = ragged["faces"][k].ravel(), np.repeat(ragged["panel_id"][k], 3)
    seams, edges = ragged["seams"][k], ragged["labels"][k]
    known = edges[edges[:, 1] < len(EDGE_LABELS)]
    edge = _members(count, known[:, 0], known[:, 1], len(EDGE_LABELS))
    edge[:, 0] = ~edge[:, 1:].any(axis=1)
    return TrueLabels(
        panels=_members(count, vertex, panel, len(classes)),
        classes=_members(count, vertex, classes[panel], len(PANEL_CLASSES)),
        seams=_members(count, seams[:, 0], seams[:, 1], len(ragged["stitches"][k])),
        edges=edge,
    )


def _members(
    count: int, vertex: Int[np.ndarray, " n"], column: Int[np.ndarray, " n"], columns: int
) -> Bool[np.ndarray, "v c"]:
    found = np.zeros((count, columns), bool)
    found[vertex, column] = True
    return found


def assigned(predicted: Int[np.ndarray, " v"], true: Bool[np.ndarray, "v p"]) -> Int[np.ndarray, " v"]:
    """The true number of each predicted one (-1 for none), under the assignment with most vertices right.

    >>> assigned(np.array([5, 5, 7, 2]), np.eye(2, dtype=bool)[[1, 1, 0, 0]]).tolist()
    [1, 1, 0, -1]
    """
    numbers, rows = np.unique(predicted, return_inverse=True)
    overlap = np.zeros((len(numbers), true.shape[1]))
    np.add.at(overlap, rows, true)
    overlap[numbers < 0] = 0
    ours, theirs = linear_sum_assignment(overlap, maximize=True)
    match = np.full(len(numbers), -1)
    match[ours] = theirs
    match[numbers < 0] = -1
    return match[rows]


def score_labels(answer: VertexLabels, true: TrueLabels) -> VertexScore:
    """The scores of an answer; an answer of another number of vertices raises ``ValueError``."""
    count = len(true.panels)
    for name, values in vars(answer).items():
        if len(values) != count:
            raise ValueError(f"{len(values)} labels {name} for {count} vertices")
    panel, seam = assigned(answer.panels, true.panels), assigned(answer.seams, true.seams)
    panel_right = _among(panel, true.panels)
    on_seam, said = true.seams.any(axis=1), answer.seams >= 0
    seam_right = np.where(on_seam, _among(seam, true.seams), ~said)
    on_edge, edge_right = ~true.edges[:, 0], _among(answer.edges, true.edges)
    count_right = len(np.unique(answer.panels)) == true.panels.any(axis=0).sum()
    return VertexScore(
        panel_label=float(panel_right.mean()),
        panel_count_acc=float(count_right),
        panels_exact=float(count_right and panel_right.mean() >= LEAST_EXACT),
        panel_class=float(_among(answer.classes, true.classes).mean()),
        seam_label=float(seam_right.mean()),
        on_seam_label=_mean(seam_right[on_seam], otherwise=not said.any()),
        seam_f1=_mean_of_two(int((on_seam & said).sum()), int(on_seam.sum()), int(said.sum())),
        edge_label=float(edge_right.mean()),
        on_edge_label=_mean(edge_right[on_edge], otherwise=not (answer.edges > 0).any()),
    )


def _among(numbers: Int[np.ndarray, " v"], true: Bool[np.ndarray, "v n"]) -> Bool[np.ndarray, " v"]:
    """Whether each number is one of the true ones of its vertex; -1 is not."""
    if not true.shape[1]:
        return np.zeros(len(numbers), bool)
    return np.asarray(true[np.arange(len(numbers)), numbers] & (numbers >= 0))


def _mean(values: Bool[np.ndarray, " n"], *, otherwise: bool) -> float:
    return float(values.mean()) if len(values) else float(otherwise)


def _mean_of_two(both: int, true: int, said: int) -> float:
    """F1 from counts; 1 if there is nothing to find and nothing is found."""
    return 2 * both / (true + said) if true + said else 1.0
