"""Plain pictures: shapes, sides, colours and shading agree with the geometry."""

import numpy as np
import pytest
import trimesh

from gcd_dataset.errors import ConfigError
from gcd_dataset.generator.lay_plan import PAPER
from gcd_dataset.generator.pipeline import prepare
from gcd_dataset.generator.recipe import MakeConfig
from gcd_dataset.generator.render import draw_views, garment_scene, render, render_garment, render_view
from gcd_dataset.generator.render.cameras import FIXED_DISTANCE, FIXED_MARGIN
from gcd_dataset.generator.render.plain import SIDES, plain_view, start_plain
from gcd_dataset.generator.render.scene import figure_scene
from gcd_dataset.records import BoxMesh
from tests.generator.test_drawing import is_paper
from tests.helpers import body_from, joined, patch

BALL = body_from(trimesh.creation.icosphere(subdivisions=3, radius=5.0))


def apron() -> BoxMesh:
    """Two panels before the ball: the first, blue, at the wearer's left, the second, orange, at the right."""
    return joined(patch(6, 12, spacing=2.0, origin=(0.0, -12.0, 8.0)), patch(6, 12, spacing=2.0, origin=(-12, -12, 8)))


def test_a_ball_fills_its_circle() -> None:
    """From distance d, a ball of radius r is a disc of angular radius asin(r / d), with an antialiased border."""
    ball = trimesh.creation.icosphere(subdivisions=4, radius=20.0)
    picture = render_view(figure_scene(body_from(ball)), size=128, device="cpu")
    radius = np.tan(np.arcsin(20 / FIXED_DISTANCE)) * (FIXED_DISTANCE - 20) / (FIXED_MARGIN * 20)  # of half the picture
    assert 1 - is_paper(picture).mean() == pytest.approx(np.pi / 4 * radius**2, abs=0.01)
    row = picture[40, :, 0].astype(int)
    assert np.count_nonzero((row > row[64] + 10) & (row < PAPER[0] - 10)) in (1, 2)


def test_sides_colours_and_the_wrong_side_of_cloth() -> None:
    """The wearer's left is on the right of the front view; cloth hides the body; behind, it is darker."""
    mesh = apron()
    front, back = (side.astype(int) for side in render_garment(mesh.vertices, mesh, BALL, size=64, device="cpu"))
    for picture, left in ((front, 1), (back, -1)):
        blue, orange = picture[..., 2] > picture[..., 0] + 15, picture[..., 0] > picture[..., 2] + 25
        assert (np.nonzero(blue)[1].mean() - 32) * left > 5
        assert (np.nonzero(orange)[1].mean() - 32) * left < -5
    assert not is_paper(front)[24:40, 24:40].any()
    assert np.ptp(back[32, 32]) < 30  # skin
    assert back[8, 16].sum() < 0.8 * front[8, 48].sum()  # the same cloth


def test_the_side_view_is_from_the_wearers_left() -> None:
    """A ball before the body lies on the left of the picture, a larger one at the wearer's right is hidden."""
    body, nose, hand = (trimesh.creation.icosphere(subdivisions=3, radius=radius) for radius in (10.0, 2.0, 5.0))
    nose.apply_translation([0.0, 0.0, 20.0])
    hand.apply_translation([-20.0, 0.0, 0.0])
    scene = figure_scene(body_from(trimesh.util.concatenate([body, nose, hand])))
    seen = ~is_paper(render_view(scene, size=64, view="side", device="cpu"))
    height = seen.sum(axis=0)[seen.any(axis=0)]
    assert height[:3].max() < 0.3 * height.max() < height[-3:].max()
    assert (np.diff(np.flatnonzero(seen.any(axis=0))) > 1).sum() == 1  # two balls
    with pytest.raises(ConfigError, match="a fixed camera at 'top': choose front, side, back"):
        render_view(scene, size=8, view="top", device="cpu")


def test_a_corner_that_sees_little_sky_is_darker() -> None:
    """A plate with a lid 3 cm in front of one half: near the lid's edge half of the sky is occluded."""
    open_plate = trimesh.creation.box(extents=(40.0, 40.0, 1.0))
    for _ in range(4):
        open_plate = open_plate.subdivide()
    lid = trimesh.creation.box(extents=(20.0, 40.0, 1.0))
    lid.apply_translation([-10.0, 0.0, 4.0])
    bare, shaded = (
        render_view(figure_scene(body_from(shape)), size=64, device="cpu")[..., 0].astype(int)
        for shape in (open_plate, trimesh.util.concatenate([open_plate, lid]))
    )
    beside_the_lid, far_from_it = (32, 34), (32, 58)
    assert shaded[beside_the_lid] < bare[beside_the_lid] - 10
    assert shaded[far_from_it] == pytest.approx(bare[far_from_it], abs=3)


def test_a_garment_looks_the_same_alone_as_among_others() -> None:
    """Also beside drawn views of the same scene."""
    wearers = prepare(1, 1, MakeConfig(stage="mesh", bodies="both", resolution=10.0)).dressed
    scenes = [garment_scene(one.box_mesh.vertices, one.box_mesh, one.body) for one in wearers if one.box_mesh]
    together = start_plain(scenes, size=48, device="cpu").lend_rgb()
    drawn, beside = render(scenes, [*draw_views(1, 1, scenes[1], 1, row=1), plain_view(scenes[1], row=1)], size=48)
    alone = [render_view(scene, size=48, view=side, device="cpu") for scene, side in zip(scenes, SIDES, strict=True)]
    assert [np.array_equal(together[k], one) for k, one in zip((0, 3), alone, strict=True)] == [True, True]
    assert np.array_equal(beside.rgb, together[2])
    assert not is_paper(drawn.rgb).all()


def test_a_diverged_drape_leaves_the_body() -> None:
    mesh = apron()
    front, _ = render_garment(np.full_like(mesh.vertices, np.nan), mesh, BALL, size=24, device="cpu")
    assert np.array_equal(front, render_view(figure_scene(BALL), size=24, device="cpu"))
    assert not is_paper(front)[12, 12]
