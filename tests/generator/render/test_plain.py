"""Shapes, sides, colours and shading of renders agree with the geometry."""

import io
from dataclasses import replace

import numpy as np
import pytest
import trimesh
from PIL import Image

from gcd_dataset.errors import ConfigError
from gcd_dataset.generator.lay_plan import PAPER
from gcd_dataset.generator.pipeline import prepare
from gcd_dataset.generator.recipe import MakeConfig
from gcd_dataset.generator.render import (
    ColouredMesh,
    garment_scene,
    render_garment,
    render_sample,
    render_view,
)
from gcd_dataset.generator.render.plain_batch import DISTANCE, MARGIN, View, start_render
from gcd_dataset.records import Drape, Outcome, Provenance, Sample
from tests.helpers import SIZE, body_from, napkins, patch

GARMENTS = MakeConfig(stage="mesh", bodies="both", resolution=10.0)
VIEWS: tuple[View, View] = ("front", "back")
RED, BLUE = (0.9, 0.1, 0.1), (0.1, 0.1, 0.9)


def coloured(
    shape: trimesh.Trimesh, colour_of_face: np.ndarray, *colours: tuple[float, float, float]
) -> list[ColouredMesh]:
    return [ColouredMesh(np.asarray(shape.vertices, float), np.asarray(shape.faces), colour_of_face, np.array(colours))]


def is_paper(picture: np.ndarray) -> np.ndarray:
    return np.abs(picture.astype(int) - PAPER).max(axis=2) <= 1


def test_a_ball_fills_its_circle() -> None:
    """From distance d, a ball of radius r is a disc of angular radius asin(r / d)."""
    ball = trimesh.creation.icosphere(subdivisions=4, radius=20.0)
    picture = render_view(coloured(ball, np.zeros(len(ball.faces), int), RED), size=128, device="cpu")
    share = 1 - is_paper(picture).mean()
    radius = np.tan(np.arcsin(20.0 / DISTANCE)) * (DISTANCE - 20.0) / (MARGIN * 20.0)  # in units of half the picture
    assert share == pytest.approx(np.pi / 4 * radius**2, abs=0.01)


def test_front_and_back_show_their_own_sides() -> None:
    box = trimesh.creation.box(extents=(20.0, 20.0, 4.0))
    at_back = np.asarray(box.triangles_center)[:, 2] < -1.0
    scene = coloured(box, at_back.astype(int), RED, BLUE)
    front, back = (render_view(scene, size=64, view=view, device="cpu")[32, 32] for view in ("front", "back"))
    assert front[0] > 2 * front[2]
    assert back[2] > 2 * back[0]


def test_left_is_the_wearers_left() -> None:
    """The wearer's left, +x, is on the right of the front view and on the left of the back view."""
    box = trimesh.creation.box(extents=(20.0, 20.0, 4.0))
    left = trimesh.creation.box(extents=(4.0, 4.0, 6.0))
    left.apply_translation([8.0, 0.0, 0.0])
    both = trimesh.util.concatenate([box, left])
    scene = coloured(both, np.repeat([0, 1], [len(box.faces), len(left.faces)]), RED, BLUE)
    front, back = (render_view(scene, size=96, view=view, device="cpu").astype(int) for view in ("front", "back"))
    assert np.nonzero(front[..., 2] > front[..., 0] + 40)[1].mean() > 64
    assert np.nonzero(back[..., 2] > back[..., 0] + 40)[1].mean() < 32


def test_cloth_hides_the_body_and_its_wrong_side_is_darker() -> None:
    ball = trimesh.creation.icosphere(subdivisions=3, radius=5.0)
    cloth = patch(12, 12, spacing=2.0, origin=(-12.0, -12.0, 8.0))
    scene = garment_scene(cloth.vertices, cloth, body_from(ball))
    front = render_view(scene, size=64, view="front", device="cpu")[32, 32].astype(int)
    behind = [replace(mesh, vertices=mesh.vertices - [0, 0, 16.0]) for mesh in scene]
    inside = render_view(behind, size=64, view="back", device="cpu")
    assert front[2] > front[0]  # the first panel's colour is blue, unlike skin
    assert inside[8, 8].sum() < 0.8 * front.sum()


def test_a_corner_that_sees_little_sky_is_darker() -> None:
    """A plate with a lid 3 cm in front of one half: near the lid's edge half of the sky is occluded."""
    open_plate = trimesh.creation.box(extents=(40.0, 40.0, 1.0))
    for _ in range(4):
        open_plate = open_plate.subdivide()
    lid = trimesh.creation.box(extents=(20.0, 40.0, 1.0))
    lid.apply_translation([-10.0, 0.0, 4.0])
    covered = trimesh.util.concatenate([open_plate, lid])
    bare, shaded = (
        render_view(coloured(shape, np.zeros(len(shape.faces), int), RED), size=64, device="cpu")
        for shape in (open_plate, covered)
    )
    beside_the_lid, far_from_it = (32, 34), (32, 52)
    assert int(shaded[beside_the_lid][0]) < int(bare[beside_the_lid][0]) - 10
    assert shaded[far_from_it][0] == pytest.approx(bare[far_from_it][0], abs=3)


def test_render_garment_returns_front_and_back_views() -> None:
    ball = trimesh.creation.icosphere(subdivisions=3, radius=5.0)
    cloth = patch(6, 6, spacing=2.0, origin=(-6.0, -6.0, 8.0))
    scene = garment_scene(cloth.vertices, cloth, body_from(ball))
    front, back = render_garment(cloth.vertices, cloth, body_from(ball), size=32, device="cpu")
    assert np.array_equal(front, render_view(scene, size=32, view="front", device="cpu"))
    assert np.array_equal(back, render_view(scene, size=32, view="back", device="cpu"))


def test_a_garment_looks_the_same_alone_as_among_others() -> None:
    wearers = prepare(1, 1, GARMENTS).dressed
    scenes = [garment_scene(one.box_mesh.vertices, one.box_mesh, one.body) for one in wearers if one.box_mesh]
    assert len(scenes) == 2
    together = start_render(scenes, ["back", "front"], size=48, device="cpu").pictures()
    for scene, (back, front) in zip(scenes, together, strict=True):
        assert np.array_equal(back, render_view(scene, size=48, view="back", device="cpu"))
        assert np.array_equal(front, render_view(scene, size=48, view="front", device="cpu"))


def test_meshes_of_a_scene_render_like_their_union() -> None:
    """They hide and shade each other like parts of one mesh."""
    ball = trimesh.creation.icosphere(subdivisions=3, radius=5.0)
    cloth = patch(6, 6, spacing=2.0, origin=(-6.0, -6.0, 8.0))
    skin, garment = garment_scene(cloth.vertices, cloth, body_from(ball))
    union = ColouredMesh(
        np.concatenate([skin.vertices, garment.vertices]),
        np.concatenate([skin.faces, garment.faces + len(skin.vertices)]),
        np.concatenate([skin.colour_of_face, garment.colour_of_face + len(skin.colours)]),
        np.concatenate([skin.colours, garment.colours]),
    )
    for view in VIEWS:
        apart, whole = (render_view(s, size=64, view=view, device="cpu") for s in ([skin, garment], [union]))
        assert np.array_equal(apart, whole)


def test_repeated_renders_have_the_same_pixels() -> None:
    ball = trimesh.creation.icosphere(subdivisions=3, radius=20.0)
    scene = coloured(ball, np.arange(len(ball.faces)) % 2, RED, BLUE)
    first, second = (render_view(scene, size=48, device="cpu") for _ in range(2))
    assert np.array_equal(first, second)


def test_silhouettes_are_antialiased() -> None:
    """Along the edge of a ball there are pixels between its colour and the paper."""
    ball = trimesh.creation.icosphere(subdivisions=4, radius=20.0)
    row = render_view(coloured(ball, np.zeros(len(ball.faces), int), RED), size=64, device="cpu")[20].astype(int)
    green = row[:, 1]
    assert ((green > 60) & (green < 230)).any()


def test_a_picture_of_size_zero_is_an_error() -> None:
    ball = trimesh.creation.icosphere(subdivisions=1, radius=20.0)
    with pytest.raises(ConfigError, match="0 pixels"):
        render_view(coloured(ball, np.zeros(len(ball.faces), int), RED), size=0, device="cpu")


def test_a_draped_sample_renders_to_two_jpegs() -> None:
    cloth = patch(4, 4, spacing=2.0, origin=(-4.0, -4.0, 8.0))
    ball = body_from(trimesh.creation.icosphere(subdivisions=2, radius=5.0))
    drape = Drape(cloth.vertices, Outcome.SETTLED, 1, 0, 0, 1.0, 1.0)
    sample = Sample("gcd_000000007", Provenance(0, 7), napkins(), SIZE, {}, box_mesh=cloth, drape=drape)
    for jpeg in render_sample(sample, ball, size=40, device="cpu"):
        picture = Image.open(io.BytesIO(jpeg))
        assert (picture.format, picture.size) == ("JPEG", (40, 40))
    with pytest.raises(ConfigError, match="gcd_000000007 is not draped"):
        render_sample(replace(sample, drape=None), ball)
