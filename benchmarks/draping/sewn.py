"""Crossings at the end of sewing, before gravity acts: how tangled garments are when they begin to fall.

The meshes are those that sewing begins with in a drape: the coarse ones at their sewing starts. Counted are the edges
of the cloth that cross cloth or body, and the edges of the body that cross cloth, as at rest.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from benchmarks.cases.figures import Figure, Measured
from benchmarks.draping.workload import Worn
from gcd_dataset.generator.drape import DrapeConfig, DrapeJob
from gcd_dataset.generator.drape.model import build_model
from gcd_dataset.generator.drape.solver import Solver

SHARES = (50, 80, 95, 99)


def measure_sewn(worn: Sequence[Worn], *, device: str, batch: int) -> Measured:
    """Percentiles of the crossing edges after ``DrapeConfig.sewing_time``, and the share of garments without any."""
    found: dict[str, list[int]] = {"self": [], "body": [], "through": []}
    for first in range(0, len(worn), batch):
        solver = _sewn([one.job for one in worn[first : first + batch]], device)
        for kind, counts in (
            ("self", solver.self_crossings()),
            ("body", solver.body_crossings()),
            ("through", solver.body_through()),
        ):
            found[kind] += counts.tolist()
    total = np.sum([found[kind] for kind in found], axis=0)
    return Measured(
        [
            Figure("garments", len(worn), ""),
            Figure("sewn_clean", float(np.mean(total == 0)), "share"),
            *(
                Figure(f"sewn_{kind}_p{share}", float(np.percentile(counts, share)), "edges")
                for kind, counts in found.items()
                for share in SHARES
            ),
        ],
        [
            {
                "index": one.index,
                "upper": one.upper,
                "bottom": one.bottom,
                **{k: counts[row] for k, counts in found.items()},
            }
            for row, one in enumerate(worn)
            if total[row]
        ],
    )


def _sewn(jobs: Sequence[DrapeJob], device: str) -> Solver:
    """A solver whose garments have just been sewn."""
    config = DrapeConfig(coarse_start=False)
    coarse = {k for k, job in enumerate(jobs) if job.coarse is not None}
    starts = [job if job.coarse is None else replace(job, box_mesh=job.coarse.mesh, coarse=None) for job in jobs]
    solver = Solver(build_model(starts, config, device, coarse=coarse), config)
    solver.run_for(config.sewing_time)
    return solver
