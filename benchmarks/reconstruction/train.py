"""Train a network to predict panels from surface points of a garment's box mesh, and score it on test garments.

    python -m benchmarks.reconstruction.train --smoke         about a minute on two cores
    python -m benchmarks.reconstruction.train --workers 16    one GPU, some minutes

Garments are generated and read once through a ``DataLoader``; the training set then stays on the device, since the
network consumes it faster than it could be made. The test set has other indices of the same seed: other bodies and
designs from the same design space, so a training garment may be similar to a test garment. The nearest-neighbour
reference shows the score that this similarity alone achieves.
"""

import argparse
import math
import sys
import time
from collections import Counter
from contextlib import AbstractContextManager, nullcontext
from dataclasses import replace
from os import times
from typing import Any

import numpy as np
import torch
from torch.utils.data import DataLoader

from benchmarks.cases.figures import Figure, Measured
from benchmarks.reconstruction.data import FIELDS, Arrays, GarmentBatch, ToTargets, collate, pattern_of, patterns_from
from benchmarks.reconstruction.evaluate import figures_of, predict, row_of, scores_of
from benchmarks.reconstruction.models import NetConfig, PatternNet, set_loss
from benchmarks.reconstruction.nearest import most_typical, nearest_garments
from gcd_dataset.generator import read_overlay
from gcd_dataset.loaders import GeneratedGarments
from gcd_dataset.records import Pattern

__all__ = ["add_arguments", "run", "train"]

SMOKE: dict[str, Any] = {
    "train": 240, "test": 60, "threads": 1, "resolution": 4.0, "steps": 300, "batch": 16, "lr": 2e-3, "width": 64,
    "heads": 4, "layers": 2, "tokens": 32, "neighbours": 16, "points": 256, "stored_points": 1024, "queries": 40,
    "nearest_points": 256, "typical": 60,
}  # fmt: skip
WARM_UP = 0.05  # share of the steps in which the learning rate rises
WEIGHT_DECAY = 0.05
LARGEST_GRADIENT = 1.0
LOG_EVERY = 50  # steps, or batches of garments


def add_arguments(parser: argparse.ArgumentParser) -> None:
    def option(name: str, default: Any, text: str) -> None:
        parser.add_argument(name, type=type(default), default=default, help=f"{text} ({default})")

    parser.add_argument("--smoke", action="store_true", help="a few hundred garments and a tiny network, for two cores")
    option("--train", 20_000, "garments to train on")
    option("--test", 500, "garments to test on: the following indices")
    option("--seed", 0, "seed of the garments, the network and the order")
    option("--design", "", "TOML file that restricts the designs")
    option("--resolution", 2.0, "edge length of the box meshes [cm]")
    option("--workers", 0, "processes for making garments and scoring patterns")
    option("--cache-dir", "", "folder that caches the garments")
    option("--device", "auto", "auto, cpu or cuda:0")
    option("--threads", 0, "torch's CPU threads; 0 for its default, 1 is best for tiny networks on a busy machine")
    option("--steps", 6_000, "optimiser steps")
    option("--batch", 256, "garments per step")
    option("--lr", 5e-4, "highest learning rate")
    option("--points", 2_048, "points per garment and step, redrawn for each step")
    option("--stored-points", 4_096, "points per garment to draw from, at most 8192")
    option("--queries", 40, "most panels of a prediction")
    option("--contour-points", 64, "points of a panel's outline")
    option("--tokens", 256, "regions of points")
    option("--neighbours", 32, "points in a region")
    option("--width", 384, "features of a token")
    option("--heads", 6, "heads per attention layer")
    option("--layers", 6, "layers of the encoder, and of the decoder")
    option("--nearest-points", 512, "points per garment for the nearest neighbour")
    option("--typical", 500, "training garments to choose the most typical one from")


def run(args: argparse.Namespace) -> Measured:
    """Load the garments, train, evaluate."""
    if args.smoke:
        args = argparse.Namespace(**{**vars(args), **SMOKE})
    device = torch.device(("cuda:0" if torch.cuda.is_available() else "cpu") if args.device == "auto" else args.device)

    if args.threads:
        torch.set_num_threads(args.threads)

    start = _clocks()
    garments, arrays = load(args)
    spent = _spent("load", start, per=len(garments), unit="garments")

    start = _clocks()
    losses: list[float] = []
    known, unseen = garments[: args.train].to(device), garments[args.train :]
    net = train(known, args, device, losses)
    spent += _spent("train", start, per=args.steps, unit="steps")
    learnt = [
        Figure("parameters", sum(parameter.numel() for parameter in net.parameters()), "numbers"),
        Figure("first_loss", float(np.mean(losses[:LOG_EVERY])), f"a step, the first {LOG_EVERY}"),
        Figure("last_loss", float(np.mean(losses[-LOG_EVERY:])), f"a step, the last {LOG_EVERY}"),
    ]

    start = _clocks()
    measured = evaluate(net, known, unseen, arrays, args, device)
    spent += _spent("evaluate", start, per=len(unseen), unit="garments")
    return Measured([*spent, *learnt, *measured.figures], measured.rows)


# --------------------------------------------------------------------------------------------------------- the garments


def load(args: argparse.Namespace) -> tuple[GarmentBatch, list[Arrays]]:
    """Training garments followed by test garments, with their patterns as arrays."""
    dataset = GeneratedGarments(
        args.train + args.test,
        args.seed,
        drape=None,
        resolution=args.resolution,
        cache_dir=args.cache_dir or None,
        design=read_overlay(args.design) if args.design else None,
        fields=FIELDS,
        transform=ToTargets(args.queries, args.contour_points, args.stored_points),
        dtype=None,  # arcs are decoded from the ends of their edges, which needs float64
    )
    loader = DataLoader(dataset, batch_size=32, num_workers=args.workers, collate_fn=collate)
    parts, arrays = [], []
    for part, pattern_arrays in loader:
        parts.append(part)
        arrays += pattern_arrays
        if len(parts) % LOG_EVERY == 0 or len(arrays) == len(dataset):
            _log(f"{len(arrays)} of {len(dataset)} garments")
    return GarmentBatch.join(parts), arrays


# --------------------------------------------------------------------------------------------------------- the training


def train(known: GarmentBatch, args: argparse.Namespace, device: torch.device, losses: list[float]) -> PatternNet:
    """Train a network on the garments; appends each step's loss to ``losses``."""
    torch.manual_seed(args.seed)
    net = PatternNet(net_config(args)).to(device)
    chance = torch.Generator().manual_seed(args.seed)
    optimizer = torch.optim.AdamW(net.parameters(), lr=args.lr, weight_decay=WEIGHT_DECAY)
    schedule = torch.optim.lr_scheduler.LambdaLR(optimizer, lambda step: learning_rate(step, args.steps))
    net.train()
    for step in range(args.steps):
        rows = torch.randint(len(known), (args.batch,), generator=chance).to(device)
        batch = known[rows].with_points(args.points, chance)
        with _half_precision(device):
            predicted = net(batch.points)
        parts = set_loss(predicted, batch)
        loss = torch.stack(list(parts.values())).sum()
        optimizer.zero_grad()
        torch.autograd.backward(loss)
        torch.nn.utils.clip_grad_norm_(net.parameters(), LARGEST_GRADIENT)
        optimizer.step()
        schedule.step()
        losses.append(loss.item())
        if (step + 1) % LOG_EVERY == 0:
            _log(f"step {step + 1} of {args.steps}, loss {np.mean(losses[-LOG_EVERY:]):.3f}: {_listed(parts)}")
    return net


def net_config(args: argparse.Namespace) -> NetConfig:
    return NetConfig(
        queries=args.queries,
        contour_points=args.contour_points,
        tokens=args.tokens,
        neighbours=args.neighbours,
        width=args.width,
        heads=args.heads,
        layers=args.layers,
    )


def learning_rate(step: int, steps: int) -> float:
    """Learning rate relative to the highest: linear warm-up, then half a cosine."""
    rise = max(1, round(WARM_UP * steps))
    if step < rise:
        return (step + 1) / rise
    return 0.5 + 0.5 * math.cos(math.pi * (step - rise) / (steps - rise))


def _half_precision(device: torch.device) -> AbstractContextManager[Any]:
    return torch.autocast("cuda", torch.bfloat16) if device.type == "cuda" else nullcontext()


# ------------------------------------------------------------------------------------------------------- the evaluation


def evaluate(
    net: PatternNet,
    known: GarmentBatch,
    unseen: GarmentBatch,
    arrays: list[Arrays],
    args: argparse.Namespace,
    device: torch.device,
) -> Measured:
    """Score the network and the references."""
    patterns = [pattern_of(entry) for entry in arrays[args.train :]]
    near = args.nearest_points
    neighbours = nearest_garments(unseen.points[:, :near, :3].to(device).float(), known.points[:, :near, :3].float())
    typical = most_typical(known.points[: args.typical, :near, :3].float())
    seen = replace(unseen, points=unseen.points[:, : args.points])
    answers = {
        "network": predict(net, seen, batch=args.batch, device=device),
        "nearest": [pattern_of(arrays[row]) for row in neighbours.tolist()],
        "typical": [pattern_of(arrays[typical])] * len(patterns),
        "ceiling": patterns_from(unseen),
    }
    figures, rows = [_commonest_count(arrays[: args.train], patterns)], []
    predictions = [pattern for answer in answers.values() for pattern in answer]
    all_scores = scores_of(predictions, patterns * len(answers), workers=args.workers)  # in one pool of processes
    for number, (name, answer) in enumerate(answers.items()):
        scores = all_scores[number * len(patterns) : (number + 1) * len(patterns)]
        seams = any(pattern.seams for pattern in answer)
        figures += figures_of(name, scores, seams=seams)
        rows.append(row_of(name, scores, seams=seams))
    return Measured(figures, rows)


def _commonest_count(known: list[Arrays], unseen: list[Pattern]) -> Figure:
    """Share of test garments that have the most common number of panels."""
    counts = Counter(len(panels) for panels, _, _ in known)
    commonest = counts.most_common(1)[0][0]
    right = float(np.mean([len(pattern.panels) == commonest for pattern in unseen]))
    return Figure("commonest_panel_count_acc", right, "share")


# -------------------------------------------------------------------------------------------------------------- helpers


def _clocks() -> tuple[float, float]:
    """Wall time, and CPU time of this process and its ended children [s]."""
    return time.perf_counter(), sum(times()[:4])


def _spent(step: str, start: tuple[float, float], *, per: int, unit: str) -> list[Figure]:
    if torch.cuda.is_available():
        torch.cuda.synchronize()
    wall, cpu = (now - then for now, then in zip(_clocks(), start, strict=True))
    rate = Figure(f"{step}_rate", per / wall, f"{unit}/s")
    return [Figure(f"{step}_s", wall, "s"), Figure(f"{step}_cpu_s", cpu, "s"), rate]


def _listed(parts: dict[str, torch.Tensor]) -> str:
    return ", ".join(f"{name} {value.item():.3f}" for name, value in parts.items())


def _log(text: str) -> None:
    print(text, file=sys.stderr, flush=True)


if __name__ == "__main__":
    from benchmarks.run import main

    sys.exit(main(["reconstruction", *sys.argv[1:]]))
