"""Fits ``generator/data/adults.npz``: the distribution of shape weights among the adults of a survey.

    python -m tools.body_model.calibrate generator/data

Takes five minutes of one core, and needs the body model alone. The prior of each sex is a Gaussian about its mean body.
Among all Gaussians with the published mean and covariance of the measures, the result is the nearest to the prior in
Kullback-Leibler divergence. The measures are linearised in the weights, which gives a closed form:

    mean        = mean₀ + gain (published mean - measures at mean₀),    gain = Σ₀ Jᵀ (J Σ₀ Jᵀ)⁻¹
    covariance  = Σ₀ + gain (published covariance - J Σ₀ Jᵀ) gainᵀ

with J the Jacobian of the measures. Since measures are not quite linear far from the mean, each round draws and
measures bodies and corrects the target by the error of their statistics; the round with the smallest error wins.
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
from gcd_dataset.generator.body.shape import MAX_DEVIATION, SEXES, Adults, build_body
from gcd_dataset.records import BodyPart, BodyShape
from tools.body_model.survey import Survey, survey_measures, survey_of

ROUNDS = 6
DAMPING = 0.3  # share of the correction that is applied after a round, since measures vary together
PEOPLE = 700  # bodies drawn in a round, each with its mirror image about the mean (antithetic sampling)
STEP = 0.3  # half width of the central differences [standard deviations]
SWEEPS = 60  # iterations of iterative proportional fitting
NEAR = (0.02, 0.1, 0.1)
"""Errors of equal weight: of a mean and of a standard deviation (relative), and of a correlation with the height."""
WIDEST = 5.0
"""Largest variance along any axis of the weights; 1 in the body model. The model hardly varies in some combinations of
measures (wrist and neck against thigh and hips), so their published variance would need implausible bodies."""
ALONE = ("waist_breadth", "waist_depth", "bust_depth")
"""Measures fitted by variance alone, since the survey publishes no correlations for them."""
TOGETHER = ("height", "weight")
"""Fitted as a pair after all others: the weight follows from the girths and cannot vary independently."""
FLANK = (0.545, 0.605)
"""Heights of the flank between hips and waist, as shares of the mean body's height."""
FLANK_SD = 0.08
"""Standard deviation of the flanks' height as a share of the mean body's, about that of the mean woman or man. The
model shortens the trunk in this narrow band alone: a body that loses most of it has a ledge at the hips."""
FLANK_TOLERANCE = 0.02


def main() -> None:
    """Write the adults of both sexes and a checksum into a folder."""
    parser = argparse.ArgumentParser(description="fit adults.npz to a survey")
    parser.add_argument("folder", type=Path, help="folder for adults.npz and adults.npz.sha256")
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
    """The distribution of shape weights fitted to the survey's figures for one sex."""
    survey, start = survey_of(sex), body_model().named[sex].astype(float)
    prior, jacobian, stretch = within_sex_covariance(), _jacobian(start, survey), flank_stretch()[None]
    published = _Statistics.published(survey)
    target = published
    mean, covariance = start, prior
    normals = np.random.default_rng(0).standard_normal((PEOPLE, len(start)))
    people = np.clip(np.concatenate([normals, -normals]), -MAX_DEVIATION, MAX_DEVIATION)
    rounds = []
    for number in range(ROUNDS):
        conditions = [*_conditions(survey, jacobian, target), (stretch, np.array([[FLANK_SD**2]]))]
        covariance = _bounded(nearest_covariance(prior, conditions))
        adults = Adults(mean, _axes(covariance))
        found = _Statistics.of(_measured(mean + people @ adults.axes.T, survey), survey)
        rounds.append((published.error(found, survey), number, adults))
        print(f"{sex}, round {number}, error {rounds[-1][0]:.3f}:")
        print(published.comparison(found, survey))
        target = target.corrected(published, found)
        error = published.mean - found.mean
        mean = _next_mean(mean, start, prior, (jacobian, stretch), error, survey)
    return min(rounds)[-1]


def within_sex_covariance() -> Float[np.ndarray, "k k"]:
    """Covariance of the weights among the adults of one sex, by the body model.

    The model pools both sexes, with unit covariance; this subtracts the contribution of the distance between the sexes.
    """
    named = body_model().named
    apart = (named["male"] - named["female"]).astype(float)
    return np.eye(len(apart)) - np.outer(apart, apart) / max(4.0, 1.1 * apart @ apart)


def flank_stretch() -> Float[np.ndarray, " k"]:
    """Change of the flanks' height by each weight, as a share of the mean body's: the slope of ``y`` over its mean."""
    model = body_model()
    x, y = np.abs(model.mean[:, 0]), model.mean[:, 1]
    trunk = np.isin(model.parts, [part.value for part in (BodyPart.TRUNK, BodyPart.LEFT_LEG, BodyPart.RIGHT_LEG)])
    band = trunk & (y > FLANK[0] * y.max()) & (y < FLANK[1] * y.max())
    flanks = band & (x > 0.6 * x[band].max())
    heights = y[flanks] - y[flanks].mean()
    return model.components[:, flanks, 1] @ heights / (heights @ heights)


def nearest_covariance(
    prior: Float[np.ndarray, "k k"], conditions: Sequence[tuple[Float[np.ndarray, "m k"], Float[np.ndarray, "m m"]]]
) -> Float[np.ndarray, "k k"]:
    """The covariance nearest to ``prior`` with a given covariance of each condition's ``jacobian @ weights``.

    ``conditions`` holds pairs (jacobian, covariance), met in turn by iterative proportional fitting; contradictory
    conditions are met approximately.
    """
    found = prior
    for jacobian, wanted in list(conditions) * SWEEPS:
        current = jacobian @ found @ jacobian.T
        gain = np.linalg.solve(current, jacobian @ found).T
        found = found + gain @ (wanted - current) @ gain.T
    return found


# ---------------------------------------------------------------------------------------------------------- statistics


@dataclass(frozen=True)
class _Statistics:
    """Means and standard deviations of all measures; correlations between the measures ``survey.correlated``."""

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
        """These targets, each moved by the share ``DAMPING`` of the error of ``found`` against ``wanted``."""
        return replace(
            self,
            sd=self.sd * (wanted.sd / found.sd) ** DAMPING,
            correlation=self.correlation + DAMPING * (wanted.correlation - found.correlation),
        )

    def error(self, found: Self, survey: Survey) -> float:
        """Root mean square error of the statistics ``found`` against these, in units of ``NEAR``."""
        known, height = np.isfinite(survey.tolerance), survey.correlated.index("height")
        relative = (found.mean / self.mean - 1)[known], found.sd / self.sd - 1
        errors = (*relative, (found.correlation - self.correlation)[height])
        return float(np.sqrt(np.mean(np.concatenate([e / near for e, near in zip(errors, NEAR, strict=True)]) ** 2)))

    def comparison(self, found: Self, survey: Survey) -> str:
        """A table with both means and standard deviations, a line for each measure."""
        columns = (survey.measures, self.mean, found.mean, found.mean / self.mean - 1)
        spreads = (self.sd, found.sd, found.sd / self.sd - 1)
        lines = [
            f"  {name:14} {mean:7.2f} {ours:7.2f} {error:+7.1%}   {sd:6.2f} {our_sd:6.2f} {sd_error:+7.1%}"
            for name, mean, ours, error, sd, our_sd, sd_error in zip(*columns, *spreads, strict=True)
        ]
        height = survey.correlated.index("height")
        pairs = zip(survey.correlated, self.correlation[height], found.correlation[height], strict=True)
        lines += [
            f"  height and {name:14} {theirs:5.2f} {ours:5.2f}" for name, theirs, ours in pairs if name != "height"
        ]
        worst = np.abs(self.correlation - found.correlation).max()
        return "\n".join([*lines, f"  correlations differ by {worst:.2f} at most"])


def _conditions(
    survey: Survey, jacobian: Float[np.ndarray, "m k"], target: _Statistics
) -> list[tuple[Float[np.ndarray, "c k"], Float[np.ndarray, "c c"]]]:
    """Jacobian and target covariance of each group: ``ALONE`` one by one, correlated measures, ``TOGETHER``."""
    alone = [(jacobian[[column]], target.sd[[column], None] ** 2) for column in _columns(survey, ALONE)]
    groups = ([name for name in survey.correlated if name != "weight"], TOGETHER)
    return [*alone, *(_correlated(survey, jacobian, target, names) for names in groups)]


def _correlated(
    survey: Survey, jacobian: Float[np.ndarray, "m k"], target: _Statistics, names: Sequence[str]
) -> tuple[Float[np.ndarray, "c k"], Float[np.ndarray, "c c"]]:
    columns, rows = _columns(survey, names), [survey.correlated.index(name) for name in names]
    sd = target.sd[columns]
    return jacobian[columns], target.correlation[np.ix_(rows, rows)] * np.outer(sd, sd)


def _next_mean(
    mean: np.ndarray,
    start: np.ndarray,
    prior: np.ndarray,
    jacobians: tuple[np.ndarray, np.ndarray],
    error: np.ndarray,
    survey: Survey,
) -> Float[np.ndarray, " k"]:
    """One Gauss-Newton step on the mean weights, with the measures' tolerances and a prior at ``start``.

    ``jacobians``: of the measures, and of the flanks' height, which stays that of ``start``.
    """
    known = np.isfinite(survey.tolerance)
    rows = np.concatenate([jacobians[0][known], jacobians[1]])
    right = np.append(error[known] + jacobians[0][known] @ (mean - start), 0.0)
    tolerance = np.append(survey.tolerance[known], FLANK_TOLERANCE)
    matrix = rows @ prior @ rows.T + np.diag(tolerance**2)
    return start + prior @ rows.T @ np.linalg.solve(matrix, right)


def _bounded(covariance: Float[np.ndarray, "k k"]) -> Float[np.ndarray, "k k"]:
    values, vectors = np.linalg.eigh(covariance)
    return (vectors * np.minimum(values, WIDEST)) @ vectors.T


def _axes(covariance: Float[np.ndarray, "k k"]) -> Float[np.ndarray, "k k"]:
    values, vectors = np.linalg.eigh(covariance)
    return vectors * np.sqrt(values)


def _columns(survey: Survey, names: Sequence[str]) -> list[int]:
    return [survey.measures.index(name) for name in names]


def _jacobian(weights: Float[np.ndarray, " k"], survey: Survey) -> Float[np.ndarray, "m k"]:
    """Derivatives of the measures by the weights, by central differences."""
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
