"""Renders several scenes in one batch: upload, ray casting passes, download; a GPU works asynchronously."""

import itertools
from collections.abc import Sequence
from functools import cache
from typing import TYPE_CHECKING, Literal, TypeAlias

import numpy as np
import warp as wp
from jaxtyping import Float, UInt8

from gcd_dataset.errors import ConfigError
from gcd_dataset.generator.drape import load_kernels, resolve_device
from gcd_dataset.generator.drape.device import launch_lock
from gcd_dataset.generator.lay_plan import PAPER
from gcd_dataset.generator.render import plain_kernels
from gcd_dataset.generator.render.images import linear_light
from gcd_dataset.generator.render.plain_kernels import (
    LEVELS,
    Camera,
    Scenes,
    cast_rays,
    scale_normals,
    shade_pixels,
    sky_visibility,
    sum_normals,
)
from gcd_dataset.generator.render.staging import StagingBuffers, to_device, wrapped

if TYPE_CHECKING:
    from gcd_dataset.generator.render.plain import ColouredMesh

Scene: TypeAlias = Sequence["ColouredMesh"]
View = Literal["front", "back"]
Picture = UInt8[np.ndarray, "h w 3"]

DISTANCE = 520.0  # cm from the camera to the centre of the scene
MARGIN = 1.04  # width of the field of view over the larger side of the scene's bounding box
WRONG_SIDE = 0.55  # brightness of the wrong side of cloth, relative to the right side
SAMPLES = 3  # rays per pixel, along each side
LEAF = 1  # faces in a leaf of the BVH: rays take 20 % less time on an H200 than with Warp's default of 4
KEY_LIGHT, FILL_LIGHT = (-0.45, 0.55, 0.70), (0.8, 0.1, 0.5)  # directions to the lights, in the front camera's view


def start_render(scenes: Sequence[Scene], views: Sequence[View], *, size: int, device: str) -> "PendingRender":
    """Start rendering square pictures of ``size`` pixels, each scene from all ``views``; a GPU works in the background.

    The pictures of a scene do not depend on the other scenes. Raises ``ConfigError`` for a missing device or a size
    below 1.
    """
    if size < 1:
        raise ConfigError(f"a picture of {size} pixels: give a size of 1 or more")
    device = resolve_device(device)
    load_kernels("renderer", plain_kernels, device=device)
    with launch_lock:
        return PendingRender(scenes, views, size, device)


class PendingRender:
    """Pictures that a device is rendering."""

    def __init__(self, scenes: Sequence[Scene], views: Sequence[View], size: int, device: str) -> None:
        self._views, self._staging = len(views), StagingBuffers(device)
        uploaded, _meshes = _upload(scenes, self._staging)
        cameras = [camera for scene in scenes for camera in _cameras(scene, views)]
        pictures = _render(uploaded, wp.array(cameras, dtype=Camera, device=device), len(views), size, device)
        self._pictures = self._staging.array(pictures.shape, np.uint8)
        wp.copy(wrapped(self._pictures, wp.uint8), pictures)
        self._rendered = self._staging.event()

    def ready(self) -> bool:
        """Whether ``pictures`` returns without waiting."""
        with launch_lock:  # CUDA refuses event queries while another thread captures a graph
            return self._rendered is None or self._rendered.is_complete

    def pictures(self) -> list[tuple[Picture, ...]]:
        """Wait for the pictures and return the views of each scene. Call once: this releases the buffers."""
        with launch_lock:
            if self._rendered is not None:
                wp.synchronize_event(self._rendered)
        each = [picture.copy() for picture in self._pictures]
        self._staging.release()
        return [tuple(each[first : first + self._views]) for first in range(0, len(each), self._views)]


# ------------------------------------------------------------------------------------------------------------- helpers


def _upload(scenes: Sequence[Scene], staging: StagingBuffers) -> tuple[Scenes, list[wp.Mesh]]:
    """The scenes on the device, and their Warp meshes, which must outlive the launches."""
    device, meshes = staging.device, [mesh for scene in scenes for mesh in scene]
    first_vertex, first_face, first_colour = (
        np.cumsum([0, *map(len, parts)], dtype=np.int32)
        for parts in zip(*((mesh.vertices, mesh.faces, mesh.colours) for mesh in meshes), strict=True)
    )
    position = staging.array((int(first_vertex[-1]), 3), np.float32)
    corner = staging.array((int(first_face[-1]), 3), np.int32)
    colour_of_face = staging.array((int(first_face[-1]),), np.int32)
    for k, mesh in enumerate(meshes):
        faces = slice(first_face[k], first_face[k + 1])
        position[first_vertex[k] : first_vertex[k + 1]] = mesh.vertices
        np.add(mesh.faces, first_vertex[k], out=corner[faces], casting="same_kind")
        np.add(mesh.colour_of_face, first_colour[k], out=colour_of_face[faces], casting="same_kind")
    linear = linear_light(np.concatenate([mesh.colours for mesh in meshes]))
    uploaded = Scenes()
    uploaded.position = to_device(position, wp.vec3, device)
    uploaded.corner = to_device(corner.reshape(-1), wp.int32, device)
    uploaded.colour_of_face = to_device(colour_of_face, wp.int32, device)
    uploaded.normal = vertex_normals(uploaded.corner, uploaded.position, device)
    uploaded.colour = wp.array(linear, dtype=wp.vec3, device=device)
    uploaded.wrong_side_colour = wp.array(WRONG_SIDE * linear, dtype=wp.vec3, device=device)
    uploaded.background = wp.vec3(*linear_light(np.array(PAPER) / 255))
    # One BVH for each scene: the BVH decides which of two faces a ray through their common edge hits, so a shared BVH
    # would make the picture of a scene depend on the other scenes.
    begin = first_face[np.cumsum([0, *map(len, scenes)])]
    leaf = LEAF if staging.locked else None
    trees = [
        wp.Mesh(points=uploaded.position, indices=uploaded.corner[3 * first : 3 * end], bvh_leaf_size=leaf)
        for first, end in itertools.pairwise(begin.tolist())
    ]
    uploaded.mesh = wp.array([tree.id for tree in trees], dtype=wp.uint64, device=device)
    uploaded.first_face = wp.array(begin[:-1], dtype=int, device=device)
    return uploaded, trees


def _render(scenes: Scenes, cameras: wp.array, views: int, size: int, device: str) -> wp.array:
    """The pictures (shot, h, w, 3) of all cameras: the ``views`` of the first scene, then of the second, and so on."""
    rays = (len(cameras), size, size, SAMPLES**2)
    hit_face, hit_uv = wp.empty(rays, dtype=int, device=device), wp.empty(rays, dtype=wp.vec2, device=device)
    sides = (2, len(scenes.position))
    seen, sky = wp.full(sides, -1, dtype=int, device=device), wp.empty(sides, dtype=float, device=device)
    pictures = wp.empty((*rays[:3], 3), dtype=wp.uint8, device=device)
    inputs = [scenes, cameras, views, SAMPLES]
    wp.launch(cast_rays, rays, inputs=inputs, outputs=[hit_face, hit_uv, seen], device=device)
    wp.launch(sky_visibility, sides, inputs=[scenes, seen], outputs=[sky], device=device)
    inputs = [scenes, cameras, hit_face, hit_uv, sky, thresholds(device)]
    wp.launch(shade_pixels, rays[:3], inputs=inputs, outputs=[pictures], device=device)
    return pictures


def _cameras(scene: Scene, views: Sequence[View]) -> list[Camera]:
    """A camera for each view, aimed at the centre of the scene's bounding box, with the whole scene in the picture."""
    # C-ordered rows: NumPy reduces them 20 times as fast as columns.
    rows = [mesh.vertices.T.astype(float, order="C") for mesh in scene]
    low = np.min([row.min(axis=1) for row in rows], axis=0)
    high = np.max([row.max(axis=1) for row in rows], axis=0)
    # The nearest side of the box needs the widest angle.
    half = MARGIN * 0.5 * float(max(high[0] - low[0], high[1] - low[1]))
    focal = (DISTANCE - 0.5 * float(high[2] - low[2])) / half
    return [_camera(0.5 * (low + high), focal, view) for view in views]


def _camera(middle: Float[np.ndarray, "3"], focal: float, view: View) -> Camera:
    facing = 1.0 if view == "front" else -1.0
    camera = Camera()
    camera.eye = wp.vec3(*(middle + [0.0, 0.0, facing * DISTANCE]))
    camera.right, camera.up = wp.vec3(facing, 0.0, 0.0), wp.vec3(0.0, 1.0, 0.0)
    camera.forward = wp.vec3(0.0, 0.0, -facing)
    camera.focal = focal
    turned = np.array([facing, 1.0, facing])
    camera.key_light = wp.vec3(*(turned * KEY_LIGHT / np.linalg.norm(KEY_LIGHT)))
    camera.fill_light = wp.vec3(*(turned * FILL_LIGHT / np.linalg.norm(FILL_LIGHT)))
    return camera


def vertex_normals(corner: wp.array, points: wp.array, device: str) -> wp.array:
    """Unit vertex normals: face normals weighted by area."""
    total = wp.zeros((len(points), 3), dtype=wp.int64, device=device)
    normals = wp.empty(len(points), dtype=wp.vec3, device=device)
    wp.launch(sum_normals, len(corner) // 3, inputs=[corner, points], outputs=[total], device=device)
    wp.launch(scale_normals, len(points), inputs=[total], outputs=[normals], device=device)
    return normals


@cache
def thresholds(device: str) -> wp.array:
    """The smallest linear value of each sRGB byte from 1 to 255."""
    least = linear_light((np.arange(LEVELS) + 0.5) / LEVELS)
    return wp.array(least.astype(np.float32), dtype=float, device=device)
