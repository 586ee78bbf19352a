"""Buffers of staging memory, pictures that are lent, and renderings of several threads."""

import threading

import numpy as np
import pytest

from gcd_dataset.generator.render import MAPS, draw_views, render, start_pictures
from gcd_dataset.generator.render.uploading import LARGE, buffer_size
from tests.generator.render.scenes import ball_scene, patch_scene


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
