"""Scores of answers that are no patterns: labels of vertices (T4), measures of a body (T5), drapes (T6), motions (T8).

Numbers of panels and seams belong to one garment, and any numbering is as good as another: answers are compared under
the one-to-one assignment of predicted to true numbers that gives most vertices right (Hungarian method). Predicted
panels beyond the true ones are assigned to none, and their vertices are wrong.

Errors have limits, which a missing number gets: means over garments stay finite.
"""

import re
from collections.abc import Sequence
from dataclasses import astuple, dataclass, make_dataclass
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.optimize import linear_sum_assignment

from gcd_dataset.measurements import ANGLES, MEASURES
from gcd_dataset.tensors import EDGE_LABELS

MOST_CM, MOST_DEGREES = 100.0, 180.0  # largest errors of a position or length, and of an angle
CLOSE = 1.0  # cm: mean distance of a drape that is right
LEAST_EXACT = 0.99  # share of the vertices of a garment whose panels count as right throughout

PANEL_CLASSES = (
    "other",
    *(f"{side}_{part}" for side in ("left", "right") for part in (
        "ftorso", "btorso", "sleeve_f", "sleeve_b", "collar_front", "collar_back", "hood",
    )),
    *(f"sl_{side}_cuff{kind}_{part}" for side in ("left", "right") for kind in ("", "_skirt") for part in "fb"),
    *(f"pant_{part}_{side}" for side in "lr" for part in "fb"),
    *(f"pant_{side}_cuff{kind}_{part}" for side in "lr" for kind in ("", "_skirt") for part in "fb"),
    "wb_front", "wb_back", "skirt_front", "skirt_back", "skirt_panel", "ins_skirt_front", "ins_skirt_back",
)  # fmt: skip
"""Names of panels without numbers, the classes of task T4; ``other`` for names that are not listed."""
CLASS_OF = {name: row for row, name in enumerate(PANEL_CLASSES)}


def panel_class(name: str) -> int:
    """The row of ``PANEL_CLASSES`` for the name of a panel.

    >>> PANEL_CLASSES[panel_class("ins_skirt_front_3")], PANEL_CLASSES[panel_class("pocket")]
    ('ins_skirt_front', 'other')
    """
    return CLASS_OF.get(re.sub(r"_?\d+", "", name), 0)


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
    """Share of all vertices with the right seam; off seams, none is right."""
    on_seam_label: float
    """The same among the vertices on seams."""
    seam_f1: float
    """F1 of being on any seam."""
    edge_label: float
    """Share of the vertices with the right edge label; off labelled edges, none is right."""
    on_edge_label: float
    """The same among the vertices on labelled edges."""


def true_labels(
    count: int,
    *,
    faces: Int[np.ndarray, "f 3"],
    panel_id: Int[np.ndarray, " f"],
    classes: Int[np.ndarray, " p"],
    seams: Int[np.ndarray, "n 2"],
    labels: Int[np.ndarray, "m 2"],
    stitches: int,
) -> TrueLabels:
    """The labels of the ``count`` vertices of a box mesh.

    ``classes``: row of ``PANEL_CLASSES`` of each panel; ``seams``, ``labels``: pairs of a vertex and a seam, of the
    ``stitches`` seams, or a row of ``EDGE_LABELS``.
    """
    vertex, panel = faces.ravel(), np.repeat(panel_id, 3)
    known = labels[labels[:, 1] < len(EDGE_LABELS)]
    edge = _members(count, known[:, 0], known[:, 1], len(EDGE_LABELS))
    edge[:, 0] = ~edge[:, 1:].any(axis=1)
    return TrueLabels(
        panels=_members(count, vertex, panel, len(classes)),
        classes=_members(count, vertex, classes[panel], len(PANEL_CLASSES)),
        seams=_members(count, seams[:, 0], seams[:, 1], stitches),
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

    >>> assigned(np.array([5, 5, 7, 7, 2]), np.eye(2, dtype=bool)[[1, 1, 0, 0, 0]]).tolist()
    [1, 1, 0, 0, -1]
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
    numbers = np.unique(answer.panels, return_inverse=True)[1]  # a panel may have a negative number, a seam not
    panel, seam = assigned(numbers, true.panels), assigned(answer.seams, true.seams)
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
    """Whether each number is one of the true ones of its vertex; a number of no column is not."""
    found = np.zeros(len(numbers), bool)
    known = np.flatnonzero((numbers >= 0) & (numbers < true.shape[1]))
    found[known] = true[known, numbers[known]]
    return found


def _mean(values: Bool[np.ndarray, " n"], *, otherwise: bool) -> float:
    return float(values.mean()) if len(values) else float(otherwise)


def _mean_of_two(both: int, true: int, said: int) -> float:
    """F1 from counts; 1 if there is nothing to find and nothing is found."""
    return 2 * both / (true + said) if true + said else 1.0


MeasureScore: Any = make_dataclass(
    "MeasureScore",
    [("error_cm", float), ("error_degrees", float), *((name, float) for name in MEASURES)],
    frozen=True,
    namespace={
        "__doc__": "Absolute errors of a body's measures: means over lengths and angles, and each [cm, degrees]."
    },
)


def score_measures(answer: Float[np.ndarray, " m"], true: Float[np.ndarray, " m"]) -> Any:
    """The scores of an answer in the order of ``MEASURES`` [cm, degrees]. Raises ``ValueError`` for missing measures.

    >>> true = np.full(len(MEASURES), 50.0)
    >>> score_measures(true + 2, true).error_cm
    2.0
    """
    if np.shape(answer) != (len(MEASURES),) or not np.isfinite(true).all():
        raise ValueError(f"{np.size(answer)} measures, the truth has {np.isfinite(true).sum()} of {len(MEASURES)}")
    angle = np.array([name in ANGLES for name in MEASURES])
    errors = np.abs(np.asarray(answer, float) - np.asarray(true, float))
    errors = np.fmin(errors, np.where(angle, MOST_DEGREES, MOST_CM))  # NaN: the limit
    return MeasureScore(float(errors[~angle].mean()), float(errors[angle].mean()), *errors.tolist())


@dataclass(frozen=True)
class DrapeScore:
    """Scores of the predicted drape of one garment; smaller is better, but for ``within_1cm``."""

    error_cm: float
    """Mean distance of a vertex from its place in the drape, each at most ``MOST_CM``."""
    error_p95_cm: float
    """95th percentile of these distances."""
    within_1cm: float
    """1 if the mean distance is at most 1 cm."""
    stretch_error: float
    """Mean difference of edge lengths from those in the drape, over the flat length; at most 1."""
    self_crossings: float
    """Edges of the cloth that cross the cloth."""
    body_crossings: float
    """Edges of the cloth that cross the skin."""
    body_through: float
    """Edges of the skin that cross the cloth."""


def score_drape(
    answer: Float[np.ndarray, "v 3"],
    true: Float[np.ndarray, "v 3"],
    faces: Int[np.ndarray, "f 3"],
    flat: Float[np.ndarray, "f 3 2"],
    crossings: tuple[int, int, int],
) -> DrapeScore:
    """The scores of positions [cm]; ``flat``: corners of the faces in the planes of their panels [cm].

    ``crossings``: edges of cloth through cloth, of cloth through skin, of skin through cloth. Raises ``ValueError`` for
    another number of vertices.
    """
    if answer.shape != true.shape:
        raise ValueError(f"positions of shape {answer.shape} for {len(true)} vertices")
    away = np.fmin(np.linalg.norm(answer - true, axis=1), MOST_CM)  # NaN: the limit
    off = np.abs(_sides(answer[faces]) - _sides(true[faces])) / np.maximum(_sides(flat), 1e-2)
    error = float(away.mean())
    return DrapeScore(
        error_cm=error,
        error_p95_cm=float(np.percentile(away, 95)),
        within_1cm=float(error <= CLOSE),
        stretch_error=float(np.fmin(off.mean(), 1.0)),
        self_crossings=float(crossings[0]),
        body_crossings=float(crossings[1]),
        body_through=float(crossings[2]),
    )


def score_motion(
    answer: Float[np.ndarray, "t v 3"],
    true: Float[np.ndarray, "t v 3"],
    faces: Int[np.ndarray, "f 3"],
    flat: Float[np.ndarray, "f 3 2"],
    crossings: Sequence[tuple[int, int, int]],
) -> DrapeScore:
    """The mean scores of the frames of a motion after the first, which is given: ``within_1cm`` is a share of frames.

    ``crossings``: of each of these frames; other arguments, and errors, as of ``score_drape``.
    """
    if answer.shape != true.shape:
        raise ValueError(f"positions of shape {answer.shape} for {true.shape}")
    frames = zip(answer[1:], true[1:], crossings, strict=True)
    scores = [astuple(score_drape(there, place, faces, flat, counts)) for there, place, counts in frames]
    return DrapeScore(*np.mean(scores, axis=0).tolist())


def _sides(corner: Float[np.ndarray, "f 3 d"]) -> Float[np.ndarray, "f 3"]:
    return np.asarray(np.linalg.norm(corner[:, [1, 2, 0]] - corner, axis=-1))
