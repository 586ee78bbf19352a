"""Sketches: lines lie where the geometry has outlines, edges, seams, hems and folds; strokes have their ink."""

from dataclasses import replace

import numpy as np
import pytest
import trimesh

from gcd_dataset.errors import ConfigError
from gcd_dataset.generator.render import (
    FLAT,
    HAND,
    Camera,
    Scene,
    SketchStyle,
    look_at,
    scene_of,
    sketch,
    sketch_camera,
    sketches,
)
from gcd_dataset.generator.render.sketches import HEM_STITCH, INSIDE, NOBODY, PIXELS, WIDTHS
from gcd_dataset.generator.render.strokes import SketchLine, by_hand, chains, draw_strokes, level_lines, linked, valleys
from gcd_dataset.records import BoxMesh
from tests.generator.render.scenes import hung_patch, open_napkins
from tests.helpers import far_ball, joined, patch

ROW, COLUMN = np.indices((60, 80)).astype(float)
SIZE = 400
BARE = SketchStyle(seams=False, hems=False, folds=False)
MIDDLE = np.array([0.0, 100.0, 0.0])


@pytest.fixture(autouse=True)
def coarse(monkeypatch: pytest.MonkeyPatch) -> None:
    """Range images with a quarter of the pixels."""
    monkeypatch.setattr(sketches, "PIXELS", PIXELS // 2)


def ahead(distance: float = 1000.0, *, width: float = 50.0) -> Camera:
    """A camera in front of the middle, with a picture ``width`` cm wide there."""
    return look_at(MIDDLE + [0.0, 0.0, distance], MIDDLE, focal=distance / width)


def drawn(scene: Scene, style: SketchStyle = BARE, camera: Camera | None = None, seed: int | None = None) -> np.ndarray:
    """Ink at each pixel, 0 to 1."""
    rng = None if seed is None else np.random.default_rng(seed)
    picture = sketch(scene, camera or ahead(), size=SIZE, style=style, rng=rng, device="cpu")
    assert picture.dtype == np.uint8
    return 1.0 - picture / 255.0


def of_cloth(mesh: BoxMesh) -> Scene:
    return scene_of(mesh, mesh.vertices, far_ball())


def ball_of_cloth(radius: float) -> Scene:
    ball = trimesh.creation.icosphere(subdivisions=5, radius=radius)
    vertices, faces = np.asarray(ball.vertices) + MIDDLE, np.asarray(ball.faces)
    rows, none = np.arange(len(vertices)), np.zeros((0, 2), int)
    panel = np.zeros(len(faces), int)
    return Scene(vertices, faces, vertices[:, :2], faces, rows, panel, ("ball",), ("body",), none, NOBODY)


def test_the_outline_of_a_ball_is_a_circle_of_even_width() -> None:
    """From distance d, a ball of radius r is a disc of angular radius asin(r / d)."""
    radius, distance = 20.0, 300.0
    ink = drawn(ball_of_cloth(radius), camera=ahead(distance))
    row, column = np.indices(ink.shape) - 0.5 * (SIZE - 1)
    expected = np.tan(np.arcsin(radius / distance)) * distance / 50.0 * SIZE
    from_middle = np.hypot(row, column)
    assert np.average(from_middle, weights=ink) == pytest.approx(expected, abs=0.3)
    width = WIDTHS["outline"] * SIZE
    assert np.abs(from_middle[ink > 0.1] - expected).max() < 0.5 * width + 1.5
    sector = ((np.arctan2(row, column) + np.pi) / (2 * np.pi) * 16).astype(int) % 16
    ink_of_sector = np.bincount(sector.ravel(), ink.ravel())
    assert ink_of_sector == pytest.approx(2 * np.pi * expected / 16 * width, rel=0.08)


def test_an_edge_is_drawn_where_cloth_hangs_in_front_of_cloth() -> None:
    """A square 10 cm wide before one of 30 cm: the small one's border, unless it lies on the large one."""
    back, front = hung_patch(15, 15), hung_patch(5, 5)

    def inner(gap: float) -> np.ndarray:
        both = joined(back, replace(front, vertices=front.vertices + [0.0, 0.0, gap]))
        return drawn(of_cloth(both))[100:300, 100:300]

    row, column = np.nonzero(inner(5.0) > 0.5)
    side = 10.0 / 50.0 * SIZE * 1000 / 995
    reach = np.maximum(np.abs(row - 99.5), np.abs(column - 99.5))
    assert len(row) > 4 * side * 0.9
    assert reach == pytest.approx(0.5 * side, abs=2.5)
    assert inner(0.1).max() == 0.0


def test_seams_are_lines_where_panels_meet_and_stitches_follow_the_hems() -> None:
    """Two napkins of 20 x 10 cm side by side: one seam in the middle, hems around."""
    scene = open_napkins()
    plain, sewn = drawn(scene), drawn(scene, replace(BARE, seams=True))
    row, column = np.nonzero(sewn - plain > 0.3)
    assert np.abs(column - 199.5).max() < 2
    assert np.ptp(row) > 0.75 * 10 / 50 * SIZE
    stitched = drawn(scene, replace(BARE, hems=True)) - plain
    row, column = np.nonzero(stitched > 0.3)
    from_edge = np.minimum(20 - np.abs(column - 199.5) * 50 / SIZE, 5 - np.abs(row - 199.5) * 50 / SIZE)
    assert len(row) > 300
    assert from_edge == pytest.approx(HEM_STITCH, abs=0.35)


def test_folds_are_drawn_where_cloth_turns_most_from_the_eye(monkeypatch: pytest.MonkeyPatch) -> None:
    """z = 1.5 sin(2 pi x / 16) is steepest at x = 0, 8, 16 …; flat cloth has no folds."""
    flat = of_cloth(hung_patch(5, 5))
    assert np.array_equal(drawn(flat, replace(BARE, folds=True)), drawn(flat))
    monkeypatch.setattr(sketches, "PIXELS", PIXELS)
    sheet = patch(40, 40, origin=(-20.0, 80.0, 0.0))
    x, y, _ = sheet.vertices.T
    scene = of_cloth(replace(sheet, vertices=np.column_stack([x, y, 1.5 * np.sin(2 * np.pi * x / 16.0)])))
    ink = drawn(scene, replace(BARE, folds=True)) - drawn(scene)
    _, column = np.nonzero(ink > 0.2)
    across = (column - 199.5) * 50 / SIZE
    assert set(np.rint(across / 8).astype(int).tolist()) == {-2, -1, 0, 1, 2}
    assert np.abs(across - 8 * np.rint(across / 8)).max() < 0.6


def test_the_inside_of_the_cloth_is_grey_in_a_flat() -> None:
    scene = of_cloth(hung_patch())
    behind = look_at(MIDDLE - [0.0, 0.0, 1000.0], MIDDLE, focal=20.0)
    for camera, grey in ((ahead(), 255), (behind, INSIDE)):
        picture = sketch(scene, camera, size=SIZE, style=BARE, device="cpu")
        assert picture[SIZE // 2, SIZE // 2] == grey
        assert picture[5, 5] == 255


def test_the_wearer_is_drawn_only_if_wanted() -> None:
    """A ball beside the cloth, and one that hides it."""
    ball = ball_of_cloth(12.0)
    wearer = replace(far_ball(), vertices=ball.vertices + [15.0, 0.0, 10.0], faces=ball.faces,
                     parts=np.zeros(len(ball.vertices), np.uint8))  # fmt: skip
    scene = replace(of_cloth(hung_patch()), body=wearer)
    alone, worn = drawn(scene), drawn(scene, replace(BARE, body=True))
    assert np.array_equal(alone, drawn(of_cloth(hung_patch())))
    right = np.s_[:, SIZE // 2 + 90 :]
    assert alone[right].max() == 0.0
    assert worn[right].max() > 0.3


@pytest.mark.parametrize("yaw", [0.0, 90.0, 200.0])
def test_the_camera_frames_the_garment(yaw: float) -> None:
    scene = ball_of_cloth(30.0)
    pixels = sketch_camera(scene, yaw).project(scene.vertices, 100)
    assert np.ptp(pixels[:, 1]) == pytest.approx(90.0, abs=3.0)
    assert pixels.mean(axis=0) == pytest.approx([49.5, 49.5], abs=0.5)


def test_the_front_shows_the_wearers_left_on_the_right() -> None:
    scene = of_cloth(joined(hung_patch(), patch(4, 4, origin=(20.0, 100.0, 0.0))))
    for yaw, right in ((0.0, True), (180.0, False)):
        x, _ = sketch_camera(scene, yaw).project(np.array([[24.0, 102.0, 0.0], [-10.0, 102.0, 0.0]]), SIZE).T
        assert (x[0] > x[1]) == right


def test_the_same_seed_draws_the_same_bytes() -> None:
    scene = of_cloth(hung_patch(5, 5))

    def small(style: SketchStyle, seed: int | None) -> bytes:
        rng = None if seed is None else np.random.default_rng(seed)
        return sketch(scene, ahead(), size=100, style=style, rng=rng, device="cpu").tobytes()

    first, again, other = (small(HAND, seed) for seed in (1, 1, 2))
    assert first == again != other
    assert small(FLAT, 1) == small(FLAT, None)


def test_a_sketch_has_the_same_lines_at_every_size() -> None:
    scene = of_cloth(hung_patch())
    small, large = (sketch(scene, ahead(), size=size, style=BARE, device="cpu") for size in (SIZE // 2, SIZE))
    mean = large.reshape(SIZE // 2, 2, SIZE // 2, 2).mean(axis=(1, 3))
    assert np.abs(mean - small).max() < 60
    assert mean.mean() == pytest.approx(small.mean(), abs=0.3)


def test_bad_options_are_named() -> None:
    scene = of_cloth(hung_patch())
    with pytest.raises(ConfigError, match="needs rng="):
        sketch(scene, ahead(), style=HAND, device="cpu")
    with pytest.raises(ConfigError, match="0 pixels"):
        sketch(scene, ahead(), size=0, device="cpu")
    with pytest.raises(ConfigError, match="weight of a sketch"):
        SketchStyle(weight=0.0)
    bare = replace(scene, vertices=np.zeros((0, 3)), faces=np.zeros((0, 3), int))
    with pytest.raises(ConfigError, match="without cloth"):
        sketch(bare, ahead(), device="cpu")
    with pytest.raises(ConfigError, match="without cloth"):
        sketch_camera(bare)


def test_a_level_line_of_a_distance_is_a_circle() -> None:
    [circle] = chains(level_lines(np.hypot(COLUMN - 40.3, ROW - 28.6), 20.0))
    assert (circle[0] == circle[-1]).all()
    assert np.hypot(circle[:, 0] - 40.3, circle[:, 1] - 28.6) == pytest.approx(20.0, abs=0.02)


@pytest.mark.parametrize("angle", [0.0, 0.4, 1.2, 2.5])
def test_a_valley_is_its_deepest_line(angle: float) -> None:
    """A parabola across a slanted line has that line as its only valley, of curvature 2 · 0.01."""
    across = (COLUMN - 40) * np.cos(angle) + (ROW - 30) * np.sin(angle)
    segments, strength = valleys(0.01 * across**2, sigma=1.0)
    used = segments.place[segments.ends]
    used = used[(np.abs(used - [40, 30]) < 18).all(axis=(1, 2))].reshape(-1, 2)  # away from the border of the picture
    assert len(used) > 30
    found = (used[:, 0] - 40) * np.cos(angle) + (used[:, 1] - 30) * np.sin(angle)
    assert np.abs(found).max() < 0.05
    assert strength[30, 40] == pytest.approx(0.02, rel=0.01)


@pytest.mark.parametrize("width", [0.6, 1.5, 4.0])
@pytest.mark.parametrize("slope", [0.0, 0.7])
def test_the_ink_of_a_line_is_its_length_times_its_width(width: float, slope: float) -> None:
    size = 200
    points = np.array([[0.2, 0.2], [0.8, 0.2 + 0.6 * slope]])
    ink = float((255 - draw_strokes([SketchLine(points, width / size)], size).astype(float)).sum()) / 255
    length = size * float(np.linalg.norm(points[1] - points[0]))
    assert ink == pytest.approx(length * width, rel=0.06)


def test_a_hand_stays_near_the_line_and_does_not_repeat_itself() -> None:
    line = SketchLine(np.array([[0.1, 0.5], [0.9, 0.5]]), 0.004)
    first, again, other = (by_hand(line, np.random.default_rng(seed)) for seed in (1, 1, 2))
    assert all((a.points == b.points).all() for a, b in zip(first, again, strict=True))
    assert len(first) != len(other) or not np.array_equal(first[0].points, other[0].points)
    points = np.concatenate([piece.points for piece in first])
    assert 1e-4 < np.abs(points[:, 1] - 0.5).max() < 0.02
    assert (np.diff(np.sort(points[:, 0])) < 0.01).all()  # pieces leave no gap


def test_lines_are_joined_where_one_goes_on_as_another() -> None:
    along = np.arange(20.0)
    level = np.stack([along, np.zeros(20)], axis=1)
    after, aside = level[::-1] + [24.0, 0.0], np.stack([np.full(20, 21.0), along + 3.0], axis=1)
    lines = linked([level, aside, after], 6.0)
    assert sorted(len(line) for line in lines) == [20, 40]
    (joined,) = (line for line in lines if len(line) == 40)
    assert (np.abs(np.diff(joined[:, 0])) <= 5).all()
    assert np.ptp(joined[:, 0]) == 43
    assert len(linked([level, after], 4.0)) == 2
