"""The peers of the render benchmark see a ball where it is; its stages add up."""

import sys

import numpy as np
import pytest
import trimesh

from benchmarks.cases.render import embree_maps
from benchmarks.peers.pyrender_egl import pyrender_depths, require_pyrender, vertex_normals
from gcd_dataset.errors import ConfigError
from gcd_dataset.generator.render import look_at


def test_embrees_depth_and_shadow_of_a_ball() -> None:
    ball = trimesh.creation.icosphere(subdivisions=4, radius=20.0)
    camera = look_at(np.array([0.0, 0.0, 200.0]), np.zeros(3), focal=4.0)
    light = np.array([1.0, 0.0, 0.0])
    depth, lit = embree_maps(np.asarray(ball.vertices), np.asarray(ball.faces), camera, light, 65)
    assert depth[32, 32] == pytest.approx(180.0, abs=0.05)
    assert np.isinf(depth[0, 0])
    assert lit[32, 45] and not lit[32, 20]


def test_vertex_normals_of_a_ball_point_outwards() -> None:
    ball = trimesh.creation.icosphere(subdivisions=3, radius=7.0)
    normals = vertex_normals(np.asarray(ball.vertices), np.asarray(ball.faces))
    assert normals == pytest.approx(np.asarray(ball.vertices) / 7.0, abs=0.03)


def test_the_remedy_for_a_missing_pyrender_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pyrender", None)
    monkeypatch.setenv("PYOPENGL_PLATFORM", "egl")
    monkeypatch.setenv("LP_NUM_THREADS", "0")
    with pytest.raises(ConfigError, match="pip install pyrender"):
        require_pyrender()


def test_pyrenders_depth_of_a_ball() -> None:
    pytest.importorskip("pyrender", reason="pyrender is not installed: make an environment of its own")
    ball = trimesh.creation.icosphere(subdivisions=4, radius=20.0)
    vertices, faces = np.asarray(ball.vertices), np.asarray(ball.faces)
    camera = look_at(np.array([0.0, 0.0, 200.0]), np.array([0.0, 10.0, 0.0]), focal=4.0)
    [depth] = pyrender_depths(require_pyrender(), vertices, faces, vertex_normals(vertices, faces), [camera], 65)
    expected, _ = embree_maps(vertices, faces, camera, np.array([1.0, 0.0, 0.0]), 65)
    seen = np.isfinite(expected)
    assert (seen == (depth > 0)).mean() > 0.99
    assert np.median(np.abs(depth - expected)[seen & (depth > 0)]) < 0.2
