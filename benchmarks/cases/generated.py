"""Fresh garments that reach a training loop: how many a second, and how far a GPU is kept busy with them.

    python -m benchmarks.run generated --stage drape --workers 14 --seconds 60 --device cuda:0

Workers make them ahead, as ``FreshGarments`` does; the loop puts them into batches. The clock starts when ``--warm``
garments have come: kernels are loaded then, and every worker is at work. ``own_per_second``, of draped garments: what
the draping process gives when prepared garments never run out, measured after the loop has ended; ``share``: what of
that reached the loop. On a GPU with box meshes or drapes a small network is trained in a second run, on each garment
``--replay`` times: ``train_waits``: the share of time in which it has no batch; ``gpu_idle``: the mean of what
nvidia-smi tells, whoever uses the GPU.
"""

import argparse
import time
from itertools import pairwise
from typing import Any

import torch
from torch import nn

from benchmarks.cases.figures import Figure, Measured
from benchmarks.draper import gpu_idle, own_rate
from gcd_dataset.errors import ConfigError
from gcd_dataset.loaders import FreshGarments, GarmentLoader, GeneratedGarments

__all__ = ["add_arguments", "run"]

MANY = 10**6  # garments: more than any run makes
FIELDS = {"pattern": ("panels", "edges", "stitches", "body"), "mesh": ("points", "body", "box", "faces")}
FIELDS["drape"] = ("points", "body", "verts", "faces")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The options of the case."""
    parser.add_argument("--stage", choices=("pattern", "mesh", "drape"), default="drape")
    parser.add_argument("--workers", type=int, default=2, help="processes that make garments")
    parser.add_argument("--seconds", type=float, default=30.0, help="of each measurement")
    parser.add_argument("--device", default="auto", help="where cloth is draped and the network is trained")
    parser.add_argument("--resolution", type=float, default=1.0, help="[cm]")
    parser.add_argument("--picture", type=int, default=512, help="side of the pictures [pixels]; 0 for none")
    parser.add_argument("--batch", type=int, default=8, help="garments in a batch of the loop")
    parser.add_argument("--warm", type=int, default=64, help="garments that come before the clock starts")
    parser.add_argument("--prepared", type=int, default=64, help="different garments for the draper's own rate")
    parser.add_argument("--replay", type=float, default=8.0, help="times the network sees a garment")


def run(options: argparse.Namespace) -> Measured:
    """Make, count, train. Raises ``ConfigError`` for no time, or nothing to make."""
    if options.seconds <= 0 or min(options.workers, options.warm) < 0 or min(options.batch, options.prepared) < 1:
        raise ConfigError("give --seconds above 0, --workers and --warm of 0 or more, --batch and --prepared of 1")
    garments = GeneratedGarments(
        MANY,
        stage=options.stage,
        device=options.device,
        resolution=options.resolution,
        picture=options.picture,
        fields=FIELDS[options.stage],
    )
    on_gpu = garments.config.device != "cpu"
    with gpu_idle(garments.config.device) as idle:
        rate = _rate(garments, options)
    figures = [Figure("per_second", rate, "garments")]
    figures += [Figure("gpu_idle_alone", idle[0], "of the time, nothing is trained")] if idle else []
    if options.stage == "drape" and on_gpu:
        own = own_rate(garments.config, prepared=options.prepared, warm=options.warm, seconds=options.seconds)
        figures += [Figure("own_per_second", own, "garments"), Figure("share", rate / own, "of the draper's own rate")]
    if options.stage != "pattern" and on_gpu:
        with gpu_idle(garments.config.device) as idle:
            figures += _trained(garments, options)
        figures += [Figure("gpu_idle", idle[0], "of the time, a network is trained")] if idle else []
    return Measured(figures)


def _rate(garments: GeneratedGarments, options: argparse.Namespace) -> float:
    """Garments a second that reach the loop."""
    fresh = FreshGarments(garments, room=options.batch, workers=options.workers)
    batches = iter(GarmentLoader(fresh, options.batch, shuffle=False, rank=0, world_size=1))
    for _ in range(-(-options.warm // options.batch)):
        next(batches)
    begun, count = time.perf_counter(), 0
    while time.perf_counter() - begun < options.seconds:
        next(batches)
        count += options.batch
    return count / (time.perf_counter() - begun)


def _trained(garments: GeneratedGarments, options: argparse.Namespace) -> list[Figure]:
    """A network is trained on the surface points, to tell the body in the garment."""
    device = torch.device(garments.config.device)
    fresh = FreshGarments(garments, replay=options.replay, room=options.warm or 1, workers=options.workers)
    batches = iter(GarmentLoader(fresh, options.batch, shuffle=False, rank=0, world_size=1))
    first = next(batches)
    net = _PointNet(first["body"].reshape(options.batch, -1).shape[1]).to(device)
    chosen = torch.optim.Adam(net.parameters())
    _step(net, chosen, first, device, options.batch)
    begun, waited, steps = time.perf_counter(), 0.0, 0
    while time.perf_counter() - begun < options.seconds:
        asked = time.perf_counter()
        batch = next(batches)
        waited += time.perf_counter() - asked
        _step(net, chosen, batch, device, options.batch)
        steps += 1
    seconds = time.perf_counter() - begun
    return [
        Figure("train_steps_per_second", steps / seconds, f"of {options.batch} garments"),
        Figure("train_fresh_per_second", steps * options.batch / options.replay / seconds, "garments"),
        Figure("train_waits", waited / seconds, "of the time"),
    ]


def _step(net: nn.Module, chosen: torch.optim.Optimizer, batch: Any, device: torch.device, count: int) -> None:
    points = batch["points"].to(device, non_blocking=True).float().reshape(count, -1, 6) / 100
    body = batch["body"].to(device, non_blocking=True).reshape(count, -1)
    chosen.zero_grad()
    loss = nn.functional.mse_loss(net(points), body)
    loss.backward()  # type: ignore[no-untyped-call]
    chosen.step()
    loss.item()  # waits for the GPU, so that what follows is counted as waiting for garments alone


class _PointNet(nn.Module):
    """Each point through the same layers, then the greatest of each feature."""

    def __init__(self, outputs: int) -> None:
        super().__init__()
        widths = (6, 128, 256, 1024)
        layers = [part for a, b in pairwise(widths) for part in (nn.Linear(a, b), nn.ReLU())]
        self.each = nn.Sequential(*layers)
        self.all = nn.Sequential(nn.Linear(widths[-1], 256), nn.ReLU(), nn.Linear(256, outputs))

    def forward(self, points: torch.Tensor) -> torch.Tensor:
        """[B, n, 6] to [B, outputs]."""
        return self.all(self.each(points).amax(dim=1))
