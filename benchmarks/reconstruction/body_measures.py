"""Scores of predicted body measures (task T5)."""

from dataclasses import make_dataclass
from typing import Any

import numpy as np
from jaxtyping import Float

from gcd_dataset.measurements import ANGLES, MEASURES

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
    errors = np.abs(np.asarray(answer, float) - np.asarray(true, float))
    angle = np.array([name in ANGLES for name in MEASURES])
    return MeasureScore(float(errors[~angle].mean()), float(errors[angle].mean()), *errors.tolist())
