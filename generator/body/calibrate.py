"""Fits ``generator/data/adults.npz``: which shape weights the adults of a survey have.

    python -m gcd_dataset.generator.body.calibrate generator/data

Takes five minutes of one core; nothing beyond the body model is needed. The body model gives a first Gaussian for each
sex, about its mean body. Of all Gaussians whose measures have the published mean and covariance the one nearest to it
(in the sense of Kullback and Leibler) is taken; both conditions are linear in the weights, and it has a closed form:

    mean        = mean₀ + gain (published mean - measures at mean₀),    gain = Σ₀ Jᵀ (J Σ₀ Jᵀ)⁻¹
    covariance  = Σ₀ + gain (published covariance - J Σ₀ Jᵀ) gainᵀ

with J the slopes of the measures by the weights. Measures bend a little where the weights go far, so bodies are drawn
and measured, and what their statistics miss is added to what is aimed at, a few times over; the round that misses
least is kept.
"""

import argparse
import hashlib
import io
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Self

import numpy as np
from jaxtyping import Float

from gcd_dataset.files import write_whole
from gcd_dataset.generator.body import measure
from gcd_dataset.generator.body.asset import body_model
from gcd_dataset.generator.body.population import FURTHEST, SEXES, Adults
from gcd_dataset.generator.body.shape import build_body
from gcd_dataset.generator.body.survey import Survey, survey_measures, survey_of
from gcd_dataset.records import BodyShape

__all__ = ["calibrated"]

ROUNDS = 6
DAMPING = 0.3  # of the corrections between rounds: a variation asked of one measure is also one of others
PEOPLE = 700  # drawn in a round, each with its opposite
STEP = 0.3  # standard deviations: half the width of the differences that slopes are taken from
SWEEPS = 60
NEAR = (0.02, 0.1, 0.1)
"""What counts alike as a miss: of a mean and of a standard deviation (shares), and of a correlation with the height."""
WIDEST = 5.0
"""Largest variance along any axis of the weights, which have 1 in the body model. A few combinations of measures hardly
vary there (wrist and neck against thigh and hips); to have them vary as published would take bodies that look wrong."""
ALONE = ("waist_breadth", "waist_depth", "bust_depth")
"""Measures that only their own variance is asked of: the survey's table holds no correlations of theirs."""
TOGETHER = ("height", "weight")
"""Asked for by themselves, after all others: the weight follows from the girths, and can vary in no way of its own."""


def main() -> None:
    """Calibrates both sexes into a folder."""
    parser = argparse.ArgumentParser(description="fit adults.npz to a survey")
    parser.add_argument("folder", type=Path, help="where adults.npz and adults.npz.sha256 go")
    folder = parser.parse_args().folder
    buffer = io.BytesIO()
    arrays: dict[str, np.ndarray] = {}
    for sex in SEXES:
        adults = calibrated(sex)
        arrays |= {f"{sex}_mean": adults.mean.astype(np.float32), f"{sex}_axes": adults.axes.astype(np.float32)}
    np.savez_compressed(buffer, **arrays)  # type: ignore[arg-type]
    digest = hashlib.sha256(buffer.getvalue()).hexdigest()
    write_whole(folder / "adults.npz", buffer.getvalue())
    write_whole(folder / "adults.npz.sha256", f"{digest}  adults.npz\n".encode())


def calibrated(sex: str) -> Adults:
    """The adults of one sex."""
    survey, start = survey_of(sex), body_model().named[sex].astype(float)
    prior, slopes = within_sex_covariance(), _slopes(start, survey)
    aim = _Statistics.published(survey)
    wanted = aim
    mean, covariance = start, prior
    opposite = np.random.default_rng(0).standard_normal((PEOPLE, len(start)))
    people = np.clip(np.concatenate([opposite, -opposite]), -FURTHEST, FURTHEST)
    tried = []
    for number in range(ROUNDS):
        covariance = _bounded(nearest_covariance(prior, _conditions(survey, slopes, aim)))
        adults = Adults(mean, _axes(covariance))
        found = _Statistics.of(_measured(mean + people @ adults.axes.T, survey), survey)
        tried.append((wanted.miss(found, survey), number, adults))
        print(f"{sex}, round {number}, miss {tried[-1][0]:.3f}:")
        print(wanted.compared(found, survey))
        aim = aim.corrected(wanted, found)
        mean = _moved(mean, start, prior, slopes, wanted.mean - found.mean, survey)
    return min(tried)[-1]


def within_sex_covariance() -> Float[np.ndarray, "k k"]:
    """How weights vary among the adults of a sex in the body model.

    Over both sexes the weights have unit covariance; what the distance between the sexes has added to it is taken off.
    """
    named = body_model().named
    apart = (named["male"] - named["female"]).astype(float)
    return np.eye(len(apart)) - np.outer(apart, apart) / max(4.0, 1.1 * apart @ apart)


def nearest_covariance(
    prior: Float[np.ndarray, "k k"], conditions: Sequence[tuple[Float[np.ndarray, "m k"], Float[np.ndarray, "m m"]]]
) -> Float[np.ndarray, "k k"]:
    """Of all covariances under which each ``slopes @ weights`` has the one wanted, the one nearest to ``prior``.

    Conditions are met in turn, over and over (iterative proportional fitting); those that cannot all be met end in a
    compromise.
    """
    found = prior
    for slopes, wanted in list(conditions) * SWEEPS:
        own = slopes @ found @ slopes.T
        gain = np.linalg.solve(own, slopes @ found).T
        found = found + gain @ (wanted - own) @ gain.T
    return found


# ---------------------------------------------------------------------------------------------------------- statistics


@dataclass(frozen=True)
class _Statistics:
    """Mean and standard deviation of all measures, correlations of those for which they are published."""

    mean: Float[np.ndarray, " m"]
    sd: Float[np.ndarray, " m"]
    correlation: Float[np.ndarray, "c c"]

    @classmethod
    def published(cls, survey: Survey) -> Self:
        return cls(survey.mean, survey.sd, survey.correlation)

    @classmethod
    def of(cls, measured: Float[np.ndarray, "n m"], survey: Survey) -> Self:
        chosen = measured[:, _columns(survey, survey.correlated)]
        return cls(measured.mean(axis=0), measured.std(axis=0, ddof=1), np.corrcoef(chosen.T))

    def corrected(self, wanted: Self, found: Self) -> Self:
        """An aim moved by some of what was missed."""
        return replace(
            self,
            sd=self.sd * (wanted.sd / found.sd) ** DAMPING,
            correlation=self.correlation + DAMPING * (wanted.correlation - found.correlation),
        )

    def miss(self, found: Self, survey: Survey) -> float:
        """How far off other statistics are: root mean square over all figures, 1 for those off by ``NEAR``."""
        known, height = np.isfinite(survey.tolerance), survey.correlated.index("height")
        shares = (found.mean / self.mean - 1)[known], found.sd / self.sd - 1
        misses = (*shares, (found.correlation - self.correlation)[height])
        return float(np.sqrt(np.mean(np.concatenate([m / near for m, near in zip(misses, NEAR, strict=True)]) ** 2)))

    def compared(self, found: Self, survey: Survey) -> str:
        """A line a measure: what both means and spreads are."""
        columns = (survey.measures, self.mean, found.mean, found.mean / self.mean - 1)
        spreads = (self.sd, found.sd, found.sd / self.sd - 1)
        lines = [
            f"  {name:14} {mean:7.2f} {own:7.2f} {off:+7.1%}   {sd:6.2f} {own_sd:6.2f} {sd_off:+7.1%}"
            for name, mean, own, off, sd, own_sd, sd_off in zip(*columns, *spreads, strict=True)
        ]
        height = survey.correlated.index("height")
        pairs = zip(survey.correlated, self.correlation[height], found.correlation[height], strict=True)
        lines += [f"  height and {name:14} {theirs:5.2f} {own:5.2f}" for name, theirs, own in pairs if name != "height"]
        worst = np.abs(self.correlation - found.correlation).max()
        return "\n".join([*lines, f"  correlations differ by {worst:.2f} at most"])


def _conditions(
    survey: Survey, slopes: Float[np.ndarray, "m k"], aim: _Statistics
) -> list[tuple[Float[np.ndarray, "c k"], Float[np.ndarray, "c c"]]]:
    """Slopes and covariances aimed at: of some measures alone, of those with known correlations, of ``TOGETHER``."""
    alone = [(slopes[[column]], aim.sd[[column], None] ** 2) for column in _columns(survey, ALONE)]
    groups = ([name for name in survey.correlated if name != "weight"], TOGETHER)
    return [*alone, *(_correlated(survey, slopes, aim, names) for names in groups)]


def _correlated(
    survey: Survey, slopes: Float[np.ndarray, "m k"], aim: _Statistics, names: Sequence[str]
) -> tuple[Float[np.ndarray, "c k"], Float[np.ndarray, "c c"]]:
    columns, rows = _columns(survey, names), [survey.correlated.index(name) for name in names]
    sd = aim.sd[columns]
    return slopes[columns], aim.correlation[np.ix_(rows, rows)] * np.outer(sd, sd)


def _moved(
    mean: np.ndarray, start: np.ndarray, prior: np.ndarray, slopes: np.ndarray, miss: np.ndarray, survey: Survey
) -> Float[np.ndarray, " k"]:
    """The next mean by Gauss-Newton, each measure within its tolerance, held near the body model's mean body."""
    known = np.isfinite(survey.tolerance)
    own = slopes[known]
    right = miss[known] + own @ (mean - start)
    return start + prior @ own.T @ np.linalg.solve(own @ prior @ own.T + np.diag(survey.tolerance[known] ** 2), right)


def _bounded(covariance: Float[np.ndarray, "k k"]) -> Float[np.ndarray, "k k"]:
    values, vectors = np.linalg.eigh(covariance)
    return (vectors * np.minimum(values, WIDEST)) @ vectors.T


def _axes(covariance: Float[np.ndarray, "k k"]) -> Float[np.ndarray, "k k"]:
    values, vectors = np.linalg.eigh(covariance)
    return vectors * np.sqrt(values)


def _columns(survey: Survey, names: Sequence[str]) -> list[int]:
    return [survey.measures.index(name) for name in names]


def _slopes(weights: Float[np.ndarray, " k"], survey: Survey) -> Float[np.ndarray, "m k"]:
    """Slopes of the measures by the weights, by central differences."""
    steps = STEP * np.eye(len(weights))
    up, down = np.split(_measured(weights + np.concatenate([steps, -steps]), survey), 2)
    return ((up - down) / (2 * STEP)).T


def _measured(weights: Float[np.ndarray, "n k"], survey: Survey) -> Float[np.ndarray, "n m"]:
    rows = []
    for row in weights:
        body = build_body(BodyShape(row))
        found = survey_measures(body, measure(body))
        rows.append([found[name] for name in survey.measures])
    return np.array(rows)


if __name__ == "__main__":
    main()
