"""What the draper of a GPU does: how many garments a second, and how long the GPU waits."""

import shutil
import subprocess
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from itertools import cycle, islice

import numpy as np

from gcd_dataset.generator.drape import DrapeJob
from gcd_dataset.generator.drapers import DrapeRequest, SharedDraper, address_for
from gcd_dataset.generator.pipeline import prepare
from gcd_dataset.generator.recipe import MakeConfig, devices_of

__all__ = ["gpu_idle", "own_rate"]

TOLD_EVERY = 200  # ms between two readings of nvidia-smi
TRIFLE = 1e-6  # cm
REQUESTED = 256  # more than a GPU drapes at a time


def own_rate(config: MakeConfig, *, prepared: int, warm: int, seconds: float, pictured: bool = False) -> float:
    """Garments a second of the draping process alone, which always has more requests than it drapes at a time.

    ``prepared`` designs come again, on bodies that the draper has not seen; the first ``warm`` are not counted.
    """
    counted = 0
    worn = [worn for number in range(prepared) for worn in prepare(1, number, config).dressed]
    jobs = [
        DrapeJob(one.box_mesh, one.body, one.size, coarse=one.coarse, start=one.start) for one in worn if one.box_mesh
    ]
    picture = config.picture if pictured else 0
    with SharedDraper(address_for(devices_of(config)[0])) as draper:
        requests = (DrapeRequest(number, _on_another(job, number), picture) for number, job in enumerate(cycle(jobs)))
        for request in islice(requests, REQUESTED):
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


def _on_another(job: DrapeJob, number: int) -> DrapeJob:
    """The job on a body of its own, as the garments of a data set have: what is known of a body is kept."""
    return replace(job, body=replace(job.body, vertices=job.body.vertices + TRIFLE * number))


@contextmanager
def gpu_idle(device: str) -> Iterator[list[float]]:
    """A list that holds, after the block, the share of time in which the GPU did nothing; without a GPU none."""
    idle: list[float] = []
    if device == "cpu" or shutil.which("nvidia-smi") is None:
        yield idle
        return
    number = device.partition(":")[2] or "0"
    command = ["nvidia-smi", "-i", number, "--query-gpu=utilization.gpu", "--format=csv,noheader,nounits"]
    reading = subprocess.Popen([*command, "-lms", str(TOLD_EVERY)], stdout=subprocess.PIPE, text=True)
    told: list[float] = []

    def listen() -> None:
        assert reading.stdout is not None
        told.extend(float(line) for line in reading.stdout if line.strip().isdigit())

    thread = threading.Thread(target=listen)
    thread.start()
    try:
        yield idle
    finally:
        reading.terminate()
        thread.join()
        reading.wait()
        if told:
            idle.append(1 - float(np.mean(told)) / 100)
