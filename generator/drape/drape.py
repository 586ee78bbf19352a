"""Box meshes and bodies in, garments at rest out."""

from collections.abc import Sequence

import numpy as np

from gcd_dataset.errors import DrapeError
from gcd_dataset.generator.drape.config import DrapeConfig, DrapeJob
from gcd_dataset.generator.drape.device import resolve_device
from gcd_dataset.generator.drape.kernels.world import DIVERGED, DONE, RUNNING
from gcd_dataset.generator.drape.model import ClothModel, build_model
from gcd_dataset.generator.drape.outcome import judge, slid_off, stretch
from gcd_dataset.generator.drape.solver import Solver
from gcd_dataset.records import Drape

__all__ = ["drape_batch"]

DEFAULT = DrapeConfig()


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
    model = build_model(jobs, config, device)
    solver = Solver(model, config)
    frames = _play(solver, jobs)
    return _collect(solver, jobs, frames)


def _play(solver: Solver, jobs: Sequence[DrapeJob]) -> np.ndarray:
    """Run frames until every garment rests, has slid off or the frames are used up; returns frames by world."""
    config, model, state = solver.config, solver.model, solver.state
    worlds = model.worlds.numpy()
    sizes = np.diff(model.vertex_offset)
    loose_after = worlds["sewing_time"] + worlds["held_time"] + 2 * config.substeps * worlds["dt"]
    frames = np.zeros(model.n_worlds, int)
    while solver.frames < config.max_frames:
        solver.frame()
        status = state.status.numpy()
        frames[status == RUNNING] = solver.frames
        loose = state.time.numpy() > loose_after
        still = state.moving.numpy() <= config.moving_share * sizes
        ended = (status == RUNNING) & loose & (still | _slid(solver, jobs, status, loose))
        if ended.any():
            state.status.assign(np.where(ended, DONE, status).astype(np.int32))
        if not ((status == RUNNING) & ~ended).any():
            break
    return frames


def _slid(solver: Solver, jobs: Sequence[DrapeJob], status: np.ndarray, loose: np.ndarray) -> np.ndarray:
    """Worlds whose held edge has gone down too far; looked at every tenth frame."""
    slid = np.zeros(len(jobs), bool)
    if solver.frames % 10 == 0 and (loose & (status == RUNNING)).any():
        x = solver.state.x.numpy()
        for world in map(int, np.flatnonzero(loose & (status == RUNNING))):
            slid[world] = slid_off(jobs[world], _own(x, solver.model, world))
    return slid


def _collect(solver: Solver, jobs: Sequence[DrapeJob], frames: np.ndarray) -> list[Drape]:
    x, status = solver.state.x.numpy(), solver.state.status.numpy()
    overfull = solver.state.overfull.numpy()
    self_crossings, body_crossings = solver.self_crossings(), solver.body_crossings()
    drapes = []
    for world, job in enumerate(jobs):
        vertices = np.array(_own(x, solver.model, world), np.float32)
        median, p99 = stretch(solver.model.topologies[world], vertices)
        outcome = judge(
            job,
            vertices,
            solver.config,
            running=status[world] == RUNNING,
            diverged=status[world] == DIVERGED,
            overfull=bool(overfull[world]),
            self_crossings=int(self_crossings[world]),
            body_crossings=int(body_crossings[world]),
            stretch_p99=p99,
        )
        drapes.append(
            Drape(
                vertices=vertices,
                outcome=outcome,
                frames=int(frames[world]),
                self_crossings=int(self_crossings[world]),
                body_crossings=int(body_crossings[world]),
                stretch_median=median,
                stretch_p99=p99,
            )
        )
    return drapes


def _own(x: np.ndarray, model: ClothModel, world: int) -> np.ndarray:
    return x[model.vertex_offset[world] : model.vertex_offset[world + 1]]
