"""Generating a body set: people in shards."""

from collections.abc import Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import Any

from gcd_dataset.generator.drape.device import cores
from gcd_dataset.generator.people import make_person, model_mesh, people_recipe
from gcd_dataset.generator.recipe import versions
from gcd_dataset.making.progress import Progress, ProgressCallback, ignore_progress
from gcd_dataset.making.run import Made, Wanted, run
from gcd_dataset.making.store import place_for
from gcd_dataset.making.tasks import Job, Work, check_count
from gcd_dataset.shards.body_set import encode_person, mesh_bytes
from gcd_dataset.shards.layout import BODIES, TRAIN, mesh_name
from gcd_dataset.shards.manifest import Plan
from gcd_dataset.workers import parallel_map_chunks

CHUNK = 16  # people per task of a worker: a quarter of a second of work, 10 MB of results
CPU_SECONDS = 0.016  # CPU time per body [s]
STARTUP = 4.0  # s for a worker to start


def generate_people(
    out: Path | str,
    count: int,
    *,
    seed: int = 0,
    bodies: str = "random",
    job: Job | None = None,
    workers: int | None = None,
    on_progress: ProgressCallback = ignore_progress,
    log: Path | str | None = None,
) -> Progress:
    """Generate people 0 … ``count`` - 1 of ``seed`` in ``out``, in two poses, with their measures.

    ``bodies``: the group they are drawn from: ``random`` (women and men), ``female``, ``male`` or ``pooled``. The other
    options, resumption and errors as for ``generate``; raises ``ConfigError`` for an unknown group, too.
    """
    check_count(count)
    mesh = model_mesh()
    recipe = {**people_recipe(bodies), "mesh": mesh.sha256}
    plan, files = Plan(BODIES.kind, seed, recipe, count, 1), {mesh_name(TRAIN): mesh_bytes(mesh)}
    work = Work(place_for(out), plan, {TRAIN: range(count)}, files=files)
    maker = partial(_make, seed, bodies, recipe, workers)
    return run(work, maker, job=job, on_progress=on_progress, log=log, options={"workers": workers})


def _make(seed: int, bodies: str, recipe: dict[str, Any], workers: int | None, wanted: Wanted) -> Iterator[Made]:
    indices = [index for _, left in wanted for index in left]
    processes = min(cores(), int(CPU_SECONDS * len(indices) / STARTUP)) if workers is None else workers
    return parallel_map_chunks(partial(_make_chunk, seed, bodies, recipe), indices, processes, chunk=CHUNK)


def _make_chunk(seed: int, bodies: str, recipe: dict[str, Any], indices: Sequence[int]) -> list[Made]:
    origin = {"seed": seed, "versions": versions()}
    people = ((index, make_person(seed, index, bodies=bodies)) for index in indices)
    return [
        Made(index, encode_person(person, {**origin, "index": index, "recipe": recipe})) for index, person in people
    ]
