"""What the same bytes in any batch cost: contact sums in fixed point against sums in floating point.

The order of a GPU's atomic additions varies from run to run. Integer sums do not depend on it, floating-point sums do
(``generator.drape.kernels.push``). Nothing else in the solver is ordered: contact lists may be filled in any order.
Both kernels add a displacement to every vertex of the same contacts, those of a batch in mid-drape. The cost of the
promise is the difference of their times as a share of the time of a substep.
"""

import time
from collections.abc import Callable, Sequence

import warp as wp

from benchmarks.cases.figures import Figure, Measured
from benchmarks.draping.ordering_kernels import add_in_fixed_point, add_in_floating_point
from gcd_dataset.generator.drape import DrapeConfig, DrapeJob
from gcd_dataset.generator.drape.model import build_model
from gcd_dataset.generator.drape.solver import Solver

MID_DRAPE = 40  # frames
LAUNCHES = 200


def measure_ordering(jobs: Sequence[DrapeJob], *, device: str) -> Measured:
    """Seconds of both sums and of a substep, in one batch of ``jobs`` after ``MID_DRAPE`` frames."""
    solver = Solver(build_model(jobs, DrapeConfig(), device), DrapeConfig())
    while solver.frames < MID_DRAPE:
        solver.frame()
    model, state = solver.model, solver.state
    threads = 1 if device == "cpu" else 128 * 1024
    fixed = wp.zeros((model.n_vertices, 4), dtype=int, device=device)
    floating = wp.zeros((model.n_vertices, 4), dtype=float, device=device)
    shared = [model.worlds, state.contacts, threads, state.x]
    seconds = {
        "fixed_point": _time(lambda: solver.launch(add_in_fixed_point, threads, shared, [fixed]), device),
        "floating_point": _time(lambda: solver.launch(add_in_floating_point, threads, shared, [floating]), device),
    }
    begin = time.perf_counter()
    for _ in range(10):
        solver.frame()
    wp.synchronize_device(device)
    substep = (time.perf_counter() - begin) / (10 * solver.config.substeps)
    extra = seconds["fixed_point"] - seconds["floating_point"]
    return Measured(
        [
            Figure("contacts", int(state.contacts.work.numpy()[-1]), "pairs"),
            *(Figure(f"sum_{kind}_us", 1e6 * value, "µs") for kind, value in seconds.items()),
            Figure("substep_us", 1e6 * substep, "µs"),
            Figure("ordering_cost", extra / substep, "share of a substep"),
        ]
    )


def _time(launch: Callable[[], None], device: str) -> float:
    """Seconds of a launch, the mean of ``LAUNCHES``."""
    launch()
    wp.synchronize_device(device)
    begin = time.perf_counter()
    for _ in range(LAUNCHES):
        launch()
    wp.synchronize_device(device)
    return (time.perf_counter() - begin) / LAUNCHES
