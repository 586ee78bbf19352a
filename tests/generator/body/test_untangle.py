"""Removal of known folds and creases from simple surfaces."""

from collections.abc import Callable

import numpy as np
import pytest
import trimesh
from jaxtyping import Float, Int

from benchmarks.skin import skin_crossings
from gcd_dataset.generator.body import build_body, draw_shape
from gcd_dataset.generator.body.asset import body_model
from gcd_dataset.generator.body.repair import ROUNDS, SkinMesh
from gcd_dataset.records import BodyPart
from gcd_dataset.seeding import Stage, rng


@pytest.fixture(scope="module")
def ball() -> trimesh.Trimesh:
    return trimesh.creation.icosphere(subdivisions=4, radius=10.0)


def test_a_ball_has_no_fold_and_is_unchanged(ball: trimesh.Trimesh) -> None:
    skin = SkinMesh.of(ball.vertices, ball.faces)
    assert not skin.folded(ball.vertices).any()
    stretched = ball.vertices * [1.0, 2.0, 0.7]
    assert skin.flattened(stretched) is stretched


def test_an_inverted_patch_is_flattened_and_the_rest_is_unchanged(ball: trimesh.Trimesh) -> None:
    """A pole pulled over the skin beside it, as a nipple may be."""
    skin = SkinMesh.of(ball.vertices, ball.faces)
    dented = ball.vertices.copy()
    pole = int(dented[:, 1].argmax())
    dented[pole] += [4.0, 0.0, 0.0]
    assert skin.folded(dented).any()
    flat = skin.flattened(dented)
    assert not skin.folded(flat).any()
    far = np.linalg.norm(ball.vertices - ball.vertices[pole], axis=1) > 5.0
    assert np.array_equal(flat[far], dented[far])
    assert np.linalg.norm(flat, axis=1) == pytest.approx(np.full(len(flat), 10.0), abs=1.0)


def test_folds_first_and_creases_later_give_the_same_skin(ball: trimesh.Trimesh) -> None:
    skin = SkinMesh.of(ball.vertices, ball.faces)
    dented = ball.vertices.copy()
    dented[int(dented[:, 1].argmax())] += [4.0, 0.0, 0.0]
    unfolded = skin.smoothed(dented, ROUNDS, resolve_creases=False)
    assert 0 < unfolded.rounds < ROUNDS
    for normals in (None, unfolded.normals):
        later = skin.smoothed(unfolded.vertices, unfolded.rounds, resolve_creases=True, normals=normals)
        assert np.array_equal(later.vertices, skin.flattened(dented))


def test_vertices_off_the_skin_do_not_move(ball: trimesh.Trimesh) -> None:
    upper = ball.faces[(ball.vertices[ball.faces][:, :, 1] > 0).all(axis=1)]
    skin = SkinMesh.of(ball.vertices, upper)
    dented = ball.vertices.copy()
    dented[int(dented[:, 1].argmax())] += [4.0, 0.0, 0.0]
    below = ball.vertices[:, 1] < -1.0
    assert np.array_equal(skin.flattened(dented)[below], ball.vertices[below])


def groove(wall: Callable[[np.ndarray], np.ndarray]) -> Float[np.ndarray, "v 3"]:
    """A sheet with a groove along z, 10 long and 1 deep; its walls are at x = ± ``wall(height)``."""
    across, along = np.meshgrid(np.linspace(-1.0, 1.0, 41), np.linspace(0.0, 10.0, 31), indexing="ij")
    return np.stack([np.sign(across) * wall(np.abs(across)), np.abs(across), along], axis=-1).reshape(-1, 3)


def groove_faces() -> Int[np.ndarray, "f 3"]:
    first = (np.arange(40)[:, None] * 31 + np.arange(30)).ravel()
    a, b, c, d = first, first + 1, first + 31, first + 32
    return np.concatenate([np.stack([a, b, c], axis=1), np.stack([b, d, c], axis=1)])


def test_crossed_walls_of_a_groove_are_separated() -> None:
    """No face is inverted: the walls lean over the middle by a few degrees."""
    skin = SkinMesh.of(groove(lambda height: height), groove_faces())
    closed = groove(lambda height: 0.2 * height * (height - 0.4))
    assert not skin.folded(closed).any()
    assert len(skin.intersecting(closed))
    parted = skin.flattened(closed)
    assert not len(skin.intersecting(parted))
    assert (np.sign(parted[:, 0]) == np.sign(closed[:, 0])).mean() > 0.9
    upper = closed[:, 1] > 0.7
    assert np.array_equal(parted[upper], closed[upper])


def test_a_narrow_groove_is_unchanged() -> None:
    skin = SkinMesh.of(groove(lambda height: height), groove_faces())
    narrow = groove(lambda height: 0.01 * height)
    assert skin.flattened(narrow) is narrow


@pytest.mark.parametrize(("seed", "number", "sex"), [(0, 1763, "male"), (1, 1174, "female"), (1, 1450, "female")])
def test_thighs_and_crotch_of_unusual_bodies_do_not_intersect(seed: int, number: int, sex: str) -> None:
    body = build_body(draw_shape(rng(seed, number, Stage.BODY), group=sex))
    assert skin_crossings(body) == 0


def test_drawn_bodies_have_no_folds() -> None:
    """Normals of trunk, arms and legs are within a right angle of the mean body's."""
    model = body_model()
    skin = SkinMesh.of(model.mean, model.faces[(model.parts < BodyPart.HEAD.value)[model.faces].all(axis=1)])
    for index in range(12):
        for sex in ("female", "male"):
            body = build_body(draw_shape(rng(31, index, Stage.BODY), group=sex))
            assert not skin.folded(body.vertices).any()
