"""The field of a body with garments on it, as the garments over these meet it.

The field of the body is lowered to the signed distance from each worn garment. Generalised winding numbers give the
sign: a tube of cloth is solid, so that no outer garment enters a skirt from below.
"""

from dataclasses import replace
from functools import lru_cache

import numpy as np
import warp as wp
from jaxtyping import Float

from gcd_dataset.generator.device import native_builds
from gcd_dataset.generator.drape.body_field import ARMS, BAND, CACHED, BodyField
from gcd_dataset.generator.drape.kernels.field import BLOCK, find_parts, lower_to_cloth, measure_cloth_blocks
from gcd_dataset.generator.dressing.worn import WornCloth
from gcd_dataset.meshedges import mesh_edges


@lru_cache(CACHED)
def dressed(field: BodyField, under: tuple[WornCloth, ...], gap: float) -> BodyField:
    """The field of a body that wears garments, each thicker by ``gap`` [cm]; cached, for a second drape."""
    device = str(field.distance.device)
    grown = _grown(field, np.concatenate([cloth.vertices for cloth in under]))
    worn = []
    for cloth in under:
        points = wp.array(np.asarray(cloth.vertices, np.float32), dtype=wp.vec3, device=device)
        faces = wp.array(cloth.faces.astype(np.int32).ravel(), dtype=int, device=device)
        with native_builds(device):
            mesh = wp.Mesh(points, faces, support_winding_number=True)
        parts = wp.array(cloth.parts, dtype=wp.uint8, device=device)
        inputs = [field.mesh.id, field.face_parts, ARMS, points]
        wp.launch(find_parts, len(points), inputs, [parts], device=device)
        low, shape = wp.vec3(*grown.origin), grown.distance.shape
        blocks = wp.empty([-(-size // int(BLOCK)) for size in shape], dtype=float, device=device)
        inputs = [mesh.id, low, grown.cell]
        wp.launch(measure_cloth_blocks, blocks.shape, inputs, [blocks], device=device)
        inputs = [mesh.id, parts, low, grown.cell, gap, blocks]
        wp.launch(lower_to_cloth, shape, inputs, [grown.distance, grown.part], device=device)
        ends = wp.array(mesh_edges(cloth.faces).ends.astype(np.int32), dtype=wp.vec2i, device=device)
        worn.append((mesh, ends))
    ids = wp.array([mesh.id for mesh, _ in worn], dtype=wp.uint64, device=device)
    return replace(grown, worn=tuple(worn), worn_ids=ids)


def _grown(field: BodyField, points: Float[np.ndarray, "v 3"]) -> BodyField:
    """A copy of a field whose grid covers points too [cm]."""
    low, shape = np.array(field.origin), np.array(field.distance.shape)
    before = np.ceil(np.maximum(low - points.min(axis=0) + BAND + field.cell, 0.0) / field.cell).astype(int)
    high = low + (shape - 1) * field.cell
    after = np.ceil(np.maximum(points.max(axis=0) + BAND + field.cell - high, 0.0) / field.cell).astype(int)
    inside = tuple(slice(first, first + count) for first, count in zip(before.tolist(), shape.tolist(), strict=True))
    device, size = field.distance.device, tuple((before + shape + after).tolist())
    distance = wp.full(size, BAND, dtype=float, device=device)
    part = wp.zeros(size, dtype=wp.uint8, device=device)
    wp.copy(distance[inside], field.distance)
    wp.copy(part[inside], field.part)
    x, y, z = (low - before * field.cell).tolist()
    return replace(field, distance=distance, part=part, origin=(x, y, z))
