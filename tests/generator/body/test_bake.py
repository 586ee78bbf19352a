"""The steps of baking the body model that do not need anny."""

import numpy as np
import pytest

from tools.body_model.anny_bodies import rotation_between
from tools.body_model.bake import COMPONENTS, _regressed, principal


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
