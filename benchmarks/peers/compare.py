"""Our solver and Newton's on the same garments, by batch size, with the same crossing counters."""

import time
from collections.abc import Sequence
from dataclasses import replace
from itertools import cycle, islice
from typing import Any

import numpy as np
import warp as wp

from benchmarks.cases import CaseResult, Figure
from benchmarks.draping.workload import quality
from benchmarks.peers.newton import PeerDrapes, drape_with_newton
from gcd_dataset.generator.drape import DrapeConfig, DrapeJob, drape_batch
from gcd_dataset.generator.drape.holds import fell, off_body
from gcd_dataset.generator.drape.model import build_model
from gcd_dataset.generator.drape.outcome import slid_off
from gcd_dataset.generator.drape.solver import Solver
from gcd_dataset.generator.mesh import coarse_start
from gcd_dataset.records import Drape, Outcome


def compare_solvers(jobs: Sequence[DrapeJob], batches: Sequence[int], *, device: str) -> CaseResult:
    """Drape batches of each size with every solver, cycling through the garments; one row per solver and size.

    ``ours`` starts from coarse meshes, made in ``setup_s``. For ``newton``,
    ``setup_s`` covers the model and the first frame; ``ours`` builds its model in ``solve_s``. Seconds are per garment.
    """
    jobs = [replace(job, coarse=None, start=None) for job in jobs]
    drape_batch(jobs[:1], DrapeConfig(max_frames=1), device=device)
    drape_with_newton(jobs[:1], device=device, max_frames=2)
    rows, figures = [], []
    for batch in batches:
        some = list(islice(cycle(jobs), batch))
        for row in (_ours(some, device), _theirs(some, device)):
            rows.append({"solver": row["solver"], "batch": batch, **row})
            figures += [
                Figure(f"{row['solver']}_{part}_batch_{batch}", row[part], "s") for part in ("setup_s", "solve_s")
            ]
    return CaseResult(figures, rows)


def _ours(jobs: Sequence[DrapeJob], device: str) -> dict[str, Any]:
    start = time.perf_counter()
    ready = [replace(job, coarse=coarse_start(job.box_mesh)) for job in jobs]
    meshed = time.perf_counter()
    at_once = 1 if device == "cpu" else len(jobs)  # one thread for both solvers
    drapes = drape_batch(ready, device=device, at_once=at_once)
    return _row("ours", drapes, meshed - start, time.perf_counter() - meshed)


def _theirs(jobs: Sequence[DrapeJob], device: str) -> dict[str, Any]:
    peer = drape_with_newton(jobs, device=device)
    return _row("newton", _judged(jobs, peer, device), peer.setup_seconds, peer.solve_seconds)


def _row(solver: str, drapes: Sequence[Drape], setup: float, solve: float) -> dict[str, Any]:
    """The table row of a batch, with seconds per garment."""
    return {
        "solver": solver,
        "setup_s": setup / len(drapes),
        "solve_s": solve / len(drapes),
        **{figure.metric: round(figure.value, 3) for figure in quality(drapes)},
        "stretch_p99": round(float(np.median([drape.stretch_p99 for drape in drapes])), 3),
        "frames_p50": float(np.median([drape.frames for drape in drapes])),
        "outcomes": " ".join(sorted({drape.outcome.name for drape in drapes})),
    }


def _judged(jobs: Sequence[DrapeJob], peer: PeerDrapes, device: str) -> list[Drape]:
    """Newton's drapes with outcomes by our criteria and counters."""
    config = DrapeConfig()
    solver = Solver(build_model(jobs, config, device), config)
    solver.state.x.assign(wp.array(np.concatenate(peer.vertices), dtype=wp.vec3, device=device))
    own, body, through = solver.self_crossings(), solver.body_crossings(), solver.body_through()
    stretches = solver.stretches().numpy()
    parts = np.split(stretches, [span.start for span in solver.model.edges[1:]])
    drapes = []
    for k, (job, vertices) in enumerate(zip(jobs, peer.vertices, strict=True)):
        median, p99 = np.percentile(parts[k], [50, 99])
        drape = Drape(
            vertices=vertices,
            outcome=Outcome.SETTLED,
            frames=int(peer.frames[k]),
            self_crossings=int(own[k]),
            body_crossings=int(body[k]),
            stretch_median=float(median),
            stretch_p99=float(p99),
            body_through=int(through[k]),
        )
        outcome = _outcome(job, drape, config, rested=bool(peer.rested[k]))
        drapes.append(replace(drape, outcome=outcome))
    return drapes


def _outcome(job: DrapeJob, drape: Drape, config: DrapeConfig, *, rested: bool) -> Outcome:
    """The first outcome that applies, in the order used for our drapes."""
    failures = {
        Outcome.DIVERGED: not np.isfinite(drape.vertices).all(),
        Outcome.FELL: bool(fell(job, drape.vertices)),
        Outcome.SLID_OFF: bool(slid_off(job, drape.vertices) or off_body(job, drape.vertices)),
        Outcome.NOT_SETTLED: not rested,
        Outcome.THROUGH_BODY: drape.body_crossings > config.max_body_crossings,
        Outcome.THROUGH_ITSELF: drape.self_crossings > config.max_self_crossings,
        Outcome.OVERSTRETCHED: drape.stretch_p99 > config.max_stretch,
    }
    return next((outcome for outcome, applies in failures.items() if applies), Outcome.SETTLED)
