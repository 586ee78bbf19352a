"""Pictures of garments on their bodies by ray casting, without display or GL."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from typing import Literal

import numpy as np
import warp as wp
from jaxtyping import Float, Int, UInt8

from gcd_dataset.errors import ConfigError
from gcd_dataset.generator import render_kernels
from gcd_dataset.generator.colours import PALETTE, PAPER
from gcd_dataset.generator.drape import load_kernels, resolve_device
from gcd_dataset.generator.drape.device import one_at_a_time
from gcd_dataset.generator.drawing import jpeg_bytes
from gcd_dataset.generator.render_kernels import (
    LEVELS,
    Camera,
    Scene,
    cast_rays,
    develop,
    encode,
    look_up,
    scale_normals,
    sum_normals,
)
from gcd_dataset.records import Body, BoxMesh, Sample

__all__ = [
    "Painted",
    "painted_garment",
    "render_garment",
    "render_sample",
    "render_view",
]

View = Literal["front", "back"]

DISTANCE = 520.0  # cm from the camera to the middle of the body
MARGIN = 1.04  # picture over what must be seen
SKIN = (0.80, 0.76, 0.72)
WRONG_SIDE = 0.55  # brightness of the inside of the cloth
SAMPLES = 3  # rays per pixel, along each side
KEY_LIGHT, FILL_LIGHT = (-0.45, 0.55, 0.70), (0.8, 0.1, 0.5)  # seen from the camera


@dataclass(frozen=True)
class Painted:
    """Triangles with colours: all that a picture shows."""

    vertices: Float[np.ndarray, "v 3"]
    """[cm]"""
    faces: Int[np.ndarray, "f 3"]
    """Counter-clockwise on the right side."""
    paint: Int[np.ndarray, " f"]
    """Row of ``colours`` of each face."""
    colours: Float[np.ndarray, "n 3"]
    """sRGB, 0 to 1."""


def painted_garment(vertices: Float[np.ndarray, "v 3"], mesh: BoxMesh, body: Body) -> Painted:
    """A garment at ``vertices`` [cm] on its body, the panels in different colours."""
    return Painted(
        vertices=np.concatenate([body.vertices, vertices]),
        faces=np.concatenate([body.faces, mesh.faces + len(body.vertices)]),
        paint=np.concatenate([np.zeros(len(body.faces), int), 1 + mesh.panel_id % len(PALETTE)]),
        colours=np.array([SKIN, *PALETTE]),
    )


def render_view(
    shown: Painted, *, size: int = 512, view: View = "front", device: str = "auto"
) -> UInt8[np.ndarray, "h w 3"]:
    """A square picture of ``size`` pixels, framed alike from the front and from behind; the same on every run.

    Raises ``ConfigError`` for a device that is not there, or a picture without pixels.
    """
    (picture,) = _render(shown, [view], size, device)
    return picture


def render_garment(
    vertices: Float[np.ndarray, "v 3"], mesh: BoxMesh, body: Body, *, size: int = 512, device: str = "auto"
) -> tuple[UInt8[np.ndarray, "h w 3"], UInt8[np.ndarray, "h w 3"]]:
    """Front and back of a garment at ``vertices`` [cm] on its body."""
    front, back = _render(painted_garment(vertices, mesh, body), ["front", "back"], size, device)
    return front, back


def render_sample(sample: Sample, body: Body, *, size: int = 512, device: str = "auto") -> tuple[bytes, bytes]:
    """JPEGs of a draped sample on its body, front and back. Raises ``ConfigError`` for a sample without a drape."""
    if sample.box_mesh is None or sample.drape is None:
        raise ConfigError(f"{sample.key} is not draped: there is nothing to render")
    front, back = render_garment(sample.drape.vertices, sample.box_mesh, body, size=size, device=device)
    return jpeg_bytes(front), jpeg_bytes(back)


# ------------------------------------------------------------------------------------------------------------- helpers


def _render(shown: Painted, views: Sequence[View], size: int, device: str) -> list[UInt8[np.ndarray, "h w 3"]]:
    """Pictures of one scene from several sides."""
    if size < 1:
        raise ConfigError(f"a picture of {size} pixels: give 1 or more")
    device = resolve_device(device)
    load_kernels("renderer", render_kernels, device=device)
    with one_at_a_time:
        scene, _mesh = _scene(shown, device)
        return [_picture(scene, _camera(shown.vertices, view), len(shown.vertices), size, device) for view in views]


def _picture(scene: Scene, camera: Camera, n: int, size: int, device: str) -> UInt8[np.ndarray, "h w 3"]:
    """What the camera sees of a scene of ``n`` vertices."""
    rays = (size * SAMPLES, size * SAMPLES)
    hit_face, hit_place = wp.empty(rays, dtype=int, device=device), wp.empty(rays, dtype=wp.vec2, device=device)
    seen, sky = wp.zeros((2, n), dtype=int, device=device), wp.zeros((2, n), dtype=float, device=device)
    picture = wp.empty((size, size), dtype=wp.vec3, device=device)
    wp.launch(cast_rays, rays, inputs=[scene, camera], outputs=[hit_face, hit_place, seen], device=device)
    wp.launch(look_up, (2, n), inputs=[scene, seen], outputs=[sky], device=device)
    inputs = [scene, camera, hit_face, hit_place, sky, SAMPLES]
    wp.launch(develop, (size, size), inputs=inputs, outputs=[picture], device=device)
    coded = wp.empty((size, size, 3), dtype=wp.uint8, device=device)
    wp.launch(encode, (size, size), inputs=[picture, _thresholds(device)], outputs=[coded], device=device)
    return coded.numpy()


def _camera(points: Float[np.ndarray, "v 3"], view: View) -> Camera:
    """In front of the middle, or behind it, with everything in the picture."""
    low, high = points.min(axis=0), points.max(axis=0)
    middle = 0.5 * (low + high)
    facing = 1.0 if view == "front" else -1.0
    # What stands nearest to the camera decides how wide the picture must be.
    half = MARGIN * 0.5 * float(max(high[0] - low[0], high[1] - low[1]))
    camera = Camera()
    camera.eye = wp.vec3(*(middle + [0.0, 0.0, facing * DISTANCE]))
    camera.right, camera.up = wp.vec3(facing, 0.0, 0.0), wp.vec3(0.0, 1.0, 0.0)
    camera.forward = wp.vec3(0.0, 0.0, -facing)
    camera.focal = (DISTANCE - 0.5 * float(high[2] - low[2])) / half
    turned = np.array([facing, 1.0, facing])
    camera.key_light = wp.vec3(*(turned * KEY_LIGHT / np.linalg.norm(KEY_LIGHT)))
    camera.fill_light = wp.vec3(*(turned * FILL_LIGHT / np.linalg.norm(FILL_LIGHT)))
    return camera


def _scene(shown: Painted, device: str) -> tuple[Scene, wp.Mesh]:
    """The scene on a device, and the mesh that must outlive it."""
    points = wp.array(np.asarray(shown.vertices, np.float32), dtype=wp.vec3, device=device)
    faces = np.ascontiguousarray(shown.faces, np.int32)
    mesh = wp.Mesh(points=points, indices=wp.array(faces.ravel(), dtype=int, device=device))
    linear = _linear(shown.colours)
    scene = Scene()
    scene.mesh = mesh.id
    scene.face = wp.array(faces, dtype=wp.vec3i, device=device)
    scene.position = points
    scene.normal = _vertex_normals(scene.face, points, device)
    scene.paint = wp.array(np.asarray(shown.paint, np.int32), dtype=int, device=device)
    scene.colour = wp.array(linear, dtype=wp.vec3, device=device)
    scene.inside = wp.array(WRONG_SIDE * linear, dtype=wp.vec3, device=device)
    scene.background = wp.vec3(*_linear(np.array(PAPER) / 255))
    return scene, mesh


def _vertex_normals(faces: wp.array, points: wp.array, device: str) -> wp.array:
    """Unit normals at vertices: of their faces, weighted by area."""
    total = wp.zeros((len(points), 3), dtype=wp.int64, device=device)
    normals = wp.empty(len(points), dtype=wp.vec3, device=device)
    wp.launch(sum_normals, len(faces), inputs=[faces, points], outputs=[total], device=device)
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
