"""From coarse to fine: start the drape of a garment's fine mesh from the drape of its coarse mesh."""

from collections.abc import Sequence

import numpy as np
import warp as wp

from gcd_dataset.generator.drape.device import to_host
from gcd_dataset.generator.drape.kernels.refine import refine
from gcd_dataset.generator.drape.kernels.world import DIVERGED
from gcd_dataset.generator.drape.solver import Solver
from gcd_dataset.generator.mesh.coarse import CoarseMesh

MIN_FRAMES = 4  # frames of the fine mesh before it may count as at rest


def start_from_coarse(coarse: Solver, fine: Solver, worlds: Sequence[tuple[int, int, CoarseMesh]]) -> None:
    """Start garments of ``fine`` from the end of their coarse drapes.

    ``worlds``: world index in ``coarse``, world index in ``fine``, and the coarse mesh that interpolates between them.
    A garment whose coarse drape diverged starts from its placed panels. A garment whose coarse drape overfilled a
    contact list is marked as overfull in ``fine`` too, since the choice of dropped contacts is not deterministic.
    """
    status, time, held = (to_host(array) for array in (coarse.state.status, coarse.state.time, coarse.state.held))
    overfull, new_overfull = to_host(coarse.state.contacts.overfull), to_host(fine.state.contacts.overfull)
    worlds = [entry for entry in worlds if status[entry[0]] != DIVERGED]
    if not worlds:
        return
    model, state, device = fine.model, fine.state, fine.model.device
    first, first_coarse = model.topology.vertex_offset, coarse.model.topology.vertex_offset
    corners = np.zeros((model.n_vertices, 3), np.int32)
    weights = np.zeros((model.n_vertices, 3), np.float32)
    new_time, new_held, loose_after = (to_host(array) for array in (state.time, state.held, state.loose_after))
    frame = to_host(model.worlds)["frame"]
    for old, new, mesh in worlds:
        span = slice(first[new], first[new + 1])
        corners[span], weights[span] = mesh.corners + first_coarse[old], mesh.weights
        new_time[new], new_held[new], new_overfull[new] = time[old], held[old], overfull[old]
        loose_after[new] = time[old] + MIN_FRAMES * frame[new]
    state.time.assign(new_time)
    state.held.assign(new_held)
    state.loose_after.assign(loose_after)
    state.contacts.overfull.assign(new_overfull)
    interpolation = [wp.array(corners, dtype=wp.vec3i, device=device), wp.array(weights, dtype=wp.vec3, device=device)]
    wp.launch(
        refine,
        dim=model.n_vertices,
        inputs=[model.worlds, model.cloth.vertex_world, *interpolation, coarse.state.x, coarse.state.v],
        outputs=[state.x, state.v, state.ahead, state.x_seen, state.search.x],
        device=device,
    )
