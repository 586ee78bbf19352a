"""Profiles of renderings, buffers of staging memory, and pictures that are lent."""

import threading
import time

import numpy as np
import pytest

from gcd_dataset.generator.render import MAPS, draw_views, render, start_pictures
from gcd_dataset.generator.render.profile import Profile
from gcd_dataset.generator.render.staging import LARGE, buffer_size
from tests.generator.render.scenes import ball_scene, patch_scene


def test_a_profile_counts_the_bytes_of_the_pictures() -> None:
    scene = patch_scene()
    views = draw_views(3, 0, scene, 2)
    profile = Profile("cpu")
    start_pictures([scene], views, size=16, maps=("depth", "panel_id"), device="cpu", profile=profile).pictures()
    points = 2 * (len(scene.corner_rows) + len(scene.landmarks))
    assert profile.copied["to host"] == 2 * 16 * 16 * (3 + 4 + 2) + points
    solid_bytes = 12 * (len(scene.vertices) + len(scene.body.vertices)) + 12 * (
        len(scene.faces) + len(scene.body.faces)
    )
    assert profile.copied["to device"] > solid_bytes
    assert profile.device_times() == {}
    assert {"cast", "shade", "truths", "download", "wait"} <= set(profile.host)


def test_a_stage_adds_up_over_threads_and_leaves_out_sleep_from_cpu_time() -> None:
    profile = Profile("cpu")

    def sleep() -> None:
        with profile.stage("sleep"):
            time.sleep(0.02)

    threads = [threading.Thread(target=sleep) for _ in range(3)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert profile.host["sleep"] >= 0.06
    assert profile.cpu["sleep"] < 0.5 * profile.host["sleep"]


def test_a_stage_that_fails_is_not_counted() -> None:
    profile = Profile("cpu")
    with pytest.raises(ValueError, match="broken"), profile.stage("broken"):
        raise ValueError("broken")
    assert not profile.host


def test_lent_pictures_are_the_pictures() -> None:
    scenes = [ball_scene(), patch_scene()]
    views = [view for row, scene in enumerate(scenes) for view in draw_views(5, row, scene, 2, row=row)]
    pending = start_pictures(scenes, views, size=16, maps=MAPS, device="cpu")
    lent = pending.lend()
    for one, other in zip(lent, render(scenes, views, size=16, maps=MAPS, device="cpu"), strict=True):
        assert np.array_equal(one.rgb, other.rgb)
        assert all(np.array_equal(one.maps[name], other.maps[name], equal_nan=True) for name in MAPS)
    pending.release()


def test_several_threads_render_the_same_bytes() -> None:
    scene = ball_scene()
    views = draw_views(5, 0, scene, 2)
    results: dict[int, bytes] = {}

    def work(number: int) -> None:
        pictures = start_pictures([scene], views, size=16, device="cpu").pictures()
        results[number] = b"".join(picture.rgb.tobytes() for picture in pictures)

    threads = [threading.Thread(target=work, args=(number,)) for number in range(3)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len(set(results.values())) == 1 and len(results) == 3


@pytest.mark.parametrize("needed", [0, 1, 2, 3, 1000, LARGE, LARGE + 1, 9 * LARGE // 8, 64 * 512**2 * 12])
def test_buffers_hold_what_they_are_for(needed: int) -> None:
    size = buffer_size(needed)
    assert max(needed, 1) <= size <= max(2 * needed, 1)
    assert needed <= LARGE or size < needed * 1.25
    assert buffer_size(size) == size
