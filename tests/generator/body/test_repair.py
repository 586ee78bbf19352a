"""Closed skins for any damage in the file, and removal of known folds and creases."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh
from jaxtyping import Float

from gcd_dataset.bodyfiles import read_body_parts
from gcd_dataset.errors import BodyError
from gcd_dataset.generator.body import build_body, draw_shape
from gcd_dataset.generator.body.asset import body_model
from gcd_dataset.generator.body.repair import ROUNDS, WIDEST_HOLE, ClosedSkin, SkinMesh, skin_normals
from gcd_dataset.generator.drape.self_contact import skin_crossings
from gcd_dataset.records import Body, BodyPart
from gcd_dataset.seeding import Stage, rng
from tests.helpers import body_from


def a_ball() -> Body:
    return body_from(trimesh.creation.icosphere(subdivisions=4, radius=20.0))


def closed(body: Body, faces: np.ndarray) -> ClosedSkin:
    return ClosedSkin.of(body.vertices, faces, body.parts, "a_ball")


def is_whole(skin: ClosedSkin | Body) -> bool:
    mesh = trimesh.Trimesh(skin.vertices, skin.faces, process=False)
    return bool(mesh.is_watertight and mesh.is_winding_consistent and mesh.volume > 0)


def without_cap(body: Body, radius: float) -> np.ndarray:
    """The faces with no vertex within ``radius`` of the vertex with the largest z."""
    near = np.linalg.norm(body.vertices - body.vertices[body.vertices[:, 2].argmax()], axis=1) < radius
    return body.faces[~near[body.faces].any(axis=1)]


def test_a_closed_skin_is_unchanged() -> None:
    skin = closed(a_ball(), a_ball().faces)
    assert np.array_equal(skin.faces, a_ball().faces)
    assert np.array_equal(skin.vertices, a_ball().vertices)
    assert not len(skin.hole_widths)
    assert not skin.flipped


def test_holes_are_closed_flat() -> None:
    """The patch of a hole of width 2a in a ball of radius r lies r - sqrt(r² - a²) below the ball's surface."""
    skin = closed(a_ball(), without_cap(a_ball(), 3.0))
    assert is_whole(skin)
    (width,) = skin.hole_widths
    assert 6.0 < width < 9.0
    lowered = 20.0 - np.sqrt(20.0**2 - (width / 2) ** 2)
    pole = a_ball().vertices[a_ball().vertices[:, 2].argmax()]
    assert skin.vertices[-1] @ pole / 20.0 == pytest.approx(20.0 - lowered, abs=0.1)


@pytest.mark.parametrize("damage", ["flipped", "inward", "split", "both"])
def test_faces_of_any_winding_are_turned_outward(damage: str) -> None:
    body = a_ball()
    some = np.random.default_rng(0).random(len(body.faces)) < 0.3
    faces = body.faces if damage == "split" else body.faces[:, ::-1]
    if damage in ("flipped", "both"):
        faces = np.where(some[:, None], faces, faces[:, ::-1])
    if damage in ("split", "both"):
        body = replace(body, vertices=body.vertices[faces].reshape(-1, 3), parts=np.zeros(faces.size, np.uint8))
        faces = np.arange(faces.size).reshape(-1, 3)
    skin = closed(body, faces)
    assert is_whole(skin)
    assert not len(skin.hole_widths)


def test_closing_a_hole_does_not_join_touching_skins() -> None:
    """Two boxes that touch along an edge, each with its own vertices there; a triangle is missing on the far side."""
    one = trimesh.creation.box((10.0, 10.0, 10.0)).subdivide()
    both = trimesh.util.concatenate([one, one.copy().apply_translation([10.0, 10.0, 0.0])])
    far = int(both.triangles_center.sum(axis=1).argmin())
    skin = closed(body_from(both), np.delete(both.faces, far, axis=0))
    assert is_whole(skin)
    assert len(skin.hole_widths) == 1


def test_a_published_body_without_a_triangle_is_closed(examples: Path) -> None:
    """Its lips touch: welding them would give 28 edges three faces each."""
    folder = examples / "bodies"
    mesh = trimesh.load(folder / "mean_all.obj", process=False, maintain_order=True)
    parts = read_body_parts(folder / "ggg_body_segmentation.json", len(mesh.vertices), folder / "mean_all.obj")
    vertices = 100.0 * np.asarray(mesh.vertices)
    for lost in (0, 17_000, 47_499):
        skin = ClosedSkin.of(vertices, np.delete(mesh.faces, lost, axis=0), parts, "mean")
        assert is_whole(skin)
        assert len(skin.hole_widths) == 1


def test_the_error_of_a_wide_hole_gives_size_and_position() -> None:
    message = r"^a_ball: the skin is not closed: it has a hole \d+\.\d cm across about \(.*fill"
    with pytest.raises(BodyError, match=message):
        closed(a_ball(), without_cap(a_ball(), WIDEST_HOLE / 2 + 2.0))


def test_inner_walls_are_an_error() -> None:
    body = a_ball()
    wall = np.concatenate([body.faces, [[*body.faces[0, :2], body.vertices[:, 2].argmax()]]])
    with pytest.raises(BodyError, match=r"a_ball: .* sides of faces are shared by three or more"):
        closed(body, wall)


def flattened(skin: SkinMesh, vertices: np.ndarray) -> np.ndarray:
    return skin.smoothed(vertices, ROUNDS, resolve_creases=True).vertices


def is_folded(skin: SkinMesh, vertices: np.ndarray) -> bool:
    """Whether unfolding takes a round."""
    return skin.smoothed(vertices, 1, resolve_creases=False).rounds == 0


def intersecting(skin: SkinMesh, vertices: np.ndarray) -> np.ndarray:
    """The faces near creases that intersect each other."""
    return skin._intersecting(vertices, skin_normals(vertices, skin.faces))


@pytest.fixture(scope="module")
def ball() -> trimesh.Trimesh:
    return trimesh.creation.icosphere(subdivisions=4, radius=10.0)


def test_a_ball_has_no_fold_and_is_unchanged(ball: trimesh.Trimesh) -> None:
    skin = SkinMesh.of(ball.vertices, ball.faces)
    assert not is_folded(skin, ball.vertices)
    stretched = ball.vertices * [1.0, 2.0, 0.7]
    assert flattened(skin, stretched) is stretched


def test_an_inverted_patch_is_flattened_and_the_rest_is_unchanged(ball: trimesh.Trimesh) -> None:
    """A pole pulled over the skin beside it, as a nipple may be. Folds first and creases later give the same skin."""
    skin = SkinMesh.of(ball.vertices, ball.faces)
    dented = ball.vertices.copy()
    pole = int(dented[:, 1].argmax())
    dented[pole] += [4.0, 0.0, 0.0]
    assert is_folded(skin, dented)
    flat = flattened(skin, dented)
    assert not is_folded(skin, flat)
    unfolded = skin.smoothed(dented, ROUNDS, resolve_creases=False)
    assert 0 < unfolded.rounds < ROUNDS
    for normals in (None, unfolded.normals):
        later = skin.smoothed(unfolded.vertices, unfolded.rounds, resolve_creases=True, normals=normals)
        assert np.array_equal(later.vertices, flat)
    far = np.linalg.norm(ball.vertices - ball.vertices[pole], axis=1) > 5.0
    assert np.array_equal(flat[far], dented[far])
    assert np.linalg.norm(flat, axis=1) == pytest.approx(np.full(len(flat), 10.0), abs=1.0)


def groove(wall: Callable[[np.ndarray], np.ndarray]) -> Float[np.ndarray, "v 3"]:
    """A sheet with a groove along z, 10 long and 1 deep; its walls are at x = ± ``wall(height)``."""
    across, along = np.meshgrid(np.linspace(-1.0, 1.0, 41), np.linspace(0.0, 10.0, 31), indexing="ij")
    return np.stack([np.sign(across) * wall(np.abs(across)), np.abs(across), along], axis=-1).reshape(-1, 3)


def test_crossed_walls_of_a_groove_are_separated_and_a_narrow_groove_is_unchanged() -> None:
    """No face is inverted: the walls lean over the middle by a few degrees."""
    first = (np.arange(40)[:, None] * 31 + np.arange(30)).ravel()
    a, b, c, d = first, first + 1, first + 31, first + 32
    faces = np.concatenate([np.stack([a, b, c], axis=1), np.stack([b, d, c], axis=1)])
    skin = SkinMesh.of(groove(lambda height: height), faces)
    closed = groove(lambda height: 0.2 * height * (height - 0.4))
    assert not is_folded(skin, closed)
    assert len(intersecting(skin, closed))
    parted = flattened(skin, closed)
    assert not len(intersecting(skin, parted))
    assert (np.sign(parted[:, 0]) == np.sign(closed[:, 0])).mean() > 0.9
    upper = closed[:, 1] > 0.7
    assert np.array_equal(parted[upper], closed[upper])
    narrow = groove(lambda height: 0.01 * height)
    assert flattened(skin, narrow) is narrow


@pytest.mark.parametrize(("seed", "number", "sex"), [(0, 1763, "male"), (1, 1174, "female"), (1, 1450, "female")])
def test_thighs_and_crotch_of_unusual_bodies_do_not_intersect(seed: int, number: int, sex: str) -> None:
    assert skin_crossings(build_body(draw_shape(rng(seed, number, Stage.BODY), group=sex))) == 0


def test_drawn_bodies_have_no_folds() -> None:
    """Normals of trunk, arms and legs are within a right angle of the mean body's."""
    model = body_model()
    skin = SkinMesh.of(model.mean, model.faces[(model.parts < BodyPart.HEAD.value)[model.faces].all(axis=1)])
    for index in range(4):
        for sex in ("female", "male"):
            body = build_body(draw_shape(rng(31, index, Stage.BODY), group=sex))
            assert not is_folded(skin, body.vertices)
