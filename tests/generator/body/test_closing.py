"""Closed skins are watertight and consistently wound, for any damage in the file."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh

from gcd_dataset.bodyfiles import read_body_parts
from gcd_dataset.errors import BodyError
from gcd_dataset.generator.body.repair import WIDEST_HOLE, ClosedSkin
from gcd_dataset.records import Body
from tests.helpers import body_from


def ball() -> Body:
    return body_from(trimesh.creation.icosphere(subdivisions=4, radius=20.0))


def closed(body: Body, faces: np.ndarray) -> ClosedSkin:
    return ClosedSkin.of(body.vertices, faces, body.parts, "ball")


def is_whole(skin: ClosedSkin | Body) -> bool:
    mesh = trimesh.Trimesh(skin.vertices, skin.faces, process=False)
    return bool(mesh.is_watertight and mesh.is_winding_consistent and mesh.volume > 0)


def without_cap(body: Body, radius: float) -> np.ndarray:
    """The faces with no vertex within ``radius`` of the vertex with the largest z."""
    near = np.linalg.norm(body.vertices - body.vertices[body.vertices[:, 2].argmax()], axis=1) < radius
    return body.faces[~near[body.faces].any(axis=1)]


def test_a_closed_skin_is_unchanged() -> None:
    skin = closed(ball(), ball().faces)
    assert np.array_equal(skin.faces, ball().faces)
    assert np.array_equal(skin.vertices, ball().vertices)
    assert not len(skin.hole_widths)
    assert not skin.flipped


def test_holes_are_closed_flat() -> None:
    """The patch of a hole of width 2a in a ball of radius r lies r - sqrt(r² - a²) below the ball's surface."""
    skin = closed(ball(), without_cap(ball(), 3.0))
    assert is_whole(skin)
    (width,) = skin.hole_widths
    assert 6.0 < width < 9.0
    lowered = 20.0 - np.sqrt(20.0**2 - (width / 2) ** 2)
    assert skin.vertices[-1] @ ball().vertices[ball().vertices[:, 2].argmax()] / 20.0 == pytest.approx(
        20.0 - lowered, abs=0.1
    )


@pytest.mark.parametrize("damage", ["flipped", "inward", "split", "both"])
def test_faces_of_any_winding_are_turned_outward(damage: str) -> None:
    body = ball()
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
    two = one.copy().apply_translation([10.0, 10.0, 0.0])
    both = trimesh.util.concatenate([one, two])
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
    with pytest.raises(
        BodyError, match=r"^ball: the skin is not closed: it has a hole \d+\.\d cm across about \(.*fill"
    ):
        closed(ball(), without_cap(ball(), WIDEST_HOLE / 2 + 2.0))


def test_inner_walls_are_an_error() -> None:
    body = ball()
    wall = np.concatenate([body.faces, [[*body.faces[0, :2], body.vertices[:, 2].argmax()]]])
    with pytest.raises(BodyError, match=r"ball: .* sides of faces are shared by three or more"):
        closed(body, wall)
