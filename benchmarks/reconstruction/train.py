"""Train a model on a task, let it answer for the test garments, and score the answers.

    python -m benchmarks.reconstruction.train panel_set --task T0 --smoke --out out     a minute on two cores
    python -m benchmarks.reconstruction.train panel_set --task T1 --train 4000 --minutes 8 --out out
    torchrun --nproc-per-node 4 -m benchmarks.reconstruction.train panel_set --task T0 --train 24000 --out out

``--out`` receives ``predictions/KEY.json`` and ``truth/KEY.json``, specification files that the evaluator reads too
(answers that are no patterns: ``predictions/KEY.npz``); ``scores.csv``, a row for each test garment; ``report.json``
with mean scores, 95 % intervals, options and hashes of the data; ``curves.csv``; ``pictures/`` with answers beside
truth; and the checkpoint, from which a repeated call continues. ``--drape`` then drapes the answers, as ``evaluate
--drape`` does, beside the points that they were told from (T1) or the draped true patterns: ``evaluation.json``; the
scores of the drapes are added to ``report.json``.

A call whose run has a ``report.json`` in ``--out`` does not answer again: with ``--drape`` it drapes the answers that
are there, unless the report has the scores of drapes. Delete the report to answer again.
"""

import argparse
import csv
import hashlib
import json
import math
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, is_dataclass
from functools import cache, partial
from itertools import product
from pathlib import Path
from typing import Any

import torch
import torch.distributed as dist
from gcd_dataset.scoring.evaluate import evaluate, evaluator

from benchmarks.reconstruction.garments import GarmentSet, Split, fresh_garments
from benchmarks.reconstruction.judging import Judge, intervals, judge_of, means_of
from benchmarks.reconstruction.learners import Examples, Learner, TensorExamples
from benchmarks.reconstruction.models import MODELS, load_model
from benchmarks.reconstruction.tasks import FRESH_SEED, TASKS, ReconstructionTask, task_named
from benchmarks.reconstruction.training import (
    CHECKPOINT,
    CURVES,
    Check,
    FreshPool,
    StoppedError,
    TrainConfig,
    Trained,
    one_of_several_ranks,
    rank,
    train,
    training_device,
)
from gcd_dataset.devicenames import named_devices
from gcd_dataset.errors import ConfigError, GcdError
from gcd_dataset.files import drafted, make_folder, write_whole
from gcd_dataset.generator.device import cores
from gcd_dataset.generator.drawing import png_bytes
from gcd_dataset.scoring.table import DRAPED, EVALUATION, REPORT, SCORES

MINUTES, TRAINED = 8.0, 4000
OF_GARMENTS, SUFFIXES = ("predictions", "truth", "inputs", "bodies"), (".json", ".npz", ".npy", ".meta.json")
"""Folders of the files of test garments, and how these end after the garment's key."""
UNFINISHED = 3
"""Exit code of a call that ``--limit-minutes`` ended."""
AS_GIVEN = ("source", "leave_out", "fresh", "make_device", "smoke", "make_only", "limit_minutes", "drape")
"""Fields of ``Options`` that are options of the command."""
SMOKE: Mapping[str, Any] = {
    "train": 16, "test": 8, "resolution": 4.0,
    "design": {"meta": {"upper": "none", "bottom": {"options": ["SkirtCircle", "Skirt2"]}}},
}  # fmt: skip
"""Options of the smallest run: few garments, coarse and all of one kind."""


@dataclass(frozen=True)
class Options:
    """Options of a run."""

    model: str
    task: ReconstructionTask
    out: Path
    train: int
    test: int
    """Number of test garments; 0: the task's own."""
    config: TrainConfig
    sizes: Mapping[str, Any]
    """Options of the network."""
    data: Path | None = None
    source: str = ""
    """Folder or repository of the garments; empty: they are generated, and kept in ``data``."""
    leave_out: str = ""
    """Kind of garment to test on, and not to train on."""
    fresh: int = 0
    """Room for the garments to train on and for fresh ones, the latest; 0: only the fixed set."""
    recipe: Mapping[str, Any] | None = None
    """Changes of the task's recipe."""
    workers: int = 0
    device: str = "cpu"
    make_device: str = "auto"
    """Device that drapes generated garments."""
    smoke: bool = False
    make_only: bool = False
    """Make the garments, nothing else."""
    limit_minutes: float = 0.0
    """Time of this call; 0: no limit."""
    drape: bool = False
    """Whether answers are draped and scored."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of a run, besides the model."""

    def option(name: str, default: Any, text: str) -> None:
        parser.add_argument(name, type=type(default), default=default, help=f"{text} (%(default)s)")

    option("--task", "T0", f"one of {', '.join(TASKS)}")
    option("--train", 0, f"garments to train on; 0: {TRAINED}, or {SMOKE['train']} with --smoke")
    option("--test", 0, "garments to test on; 0: those of the task")
    option("--out", "out", "folder of the results; a repeated call continues there")
    option("--data", "", "folder that caches generated garments (default: garments beside --out)")
    option("--source", "", "folder, URL or Hub repository of garments of the task's stage, instead of generated ones; "
           "they are split by design and body, and --data is not used")  # fmt: skip
    option("--leave-out", "", "kind of garment to test on, and not to train on: dress, skirt, …")
    option("--fresh", 0, "room for the garments of --train and those made meanwhile, the latest; 0: none are made")
    option("--minutes", 0.0, f"time for the steps alone, without loading and scoring; {MINUTES:g} without --steps")
    option("--steps", 0, "optimiser steps")
    option("--batch", 0, "garments of a step; 0: the model's own")
    option("--lr", 0.0, "highest learning rate; 0: the model's own")
    option("--checks", 0, "scores and pictures on the way; 0: the model's own, mostly 4")
    option("--seed", 0, "seed of weights and order")
    option("--limit-minutes", 0.0, "time of this call; a repeated call continues from the checkpoint; 0: no limit")
    option("--resolution", 0.0, "edge length of generated meshes and of drapes [cm]; 0: the task's own")
    option("--workers", -1, "processes that make and score; -1: all cores but one")
    option("--device", "auto", "auto, cpu or cuda")
    option("--make-device", "auto", "device that drapes generated garments, such as cuda:1 beside a training; "
           "auto: all GPUs, or the CPU without a GPU")  # fmt: skip
    parser.add_argument("--compile", action="store_true", help="compile the network")
    parser.add_argument("--make-only", action="store_true", help="make the garments of --data, then stop")
    parser.add_argument("--drape", action="store_true", help="also score drapes of the answers, at the resolution "
                        "of the garments, with --source at the task's own; a finished run is only draped")  # fmt: skip
    parser.add_argument("--smoke", action="store_true", help="few coarse garments and a tiny network, for two cores")
    parser.add_argument("--set", nargs="*", default=[], metavar="NAME=NUMBER", help="sizes of the network")


def options_from(args: argparse.Namespace, model: str) -> Options:
    """The options of a run. Raises ``ConfigError``."""
    module, out, device = load_model(model), Path(args.out), training_device(args.device)
    least = {"train": 0, "test": 0, "fresh": 0, "seed": 0, "workers": -1, "limit_minutes": 0}
    for name, low in least.items():
        if not low <= getattr(args, name) < math.inf:
            raise ConfigError(f"--{name.replace('_', '-')} {getattr(args, name)}: give {low} or more")
    usual = getattr(module, "SMOKE" if args.smoke else "USUAL", {})
    given = {name: value for name in ("batch", "lr", "steps", "minutes", "checks") if (value := getattr(args, name))}
    chosen = {**usual, **given}
    if "minutes" in given and "steps" not in given:
        chosen.pop("steps", None)
    if "steps" not in chosen:
        chosen.setdefault("minutes", MINUTES)
    if args.make_device != "auto":
        named_devices(args.make_device)
    recipe: dict[str, Any] = {"resolution": args.resolution} if args.resolution else {}
    if args.source and recipe:
        raise ConfigError(f"--resolution {args.resolution:g}: the garments of --source are made: leave it out")
    if args.smoke and not args.source:
        recipe = {"resolution": SMOKE["resolution"], "design": SMOKE["design"], **recipe}
    workers = (0 if args.smoke else max(1, cores() - 1)) if args.workers < 0 else args.workers
    return Options(
        model=model,
        task=task_named(args.task),
        out=out,
        train=args.train or (SMOKE["train"] if args.smoke else TRAINED),
        test=args.test or (SMOKE["test"] if args.smoke else 0),
        config=TrainConfig(**chosen, seed=args.seed, compile=args.compile),
        sizes=_sizes(args.set),
        data=Path(args.data) if args.data else out.parent / "garments",
        recipe=recipe,
        workers=workers,
        device=device,
        **{name: getattr(args, name) for name in AS_GIVEN},
    )


def _sizes(texts: Sequence[str]) -> dict[str, int]:
    try:
        found = {name: int(value) for name, value in (text.split("=") for text in texts)}
    except ValueError as error:
        raise ConfigError(f"--set {' '.join(texts)}: give NAME=NUMBER, such as width=256") from error
    if any(value < 0 for value in found.values()):
        raise ConfigError(f"--set {' '.join(texts)}: give numbers of 0 or more")
    return found


def run(options: Options) -> dict[str, Any] | None:
    """Make the garments, train, answer, score, drape; the report, or ``None`` on other ranks and with ``make_only``.

    A report of the same run in the folder is kept, and only drapes that it lacks are scored. Otherwise the report is
    written before the answers are draped. Raises ``ConfigError`` for unusable options, and ``StoppedError`` for a
    training that the time limit ends.
    """
    require_usable(options)
    _require_own_folder(options)
    begun = time.perf_counter()
    if options.smoke:
        torch.set_num_threads(1)  # fastest for tiny networks
    path = make_folder(options.out) / REPORT
    with one_of_several_ranks(options.device) as device:
        split = load_split(options)
        loaded = time.perf_counter()
        if options.make_only:
            print(f"{len(split.train)} garments to train on, {len(split.test)} to test on: {loaded - begun:.0f} s")
            return None
        report = _kept(options, split)
        if report is not None and not rank():
            print(f"{path} is of this run: delete it to answer again", file=sys.stderr)
        if report is None:
            report = _answered(options, split, device, begun=begun, loaded=loaded)
        if report is None or rank():
            return None
    if options.drape and not is_draped(report):
        report = _with_drapes(report, options)
        write_whole(path, json.dumps(report, indent=1).encode())
    return report


def is_draped(report: Mapping[str, Any]) -> bool:
    """Whether a report has the scores of drapes."""
    return all(name in report.get("scores", ()) for name in DRAPED)


def _kept(options: Options, split: Split) -> dict[str, Any] | None:
    """The report in the folder; ``None`` if it is of another run, or if files of answers are missing."""
    try:
        found = json.loads((options.out / REPORT).read_text())
    except (FileNotFoundError, ValueError):
        return None
    if not isinstance(found, dict) or found.get("identity") != _identity_of_answers(options, split):
        return None
    names = [SCORES, *judge_of(options.task).files(split.test)]
    return found if all((options.out / name).exists() for name in names) else None


def _answered(
    options: Options, split: Split, device: torch.device, *, begun: float, loaded: float
) -> dict[str, Any] | None:
    """Train, answer, score, and write the results; the report, or ``None`` on ranks other than the first.

    The call began at ``begun``, and had the garments at ``loaded`` [s].
    """
    module, judge = load_model(options.model), judge_of(options.task)
    trained, received = None, 0
    if hasattr(module, "build"):
        torch.manual_seed(options.config.seed)
        learner = module.build(smoke=options.smoke, options=options.sizes)
        learner.to(device)
        watched = learner.prepare(split.check, device=device)
        check = _Check(split.check, watched, options.out, judge_of(options.task, watching=True))
        trained, received = trained_by(options, learner, split, device, check=check, begun=begun)
    if rank():
        return None
    trained_at = time.perf_counter()
    answers = _answers(module, trained, split, options, device)
    scores = judge.scores(answers, split.test, workers=options.workers)
    tested = time.perf_counter()
    checked, steps = (trained.checked, trained.seconds) if trained else (0.0, 0.0)
    times = {"load_s": loaded - begun, "train_s": trained_at - loaded, "check_s": checked}
    times["test_s"] = tested - trained_at
    shown = f"{steps:.0f} s of steps so far; this call: {loaded - begun:.0f} s to load, {checked:.0f} s of checks, "
    print(f"{shown}{tested - trained_at:.0f} s to answer and score, {tested - begun:.0f} s in all", file=sys.stderr)
    report = _report(options, split, scores, trained, {**times, "fresh": received})
    _write(options.out, judge, split.test, answers, scores)
    write_whole(options.out / REPORT, json.dumps(report, indent=1).encode())
    return report


def require_usable(options: Options) -> None:
    """Raise ``ConfigError`` for options that do not go together; a model without ``TASKS`` answers patterns."""
    module = load_model(options.model)
    patterns = tuple(task.name for task in TASKS.values() if task.answers_patterns)
    answered = getattr(module, "TASKS", patterns)
    if options.task.name not in answered:
        raise ConfigError(f"{options.model} does not answer {options.task.name}: give --task {', '.join(answered)}")
    if not hasattr(module, "build"):
        if options.sizes or options.fresh:
            raise ConfigError(f"{options.model} has no network and no training: leave out --set and --fresh")
    elif options.sizes or options.fresh:
        with torch.random.fork_rng(devices=[]):
            learner = module.build(smoke=options.smoke, options=options.sizes)
        learner.require_fields(options.task.extra)
        if options.fresh and (learner.encoder() is None or options.source or options.leave_out):
            raise ConfigError("--fresh: needs a model that encodes garments, no --source, and no --leave-out")
    if 0 < options.fresh < options.train:
        raise ConfigError(f"--fresh {options.fresh}: give room for the {options.train} garments of --train, and more")
    if options.drape and not (options.task.answers_patterns and "pose" in options.task.extra):
        raise ConfigError(f"{options.task.name} has no patterns or no bodies to drape: leave out --drape")


def _require_own_folder(options: Options) -> None:
    """Raise ``ConfigError`` if a reference would answer into the folder of a training."""
    for name in (CHECKPOINT, CURVES):
        if not hasattr(load_model(options.model), "build") and (options.out / name).exists():
            raise ConfigError(f"{options.out} holds {name} of a training: give {options.model} another folder")


def load_split(options: Options, *, checked: int = 0) -> Split:
    """The garments; the first rank makes them, the others read its cache. ``checked``: as in ``task.load``."""
    if rank():
        dist.barrier()
    load: Callable[..., Split] = partial(options.task.load, data=options.data, checked=checked, **_recipe(options))
    if options.source:
        load = partial(options.task.read, options.source)
    split = load(options.train, workers=options.workers, tested=options.test)
    if dist.is_initialized() and not dist.get_rank():
        dist.barrier()
    return split.without(options.leave_out) if options.leave_out else split


def _recipe(options: Options) -> dict[str, Any]:
    """Changes of the task's recipe, and the device of its drapes."""
    drapes = {"device": options.make_device} if options.task.stage == "drape" else {}
    return {**drapes, **(options.recipe or {})}


# --------------------------------------------------------------------------------------------------------- the training


def trained_by(
    options: Options, learner: Learner[Any, Any], split: Split, device: torch.device, *, check: Check, begun: float
) -> tuple[Trained, int]:
    """The trained learner, and the number of fresh garments received; the call began at ``begun``.

    Raises ``StoppedError`` for a training that the time limit ends.
    """
    examples = learner.prepare(split.train, device=device, workers=options.workers)
    if options.fresh:
        examples = _pool(learner, split.train, options, device)
    limit = 60 * options.limit_minutes - (time.perf_counter() - begun) if options.limit_minutes else math.inf
    arguments: dict[str, Any] = {"device": device, "out": options.out, "check": check, "limit": limit}
    trained = train(learner, examples, options.config, of=_identity(options, split.train), **arguments)
    return trained, examples.received if isinstance(examples, FreshPool) else 0


def _identity(options: Options, garments: GarmentSet) -> dict[str, str | int]:
    """Model, options and data of a training; a checkpoint with another identity is refused."""
    recipe = {name: value for name, value in garments.recipe.items() if name != "made"}
    return {
        "task": options.task.name,
        "model": options.model,
        "sizes": json.dumps(options.sizes, sort_keys=True),
        "smoke": int(options.smoke),
        "network": _network_hash(options.model, options.smoke, json.dumps(options.sizes)),
        "leave_out": options.leave_out,
        "fresh": options.fresh,
        "garments": len(garments),
        "recipe": json.dumps(recipe, sort_keys=True),
        "ids": garments.ids_hash,
        "patterns": garments.patterns_hash,
        "points": garments.points_hash,
    }


@cache
def _network_hash(model: str, smoke: bool, sizes: str) -> str:
    """SHA-256 of the options of all parts of a network, defaults included: these may change between versions.

    Empty for a reference. ``sizes``: a JSON object.
    """
    module = load_model(model)
    if not hasattr(module, "build"):
        return ""
    with torch.random.fork_rng(devices=[]):
        learner = module.build(smoke=smoke, options=json.loads(sizes))
    told = {path: _told(vars(part)) for path, part in learner.named_modules()}
    return hashlib.sha256(json.dumps(told).encode()).hexdigest()


def _told(values: Mapping[str, Any]) -> dict[str, str]:
    """The numbers, texts and configurations among the attributes of a part of a network."""
    own = {name: value for name, value in sorted(values.items()) if not name.startswith("_") and name != "training"}
    return {name: str(v) for name, v in own.items() if isinstance(v, int | float | str) or is_dataclass(v)}


def _identity_of_answers(options: Options, split: Split) -> str:
    """SHA-256 of what the answers depend on: the training, or the reference, and the test garments."""
    test = [split.test.ids_hash, split.test.patterns_hash, split.test.points_hash]
    device = options.device.split(":")[0]  # answers of a CPU are rounded in another way, and take another time
    of = {**_identity(options, split.train), **options.config.identity, "test": test, "device": device}
    return hashlib.sha256(json.dumps(of, sort_keys=True).encode()).hexdigest()


def _pool(learner: Learner[Any, Any], known: GarmentSet, options: Options, device: torch.device) -> FreshPool[Any]:
    """Examples that fresh garments renew."""
    encode, task = learner.encoder(), options.task
    assert encode is not None  # ``require_usable``
    make = {"points": task.points, "extra": task.extra, "workers": options.workers, **task.options}
    seed = FRESH_SEED + rank()

    def stream(first: int) -> Iterator[tuple[int, TensorExamples]]:
        return fresh_garments(encode, seed, first=first, **{**make, **_recipe(options)})

    return FreshPool(learner, encode(known).to(device), stream, room=options.fresh)


@dataclass(frozen=True)
class _Check:
    """Mean scores of the answers for some garments, their losses, and a picture of the first of them."""

    garments: GarmentSet
    examples: Examples[Any]
    out: Path
    judge: Judge

    def __call__(self, step: int, learner: Learner[Any, Any]) -> Mapping[str, float]:
        batch = self.examples.batch(torch.arange(len(self.garments)))
        with torch.no_grad():
            losses = learner.loss(batch)
        answers = learner.predict(batch)
        picture = self.judge.picture(answers, self.garments)
        write_whole(make_folder(self.out / "pictures") / f"step_{step:06d}.png", png_bytes(picture))
        means = means_of(self.judge.scores(answers, self.garments))
        told = {f"check_loss_{name}": float(loss) for name, loss in losses.items()}
        return {"check_loss": sum(told.values()), **told, **{f"check_{name}": value for name, value in means.items()}}


def _answers(module: Any, trained: Trained | None, split: Split, options: Options, device: torch.device) -> list[Any]:
    """The answers for the test garments."""
    if trained is None:
        return list(module.answers(split.train, split.test, device=device, workers=options.workers))
    examples = trained.learner.prepare(split.test, device=device, workers=options.workers)
    count, batch = len(split.test), options.config.batch
    return list(trained.learner.answers(examples, count, batch=batch, workers=options.workers))


# ---------------------------------------------------------------------------------------------------------- the results


def _report(
    options: Options, split: Split, scores: Sequence[Any], trained: Trained | None, times: Mapping[str, float]
) -> dict[str, Any]:
    kinds = {kind: [s for s, k in zip(scores, split.test.kinds, strict=True) if k == kind] for kind in split.test.kinds}
    return {
        "model": options.model,
        "task": options.task.name,
        "headline": options.task.headline,
        "identity": _identity_of_answers(options, split),
        "scores": intervals(scores),
        "scores_of_kinds": {kind: means_of(of_kind) for kind, of_kind in sorted(kinds.items())},
        "data": {
            name: {"count": len(part), "patterns": part.patterns_hash, "ids": part.ids_hash, "recipe": part.recipe}
            for name, part in (("train", split.train), ("test", split.test))
        },
        "options": {
            "train": options.train,
            **asdict(options.config),
            "sizes": options.sizes,
            "leave_out": options.leave_out,
            "fresh": options.fresh,
        },
        "steps": trained.steps if trained else 0,
        "minutes": trained.seconds / 60 if trained else 0.0,
        "parameters": sum(p.numel() for p in trained.learner.parameters()) if trained else 0,
        "first_loss": trained.curve[0]["loss"] if trained else None,
        "last_loss": trained.curve[-1]["loss"] if trained else None,
        "device": torch.cuda.get_device_name() if options.device.startswith("cuda") else "cpu",
        **{name: round(value, 2) for name, value in times.items()},
    }


def _write(
    out: Path,
    judge: Judge,
    test: GarmentSet,
    answers: Sequence[Any],
    scores: Sequence[Any],
) -> None:
    _remove_answers(out)
    with drafted(out / SCORES) as draft, draft.open("w", newline="") as file:
        writer = csv.DictWriter(file, ["key", "kind", *asdict(scores[0])])
        writer.writeheader()
        for key, kind, score in zip(test.keys, test.kinds, scores, strict=True):
            writer.writerow({"key": key, "kind": kind, **asdict(score)})
    judge.write(answers, test, out)
    picture = judge.picture(answers, test)
    write_whole(make_folder(out / "pictures") / "test.png", png_bytes(picture))


def _remove_answers(out: Path) -> None:
    """Remove the files of an earlier run, listed in ``SCORES``: they would be scored as answers of this one."""
    for name in (REPORT, EVALUATION):
        (out / name).unlink(missing_ok=True)
    if not (out / SCORES).exists():
        return
    with (out / SCORES).open(newline="") as file:
        keys = [row.get("key") or "" for row in csv.DictReader(file)]
    for folder, key, suffix in product(OF_GARMENTS, filter(None, keys), SUFFIXES):
        (out / folder / f"{Path(key).name}{suffix}").unlink(missing_ok=True)


def _with_drapes(report: Mapping[str, Any], options: Options) -> dict[str, Any]:
    """The report with the scores of the draped answers, which ``evaluation.json`` holds for each garment."""
    out, device, scan = options.out, options.device, options.task.name == "T1-scan"
    spacing = (options.recipe or {}).get("resolution", options.task.options["resolution"])
    given = [str(out / "predictions"), str(out / "truth"), "--drape", "--bodies", str(out / "bodies"), "--quiet"]
    given += ["--resolution", f"{spacing:g}", "--device", "auto" if device == "cuda" else device]
    given += ["--workers", str(max(1, options.workers)), "--json", str(out / EVALUATION)]
    if options.task.name in ("T1", "T1-scan"):
        given += ["--inputs", str(out / "inputs"), *(["--partial"] if scan else [])]
    for _ in evaluate(evaluator().parse_args(given)):
        pass
    found = json.loads((out / EVALUATION).read_bytes())
    kinds = {
        kind: {**means, **{name: found["by_kind"][kind][name]["mean"] for name in DRAPED}}
        for kind, means in report["scores_of_kinds"].items()
    }
    figures = {name: [found["figures"][name][part] for part in ("mean", "low", "high")] for name in DRAPED}
    return {**report, "scores": {**report["scores"], **figures}, "scores_of_kinds": kinds}


def main(arguments: Sequence[str] | None = None) -> int:
    """Train a model and print its scores. Returns the exit code."""
    formatter = argparse.RawDescriptionHelpFormatter
    parser = argparse.ArgumentParser(prog="train", description=__doc__, formatter_class=formatter)
    parser.add_argument("model", choices=MODELS)
    add_arguments(parser)
    args = parser.parse_args(arguments)

    def call() -> None:
        report = run(options_from(args, args.model))
        for name, (mean, low, high) in report["scores"].items() if report else ():
            print(f"{args.task}.{args.model}.{name} {mean:.4g} ({low:.4g} to {high:.4g})")

    return exit_code(f"train {args.model}", call)


def exit_code(program: str, call: Callable[[], None]) -> int:
    """The exit code of a call: 0, 1 or ``UNFINISHED``. An error is printed as one line."""
    try:
        call()
    except GcdError as error:
        print(f"{program}: {error}", file=sys.stderr)
        return UNFINISHED if isinstance(error, StoppedError) else 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
