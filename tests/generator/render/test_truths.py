"""Maps, matrices and points agree with the geometry."""

from dataclasses import replace

import numpy as np
import pytest
import trimesh
from jaxtyping import Float

from gcd_dataset.generator.body import build_body, named_pose, neutral_shape, pose_body
from gcd_dataset.generator.mesh import build_box_mesh
from gcd_dataset.generator.render import (
    COCO_KEYPOINTS,
    MAPS,
    Camera,
    HairStyle,
    Lights,
    Picture,
    Scene,
    fixed_camera,
    look_at,
    render,
    scene_of,
)
from gcd_dataset.generator.render.geometry import HEM
from gcd_dataset.generator.render.pictures import BACKGROUND, GARMENT, HAIR, VERTEX_MAPS
from gcd_dataset.generator.render.scene import figure_scene
from gcd_dataset.records import BodyPart
from tests.generator.render.scenes import FRONT_LIGHT, ahead, ball_scene, open_napkins, patch_scene, view_of
from tests.helpers import body_from, far_ball, napkins, patch


def picture_of(scene: Scene, camera: Camera, size: int = 64, *, lights: Lights = FRONT_LIGHT) -> Picture:
    [picture] = render([scene], [view_of(scene, camera=camera, lights=lights)], size=size, maps=MAPS, device="cpu")
    return picture


def points_at(picture: Picture, row: np.ndarray, column: np.ndarray) -> Float[np.ndarray, "3 n"]:
    """The points that K, depth and [R | t] give back to pixels [cm]."""
    seen = np.linalg.solve(picture.intrinsics, np.stack([column, row, np.ones_like(row)]).astype(float))
    R, t = picture.extrinsics[:, :3], picture.extrinsics[:, 3:]
    return np.asarray(R.T @ (seen * picture.maps["depth"][row, column] - t))


def test_depth_of_a_ball() -> None:
    """Along the optical axis, in cm: the camera's distance less the radius; outside 0."""
    maps = picture_of(ball_scene(20.0), ahead(200.0), 65).maps
    assert maps["depth"][32, 32] == pytest.approx(180.0, abs=0.05)
    assert maps["depth"][0, 0] == 0.0
    assert maps["silhouette"][32, 32] == 255
    assert maps["silhouette"][0, 0] == 0


def test_every_pixel_projects_back_onto_itself() -> None:
    """The camera takes the points of pixels back to their pixels; the points lie on the ball."""
    camera = look_at(np.array([60.0, 150.0, 180.0]), np.array([3.0, 98.0, 0.0]), focal=2.5, roll=0.2, shift=(0.05, 0.1))
    picture = picture_of(ball_scene(20.0), camera, 48)
    row, column = np.nonzero(picture.maps["part"] == BodyPart.TRUNK.value)
    assert len(row) > 200
    points = points_at(picture, row, column).T
    assert np.linalg.norm(points - [0.0, 100.0, 0.0], axis=1) == pytest.approx(20.0, abs=0.1)
    assert camera.project(points, 48) == pytest.approx(np.stack([column, row], axis=1), abs=1e-3)
    assert np.linalg.det(picture.extrinsics[:, :3]) == pytest.approx(1.0)


def test_normals_point_at_the_camera_in_its_own_axes() -> None:
    """x right, y down, z forward: on the ball's right, normals point right; below, down; everywhere against z."""
    normals = picture_of(ball_scene(20.0), ahead(200.0), 65).maps["normals"]
    assert normals[32, 32] == pytest.approx([0.0, 0.0, -1.0], abs=0.05)
    assert normals[32, 50][0] > 0.5
    assert normals[50, 32][1] > 0.5
    covered = np.abs(normals).sum(axis=2) > 0
    assert (normals[covered][:, 2] < 0.1).all()


def test_uv_of_a_flat_patch_is_its_place_on_the_panel() -> None:
    """20 cm wide, 100 cm away: a pixel of 100 at focal 4 is 0.25 cm; u grows to the right, v upwards."""
    maps = picture_of(patch_scene(), ahead(), 100).maps
    u, v = maps["uv"][40, 60]
    assert u == pytest.approx(10.0 + (60 - 49.5) * 0.25, abs=1e-3)
    assert v == pytest.approx(10.0 + (49.5 - 40) * 0.25, abs=1e-3)
    assert np.isnan(maps["uv"][2, 2]).all()
    assert maps["panel_id"][40, 60] == 0
    assert maps["panel_id"][2, 2] == -1
    assert maps["part"][40, 60] == GARMENT
    assert maps["part"][2, 2] == BACKGROUND


def test_a_linear_value_of_the_vertices_has_at_each_pixel_its_value_at_the_point_seen_there() -> None:
    """On a plane, seen askew; NaN off the garment. A figure before the plane in the same batch changes nothing."""
    scene = patch_scene()
    x, y, _ = scene.vertices.T
    values = {"stretch": np.stack([1.0 + 0.01 * x, 0.02 * y], axis=1), "gap": 0.3 * x - 0.2 * y, "pressure": 5.0 - x}
    scene = replace(scene, values=values)
    ball = ball_scene()
    ball = replace(ball, values={name: np.zeros_like(each) for name, each in values.items()})
    camera = look_at(np.array([40.0, 130.0, 90.0]), np.array([0.0, 100.0, 0.0]), focal=3.0, roll=0.2)
    views = [replace(view_of(ball, camera=camera), scene=0), replace(view_of(scene, camera=camera), scene=1)]
    _, picture = render([ball, scene], views, size=64, maps=("gap", "depth", "uv", "stretch", "pressure"), device="cpu")
    maps = picture.maps
    row, column = np.nonzero(maps["depth"] > 0.0)
    assert len(row) > 500
    x, y, _ = points_at(picture, row, column)
    assert maps["gap"][row, column] == pytest.approx(0.3 * x - 0.2 * y, abs=1e-3)
    assert maps["pressure"][row, column] == pytest.approx(5.0 - x, abs=1e-3)
    assert maps["stretch"][row, column] == pytest.approx(np.stack([1.0 + 0.01 * x, 0.02 * y], axis=1), abs=1e-4)
    assert maps["uv"][row, column] == pytest.approx(np.stack([x + 10.0, y - 90.0], axis=1), abs=1e-3)
    for name in VERTEX_MAPS:
        assert maps[name].dtype == np.float32
        assert np.isnan(maps[name][maps["depth"] == 0.0]).all()


def test_seams_and_hems_are_lines_where_the_pattern_has_them() -> None:
    """Two napkins sewn together, laid open: one seam in the middle, hems around."""
    scene = open_napkins()
    picture = picture_of(scene, ahead(100.0, focal=2.0), 128)
    seam, panel = picture.maps["seam"], picture.maps["panel_id"]
    assert sorted(scene.panel_corners.tolist()) == [[p, k] for p in range(2) for k in range(4)]
    row, column = np.nonzero(seam == 0)
    assert len(row) > 20
    assert np.abs(column - 63.5).max() < 3
    edge_rows = np.nonzero(seam[:, 40] == HEM)[0]
    assert len(edge_rows) > 0
    assert np.abs(np.abs(edge_rows - 63.5) * 50 / 128 - 5.0).max() < 1.0
    assert set(np.unique(panel)) == {-1, 0, 1}
    assert seam[64, 40] == -1
    assert (panel[64, 30], panel[64, 100]) == (0, 1)


def test_panel_corners_project_to_the_patch_and_are_hidden_by_a_body() -> None:
    pattern = napkins()
    one = replace(pattern, panels=pattern.panels[:1], seams=())
    mesh = build_box_mesh(one, spacing=2.0)
    flat = np.column_stack([mesh.uv + [-10.0, 95.0], np.zeros(len(mesh.uv))])
    flat = flat[np.argsort(mesh.uv_vertex)]
    scene = scene_of(mesh, flat, far_ball(), pattern=one)
    free = picture_of(scene, ahead(100.0, focal=2.0), 100)
    left_below = free.corner_pixels[free.panel_corners.tolist().index([0, 0])]
    assert left_below == pytest.approx([49.5 - 20.0, 49.5 + 10.0], abs=1e-6)
    assert free.corner_visible.all()
    hidden = ball_scene(20.0).body  # between the camera and the cloth
    behind = replace(scene, vertices=flat - [0, 0, 40.0], body=hidden)
    assert not picture_of(behind, ahead(100.0, focal=2.0), 100).corner_visible.any()
    aside = look_at(np.array([0.0, 100.0, 100.0]), np.array([200.0, 100.0, 0.0]), focal=2.0)
    assert not picture_of(scene, aside, 100).corner_visible.any()


def test_landmarks_and_parts_of_the_body() -> None:
    """From behind, the nape is seen and the nose side is not; the part at a wrist's pixel is a hand or an arm."""
    body = build_body(neutral_shape())
    cloth = patch(2, 2, origin=(0.0, 200.0, 0.0))
    scene = scene_of(cloth, cloth.vertices, body, hair=HairStyle.CROPPED)
    front, back = (picture_of(scene, fixed_camera(scene, side), 256) for side in ("front", "back"))
    names = front.landmark_names
    nape, bust = names.index("nape_of_neck"), names.index("bust_right")
    assert back.landmark_visible[nape] and not front.landmark_visible[nape]
    assert front.landmark_visible[bust] and not back.landmark_visible[bust]
    column, row = front.landmark_pixels[names.index("wrist_right")].round().astype(int)
    near = front.maps["part"][row - 2 : row + 3, column - 2 : column + 3]
    assert {BodyPart.RIGHT_ARM.value, BodyPart.HANDS.value} & set(np.unique(near).tolist())
    assert column < 128  # the wearer's right is on the left of the front view
    assert (back.maps["part"] == HAIR).sum() > (front.maps["part"] == HAIR).sum() > 0


def test_a_body_of_another_mesh_has_no_landmarks() -> None:
    cloth = patch(2, 2)
    assert scene_of(cloth, cloth.vertices, body_from(trimesh.creation.box())).landmarks == {}


def test_lit_is_the_side_of_the_light_without_what_stands_before_it() -> None:
    """A ball under light from its right; a sheet to the right of its upper half shades that half."""
    ball = ball_scene(20.0)
    from_right = Lights(np.array([1.0, 0.0, 0.0]))
    sheet = patch(30, 15, spacing=2.0)
    upright = np.column_stack([np.full(len(sheet.uv), 40.0), sheet.uv[:, 1] + 100.0, sheet.uv[:, 0] - 30.0])
    shaded = scene_of(sheet, upright, ball.body)
    free, behind = (picture_of(each, ahead(200.0), 65, lights=from_right).maps["lit"] for each in (ball, shaded))
    above, below = (22, 42), (42, 42)
    assert free[above] == free[below] == 255
    assert free[32, 20] == 0
    assert (behind[above], behind[below]) == (0, 255)


def test_keypoints_of_a_stride_seen_from_both_sides() -> None:
    """Bones keep their lengths in a pose; from behind the face is hidden, and left and right change sides."""
    standing = build_body(neutral_shape())
    striding = pose_body(standing, named_pose("stride"))
    pairs = [[COCO_KEYPOINTS.index(f"left_{name}") for name in pair] for pair in (("hip", "knee"), ("knee", "ankle"))]
    still, scene = figure_scene(standing), figure_scene(striding)
    lengths = [[np.linalg.norm(np.subtract(*each.keypoints[pair])) for pair in pairs] for each in (still, scene)]
    assert lengths[1] == pytest.approx(lengths[0], abs=1e-6)
    front, back = (picture_of(scene, fixed_camera(scene, side), 256).keypoints for side in ("front", "back"))
    nose, left, right = (COCO_KEYPOINTS.index(name) for name in ("nose", "left_elbow", "right_elbow"))
    assert (front[nose, 2], back[nose, 2]) == (2, 1)
    assert front[left, 0] > front[right, 0] and back[left, 0] < back[right, 0]
    assert front[left, 2] == back[left, 2] == 2  # though the joint lies in the flesh
    feet = look_at(np.array([0.0, 5.0, 100.0]), np.array([0.0, 5.0, 0.0]), focal=2.0)
    assert picture_of(scene, feet, 64).keypoints[nose].tolist() == [0, 0, 0]
