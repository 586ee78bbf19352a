"""Garments written to shards: rate, compared with the draper of the same machine alone.

    python -m benchmarks.run scale --device cuda:0 --workers 15 --count 2000

Garments with pictures, as ``gcd generate --bodies both`` makes them, are written to a temporary folder.
``garments_per_s`` is timed from the first garment finished, when kernels are loaded and all workers busy, to the last.
``own_per_s``: rate of the draping process alone with unlimited requests, without pictures; ``share``:
``garments_per_s`` divided by it and by the number of GPUs; ``gpu_waits``: the share of the timed stretch in which
nvidia-smi sees no kernel on the first GPU; ``joules``: mean power of that GPU in it over the garments it drapes a
second; ``cpu_*``: CPU seconds per garment of each step, in this process, over ``--staged`` designs. ``--recipe`` makes
other garments, such as those of a TOML file, no drape repeated. ``clean``: the share with this grade;
``frames_clean``: that of the frames of motions without a crossing.
"""

import argparse
import json
import re
import resource
import shutil
import subprocess
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, replace
from itertools import cycle, islice
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.cases import CaseResult, Figure
from gcd_dataset.errors import ConfigError
from gcd_dataset.generator.drape import DrapeJob
from gcd_dataset.generator.drape.batches import PreparedJob
from gcd_dataset.generator.drapers import DrapeReply, DrapeRequest, SharedDraper, address_for
from gcd_dataset.generator.maker import produce
from gcd_dataset.generator.pipeline import drape_jobs, finish, prepare
from gcd_dataset.generator.recipe import MakeConfig, device_kind, devices_of, recipe_of
from gcd_dataset.generator.recipes import find_recipe
from gcd_dataset.records import Drape, Outcome, Sample
from gcd_dataset.shards import ShardWriter
from gcd_dataset.shards.codec import encode_sample


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--count", type=int, default=64, help="garments written")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--workers", type=int, default=2, help="processes that make garments")
    parser.add_argument("--device", default="auto", help="where cloth is draped; several GPUs as cuda:0,1")
    parser.add_argument("--bodies", help="wearers, as for gcd generate (default: both)")
    parser.add_argument("--resolution", type=float, default=1.0, help="[cm]")
    parser.add_argument("--recipe", help="name, or path of a TOML file; without --bodies")
    parser.add_argument("--picture", type=int, default=512, help="side of the pictures [pixels]; 0 for none")
    parser.add_argument(
        "--seconds", type=float, default=30.0, help="duration of the draper's own measurement; 0 for none"
    )
    parser.add_argument("--prepared", type=int, default=32, help="designs for the draper's own rate")
    parser.add_argument("--staged", type=int, default=8, help="designs for the CPU seconds of each step")


def run(options: argparse.Namespace) -> CaseResult:
    """Write shards, then measure the draper and each step alone."""
    if options.count < 2:
        raise ConfigError(f"--count is {options.count}: give 2 or more")
    if options.recipe and options.bodies:
        raise ConfigError("--recipe has bodies of its own: leave --bodies out")
    config = find_recipe(options.recipe).config if options.recipe else MakeConfig(bodies=options.bodies or "both")
    config = replace(config, resolution=options.resolution, device=options.device, picture=options.picture)
    if options.recipe:
        config = replace(config, on_fail="keep")
    devices = devices_of(config)
    counts: Counter[str] = Counter()

    def note(meta: dict[str, Any]) -> None:
        frames = meta.get("motion", {}).get("crossings", [])
        counts.update([meta["drape"]["outcome"], f"grade {meta['grade']}", *(f"frame {sum(own)}" for own in frames)])
        counts["frames"] += len(frames)

    figures = written(config, options, note)
    rate = figures[0].value
    figures.append(Figure("unsettled", 1 - counts[Outcome.SETTLED.name] / options.count, "of the garments"))
    figures.append(Figure("clean", counts["grade clean"] / options.count, "of the garments"))
    if counts["frames"]:
        figures.append(Figure("frames_clean", counts["frame 0"] / counts["frames"], "of the frames"))
        figures.append(Figure("frames_per_s", rate * counts["frames"] / options.count, "frames of garments"))
    if device_kind(config) == "cuda" and options.seconds:
        own = own_rate(config, prepared=options.prepared, warm=256, seconds=options.seconds)
        figures.append(Figure("own_per_s", own, "garments, by one GPU"))
        figures.append(Figure("share", rate / own / len(devices), "of the drapers' own rate"))
    memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    return CaseResult(
        [*figures, Figure("memory", memory, "MB, the writing process at its peak"), *_steps(config, options)]
    )


def written(
    config: MakeConfig, options: argparse.Namespace, note: Callable[[dict[str, Any]], None], *, ends: int = 1
) -> list[Figure]:
    """Write ``options.count`` garments to shards; their rate, and the GPU's load meanwhile.

    The rate is that from the ``ends``-th garment finished to the ``ends``-th last. ``note`` is called with the metadata
    of each garment.
    """
    times, load, devices = list[float](), GpuLoad(), devices_of(config)
    with (
        tempfile.TemporaryDirectory() as folder,
        ShardWriter(Path(folder), seed=options.seed, recipe=recipe_of(config)) as writer,
        ExitStack() as measured,
    ):
        made = produce(options.seed, range(options.count), config, workers=options.workers, finished=_encoded)
        for index, (members, at) in enumerate(made):
            writer.add(index, members)
            times.append(at)
            if not index:
                load = measured.enter_context(gpu_load(devices[0]))
            note(json.loads(members["meta.json"]))
    first, last = sorted(times)[ends - 1], sorted(times)[-ends]
    rate = (options.count - 2 * ends + 1) / (last - first)
    figures = [Figure("garments_per_s", rate, "garments")]
    if load.watts:
        figures.append(Figure("gpu_waits", load.idle, "of the time"))
        figures.append(Figure("joules", load.watts * len(devices) / rate, "J a garment"))
    return figures


def _encoded(sample: Sample) -> tuple[dict[str, bytes], float]:
    """The members of a sample, and when they were finished, on a clock that processes share [s]."""
    return encode_sample(sample), time.monotonic()


def _steps(config: MakeConfig, options: argparse.Namespace) -> list[Figure]:
    """CPU seconds of each step, per garment."""
    spent: dict[str, float] = {}

    def timed(name: str, step: Callable[..., Any], *arguments: Any) -> Any:
        begun = time.process_time()
        result = step(*arguments)
        spent[name] = spent.get(name, 0.0) + time.process_time() - begun
        return result

    garments = 0
    for number in range(options.staged):
        design = timed("prepare", prepare, options.seed, number, config)
        for job, worn in zip(drape_jobs(design, config), design.dressed, strict=True):
            drape = Drape(job.box_mesh.vertices, Outcome.SETTLED, 1, 0, 0, 1.0, 1.0)
            sample = timed("finish", finish, design, worn.index, config, DrapeReply(worn.index, drape, None))
            timed("encode", encode_sample, sample)
            garments += 1
    return [Figure(f"cpu_{name}", seconds / garments, "CPU-s a garment") for name, seconds in spent.items()]


SAMPLE_EVERY = 200  # ms between samples of nvidia-smi
SHIFT = 1e-6  # cm, change of a body that makes the draper treat it as another body
QUEUED = 256  # requests in the queue: more than a GPU drapes at a time


def own_rate(config: MakeConfig, *, prepared: int, warm: int, seconds: float) -> float:
    """Garments per second of one draping process with a queue that never runs empty.

    ``prepared`` designs are repeated, on bodies that the draper has not seen; the first ``warm`` garments are not
    counted.
    """
    counted = 0
    worn = [worn for number in range(prepared) for worn in prepare(1, number, config).dressed]
    jobs = [
        DrapeJob(one.box_mesh, one.body, one.size, coarse=one.coarse, start=one.start) for one in worn if one.box_mesh
    ]
    ready = [PreparedJob.of(job) for job in jobs]
    with SharedDraper(address_for(devices_of(config)[0])) as draper:
        requests = (_on_new_body(one, number) for number, one in enumerate(cycle(ready)))
        for request in islice(requests, QUEUED):
            draper.send(request)
        for request in islice(requests, warm):
            draper.receive()
            draper.send(request)
        begun = time.perf_counter()
        while time.perf_counter() - begun < seconds:
            draper.receive()
            counted += 1
            draper.send(next(requests))
        return counted / (time.perf_counter() - begun)


def _on_new_body(ready: PreparedJob, number: int) -> DrapeRequest:
    """A request on a slightly moved body: the draper caches data per body, and a data set has a new body per job."""
    job = replace(ready.job, body=replace(ready.job.body, vertices=ready.job.body.vertices + SHIFT * number))
    skin, shape = ready.field.digests
    field = replace(ready.field, digests=(skin, shape + str(number).encode()))
    return DrapeRequest(number, job, 0, prepared=replace(ready, job=job, field=field))


@dataclass
class GpuLoad:
    """Load of a GPU over a stretch of time; zeros where there is none."""

    idle: float = 0.0
    """Share of time in which nvidia-smi sees no kernel of any process."""
    watts: float = 0.0
    """Mean power [W]."""


@contextmanager
def gpu_load(device: str) -> Iterator[GpuLoad]:
    """Context manager: what nvidia-smi reports of a GPU until it closes, known from then on."""
    load = GpuLoad()
    if device == "cpu" or shutil.which("nvidia-smi") is None:
        yield load
        return
    number = device.partition(":")[2] or "0"
    command = ["nvidia-smi", "-i", number, "--query-gpu=utilization.gpu,power.draw", "--format=csv,noheader,nounits"]
    smi = subprocess.Popen([*command, "-lms", str(SAMPLE_EVERY)], stdout=subprocess.PIPE, text=True)
    try:
        yield load
    finally:
        smi.terminate()
        samples = re.findall(r"^(\d+), ([\d.]+)\n", smi.communicate()[0], re.MULTILINE)
        if samples:
            busy, load.watts = np.mean(np.array(samples, float), axis=0).tolist()
            load.idle = 1 - busy / 100
