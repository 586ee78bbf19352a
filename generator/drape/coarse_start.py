"""A cheap start: the garment is draped at twice its spacing first, and goes on from there."""

from collections.abc import Sequence

import numpy as np
import warp as wp

from gcd_dataset.generator.drape.kernels.refine import refine
from gcd_dataset.generator.drape.kernels.world import DIVERGED
from gcd_dataset.generator.drape.solver import Solver
from gcd_dataset.generator.mesh.coarse import CoarseMesh

__all__ = ["go_on_from"]

AGAIN_LOOSE = 4  # frames after which a fine garment that goes on may be found at rest


def go_on_from(coarse: Solver, fine: Solver, places: Sequence[tuple[int, int, CoarseMesh]]) -> None:
    """Have garments of ``fine`` start from the end of their coarse drapes, whose worlds in ``coarse`` stand first.

    One whose coarse drape has diverged starts as it is. Where there was no room for contacts, that is told of the fine
    garment too: which ones were left out depends on chance.
    """
    contacts = coarse.state.contacts, fine.state.contacts
    status, time, held = (array.numpy() for array in (coarse.state.status, coarse.state.time, coarse.state.held))
    overfull, overfulls = contacts[0].overfull.numpy(), contacts[1].overfull.numpy().copy()
    places = [place for place in places if status[place[0]] != DIVERGED]
    if not places:
        return
    model, state, device = fine.model, fine.state, fine.model.device
    first, first_coarse = model.topology.vertex_offset, coarse.model.topology.vertex_offset
    corners = np.zeros((model.n_vertices, 3), np.int32)
    weights = np.zeros((model.n_vertices, 3), np.float32)
    times, helds, loose = (array.numpy().copy() for array in (state.time, state.held, state.loose_after))
    frame = model.worlds.numpy()["frame"]
    for old, new, mesh in places:
        span = slice(first[new], first[new + 1])
        corners[span], weights[span] = mesh.corners + first_coarse[old], mesh.weights
        times[new], helds[new], overfulls[new] = time[old], held[old], overfull[old]
        loose[new] = time[old] + AGAIN_LOOSE * frame[new]
    pairs = (state.time, times), (state.held, helds), (state.loose_after, loose), (contacts[1].overfull, overfulls)
    for array, values in pairs:
        array.assign(values)
    shares = [wp.array(corners, dtype=wp.vec3i, device=device), wp.array(weights, dtype=wp.vec3, device=device)]
    wp.launch(
        refine,
        dim=model.n_vertices,
        inputs=[model.worlds, model.cloth.vertex_world, *shares, coarse.state.x, coarse.state.v],
        outputs=[state.x, state.v, state.ahead, state.x_seen, state.search.x],
        device=device,
    )
