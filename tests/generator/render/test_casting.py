"""Light, shadow and cloth in pictures follow the scene; the same view gives the same bytes in any batch."""

from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numpy as np
import pytest
import warp as wp

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
    start_pictures,
)
from gcd_dataset.generator.render.scene import figure_scene
from gcd_dataset.generator.render.uploading import StagingBuffers
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


def test_lent_pictures_and_those_of_several_threads_are_the_pictures() -> None:
    scenes = [ball_scene(), patch_scene()]
    views = [view for row, scene in enumerate(scenes) for view in draw_views(5, row, scene, 2, row=row)]
    expected = [bytes_of(picture) for picture in render(scenes, views, size=16, maps=MAPS, device="cpu")]
    pending = start_pictures(scenes, views, size=16, maps=MAPS, device="cpu")
    assert [bytes_of(picture) for picture in pending.lend()] == expected

    def work() -> list[bytes]:
        pictures = start_pictures(scenes, views, size=16, maps=MAPS, device="cpu").pictures()
        return [bytes_of(picture) for picture in pictures]

    with ThreadPoolExecutor(2) as pool:
        assert [one.result() for one in [pool.submit(work) for _ in range(2)]] == [expected, expected]


def test_page_locked_memory_is_free_once_the_last_picture_in_it_is_dropped(monkeypatch: pytest.MonkeyPatch) -> None:
    free = [wp.empty(2048, dtype=wp.uint8, device="cpu")]
    monkeypatch.setattr(StagingBuffers, "_free", {2048: free})
    staging = StagingBuffers("cpu")
    staging.locked = True  # as on a GPU
    front, back = staging.array((2, 1000), np.uint8)
    del front
    staging.release()
    assert len(free) == 0
    shown = replace(Picture(back, np.eye(3), np.eye(4)[:3])).rgb[:10]
    del back
    assert len(free) == 0
    del shown
    assert len(free) == 1


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
    slanted = Lights(np.array([0.0, 0.8, 0.6]), key=(0.9, 0.9, 0.9), key_size=0.01, sky=0.1)
    scene = scene_of(joined(hung, sheet), np.concatenate([hung.vertices, level]), far_ball())
    shaded, bare = (shot(one, view_of(one, lights=slanted), 32) for one in (scene, patch_scene(hung)))
    above, below = (10, 16), (19, 16)
    assert shaded[above][0] == pytest.approx(bare[above][0], abs=12)
    assert shaded[below][0] < 0.6 * bare[below][0]


def test_light_from_behind_leaves_opaque_cloth_darker_than_voile() -> None:
    scene = patch_scene()
    behind = Lights(np.array([0.0, 0.0, -1.0]), key=(1.0, 1.0, 1.0), sky=0.1)
    cloths = [cloth_of(plain(GREY), transmission=share) for share in (0.0, 0.4)]
    opaque, voile = shots(scene, [view_of(scene, cloth, lights=behind) for cloth in cloths], 16)
    assert voile[8, 8].mean() > opaque[8, 8].mean() + 20


def test_sheer_cloth_shows_what_lies_behind_it() -> None:
    """White voile before a black and before a red sheet; its sky does not depend on views that see the sheet bare."""
    front, back = hung_patch(), hung_patch()
    scene = scene_of(joined(front, back), np.concatenate([front.vertices + [0, 0, 10.0], back.vertices]), far_ball())
    views = [
        view_of(scene, cloth_of(plain(WHITE), translucency=sheerness), cloth_of(plain(behind)))
        for sheerness in (0.0, 0.5)
        for behind in (RED, BLACK)
    ]
    aside = look_at(np.array([90.0, 100.0, 12.0]), np.array([0.0, 100.0, 0.0]), focal=4.0)
    *pictures, _ = shots(scene, [*views, replace(views[2], camera=aside)], 16)
    over_red, over_black, through_red, through_black = (picture[8, 8] for picture in pictures)
    assert np.abs(over_red - over_black).max() <= 3
    through = through_red - through_black
    assert through[0] > 20
    assert through[0] > 3 * abs(through[2])
    assert np.array_equal(shot(scene, views[2], 16), pictures[2])


def test_the_floor_shows_the_figures_shadow() -> None:
    """Light from the left and above: the sweep is darker to the right of the ball's foot point than to the left."""
    scene = ball_scene()
    lights = Lights(np.array([-0.6, 0.8, 0.0]), key=(0.9, 0.9, 0.9), key_size=0.02, sky=0.3)
    place = Environment(EnvironmentKind.SWEEP, ((0.7, 0.7, 0.7),) * 3, size=800.0)
    camera = ahead(400.0, focal=1.0)
    picture = shot(scene, replace(view_of(scene, lights=lights, camera=camera), environment=place))
    # The shadow's middle lies 100 · 0.6 / 0.8 = 75 cm to the right of the foot point, on the floor.
    right, left = camera.project(np.array([[75.0, 0.0, 0.0], [-75.0, 0.0, 0.0]]), 64).round().astype(int)
    assert picture[right[1], right[0]].mean() < picture[left[1], left[0]].mean() - 30


@pytest.fixture(scope="module")
def printed() -> dict[str, np.ndarray]:
    """Prints on a patch, 96 pixels of 0.26 cm, in one rendering."""
    tile = np.full((2, 2, 3), 0.02)
    tile[0, :] = (0.6, 0.02, 0.02)
    tile[1, 0] = (0.8, 0.8, 0.8)
    colours = ((0.1, 0.1, 0.1), (0.9, 0.2, 0.2), (0.2, 0.9, 0.2), (0.2, 0.2, 0.9))
    prints = {
        "white": plain(WHITE),
        "black": plain(BLACK),
        "quarter": Print(PrintKind.STRIPES, (BLACK, WHITE, GREY, GREY), period=2.0, fill=0.25),
        "grain": Print(PrintKind.STRIPES, (BLACK, WHITE, GREY, GREY), period=4.0, fill=0.5, matched=True),
        "tile": Print(PrintKind.IMAGE, period=20.0, image=tile, matched=True),
        "tall": Print(
            PrintKind.IMAGE, period=10.0, image=tile[:, [1, 1]].repeat(4, axis=0).repeat(2, axis=1), matched=True
        ),
        **{
            f"every {kind}": Print(
                kind, colours, period=5.0 if kind is PrintKind.DOTS else 12.0, image=np.tile(tile, (2, 2, 1))
            )
            for kind in PrintKind
        },
    }
    scene = patch_scene()
    pictures = shots(scene, [view_of(scene, cloth_of(motif)) for motif in prints.values()], 96)
    return dict(zip(prints, pictures, strict=True))


def test_a_stripe_covers_its_share_of_the_cloth(printed: dict[str, np.ndarray]) -> None:
    """The mean light is that of the colours, weighted by their shares, whatever the size of the pixels."""
    scene = patch_scene()
    coarse = shot(scene, view_of(scene, cloth_of(Print(PrintKind.STRIPES, (BLACK, WHITE, GREY, GREY), 2.0, 0.25))), 24)
    white, black = ((printed[name][48, 48] / 255) ** 2.2 for name in ("white", "black"))
    for picture in (printed["quarter"], coarse):
        edge = len(picture) // 4
        mean = ((picture[edge:-edge, edge:-edge] / 255) ** 2.2).mean(axis=(0, 1))
        # On the coarse picture pixels hold several stripes: their light is averaged before the film's response.
        assert mean == pytest.approx(0.25 * white + 0.75 * black, abs=0.06)


def test_stripes_are_measured_in_centimetres_along_the_grain(printed: dict[str, np.ndarray]) -> None:
    """Stripes of 4 cm on a patch of 20 cm: five along each row, and no change along the columns."""
    picture = printed["grain"][..., 1]
    light = picture[48, 10:86] > 128
    assert np.count_nonzero(np.diff(light.astype(int)) == 1) in (4, 5)
    assert np.ptp(picture[16:80, 51]) < 30


def test_an_image_tile_lies_upright_and_unmirrored(printed: dict[str, np.ndarray]) -> None:
    """A tile of 20 cm that is red above and white below left, laid once on a patch of 20 cm."""
    picture = printed["tile"]
    upper, left, right = picture[26, 30], picture[70, 26], picture[70, 70]
    assert upper[0] > 2 * upper[2]
    assert left[2] > 150
    assert right.max() < left.min() - 60


def test_an_image_tile_keeps_its_shape(printed: dict[str, np.ndarray]) -> None:
    """The tile is 10 cm wide and 20 cm tall; its upper half is red."""
    column = printed["tall"][:, 48].astype(int)
    assert [red > 2 * blue for red, _, blue in column[[22, 40, 58, 74]]] == [True, True, False, False]


def test_every_print_is_drawn(printed: dict[str, np.ndarray]) -> None:
    """On cloth of one colour no motif shows; in four colours all but the plain one do."""
    for kind in PrintKind:
        varied = printed[f"every {kind}"][20:76, 20:76].std(axis=(0, 1)).max() > 6
        assert varied == (kind not in (PrintKind.PLAIN, PrintKind.PANELS)), kind


def test_prints_repeat_to_the_left_of_the_panels_origin() -> None:
    """Moved by 20 periods to either side, cloth looks the same."""
    kinds = (PrintKind.STRIPES, PrintKind.CHECKS, PrintKind.TARTAN, PrintKind.DOTS)
    motifs = [Print(kind, ((0.05, 0.05, 0.05), WHITE, RED, GREY), period=4.0, fill=0.3, matched=True) for kind in kinds]
    mesh = hung_patch()
    scenes = [patch_scene(replace(mesh, uv=mesh.uv + shift)) for shift in (0.0, 80.0, -80.0)]
    pictures = [shots(scene, [view_of(scene, cloth_of(motif)) for motif in motifs], 48) for scene in scenes]
    for kind, here, *moved in zip(kinds, *pictures, strict=True):
        assert max(np.abs(here - other).max() for other in moved) <= 6, kind


def test_prints_break_between_panels_that_are_not_matched() -> None:
    one, other = hung_patch(5, 10), hung_patch(5, 10)
    halves = np.concatenate([one.vertices - [5.0, 0, 0], other.vertices + [5.0, 0, 0]])
    scene = scene_of(joined(one, other), halves, far_ball())
    motif = Print(PrintKind.STRIPES, (BLACK, WHITE, GREY, GREY), angle=np.pi / 2, matched=True, seed=4)
    views = [view_of(scene, cloth_of(one)) for one in (motif, replace(motif, matched=False))]
    matched, shifted = (p[16:48, [24, 40], 1] > 128 for p in shots(scene, views))
    assert (matched[:, 0] == matched[:, 1]).mean() > 0.95
    assert (shifted[:, 0] == shifted[:, 1]).mean() < 0.9


def test_places_fill_the_picture_and_light_the_figure() -> None:
    """A room goes on to the lower edge for a camera outside; a photograph is shown as it is, under any lights.

    A panorama that is bright ahead of +x alone: the ball's side towards +x is the bright one.
    """
    scene = ball_scene()
    image, glow = np.zeros((10, 10, 3)), np.full((16, 32, 3), 0.02)
    image[:5], image[5:] = (0.2, 0.02, 0.02), (0.02, 0.02, 0.2)
    glow[:, 22:26] = 4.0  # columns run from -z through +x... the middle column is -z
    colours = ((0.8, 0.7, 0.6), (0.5, 0.4, 0.3), (0.3, 0.5, 0.4))
    view, grey = view_of(scene, camera=ahead(400.0, focal=1.5)), np.full((8, 16, 3), 0.4)
    unlit = Lights(np.array([0.0, 1.0, 0.0]), key=(0.0, 0.0, 0.0), sky=1.0)
    views = [replace(view, environment=Environment(kind, colours, image=grey)) for kind in EnvironmentKind]
    room = Environment(EnvironmentKind.ROOM, colours, size=240.0)  # its half width; the camera stands 6 m away
    views += [
        replace(view, camera=ahead(600.0, focal=1.2), environment=room),
        replace(view, camera=ahead(400.0, focal=1.0), environment=Environment(EnvironmentKind.PHOTOGRAPH, image=image)),
        replace(view, lights=unlit, camera=ahead(200.0), environment=Environment(EnvironmentKind.PANORAMA, image=glow)),
        replace(view, environment=DARK),
    ]
    *every, outside, photograph, lit, dark = shots(scene, views)
    for kind, picture in zip(EnvironmentKind, every, strict=True):
        assert picture.min() > 8, kind
        assert picture[:3].std() < 60, kind
    assert outside[-4:].min() > 8
    assert np.abs(photograph[4, 32] - [123, 39, 39]).max() <= 3
    assert np.abs(photograph[60, 32] - [39, 39, 123]).max() <= 3
    assert lit[32, 40].mean() > lit[32, 24].mean() + 15
    assert dark[2, 2].max() == 0


def test_users_photographs_are_drawn() -> None:
    image = np.full((4, 4, 3), 0.5)
    ranges = EnvironmentRanges(photographs=(image,), images=1.0)
    drawn = draw_environment(np.random.default_rng(0), ranges=ranges)
    assert drawn.kind is EnvironmentKind.PHOTOGRAPH
    assert drawn.image is not None and np.array_equal(drawn.image, image)


def test_errors_name_the_remedy() -> None:
    scene, other = patch_scene(), patch_scene(joined(hung_patch(), hung_patch()))
    view = view_of(scene)
    absent = replace(view.appearance, cloth_of_panel=np.array([1]))
    for fault, changes, size, maps in (
        ("give a size of 1 or more", {}, 0, ()),
        ("unknown map 'colour': choose from depth", {}, 8, ("colour",)),
        ("view 0 is of scene 1", {"scene": 1}, 8, ()),
        ("appearance of 2 panels for a garment of 1", {"appearance": look(other, cloth_of(plain(GREY)))}, 8, ()),
        ("names a cloth that is not there", {"appearance": absent}, 8, ()),
    ):
        with pytest.raises(ConfigError, match=fault):
            render([scene], [replace(view, **changes)], size=size, maps=maps, device="cpu")  # type: ignore[arg-type]
    broken = hung_patch().vertices.copy()
    broken[3] = np.nan
    with pytest.raises(ConfigError, match="its drape diverged"):
        scene_of(hung_patch(), broken, far_ball())


def test_a_figure_without_a_garment_and_a_scene_without_views() -> None:
    nothing = figure_scene(ball_scene().body)
    [view] = draw_views(0, 0, nothing, 1)
    [picture] = render([nothing], [view], size=32, maps=MAPS, device="cpu")
    assert (picture.maps["panel_id"] == -1).all()
    assert (picture.maps["silhouette"] > 0).any()
    assert render([nothing], [], size=8, device="cpu") == []
