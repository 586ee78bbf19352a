"""The same scenes rasterised by pyrender (MIT) through EGL: one light without shadows, one colour, colour and depth.

Triangles, cameras and sizes are those of the case ``render``. The peer has less to do: no prints, shadows, ambient
occlusion and places, one sample a pixel, two maps. A garment's mesh is new to OpenGL, as it is to the ray caster; its
vertex normals are given. On a machine without a GPU, Mesa rasterises on the CPU (llvmpipe), here on one core.
pyrender's pictures are multisampled: its depth and silhouette are of a sample beside the pixel's centre.
"""

import os
import time
from collections.abc import Sequence
from dataclasses import dataclass
from importlib import import_module
from typing import Any

import numpy as np
from jaxtyping import Float

from benchmarks.cases.figures import Figure
from gcd_dataset.errors import ConfigError
from gcd_dataset.generator.render import Camera, Picture, Scene, View, render
from gcd_dataset.generator.render.geometry import solid_of

NEAR, FAR = 10.0, 5000.0  # cm
GREY = (0.7, 0.7, 0.7, 1.0)


@dataclass(frozen=True)
class Peer:
    """pyrender with an OpenGL context."""

    package: Any
    driver: str
    """OpenGL's name of the renderer."""


def require_pyrender() -> Peer:
    """pyrender on EGL. Raises ``ConfigError`` if it is not installed, or EGL is not there."""
    os.environ["PYOPENGL_PLATFORM"] = "egl"
    os.environ.setdefault("LP_NUM_THREADS", "0")  # llvmpipe on the calling thread: one core, as ours
    try:
        pyrender = import_module("pyrender")
    except ImportError as error:
        raise ConfigError(f"--peer pyrender: {error}: pip install pyrender") from error
    try:
        renderer = pyrender.OffscreenRenderer(16, 16)
        renderer._platform.make_current()
        gl = import_module("OpenGL.GL")
        driver = bytes(gl.glGetString(gl.GL_RENDERER)).decode()
        renderer.delete()
    except Exception as error:  # PyOpenGL and pyrender raise errors of many kinds
        raise ConfigError(
            f"--peer pyrender: no OpenGL context through EGL ({error}): install libegl1 and, without a GPU's driver, "
            "libegl-mesa0"
        ) from error
    return Peer(pyrender, driver)


def compare_with_pyrender(
    scenes: Sequence[Scene], views: Sequence[Sequence[View]], *, size: int, device: str
) -> list[Figure]:
    """Pictures per second of both, and their agreement, on one view of each scene after the first.

    ``peer_silhouette``: share of pixels that both find covered or both empty, in the worst picture; ``peer_depth``:
    share of the pixels that both cover whose depths differ by less than 0.5 cm. The rates are of all ``views``.
    """
    peer = require_pyrender()
    # On a CPU, time of the core: other processes do not count.
    clock = time.process_time if device == "cpu" and "llvmpipe" in peer.driver else time.perf_counter
    own, theirs, seconds = list[Picture](), list[np.ndarray](), [0.0, 0.0]
    count = 0
    for number, (scene, some) in enumerate(zip(scenes, views, strict=True)):
        begun = clock()
        placed = [View(0, v.appearance, v.camera, v.lights, v.environment, v.seed) for v in some]
        pictures = render([scene], placed, size=size, maps=("depth", "silhouette"), device=device)
        between = clock()
        solid = solid_of(scene)
        normals = vertex_normals(solid.position, solid.faces)
        meshed = clock()
        depths = pyrender_depths(peer, solid.position, solid.faces, normals, [view.camera for view in some], size)
        if number:  # the first compiles kernels and shaders
            seconds[0] += between - begun
            seconds[1] += clock() - meshed
            count += len(some)
        own.append(pictures[0])
        theirs.append(depths[0])
    covered = [picture.maps["silhouette"] > 0 for picture in own]
    same = [float((mask == (depth > 0)).mean()) for mask, depth in zip(covered, theirs, strict=True)]
    near = [
        float((np.abs(picture.maps["depth"] - depth) < 0.5)[mask & (depth > 0)].mean())
        for picture, mask, depth in zip(own, covered, theirs, strict=True)
    ]
    rates = [count / elapsed for elapsed in seconds]
    return [
        Figure(f"peer_images_per_s_{size}", rates[1], f"by pyrender on {peer.driver}"),
        Figure(f"peer_own_images_per_s_{size}", rates[0], f"by ours on {device}, one garment at a time"),
        Figure(f"peer_ratio_{size}", rates[0] / rates[1], "ours over pyrender"),
        Figure(f"peer_silhouette_{size}", min(same), "of pixels, worst picture"),
        Figure(f"peer_depth_{size}", min(near), "within 0.5 cm, worst picture"),
    ]


def pyrender_depths(
    peer: Peer,
    vertices: Float[np.ndarray, "v 3"],
    faces: np.ndarray,
    normals: Float[np.ndarray, "v 3"],
    cameras: Sequence[Camera],
    size: int,
) -> list[Float[np.ndarray, "h w"]]:
    """The depth along the optical axis [cm], 0 on the background, that is drawn together with the colours."""
    pyrender = peer.package
    material = pyrender.MetallicRoughnessMaterial(baseColorFactor=GREY, doubleSided=True)
    primitive = pyrender.Primitive(
        positions=vertices.astype(np.float32),
        normals=normals.astype(np.float32),
        indices=faces.astype(np.uint32),
        material=material,
    )
    scene = pyrender.Scene(ambient_light=(0.3, 0.3, 0.3))
    scene.add(pyrender.Mesh([primitive]))
    light = scene.add(pyrender.DirectionalLight(intensity=3.0))
    renderer = _renderer(peer, size)
    depths = []
    for camera in cameras:
        K, pose = camera.intrinsics(size), np.eye(4)
        pose[:3, :3], pose[:3, 3] = camera.rotation.T * [1.0, -1.0, -1.0], camera.eye
        # OpenGL's pixel centres lie at halves.
        lens = pyrender.IntrinsicsCamera(K[0, 0], K[1, 1], K[0, 2] + 0.5, K[1, 2] + 0.5, NEAR, FAR)
        node = scene.add(lens, pose=pose)
        scene.set_pose(light, pose)
        depths.append(renderer.render(scene)[1])
        scene.remove_node(node)
    return depths


def vertex_normals(vertices: Float[np.ndarray, "v 3"], faces: np.ndarray) -> Float[np.ndarray, "v 3"]:
    """Unit vertex normals: face normals weighted by area."""
    a, b, c = vertices[faces].transpose(1, 0, 2)
    normal = np.cross(b - a, c - a)
    total = np.zeros_like(vertices)
    for axis in range(3):
        total[:, axis] = np.bincount(faces.ravel(), np.repeat(normal[:, axis], 3), minlength=len(vertices))
    return total / np.maximum(np.linalg.norm(total, axis=1, keepdims=True), 1e-12)


# ------------------------------------------------------------------------------------------------------------- helpers


def _renderer(peer: Peer, size: int) -> Any:
    if size not in _renderers:
        _renderers[size] = peer.package.OffscreenRenderer(size, size)
    return _renderers[size]


_renderers: dict[int, Any] = {}  # an OpenGL context for each size
