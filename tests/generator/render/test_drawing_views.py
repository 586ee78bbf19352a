"""Views are a function of (seed, index, epoch), and stay within their ranges."""

from dataclasses import replace

import numpy as np
import pytest

from gcd_dataset.errors import ConfigError
from gcd_dataset.generator.drape import FABRICS
from gcd_dataset.generator.render import (
    AppearanceRanges,
    CameraRanges,
    HairStyle,
    PrintKind,
    Ranges,
    View,
    draw_appearance,
    draw_camera,
    draw_hair,
    draw_lights,
    draw_view,
    draw_views,
    render,
)
from gcd_dataset.generator.render.appearance import MONK_TONES
from gcd_dataset.generator.render.environment import tint, white_balance
from gcd_dataset.generator.render.images import linear_light
from gcd_dataset.generator.render.materials import LOOKS, LOOKS_OF_FABRIC, parts_of
from gcd_dataset.generator.render.packing import skin_albedo
from tests.generator.render.scenes import ahead, ball_scene, cloth_of, hung_patch, look, patch_scene, plain
from tests.helpers import joined


def test_views_depend_on_their_numbers_alone() -> None:
    scene = ball_scene()
    np.random.seed(1)  # noqa: NPY002
    first = draw_views(7, 3, scene, 4)
    np.random.seed(2)  # noqa: NPY002
    assert draw_views(7, 3, scene, 2) == first[:2]
    others = [draw_views(8, 3, scene, 1), draw_views(7, 4, scene, 1), draw_views(7, 3, scene, 1, epoch=1)]
    assert all(other[0] != first[0] for other in others)
    assert len({view.appearance is first[0].appearance for view in first}) == 1
    cameras: list[View] = first
    assert len({tuple(view.camera.eye.tolist()) for view in cameras}) == 4


def test_prints_and_looks_that_are_held_out_are_not_drawn() -> None:
    ranges = AppearanceRanges(prints=(PrintKind.STRIPES, PrintKind.DOTS), looks=("poplin", "jersey"), plain=0.2)
    scene = patch_scene()
    drawn = [draw_appearance(np.random.default_rng(k), scene, ranges=ranges).cloths[0] for k in range(60)]
    assert {cloth.print.kind for cloth in drawn} == {PrintKind.PLAIN, PrintKind.STRIPES, PrintKind.DOTS}
    assert {cloth.look for cloth in drawn} == {"poplin", "jersey"}


def test_a_tile_of_the_users_is_drawn() -> None:
    tile = np.zeros((2, 2, 3))
    ranges = AppearanceRanges(tiles=(tile,), images=1.0)
    cloth = draw_appearance(np.random.default_rng(0), patch_scene(), ranges=ranges).cloths[0]
    assert cloth.print.kind is PrintKind.IMAGE
    assert cloth.print.image is not None and np.array_equal(cloth.print.image, tile)


def test_cloth_suits_the_fabric_that_was_draped() -> None:
    scene = patch_scene()
    looks = {draw_appearance(np.random.default_rng(k), scene, fabric="denim").cloths[0].look for k in range(10)}
    assert looks == {"denim"}
    assert set(LOOKS_OF_FABRIC) <= set(FABRICS)
    assert all(set(names) <= set(LOOKS) for names in LOOKS_OF_FABRIC.values())


def test_pieces_that_are_not_sewn_together_have_cloths_of_their_own() -> None:
    scene = patch_scene(joined(hung_patch(), hung_patch()))
    assert parts_of(scene)[0].tolist() == [0, 1]
    assert len(set(draw_appearance(np.random.default_rng(0), scene).cloth_of_panel.tolist())) == 2


def test_all_ten_tones_are_drawn_and_others_refused() -> None:
    scene = patch_scene()
    tones = {draw_appearance(np.random.default_rng(k), scene).skin.tone for k in range(120)}
    assert tones == set(range(1, 11))
    assert len(MONK_TONES) == 10
    with pytest.raises(ConfigError, match="give some of 1 to 10"):
        draw_appearance(np.random.default_rng(0), scene, ranges=AppearanceRanges(tones=(0,)))
    with pytest.raises(ConfigError, match="unknown looks tweed: choose from poplin"):
        draw_appearance(np.random.default_rng(0), scene, ranges=AppearanceRanges(looks=("tweed",)))


def test_skin_is_neither_chalk_nor_coal_and_warm_on_all_tones() -> None:
    """Luminance of the albedo falls along the scale, from below 0.52 to above 0.045; red over green over blue."""
    albedos = np.array([skin_albedo(tone) for tone in MONK_TONES])
    luminance = albedos @ [0.2126, 0.7152, 0.0722]
    assert luminance.max() < 0.52 and luminance.min() > 0.045
    assert (np.diff(luminance[3:]) < 0).all()  # the first three tones are as light as each other
    assert (albedos[:, 0] > 1.3 * albedos[:, 1]).all() and (albedos[:, 1] > 1.3 * albedos[:, 2]).all()


def test_nobody_is_drawn_without_underwear() -> None:
    scene = patch_scene()
    assert all(draw_appearance(np.random.default_rng(k), scene).underwear is not None for k in range(40))


def test_drawn_cameras_hold_the_whole_figure() -> None:
    """Without crops, every point of the figure lies in the picture."""
    scene = ball_scene()
    for k in range(40):
        camera = draw_camera(np.random.default_rng(k), scene, ranges=CameraRanges(crop=0.0, offset=(0.0, 0.0)))
        pixels = camera.project(np.concatenate([scene.vertices, scene.body.vertices]), 100)
        assert 30 < np.abs(pixels - 49.5).max() < 50, k
        assert camera.rotation @ camera.rotation.T == pytest.approx(np.eye(3), abs=1e-9)


def test_lights_stand_on_the_cameras_side() -> None:
    """The key light of the default ranges never shines from behind the figure."""
    scene = ball_scene()
    for k in range(40):
        rng = np.random.default_rng(k)
        camera = draw_camera(rng, scene)
        lights = draw_lights(rng, camera)
        towards = -camera.rotation[2] * [1, 0, 1]
        assert float(lights.key_direction @ towards) > 0
        assert np.linalg.norm(lights.key_direction) == pytest.approx(1.0)


def test_warm_light_is_red_and_cold_light_blue() -> None:
    assert tint(3500.0)[0] > 1.2 > 1.0 > tint(3500.0)[2]
    assert tint(8000.0)[2] > 1.0 > tint(8000.0)[0]
    assert tint(5500.0) == pytest.approx((1.0, 1.0, 1.0))


def test_grey_cloth_looks_grey_in_every_drawn_view() -> None:
    """Grey cloth that faces the camera has red and blue within 20 % of green, in any light and place; not always equal.

    The white balance leaves casts of up to 10.5 % (``LightRanges.cast``); creases that turn away from the camera are
    lit more by the key or more by the surroundings.
    """
    scene = patch_scene()
    cloth = look(scene, cloth_of(plain((0.5, 0.5, 0.5))))
    casts = []
    for k in range(60):
        camera = CameraRanges(yaw=(-30.0, 30.0), crop=1.0)
        drawn = draw_view(np.random.default_rng(k), scene, cloth, ranges=Ranges(camera=camera))
        view = replace(drawn, camera=ahead(60.0), lights=replace(drawn.lights, exposure=0.6))
        middle = render([scene], [view], size=16, device="cpu")[0].rgb[6:10, 6:10]
        red, green, blue = linear_light(middle.astype(float) / 255).mean(axis=(0, 1))
        casts.append([np.log(red / green), np.log(blue / green)])
    assert 0.02 < np.abs(casts).max() < 0.2


def test_white_balance_leaves_casts_within_its_bound() -> None:
    tungsten = np.array([1.8, 1.0, 0.3])
    for left in (0.0, 0.5, 1.0):
        gains, recorded = white_balance(tungsten, left=left, cast=0.1)
        assert np.abs(np.log(recorded / recorded[1])).max() <= 0.1
        assert recorded.sum() == pytest.approx(tungsten.sum())
        assert recorded == pytest.approx(gains * tungsten)
    assert white_balance(tungsten, left=0.0, cast=0.1)[1] == pytest.approx(tungsten.mean())
    assert white_balance(tungsten, left=0.7, cast=0.0)[1] == pytest.approx(tungsten.mean())
    slight = np.array([1.01, 1.0, 0.99])
    assert white_balance(slight, left=1.0, cast=0.1)[1] == pytest.approx(slight, abs=1e-3)


def test_ranges_may_be_given_together() -> None:
    scene = patch_scene()
    ranges = Ranges(appearance=AppearanceRanges(tones=(3,)), camera=CameraRanges(yaw=(0.0, 0.0), crop=1.0))
    [view] = draw_views(0, 0, scene, 1, ranges=ranges)
    assert view.appearance.skin.tone == 3
    assert view.camera.eye[2] > 0


def test_hair_is_a_function_of_seed_index_and_epoch() -> None:
    drawn = [draw_hair(3, index) for index in range(60)]
    assert drawn == [draw_hair(3, index) for index in range(60)]
    assert set(drawn) == set(HairStyle)
    assert drawn != [draw_hair(3, index, epoch=1) for index in range(60)]
