"""The distance between the drapes of the same garments on two devices: the noise floor of draped positions.

Both devices run the same kernels; their sums and functions round differently, and a fold may fall to either side.
"""

from collections.abc import Sequence

import numpy as np

from benchmarks.cases.figures import Figure, Measured
from benchmarks.draping.workload import Worn
from gcd_dataset.generator.drape import drape_batch
from gcd_dataset.records import Outcome


def compare_devices(worn: Sequence[Worn], device: str, other: str, *, batch: int) -> Measured:
    """Distances [cm] between corresponding vertices of the two drapes of each garment that settles on both devices."""
    jobs = [one.job for one in worn]
    pairs = zip(worn, drape_batch(jobs, device=device, at_once=batch), drape_batch(jobs, device=other), strict=True)
    rows = [
        {
            "index": one.index,
            "upper": one.upper,
            "bottom": one.bottom,
            "mean_cm": float(apart.mean()),
            "p95_cm": float(np.percentile(apart, 95)),
            "largest_cm": float(apart.max()),
        }
        for one, here, there in pairs
        if here.outcome is there.outcome is Outcome.SETTLED
        for apart in [np.linalg.norm(here.vertices - there.vertices, axis=1)]
    ]
    figures = [Figure("garments_on_both_devices", len(rows), "")]
    if rows:
        means = np.array([row["mean_cm"] for row in rows])
        figures += [
            Figure("floor_mean", float(means.mean()), "cm"),
            Figure("floor_median", float(np.median(means)), "cm"),
            Figure("floor_largest_mean", float(means.max()), "cm"),
            Figure("floor_p95", float(np.mean([row["p95_cm"] for row in rows])), "cm"),
        ]
    return Measured(figures, rows)
