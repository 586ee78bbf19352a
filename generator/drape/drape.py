"""Box meshes and bodies in, garments at rest out."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Int

from gcd_dataset.errors import DrapeError
from gcd_dataset.generator.drape.coarse_start import coarse_of, go_on_from
from gcd_dataset.generator.drape.config import DrapeConfig, DrapeJob, Fabric
from gcd_dataset.generator.drape.device import resolve_device
from gcd_dataset.generator.drape.kernels.world import DIVERGED, RUNNING
from gcd_dataset.generator.drape.model import build_model
from gcd_dataset.generator.drape.outcome import judge
from gcd_dataset.generator.drape.solver import Solver
from gcd_dataset.records import Drape

__all__ = ["drape_batch"]

DEFAULT = DrapeConfig()
COARSE_THICKNESS = 2.5  # of the fabric's
POLL_EVERY = 4  # frames after which the device is asked whether any garment still moves


def drape_batch(jobs: Sequence[DrapeJob], config: DrapeConfig = DEFAULT, *, device: str = "auto") -> list[Drape]:
    """The garments at rest on their bodies, one ``Drape`` for each job, in order.

    All jobs are simulated at the same time; each gives the same result alone as in any batch. A garment that does not
    come to rest, or comes to rest badly, is returned with the ``Outcome`` that says so.
    Raises ``ConfigError`` for a device that is not there, ``DrapeError`` for a box mesh without faces.
    """
    if not jobs:
        return []
    for number, job in enumerate(jobs):
        if len(job.box_mesh.faces) == 0:
            raise DrapeError(f"garment {number} has no faces: build its box mesh from a pattern with panels")
    device = resolve_device(device)
    solver = Solver(build_model(jobs, config, device), config)
    frames = np.zeros(len(jobs), int)
    if config.coarse_start:
        frames += _start_coarse(solver, jobs)
    _run(solver, config.max_frames)
    return _collect(solver, jobs, frames)


def _start_coarse(solver: Solver, jobs: Sequence[DrapeJob]) -> Int[np.ndarray, " w"]:
    """Drape the jobs' coarse meshes, have ``solver`` go on from there; the frames that took."""
    frames = np.zeros(len(jobs), int)
    coarse = [(world, mesh) for world, mesh in enumerate(map(coarse_of, jobs)) if mesh is not None]
    if not coarse:
        return frames
    worlds, meshes = zip(*coarse, strict=True)

    first = [replace(jobs[world], box_mesh=mesh.mesh, fabric=_thicker(jobs[world].fabric)) for world, mesh in coarse]
    start = Solver(build_model(first, solver.config, solver.model.device), solver.config)
    _run(start, solver.config.max_frames // 2)
    go_on_from(solver, start, meshes, worlds)
    frames[list(worlds)] = start.state.frames.numpy()
    return frames


def _thicker(fabric: Fabric) -> Fabric:
    """Layers are kept further apart while the mesh is coarse, lest they cross when chords become folds again."""
    return replace(fabric, thickness=COARSE_THICKNESS * fabric.thickness)


def _run(solver: Solver, max_frames: int) -> None:
    while solver.running and solver.frames < max_frames:
        for _ in range(min(POLL_EVERY, max_frames - solver.frames)):
            solver.frame()


def _collect(solver: Solver, jobs: Sequence[DrapeJob], frames_before: Int[np.ndarray, " w"]) -> list[Drape]:
    x, status, frames = solver.state.x.numpy(), solver.state.status.numpy(), solver.state.frames.numpy() + frames_before
    running = (status == RUNNING) & ~_calm(solver)
    overfull, stretches = solver.state.contacts.overfull.numpy(), solver.stretches()
    self_crossings, body_crossings = solver.self_crossings(), solver.body_crossings()
    vertex_offset, edge_offset = solver.model.topology.vertex_offset, solver.model.topology.edge_offset
    drapes = []
    for world, job in enumerate(jobs):
        vertices = np.array(x[vertex_offset[world] : vertex_offset[world + 1]], np.float32)
        median, p99 = np.percentile(stretches[edge_offset[world] : edge_offset[world + 1]], [50, 99])
        outcome = judge(
            job,
            vertices,
            solver.config,
            running=bool(running[world]),
            diverged=status[world] == DIVERGED,
            overfull=bool(overfull[world]),
            self_crossings=int(self_crossings[world]),
            body_crossings=int(body_crossings[world]),
            stretch_p99=float(p99),
        )
        drapes.append(
            Drape(
                vertices=vertices,
                outcome=outcome,
                frames=int(frames[world]),
                self_crossings=int(self_crossings[world]),
                body_crossings=int(body_crossings[world]),
                stretch_median=float(median),
                stretch_p99=float(p99),
            )
        )
    return drapes


def _calm(solver: Solver) -> np.ndarray:
    """(w) whether a garment hangs loose, and few of its vertices move fast."""
    state, model = solver.state, solver.model
    loose = (state.held.numpy() == 0) & (state.time.numpy() > state.loose_after.numpy())
    few = solver.config.moving_share * np.diff(model.topology.vertex_offset)
    return np.asarray(loose & (state.moved_fast.numpy() <= few))
