"""Train a network that sees points of a garment's box mesh and says its panels; score it on garments it has not seen.

    python -m benchmarks.reconstruction.train --smoke         about a minute on two cores
    python -m benchmarks.reconstruction.train --workers 16    one GPU, some minutes

Garments are made on the spot and read once through a ``DataLoader``; what training needs of them then stays in memory,
on the device, since a network reads them faster than anyone can make them. The test set is other indices of the same
seed: other bodies and designs from the same wardrobe, so a garment like the test garment may well be in the training
set. How far that alone leads is what the nearest neighbour tells.
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
WARM_UP = 0.05  # of the steps, in which the learning rate rises
WEIGHT_DECAY = 0.05
LARGEST_GRADIENT = 1.0
TOLD_EVERY = 50  # steps, or batches of garments


def add_arguments(parser: argparse.ArgumentParser) -> None:
    def option(name: str, default: Any, text: str) -> None:
        parser.add_argument(name, type=type(default), default=default, help=f"{text} ({default})")

    parser.add_argument("--smoke", action="store_true", help="a few hundred garments and a tiny network, for two cores")
    option("--train", 20_000, "garments to train on")
    option("--test", 500, "garments to test on: the indices behind them")
    option("--seed", 0, "of the garments, the network and the order")
    option("--design", "", "TOML file that narrows what garments are drawn")
    option("--resolution", 2.0, "of the box meshes that points are taken from [cm]")
    option("--workers", 0, "processes that make garments, and that score patterns")
    option("--cache-dir", "", "keeps the garments for the next run")
    option("--device", "auto", "auto, cpu or cuda:0")
    option("--threads", 0, "of torch on a CPU; 0 leaves it to torch, 1 is best for tiny networks on a busy machine")
    option("--steps", 6_000, "of the optimiser")
    option("--batch", 256, "garments a step")
    option("--lr", 5e-4, "learning rate at its highest")
    option("--points", 2_048, "points of a garment that a step sees, drawn anew each time")
    option("--stored-points", 4_096, "points of a garment that they are drawn from, 8192 at most")
    option("--queries", 40, "panels that the network can find")
    option("--contour-points", 64, "points of a panel's outline")
    option("--tokens", 256, "regions that the points are gathered in")
    option("--neighbours", 32, "points in a region")
    option("--width", 384, "features of a token")
    option("--heads", 6, "of each attention")
    option("--layers", 6, "of the encoder, and of the decoder")
    option("--nearest-points", 512, "points that garments are compared by for the nearest neighbour")
    option("--typical", 500, "training garments among which the most typical one is sought")


def run(args: argparse.Namespace) -> Measured:
    """Make or read the garments, train, evaluate."""
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
        Figure("first_loss", float(np.mean(losses[:TOLD_EVERY])), f"a step, the first {TOLD_EVERY}"),
        Figure("last_loss", float(np.mean(losses[-TOLD_EVERY:])), f"a step, the last {TOLD_EVERY}"),
    ]

    start = _clocks()
    measured = evaluate(net, known, unseen, arrays, args, device)
    spent += _spent("evaluate", start, per=len(unseen), unit="garments")
    return Measured([*spent, *learnt, *measured.figures], measured.rows)


# --------------------------------------------------------------------------------------------------------- the garments


def load(args: argparse.Namespace) -> tuple[GarmentBatch, list[Arrays]]:
    """Garments to train on, and behind them those to test on; with their patterns as arrays."""
    dataset = GeneratedGarments(
        args.train + args.test,
        args.seed,
        drape=None,
        resolution=args.resolution,
        cache_dir=args.cache_dir or None,
        design=read_overlay(args.design) if args.design else None,
        fields=FIELDS,
        transform=ToTargets(args.queries, args.contour_points, args.stored_points),
        dtype=None,  # arcs are decoded from the ends of their edges, which takes every digit
    )
    loader = DataLoader(dataset, batch_size=32, num_workers=args.workers, collate_fn=collate)
    parts, arrays = [], []
    for part, several in loader:
        parts.append(part)
        arrays += several
        if len(parts) % TOLD_EVERY == 0 or len(arrays) == len(dataset):
            _tell(f"{len(arrays)} of {len(dataset)} garments")
    return GarmentBatch.join(parts), arrays


# --------------------------------------------------------------------------------------------------------- the training


def train(known: GarmentBatch, args: argparse.Namespace, device: torch.device, losses: list[float]) -> PatternNet:
    """A network trained on the garments; the loss of every step is added to ``losses``."""
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
        if (step + 1) % TOLD_EVERY == 0:
            _tell(f"step {step + 1} of {args.steps}, loss {np.mean(losses[-TOLD_EVERY:]):.3f}: {_listed(parts)}")
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
    """Share of the highest rate: up in a line, then down in half a cosine."""
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
    """The network beside what can be had without one, and beside the best that its form of answer allows."""
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
    everyone = [pattern for answer in answers.values() for pattern in answer]
    all_scores = scores_of(everyone, patterns * len(answers), workers=args.workers)  # one start of the processes
    for number, (who, answer) in enumerate(answers.items()):
        scores = all_scores[number * len(patterns) : (number + 1) * len(patterns)]
        seams = any(pattern.seams for pattern in answer)
        figures += figures_of(who, scores, seams=seams)
        rows.append(row_of(who, scores, seams=seams))
    return Measured(figures, rows)


def _commonest_count(known: list[Arrays], unseen: list[Pattern]) -> Figure:
    """How often one is right about the number of panels who always says the commonest one."""
    counts = Counter(len(panels) for panels, _, _ in known)
    commonest = counts.most_common(1)[0][0]
    right = float(np.mean([len(pattern.panels) == commonest for pattern in unseen]))
    return Figure("commonest_panel_count_acc", right, "share")


# -------------------------------------------------------------------------------------------------------------- helpers


def _clocks() -> tuple[float, float]:
    """Seconds on the wall, and of all processors by this process and those it has ended."""
    return time.perf_counter(), sum(times()[:4])


def _spent(what: str, start: tuple[float, float], *, per: int, unit: str) -> list[Figure]:
    if torch.cuda.is_available():
        torch.cuda.synchronize()
    wall, cpu = (now - then for now, then in zip(_clocks(), start, strict=True))
    rate = Figure(f"{what}_rate", per / wall, f"{unit}/s")
    return [Figure(f"{what}_s", wall, "s"), Figure(f"{what}_cpu_s", cpu, "s"), rate]


def _listed(parts: dict[str, torch.Tensor]) -> str:
    return ", ".join(f"{name} {value.item():.3f}" for name, value in parts.items())


def _tell(text: str) -> None:
    print(text, file=sys.stderr, flush=True)


if __name__ == "__main__":
    from benchmarks.run import main

    sys.exit(main(["reconstruction", *sys.argv[1:]]))
