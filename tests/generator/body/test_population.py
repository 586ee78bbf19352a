"""Adults drawn from the calibrated population, the calibration's closed form, and the steps of baking the model."""

from dataclasses import replace

import numpy as np
import pytest
import trimesh

from gcd_dataset.errors import BodyError
from gcd_dataset.generator.body import build_body, draw_shape, measure, neutral_shape
from gcd_dataset.generator.body.shape import (
    MAX_DEVIATION,
    T_POSE,
    Adults,
    adults_of,
    draw_from,
    named_shape,
    weights_of,
)
from gcd_dataset.records import Body
from gcd_dataset.seeding import Stage, rng
from tests.helpers import body_from
from tools.body_model.anny_bodies import rotation_between
from tools.body_model.bake import COMPONENTS, _regressed, principal
from tools.body_model.calibrate import flank_stretch, nearest_covariance
from tools.body_model.survey import HANGING, body_weight, shoulder_breadths, shoulders_of, survey_measures, survey_of

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
        assert np.corrcoef(found["height"], found[name])[0, 1] == pytest.approx(
            published, abs=0.1 + 3 / np.sqrt(people)
        )


@pytest.mark.parametrize("sex", ["female", "male"])
def test_no_adult_has_a_ledge_at_the_hips(sex: str) -> None:
    """The flanks between hips and waist keep over half of the mean body's height; once 3 % of women kept a quarter."""
    adults, stretch, chance = adults_of(sex), flank_stretch(), np.random.default_rng(0)
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


def test_the_groups_draw_different_bodies_from_one_stream() -> None:
    women, men, pool = (draw_shape(rng(3, 5, Stage.BODY), group=group) for group in ("female", "male", "pooled"))
    assert women != men
    assert np.linalg.norm(pool.weights) < 0.7 * 3 * np.sqrt(len(pool.weights))
    assert women.arm_angle == men.arm_angle == pool.arm_angle


def test_the_error_of_an_unknown_group_lists_the_known_ones() -> None:
    with pytest.raises(BodyError, match="'Female': give random, female, male, pooled"):
        draw_shape(rng(0, 0, Stage.BODY), group="Female")


def test_weights_have_the_mean_and_axes_of_the_adults() -> None:
    axes = np.diag([2.0, 0.5, 1.0])
    adults, generator = Adults(np.array([1.0, -2.0, 0.0]), axes), np.random.default_rng(0)
    drawn = np.array([weights_of(adults, generator.standard_normal(3)) for _ in range(2000)])
    assert drawn.mean(axis=0) == pytest.approx(adults.mean, abs=0.1)
    assert np.cov(drawn.T) == pytest.approx(axes**2, abs=0.2)
    assert (np.abs(drawn - adults.mean) <= MAX_DEVIATION * np.diag(axes) + 1e-12).all()


def test_adults_stay_within_the_range_of_the_model() -> None:
    for sex in ("female", "male"):
        adults = adults_of(sex)
        assert np.linalg.norm(adults.axes, axis=0).max() < 2.5  # standard deviations of the model
        assert np.abs(adults.mean).max() < 4.0


# --------------------------------------------------------------------------------------------------------- calibration


def test_the_nearest_covariance_changes_conditioned_axes_only() -> None:
    """With an identity prior and a condition on the first axis, only that axis changes."""
    slopes, wanted = np.array([[2.0, 0.0, 0.0]]), np.array([[16.0]])
    assert nearest_covariance(np.eye(3), [(slopes, wanted)]) == pytest.approx(np.diag([4.0, 1.0, 1.0]))


def test_the_nearest_covariance_meets_all_conditions() -> None:
    generator = np.random.default_rng(2)
    together, alone = generator.standard_normal((3, 6)), generator.standard_normal((1, 6))
    root = generator.standard_normal((3, 3))
    wanted, variance = root @ root.T + np.eye(3), np.array([[2.5]])
    found = nearest_covariance(np.eye(6), [(together, wanted), (alone, variance)])
    assert together @ found @ together.T == pytest.approx(wanted, abs=1e-6)
    assert alone @ found @ alone.T == pytest.approx(variance, abs=1e-6)
    assert np.linalg.eigvalsh(found).min() > 0


# --------------------------------------------------------------------------------------------------------------- survey


def test_a_ball_of_a_litre_weighs_a_kilogram() -> None:
    ball = trimesh.creation.icosphere(subdivisions=5, radius=(3000 / (4 * np.pi)) ** (1 / 3))
    assert body_weight(body_from(ball)) == pytest.approx(1.0, rel=2e-3)


def test_the_surveys_measures_of_the_neutral_body_make_sense() -> None:
    body = build_body(neutral_shape())
    size = measure(body)
    found = survey_measures(body, size)
    assert size.waist < found["navel_girth"] < found["hips"]
    assert 2 * (found["waist_breadth"] + found["waist_depth"]) > found["navel_girth"]
    assert np.pi * found["waist_depth"] < found["navel_girth"]
    assert (
        found["crotch_height"] < found["navel_height"] < found["bust_height"] < found["nape_height"] < found["height"]
    )
    assert (
        found["nape_height"] - found["navel_height"]
        < found["nape_to_navel"]
        < 1.1 * (found["nape_height"] - found["navel_height"])
    )
    assert size.wrist < found["calf"] < found["thigh"]


def test_the_surveys_measures_grow_with_the_body() -> None:
    body = build_body(neutral_shape())
    larger = Body(1.1 * body.vertices, body.faces, body.parts)
    small, large = (survey_measures(each, measure(each)) for each in (body, larger))
    for name in ("navel_girth", "waist_breadth", "waist_depth", "nape_to_navel", "calf", "bust_depth"):
        assert large[name] == pytest.approx(1.1 * small[name], rel=1e-6)
    assert large["weight"] == pytest.approx(1.1**3 * small["weight"])


def test_the_mixed_population_is_half_women_and_half_men() -> None:
    """Statures of 162.85 ± 6.42 and 175.62 ± 6.86 cm: the variance within the sexes and of the sexes."""
    mixed, row = survey_of("random"), survey_of("random").measures.index("height")
    assert mixed.mean[row] == pytest.approx((162.85 + 175.62) / 2)
    assert mixed.sd[row] == pytest.approx(np.sqrt((6.42**2 + 6.86**2) / 2 + ((175.62 - 162.85) / 2) ** 2))
    assert mixed.sd[row] == pytest.approx(9.2, abs=0.05)


def test_shoulder_points_approach_each_other_as_the_arms_rise() -> None:
    """Thus the shoulder width of the A-pose is less than a survey's breadth with hanging arms."""
    shape = neutral_shape()
    widths = [
        shoulder_breadths(build_body(replace(shape, arm_angle=angle)))["biacromial"] for angle in (HANGING, 0.0, T_POSE)
    ]
    assert widths[0] > widths[1] + 2.0 > widths[2] + 4.0


@pytest.mark.parametrize("sex", ["female", "male"])
def test_hanging_shoulders_are_as_broad_as_the_surveys(sex: str) -> None:
    """The mean bodies are taller than the survey's people; breadths are scaled to the same height."""
    body = build_body(replace(named_shape(sex), arm_angle=HANGING))
    scale = survey_of(sex).mean[survey_of(sex).measures.index("height")] / np.ptp(body.vertices[:, 1])
    mean, _ = shoulders_of(sex)["bideltoid"]
    assert scale * shoulder_breadths(body)["bideltoid"] == pytest.approx(mean, rel=0.04)


def test_published_correlations_are_correlations() -> None:
    for sex in ("female", "male", "random"):
        matrix = survey_of(sex).correlation
        assert np.array_equal(matrix, matrix.T)
        assert np.diag(matrix) == pytest.approx(np.ones(len(matrix)))
        assert np.linalg.eigvalsh(matrix).min() > 0


def test_principal_components_recover_planted_ones() -> None:
    rng = np.random.default_rng(0)
    axes = np.linalg.qr(rng.standard_normal((90, COMPONENTS)))[0].T
    sizes = np.geomspace(30.0, 0.5, COMPONENTS)
    weights = rng.standard_normal((400, COMPONENTS))
    halves = ((weights * sizes) @ axes).reshape(400, 30, 3) + 7.0
    mean, components, found = principal(halves)
    assert mean + np.einsum("nk,khi->nhi", found, components) == pytest.approx(halves, abs=1e-9)
    assert found.std(axis=0, ddof=1) == pytest.approx(np.ones(COMPONENTS))
    assert np.corrcoef(found.T) == pytest.approx(np.eye(COMPONENTS), abs=1e-9)
    assert np.diff(np.linalg.norm(components.reshape(COMPONENTS, -1), axis=1)).max() < 0


def test_joints_that_follow_the_weights_are_found_exactly() -> None:
    rng = np.random.default_rng(1)
    parts, weights = rng.standard_normal((6, 3, 3)), rng.standard_normal((40, 5))
    joints = parts[0] + np.einsum("nk,kij->nij", weights, parts[1:])
    assert _regressed(weights, joints) == pytest.approx(parts)


def test_a_rotation_takes_one_direction_to_the_other() -> None:
    start, end = np.array([0.0, 2.0, 0.0]), np.array([1.0, 1.0, 1.0])
    turn = rotation_between(start, end)
    assert turn @ start / 2.0 == pytest.approx(end / np.sqrt(3.0))
    assert turn @ turn.T == pytest.approx(np.eye(3))
    assert np.linalg.det(turn) == pytest.approx(1.0)
