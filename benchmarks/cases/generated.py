"""Fresh garments that reach a training loop: how many a second, and how long a training waits for them.

    python -m benchmarks.run generated --device cuda:0 --workers 14 --seconds 20 --warm 300

Workers make them ahead, as ``FreshGarments`` does; the loop puts them into batches. The clock starts when ``--warm``
garments have come: kernels are loaded then, and every worker is at work. ``own_per_second``, of draped garments: what
one draping process gives when prepared garments never run out, measured after the loop has ended; ``share``: what of
that reached the loop, which two such processes on each GPU feed.

On a GPU with box meshes or drapes two networks are trained then, on each garment ``--replay`` times, to tell the body
in the garment. ``small``: a few layers on each point. ``large``: a transformer of as many layers as it takes for a step
to last longer than the making of the garments that it asks for, timed before on a batch that is there. ``*_waits``: the
share of time in which a network has no batch; ``*_gpu_idle``: the mean of what nvidia-smi tells, whoever uses the GPU.
"""

import argparse
import time
from collections.abc import Iterator
from itertools import pairwise
from typing import Any

import torch
from torch import nn

from benchmarks.cases.figures import Figure, Measured
from benchmarks.draper import gpu_idle, own_rate
from gcd_dataset.errors import ConfigError
from gcd_dataset.generator.recipe import devices_of
from gcd_dataset.loaders import FreshGarments, GarmentLoader, GeneratedGarments

__all__ = ["add_arguments", "run"]

MANY = 10**6  # garments: more than any run makes
FIELDS = {"pattern": ("panels", "edges", "stitches", "body"), "mesh": ("points", "body", "box", "faces")}
FIELDS["drape"] = ("points", "body", "verts", "faces")
LAYERS = (1, 2, 4, 8, 16, 32, 64)  # of the large network: 3 million weights each
SLOWER = 1.25  # by which a step of it is longer than the garments of the step take


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
    parser.add_argument("--prepared", type=int, default=32, help="different garments for the draper's own rate")
    parser.add_argument("--replay", type=float, default=8.0, help="times the networks see a garment")


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
    devices = devices_of(garments.config)
    on_gpu = devices[0] != "cpu"
    with gpu_idle(garments.config.device) as idle:
        first, rate = _rate(garments, options)
    figures = [Figure("first_batch_s", first, "s"), Figure("per_second", rate, "garments")]
    figures += [Figure("gpu_idle_alone", idle[0], "of the time, nothing is trained")] if idle else []
    if options.stage == "drape" and on_gpu:
        own = own_rate(garments.config, prepared=options.prepared, warm=options.warm, seconds=options.seconds)
        figures += [
            Figure("own_per_second", own, "garments, by one draping process"),
            Figure("share", rate / own / len(devices), "of the draping processes' own rate, one for each GPU"),
        ]
    if options.stage != "pattern" and on_gpu:
        figures += _trained(garments, options, rate, devices[0])
    return Measured(figures)


def _rate(garments: GeneratedGarments, options: argparse.Namespace) -> tuple[float, float]:
    """Seconds until the first batch, and garments a second that reach the loop."""
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
    """The batches of a loop; with ``replay`` the buffer is full when ``--warm`` garments have been given."""
    room = options.batch if replay == 1 else max(options.warm, 1)
    fresh = FreshGarments(garments, replay=replay, room=room, workers=options.workers)
    return iter(GarmentLoader(fresh, options.batch, shuffle=False, rank=0, world_size=1))


def _pass_warm(batches: Iterator[Any], options: argparse.Namespace) -> None:
    for _ in range(-(-options.warm // options.batch)):
        next(batches)


def _trained(garments: GeneratedGarments, options: argparse.Namespace, rate: float, name: str) -> list[Figure]:
    """A small network, then one that garments coming at ``rate`` are enough for, on the same stream."""
    device = torch.device(name)
    batches = _batches(garments, options, replay=options.replay)
    first = next(batches)
    outputs = first["body"].reshape(options.batch, -1).shape[1]
    # Chosen before the rest: the small network then uses up the garments that were made meanwhile.
    least = SLOWER * options.batch / (rate * options.replay)
    large, layers, seconds = _large(outputs, first, device, options.batch, least)
    weights = sum(weight.numel() for weight in large.parameters()) / 1e6
    _pass_warm(batches, options)
    with gpu_idle(garments.config.device) as idle:
        figures = _waits("small", _PointNet(outputs), batches, device, options)
    figures += [Figure("small_gpu_idle", idle[0], "of the time")] if idle else []
    figures += [
        Figure("large_layers", layers, f"of a transformer, {weights:.0f} million weights"),
        Figure("large_step_s", seconds, "s, with the batch there"),
    ]
    with gpu_idle(garments.config.device) as idle:
        figures += _waits("large", large, batches, device, options)
    return figures + ([Figure("large_gpu_idle", idle[0], "of the time")] if idle else [])


def _waits(
    name: str, net: nn.Module, batches: Iterator[Any], device: torch.device, options: argparse.Namespace
) -> list[Figure]:
    """How many steps a network takes, and the share of the time in which it waits for a batch."""
    training = _Training(net, device, options.batch)
    training.step(next(batches))
    begun, waited, steps = time.perf_counter(), 0.0, 0
    while time.perf_counter() - begun < options.seconds:
        asked = time.perf_counter()
        batch = next(batches)
        waited += time.perf_counter() - asked
        training.step(batch)
        steps += 1
    seconds = time.perf_counter() - begun
    return [
        Figure(f"{name}_steps_per_second", steps / seconds, f"of {options.batch} garments"),
        Figure(f"{name}_fresh_per_second", steps * options.batch / options.replay / seconds, "garments"),
        Figure(f"{name}_waits", waited / seconds, "of the time"),
    ]


def _large(outputs: int, batch: Any, device: torch.device, size: int, least: float) -> tuple[nn.Module, int, float]:
    """The smallest transformer of which a step takes ``least`` seconds, or the largest; its layers, and its seconds."""
    for layers in LAYERS:
        net = _Transformer(outputs, layers)
        training = _Training(net, device, size)
        training.step(batch)
        begun = time.perf_counter()
        for _ in range(3):
            training.step(batch)
        seconds = (time.perf_counter() - begun) / 3
        if seconds >= least:
            break
    return net, layers, seconds


class _Training:
    """Steps of a network."""

    def __init__(self, net: nn.Module, device: torch.device, batch: int) -> None:
        self._net, self._device, self._batch = net.to(device), device, batch
        self._chosen = torch.optim.Adam(net.parameters())

    def step(self, batch: Any) -> None:
        """From the surface points to the body's shape."""
        points = batch["points"].to(self._device, non_blocking=True).float().reshape(self._batch, -1, 6) / 100
        body = batch["body"].to(self._device, non_blocking=True).reshape(self._batch, -1)
        self._chosen.zero_grad()
        loss = nn.functional.mse_loss(self._net(points), body)
        loss.backward()  # type: ignore[no-untyped-call]
        self._chosen.step()
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


class _Transformer(nn.Module):
    """Points in groups of 16, each group a token of 512 numbers."""

    def __init__(self, outputs: int, layers: int) -> None:
        super().__init__()
        self.token = nn.Linear(16 * 6, 512)
        layer = nn.TransformerEncoderLayer(512, 8, 2048, dropout=0.0, batch_first=True)
        self.layers = nn.TransformerEncoder(layer, layers)
        self.all = nn.Linear(512, outputs)

    def forward(self, points: torch.Tensor) -> torch.Tensor:
        """[B, n, 6] to [B, outputs]."""
        return self.all(self.layers(self.token(points.reshape(len(points), -1, 16 * 6))).mean(dim=1))
