"""Scans: depth cameras measure what they see, with the stated errors."""

import math
from dataclasses import replace

import numpy as np
import pytest
import trimesh

from gcd_dataset.errors import ConfigError
from gcd_dataset.generator.render import KINECT, NOISELESS, Camera, DepthNoise, PointScan, Scene, look_at, scan
from gcd_dataset.generator.render import scan_cameras as cameras_round
from tests.generator.render.scenes import ahead, ball_scene, hung_patch, patch_scene

SIZE, RADIUS = 120, 20.0
MIDDLE = np.array([0.0, 100.0, 0.0])


def scanned(scene: Scene, *cameras: Camera, noise: DepthNoise = NOISELESS, seed: int = 0, points: int = 4000,
            body: bool = False, size: int = SIZE) -> PointScan:  # fmt: skip
    rng = np.random.default_rng(seed)
    return scan(scene, cameras, rng, points=points, noise=noise, body=body, size=size, device="cpu")


def beside(angle: float, distance: float = 200.0) -> Camera:
    """A camera at an angle [degrees] round the ball; 0 in front."""
    away = np.array([math.sin(math.radians(angle)), 0.0, math.cos(math.radians(angle))])
    return look_at(MIDDLE + distance * away, MIDDLE, focal=3.0)


@pytest.mark.parametrize("distance", [150.0, 250.0])
def test_depths_of_a_plane_scatter_as_the_sources_state(distance: float) -> None:
    """Khoshelham and Elberink: 2.85e-5 / cm times half a step times the square of the distance."""
    noise = DepthNoise(disparity_step=2.85e-5, disparity_sigma=0.5, rounded=True)
    plane = scanned(patch_scene(), ahead(distance, focal=8.0), noise=noise)
    assert plane.points[:, 2].std() == pytest.approx(2.85e-5 * 0.5 * distance**2, rel=0.06)
    assert len(np.unique(plane.points[:, 2].round(6))) < 20  # in layers
    tenths = scanned(patch_scene(), ahead(distance, focal=8.0), noise=DepthNoise(sigma=0.1))
    assert np.sqrt(np.mean(tenths.points[:, 2] ** 2)) == pytest.approx(0.1, rel=0.05)


def test_without_noise_points_lie_on_the_mesh() -> None:
    scene = ball_scene(RADIUS)
    cloud = scanned(scene, beside(0.0), beside(120.0), points=100, body=True)
    mesh = trimesh.Trimesh(
        np.concatenate([scene.vertices, scene.body.vertices]),
        np.concatenate([scene.faces, scene.body.faces + len(scene.vertices)]),
        process=False,
    )
    _, distance, _ = trimesh.proximity.closest_point_naive(mesh, cloud.points)
    assert distance.max() < 0.05
    on_ball = cloud.panel_id == -1
    radial = (cloud.points[on_ball] - MIDDLE) / RADIUS
    assert np.einsum("nc,nc->n", radial, cloud.normals[on_ball]).min() > 0.998


def test_one_camera_sees_one_side() -> None:
    scene = ball_scene(RADIUS)
    front = scanned(scene, beside(0.0), body=True)
    ball = front.points[front.panel_id == -1]
    assert ball[:, 2].min() > RADIUS**2 / 200.0 - 0.2  # the tangents from the camera touch the ball there
    both = scanned(scene, beside(0.0), beside(90.0), body=True)
    assert both.points[(both.panel_id == -1) & (both.camera == 1), 0].min() > RADIUS**2 / 200.0 - 0.2


def test_the_body_hides_cloth() -> None:
    """Cloth 100 cm behind a ball of 40 cm."""
    hidden = scanned(ball_scene(RADIUS), beside(0.0), points=50)
    assert hidden.measured == 0
    assert np.isnan(hidden.points).all()
    assert (hidden.panel_id == -1).all()
    assert (scanned(ball_scene(RADIUS), beside(180.0)).panel_id == 0).all()


def test_a_projector_casts_a_shadow_on_the_side_away_from_it() -> None:
    """A ball 30 cm across, 40 cm before a wide sheet."""
    mesh = hung_patch(40, 40, spacing=4.0)
    scene = replace(ball_scene(15.0), vertices=mesh.vertices - [0, 0, 40.0], faces=mesh.faces, panel_id=mesh.panel_id)
    camera = look_at(MIDDLE + [0, 0, 200.0], MIDDLE, focal=1.5)
    lit = scanned(scene, camera, points=SIZE**2)
    shadowed = scanned(scene, camera, points=SIZE**2, noise=DepthNoise(baseline=20.0))
    lost = {tuple(p) for p in lit.points.round(4)} - {tuple(p) for p in shadowed.points.round(4)}
    assert len(lost) > 30
    assert max(x for x, _, _ in lost) < 0.0  # the projector stands at the camera's right, +x


def test_steep_surfaces_and_patches_are_lost() -> None:
    scene = ball_scene(RADIUS)
    whole = scanned(scene, beside(0.0), body=True)
    steep = scanned(scene, beside(0.0), body=True, noise=DepthNoise(grazing=45.0))
    towards = steep.extrinsics[0, :, :3].T @ -steep.extrinsics[0, :, 3] - steep.points
    cosine = np.einsum("nc,nc->n", steep.normals, towards) / np.linalg.norm(towards, axis=1)
    assert cosine.min() > math.cos(math.radians(45.5))
    assert steep.measured < 0.7 * whole.measured
    holed = scanned(scene, beside(0.0), body=True, noise=DepthNoise(holes=0.2))
    assert holed.measured == pytest.approx(0.8 * whole.measured, rel=0.02)


def test_flying_pixels_hang_behind_the_edges() -> None:
    flown = scanned(patch_scene(), ahead(), noise=DepthNoise(flying=0.5), points=SIZE**2).points
    behind = flown[flown[:, 2] < -0.1]
    assert len(behind) > 20
    assert behind[:, 2].min() > -12.1
    edge = np.abs(behind[:, :2] - MIDDLE[:2]).max(axis=1)
    assert edge.min() > 9.5  # of a square of 20 cm


def test_cameras_but_the_first_are_misplaced() -> None:
    exact = scanned(patch_scene(), ahead(), ahead(90.0), points=3000)
    moved = scanned(patch_scene(), ahead(), ahead(90.0), points=3000, noise=DepthNoise(shift=2.0))
    assert np.abs(moved.points[moved.camera == 0, 2]).max() < 1e-3
    heights = moved.points[moved.camera == 1, 2]
    assert np.ptp(heights) < 1e-3
    assert 0.05 < abs(heights.mean()) < 8.0
    assert np.array_equal(exact.extrinsics, moved.extrinsics)


def test_the_same_seed_gives_the_same_bytes() -> None:
    scene = ball_scene(RADIUS)
    cameras = cameras_round(scene, 2, body=True)
    first, again = (scanned(scene, *cameras, noise=KINECT, seed=3, body=True) for _ in range(2))
    assert first.points.tobytes() == again.points.tobytes()
    assert first.panel_id.tobytes() == again.panel_id.tobytes()
    assert scanned(scene, *cameras, noise=KINECT, seed=4, body=True).points.tobytes() != first.points.tobytes()


@pytest.mark.parametrize("points", [10, 5000])
def test_there_are_as_many_points_as_asked(points: int) -> None:
    cloud = scanned(patch_scene(), ahead(), points=points, size=24)
    assert cloud.points.shape == cloud.normals.shape == (points, 3)
    assert len(np.unique(cloud.points, axis=0)) == min(points, cloud.measured)


def test_cameras_stand_evenly_and_see_the_whole_figure() -> None:
    scene = ball_scene(RADIUS)
    cameras = cameras_round(scene, 3, yaw=20.0, body=True)
    corners = np.concatenate([scene.vertices, scene.body.vertices])
    for camera in cameras:
        pixels = camera.project(corners, 100)
        assert ((pixels > 0) & (pixels < 99)).all()
    yaw = [math.degrees(math.atan2(*(camera.eye - sum(scene.bounds()) / 2)[[0, 2]])) % 360 for camera in cameras]
    assert yaw == pytest.approx([20.0, 140.0, 260.0])


def test_impossible_options_are_refused() -> None:
    with pytest.raises(ConfigError, match=r"sigma of depth noise is -1\.0"):
        DepthNoise(sigma=-1.0)
    with pytest.raises(ConfigError, match="holes of depth noise is 2: give a share"):
        DepthNoise(holes=2)
    with pytest.raises(ConfigError, match="0 points by 1 cameras"):
        scanned(patch_scene(), ahead(), points=0)
    with pytest.raises(ConfigError, match="0 views"):
        cameras_round(patch_scene(), 0)
