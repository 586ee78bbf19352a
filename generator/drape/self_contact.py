"""Self-intersections of a body's skin."""

import functools

import numpy as np
import warp as wp
from jaxtyping import Int, UInt8

from gcd_dataset.generator.body.asset import COARSE_PARTS, body_model
from gcd_dataset.generator.device import resolve_device
from gcd_dataset.generator.drape.kernels.crossing import count_self_crossings
from gcd_dataset.generator.drape.kernels.world import ClothArrays
from gcd_dataset.meshedges import mesh_edges
from gcd_dataset.records import Body, BodyPart


def skin_crossings(body: Body) -> int:
    """Number of edges of trunk, arms and legs that pass through the skin, or through a hand, a foot or the head.

    Edges of heads, hands and feet are excluded: their skin folds into itself in every body of the model.
    """
    faces, edges = _model_skin() if body.posed is None else _skin(body.faces, body.parts)
    corners = body.vertices[faces].astype(np.float32)
    device = resolve_device("cpu")

    def vectors(points: np.ndarray) -> wp.array:
        return wp.array(points, dtype=wp.vec3, device=device)

    # The drape's kernel, for one world. Keep a reference to the BVH: its id does not keep it alive.
    bvh = wp.Bvh(vectors(corners.min(axis=1)), vectors(corners.max(axis=1)))
    cloth = ClothArrays()
    cloth.vertex_world = _zeros(len(body.vertices), device)
    cloth.edges = wp.array(edges, dtype=wp.vec2i, device=device)
    cloth.faces = wp.array(faces, dtype=wp.vec3i, device=device)
    count, roots = _zeros(1, device), wp.full(1, -1, dtype=int, device=device)  # -1: the whole tree
    asked = wp.ones(1, dtype=int, device=device)
    inputs = [cloth, bvh.id, roots, asked, vectors(body.vertices)]
    wp.launch(count_self_crossings, dim=len(edges), inputs=inputs, outputs=[count], device=device)
    return int(count.numpy()[0])


def _zeros(count: int, device: str) -> wp.array:
    return wp.zeros(count, dtype=int, device=device)


@functools.cache
def _model_skin() -> tuple[Int[np.ndarray, "f 3"], Int[np.ndarray, "e 2"]]:
    return _skin(body_model().faces, body_model().parts)


def _skin(
    faces: Int[np.ndarray, "g 3"], parts: UInt8[np.ndarray, " v"]
) -> tuple[Int[np.ndarray, "f 3"], Int[np.ndarray, "e 2"]]:
    folded = np.isin(parts, [part.value for part in COARSE_PARTS])
    edges = mesh_edges(faces[~folded[faces].any(axis=1)]).ends
    return faces[~(parts == BodyPart.INTERNAL.value)[faces].any(axis=1)], edges
