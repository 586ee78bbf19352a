"""The gain by drawn pictures: one network, trained on three inputs, predicts panels from two pictures of a garment.

    python -m benchmarks.run pictures_matter --count 12 --steps 30 --size 64 --device cpu

The inputs show the same garments from the front and from behind:

- ``plain``: the stored pictures, fixed cameras, a colour for each panel; the same at every reading;
- ``grey``: grey cloth in studio light, cameras drawn anew for each reading;
- ``drawn``: cloth, prints, people, cameras, lights and places drawn anew for each reading.

Each network has the same first weights, steps and order of draws. All are tested on garments of other designs, as
``plain``, ``grey`` and ``drawn`` pictures and as ``held_out`` ones: prints (checks, tartan, flowers), kinds of cloth
(satin, crepe, flannel, ponte), skin tones, places (rooms), cameras (yaw, pitch, focal length) and lights (azimuth,
colour, contrast) that no training drew. ``gap_to_X_on_Y``: the score of the network trained on ``drawn`` minus that of
the network trained on X, both tested on Y, with a 95 % interval (bootstrap over garments, paired).

Pictures of ``grey`` and ``drawn`` are rendered during a training: ``--fresh`` new readings a step enter a pool on the
device, and each step draws its batch from the pool.
"""

import argparse
import csv
import json
import sys
import time
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import astuple, dataclass, fields
from functools import partial
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np
import torch
from jaxtyping import Int, UInt8
from torch import Tensor

from benchmarks.cases import CaseResult, Figure
from benchmarks.reconstruction import training
from benchmarks.reconstruction.models.panel_set import answers_of, set_loss
from benchmarks.reconstruction.models.picture_set import PictureSet, PictureTargets
from benchmarks.reconstruction.panel_net import NetConfig
from benchmarks.reconstruction.panel_targets import PanelTargets, ToTargets, patterns_from
from benchmarks.reconstruction.picture_inputs import SIDES, Input, Rendered, load_garment, rendering, views_of
from benchmarks.reconstruction.picture_model import STRIDE, PictureNet
from benchmarks.reconstruction.training import Check, TrainConfig
from gcd_dataset import Progress, generate
from gcd_dataset.errors import ConfigError
from gcd_dataset.files import write_whole
from gcd_dataset.generator import MakeConfig, read_overlay
from gcd_dataset.generator.device import cores
from gcd_dataset.generator.drape import resolve_device
from gcd_dataset.generator.drawing import contact_sheet, jpeg_bytes
from gcd_dataset.generator.garments.overlay import NO_OVERLAY
from gcd_dataset.generator.render import render
from gcd_dataset.metrics import PatternScore, bootstrap_interval, mean_scores
from gcd_dataset.records import Pattern
from gcd_dataset.scoring.garments import scores_of
from gcd_dataset.scoring.table import UNITS
from gcd_dataset.shards import ShardReader
from gcd_dataset.workers import parallel_map

INPUTS = (Input.DRAWN, Input.PLAIN, Input.GREY)  # in the order of training: the slowest decides the number of steps
LOOP: Mapping[str, Any] = {"ema": 0.0, "betas": (0.9, 0.999), "decay_vectors": True, "rate_at": 1.0}
"""Options of the training besides those of the case: as in the first report, so that its figures stay."""
ON_GPU: Mapping[str, Any] = {
    "resolution": 2.0, "pool": 65_536, "batch": 128, "fresh": 32, "width": 256, "heads": 8, "layers": 4, "lr": 5e-4,
}  # fmt: skip
ON_CPU: Mapping[str, Any] = {
    "resolution": 4.0, "pool": 512, "batch": 4, "fresh": 1, "width": 64, "heads": 4, "layers": 2, "lr": 2e-3,
}  # fmt: skip
"""Options that are 0 where they are not given."""
LOG_EVERY = 25  # steps
CHECKS = 20  # losses on the test pictures in the course of a training
CHECKED = 64  # test garments of these
PROBE = 60  # steps of a network that is thrown away, of which the second half is timed
CHUNK = 32  # garments that a process encodes at once
START_UP = 20.0  # s from the end of a training to the first step of the next, besides scoring
SCORING = 0.1  # CPU-s for each prediction
SHEET = 8  # garments of the sheet
TESTS = (Input.HELD_OUT, Input.PLAIN, Input.DRAWN, Input.GREY)
METRICS = ("panel_count_acc", "edge_count_acc", "iou")
"""Metrics with gaps in points."""


@dataclass
class Result:
    """Scores of a network that was trained on one input."""

    what: Input
    figures: dict[str, float]
    scores: dict[Input, list[PatternScore]]
    """Scores by test input, in the order of the test garments."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    def option(name: str, default: Any, text: str) -> None:
        shown = f"{text} ({default})"
        if (key := name[2:].replace("-", "_")) in ON_GPU:
            shown = f"{text} (0: {ON_GPU[key]} on a GPU, {ON_CPU[key]} on a CPU)"
        parser.add_argument(name, type=type(default), default=default, help=shown)

    option("--count", 3_000, "garments; the last --test of them are tested on")
    option("--test", 300, "garments to test on, at most a quarter")
    option("--garments", "", "folder of draped garments; made there if it holds none (default: garments in --out)")
    option("--out", "pictures_matter", "folder for scores, curves and the sheet; a repeated call continues there")
    option("--inputs", ",".join(INPUTS), "inputs to train on")
    option("--minutes", 9.0, "time for everything; it decides the number of steps")
    option("--steps", 0, "optimiser steps of each training; 0: as many as --minutes allows")
    option("--seed", 0, "seed of garments, pictures, networks and order")
    option("--design", "", "TOML file that restricts the designs")
    option("--resolution", 0.0, "edge length of the meshes [cm]")
    option("--size", 128, f"width and height of the pictures [pixels], a multiple of {STRIDE}")
    option("--device", "auto", "auto, cpu or cuda:0")
    option("--workers", 0, "processes that make garments and score patterns; 0: all cores but one on a GPU")
    option("--renderers", 0, "processes that render; 0: 8 on a GPU, at most all cores but one; 1: a thread")
    option("--pool", 0, "most readings in memory; later ones replace the first")
    option("--fresh", 0, "new readings rendered for each step")
    option("--batch", 0, "readings of a step, from the pool")
    option("--lr", 0.0, "highest learning rate")
    option("--width", 0, "features of a token")
    option("--heads", 0, "heads per attention layer")
    option("--layers", 0, "layers of the encoder, and of the decoder")
    option("--queries", 40, "most panels of a prediction")


def run(args: argparse.Namespace) -> CaseResult:
    """Make or read the garments, train on each input, test, compare. Raises ``ConfigError`` for unusable options."""
    begun = time.perf_counter()
    args = completed(args)
    out = Path(args.out)
    out.mkdir(parents=True, exist_ok=True)
    folder = garments_folder(args, out)
    data = load(folder, args)
    log(f"{len(data.known)} garments to train on, {len(data.unseen)} to test on, {_seconds_since(begun):.0f} s")
    tests = pictures_to_test(data, args)
    write_whole(out / "inputs.jpg", jpeg_bytes(sheet(tests)))
    results: dict[Input, Result] = {}
    inputs = [Input(name) for name in args.inputs.split(",")]
    for number, what in enumerate(inputs):
        result = read_result(out, what, args)
        if result is None:
            left = 60.0 * args.minutes - _seconds_since(begun)
            result = trained_and_tested(what, data, tests, args, out, seconds=left / (len(inputs) - number))
            write_result(out, result, args)
        results[what], args.steps = result, int(result.figures["steps"])  # the same number of steps for all
        figures = [*_about(data, args), *figures_of(results)]
        write_whole(out / "figures.csv", _table(figures))
    return CaseResult([Figure("minutes", _seconds_since(begun) / 60, "min, everything"), *figures], rows_of(results))


def completed(args: argparse.Namespace) -> argparse.Namespace:
    """The options with the defaults of the device. Raises ``ConfigError`` for invalid ones."""
    device = resolve_device(args.device)
    usual = ON_CPU if device == "cpu" else ON_GPU
    processes = 1 if device == "cpu" else max(1, cores() - 1)
    given = {**vars(args), "device": device, "workers": args.workers or processes}
    given["renderers"] = args.renderers or min(8, processes)
    args = argparse.Namespace(**{**given, **{key: given[key] or value for key, value in usual.items()}})
    unknown = [name for name in args.inputs.split(",") if name not in INPUTS]
    if unknown or not args.inputs:
        raise ConfigError(f"--inputs {args.inputs}: give some of {','.join(INPUTS)}")
    if args.size < STRIDE or args.size % STRIDE:
        raise ConfigError(f"--size {args.size}: give a multiple of {STRIDE}")
    if args.count < 4 or args.test < 1 or args.fresh < 1 or args.pool < args.batch:
        raise ConfigError("give --count of 4 or more, --test and --fresh of 1 or more, --pool of --batch or more")
    return args


# --------------------------------------------------------------------------------------------------------- the garments


@dataclass(frozen=True)
class Data:
    """The garments of a folder."""

    folder: str
    known: list[int]
    """Positions of the garments to train on: in the folder, in ``targets`` and in ``patterns``."""
    unseen: list[int]
    targets: PanelTargets
    """Without points."""
    patterns: list[Pattern]


def garments_folder(args: argparse.Namespace, out: Path) -> Path:
    """The folder of the garments. The set in ``--out``, or in an empty folder, is made or completed."""
    folder = Path(args.garments) if args.garments else out / "garments"
    if not args.garments or not (folder / "manifest.json").exists():
        design = read_overlay(args.design) if args.design else NO_OVERLAY
        config = MakeConfig(resolution=args.resolution, device=args.device, picture=0, points=0, design=design)
        generate(folder, args.count, seed=args.seed, config=config, workers=args.workers, on_progress=_log_progress)
    return folder


def load(folder: Path, args: argparse.Namespace) -> Data:
    """Targets of the garments; the last designs are tested on, with all their wearers."""
    reader = ShardReader(folder, settled_only=True)
    positions = range(min(args.count, len(reader)))
    designs = np.array([reader.number(k) // _wearers(reader) for k in positions])
    kept = np.unique(designs)[: -max(1, min(args.test, len(np.unique(designs)) // 4))]
    is_known = np.isin(designs, kept)
    if is_known.all() or not is_known.any():
        raise ConfigError(f"{folder} holds {len(kept)} designs: give a folder with 4 or more")
    to_targets = ToTargets(args.queries, NetConfig().slots, NetConfig().edges, points=0)
    chunks = (positions[k : k + CHUNK] for k in range(0, len(positions), CHUNK))
    targets, patterns = zip(*parallel_map(partial(_targets, folder, to_targets), chunks, args.workers), strict=True)
    known, unseen = (np.flatnonzero(wanted).tolist() for wanted in (is_known, ~is_known))
    return Data(str(folder), known, unseen, PanelTargets.join(targets), list(chain.from_iterable(patterns)))


def _wearers(reader: ShardReader) -> int:
    """Samples of one design."""
    recipe = reader.record.plan.recipe
    return int(recipe.get("bodies_each", 1)) + (recipe.get("bodies") == "both")


def _targets(folder: Path, to_targets: ToTargets, positions: Sequence[int]) -> tuple[PanelTargets, list[Pattern]]:
    reader = ShardReader(folder, settled_only=True)
    patterns = [reader.sample(position).pattern for position in positions]
    return PanelTargets.join([to_targets.of(pattern) for pattern in patterns]), patterns


def pictures_to_test(data: Data, args: argparse.Namespace) -> dict[Input, UInt8[Tensor, "t n h w 3"]]:
    """Every test garment as each input, in the order of ``data.unseen``."""
    # Compile the renderer's kernels in this process, before several look for them.
    garment = load_garment(ShardReader(data.folder, settled_only=True), data.unseen[0])
    scene, views = views_of(Input.DRAWN, args.seed, garment, 0, 0)
    render([scene], views, size=args.size, device=args.device)
    place = {position: k for k, position in enumerate(data.unseen)}
    shape = (len(place), SIDES, args.size, args.size, 3)
    pictures = {what: torch.zeros(shape, dtype=torch.uint8) for what in TESTS}
    processes = min(args.renderers, 1 + len(place) // 32)
    options = {**_render_options(args), "processes": processes, "readings": 1}
    with rendering(data.folder, data.unseen, TESTS, **options) as batches:
        for batch in batches:
            pictures[batch.what][[place[k] for k in batch.positions.tolist()]] = torch.from_numpy(batch.pictures)
    return pictures


def _render_options(args: argparse.Namespace) -> dict[str, Any]:
    return {"seed": args.seed, "size": args.size, "device": args.device}


# ------------------------------------------------------------------------------------------------------------- the pool


class Pool:
    """The latest readings on the device, fed by a stream of rendered batches; examples of a training.

    Each step receives ``fresh`` more readings and draws its batch with ``chance``, one generator for all steps.
    """

    def __init__(
        self, batches: Iterator[Rendered], targets: PanelTargets, room: int, size: int, *, fresh: int = 0
    ) -> None:
        """``targets``: of the garments by position, on the device of the readings."""
        self.fresh, self.chance = fresh, torch.Generator()
        self._batches, self._targets, device = batches, targets, targets.device
        self._positions = torch.zeros(room, dtype=torch.int64)
        self._pictures = torch.zeros(room, SIDES, size, size, 3, dtype=torch.uint8, device=device)
        self._labels = torch.zeros(room, SIDES, size, size, dtype=torch.uint8, device=device)
        self._due = 0
        self.added = 0
        """Readings received so far."""
        self.waited = 0.0
        """Time spent waiting for them [s]."""

    def __len__(self) -> int:
        return min(self.added, len(self._positions))

    def advance(self, step: int) -> None:
        """Receive the readings of a step."""
        self.receive(self.fresh)

    def state_dict(self) -> dict[str, Any]:
        """Nothing: rendered readings are not kept."""
        return {}

    def load_state_dict(self, state: dict[str, Any]) -> None: ...

    def receive(self, count: int) -> None:
        """Receive ``count`` more readings; rounded up to whole batches over the calls."""
        self._due += count
        while self.added < self._due:
            begun = time.perf_counter()
            batch = next(self._batches)
            self.waited += time.perf_counter() - begun
            slots = torch.arange(self.added, self.added + len(batch.positions)) % len(self._positions)
            self._positions[slots] = torch.from_numpy(batch.positions)
            here = slots.to(self._pictures.device)
            self._pictures[here] = torch.from_numpy(batch.pictures).to(here.device)
            self._labels[here] = torch.from_numpy(batch.labels).to(here.device)
            self.added += len(batch.positions)

    def batch(self, rows: Int[Tensor, " b"], chance: torch.Generator | None = None) -> PictureTargets:
        """One reading per row, drawn with repetition; the rows themselves are not used."""
        slots = torch.randint(len(self), (len(rows),), generator=self.chance)
        here = slots.to(self._pictures.device)
        targets = self._targets[self._positions[slots].to(here.device)]
        return PictureTargets(**vars(targets), pictures=self._pictures[here], shown=self._labels[here])


@contextmanager
def pool_of(what: Input, data: Data, args: argparse.Namespace) -> Iterator[Pool]:
    """A pool that holds one reading of each garment to train on; of plain pictures there are no others."""
    endless = what is not Input.PLAIN
    room = args.pool if endless else len(data.known)
    options = {**_render_options(args), "processes": args.renderers, "readings": 0 if endless else 1}
    with rendering(data.folder, data.known, [what], **options) as batches:
        targets = data.targets.to(torch.device(args.device))
        pool = Pool(batches, targets, max(room, args.batch), args.size, fresh=args.fresh if endless else 0)
        pool.receive(min(room, len(data.known)))
        yield pool


# --------------------------------------------------------------------------------------------------------- the training


def trained_and_tested(
    what: Input,
    data: Data,
    tests: Mapping[Input, Tensor],
    args: argparse.Namespace,
    out: Path,
    *,
    seconds: float,
) -> Result:
    """Train on one input within ``seconds``, scoring included, and score the predictions for all test pictures."""
    begun = time.perf_counter()
    with pool_of(what, data, args) as pool:
        overhead = START_UP + SCORING * len(TESTS) * len(data.unseen) / args.workers
        steps = args.steps or planned_steps(pool, data, args, seconds - overhead - _seconds_since(begun))
        log(f"{what}: {steps} steps, {pool.added} readings rendered in {_seconds_since(begun):.0f} s")
        start, received, waited = time.perf_counter(), pool.added, pool.waited
        net, rows = train(pool, data, steps, args, losses_on(tests, what, data, args))
        trained = _seconds_since(start)
    write_curve(out, what, rows)
    losses = [row["loss"] for row in rows]
    last = max(1, min(LOG_EVERY, steps // 4))
    figures = {
        "steps": float(steps),
        "train_minutes": trained / 60,
        "steps_per_s": steps / trained,
        "readings_per_s": (pool.added - received) / trained,
        "uses_of_a_reading": steps * args.batch / pool.added,
        "waiting": (pool.waited - waited) / trained,
        "first_loss": float(np.mean(losses[:last])),
        "last_loss": float(np.mean(losses[-last:])),
    }
    truth = [data.patterns[k] for k in data.unseen]
    answers = [pattern for pictures in tests.values() for pattern in predict(net, pictures, args)]
    scores = scores_of(answers, truth * len(tests), workers=args.workers)
    of_tests = {test: scores[k * len(truth) : (k + 1) * len(truth)] for k, test in enumerate(tests)}
    shown = ", ".join(f"{test} {mean_scores(found).iou:.3f}" for test, found in of_tests.items())
    log(f"{what}: trained for {trained:.0f} s, IoU on {shown}")
    return Result(what, figures, of_tests)


def planned_steps(pool: Pool, data: Data, args: argparse.Namespace, seconds: float) -> int:
    """The number of steps that fit into ``seconds``, by the pace of a network that is thrown away."""
    begun = time.perf_counter()
    train(pool, data, PROBE // 2, args)
    start = time.perf_counter()
    train(pool, data, PROBE // 2, args)
    a_step = _seconds_since(start) / (PROBE // 2)
    return max(PROBE, int((seconds - (time.perf_counter() - begun)) / a_step))


def train(
    pool: Pool, data: Data, steps: int, args: argparse.Namespace, check: Check | None = None
) -> tuple[PictureNet, list[dict[str, float]]]:
    """A network trained on readings of the pool, and a row of the curve for each step."""
    torch.manual_seed(args.seed)
    sizes = NetConfig(
        queries=args.queries,
        width=args.width,
        heads=args.heads,
        layers=args.layers,
        edge_width=args.width,
        edge_heads=args.heads,
        edge_layers=max(1, args.layers // 2),
        seam_layers=max(1, args.layers // 2),
        seen=0,
    )
    config = TrainConfig(
        steps=steps,
        batch=args.batch,
        lr=args.lr,
        seed=args.seed,
        log_every=1,
        checks=min(CHECKS, max(1, steps // LOG_EVERY)),
        **LOOP,
    )
    learner = PictureSet(sizes, views=SIDES, size=args.size)
    pool.chance.manual_seed(args.seed)
    trained = training.train(learner, pool, config, device=torch.device(args.device), check=check)
    best = trained.learner
    assert isinstance(best, PictureSet)
    return best.net, trained.curve


def predict(net: PictureNet, pictures: UInt8[Tensor, "t n h w 3"], args: argparse.Namespace) -> list[Pattern]:
    """Patterns predicted from pictures."""
    net.eval()
    patterns: list[Pattern] = []
    with torch.no_grad():
        for part in torch.split(pictures, args.batch):
            with _autocast(args):
                found = answers_of(net.decoder, net(part.to(args.device)))
            patterns += patterns_from(found)
    return patterns


def losses_on(tests: Mapping[Input, Tensor], what: Input, data: Data, args: argparse.Namespace) -> Check:
    """A check of the loss on some test pictures of each kind, without the loss of pixels."""
    device = torch.device(args.device)
    seen = {test: pictures[:CHECKED].to(device) for test, pictures in tests.items()}
    true = data.targets[torch.tensor(data.unseen[:CHECKED])].to(device)

    def check(step: int, learner: Any) -> dict[str, float]:
        net = learner.net
        with torch.no_grad(), _autocast(args):
            losses = {f"loss_{test}": set_loss(net.decoder, net(pictures), true) for test, pictures in seen.items()}
        found = {name: sum(part.item() for part in parts.values()) for name, parts in losses.items()}
        log(f"{what}: step {step}; {', '.join(f'{name} {value:.3f}' for name, value in found.items())}")
        return found

    return check


def _autocast(args: argparse.Namespace) -> torch.autocast:
    return torch.autocast(args.device.split(":")[0], torch.bfloat16, enabled=args.device != "cpu")


# ------------------------------------------------------------------------------------------------------------ the files


def write_curve(out: Path, what: Input, rows: Sequence[Mapping[str, float]]) -> None:
    """Append rows to ``curves.csv``: every ``LOG_EVERY`` steps their mean loss, and each loss on test pictures."""
    checks = [f"loss_{test}" for test in TESTS]
    path = out / "curves.csv"
    is_new = not path.exists()
    with path.open("a", newline="") as file:
        writer = csv.DictWriter(file, ["input", "step", "seconds", "loss", *checks], extrasaction="ignore")
        if is_new:
            writer.writeheader()
        for k, row in enumerate(rows, 1):
            if k % LOG_EVERY == 0 or k == len(rows) or checks[0] in row:
                loss = np.mean([each["loss"] for each in rows[max(0, k - LOG_EVERY) : k]])
                writer.writerow({**row, "input": what, "loss": f"{loss:.5g}"})


def sheet(tests: Mapping[Input, UInt8[Tensor, "t n h w 3"]]) -> UInt8[np.ndarray, "h w 3"]:
    """Front and back of some test garments, a row each: plain, grey, drawn, held out."""
    order = (Input.PLAIN, Input.GREY, Input.DRAWN, Input.HELD_OUT)
    garments = range(min(SHEET, len(tests[Input.PLAIN])))
    return contact_sheet([p.numpy() for k in garments for what in order for p in tests[what][k]], columns=8, gap=3)


def _table(figures: Sequence[Figure]) -> bytes:
    """Figures as CSV: what stands so far, should the run be stopped."""
    lines = ["metric,value,unit", *(f'{f.metric},{f.value:.6g},"{f.unit}"' for f in figures)]
    return "\n".join([*lines, ""]).encode()


def _about(data: Data, args: argparse.Namespace) -> list[Figure]:
    counts = Counter(len(data.patterns[k].panels) for k in data.known)
    commonest = counts.most_common(1)[0][0]
    right = np.mean([len(data.patterns[k].panels) == commonest for k in data.unseen])
    return [
        Figure("garments", len(data.known), "to train on"),
        Figure("tested", len(data.unseen), "garments"),
        Figure("fresh", args.fresh, "readings a step"),
        Figure("batch", args.batch, "readings"),
        Figure("commonest_panel_count_acc", float(right), "share"),
    ]


def _log_progress(progress: Progress) -> None:
    if progress.made % 100 == 0:
        log(f"{progress.existing + progress.made} of {progress.count} garments")


def _seconds_since(begun: float) -> float:
    return time.perf_counter() - begun


def write_result(out: Path, result: Result, args: argparse.Namespace) -> None:
    """Write the scores of every test garment, with the options that they depend on."""
    scores = {test: [astuple(score) for score in found] for test, found in result.scores.items()}
    steps = {"steps": int(result.figures["steps"])}
    text = {"options": {**_options(args), **steps}, "figures": result.figures, "scores": scores}
    write_whole(out / f"{result.what}.json", json.dumps(text).encode())


def read_result(out: Path, what: Input, args: argparse.Namespace) -> Result | None:
    """The result of an earlier call with the same options; ``None`` without one."""
    path = out / f"{what}.json"
    if not path.exists():
        return None
    text = json.loads(path.read_text())
    options = _options(args)
    if not args.steps:
        options["steps"] = text["options"]["steps"]
    if text["options"] != options:
        raise ConfigError(f"{path} has results of other options: give another --out")
    log(f"{what}: read from {path}")
    if any(len(row) != len(fields(PatternScore)) for rows in text["scores"].values() for row in rows):
        raise ConfigError(f"{path} has the scores of another version: give another --out")
    scores = {Input(test): [PatternScore(*row) for row in rows] for test, rows in text["scores"].items()}
    return Result(what, text["figures"], scores)


def _options(args: argparse.Namespace) -> dict[str, Any]:
    """The options that decide the result, besides the number of renderers."""
    without = ("out", "inputs", "minutes", "workers", "report", "keep", "case")
    return {name: value for name, value in vars(args).items() if name not in without}


def figures_of(results: Mapping[Input, Result]) -> list[Figure]:
    """Course of each training, mean scores of each network on each test, gaps of the drawn input to the others."""
    units = {"train_minutes": "min", "waiting": "of the time"}
    figures = [
        Figure(f"{what}_{name}", value, units.get(name, ""))
        for what, result in results.items()
        for name, value in result.figures.items()
    ]
    for what, result in results.items():
        for test, scores in result.scores.items():
            means = mean_scores(scores)
            figures += [Figure(f"{what}_on_{test}_{name}", getattr(means, name), "share") for name in METRICS]
    if Input.DRAWN in results:
        for other in (what for what in results if what is not Input.DRAWN):
            for test in TESTS:
                found = gaps(results[Input.DRAWN].scores[test], results[other].scores[test])
                figures += [
                    Figure(f"gap_to_{other}_on_{test}_{name}", found[0][name], f"points, {low:.1f} to {high:.1f}")
                    for name in METRICS
                    for low, high in [(found[1][name], found[2][name])]
                ]
    return figures


def gaps(
    scores: Sequence[PatternScore], others: Sequence[PatternScore]
) -> tuple[dict[str, float], dict[str, float], dict[str, float]]:
    """Mean differences in points by metric, and the ends of their 95 % intervals, paired by garment."""
    apart = [
        PatternScore(*(100.0 * (np.array(astuple(one)) - astuple(other))).tolist())
        for one, other in zip(scores, others, strict=True)
    ]
    ends = bootstrap_interval(apart, np.random.default_rng(0))
    mean, low, high = ({name: float(getattr(one, name)) for name in METRICS} for one in (mean_scores(apart), *ends))
    return mean, low, high


def rows_of(results: Mapping[Input, Result]) -> list[dict[str, str]]:
    """A table row for each network and test: mean scores with 95 % intervals."""
    rows = []
    for test in TESTS:
        for what, result in results.items():
            scores = result.scores[test]
            means, (low, high) = mean_scores(scores), bootstrap_interval(scores, np.random.default_rng(0))
            cells = {
                name: f"{getattr(means, name):.3g} ({getattr(low, name):.3g} to {getattr(high, name):.3g})"
                for name in PatternScore.__dataclass_fields__
            }
            named = {f"{name} [{UNITS[name]}]" if name in UNITS else name: cell for name, cell in cells.items()}
            rows.append({"tested on": str(test), "trained on": str(what), **named})
    return rows


def log(text: str) -> None:
    """Print a line of progress."""
    print(text, file=sys.stderr, flush=True)
