"""A body for given measures: Gauss-Newton in the shape space, held near the population.

What is made small is the sum of squares of (measure - asked) / ``TOLERANCE`` and of the shape weights, which are in
standard deviations of the population: of the bodies that have the measures, the most probable (its Mahalanobis distance
is the shortest). How far the arms are raised is found with them.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from gcd_dataset.errors import BodyError
from gcd_dataset.generator.body.asset import body_model
from gcd_dataset.generator.body.measuring import measure
from gcd_dataset.generator.body.shape import build_body
from gcd_dataset.records import ANGLES, MEASURES, BodyShape, Measurements

__all__ = ["FittedShape", "fit_shape"]

STEPS = 12
DIFFERENCES = (0.3, 0.1)
"""Half the widths of the differences that slopes are taken from, in turn [standard deviations]. Girths are searched in
steps of 5 mm, so heights that hang on them jump; what one width cannot see past, the other does."""
PARTS_OF_A_STEP = (1.0, 0.5, 0.25, 0.1)
LONGEST = 2.0  # standard deviations any weight goes in one step: measures are nearly linear that far
LEAST_GAIN = 1e-3  # share of the cost: a step that gains less is followed by one more of the other width, or none
TOLERANCE = 0.1  # cm that weigh as much as one standard deviation of one shape weight
ANGLE_TOLERANCE = np.radians(0.1)
ARM_SPREAD = np.radians(9.0)  # standard deviation of the drawn arms, evenly spread over ±15°
FACTOR = 3.0  # by which a length may differ from that of the mean body: more is another unit
FAR_OFF = 0.1  # share of a length, or radians: a body that misses a measure by more is no answer,
FAR_OFF_CM = 3.0  # unless the length is short
REACH = 12.0
"""Standard deviations from the mean body, in all weights together, beyond which nobody is a person: those drawn are at
3 (pooled) to 10 (of one sex)."""
REMEDY = "give lengths in cm, all of one person, or leave doubtful ones open (NaN)"

_ANGLE = np.isin(MEASURES, list(ANGLES))
_SCALE = np.where(_ANGLE, ANGLE_TOLERANCE, TOLERANCE)


class FittedShape(NamedTuple):
    """The body for some measures."""

    shape: BodyShape
    residual: Measurements
    """Its measures minus those asked for [cm, rad]; NaN where none was asked for."""


def fit_shape(measures: Measurements) -> FittedShape:
    """The most probable body that has the measures, its legs straight; measures that are NaN are left open.

    Takes some seconds of one core. Raises ``BodyError`` where no measure is given, one is not a length, or no body
    comes within a tenth of one of them.
    """
    wanted = _values(measures)
    _refuse_nonsense(wanted)
    found = np.zeros(len(body_model().components) + 1)
    gains = [np.inf] * len(DIFFERENCES)
    for step in range(STEPS):
        cost = _cost(found, wanted)
        found = _stepped(found, wanted, DIFFERENCES[step % len(DIFFERENCES)])
        _refuse_monsters(found, 1.25 * REACH)  # who has gone so far does not come back
        gains = [*gains[1:], 1 - _cost(found, wanted) / max(cost, 1e-12)]
        if max(gains) < LEAST_GAIN:
            break
    residual = _measured(found) - wanted
    _refuse_misses(wanted, residual)
    _refuse_monsters(found, REACH)
    return FittedShape(_shape(found), Measurements(**dict(zip(MEASURES, residual.tolist(), strict=True))))


# ------------------------------------------------------------------------------------------------------------ refusals


def _refuse_nonsense(wanted: Float[np.ndarray, " m"]) -> None:
    if np.isnan(wanted).all():
        raise BodyError("no measure is given: a body is fitted to at least one, such as the height")
    usual = _measured(np.zeros(len(body_model().components) + 1))
    for name, value, mean in zip(MEASURES, wanted, usual, strict=True):
        if np.isinf(value) or (name not in ANGLES and not np.isnan(value) and not 1 / FACTOR < value / mean < FACTOR):
            raise BodyError(
                f"{name} is {value:g} cm, of the mean body {mean:.1f}: give a length in cm, or NaN to leave it open"
            )


def _refuse_misses(wanted: Float[np.ndarray, " m"], residual: Float[np.ndarray, " m"]) -> None:
    allowed = np.where(_ANGLE, FAR_OFF, np.maximum(FAR_OFF * np.abs(wanted), FAR_OFF_CM))
    share = np.nan_to_num(np.abs(residual) / allowed)
    worst = int(share.argmax())
    if share[worst] > 1.0:
        unit, size = ("°", np.degrees(1.0)) if _ANGLE[worst] else (" cm", 1.0)
        raise BodyError(
            f"no adult has these measures: {MEASURES[worst]} is {size * wanted[worst]:.1f}{unit}, and of the nearest "
            f"body {size * (wanted + residual)[worst]:.1f}{unit}: {REMEDY}"
        )


def _refuse_monsters(found: Float[np.ndarray, " u"], reach: float) -> None:
    distance = float(np.linalg.norm(found))
    if distance > reach:
        raise BodyError(
            f"no adult has these measures: who has them is {distance:.0f} standard deviations from the mean body "
            f"(up to {REACH:.0f} are taken): {REMEDY}"
        )


# -------------------------------------------------------------------------------------------------------- Gauss-Newton
# Unknowns (u): the shape weights, then the raising of the arms in units of ARM_SPREAD.


def _stepped(found: Float[np.ndarray, " u"], wanted: Float[np.ndarray, " m"], width: float) -> Float[np.ndarray, " u"]:
    """The best point on the way of one step, or the same point where none is better."""
    asked = np.isfinite(wanted)
    slopes = (_slopes(found, width) / _SCALE[:, None])[asked]
    miss = ((_measured(found) - wanted) / _SCALE)[asked]
    step = -np.linalg.solve(slopes.T @ slopes + np.eye(len(found)), slopes.T @ miss + found)
    step *= min(1.0, LONGEST / max(np.abs(step).max(), 1e-12))
    tried = [found, *(found + part * step for part in PARTS_OF_A_STEP)]
    return min(tried, key=lambda unknowns: _cost(unknowns, wanted))


def _cost(unknowns: Float[np.ndarray, " u"], wanted: Float[np.ndarray, " m"]) -> float:
    miss = (_measured(unknowns) - wanted) / _SCALE
    return float(np.nansum(miss**2) + (unknowns**2).sum())


def _slopes(unknowns: Float[np.ndarray, " u"], width: float) -> Float[np.ndarray, "m u"]:
    """Slopes of the measures by the unknowns, by central differences."""
    steps = width * np.eye(len(unknowns))
    return np.array([_measured(unknowns + step) - _measured(unknowns - step) for step in steps]).T / (2 * width)


def _measured(unknowns: Float[np.ndarray, " u"]) -> Float[np.ndarray, " m"]:
    return _values(measure(build_body(_shape(unknowns))))


def _shape(unknowns: Float[np.ndarray, " u"]) -> BodyShape:
    return BodyShape(unknowns[:-1].copy(), float(unknowns[-1] * ARM_SPREAD))


def _values(size: Measurements) -> Float[np.ndarray, " m"]:
    return np.array([getattr(size, name) for name in MEASURES])
