"""Prepared scenes on the device: meshes with a BVH each, borders of the panels, masks of the bodies."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import warp as wp

from gcd_dataset.generator.render.geometry import Solid
from gcd_dataset.generator.render.kernels.prepare import border_distances
from gcd_dataset.generator.render.kernels.records import Scenes
from gcd_dataset.generator.render.plain_batch import vertex_normals
from gcd_dataset.generator.render.scene import Scene
from gcd_dataset.generator.render.staging import StagingBuffers, to_device

__all__ = ["Uploaded", "upload"]

LEAF = 1  # faces in a leaf of the BVH on a GPU, as in the plain renderer
TREE = "lbvh"  # built by the GPU; Warp's default is built by a CPU core, 3.1 ms for 95,000 faces


@dataclass(frozen=True, eq=False)
class Uploaded:
    """Scenes on a device."""

    scenes: Scenes
    middle: wp.array
    """Where each figure stands on the floor [cm]."""
    meshes: list[wp.Mesh]
    """Must outlive the launches."""
    first_vertex: list[int]
    """Row of each scene's first vertex, and the number of all."""


def upload(scenes: Sequence[Scene], solids: Sequence[Solid], staging: StagingBuffers) -> Uploaded:
    """Copy scenes to the device, in few large copies; a GPU works asynchronously."""
    device, up = staging.device, Scenes()
    first_vertex = _starts([len(s.position) for s in solids])
    first_face = _starts([len(s.faces) for s in solids])
    up.position = to_device(_joined(staging, [s.position for s in solids], np.float32, 3), wp.vec3, device)
    corners = _joined(staging, [s.faces for s in solids], np.int32, 3, first_vertex)
    up.corner = to_device(corners.reshape(-1), wp.int32, device)
    up.normal = vertex_normals(up.corner, up.position, device)
    up.first_face = _ints(first_face[:-1], device)
    up.garment_end = _ints([s.garment_faces for s in solids], device)
    up.body_end = _ints([s.garment_faces + s.body_faces for s in solids], device)
    up.hair_end = _ints([s.garment_faces + s.body_faces + s.hair_faces for s in solids], device)
    eyes = [[*s.eyes.centres[0], s.eyes.radius, *s.eyes.centres[1], s.eyes.radius] for s in solids]
    up.eye = wp.array(np.array(eyes, np.float32).reshape(-1, 4), dtype=wp.vec4, device=device)
    body_at = first_vertex[:-1] + [s.garment_vertices for s in solids]
    up.first_body_vertex = _ints(body_at, device)
    _upload_cloth(up, scenes, solids, staging)
    _upload_bodies(up, scenes, solids, staging)
    # One BVH for each scene: the BVH decides which of two faces a ray through their common edge hits, so a shared BVH
    # would make the picture of a scene depend on the other scenes.
    leaf, tree = (LEAF, TREE) if staging.locked else (None, None)
    meshes = [
        wp.Mesh(points=up.position, indices=up.corner[3 * begin : 3 * end], bvh_leaf_size=leaf, bvh_constructor=tree)
        for begin, end in pairwise(first_face.tolist())
    ]
    up.mesh = wp.array([mesh.id for mesh in meshes], dtype=wp.uint64, device=device)
    middle = wp.array(np.array([_stand(scene) for scene in scenes], np.float32), dtype=wp.vec3, device=device)
    return Uploaded(up, middle, meshes, first_vertex.tolist())


# ------------------------------------------------------------------------------------------------------------- helpers


def _upload_cloth(up: Scenes, scenes: Sequence[Scene], solids: Sequence[Solid], staging: StagingBuffers) -> None:
    device = staging.device
    first_row = _starts([len(scene.uv) for scene in scenes])
    first_panel = _starts([len(scene.panel_names) for scene in scenes])
    borders = [solid.borders for solid in solids]
    first_segment = _starts([len(border.ends) for border in borders])
    up.first_cloth_face = _ints(_starts([len(scene.faces) for scene in scenes])[:-1], device)
    corners = _joined(staging, [scene.corners for scene in scenes], np.int32, 3, first_row)
    up.uv_corner = to_device(corners.reshape(-1), wp.int32, device)
    lowest = [float(scene.vertices[:, 1].min(initial=1e6)) for scene in scenes]
    up.lowest = wp.array(np.array(lowest, np.float32), dtype=float, device=device)
    up.panel = to_device(_joined(staging, [scene.panel_id for scene in scenes], np.int32), wp.int32, device)
    up.edge_flags = to_device(_joined(staging, [border.flags for border in borders], np.int32), wp.int32, device)
    up.uv = to_device(_joined(staging, [scene.uv for scene in scenes], np.float32, 2), wp.vec2, device)
    panel_of_row = _joined(staging, [solid.panel_of_row for solid in solids], np.int32, 0, first_panel)
    ends = _joined(staging, [border.ends for border in borders], np.int32, 2, first_row)
    seam = _joined(staging, [border.seam for border in borders], np.int32)
    along = _joined(staging, [border.along for border in borders], np.float32)
    firsts = [border.first[:-1] + begin for border, begin in zip(borders, first_segment[:-1], strict=True)]
    segments = np.append(np.concatenate(firsts), first_segment[-1])
    rows = len(up.uv)
    up.border, up.seam = wp.empty(rows, dtype=wp.vec4, device=device), wp.empty(rows, dtype=int, device=device)
    inputs = [
        _ints(segments, device),
        to_device(panel_of_row, wp.int32, device),
        up.uv,
        to_device(ends, wp.vec2i, device),
        to_device(seam, wp.int32, device),
        to_device(along, wp.float32, device),
    ]
    wp.launch(border_distances, rows, inputs=inputs, outputs=[up.border, up.seam], device=device)


def _upload_bodies(up: Scenes, scenes: Sequence[Scene], solids: Sequence[Solid], staging: StagingBuffers) -> None:
    device = staging.device
    first: dict[int, int] = {}
    kept: list[Solid] = []
    parts: list[np.ndarray] = []
    count = 0
    begins = []
    # Bodies of one model share their masks.
    for scene, solid in zip(scenes, solids, strict=True):
        if id(solid.masks) not in first:
            first[id(solid.masks)] = count
            count += len(scene.body.parts)
            kept.append(solid)
            parts.append(scene.body.parts)
        begins.append(first[id(solid.masks)])
    masks = [np.stack([m.masks.briefs, m.masks.top, m.masks.brows, m.masks.lips], axis=1) for m in kept]
    up.first_mask = _ints(begins, device)
    up.mask = to_device(_joined(staging, masks, np.float32, 4), wp.vec4, device)
    up.part = to_device(_joined(staging, parts, np.uint8), wp.uint8, device)


def _joined(
    staging: StagingBuffers, arrays: Sequence[np.ndarray], kind: type, width: int = 0, shifts: np.ndarray | None = None
) -> np.ndarray:
    """The rows of all arrays one after the other, with a shift added to each array's."""
    begins = _starts([len(array) for array in arrays])
    shape = (int(begins[-1]), width) if width else (int(begins[-1]),)
    joined = staging.array(shape, kind)
    for k, array in enumerate(arrays):
        rows = joined[begins[k] : begins[k + 1]]
        if shifts is None:
            rows[...] = array
        else:
            np.add(array, shifts[k], out=rows, casting="unsafe")
    return joined


def _starts(counts: Sequence[int]) -> np.ndarray:
    return np.cumsum([0, *counts], dtype=np.int64)


def _ints(values: np.ndarray | Sequence[int], device: str) -> wp.array:
    return wp.array(np.asarray(values, np.int32), dtype=wp.int32, device=device)


def _stand(scene: Scene) -> tuple[float, float, float]:
    low, high = scene.bounds()
    return 0.5 * float(low[0] + high[0]), 0.0, 0.5 * float(low[2] + high[2])
