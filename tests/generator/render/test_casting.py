"""Light, shadow and cloth in pictures follow the scene; the same view gives the same bytes in any batch."""

from dataclasses import replace

import numpy as np
import pytest

from gcd_dataset.errors import ConfigError
from gcd_dataset.generator.render import (
    MAPS,
    Environment,
    EnvironmentKind,
    EnvironmentRanges,
    Lights,
    Picture,
    Print,
    PrintKind,
    Scene,
    View,
    draw_environment,
    draw_views,
    look_at,
    render,
    scene_of,
)
from tests.generator.render.scenes import (
    DARK,
    GREY,
    ahead,
    ball_scene,
    cloth_of,
    hung_patch,
    look,
    patch_scene,
    plain,
    view_of,
)
from tests.helpers import far_ball, joined

RED, WHITE, BLACK = (0.8, 0.1, 0.1), (0.95, 0.95, 0.95), (0.02, 0.02, 0.02)


def shot(scene: Scene, view: View, size: int = 64) -> np.ndarray:
    [picture] = shots(scene, [view], size)
    return picture


def shots(scene: Scene, views: list[View], size: int = 64) -> list[np.ndarray]:
    return [picture.rgb.astype(int) for picture in render([scene], views, size=size, device="cpu")]


def bytes_of(picture: Picture) -> bytes:
    return picture.rgb.tobytes() + b"".join(picture.maps[name].tobytes() for name in MAPS)


def test_a_view_has_the_same_bytes_alone_and_in_any_batch() -> None:
    scenes = [ball_scene(), patch_scene(), ball_scene(30.0)]
    views = [view for row, scene in enumerate(scenes) for view in draw_views(3, row, scene, 2, row=row)]
    together = render(scenes, views, size=32, maps=MAPS, device="cpu")
    backwards = render(
        scenes[::-1], [replace(v, scene=2 - v.scene) for v in views[::-1]], size=32, maps=MAPS, device="cpu"
    )
    for view, one, other in zip(views, together, backwards[::-1], strict=True):
        [alone] = render([scenes[view.scene]], [replace(view, scene=0)], size=32, maps=MAPS, device="cpu")
        assert bytes_of(alone) == bytes_of(one) == bytes_of(other)


def test_what_sheer_cloth_covers_does_not_depend_on_views_that_see_it_bare() -> None:
    front, back = hung_patch(), hung_patch()
    both = joined(front, back)
    scene = scene_of(both, np.concatenate([front.vertices + [0, 0, 6.0], back.vertices]), far_ball())
    voile = cloth_of(plain(WHITE), translucency=0.6)
    through = view_of(scene, voile, cloth_of(plain(RED)))
    aside = view_of(scene, voile, camera=look_at(np.array([90.0, 100.0, 12.0]), np.array([0.0, 100.0, 0.0]), focal=4.0))
    [alone] = render([scene], [through], size=48, device="cpu")
    beside, _ = render([scene], [through, aside], size=48, device="cpu")
    assert np.array_equal(alone.rgb, beside.rgb)


def test_maps_do_not_change_the_picture() -> None:
    scene = ball_scene()
    [view] = draw_views(1, 0, scene, 1)
    [with_maps] = render([scene], [view], size=24, maps=("uv",), device="cpu")
    assert np.array_equal(with_maps.rgb, shot(scene, view, 24))
    assert set(with_maps.maps) == {"uv"}


def test_cloth_between_light_and_cloth_casts_a_shadow() -> None:
    """Light from straight above: a level sheet shades the lower half of a hanging one but not cloth above it."""
    hung, sheet = hung_patch(), hung_patch(20, 4)
    level = np.stack([sheet.vertices[:, 0], np.full(len(sheet.vertices), 100.0), sheet.uv[:, 1] + 0.5], axis=1)
    both = joined(hung, sheet)
    slanted = Lights(np.array([0.0, 0.8, 0.6]), key=(0.9, 0.9, 0.9), key_size=0.01, sky=0.1)
    scene = scene_of(both, np.concatenate([hung.vertices, level]), far_ball())
    shaded = shot(scene, view_of(scene, lights=slanted))
    alone = patch_scene(hung)
    bare = shot(alone, view_of(alone, lights=slanted))
    above, below = (20, 32), (38, 32)
    assert shaded[above][0] == pytest.approx(bare[above][0], abs=12)
    assert shaded[below][0] < 0.6 * bare[below][0]


def test_light_from_behind_leaves_opaque_cloth_darker_than_voile() -> None:
    scene = patch_scene()
    behind = Lights(np.array([0.0, 0.0, -1.0]), key=(1.0, 1.0, 1.0), sky=0.1)
    opaque, voile = (
        shot(scene, view_of(scene, cloth_of(plain(GREY), transmission=share), lights=behind))[32, 32]
        for share in (0.0, 0.4)
    )
    assert voile.mean() > opaque.mean() + 20


def test_sheer_cloth_shows_what_lies_behind_it() -> None:
    """White voile before a black and before a red sheet."""
    front, back = hung_patch(), hung_patch()
    both = joined(front, back)
    scene = scene_of(both, np.concatenate([front.vertices + [0, 0, 10.0], back.vertices]), far_ball())

    views = [
        view_of(scene, cloth_of(plain(WHITE), translucency=sheerness), cloth_of(plain(behind)))
        for sheerness in (0.0, 0.5)
        for behind in (RED, BLACK)
    ]
    over_red, over_black, through_red, through_black = (picture[32, 32] for picture in shots(scene, views))
    assert np.abs(over_red - over_black).max() <= 3
    through = through_red - through_black
    assert through[0] > 20
    assert through[0] > 3 * abs(through[2])


def test_a_stripe_covers_its_share_of_the_cloth() -> None:
    """The mean light is that of the colours, weighted by their shares, whatever the size of the pixels."""
    scene = patch_scene()
    motif = Print(PrintKind.STRIPES, (BLACK, WHITE, GREY, GREY), period=2.0, fill=0.25)
    colours = [view_of(scene, cloth_of(plain(colour))) for colour in (WHITE, BLACK)]
    white, black = ((picture[32, 32] / 255) ** 2.2 for picture in shots(scene, colours))
    for size in (16, 64):
        picture = shot(scene, view_of(scene, cloth_of(motif), camera=ahead(focal=6.0)), size) / 255
        middle = picture[size // 4 : -size // 4, size // 4 : -size // 4]
        mean = (middle**2.2).mean(axis=(0, 1))
        # On the coarse picture pixels hold several stripes: their light is averaged before the film's response.
        assert mean == pytest.approx(0.25 * white + 0.75 * black, abs=0.06)


def test_stripes_are_measured_in_centimetres_along_the_grain() -> None:
    """Stripes of 4 cm on a patch of 20 cm: five along each row, and no change along the columns."""
    scene = patch_scene()
    motif = Print(PrintKind.STRIPES, (BLACK, WHITE, GREY, GREY), period=4.0, fill=0.5, matched=True)
    picture = shot(scene, view_of(scene, cloth_of(motif)), 200)[..., 1]
    light = picture[100, 20:180] > 128
    assert np.count_nonzero(np.diff(light.astype(int)) == 1) in (4, 5)
    assert np.ptp(picture[30:170, 105]) < 30


def test_prints_repeat_to_the_left_of_the_panels_origin() -> None:
    """Moved by 20 periods to either side, cloth looks the same."""
    kinds = (PrintKind.STRIPES, PrintKind.CHECKS, PrintKind.TARTAN, PrintKind.DOTS)
    motifs = [Print(kind, ((0.05, 0.05, 0.05), WHITE, RED, GREY), period=4.0, fill=0.3, matched=True) for kind in kinds]
    mesh = hung_patch()
    scenes = [patch_scene(replace(mesh, uv=mesh.uv + shift)) for shift in (0.0, 80.0, -80.0)]
    here, right, left = (shots(scene, [view_of(scene, cloth_of(motif)) for motif in motifs]) for scene in scenes)
    for kind, *pictures in zip(kinds, here, right, left, strict=True):
        assert max(np.abs(pictures[0] - moved).max() for moved in pictures[1:]) <= 6, kind


def test_prints_break_between_panels_that_are_not_matched() -> None:
    one, other = hung_patch(5, 10), hung_patch(5, 10)
    both = joined(one, other)
    scene = scene_of(both, np.concatenate([one.vertices - [5.0, 0, 0], other.vertices + [5.0, 0, 0]]), far_ball())
    pictures = [
        shot(
            scene,
            view_of(
                scene,
                cloth_of(
                    Print(PrintKind.STRIPES, (BLACK, WHITE, GREY, GREY), angle=np.pi / 2, matched=matched, seed=4)
                ),
            ),
        )
        for matched in (True, False)
    ]
    halves = [(p[16:48, 24, 1] > 128, p[16:48, 40, 1] > 128) for p in pictures]
    assert (halves[0][0] == halves[0][1]).mean() > 0.95
    assert (halves[1][0] == halves[1][1]).mean() < 0.9


def test_an_image_tile_lies_upright_and_unmirrored() -> None:
    """A tile of 20 cm that is red above and white below left, laid once on a patch of 20 cm."""
    tile = np.full((2, 2, 3), 0.02)
    tile[0, :] = (0.6, 0.02, 0.02)
    tile[1, 0] = (0.8, 0.8, 0.8)
    motif = Print(PrintKind.IMAGE, period=20.0, image=tile, matched=True)
    scene = patch_scene()
    picture = shot(scene, view_of(scene, cloth_of(motif)), 96)
    upper, left, right = picture[26, 30], picture[70, 26], picture[70, 70]
    assert upper[0] > 2 * upper[2]
    assert left[2] > 150
    assert right.max() < left.min() - 60


def test_every_print_is_drawn() -> None:
    """On cloth of one colour no motif shows; in four colours all but the plain one do."""
    scene = patch_scene()
    tile = np.linspace(0.0, 0.9, 48).reshape(4, 4, 3)
    colours = ((0.1, 0.1, 0.1), (0.9, 0.2, 0.2), (0.2, 0.9, 0.2), (0.2, 0.2, 0.9))
    motifs = [Print(kind, colours, period=5.0 if kind is PrintKind.DOTS else 12.0, image=tile) for kind in PrintKind]
    for kind, picture in zip(PrintKind, shots(scene, [view_of(scene, cloth_of(one)) for one in motifs]), strict=True):
        varied = picture[14:50, 14:50].std(axis=(0, 1)).max() > 6
        assert varied == (kind not in (PrintKind.PLAIN, PrintKind.PANELS)), kind


def test_every_place_fills_the_picture() -> None:
    scene = ball_scene()
    image = np.full((8, 16, 3), 0.4)
    colours = ((0.8, 0.7, 0.6), (0.5, 0.4, 0.3), (0.3, 0.5, 0.4))
    view = view_of(scene, camera=ahead(400.0, focal=1.5))
    views = [replace(view, environment=Environment(kind, colours, image=image)) for kind in EnvironmentKind]
    for kind, picture in zip(EnvironmentKind, shots(scene, views), strict=True):
        assert picture.min() > 8, kind
        assert picture[:3].std() < 60, kind


def test_a_room_seen_from_outside_has_a_floor() -> None:
    """The camera stands 6 m before a room of 2.4 m half width: the floor goes on to the picture's lower edge."""
    place = Environment(EnvironmentKind.ROOM, ((0.8, 0.7, 0.6), (0.5, 0.4, 0.3), (0.3, 0.5, 0.4)), size=240.0)
    scene = ball_scene()
    picture = shot(scene, replace(view_of(scene, camera=ahead(600.0, focal=1.2)), environment=place))
    assert picture[-4:].min() > 8


def test_a_photograph_is_shown_as_it_is() -> None:
    """Above and below the figure; under any lights."""
    image = np.zeros((10, 10, 3))
    image[:5], image[5:] = (0.2, 0.02, 0.02), (0.02, 0.02, 0.2)
    place = Environment(EnvironmentKind.PHOTOGRAPH, image=image)
    scene = ball_scene()
    view = replace(view_of(scene, camera=ahead(400.0, focal=1.0)), environment=place)
    picture = shot(scene, view)
    assert np.abs(picture[4, 32] - [123, 39, 39]).max() <= 3
    assert np.abs(picture[60, 32] - [39, 39, 123]).max() <= 3


def test_a_panorama_lights_the_figure_from_its_bright_side() -> None:
    """A panorama that is bright ahead of +x alone: the ball's side towards +x is the bright one."""
    image = np.full((16, 32, 3), 0.02)
    image[:, 22:26] = 4.0  # columns run from -z through +x... the middle column is -z
    place = Environment(EnvironmentKind.PANORAMA, image=image)
    unlit = Lights(np.array([0.0, 1.0, 0.0]), key=(0.0, 0.0, 0.0), sky=1.0)
    scene = ball_scene()
    picture = shot(scene, replace(view_of(scene, lights=unlit, camera=ahead(200.0)), environment=place))
    assert picture[32, 40].mean() > picture[32, 24].mean() + 15


def test_the_floor_shows_the_figures_shadow() -> None:
    """Light from the left and above: the sweep is darker to the right of the ball's foot point than to the left."""
    scene = ball_scene()
    lights = Lights(np.array([-0.6, 0.8, 0.0]), key=(0.9, 0.9, 0.9), key_size=0.02, sky=0.3)
    place = Environment(EnvironmentKind.SWEEP, ((0.7, 0.7, 0.7),) * 3, size=800.0)
    camera = ahead(400.0, focal=1.0)
    picture = shot(scene, replace(view_of(scene, lights=lights, camera=camera), environment=place), 128)
    # The shadow's middle lies 100 · 0.6 / 0.8 = 75 cm to the right of the foot point, on the floor.
    right, left = camera.project(np.array([[75.0, 0.0, 0.0], [-75.0, 0.0, 0.0]]), 128).round().astype(int)
    assert picture[right[1], right[0]].mean() < picture[left[1], left[0]].mean() - 30


def test_users_photographs_are_drawn() -> None:
    image = np.full((4, 4, 3), 0.5)
    ranges = EnvironmentRanges(photographs=(image,), images=1.0)
    drawn = draw_environment(np.random.default_rng(0), ranges=ranges)
    assert drawn.kind is EnvironmentKind.PHOTOGRAPH
    assert drawn.image is not None and np.array_equal(drawn.image, image)


def test_errors_name_the_remedy() -> None:
    scene, other = patch_scene(), patch_scene(joined(hung_patch(), hung_patch()))
    view = view_of(scene)
    with pytest.raises(ConfigError, match="give a size of 1 or more"):
        render([scene], [view], size=0, device="cpu")
    with pytest.raises(ConfigError, match="unknown map 'colour': choose from depth"):
        render([scene], [view], size=8, maps=("colour",), device="cpu")  # type: ignore[arg-type]
    with pytest.raises(ConfigError, match="view 0 is of scene 1"):
        render([scene], [replace(view, scene=1)], size=8, device="cpu")
    with pytest.raises(ConfigError, match="an appearance of 2 panels for a garment of 1"):
        render([scene], [replace(view, appearance=look(other, cloth_of(plain(GREY))))], size=8, device="cpu")
    with pytest.raises(ConfigError, match="names a cloth that is not there"):
        bad = replace(view.appearance, cloth_of_panel=np.array([1]))
        render([scene], [replace(view, appearance=bad)], size=8, device="cpu")


def test_no_views_give_no_pictures() -> None:
    assert render([patch_scene()], [], size=8, device="cpu") == []


def test_the_background_of_a_dark_place_is_black() -> None:
    scene = patch_scene()
    picture = shot(scene, replace(view_of(scene), environment=DARK))
    assert picture[2, 2].max() == 0


def test_a_body_without_a_garment_can_be_rendered() -> None:
    scene = ball_scene()
    nothing = replace(
        scene,
        vertices=np.zeros((0, 3)),
        faces=np.zeros((0, 3), int),
        uv=np.zeros((0, 2)),
        corners=np.zeros((0, 3), int),
        uv_vertex=np.zeros(0, int),
        panel_id=np.zeros(0, int),
        panel_names=(),
        panel_labels=(),
    )
    [view] = draw_views(0, 0, nothing, 1)
    [picture] = render([nothing], [view], size=32, maps=MAPS, device="cpu")
    assert (picture.maps["panel_id"] == -1).all()
    assert (picture.maps["silhouette"] > 0).any()


def test_a_diverged_drape_is_refused() -> None:
    mesh = hung_patch()
    broken = mesh.vertices.copy()
    broken[3] = np.nan
    with pytest.raises(ConfigError, match="its drape diverged"):
        scene_of(mesh, broken, far_ball())
