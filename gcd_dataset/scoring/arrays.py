"""Answers that are no patterns: labels of vertices (T4), measures (T5), drapes (T6), motions (T8), and their scores.

An answer that is missing, cannot be read, has another number of vertices or is not finite gets the worst of every
score, for a reason, and stops nothing.
"""

from collections.abc import Callable, Mapping
from dataclasses import asdict, fields, replace
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from gcd_dataset.errors import SpecError
from gcd_dataset.generator.drape import DrapeJob
from gcd_dataset.jsonfile import JsonPath, read_json
from gcd_dataset.measurements import MEASURES
from gcd_dataset.meshedges import mesh_edges
from gcd_dataset.metrics import (
    TrueLabels,
    VertexLabels,
    VertexScore,
    score_drape,
    score_labels,
    score_measures,
    score_motion,
)
from gcd_dataset.records import BoxMesh, Pattern
from gcd_dataset.scoring.answers import read_arrays
from gcd_dataset.scoring.bodies import wearers_of
from gcd_dataset.scoring.draping import crossings_of, motion_crossings
from gcd_dataset.scoring.garments import NO_ANSWER, Scored, kind_of
from gcd_dataset.scoring.inputs import MESH, TaskFolder
from gcd_dataset.tensors import EDGE_LABELS

ENDINGS = {"T4": ".npz", "T5": ".json", "T6": ".npz", "T8": ".npz"}
FAR = 1e4  # cm: no drape reaches as far
Judged = tuple[Any, Callable[[Path], Any]]
"""The worst scores of a garment, and the scores of the answer in a file."""


def answer_files(task: TaskFolder, answers: Path) -> dict[str, Path]:
    """Garment to the file of its answer. Raises ``SpecError`` for a folder that is missing or holds none."""
    ending = ENDINGS[task.task]
    if found := {path.stem: path for path in sorted(answers.glob(f"*{ending}"))}:
        return found
    raise SpecError(f"{answers}: no answers: give a folder of NAME{ending}")


def score_arrays(task: TaskFolder, name: str, true: Pattern, answer: Path | None) -> Scored:
    """The scores of an answer for the garment ``name``. Raises ``SpecError`` for truth that cannot be read."""
    worst, score = JUDGES[task.task](task, name, true)
    try:
        if answer is None:
            raise SpecError(NO_ANSWER)
        values, failure = score(answer), ""
    except SpecError as error:
        values, failure = worst, str(error).removeprefix(f"{answer}: ")
    return Scored(name, kind_of(true), true, None, asdict(values), failure)


def _judged_labels(task: TaskFolder, name: str, true: Pattern) -> Judged:
    truth = TrueLabels(**read_arrays(task.truth / f"{name}.npz", [field.name for field in fields(TrueLabels)]))

    def score(path: Path) -> VertexScore:
        found = read_arrays(path, [field.name for field in fields(VertexLabels)])
        for key, numbers in found.items():
            if numbers.shape != (len(truth.panels),) or numbers.dtype.kind not in "iu":
                fault = f"{key}: {numbers.dtype} of shape {numbers.shape}"
                raise SpecError(f"{fault}: give {len(truth.panels)} whole numbers")
        return score_labels(VertexLabels(**found), truth)

    return VertexScore(*[0.0] * len(fields(VertexScore))), score


def _judged_measures(task: TaskFolder, name: str, true: Pattern) -> Judged:
    truth = read_arrays(task.truth / f"{name}.npz", ["measures"])["measures"]

    def score(path: Path) -> Any:
        at = JsonPath(str(path))
        found = at.mapping(read_json(path, "model's answer"), "the file")
        return score_measures(np.array([at.number(found.get(key), key) for key in MEASURES]), truth)

    return score_measures(np.full(len(MEASURES), np.nan), truth), score


def _judged_drape(task: TaskFolder, name: str, true: Pattern) -> Judged:
    """Of a drape (T6), or of a motion (T8)."""
    moving = ("body_vertices",) if task.task == "T8" else ()
    given = read_arrays(task.inputs / f"{name}.npz", ("vertices", *MESH, *moving, "body_faces"))
    truth = read_arrays(task.truth / f"{name}.npz", ("vertices", "legs_apart"))
    cloth, skin = (len(mesh_edges(given[key]).ends) for key in ("faces", "body_faces"))
    compared = truth["vertices"].astype(float), given["faces"], given["uv"][given["corners"]].astype(float)

    def score(path: Path) -> Any:
        found, mesh = _positions(path, compared[0].shape), box_mesh_of(given, true)
        body, size = wearers_of(str(task.bodies)).wearer(name, legs_apart=bool(truth["legs_apart"]))
        job = DrapeJob(mesh, body, size)
        if not moving:
            return score_drape(found, *compared, *crossings_of([job], [found]))
        moved = (replace(body, vertices=place.astype(float)) for place in given["body_vertices"][1:])
        return score_motion(found, *compared, list(motion_crossings(job, moved, found[1:])))

    worst, crossings = np.full(compared[0].shape, np.nan), (cloth, cloth, skin)
    if not moving:
        return score_drape(worst, *compared, crossings), score
    return score_motion(worst, *compared, [crossings] * (len(worst) - 1)), score


def _positions(path: Path, shape: tuple[int, ...]) -> Float[np.ndarray, "*t v 3"]:
    found = read_arrays(path, ["vertices"])["vertices"]
    if found.shape != shape or found.dtype.kind not in "fiu" or not (np.abs(found) < FAR).all():
        raise SpecError(f"vertices: {found.dtype} of shape {found.shape}: give {shape} finite numbers [cm]")
    return np.asarray(found, float)


JUDGES: Mapping[str, Callable[[TaskFolder, str, Pattern], Judged]] = {
    "T4": _judged_labels, "T5": _judged_measures, "T6": _judged_drape, "T8": _judged_drape
}  # fmt: skip


def box_mesh_of(arrays: Mapping[str, np.ndarray], pattern: Pattern) -> BoxMesh:
    """The box mesh of a pattern from ``vertices`` and the arrays ``MESH``."""
    labels = arrays["labels"]
    known = {name: labels[labels[:, 1] == row, 0].astype(int) for row, name in enumerate(EDGE_LABELS) if name}
    return BoxMesh(
        vertices=arrays["vertices"].astype(float),
        uv=arrays["uv"].astype(float),
        panel_names=tuple(panel.name for panel in pattern.panels),
        panel_labels=tuple(panel.label for panel in pattern.panels),
        labels={name: rows for name, rows in known.items() if len(rows)},
        **{name: arrays[name].astype(np.int64) for name in ("faces", "corners", "uv_vertex", "panel_id", "seams")},
    )
