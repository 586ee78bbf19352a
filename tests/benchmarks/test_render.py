"""The comparison caster of the render benchmark finds depth and shadow of a ball."""

import numpy as np
import pytest
import trimesh

from benchmarks.cases.render import embree_maps
from gcd_dataset.generator.render import look_at


def test_embrees_depth_and_shadow_of_a_ball() -> None:
    ball = trimesh.creation.icosphere(subdivisions=4, radius=20.0)
    camera = look_at(np.array([0.0, 0.0, 200.0]), np.zeros(3), focal=4.0)
    light = np.array([1.0, 0.0, 0.0])
    depth, lit = embree_maps(np.asarray(ball.vertices), np.asarray(ball.faces), camera, light, 65)
    assert depth[32, 32] == pytest.approx(180.0, abs=0.05)
    assert np.isinf(depth[0, 0])
    assert lit[32, 45] and not lit[32, 20]
