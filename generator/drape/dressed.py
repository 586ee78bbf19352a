"""The fields of bodies with garments on them, as the garments over these meet them.

The field of a body is lowered to the signed distance from the worn garments. Generalised winding numbers give the
sign: a tube of cloth is solid, so that no outer garment enters a skirt from below.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import chain
from weakref import WeakKeyDictionary, WeakValueDictionary

import numpy as np
import warp as wp
from jaxtyping import Float

from gcd_dataset.generator.device import native_builds
from gcd_dataset.generator.drape.body_field import ARMS, BAND, BodyField
from gcd_dataset.generator.drape.kernels.field import (
    BLOCK,
    DressedVoxels,
    WornVoxels,
    dress_fields,
    find_parts,
    lower_to_cloth,
    measure_cloth_blocks,
)
from gcd_dataset.generator.dressing.worn import WornCloth
from gcd_dataset.meshedges import mesh_edges

MOST_GAP = 1.0  # cm, the largest gap of ``dressed_fields``
FAR = 1.0e3  # cm, where no distance is needed

Worn = tuple[BodyField, tuple[WornCloth, ...]]

_meshes: WeakKeyDictionary[WornCloth, dict[str, tuple[wp.Mesh, wp.array]]] = WeakKeyDictionary()
_in_use: "WeakValueDictionary[Worn, WornGarments]" = WeakValueDictionary()


@dataclass(frozen=True, eq=False)
class WornGarments:
    """The garments on a body, and the signed distance from the nearest of them."""

    meshes: tuple[tuple[wp.Mesh, wp.array], ...]
    """Each as a mesh and the vertices at the ends of its edges."""
    ids: wp.array
    """The identifiers of the meshes."""
    origin: tuple[float, float, float]
    """Centre of the first voxel [cm]; the grid covers the body's field and the garments."""
    first: tuple[int, int, int]
    """The voxel at the first voxel of the body's field."""
    distance: wp.array
    """See ``WornVoxels``."""
    part: wp.array
    """See ``WornVoxels``."""


def dressed_fields(
    fields: Sequence[BodyField], under: Sequence[tuple[WornCloth, ...]], gaps: Sequence[float]
) -> list[BodyField]:
    """The fields of bodies that wear garments, each thicker by a gap [cm], ``MOST_GAP`` at most.

    Bodies without garments keep their fields. The distances from garments are kept for as long as a field that was
    made of them: a drape needs them for its coarse mesh, and with a smaller gap for the fine one.
    """
    wanted = {(field, worn): None for field, worn in zip(fields, under, strict=True) if worn}
    if not wanted:
        return list(fields)
    device = str(fields[0].distance.device)
    garments = {key: found for key in wanted if (found := _in_use.get(key)) is not None}
    garments |= _measured([key for key in wanted if key not in garments], device)
    _in_use.update(garments)
    made, entries = list(fields), []
    for k, key in enumerate(zip(fields, under, strict=True)):
        if not key[1]:
            continue
        worn, field, entry = garments[key], fields[k], DressedVoxels()
        entry.body, entry.body_part, entry.first = field.distance, field.part, wp.vec3i(*worn.first)
        entry.cloth, entry.cloth_part, entry.gap = worn.distance, worn.part, gaps[k]
        entry.distance, entry.part = wp.empty_like(worn.distance), wp.empty_like(worn.part)
        entries.append(entry)
        made[k] = replace(field, distance=entry.distance, part=entry.part, origin=worn.origin, worn=worn)
    inputs = [wp.array(entries, dtype=DressedVoxels, device=device), BAND]
    wp.launch(dress_fields, (len(entries), max(entry.distance.size for entry in entries)), inputs, device=device)
    return made


def _measured(given: Sequence[Worn], device: str) -> dict[Worn, WornGarments]:
    """The garments of all bodies with few kernel launches, as ``body_fields`` makes fields."""
    _build_meshes(list(dict.fromkeys(chain(*(under for _, under in given)))), device)
    made, layers = {}, []
    for field, under in given:
        low, size, first = _grid(field, np.concatenate([cloth.vertices for cloth in under]))
        distance, part = wp.full(size, FAR, dtype=float, device=device), wp.zeros(size, dtype=wp.uint8, device=device)
        meshes = tuple(_meshes[cloth][device] for cloth in under)
        ids = wp.array([mesh.id for mesh, _ in meshes], dtype=wp.uint64, device=device)
        made[field, under] = worn = WornGarments(meshes, ids, low, first, distance, part)
        layers.append(list(_voxels(field, under, worn, device)))
    for number in range(max(map(len, layers), default=0)):
        layer = [each[number] for each in layers if number < len(each)]
        entries, cell = wp.array(layer, dtype=WornVoxels, device=device), given[0][0].cell
        points, blocks = max(len(entry.parts) for entry in layer), max(entry.blocks.size for entry in layer)
        wp.launch(find_parts, (len(layer), points), [entries, ARMS], device=device)
        wp.launch(measure_cloth_blocks, (len(layer), blocks), [entries, cell], device=device)
        inputs = [entries, cell, BAND, MOST_GAP]
        wp.launch(lower_to_cloth, (len(layer), blocks * int(BLOCK) ** 3), inputs, device=device)
    return made


def _build_meshes(cloths: Sequence[WornCloth], device: str) -> None:
    """Add to ``_meshes`` the garments that it lacks on a device."""
    missing = [cloth for cloth in cloths if device not in _meshes.setdefault(cloth, {})]
    points = [wp.array(np.asarray(cloth.vertices, np.float32), dtype=wp.vec3, device=device) for cloth in missing]
    faces = [wp.array(cloth.faces.astype(np.int32).ravel(), dtype=int, device=device) for cloth in missing]
    ends = [mesh_edges(cloth.faces).ends.astype(np.int32) for cloth in missing]
    with native_builds(device):
        meshes = [wp.Mesh(*each, support_winding_number=True) for each in zip(points, faces, strict=True)]
    for cloth, mesh, own in zip(missing, meshes, ends, strict=True):
        _meshes[cloth][device] = mesh, wp.array(own, dtype=wp.vec2i, device=device)


def _voxels(field: BodyField, under: Sequence[WornCloth], worn: WornGarments, device: str) -> Iterator[WornVoxels]:
    """The kernels' view of each garment on a body."""
    for cloth, (mesh, _) in zip(under, worn.meshes, strict=True):
        entry = WornVoxels()
        entry.skin, entry.face_parts, entry.body = field.mesh.id, field.face_parts, field.distance
        entry.mesh, entry.points, entry.first = mesh.id, mesh.points, wp.vec3i(*worn.first)
        entry.parts = wp.array(cloth.parts, dtype=wp.uint8, device=device)
        entry.low, entry.distance, entry.part = wp.vec3(*worn.origin), worn.distance, worn.part
        blocks = [-(-size // int(BLOCK)) for size in worn.distance.shape]
        entry.blocks = wp.empty(blocks, dtype=float, device=device)
        yield entry


def _grid(
    field: BodyField, points: Float[np.ndarray, "v 3"]
) -> tuple[tuple[float, float, float], tuple[int, int, int], tuple[int, int, int]]:
    """A grid that covers a field and points [cm]: its origin and size, and the voxel at the field's first voxel."""
    low, shape = np.array(field.origin), np.array(field.distance.shape)
    before = np.ceil(np.maximum(low - points.min(axis=0) + BAND + field.cell, 0.0) / field.cell).astype(int)
    high = low + (shape - 1) * field.cell
    after = np.ceil(np.maximum(points.max(axis=0) + BAND + field.cell - high, 0.0) / field.cell).astype(int)
    x, y, z = (low - before * field.cell).tolist()
    columns, rows, layers = (before + shape + after).tolist()
    i, j, k = before.tolist()
    return (x, y, z), (columns, rows, layers), (i, j, k)
