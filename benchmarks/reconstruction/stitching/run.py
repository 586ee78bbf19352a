"""Task T3 from start to end: draw patterns, train on their stitches, score unseen designs and foreign patterns.

    python -m benchmarks.reconstruction.stitching.run --train 24000 --workers 16 --out runs/stitches
    python -m benchmarks.reconstruction.stitching.run --smoke --out runs/smoke

The patterns are those of ``tasks``: training and test set share no design and no body. ``--data`` keeps them.
With ``--leave-out`` the test patterns are of that kind of garment, and none of the training patterns.
``report.json`` holds three tables: one to one (subdivided as drawn), n to m (edges joined wherever possible, scored on
the seams of the parts) and, with ``--examples``, the specifications of a folder.
"""

import argparse
import json
import math
import sys
import time
from collections.abc import Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, astuple, fields, replace
from multiprocessing import get_context
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
import torch

from benchmarks.reconstruction.learners import sizes_from
from benchmarks.reconstruction.models.stitches import LEAST, StitchConfig, StitchExamples, StitchLearner
from benchmarks.reconstruction.stitching.graphs import PackedGraphs, edge_refs, graph_of, with_seams
from benchmarks.reconstruction.stitching.merging import Merged, merged
from benchmarks.reconstruction.stitching.scores import (
    IntervalScore,
    StitchScore,
    random_symmetry,
    score_intervals,
    score_stitches,
)
from benchmarks.reconstruction.stitching.sewing import Subdivision, greedy_by_length, sew, sew_in_ways
from benchmarks.reconstruction.tasks import TASKS, TEST_SEED
from benchmarks.reconstruction.train import UNFINISHED
from benchmarks.reconstruction.training import StoppedError, TrainConfig, train, training_device
from gcd_dataset.errors import ConfigError, GcdError, PatternError
from gcd_dataset.files import make_folder, write_whole
from gcd_dataset.records import Pattern
from gcd_dataset.spec import read_pattern, write_pattern

Score = TypeVar("Score", StitchScore, IntervalScore)

DRAWS = 1000  # of the bootstrap
CHECKED = 100  # patterns that choose how edges are subdivided; at most a quarter of those tested on
WATCHED = 32  # of these: patterns that are scored during the training
CUT_LOGITS = (0.0, -0.7, -1.4, -2.1, -2.8)  # log-odds of points of subdivision that are tried
MINUTES = 6.0  # of a training without --steps
SMOKE: dict[str, Any] = {
    "train": 200, "test": 32, "minutes": 0.4, "batch": 16, "width": 96, "heads": 4, "layers": 4, "pair_width": 32,
}  # fmt: skip


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command. Returns the exit code."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    add_arguments(parser)
    args = parsed(parser, arguments)
    try:
        run(args)
    except StoppedError as stopped:
        _say(f"stitching.run: {stopped}")
        return UNFINISHED
    except GcdError as error:
        _say(f"stitching.run: {error}")
        return 1
    return 0


def run(args: argparse.Namespace) -> None:
    """Draw the patterns, train, score, write the report.

    Raises ``ConfigError`` for unusable options, and ``StoppedError`` for a training that the time limit ends.
    """
    device = torch.device(training_device(args.device))
    config, sizes = configs_from(args)
    if args.examples and not Path(args.examples).is_dir():
        raise ConfigError(f"--examples {args.examples}: no such folder: give one of specification files")
    out, began = make_folder(Path(args.out)), time.perf_counter()
    data = make_folder(Path(args.data) if args.data else out / "data")
    split = TASKS["T3"].load(
        args.train, data=data, workers=args.workers, tested=args.test, checked=min(CHECKED, max(1, args.test // 4))
    )
    if args.leave_out:
        split = split.without(args.leave_out)
    if args.make_only:
        print(f"{len(split.train)} patterns to train on, {len(split.test)} to test on")
        return
    learner = StitchLearner(sizes)
    tests, watched = ([some.pattern(k) for k in range(len(some))] for some in (split.test, split.check))

    def prepared() -> StitchExamples:
        examples = learner.prepare(split.train, device=device, workers=args.workers)
        _say(f"{len(examples)} patterns prepared after {time.perf_counter() - began:.0f} s, on {device}")
        return examples

    def check(step: int, current: Any) -> Mapping[str, float]:
        some = watched[:WATCHED]
        scores = [_score(true, own) for true, own in zip(some, sew(current.net, some), strict=True)]
        return {f"check_{name}": value for name, value in _means(scores).items()}

    of = {name: getattr(args, name) for name in ("one_round", "leave_out", "foreign")}
    of |= {"sizes": json.dumps(asdict(learner.net.config), sort_keys=True), "patterns": split.train.patterns_hash}
    limit = 60 * args.limit_minutes - (time.perf_counter() - began) if args.limit_minutes else math.inf
    arguments: dict[str, Any] = {"device": device, "out": out, "check": check, "limit": limit, "of": of}
    trained = train(learner, prepared, config, **arguments)
    best = trained.learner
    assert isinstance(best, StitchLearner)
    report = {
        "arguments": vars(args) | {"minutes": config.minutes},
        "data": {
            name: {"count": len(part), "patterns": part.patterns_hash, "ids": part.ids_hash}
            for name, part in (("train", split.train), ("test", split.test))
        },
        "config": asdict(learner.net.config),
        "parameters": sum(p.numel() for p in learner.parameters()),
        "device": torch.cuda.get_device_name(device) if device.type == "cuda" else "cpu",
        "steps": trained.steps,
        "train_s": round(trained.seconds, 1),
        **evaluate(best, tests, out, args.workers, calibrated(best, watched), kinds=split.test.kinds),
    }
    if args.examples:
        report["foreign"] = foreign(best, Path(args.examples))
    report["all_s"] = round(time.perf_counter() - began, 1)
    write_whole(out / "report.json", (json.dumps(report, indent=2) + "\n").encode())
    print(json.dumps({name: value for name, value in report.items() if name not in ("arguments", "config")}, indent=2))


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of a run."""

    def option(name: str, default: Any, text: str) -> None:
        parser.add_argument(name, type=type(default), default=default, help=f"{text} ({default})")

    parser.add_argument("--out", required=True, help="folder of the checkpoint, curves and report")
    parser.add_argument("--smoke", action="store_true", help="200 patterns, a minute on two CPU cores")
    parser.add_argument("--make-only", action="store_true", help="draw the patterns of --data, then stop")
    parser.add_argument("--one-round", action="store_true", help="predict all seams at once")
    parser.add_argument("--compile", action="store_true", help="record the step on a GPU, which then takes less time")
    option("--train", 24_000, "patterns to train on")
    option("--test", 500, "patterns to test on, of another seed")
    option("--seed", 0, "seed of the network and the order")
    option("--minutes", 0.0, f"time of the training; {MINUTES:g} without --steps")
    option("--steps", 0, "optimiser steps")
    option("--limit-minutes", 0.0, "time of this call; a repeated call continues from the checkpoint; 0: no limit")
    option("--leave-out", "", "kind of garment to test on, and not to train on: dress, skirt, …")
    option("--batch", 256, "patterns of a step")
    option("--lr", 8e-4, "highest learning rate")
    option("--width", 256, "features of an edge")
    option("--heads", 8, "heads of a layer")
    option("--layers", 8, "layers")
    option("--pair-width", 48, "features of a pair of edges")
    option("--foreign", 0.0, "share of the training patterns that are subdivided as another source might, at most 0.25")
    option("--workers", 0, "processes that draw patterns")
    option("--checks", 8, "scorings on the way")
    option("--device", "auto", "auto, cpu or cuda:0")
    option("--data", "", "folder of the patterns; by default in the output folder")
    option("--examples", "", "folder whose specifications are scored, too")


def parsed(parser: argparse.ArgumentParser, arguments: Sequence[str] | None) -> argparse.Namespace:
    """The options; with ``--smoke``, ``SMOKE`` holds the defaults."""
    given = parser.parse_args(arguments)
    if given.smoke:
        parser.set_defaults(**SMOKE)
    if given.smoke and given.steps:
        parser.set_defaults(minutes=0.0)
    return parser.parse_args(arguments)


def configs_from(args: argparse.Namespace) -> tuple[TrainConfig, StitchConfig]:
    """The options of the training and of the network. Raises ``ConfigError`` for unusable options."""
    names = ("steps", "batch", "lr", "seed", "checks", "compile")
    minutes = args.minutes or (0.0 if args.steps else MINUTES)
    config = TrainConfig(minutes=minutes, **{name: getattr(args, name) for name in names})
    for name, least in (("train", 1), ("test", 1), ("seed", 0), ("workers", 0), ("limit_minutes", 0)):
        if not least <= getattr(args, name) < math.inf:
            raise ConfigError(f"--{name.replace('_', '-')} {getattr(args, name)}: give {least} or more")
    given = {name: getattr(args, name) for name in ("width", "heads", "layers", "pair_width", "foreign")}
    given |= {"rounds": 1} if args.one_round else {}
    sizes, _ = sizes_from("stitches", StitchConfig, given, least=LEAST, heads={"width": "heads"})
    return config, sizes


# ----------------------------------------------------------------------------------------------------------- the scores


def calibrated(learner: StitchLearner, patterns: Sequence[Pattern]) -> Subdivision:
    """The subdivision of the best F1 of all seams for patterns that are neither trained on nor tested.

    Their edges are joined wherever possible; where none can be, the usual subdivision is returned.
    """
    joined = [found for pattern in patterns if (found := merged(pattern)) is not None]
    if not joined:
        return Subdivision()

    bare = [entry.pattern for entry in joined]
    scored = {
        way: np.mean([score_intervals(*pair).f1_symmetric for pair in zip(joined, answers, strict=True)])
        for way, answers in sew_in_ways(learner.net, bare, CUT_LOGITS)
    }
    return max(scored, key=lambda way: float(scored[way]))


def evaluate(
    learner: StitchLearner,
    patterns: Sequence[Pattern],
    out: Path,
    workers: int,
    way: Subdivision,
    *,
    kinds: Sequence[str],
) -> dict[str, Any]:
    """The tables of stitches one to one, and n to m, beside the length-greedy baseline.

    ``way``: how edges are subdivided for seams n to m. ``kinds``: kind of each garment. Writes the predicted
    and the true specifications into folders of ``out``.
    """
    greedy = []
    for pattern in patterns:
        graph = PackedGraphs.of([graph_of(replace(pattern, seams=()))])
        greedy.append(with_seams(pattern, greedy_by_length(graph[torch.zeros(1, dtype=torch.long)])[0]))
    rng = np.random.default_rng(0)
    joined = [found for pattern in patterns if (found := merged(pattern)) is not None]
    at_once = sew(learner.net, patterns, rounds=1)
    began = time.perf_counter()
    ours = sew(learner.net, patterns)
    seconds = time.perf_counter() - began
    parted = sew(learner.net, [entry.pattern for entry in joined], subdivide=way)
    write(out / "predictions", ours)
    write(out / "truth", patterns)
    write(out / "several" / "predictions", parted)
    write(out / "several" / "truth", [entry.parts for entry in joined])
    pairs = [list(zip(patterns, answers, strict=True)) for answers in (ours, at_once, greedy)]
    if workers > 1:
        with ProcessPoolExecutor(workers, mp_context=get_context("spawn")) as pool:
            scores, first, floor = (list(pool.map(_scored, some, chunksize=16)) for some in pairs)
            several = list(pool.map(_interval_scored, zip(joined, parted, strict=True), chunksize=16))
    else:
        scores, first, floor = ([_scored(pair) for pair in some] for some in pairs)
        several = [_interval_scored(pair) for pair in zip(joined, parted, strict=True)]
    several_of = {entry.parts.name: score for entry, score in zip(joined, several, strict=True)}
    return {
        "one_to_one": _table(scores),
        "scores_of_kinds": {kind: _means(own) for kind, own in _by_kind(kinds, scores).items()},
        "several_of_kinds": {
            kind: {"garments": len(own), **_means(own)}
            for kind, own in _by_kind(kinds, [several_of.get(pattern.name) for pattern in patterns]).items()
        },
        "one_round": _table(first),
        "faultless_by_shape": _table([_moved_truth(pattern, rng) for pattern in patterns]),
        "greedy_by_length": _means(floor),
        "several": _table(several),
        "subdivision": asdict(way),
        "ms_a_pattern": 1e3 * seconds / len(patterns),
    }


def foreign(learner: StitchLearner, folder: Path) -> dict[str, Any]:
    """Scores of the specifications in a folder, subdivided as drawn, and of each by name."""
    patterns, graphs, unreadable = [], [], {}
    for path in sorted(folder.rglob("*_specification.json")):
        try:
            pattern = read_pattern(path)
            graphs.append(graph_of(pattern))
            patterns.append(pattern)
        except PatternError as error:
            unreadable[str(path.relative_to(folder))] = str(error)
    if not patterns:
        raise ConfigError(f"{folder}: no readable *_specification.json: give a folder of patterns")
    found = sew(learner.net, patterns)
    scores = [_score(true, own) for true, own in zip(patterns, found, strict=True)]
    each = [{"name": pattern.name, **asdict(score)} for pattern, score in zip(patterns, scores, strict=True)]
    return {**_table(scores), "unreadable": unreadable, "each": each}


def write(folder: Path, patterns: Sequence[Pattern]) -> None:
    """Write the specifications of patterns for the evaluator; files of an earlier run are removed."""
    for old in make_folder(folder).glob(f"{TEST_SEED}_*_specification.json"):
        old.unlink()
    for pattern in patterns:
        write_pattern(pattern, folder / f"{pattern.name}_specification.json")


def _moved_truth(pattern: Pattern, rng: np.random.Generator) -> StitchScore:
    """The score of the truth after a random symmetry of its panels: its strict part is below 1."""
    graph = graph_of(pattern)
    moved = random_symmetry(graph, rng)
    return score_stitches(graph, [(moved[a], moved[b]) for a, b in enumerate(graph.partners.tolist()) if b > a])


def _scored(pair: tuple[Pattern, Pattern]) -> StitchScore:
    return _score(*pair)


def _score(true: Pattern, predicted: Pattern) -> StitchScore:
    row_of = {ref: row for row, ref in enumerate(edge_refs(true))}
    return score_stitches(graph_of(true), [(row_of[seam.left], row_of[seam.right]) for seam in predicted.seams])


def _interval_scored(pair: tuple[Merged, Pattern]) -> IntervalScore:
    return score_intervals(*pair)


def _by_kind(kinds: Sequence[str], scores: Sequence[Score | None]) -> dict[str, list[Score]]:
    """The scores of each kind of garment, without missing ones; kinds that have some, by name."""
    found: dict[str, list[Score]] = {}
    for kind, score in sorted(zip(kinds, scores, strict=True), key=lambda pair: pair[0]):
        if score is not None:
            found.setdefault(kind, []).append(score)
    return found


def _means(scores: Sequence[Score]) -> dict[str, float]:
    means = np.mean([astuple(score) for score in scores], axis=0).tolist()
    return dict(zip((field.name for field in fields(scores[0])), means, strict=True))


def _table(scores: Sequence[Score]) -> dict[str, Any]:
    """Means with 95 % bootstrap intervals; empty for no garments."""
    if not scores:
        return {}
    values = np.array([astuple(score) for score in scores])
    drawn = values[np.random.default_rng(0).integers(len(values), size=(DRAWS, len(values)))].mean(axis=1)
    low, high = np.quantile(drawn, [0.025, 0.975], axis=0)
    names = [field.name for field in fields(scores[0])]
    rows = zip(names, values.mean(axis=0), low, high, strict=True)
    return {"garments": len(scores)} | {name: [round(float(v), 4) for v in (mean, a, b)] for name, mean, a, b in rows}


def _say(text: str) -> None:
    print(text, file=sys.stderr, flush=True)


if __name__ == "__main__":
    sys.exit(main())
