"""Views are a function of (seed, index, epoch), and stay within their ranges."""

from dataclasses import replace

import numpy as np
import pytest

from gcd_dataset.errors import ConfigError
from gcd_dataset.generator.drape import FABRICS
from gcd_dataset.generator.render import (
    Appearance,
    AppearanceRanges,
    CameraRanges,
    HairStyle,
    PrintKind,
    Ranges,
    draw_appearance,
    draw_camera,
    draw_hair,
    draw_lights,
    draw_view,
    draw_views,
    render,
)
from gcd_dataset.generator.render.appearance import MONK_TONES
from gcd_dataset.generator.render.environment import tint
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
    assert all(view.appearance is first[0].appearance for view in first)
    assert len({tuple(view.camera.eye.tolist()) for view in first}) == 4


def drawn(count: int, ranges: AppearanceRanges | None = None, fabric: str | None = None) -> list[Appearance]:
    scene = patch_scene()
    return [draw_appearance(np.random.default_rng(k), scene, fabric=fabric, ranges=ranges) for k in range(count)]


def test_appearances_are_drawn_from_their_ranges() -> None:
    """All ten tones, always underwear; no print and kind of cloth that is held out; users' tiles."""
    looks = drawn(100)
    assert {look.skin.tone for look in looks} == set(range(1, len(MONK_TONES) + 1))
    assert all(look.underwear is not None for look in looks)
    few = AppearanceRanges(prints=(PrintKind.STRIPES, PrintKind.DOTS), looks=("poplin", "jersey"), plain=0.2)
    cloths = [look.cloths[0] for look in drawn(60, few)]
    assert {cloth.print.kind for cloth in cloths} == {PrintKind.PLAIN, PrintKind.STRIPES, PrintKind.DOTS}
    assert {cloth.look for cloth in cloths} == {"poplin", "jersey"}
    tile = np.zeros((2, 2, 3))
    [tiled] = drawn(1, AppearanceRanges(tiles=(tile,), images=1.0))
    motif = tiled.cloths[0].print
    assert motif.kind is PrintKind.IMAGE
    assert motif.image is not None and np.array_equal(motif.image, tile)
    for fault, ranges in (
        ("give some of 1 to 10", AppearanceRanges(tones=(0,))),
        ("unknown looks tweed: choose from poplin", AppearanceRanges(looks=("tweed",))),
    ):
        with pytest.raises(ConfigError, match=fault):
            drawn(1, ranges)
    together = Ranges(appearance=AppearanceRanges(tones=(3,)), camera=CameraRanges(yaw=(0.0, 0.0), crop=1.0))
    [view] = draw_views(0, 0, patch_scene(), 1, ranges=together)
    assert view.appearance.skin.tone == 3
    assert view.camera.eye[2] > 0


def test_cloth_suits_the_fabric_that_was_draped() -> None:
    assert {look.cloths[0].look for look in drawn(10, fabric="denim")} == {"denim"}
    assert set(LOOKS_OF_FABRIC) <= set(FABRICS)
    assert all(set(names) <= set(LOOKS) for names in LOOKS_OF_FABRIC.values())


def test_pieces_that_are_not_sewn_together_have_cloths_of_their_own() -> None:
    scene = patch_scene(joined(hung_patch(), hung_patch()))
    assert parts_of(scene)[0].tolist() == [0, 1]
    assert len(set(draw_appearance(np.random.default_rng(0), scene).cloth_of_panel.tolist())) == 2


def test_skin_is_neither_chalk_nor_coal_and_warm_on_all_tones() -> None:
    """Luminance of the albedo falls along the scale, from below 0.52 to above 0.045; red over green over blue."""
    albedos = np.array([skin_albedo(tone) for tone in MONK_TONES])
    luminance = albedos @ [0.2126, 0.7152, 0.0722]
    assert luminance.max() < 0.52 and luminance.min() > 0.045
    assert (np.diff(luminance[3:]) < 0).all()  # the first three tones are as light as each other
    assert (albedos[:, 0] > 1.3 * albedos[:, 1]).all() and (albedos[:, 1] > 1.3 * albedos[:, 2]).all()


def test_drawn_cameras_hold_the_figure_and_lights_stand_on_their_side() -> None:
    """Without crops, every point of the figure lies in the picture; the key never shines from behind the figure."""
    scene = ball_scene()
    for k in range(40):
        rng = np.random.default_rng(k)
        camera = draw_camera(rng, scene, ranges=CameraRanges(crop=0.0, offset=(0.0, 0.0)))
        pixels = camera.project(np.concatenate([scene.vertices, scene.body.vertices]), 100)
        assert 30 < np.abs(pixels - 49.5).max() < 50, k
        assert camera.rotation @ camera.rotation.T == pytest.approx(np.eye(3), abs=1e-9)
        key = draw_lights(rng, camera).key_direction
        assert float(key @ (-camera.rotation[2] * [1, 0, 1])) > 0
        assert np.linalg.norm(key) == pytest.approx(1.0)


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
    cloth, ranges = look(scene, cloth_of(plain((0.5, 0.5, 0.5)))), Ranges(camera=CameraRanges(yaw=(-30, 30), crop=1.0))
    drawn = [draw_view(np.random.default_rng(k), scene, cloth, ranges=ranges) for k in range(60)]
    views = [replace(view, camera=ahead(60.0), lights=replace(view.lights, exposure=0.6)) for view in drawn]
    middles = np.stack([picture.rgb[3:5, 3:5] for picture in render([scene], views, size=8, device="cpu")])
    red, green, blue = linear_light(middles / 255).mean(axis=(1, 2)).T
    assert 0.02 < np.abs(np.log([red / green, blue / green])).max() < 0.2


def test_hair_is_a_function_of_seed_index_and_epoch() -> None:
    drawn = [draw_hair(3, index) for index in range(60)]
    assert drawn == [draw_hair(3, index) for index in range(60)]
    assert set(drawn) == set(HairStyle)
    assert drawn != [draw_hair(3, index, epoch=1) for index in range(60)]
