"""Host memory for asynchronous copies, and scenes on the device: meshes, borders of the panels, masks of the bodies."""

import math
import weakref
from collections import defaultdict
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import accumulate, pairwise
from typing import Any, ClassVar

import numpy as np
import warp as wp
from jaxtyping import Shaped

from gcd_dataset.generator.render.figure import body_masks
from gcd_dataset.generator.render.geometry import panel_borders, solid_of
from gcd_dataset.generator.render.kernels.prepare import border_distances, scale_normals, sum_normals
from gcd_dataset.generator.render.kernels.records import ClothRow, Scenes, Shot
from gcd_dataset.generator.render.packing import CLOTH, SHOT
from gcd_dataset.generator.render.scene import Scene


class StagingBuffers:
    """Host memory for asynchronous copies to and from a device.

    Page-locked for a GPU; locking takes milliseconds, so released buffers go to a pool.
    """

    _free: ClassVar[defaultdict[int, list[wp.array]]] = defaultdict(list)

    def __init__(self, device: str) -> None:
        self.device = device
        self.locked = wp.get_device(device).is_cuda
        self._in_use: list[tuple[wp.array, wp.array]] = []
        """Each buffer, and the owner of the arrays on it."""

    def array(self, shape: tuple[int, ...], kind: type | np.dtype) -> Shaped[np.ndarray, "*shape"]:
        """An uninitialised array; its memory is reused after ``release`` and the end of the last view of it."""
        needed = math.prod(shape) * np.dtype(kind).itemsize
        size = buffer_size(needed)
        if not self.locked:
            return np.empty(shape, kind)
        try:
            buffer = self._free[size].pop()
        except IndexError:
            buffer = wp.empty(size, dtype=wp.uint8, device="cpu", pinned=True)
        owner = wp.array(ptr=buffer.ptr, dtype=wp.uint8, shape=size, device="cpu")
        self._in_use.append((buffer, owner))
        array: np.ndarray = owner.numpy()[:needed].view(kind).reshape(shape)
        return array

    def event(self) -> wp.Event | None:
        """An event after the work launched so far; ``None`` for the CPU, which does not work in the background."""
        # Not wp.record_event: it takes the stream of the default device, the first GPU.
        return wp.get_stream(self.device).record_event() if self.locked else None

    def release(self) -> None:
        """Return each buffer to the pool once the last view of its array ends. Call it when the device uses none."""
        for buffer, owner in self._in_use:
            weakref.finalize(owner, self._free[buffer.size].append, buffer)
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


def wrapped(values: np.ndarray, dtype: type) -> wp.array:
    """A Warp array on the host that shares the memory of ``values``."""
    return wp.array(values, dtype=dtype, device="cpu", copy=False)


LEAF = 1  # faces in a leaf of the BVH on a GPU: rays take 20 % less time on an H200 than with Warp's default of 4
TREE = "lbvh"  # of a GPU: built there, and Warp's default; named, since pictures depend on it
ALIGNMENT = 256  # bytes, as of separate allocations on a GPU
NUMBERS: dict[Any, Any] = {
    wp.uint8: np.uint8,
    wp.int32: np.int32,
    wp.vec2i: np.int32,
    **dict.fromkeys((wp.float32, wp.vec2, wp.vec3, wp.vec4), np.float32),
    ClothRow: CLOTH,
    Shot: SHOT,
}
"""NumPy's type of the numbers in an array of each Warp type."""


class Block:
    """Arrays for the kernels, one after the other in one piece of memory, which is copied to a device at once."""

    def __init__(self, staging: StagingBuffers) -> None:
        self._staging = staging
        self._added: dict[str, _Part] = {}
        self._size = 0
        self._host: wp.array
        self._device: wp.array

    def add(self, name: str, dtype: Any, *arrays: Any, shifts: Sequence[int] | None = None) -> None:
        """Add an array of a Warp type: the rows of ``arrays`` one after the other, plus the shift of each."""
        given = [np.asarray(array) for array in arrays]
        size = sum(array.size for array in given) * np.dtype(NUMBERS[dtype]).itemsize
        self._added[name] = _Part(dtype, given, shifts or [0] * len(given), self._size, size)
        self._size += -(-size // ALIGNMENT) * ALIGNMENT

    def fill(self) -> None:
        """Write all arrays to staging memory; needs no device."""
        memory = self._staging.array((self._size,), np.uint8)
        for part in self._added.values():
            numbers = memory[part.begin : part.begin + part.size].view(NUMBERS[part.dtype])
            for array, shift in zip(part.arrays, part.shifts, strict=False):
                rows, numbers = numbers[: array.size].reshape(array.shape), numbers[array.size :]
                rows[...] = array
                if shift:
                    rows += shift
        self._host = wrapped(memory, wp.uint8)

    def upload(self) -> dict[str, wp.array]:
        """The arrays on the device, valid as long as this block; the copy runs asynchronously."""
        memory = self._device = wp.clone(self._host, device=self._staging.device)
        return {
            name: wp.array(
                ptr=memory.ptr + part.begin,
                dtype=part.dtype,
                shape=part.size // wp.types.type_size_in_bytes(part.dtype),
                device=memory.device,
            )
            for name, part in self._added.items()
        }


@dataclass(frozen=True, eq=False, slots=True)
class _Part:
    """An array of a block."""

    dtype: Any
    arrays: Sequence[np.ndarray]
    shifts: Sequence[int]
    begin: int
    """First byte."""
    size: int
    """[bytes]"""


@dataclass(frozen=True, eq=False)
class Uploaded:
    """Scenes on a device."""

    scenes: Scenes
    meshes: list[wp.Mesh]
    """Must outlive the launches."""
    first_vertex: list[int]
    """Row of each scene's first vertex, and the number of all."""


def add_scenes(block: Block, scenes: Sequence[Scene], *, rgb_only: bool) -> tuple[list[int], list[int]]:
    """Add the joined scenes to a block; with ``rgb_only`` what the kernel of plain pictures reads.

    Returns the row of each scene's first vertex, and the number of all; the same of the faces.
    """
    solids = [solid_of(scene) for scene in scenes]
    starts = [solid.starts for solid in solids]
    first_vertex = _starts(start[-1] for start in starts)
    first_face = _starts(sum(len(faces) for _, faces in solid.parts) for solid in solids)
    shifts = [begin + shift for start, begin in zip(starts, first_vertex, strict=False) for shift in start[:-1]]
    block.add("position", wp.vec3, *(vertices for solid in solids for vertices, _ in solid.parts))
    block.add("corner", wp.int32, *(faces for solid in solids for _, faces in solid.parts), shifts=shifts)
    block.add("first_face", wp.int32, first_face[:-1])
    block.add("garment_end", wp.int32, [s.garment_faces for s in solids])
    block.add("body_end", wp.int32, [s.garment_faces + s.body_faces for s in solids])
    block.add("hair_end", wp.int32, [s.garment_faces + s.body_faces + s.hair_faces for s in solids])
    block.add("first_cloth_face", wp.int32, _starts(len(scene.faces) for scene in scenes)[:-1])
    block.add("panel", wp.int32, *(scene.panel_id for scene in scenes))
    if not rgb_only:
        eyes = [[*centre, s.eyes.radius] for s in solids for centre in s.eyes.centres]
        block.add("eye", wp.vec4, eyes)
        block.add("first_body_vertex", wp.int32, np.add(first_vertex[:-1], [s.garment_vertices for s in solids]))
        boxes = [scene.bounds() for scene in scenes]
        block.add("middle", wp.vec3, [0.5 * (low + high) * [1.0, 0.0, 1.0] for low, high in boxes])
        _add_cloth(block, scenes)
        _add_bodies(block, scenes)
    return first_vertex, first_face


def upload(arrays: dict[str, wp.array], first_vertex: list[int], first_face: list[int], device: str) -> Uploaded:
    """Scenes whose arrays are on the device, with normals, borders and meshes; a GPU works asynchronously."""
    up = Scenes()
    for name in arrays.keys() & Scenes.vars.keys():  # type: ignore[attr-defined]
        setattr(up, name, arrays[name])
    points = first_vertex[-1]
    total, up.normal = wp.zeros((points, 3), dtype=wp.int64, device=device), wp.empty(points, wp.vec3, device=device)
    wp.launch(sum_normals, len(up.corner) // 3, inputs=[up.corner, up.position], outputs=[total], device=device)
    wp.launch(scale_normals, points, inputs=[total], outputs=[up.normal], device=device)
    if "uv" in arrays:
        rows = len(up.uv)
        up.border, up.seam = wp.empty(rows, dtype=wp.vec4, device=device), wp.empty(rows, dtype=int, device=device)
        inputs = [arrays[name] for name in ("segments", "panel_of_row", "uv", "ends", "segment_seam", "along")]
        wp.launch(border_distances, rows, inputs=inputs, outputs=[up.border, up.seam], device=device)
    # One BVH for each scene: the BVH decides which of two faces a ray through their common edge hits, so a shared BVH
    # would make the picture of a scene depend on the other scenes.
    leaf, tree = (LEAF, TREE) if wp.get_device(device).is_cuda else (None, None)
    meshes = [
        wp.Mesh(up.position, up.corner[3 * begin : 3 * end], bvh_leaf_size=leaf, bvh_constructor=tree)
        for begin, end in pairwise(first_face)
    ]
    up.mesh = wp.array([mesh.id for mesh in meshes], dtype=wp.uint64, device=device)
    return Uploaded(up, meshes, first_vertex)


def _add_cloth(block: Block, scenes: Sequence[Scene]) -> None:
    borders = [panel_borders(scene) for scene in scenes]
    first_row = _starts(len(scene.uv) for scene in scenes)
    first_panel = _starts(len(scene.panel_names) for scene in scenes)
    first_segment = _starts(len(border.ends) for border in borders)
    block.add("uv_corner", wp.int32, *(scene.corners for scene in scenes), shifts=first_row)
    block.add("lowest", wp.float32, [float(scene.vertices[:, 1].min(initial=1e6)) for scene in scenes])
    block.add("edge_flags", wp.int32, *(border.flags for border in borders))
    block.add("uv", wp.vec2, *(scene.uv for scene in scenes))
    firsts = [border.first[:-1] for border in borders]
    block.add("segments", wp.int32, *firsts, [0], shifts=first_segment)
    block.add("panel_of_row", wp.int32, *(scene.panel_of_row for scene in scenes), shifts=first_panel)
    block.add("ends", wp.vec2i, *(border.ends for border in borders), shifts=first_row)
    block.add("segment_seam", wp.int32, *(border.seam for border in borders))
    block.add("along", wp.float32, *(border.along for border in borders))


def _add_bodies(block: Block, scenes: Sequence[Scene]) -> None:
    # Bodies of one model share their masks.
    masks = [body_masks(scene.body) for scene in scenes]
    kept = {id(mask): (mask, scene.body.parts) for mask, scene in zip(masks, scenes, strict=True)}
    first = dict(zip(kept, _starts(len(parts) for _, parts in kept.values()), strict=False))
    block.add("first_mask", wp.int32, [first[id(mask)] for mask in masks])
    block.add("mask", wp.vec4, *(np.stack([m.briefs, m.top, m.brows, m.lips], axis=1) for m, _ in kept.values()))
    block.add("part", wp.uint8, *(parts for _, parts in kept.values()))


def _starts(counts: Iterable[int]) -> list[int]:
    """The row of each group's first entry, and the number of all."""
    return list(accumulate(counts, initial=0))
