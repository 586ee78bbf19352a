"""Host memory for asynchronous copies, and scenes on the device: meshes, borders of the panels, masks of the bodies."""

import math
import threading
from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Any, ClassVar

import numpy as np
import warp as wp
from jaxtyping import Shaped

from gcd_dataset.generator.render.geometry import Solid
from gcd_dataset.generator.render.kernels.prepare import border_distances, scale_normals, sum_normals
from gcd_dataset.generator.render.kernels.records import Scenes
from gcd_dataset.generator.render.scene import Scene


class StagingBuffers:
    """Host memory for asynchronous copies to and from a device.

    Page-locked for a GPU; locking takes milliseconds, so released buffers go to a pool.
    """

    _free: ClassVar[defaultdict[int, list[wp.array]]] = defaultdict(list)
    _pool: ClassVar[threading.Lock] = threading.Lock()

    def __init__(self, device: str) -> None:
        self.device = device
        self.locked = wp.get_device(device).is_cuda
        self._in_use: list[wp.array] = []

    def array(self, shape: tuple[int, ...], kind: type | np.dtype) -> Shaped[np.ndarray, "*shape"]:
        """An uninitialised array, valid until ``release``."""
        needed = math.prod(shape) * np.dtype(kind).itemsize
        size = buffer_size(needed)
        if not self.locked:
            return np.empty(shape, kind)
        with self._pool:
            buffer = self._free[size].pop() if self._free[size] else None
        if buffer is None:
            buffer = wp.empty(size, dtype=wp.uint8, device="cpu", pinned=True)
        self._in_use.append(buffer)
        array: np.ndarray = buffer.numpy()[:needed].view(kind).reshape(shape)
        return array

    def event(self) -> wp.Event | None:
        """An event after the work launched so far; ``None`` for the CPU, which does not work in the background."""
        # Not wp.record_event: it takes the stream of the default device, the first GPU.
        return wp.get_stream(self.device).record_event() if self.locked else None

    def release(self) -> None:
        """Return all arrays to the pool."""
        with self._pool:
            for buffer in self._in_use:
                self._free[buffer.size].append(buffer)
        self._in_use = []


LARGE = 1 << 26  # bytes


def buffer_size(needed: int) -> int:
    """The size of the buffer for ``needed`` bytes: few sizes, so that most requests find a free buffer.

    A power of two, as meshes differ from batch to batch; above ``LARGE``, an eighth of one: pictures do not differ.
    """
    step = 1 << max(needed - 1, 0).bit_length()
    if step > LARGE:
        step >>= 3
    return -(-max(needed, 1) // step) * step


def staged_values(staging: StagingBuffers, values: Any, kind: type | np.dtype) -> Shaped[np.ndarray, "..."]:
    """A copy of ``values`` in staging memory."""
    given = np.asarray(values)
    array = staging.array(given.shape, kind)
    array[...] = given
    return array


def wrapped(values: np.ndarray, dtype: type) -> wp.array:
    """A Warp array on the host that shares the memory of ``values``."""
    return wp.array(values, dtype=dtype, device="cpu", copy=False)


def to_device(values: np.ndarray, dtype: type, device: str) -> wp.array:
    """A copy of a staging array on the device; the copy runs asynchronously."""
    source = wrapped(values, dtype)
    copy = wp.empty_like(source, device=device)
    wp.copy(copy, source)
    return copy


LEAF = 1  # faces in a leaf of the BVH on a GPU: rays take 20 % less time on an H200 than with Warp's default of 4
TREE = "lbvh"  # of a GPU: built there, and Warp's default; named, since pictures depend on it


@dataclass(frozen=True, eq=False)
class StagedScenes:
    """Scenes in staging memory, ready to be copied."""

    staging: StagingBuffers
    first_vertex: list[int]
    """Row of each scene's first vertex, and the number of all."""
    first_face: list[int]
    """Row of each scene's first face, and the number of all."""
    fields: dict[str, tuple[np.ndarray, Any]] = field(default_factory=dict)
    """Fields of ``Scenes`` with their Warp types."""
    others: dict[str, tuple[np.ndarray, Any]] = field(default_factory=dict)
    """Arrays with their Warp types: ``middle`` and the inputs of ``border_distances``."""

    def add(self, name: str, values: Any, kind: type, dtype: Any) -> None:
        """Add a field of ``Scenes`` with one row for each scene."""
        self.fields[name] = staged_values(self.staging, values, kind), dtype


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


def stage(scenes: Sequence[Scene], solids: Sequence[Solid], staging: StagingBuffers) -> StagedScenes:
    """Join the scenes in staging memory; needs no device."""
    starts = [solid.starts for solid in solids]
    first_vertex = _starts([start[-1] for start in starts])
    first_face = _starts([sum(len(faces) for _, faces in solid.parts) for solid in solids])
    staged = StagedScenes(staging, first_vertex.tolist(), first_face.tolist())
    vertices = [vertices for solid in solids for vertices, _ in solid.parts]
    faces = [faces for solid in solids for _, faces in solid.parts]
    shifts = [begin + shift for start, begin in zip(starts, first_vertex, strict=False) for shift in start[:-1]]
    staged.fields["position"] = _joined(staging, vertices, np.float32, 3), wp.vec3
    staged.fields["corner"] = _joined(staging, faces, np.int32, 3, shifts).reshape(-1), wp.int32
    staged.add("first_face", first_face[:-1], np.int32, wp.int32)
    staged.add("garment_end", [s.garment_faces for s in solids], np.int32, wp.int32)
    staged.add("body_end", [s.garment_faces + s.body_faces for s in solids], np.int32, wp.int32)
    staged.add("hair_end", [s.garment_faces + s.body_faces + s.hair_faces for s in solids], np.int32, wp.int32)
    eyes = [[[*centre, s.eyes.radius] for centre in s.eyes.centres] for s in solids]
    staged.add("eye", np.array(eyes, float).reshape(-1, 4), np.float32, wp.vec4)
    body_at = first_vertex[:-1] + [s.garment_vertices for s in solids]
    staged.add("first_body_vertex", body_at, np.int32, wp.int32)
    middle = np.array([0.5 * (low + high) * [1.0, 0.0, 1.0] for low, high in (scene.bounds() for scene in scenes)])
    staged.others["middle"] = staged_values(staging, middle, np.float32), wp.vec3
    _stage_cloth(staged, scenes, solids)
    _stage_bodies(staged, scenes, solids)
    return staged


def upload(staged: StagedScenes) -> Uploaded:
    """Copy the scenes to the device, in few large copies; a GPU works asynchronously."""
    device, up = staged.staging.device, Scenes()
    for name, (values, dtype) in staged.fields.items():
        setattr(up, name, to_device(values, dtype, device))
    others = {name: to_device(values, dtype, device) for name, (values, dtype) in staged.others.items()}
    points, rows = len(up.position), len(up.uv)
    total, up.normal = wp.zeros((points, 3), dtype=wp.int64, device=device), wp.empty(points, wp.vec3, device=device)
    wp.launch(sum_normals, len(up.corner) // 3, inputs=[up.corner, up.position], outputs=[total], device=device)
    wp.launch(scale_normals, points, inputs=[total], outputs=[up.normal], device=device)
    up.border, up.seam = wp.empty(rows, dtype=wp.vec4, device=device), wp.empty(rows, dtype=int, device=device)
    inputs = [others["segments"], others["panel_of_row"], up.uv, others["ends"], others["seam"], others["along"]]
    wp.launch(border_distances, rows, inputs=inputs, outputs=[up.border, up.seam], device=device)
    # One BVH for each scene: the BVH decides which of two faces a ray through their common edge hits, so a shared BVH
    # would make the picture of a scene depend on the other scenes.
    leaf, tree = (LEAF, TREE) if staged.staging.locked else (None, None)
    meshes = [
        wp.Mesh(up.position, up.corner[3 * begin : 3 * end], bvh_leaf_size=leaf, bvh_constructor=tree)
        for begin, end in pairwise(staged.first_face)
    ]
    up.mesh = wp.array([mesh.id for mesh in meshes], dtype=wp.uint64, device=device)
    return Uploaded(up, others["middle"], meshes, staged.first_vertex)


# ------------------------------------------------------------------------------------------------------------- helpers


def _stage_cloth(staged: StagedScenes, scenes: Sequence[Scene], solids: Sequence[Solid]) -> None:
    staging, fields, others = staged.staging, staged.fields, staged.others
    first_row = _starts([len(scene.uv) for scene in scenes])
    first_panel = _starts([len(scene.panel_names) for scene in scenes])
    borders = [solid.borders for solid in solids]
    first_segment = _starts([len(border.ends) for border in borders])
    staged.add("first_cloth_face", _starts([len(scene.faces) for scene in scenes])[:-1], np.int32, wp.int32)
    corners = _joined(staging, [scene.corners for scene in scenes], np.int32, 3, first_row)
    fields["uv_corner"] = corners.reshape(-1), wp.int32
    staged.add("lowest", [float(scene.vertices[:, 1].min(initial=1e6)) for scene in scenes], np.float32, wp.float32)
    fields["panel"] = _joined(staging, [scene.panel_id for scene in scenes], np.int32), wp.int32
    fields["edge_flags"] = _joined(staging, [border.flags for border in borders], np.int32), wp.int32
    fields["uv"] = _joined(staging, [scene.uv for scene in scenes], np.float32, 2), wp.vec2
    panel_of_row = _joined(staging, [scene.panel_of_row for scene in scenes], np.int32, 0, first_panel)
    firsts = [border.first[:-1] + begin for border, begin in zip(borders, first_segment[:-1], strict=True)]
    segments = np.append(np.concatenate(firsts), first_segment[-1])
    others["segments"] = staged_values(staging, segments, np.int32), wp.int32
    others["panel_of_row"] = panel_of_row, wp.int32
    others["ends"] = _joined(staging, [border.ends for border in borders], np.int32, 2, first_row), wp.vec2i
    others["seam"] = _joined(staging, [border.seam for border in borders], np.int32), wp.int32
    others["along"] = _joined(staging, [border.along for border in borders], np.float32), wp.float32


def _stage_bodies(staged: StagedScenes, scenes: Sequence[Scene], solids: Sequence[Solid]) -> None:
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
    staged.add("first_mask", begins, np.int32, wp.int32)
    staged.fields["mask"] = _joined(staged.staging, masks, np.float32, 4), wp.vec4
    staged.fields["part"] = _joined(staged.staging, parts, np.uint8), wp.uint8


def _joined(
    staging: StagingBuffers,
    arrays: Sequence[np.ndarray],
    kind: type,
    width: int = 0,
    shifts: Sequence[int] | np.ndarray | None = None,
) -> np.ndarray:
    """The rows of all arrays one after the other, with a shift added to each array's."""
    begins = _starts([len(array) for array in arrays])
    shape = (int(begins[-1]), width) if width else (int(begins[-1]),)
    joined = staging.array(shape, kind)
    for k, array in enumerate(arrays):
        rows = joined[begins[k] : begins[k + 1]]
        rows[...] = array
        if shifts is not None:
            rows += kind(shifts[k])
    return joined


def _starts(counts: Sequence[int]) -> np.ndarray:
    return np.cumsum([0, *counts], dtype=np.int64)
