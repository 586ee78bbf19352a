"""Pictures of several scenes at a time: their way to the device, the passes over them, and their way back."""

import itertools
import math
from collections import defaultdict
from collections.abc import Sequence
from functools import cache
from typing import TYPE_CHECKING, ClassVar, Literal, TypeAlias

import numpy as np
import warp as wp
from jaxtyping import Float, Shaped, UInt8

from gcd_dataset.errors import ConfigError
from gcd_dataset.generator import render_kernels
from gcd_dataset.generator.colours import PAPER
from gcd_dataset.generator.drape import load_kernels, resolve_device
from gcd_dataset.generator.drape.device import launch_lock
from gcd_dataset.generator.render_kernels import (
    LEVELS,
    Camera,
    Scenes,
    cast_rays,
    develop,
    look_up,
    scale_normals,
    sum_normals,
)

if TYPE_CHECKING:
    from gcd_dataset.generator.render import Painted

__all__ = ["DISTANCE", "MARGIN", "Exposure", "Picture", "Scene", "View", "expose"]

Scene: TypeAlias = Sequence["Painted"]
View = Literal["front", "back"]
Picture = UInt8[np.ndarray, "h w 3"]

DISTANCE = 520.0  # cm from the camera to the middle of the body
MARGIN = 1.04  # picture over what must be seen
WRONG_SIDE = 0.55  # brightness of the inside of the cloth
SAMPLES = 3  # rays per pixel, along each side
LEAF = 1  # faces in a leaf of the tree: on an H200 rays take a fifth less time than with Warp's 4
KEY_LIGHT, FILL_LIGHT = (-0.45, 0.55, 0.70), (0.8, 0.1, 0.5)  # seen from the camera


def expose(scenes: Sequence[Scene], views: Sequence[View], *, size: int, device: str) -> "Exposure":
    """Begin square pictures of ``size`` pixels of several scenes, each from all ``views``; a GPU takes them meanwhile.

    The pictures of a scene do not depend on the others. Raises ``ConfigError`` for a device that is not there, or
    pictures without pixels.
    """
    if size < 1:
        raise ConfigError(f"a picture of {size} pixels: give 1 or more")
    device = resolve_device(device)
    load_kernels("renderer", render_kernels, device=device)
    with launch_lock:
        return Exposure(scenes, views, size, device)


class Exposure:
    """Pictures that a device is taking."""

    def __init__(self, scenes: Sequence[Scene], views: Sequence[View], size: int, device: str) -> None:
        self._views, self._loan = len(views), _Loan(device)
        world, _meshes = _send(scenes, self._loan)
        cameras = [camera for scene in scenes for camera in _cameras(scene, views)]
        pictures = _take(world, wp.array(cameras, dtype=Camera, device=device), len(views), size, device)
        self._pictures = self._loan.array(pictures.shape, np.uint8)
        wp.copy(_wrapped(self._pictures, wp.uint8), pictures)
        self._taken = wp.record_event(wp.Event(device)) if pictures.device.is_cuda else None

    def ready(self) -> bool:
        """Whether ``pictures`` returns at once."""
        with launch_lock:  # an event cannot be asked for while another thread records
            return self._taken is None or self._taken.is_complete

    def pictures(self) -> list[tuple[Picture, ...]]:
        """The views of each scene, once they are taken. To be called once."""
        with launch_lock:
            if self._taken is not None:
                wp.synchronize_event(self._taken)
        each = [picture.copy() for picture in self._pictures]
        self._loan.end()
        return [tuple(each[first : first + self._views]) for first in range(0, len(each), self._views)]


# ------------------------------------------------------------------------------------------------------------- helpers


class _Loan:
    """Memory of the host from which a device reads, and into which it writes, while the host goes on.

    For a GPU it is page-locked; locking takes milliseconds, so the same memory is lent again and again.
    """

    _free: ClassVar[defaultdict[int, list[wp.array]]] = defaultdict(list)

    def __init__(self, device: str) -> None:
        self.device = device
        self.locked = wp.get_device(device).is_cuda
        self._lent: list[wp.array] = []

    def array(self, shape: tuple[int, ...], kind: type) -> Shaped[np.ndarray, "*shape"]:
        """An array to be written, by either side, before ``end``."""
        used = math.prod(shape) * np.dtype(kind).itemsize
        size = 1 << max(used - 1, 0).bit_length()  # few sizes, so that most find one that is free
        free = self._free[size] if self.locked else None
        buffer = free.pop() if free else wp.empty(size, dtype=wp.uint8, device="cpu", pinned=self.locked)
        self._lent.append(buffer)
        lent: np.ndarray = buffer.numpy()[:used].view(kind).reshape(shape)
        return lent

    def end(self) -> None:
        """Give all arrays back."""
        for buffer in self._lent if self.locked else ():
            self._free[buffer.size].append(buffer)
        self._lent = []


def _wrapped(values: np.ndarray, dtype: type) -> wp.array:
    return wp.array(values, dtype=dtype, device="cpu", copy=False)


def _sent(values: np.ndarray, dtype: type, device: str) -> wp.array:
    """What was written into an array on loan, on its way to the device."""
    here = _wrapped(values, dtype)
    there = wp.empty_like(here, device=device)
    wp.copy(there, here)
    return there


def _send(scenes: Sequence[Scene], loan: _Loan) -> tuple[Scenes, list[wp.Mesh]]:
    """The scenes on the device, and their meshes, which must outlive the launches."""
    device, things = loan.device, [thing for scene in scenes for thing in scene]
    first_vertex, first_face, first_colour = (
        np.cumsum([0, *map(len, parts)], dtype=np.int32)
        for parts in zip(*((thing.vertices, thing.faces, thing.colours) for thing in things), strict=True)
    )
    position = loan.array((int(first_vertex[-1]), 3), np.float32)
    corner, paint = loan.array((int(first_face[-1]), 3), np.int32), loan.array((int(first_face[-1]),), np.int32)
    for k, thing in enumerate(things):
        faces = slice(first_face[k], first_face[k + 1])
        position[first_vertex[k] : first_vertex[k + 1]] = thing.vertices
        np.add(thing.faces, first_vertex[k], out=corner[faces], casting="same_kind")
        np.add(thing.paint, first_colour[k], out=paint[faces], casting="same_kind")
    linear = _linear(np.concatenate([thing.colours for thing in things]))
    sent = Scenes()
    sent.position = _sent(position, wp.vec3, device)
    sent.corner = _sent(corner.reshape(-1), wp.int32, device)
    sent.paint = _sent(paint, wp.int32, device)
    sent.normal = _vertex_normals(sent.corner, sent.position, device)
    sent.colour = wp.array(linear, dtype=wp.vec3, device=device)
    sent.inside = wp.array(WRONG_SIDE * linear, dtype=wp.vec3, device=device)
    sent.background = wp.vec3(*_linear(np.array(PAPER) / 255))
    # A tree of its own for each scene: the tree decides which of two faces a ray through their common edge meets.
    begin = first_face[np.cumsum([0, *map(len, scenes)])]
    leaf = LEAF if loan.locked else None
    meshes = [
        wp.Mesh(points=sent.position, indices=sent.corner[3 * first : 3 * end], bvh_leaf_size=leaf)
        for first, end in itertools.pairwise(begin.tolist())
    ]
    sent.mesh = wp.array([mesh.id for mesh in meshes], dtype=wp.uint64, device=device)
    sent.first_face = wp.array(begin[:-1], dtype=int, device=device)
    return sent, meshes


def _take(scenes: Scenes, cameras: wp.array, views: int, size: int, device: str) -> wp.array:
    """(shot, h, w, 3) what the cameras see: ``views`` of the first scene, then of the next."""
    rays = (len(cameras), size, size, SAMPLES**2)
    hit_face, hit_place = wp.empty(rays, dtype=int, device=device), wp.empty(rays, dtype=wp.vec2, device=device)
    sides = (2, len(scenes.position))
    seen, sky = wp.full(sides, -1, dtype=int, device=device), wp.empty(sides, dtype=float, device=device)
    pictures = wp.empty((*rays[:3], 3), dtype=wp.uint8, device=device)
    inputs = [scenes, cameras, views, SAMPLES]
    wp.launch(cast_rays, rays, inputs=inputs, outputs=[hit_face, hit_place, seen], device=device)
    wp.launch(look_up, sides, inputs=[scenes, seen], outputs=[sky], device=device)
    inputs = [scenes, cameras, hit_face, hit_place, sky, _thresholds(device)]
    wp.launch(develop, rays[:3], inputs=inputs, outputs=[pictures], device=device)
    return pictures


def _cameras(scene: Scene, views: Sequence[View]) -> list[Camera]:
    """In front of the middle, or behind it, with everything in the picture."""
    # NumPy finds the least of a row twenty times as fast as of a column.
    rows = [thing.vertices.T.astype(float, order="C") for thing in scene]
    low = np.min([row.min(axis=1) for row in rows], axis=0)
    high = np.max([row.max(axis=1) for row in rows], axis=0)
    # What stands nearest to the camera decides how wide the picture must be.
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


def _vertex_normals(corner: wp.array, points: wp.array, device: str) -> wp.array:
    """Unit normals at vertices: of their faces, weighted by area."""
    total = wp.zeros((len(points), 3), dtype=wp.int64, device=device)
    normals = wp.empty(len(points), dtype=wp.vec3, device=device)
    wp.launch(sum_normals, len(corner) // 3, inputs=[corner, points], outputs=[total], device=device)
    wp.launch(scale_normals, len(points), inputs=[total], outputs=[normals], device=device)
    return normals


@cache
def _thresholds(device: str) -> wp.array:
    """The least linear value of each sRGB byte from 1 on."""
    least = _linear((np.arange(LEVELS) + 0.5) / LEVELS)
    return wp.array(least.astype(np.float32), dtype=float, device=device)


def _linear(srgb: np.ndarray) -> np.ndarray:
    """IEC 61966-2-1."""
    return np.where(srgb <= 0.04045, srgb / 12.92, ((srgb + 0.055) / 1.055) ** 2.4)
