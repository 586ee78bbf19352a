"""The rate of a GPU's draping process, and the GPU's idle time."""

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

SAMPLE_EVERY = 200  # ms between samples of nvidia-smi
SHIFT = 1e-6  # cm, change of a body that makes the draper treat it as another body
QUEUED = 256  # requests in the queue: more than a GPU drapes at a time


def own_rate(config: MakeConfig, *, prepared: int, warm: int, seconds: float, pictured: bool = False) -> float:
    """Garments per second of one draping process with a queue that never runs empty.

    ``prepared`` designs are repeated, on bodies that the draper has not seen; the first ``warm`` garments are not
    counted.
    """
    counted = 0
    worn = [worn for number in range(prepared) for worn in prepare(1, number, config).dressed]
    jobs = [
        DrapeJob(one.box_mesh, one.body, one.size, coarse=one.coarse, start=one.start) for one in worn if one.box_mesh
    ]
    picture = config.picture if pictured else 0
    with SharedDraper(address_for(devices_of(config)[0])) as draper:
        requests = (DrapeRequest(number, _on_new_body(job, number), picture) for number, job in enumerate(cycle(jobs)))
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


def _on_new_body(job: DrapeJob, number: int) -> DrapeJob:
    """The job on a slightly moved body: the draper caches data per body, and a data set has a new body per job."""
    return replace(job, body=replace(job.body, vertices=job.body.vertices + SHIFT * number))


@contextmanager
def gpu_idle(device: str) -> Iterator[list[float]]:
    """Context manager: a list that afterwards holds the GPU's share of idle time; empty without a GPU."""
    idle: list[float] = []
    if device == "cpu" or shutil.which("nvidia-smi") is None:
        yield idle
        return
    number = device.partition(":")[2] or "0"
    command = ["nvidia-smi", "-i", number, "--query-gpu=utilization.gpu", "--format=csv,noheader,nounits"]
    smi = subprocess.Popen([*command, "-lms", str(SAMPLE_EVERY)], stdout=subprocess.PIPE, text=True)
    percent: list[float] = []

    def listen() -> None:
        assert smi.stdout is not None
        percent.extend(float(line) for line in smi.stdout if line.strip().isdigit())

    thread = threading.Thread(target=listen)
    thread.start()
    try:
        yield idle
    finally:
        smi.terminate()
        thread.join()
        smi.wait()
        if percent:
            idle.append(1 - float(np.mean(percent)) / 100)
