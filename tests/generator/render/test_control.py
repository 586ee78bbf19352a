"""Control pictures: colours of maps and key points."""

import numpy as np
import pytest

from gcd_dataset.errors import ConfigError
from gcd_dataset.generator.render import COCO_KEYPOINTS, control_picture, pose_picture, render
from gcd_dataset.generator.render.control import CONTROL_MAPS
from tests.generator.render.scenes import ahead, ball_scene, patch_scene, view_of


def test_a_ball_is_bluest_and_brightest_in_the_middle_and_red_on_its_right() -> None:
    scene = ball_scene(20.0)
    [picture] = render([scene], [view_of(scene, camera=ahead(100.0, focal=2.0))], size=64, maps=("normals", "depth"))
    normal, depth = (control_picture(picture.maps, kind).astype(int) for kind in ("normal", "depth"))
    assert np.abs(normal[32, 32] - [128, 128, 255]).max() < 8
    covered = np.flatnonzero(picture.maps["depth"][32])
    assert normal[32, covered[-1], 0] > 220 and normal[32, covered[0], 0] < 36
    rows = np.flatnonzero(picture.maps["depth"][:, 32])
    assert normal[rows[0], 32, 1] > 220  # green upwards
    assert depth[32, 32, 0] > 250
    assert depth[32, covered[0], 0] < 100 and depth[0, 0, 0] == 0


def test_cloth_has_a_grey_hem_the_colour_of_its_panel_and_no_seam() -> None:
    scene = patch_scene()
    maps = [name for names in CONTROL_MAPS.values() for name in names]
    [picture] = render([scene], [view_of(scene, camera=ahead(100.0, focal=4.0))], size=64, maps=maps)
    seams, parts = (control_picture(picture.maps, kind) for kind in ("seams", "parts"))
    assert set(np.unique(seams)) == {0, 128}
    assert parts[32, 32].tolist() == [84, 120, 168]  # the first of the palette
    assert parts[0, 0].tolist() == [0, 0, 0]
    with pytest.raises(ConfigError, match="seams is made from seam: render it with these maps"):
        control_picture({}, "seams")
    with pytest.raises(ConfigError, match="no control picture 'canny': there are normal, depth, seams, parts"):
        control_picture(picture.maps, "canny")  # type: ignore[arg-type]


def test_a_limb_joins_its_joints_and_hidden_eyes_are_left_out() -> None:
    points = np.zeros((17, 3))
    for name, place in {"left_elbow": (10, 40, 2), "left_wrist": (50, 40, 1), "left_eye": (30, 10, 1)}.items():
        points[COCO_KEYPOINTS.index(name)] = place
    picture = pose_picture(points, 64)
    assert picture[40, 30].any()
    assert not picture[:20].any()
    points[COCO_KEYPOINTS.index("left_eye"), 2] = 2
    assert pose_picture(points, 64)[10, 30].any()
