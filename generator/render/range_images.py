"""Range images: face, place on it and depth at the centre of each pixel, without colours and light.

Scans are made of them. Conventions are those of ``pictures``.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Self

import numpy as np
import warp as wp
from jaxtyping import Bool, Float, Float32, Int, Int32

from gcd_dataset.errors import ConfigError
from gcd_dataset.generator.drape import load_kernels, resolve_device
from gcd_dataset.generator.drape.device import launch_lock, to_host
from gcd_dataset.generator.render.cameras import Camera
from gcd_dataset.generator.render.kernels import ranging
from gcd_dataset.generator.render.scene import Scene
from gcd_dataset.records import Record


@dataclass(frozen=True, eq=False)
class RangeImage(Record):
    """The surface that one camera sees; pixels of the background hold face -1 and depth 0."""

    scene: Scene
    vertex_normals: Float[np.ndarray, "n 3"]
    """Unit normals of the vertices of garment and body."""
    camera: Camera
    face: Int32[np.ndarray, "h w"]
    """Faces of the garment, then those of the body."""
    weights: Float32[np.ndarray, "h w 2"]
    """Barycentric weights of the first two corners."""
    depth: Float32[np.ndarray, "h w"]
    """Along the optical axis [cm]."""

    @property
    def size(self) -> int:
        return len(self.face)

    @property
    def covered(self) -> Bool[np.ndarray, "h w"]:
        """Pixels of any surface."""
        return self.face >= 0

    @property
    def garment(self) -> Bool[np.ndarray, "h w"]:
        """Pixels of cloth."""
        return (self.face >= 0) & (self.face < len(self.scene.faces))

    @property
    def panel(self) -> Int[np.ndarray, "h w"]:
        """Panel of each pixel; -1 where there is no cloth."""
        own = self.garment
        return np.where(own, self.scene.panel_id[np.where(own, self.face, 0)], -1)

    @cached_property
    def normals(self) -> Float32[np.ndarray, "h w 3"]:
        """Unit normals towards the camera, in world axes, interpolated over the faces; 0 on the background."""
        normals = np.zeros((*self.face.shape, 3), np.float32)
        seen = self.covered
        corner = self.vertex_normals[_faces(self.scene)[self.face[seen]]]
        own = np.einsum("nk,nkc->nc", _three(self.weights[seen]), corner)
        own /= np.maximum(np.linalg.norm(own, axis=1, keepdims=True), 1e-12)
        facing = np.einsum("nc,nc->n", own, self.positions()[seen] - self.camera.eye)
        normals[seen] = np.where(facing[:, None] > 0, -own, own)
        return normals

    def positions(self, depth: Float[np.ndarray, "h w"] | None = None) -> Float[np.ndarray, "h w 3"]:
        """Points in the world [cm] at the depths of the pixels, or at other depths."""
        K = self.camera.intrinsics(self.size)
        z = self.depth.astype(float) if depth is None else depth
        column, row = np.meshgrid(np.arange(z.shape[1]), np.arange(z.shape[0]))
        seen = np.stack([(column - K[0, 2]) / K[0, 0] * z, (row - K[1, 2]) / K[1, 1] * z, z], axis=-1)
        return seen @ self.camera.rotation + self.camera.eye


class Ranger:
    """A scene on a device, for range images of it; a context manager, which frees the scene's memory there.

    Raises ``ConfigError`` for a garment with NaN positions.
    """

    def __init__(self, scene: Scene, *, device: str = "auto") -> None:
        self.scene, self.device = scene, resolve_device(device)
        load_kernels("scanner", ranging, device=self.device)
        vertices, faces = np.concatenate([scene.vertices, scene.body.vertices]), _faces(scene)
        if not np.isfinite(vertices).all():
            raise ConfigError("a garment with NaN positions, of a diverged drape: select samples by their outcome")
        self._normals = _mesh_normals(vertices, faces)
        with launch_lock:
            points = wp.array(vertices.astype(np.float32), dtype=wp.vec3, device=self.device)
            corners = wp.array(faces.astype(np.int32).ravel(), dtype=int, device=self.device)
            self._mesh = wp.Mesh(points=points, indices=corners)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        with launch_lock:  # freeing memory would break the capture of a graph in another thread
            del self._mesh

    def images(self, cameras: Sequence[Camera], size: int) -> list[RangeImage]:
        """A range image of ``size`` × ``size`` pixels for each camera."""
        if size < 1:
            raise ConfigError(f"a range image of {size} pixels: give a size of 1 or more")
        shape = (len(cameras), size, size)
        with launch_lock:
            face = wp.full(shape, -1, dtype=int, device=self.device)
            weights = wp.zeros(shape, dtype=wp.vec2, device=self.device)
            depth = wp.zeros(shape, dtype=float, device=self.device)
            inputs = [
                self._mesh.id,
                self._array([camera.eye for camera in cameras], wp.vec3),
                self._array([camera.rotation for camera in cameras], wp.mat33),
                self._array([camera.intrinsics(size) for camera in cameras], wp.mat33),
            ]
            wp.launch(ranging.first_surface, shape, inputs=inputs, outputs=[face, weights, depth], device=self.device)
            arrays = zip(cameras, to_host(face), to_host(weights), to_host(depth), strict=True)
            return [RangeImage(self.scene, self._normals, *entry) for entry in arrays]

    def lit(self, lamp: Float[np.ndarray, "3"], points: Float[np.ndarray, "n 3"]) -> Bool[np.ndarray, " n"]:
        """Whether light of a lamp [cm] reaches each point [cm]."""
        with launch_lock:
            lit = wp.zeros(len(points), dtype=wp.uint8, device=self.device)
            inputs = [self._mesh.id, wp.vec3(*map(float, lamp)), self._array(points, wp.vec3)]
            wp.launch(ranging.lit_points, len(points), inputs=inputs, outputs=[lit], device=self.device)
            return to_host(lit) == 1

    def _array(self, values: object, dtype: type) -> wp.array:
        return wp.array(np.asarray(values, np.float32), dtype=dtype, device=self.device)


# ------------------------------------------------------------------------------------------------------------- helpers


def _faces(scene: Scene) -> Int[np.ndarray, "m 3"]:
    return np.concatenate([scene.faces, scene.body.faces + len(scene.vertices)])


def _three(weights: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, "n 3"]:
    return np.column_stack([weights, 1.0 - weights.sum(axis=1)])


def _mesh_normals(vertices: Float[np.ndarray, "n 3"], faces: Int[np.ndarray, "m 3"]) -> Float[np.ndarray, "n 3"]:
    """Unit vertex normals: face normals weighted by area."""
    a, b, c = vertices.astype(float)[faces].transpose(1, 0, 2)
    normal = np.repeat(np.cross(b - a, c - a), 3, axis=0)
    corner = faces.ravel()
    total = np.stack([np.bincount(corner, normal[:, k], minlength=len(vertices)) for k in range(3)], axis=1)
    return total / np.maximum(np.linalg.norm(total, axis=1, keepdims=True), 1e-12)
