"""Bodies: CPU time, agreement with a survey, and fitness for draping.

Three quarters of the bodies are drawn as ``bodies="random"`` draws them, women and men, and a quarter from the pool;
each is built with straight legs and with legs apart. Women, men and both together are compared with ANSUR II, measure
by measure in the survey's own definitions (``tools/body_model/survey.json``): one row of the table each. The survey's
mixed figures are those of as many women as men; "CAESAR" is the mean of GarmentCode's mean bodies where the definition
is the same. "within" counts measures whose mean differs by at most 2 %, or whose standard deviation by at most 10 %;
neck, shoulder width and arm length are defined differently there, so only their variation is compared. As in a survey
all bodies have the same pose, arms in the A-pose. ``failed`` counts bodies with a measure that is not a positive
number, ``crossing`` those whose trunk, arms or legs intersect themselves or each other; ``clearance`` is the gap
between arm and trunk 3 cm below the underarm point.

``shoulder_w`` is 2 to 3 cm below the survey's biacromial breadth because of the pose: the survey measures with hanging
arms, GarmentCode between the shoulder points of the A-pose, and lifted arms move these points together, on
GarmentCode's own mean body too (3.1 cm from the A-pose to the T-pose). ``biacromial`` and ``bideltoid`` are taken with
hanging arms: there the shoulder points are further apart than the acromia, and the shoulders as broad as the survey's.
"""

import argparse
import json
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from benchmarks.cases import CaseResult, Figure
from gcd_dataset.errors import ConfigError
from gcd_dataset.generator.body import build_body, measure
from gcd_dataset.generator.body.shape import POOLED, SEXES, arm_clearance, draw_from
from gcd_dataset.generator.drape.self_contact import skin_crossings
from gcd_dataset.records import ANGLES, MEASURES, Body, BodyShape, Measurements
from gcd_dataset.seeding import Stage, rng
from tools.body_model.survey import (
    HANGING,
    Survey,
    shoulder_breadths,
    shoulders_of,
    survey_measures,
    survey_of,
)

POPULATION = Path(__file__).parents[2] / "tools" / "body_model" / "population.json"
GROUPS = ("random", "random", "random", POOLED)
"""Groups from which the bodies are drawn, in turn."""
LEAST = 4 * len(GROUPS)
MIXED = "random"
MEAN_WITHIN, SD_WITHIN = 0.02, 0.10
FOLLOW_HEIGHT = {"weight": "weight", "navel_girth": "waist", "hips": "hips"}


@dataclass(frozen=True)
class DrawnBody:
    """A drawn body: its CPU times and measures, and its faults in both poses."""

    kind: str
    """``female``, ``male`` or ``pooled``."""
    mesh_seconds: float
    measure_seconds: float
    measures: Mapping[str, float]
    """Measures as the survey defines them [cm, kg]."""
    shoulders: Mapping[str, float]
    """Breadths with hanging arms [cm]."""
    failed: bool
    crossings: int
    clearance: float
    """Least gap between arm and trunk over both poses [cm]."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--count", type=int, default=600, help="bodies")
    parser.add_argument("--seed", type=int, default=0)


def run(options: argparse.Namespace) -> CaseResult:
    """Draw, build and measure bodies. Raises ``ConfigError`` for too few of them to compare."""
    if options.count < LEAST:
        raise ConfigError(f"count is {options.count}: give {LEAST} or more")
    draw(options.seed, 0)  # warm-up: loads the asset, compiles the kernel
    people = [draw(options.seed, number) for number in range(options.count)]
    values = {MIXED: _values(people, SEXES)} | {sex: _values(people, (sex,)) for sex in SEXES}
    if short := [sex for sex, found in values.items() if len(found) < 2]:
        raise ConfigError(f"count is {options.count}: fewer than two bodies are {short[0]}: give more")
    figures = [*_costs(people), *_pool(people), *_population(values), *_shoulders(people), *_soundness(people)]
    return CaseResult(figures, [row for sex in values for row in _rows(sex, values[sex])])


def draw(seed: int, number: int) -> DrawnBody:
    """Draw, build and measure body ``number``, in both poses."""
    begun = time.process_time()
    kind, shape = draw_from(GROUPS[number % len(GROUPS)], rng(seed, number, Stage.BODY))
    body = build_body(shape)  # partly built by the draw, which checks the arms' clearance
    built = time.process_time()
    size = measure(body)
    measured = time.process_time()
    apart = build_body(replace(shape, legs_apart=True))
    return DrawnBody(
        kind=kind,
        mesh_seconds=built - begun,
        measure_seconds=measured - built,
        measures=_surveyed(shape),
        shoulders=shoulder_breadths(build_body(replace(shape, arm_angle=HANGING))),
        failed=_is_failed(size) or _is_failed(measure(apart)),
        crossings=skin_crossings(body) + skin_crossings(apart),
        clearance=_min_clearance(body, apart),
    )


def _surveyed(shape: BodyShape) -> Mapping[str, float]:
    """Measures as the survey defines them, with lowered arms: raised ones lift the shoulders."""
    body = build_body(replace(shape, arm_angle=0.0))
    return survey_measures(body, measure(body))


def _is_failed(size: Measurements) -> bool:
    lengths = np.array([getattr(size, name) for name in MEASURES if name not in ANGLES])
    angles = np.array([getattr(size, name) for name in ANGLES])
    return not (np.isfinite(angles).all() and (lengths > 0).all())


def _min_clearance(*poses: Body) -> float:
    return min(arm_clearance(body) for body in poses)


# ------------------------------------------------------------------------------------------------------------- figures


def _costs(people: Sequence[DrawnBody]) -> list[Figure]:
    return [
        Figure(
            "mesh_cpu_ms",
            1e3 * float(np.mean([p.mesh_seconds for p in people])),
            "ms, drawing a shape and building its mesh",
        ),
        Figure("measure_cpu_ms", 1e3 * float(np.mean([p.measure_seconds for p in people])), "ms, all 26 measures"),
    ]


def _soundness(people: Sequence[DrawnBody]) -> list[Figure]:
    clearance = np.array([p.clearance for p in people])
    return [
        Figure("bodies", len(people), "in two poses each"),
        Figure("failed", sum(p.failed for p in people), "bodies with a measure that failed"),
        Figure("crossing", sum(p.crossings > 0 for p in people), "bodies that pass through themselves"),
        Figure("clearance_min", float(clearance.min()), "cm"),
        Figure("clearance_p1", float(np.quantile(clearance, 0.01)), "cm"),
        Figure("clearance_under_1cm", int((clearance < 1.0).sum()), "bodies"),
    ]


def _population(values: Mapping[str, Float[np.ndarray, "n m"]]) -> list[Figure]:
    figures = []
    for sex, found in values.items():
        survey = survey_of(sex)
        means, sds = _differences(survey, found)
        comparable = np.isfinite(means)
        figures += [
            Figure(
                f"{sex}_means", int((np.abs(means[comparable]) <= MEAN_WITHIN).sum()), f"of {comparable.sum()} within"
            ),
            Figure(f"{sex}_sds", int((np.abs(sds) <= SD_WITHIN).sum()), f"of {len(sds)} within"),
        ]
        for name, called in FOLLOW_HEIGHT.items():
            own, published = _correlation(survey, found, name)
            figures.append(Figure(f"{sex}_height_{called}", own, f"correlation, published {published:.3f}"))
        figures.append(Figure(f"{sex}_correlation_rms", _correlation_rms(survey, found), "off the published ones"))
    return figures


def _values(people: Sequence[DrawnBody], kinds: Sequence[str]) -> Float[np.ndarray, "n m"]:
    """The survey's measures of all bodies of these kinds."""
    return np.array([[p.measures[name] for name in survey_of(MIXED).measures] for p in people if p.kind in kinds])


def _pool(people: Sequence[DrawnBody]) -> list[Figure]:
    found = np.array([p.measures["height"] for p in people if p.kind == POOLED])
    women = float(np.mean([p.kind == "female" for p in people if p.kind != POOLED]))
    return [
        Figure("female_share", women, "of the random bodies"),
        Figure("pooled_height_mean", float(found.mean()), "cm"),
        Figure("pooled_height_sd", float(found.std(ddof=1)), "cm"),
    ]


def _shoulders(people: Sequence[DrawnBody]) -> list[Figure]:
    figures = []
    for sex in SEXES:
        for name, (mean, sd) in shoulders_of(sex).items():
            found = np.array([p.shoulders[name] for p in people if p.kind == sex])
            figures += [
                Figure(f"{sex}_{name}_mean", float(found.mean()), f"cm, arms hanging, published {mean:.2f}"),
                Figure(f"{sex}_{name}_sd", float(found.std(ddof=1)), f"cm, published {sd:.2f}"),
            ]
    return figures


def _differences(survey: Survey, found: Float[np.ndarray, "n m"]) -> tuple[np.ndarray, np.ndarray]:
    """Relative differences of means and of standard deviations; NaN for means that are not comparable."""
    means = np.where(np.isfinite(survey.tolerance), found.mean(axis=0) / survey.mean - 1, np.nan)
    return means, found.std(axis=0, ddof=1) / survey.sd - 1


def _correlation(survey: Survey, found: Float[np.ndarray, "n m"], name: str) -> tuple[float, float]:
    height, other = (survey.measures.index(measure) for measure in ("height", name))
    published = survey.correlation[survey.correlated.index("height"), survey.correlated.index(name)]
    return float(np.corrcoef(found[:, height], found[:, other])[0, 1]), float(published)


def _correlation_rms(survey: Survey, found: Float[np.ndarray, "n m"]) -> float:
    columns = [survey.measures.index(name) for name in survey.correlated]
    off = np.corrcoef(found[:, columns].T) - survey.correlation
    return float(np.sqrt((off[np.triu_indices(len(off), 1)] ** 2).mean()))


def _rows(sex: str, found: Float[np.ndarray, "n m"]) -> list[dict[str, Any]]:
    survey = survey_of(sex)
    means, sds = _differences(survey, found)
    own, caesar = zip(found.mean(axis=0), found.std(axis=0, ddof=1), strict=True), _caesar(sex)
    return [
        {
            "sex": sex,
            "measure [cm, kg]": name,
            "CAESAR mean": f"{caesar[name]:.2f}" if name in caesar else "",
            "published mean": f"{survey.mean[i]:.2f}",
            "mean": f"{mean:.2f}",
            "off": f"{means[i]:+.1%}" if np.isfinite(means[i]) else "defined otherwise",
            "published sd": f"{survey.sd[i]:.2f}",
            "sd": f"{sd:.2f}",
            "sd off": f"{sds[i]:+.1%}",
        }
        for i, (name, (mean, sd)) in enumerate(zip(survey.measures, own, strict=True))
    ]


def _caesar(sex: str) -> dict[str, float]:
    """Means of the CAESAR survey, from GarmentCode's mean bodies, for measures that are defined as the survey's."""
    table = json.loads(POPULATION.read_bytes())["mean"]
    mean = table["neutral" if sex == MIXED else sex]
    same = {name: mean[name] for name in ("height", "bust", "hips", "wrist", "shoulder_w", "arm_length")}
    return same | {"thigh": mean["leg_circ"], "neck": 2.0 * mean["neck_w"]}
