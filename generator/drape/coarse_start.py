"""A cheap start: the garment is draped at twice its spacing first, and goes on from there."""

from collections.abc import Sequence

import numpy as np
import warp as wp

from gcd_dataset.errors import MeshError
from gcd_dataset.generator.drape.config import DrapeJob
from gcd_dataset.generator.drape.kernels.refine import refine
from gcd_dataset.generator.drape.kernels.world import DIVERGED
from gcd_dataset.generator.drape.solver import Solver
from gcd_dataset.generator.mesh.coarsen import Coarse, coarsen

__all__ = ["coarse_of", "go_on_from"]

FEW = 1000  # vertices that are draped as fast as they are
AGAIN_LOOSE = 4  # frames after which a fine garment that goes on may be found at rest


def coarse_of(job: DrapeJob) -> Coarse | None:
    """The job's box mesh made coarser; None for one that is small or too narrow somewhere, which starts as it is."""
    if job.coarse is not None or len(job.box_mesh.vertices) < FEW:
        return job.coarse
    try:
        return coarsen(job.box_mesh)
    except MeshError:
        return None


def go_on_from(solver: Solver, coarse: Solver, meshes: Sequence[Coarse], worlds: Sequence[int]) -> None:
    """Have garments ``worlds`` of ``solver``, made coarser as ``meshes``, start from the end of the coarse drape."""
    ok = [
        (world, at, mesh)
        for at, (world, mesh, status) in enumerate(zip(worlds, meshes, coarse.state.status.numpy(), strict=True))
        if status != DIVERGED
    ]
    model, state, device = solver.model, solver.state, solver.model.device
    first, first_coarse = model.topology.vertex_offset, coarse.model.topology.vertex_offset
    corners = np.zeros((model.n_vertices, 3), np.int32)
    weights = np.zeros((model.n_vertices, 3), np.float32)
    time, held, loose = state.time.numpy(), state.held.numpy(), state.loose_after.numpy()
    frame = model.worlds.numpy()["frame"]
    for world, at, mesh in ok:
        span = slice(first[world], first[world + 1])
        corners[span] = mesh.corners + first_coarse[at]
        weights[span] = mesh.weights
        time[world] = coarse.state.time.numpy()[at]
        held[world] = coarse.state.held.numpy()[at]
        loose[world] = time[world] + AGAIN_LOOSE * frame[world]
    state.time.assign(time)
    state.held.assign(held)
    state.loose_after.assign(loose)
    wp.launch(
        refine,
        dim=model.n_vertices,
        inputs=[
            model.worlds,
            model.cloth.vertex_world,
            wp.array(corners, dtype=wp.vec3i, device=device),
            wp.array(weights, dtype=wp.vec3, device=device),
            coarse.state.x,
            coarse.state.v,
        ],
        outputs=[state.x, state.v, state.ahead],
        device=device,
    )
    for seen in (state.x_seen, state.x_searched):
        wp.copy(seen, state.x)
