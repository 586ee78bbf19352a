"""Adults drawn from the calibrated population."""

from dataclasses import replace

import numpy as np
import pytest

from gcd_dataset.errors import BodyError
from gcd_dataset.generator.body import build_body, draw_shape, measure, neutral_shape
from gcd_dataset.generator.body.shape import T_POSE, adults_of, draw_from, named_shape, weights_of
from gcd_dataset.seeding import Stage, rng
from tools.body_model.calibrate import flank_stretch
from tools.body_model.survey import HANGING, shoulder_breadths, shoulders_of, survey_measures, survey_of

PEOPLE = 50  # 200 in tests/extras/test_population.py


def measured(group: str, people: int) -> dict[str, np.ndarray]:
    bodies = [build_body(draw_shape(rng(3, index, Stage.BODY), group=group)) for index in range(people)]
    rows = [survey_measures(body, measure(body)) for body in bodies]
    return {name: np.array([row[name] for row in rows]) for name in rows[0]}


@pytest.mark.parametrize("group", ["female", "male"])
def test_drawn_adults_have_the_surveys_statistics(group: str) -> None:
    require_the_surveys_statistics(group, PEOPLE)


def require_the_surveys_statistics(group: str, people: int) -> None:
    """Within the targets plus the sampling error of a number of people."""
    survey, found = survey_of(group), measured(group, people)
    assert tuple(found) == survey.measures
    means = np.array([found[name].mean() for name in survey.measures])
    sds = np.array([found[name].std() for name in survey.measures])
    chance = 3 * survey.sd / np.sqrt(people)
    close = np.abs(means - survey.mean) < 0.02 * survey.mean + chance
    assert close[np.isfinite(survey.tolerance)].sum() >= 12
    assert (np.abs(sds / survey.sd - 1) < 0.1 + 3 / np.sqrt(2 * people)).sum() >= 12
    for name in ("weight", "navel_girth", "hips"):
        published = survey.correlation[0, survey.correlated.index(name)]
        drawn = np.corrcoef(found["height"], found[name])[0, 1]
        assert drawn == pytest.approx(published, abs=0.1 + 3 / np.sqrt(people))


@pytest.mark.parametrize("sex", ["female", "male"])
def test_adults_stay_within_the_range_of_the_model_and_none_has_a_ledge_at_the_hips(sex: str) -> None:
    """The flanks between hips and waist keep over half of the mean body's height; once 3 % of women kept a quarter."""
    adults, stretch, chance = adults_of(sex), flank_stretch(), np.random.default_rng(0)
    assert np.linalg.norm(adults.axes, axis=0).max() < 2.5  # standard deviations of the model
    assert np.abs(adults.mean).max() < 4.0
    heights = [1.0 + stretch @ weights_of(adults, chance.standard_normal(len(stretch))) for _ in range(500)]
    assert min(heights) > 0.5
    assert max(heights) < 1.6


def test_random_bodies_are_the_women_and_men_of_their_streams() -> None:
    kinds = []
    for index in range(24):
        kind, shape = draw_from("random", rng(3, index, Stage.BODY))
        assert shape == draw_shape(rng(3, index, Stage.BODY)) == draw_shape(rng(3, index, Stage.BODY), group=kind)
        kinds.append(kind)
    assert set(kinds) == {"female", "male"}
    assert kinds.count("female") == pytest.approx(12, abs=3 * np.sqrt(24) / 2)


def test_the_groups_draw_different_bodies_from_one_stream_and_an_unknown_one_is_an_error() -> None:
    women, men, pool = (draw_shape(rng(3, 5, Stage.BODY), group=group) for group in ("female", "male", "pooled"))
    assert women != men
    assert np.linalg.norm(pool.weights) < 0.7 * 3 * np.sqrt(len(pool.weights))
    assert women.arm_angle == men.arm_angle == pool.arm_angle
    with pytest.raises(BodyError, match="'Female': give random, female, male, pooled"):
        draw_shape(rng(0, 0, Stage.BODY), group="Female")


def test_shoulder_points_approach_each_other_as_the_arms_rise() -> None:
    """Thus the shoulder width of the A-pose is less than a survey's breadth with hanging arms."""
    shape = neutral_shape()
    bodies = [build_body(replace(shape, arm_angle=angle)) for angle in (HANGING, 0.0, T_POSE)]
    widths = [shoulder_breadths(body)["biacromial"] for body in bodies]
    assert widths[0] > widths[1] + 2.0 > widths[2] + 4.0


@pytest.mark.parametrize("sex", ["female", "male"])
def test_hanging_shoulders_are_as_broad_as_the_surveys(sex: str) -> None:
    """The mean bodies are taller than the survey's people; breadths are scaled to the same height."""
    body = build_body(replace(named_shape(sex), arm_angle=HANGING))
    scale = survey_of(sex).mean[survey_of(sex).measures.index("height")] / np.ptp(body.vertices[:, 1])
    mean, _ = shoulders_of(sex)["bideltoid"]
    assert scale * shoulder_breadths(body)["bideltoid"] == pytest.approx(mean, rel=0.04)
