"""Fits a body to given measures: Gauss-Newton in the shape space with a population prior.

Minimises the sum of squares of (measure - given) / ``TOLERANCE`` and of the shape weights, which are in standard
deviations of the population. The minimum is the most probable body with these measures: its Mahalanobis distance from
the mean body is the least. The angle of the arms is a further unknown.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from gcd_dataset.errors import BodyError
from gcd_dataset.generator.body.asset import body_model
from gcd_dataset.generator.body.measuring import measure
from gcd_dataset.generator.body.shape import build_body
from gcd_dataset.records import ANGLES, MEASURES, BodyShape, Measurements

STEPS = 12
DIFFERENCES = (0.3, 0.1)
"""Half widths of the central differences, used in turn [standard deviations]. Girth levels are searched in steps of
5 mm, so measures jump with the level. If a jump hides the derivative at one width, the other width shows it."""
STEP_SHARES = (1.0, 0.5, 0.25, 0.1)  # tried in a line search
MAX_STEP = 2.0  # standard deviations: largest change of a weight in a step; measures are nearly linear within it
LEAST_GAIN = 1e-3  # the fit ends when the relative decrease of the cost is smaller at every width
TOLERANCE = 0.1  # cm: error of a measure with the same cost as one standard deviation of a weight
ANGLE_TOLERANCE = np.radians(0.1)
ARM_SPREAD = np.radians(9.0)  # standard deviation of the drawn arm angle, uniform over ±15°
MAX_FACTOR = 3.0  # largest ratio of a length to the mean body's, or inverse: others are in another unit
MAX_ERROR = 0.1  # largest error of an accepted fit: relative for lengths, absolute for angles [rad]
MAX_ERROR_CM = 3.0  # cm: largest error of a length that is accepted even if its relative error is larger
REACH = 12.0
"""Largest distance from the mean body, over all weights [standard deviations]; drawn bodies are at 3 (pooled) to 10
(women and men)."""
REMEDY = "give lengths in cm, all of one person, or leave doubtful ones open (NaN)"

_ANGLE = np.isin(MEASURES, list(ANGLES))
_SCALE = np.where(_ANGLE, ANGLE_TOLERANCE, TOLERANCE)


class FittedShape(NamedTuple):
    """A body fitted to measures."""

    shape: BodyShape
    residual: Measurements
    """Measures of the body minus the given ones [cm, rad]; NaN for measures left open."""


def fit_shape(measures: Measurements) -> FittedShape:
    """The most probable body with the given measures and legs straight; measures that are NaN are left open.

    Takes some seconds of one core. Raises ``BodyError`` if no measure is given, a length is implausible, or the nearest
    body misses a measure by more than a tenth.
    """
    wanted = _values(measures)
    _require_plausible(wanted)
    found = np.zeros(len(body_model().components) + 1)
    gains = [np.inf] * len(DIFFERENCES)
    for step in range(STEPS):
        cost = _cost(found, wanted)
        found = _step(found, wanted, DIFFERENCES[step % len(DIFFERENCES)])
        _require_within_reach(found, 1.25 * REACH)  # beyond it, later steps do not return
        gains = [*gains[1:], 1 - _cost(found, wanted) / max(cost, 1e-12)]
        if max(gains) < LEAST_GAIN:
            break
    residual = _measured(found) - wanted
    _require_close(wanted, residual)
    _require_within_reach(found, REACH)
    return FittedShape(_shape(found), Measurements(**dict(zip(MEASURES, residual.tolist(), strict=True))))


def _require_plausible(wanted: Float[np.ndarray, " m"]) -> None:
    if np.isnan(wanted).all():
        raise BodyError("no measure is given: give at least one, such as the height")
    usual = _measured(np.zeros(len(body_model().components) + 1))
    for name, value, mean in zip(MEASURES, wanted, usual, strict=True):
        if np.isinf(value) or (
            name not in ANGLES and not np.isnan(value) and not 1 / MAX_FACTOR < value / mean < MAX_FACTOR
        ):
            raise BodyError(
                f"{name} is {value:g} cm, and {mean:.1f} cm on the mean body: give a length in cm, or NaN for none"
            )


def _require_close(wanted: Float[np.ndarray, " m"], residual: Float[np.ndarray, " m"]) -> None:
    allowed = np.where(_ANGLE, MAX_ERROR, np.maximum(MAX_ERROR * np.abs(wanted), MAX_ERROR_CM))
    share = np.nan_to_num(np.abs(residual) / allowed)
    worst = int(share.argmax())
    if share[worst] > 1.0:
        unit, size = ("°", np.degrees(1.0)) if _ANGLE[worst] else (" cm", 1.0)
        raise BodyError(
            f"no adult has these measures: {MEASURES[worst]} is {size * wanted[worst]:.1f}{unit}, and "
            f"{size * (wanted + residual)[worst]:.1f}{unit} on the nearest body: {REMEDY}"
        )


def _require_within_reach(found: Float[np.ndarray, " u"], reach: float) -> None:
    distance = float(np.linalg.norm(found))
    if distance > reach:
        raise BodyError(
            f"no adult has these measures: the body is {distance:.0f} standard deviations from the mean body "
            f"(at most {REACH:.0f} are accepted): {REMEDY}"
        )


# Unknowns (u): the shape weights, then the arm angle in units of ARM_SPREAD.


def _step(found: Float[np.ndarray, " u"], wanted: Float[np.ndarray, " m"], width: float) -> Float[np.ndarray, " u"]:
    """One Gauss-Newton step with a line search; ``found`` itself if no point on the step is better."""
    given = np.isfinite(wanted)
    ahead, behind = ([_measured(found + way * row) for row in width * np.eye(len(found))] for way in (1.0, -1.0))
    jacobian = ((np.array(ahead) - np.array(behind)).T / (2 * width) / _SCALE[:, None])[given]  # central differences
    error = ((_measured(found) - wanted) / _SCALE)[given]
    step = -np.linalg.solve(jacobian.T @ jacobian + np.eye(len(found)), jacobian.T @ error + found)
    step *= min(1.0, MAX_STEP / max(np.abs(step).max(), 1e-12))
    candidates = [found, *(found + share * step for share in STEP_SHARES)]
    return min(candidates, key=lambda unknowns: _cost(unknowns, wanted))


def _cost(unknowns: Float[np.ndarray, " u"], wanted: Float[np.ndarray, " m"]) -> float:
    error = (_measured(unknowns) - wanted) / _SCALE
    return float(np.nansum(error**2) + (unknowns**2).sum())


def _measured(unknowns: Float[np.ndarray, " u"]) -> Float[np.ndarray, " m"]:
    return _values(measure(build_body(_shape(unknowns))))


def _shape(unknowns: Float[np.ndarray, " u"]) -> BodyShape:
    return BodyShape(unknowns[:-1].copy(), float(unknowns[-1] * ARM_SPREAD))


def _values(size: Measurements) -> Float[np.ndarray, " m"]:
    return np.array([getattr(size, name) for name in MEASURES])
