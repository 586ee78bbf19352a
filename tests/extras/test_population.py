"""The statistics of many adults of the calibrated population, and the tools that bake and calibrate the body model."""

import numpy as np
import pytest
import trimesh

from gcd_dataset.generator.body import build_body, measure, neutral_shape
from gcd_dataset.loaders import GeneratedGarments
from gcd_dataset.records import Body
from tests.generator.body.test_population import require_the_surveys_statistics
from tests.helpers import body_from
from tools.body_model.anny_bodies import rotation_between
from tools.body_model.bake import COMPONENTS, _regressed, principal
from tools.body_model.calibrate import nearest_covariance
from tools.body_model.survey import body_weight, survey_measures, survey_of


@pytest.mark.parametrize("group", ["random", "female", "male"])
def test_two_hundred_adults_have_the_surveys_statistics(group: str) -> None:
    require_the_surveys_statistics(group, 200)


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


def test_a_ball_of_a_litre_weighs_a_kilogram() -> None:
    ball = trimesh.creation.icosphere(subdivisions=5, radius=(3000 / (4 * np.pi)) ** (1 / 3))
    assert body_weight(body_from(ball)) == pytest.approx(1.0, rel=2e-3)


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


def test_a_wearer_of_few_garments_does_not_stop_a_data_set() -> None:
    """No fitted shirt suits her, and by chance her first twenty designs are all fitted shirts."""
    item = GeneratedGarments(33_546, seed=0, stage="pattern", drape=None, fields=("meta", "panels"))[33_545]
    assert item["meta"]["attempts"] > 20
    assert len(item["panels"])
