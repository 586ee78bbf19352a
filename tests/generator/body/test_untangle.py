"""Folded skin, on surfaces whose folds are known."""

import numpy as np
import pytest
import trimesh

from gcd_dataset.generator.body import build_body, draw_shape
from gcd_dataset.generator.body.asset import body_model
from gcd_dataset.generator.body.untangle import Skin
from gcd_dataset.records import BodyPart
from gcd_dataset.seeding import Stage, rng


@pytest.fixture(scope="module")
def ball() -> trimesh.Trimesh:
    return trimesh.creation.icosphere(subdivisions=4, radius=10.0)


def test_a_ball_has_no_fold_and_keeps_its_place(ball: trimesh.Trimesh) -> None:
    skin = Skin.of(ball.vertices, ball.faces)
    assert not skin.folded(ball.vertices).any()
    stretched = ball.vertices * [1.0, 2.0, 0.7]
    assert skin.flattened(stretched) is stretched


def test_a_patch_turned_inside_out_is_drawn_flat_and_the_rest_is_left(ball: trimesh.Trimesh) -> None:
    """A pole pulled back through the ball's skin beside it, as a nipple may be."""
    skin = Skin.of(ball.vertices, ball.faces)
    dented = ball.vertices.copy()
    pole = int(dented[:, 1].argmax())
    dented[pole] += [4.0, 0.0, 0.0]
    assert skin.folded(dented).any()
    flat = skin.flattened(dented)
    assert not skin.folded(flat).any()
    far = np.linalg.norm(ball.vertices - ball.vertices[pole], axis=1) > 5.0
    assert np.array_equal(flat[far], dented[far])
    assert np.linalg.norm(flat, axis=1) == pytest.approx(np.full(len(flat), 10.0), abs=1.0)


def test_vertices_off_the_skin_stay(ball: trimesh.Trimesh) -> None:
    upper = ball.faces[(ball.vertices[ball.faces][:, :, 1] > 0).all(axis=1)]
    skin = Skin.of(ball.vertices, upper)
    dented = ball.vertices.copy()
    dented[int(dented[:, 1].argmax())] += [4.0, 0.0, 0.0]
    below = ball.vertices[:, 1] < -1.0
    assert np.array_equal(skin.flattened(dented)[below], ball.vertices[below])


def test_drawn_bodies_have_no_folds() -> None:
    """Faces of trunk, arms and legs look where they look on the mean body, give or take a right angle."""
    model = body_model()
    skin = Skin.of(model.mean, model.faces[(model.parts < BodyPart.HEAD.value)[model.faces].all(axis=1)])
    for index in range(12):
        for sex in ("female", "male"):
            body = build_body(draw_shape(rng(31, index, Stage.BODY), sex=sex))
            assert not skin.folded(body.vertices).any()
