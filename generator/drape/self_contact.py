"""Self-intersections of a body's skin."""

import threading

import numpy as np
import warp as wp
from jaxtyping import Float, Int, UInt8

from gcd_dataset.generator.body.asset import COARSE_PARTS, body_model
from gcd_dataset.generator.device import resolve_device
from gcd_dataset.generator.drape.kernels.crossing import bound_faces, count_self_crossings
from gcd_dataset.generator.drape.kernels.world import ClothArrays
from gcd_dataset.meshedges import mesh_edges
from gcd_dataset.records import Body, BodyPart

_of_model = threading.local()
"""The skin of the body model in ``skin``, of each thread: a hierarchy of boxes serves one search at a time."""


def skin_crossings(body: Body) -> int:
    """Number of edges of trunk, arms and legs that pass through the skin, or through a hand, a foot or the head.

    Edges of heads, hands and feet are excluded: their skin folds into itself in every body of the model.
    """
    if body.posed is not None:
        return _Skin(len(body.vertices), body.faces, body.parts).crossings(body.vertices)
    if not hasattr(_of_model, "skin"):
        _of_model.skin = _Skin(len(body.vertices), body_model().faces, body_model().parts)
    found: int = _of_model.skin.crossings(body.vertices)
    return found


class _Skin:
    """The skin of a body as the only world of the drape's kernels; each search refits its boxes."""

    def __init__(self, vertices: int, faces: Int[np.ndarray, "f 3"], parts: UInt8[np.ndarray, " v"]) -> None:
        folded = np.isin(parts, [part.value for part in COARSE_PARTS])
        self._edges = mesh_edges(faces[~folded[faces].any(axis=1)]).ends
        self._device = resolve_device("cpu")
        kept = faces[~(parts == BodyPart.INTERNAL.value)[faces].any(axis=1)]
        self._cloth = cloth = ClothArrays()
        cloth.vertex_world = wp.zeros(vertices, dtype=int, device=self._device)
        cloth.edges = wp.array(self._edges, dtype=wp.vec2i, device=self._device)
        cloth.faces = wp.array(kept, dtype=wp.vec3i, device=self._device)
        self._bounds = [wp.empty(len(kept), dtype=wp.vec3, device=self._device) for _ in range(2)]
        self._bvh: wp.Bvh | None = None

    def crossings(self, vertices: Float[np.ndarray, "v 3"]) -> int:
        """``skin_crossings`` of the skin at some positions [cm]."""
        x = wp.array(vertices, dtype=wp.vec3, device=self._device)
        self._launch(bound_faces, len(self._bounds[0]), [self._cloth, x], self._bounds)
        if self._bvh is None:
            self._bvh = wp.Bvh(*self._bounds)
        else:
            self._bvh.refit()
        count, roots = wp.zeros(1, dtype=int, device=self._device), wp.full(1, -1, dtype=int, device=self._device)
        asked = wp.ones(1, dtype=int, device=self._device)  # the root -1: the whole tree
        inputs = [self._cloth, self._bvh.id, roots, asked, x]
        self._launch(count_self_crossings, len(self._edges), inputs, [count])
        return int(count.numpy()[0])

    def _launch(self, kernel: wp.Kernel, dim: int, inputs: list, outputs: list) -> None:
        wp.launch(kernel, dim=dim, inputs=inputs, outputs=outputs, device=self._device)
