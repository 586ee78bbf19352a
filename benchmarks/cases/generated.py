"""Fresh garments in a training loop: garments per second, and the time that the training waits for them.

    python -m benchmarks.run generated --device cuda:0 --workers 14 --seconds 20 --warm 1700

Workers make garments ahead of a loop that collates them, as ``FreshGarments`` does. The clock starts after ``--warm``
garments: kernels are then loaded, and each worker has garments in store, without which a loop waits for the slowest
worker (``READY`` and ``AHEAD`` of ``generator.maker``: 120 garments a worker). ``own_per_second``, for draped garments,
is the rate of one draping process with unlimited prepared garments, measured after the loop; ``share`` is the loop's
rate divided by it, with two such processes per GPU feeding the loop.

On a GPU, with box meshes or drapes, a network of a few layers per point is then trained to predict the body from the
garment, with each garment replayed ``--replay`` times. ``small_waits``: the share of time in which it has no batch;
``*gpu_idle*``: from the mean utilisation that nvidia-smi reports, of all processes.
"""

import argparse
import time
from collections.abc import Iterator
from itertools import pairwise
from typing import Any

import torch
from torch import nn

from benchmarks.cases import CaseResult, Figure
from benchmarks.cases.scale import gpu_load, own_rate
from gcd_dataset.errors import ConfigError
from gcd_dataset.generator.recipe import devices_of
from gcd_dataset.loaders import FreshGarments, GarmentLoader, GeneratedGarments

COUNT = 10**6  # garments, more than any run makes
FIELDS = {"pattern": ("panels", "edges", "stitches", "body"), "mesh": ("points", "body", "box", "faces")}
FIELDS["drape"] = ("points", "body", "verts", "faces")
ROOM = 256  # garments that a training uses in turn


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--stage", choices=("pattern", "mesh", "drape"), default="drape")
    parser.add_argument("--workers", type=int, default=2, help="processes that make garments")
    parser.add_argument("--seconds", type=float, default=30.0, help="duration of each measurement")
    parser.add_argument("--device", default="auto", help="where cloth is draped and the network is trained")
    parser.add_argument("--resolution", type=float, default=1.0, help="[cm]")
    parser.add_argument("--picture", type=int, default=512, help="side of the pictures [pixels]; 0 for none")
    parser.add_argument("--batch", type=int, default=8, help="garments in a batch of the loop")
    parser.add_argument("--warm", type=int, default=64, help="garments before the clock starts")
    parser.add_argument("--prepared", type=int, default=32, help="distinct designs for the draper's own rate")
    parser.add_argument("--replay", type=float, default=8.0, help="uses of each garment by the network")


def run(options: argparse.Namespace) -> CaseResult:
    """Measure the loop, the draper and the network. Raises ``ConfigError`` for options out of range."""
    if options.seconds <= 0 or min(options.workers, options.warm) < 0 or min(options.batch, options.prepared) < 1:
        raise ConfigError("give --seconds above 0, --workers and --warm of 0 or more, --batch and --prepared of 1")
    garments = GeneratedGarments(
        COUNT,
        stage=options.stage,
        device=options.device,
        resolution=options.resolution,
        picture=options.picture,
        fields=FIELDS[options.stage],
    )
    devices = devices_of(garments.config)
    on_gpu = devices[0] != "cpu"
    with gpu_load(garments.config.device) as load:
        first, rate = _rate(garments, options)
    figures = [Figure("first_batch_s", first, "s"), Figure("per_second", rate, "garments")]
    figures += [Figure("gpu_idle_alone", load.idle, "of the time, nothing is trained")] if load.watts else []
    if options.stage == "drape" and on_gpu:
        own = own_rate(garments.config, prepared=options.prepared, warm=256, seconds=options.seconds)
        figures += [
            Figure("own_per_second", own, "garments, by one draping process"),
            Figure("share", rate / own / len(devices), "of the draping processes' own rate, one for each GPU"),
        ]
    if options.stage != "pattern" and on_gpu:
        figures += _trained(garments, options, devices[0])
    return CaseResult(figures)


def _rate(garments: GeneratedGarments, options: argparse.Namespace) -> tuple[float, float]:
    """Seconds until the first batch, and garments per second in the loop."""
    begun = time.perf_counter()
    batches = _batches(garments, options, replay=1.0)
    next(batches)
    first = time.perf_counter() - begun
    _pass_warm(batches, options)
    begun, count = time.perf_counter(), 0
    while time.perf_counter() - begun < options.seconds:
        next(batches)
        count += options.batch
    return first, count / (time.perf_counter() - begun)


def _batches(garments: GeneratedGarments, options: argparse.Namespace, *, replay: float) -> Iterator[Any]:
    """Batches of the loop; if garments are replayed, from a buffer."""
    room = options.batch if replay == 1 else ROOM
    fresh = FreshGarments(garments, replay=replay, room=room, workers=options.workers)
    return iter(GarmentLoader(fresh, options.batch, shuffle=False, rank=0, world_size=1))


def _pass_warm(batches: Iterator[Any], options: argparse.Namespace, *, replay: float = 1.0) -> None:
    for _ in range(int(options.warm * replay) // options.batch):
        next(batches)


def _trained(garments: GeneratedGarments, options: argparse.Namespace, name: str) -> list[Figure]:
    """Steps per second of the network, and the share of time in which it waits for a batch."""
    device = torch.device(name)
    batches = _batches(garments, options, replay=options.replay)
    first = next(batches)
    training = _Training(_PointNet(first["body"].reshape(options.batch, -1).shape[1]), device, options.batch)
    _pass_warm(batches, options, replay=options.replay)
    with gpu_load(garments.config.device) as load:
        training.step(next(batches))
        begun, waited, steps = time.perf_counter(), 0.0, 0
        while time.perf_counter() - begun < options.seconds:
            asked = time.perf_counter()
            batch = next(batches)
            waited += time.perf_counter() - asked
            training.step(batch)
            steps += 1
        seconds = time.perf_counter() - begun
    figures = [
        Figure("small_steps_per_second", steps / seconds, f"of {options.batch} garments"),
        Figure("small_fresh_per_second", steps * options.batch / options.replay / seconds, "garments"),
        Figure("small_waits", waited / seconds, "of the time"),
    ]
    return figures + ([Figure("small_gpu_idle", load.idle, "of the time")] if load.watts else [])


class _Training:
    """Optimiser steps of a network."""

    def __init__(self, net: nn.Module, device: torch.device, batch: int) -> None:
        self._net, self._device, self._batch = net.to(device), device, batch
        self._optimizer = torch.optim.Adam(net.parameters())

    def step(self, batch: Any) -> None:
        """One step: predict the body's shape weights from the surface points."""
        points = batch["points"].to(self._device, non_blocking=True).float().reshape(self._batch, -1, 6) / 100
        body = batch["body"].to(self._device, non_blocking=True).reshape(self._batch, -1)
        self._optimizer.zero_grad()
        loss = nn.functional.mse_loss(self._net(points), body)
        loss.backward()  # type: ignore[no-untyped-call]
        self._optimizer.step()
        loss.item()  # synchronises, so that later waits are for garments only


class _PointNet(nn.Module):
    """A shared network per point, then the maximum over points."""

    def __init__(self, outputs: int) -> None:
        super().__init__()
        widths = (6, 128, 256, 1024)
        layers = [part for a, b in pairwise(widths) for part in (nn.Linear(a, b), nn.ReLU())]
        self.each = nn.Sequential(*layers)
        self.all = nn.Sequential(nn.Linear(widths[-1], 256), nn.ReLU(), nn.Linear(256, outputs))

    def forward(self, points: torch.Tensor) -> torch.Tensor:
        """[B, n, 6] to [B, outputs]."""
        return self.all(self.each(points).amax(dim=1))
