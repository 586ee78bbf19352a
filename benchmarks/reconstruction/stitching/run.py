"""Task T3 from start to end: draw patterns, train on their stitches, score unseen designs and foreign patterns.

    python -m benchmarks.reconstruction.stitching.run --train 24000 --workers 16 --out runs/stitches
    python -m benchmarks.reconstruction.stitching.run --smoke --out runs/smoke

Options are those of ``train``. Without ``--steps`` and ``--minutes`` it trains for 6 minutes; without ``--data`` the
patterns are kept in the output folder. They are those of ``tasks``: training and test set share no design and no body.
With ``--leave-out`` the test patterns are of that kind of garment, and none of the training patterns.
``report.json`` holds three tables: one to one (subdivided as drawn), n to m (edges joined wherever possible, scored on
the seams of the parts) and, with ``--examples``, the specifications of a folder.
"""

import argparse
import json
import sys
import time
from collections.abc import Mapping, Sequence
from dataclasses import asdict, astuple, fields, replace
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
import torch

from benchmarks.reconstruction.judging import means_of
from benchmarks.reconstruction.models.stitches import StitchConfig, StitchLearner, build
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
from benchmarks.reconstruction.tasks import TEST_SEED
from benchmarks.reconstruction.train import Options, exit_code, load_split, options_from, require_usable, trained_by
from benchmarks.reconstruction.train import add_arguments as add_training_arguments
from gcd_dataset.errors import ConfigError, PatternError
from gcd_dataset.files import make_folder, write_whole
from gcd_dataset.records import Pattern
from gcd_dataset.spec import read_pattern, write_pattern
from gcd_dataset.workers import parallel_map

Score = TypeVar("Score", StitchScore, IntervalScore)

DRAWS = 1000  # of the bootstrap
CHECKED = 100  # patterns that choose how edges are subdivided; at most a quarter of those tested on
WATCHED = 32  # of these: patterns that are scored during the training
CUT_LOGITS = (0.0, -0.7, -1.4, -2.1, -2.8)  # log-odds of points of subdivision that are tried
MINUTES = 6.0  # of a training without --steps
USUAL: Mapping[str, Any] = {
    "task": "T3", "train": 24_000, "test": 500, "checks": 8, "batch": 256, "lr": 8e-4, "workers": 0,
}  # fmt: skip
"""Defaults of the options of ``train``."""
SIZES: Mapping[str, str] = {
    "width": "features of an edge",
    "heads": "heads of a layer",
    "layers": "layers",
    "pair_width": "features of a pair of edges",
    "foreign": "share of the training patterns that are subdivided as another source might, at most 0.25",
}
"""Fields of ``StitchConfig`` that are options."""
SMOKE: dict[str, Any] = {
    "train": 200, "test": 32, "minutes": 0.4, "batch": 16, "width": 96, "heads": 4, "layers": 4, "pair_width": 32,
}  # fmt: skip


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command. Returns the exit code."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    add_arguments(parser)
    args = parsed(parser, arguments)
    return exit_code("stitching.run", lambda: run(args))


def run(args: argparse.Namespace) -> None:
    """Draw the patterns, train, score, write the report.

    Raises ``ConfigError`` for unusable options, and ``StoppedError`` for a training that the time limit ends.
    """
    options, began = options_of(args), time.perf_counter()
    require_usable(options)
    if args.examples and not Path(args.examples).is_dir():
        raise ConfigError(f"--examples {args.examples}: no such folder: give one of specification files")
    out, device = make_folder(options.out), torch.device(options.device)
    split = load_split(options, checked=min(CHECKED, max(1, options.test // 4)))
    if options.make_only:
        print(f"{len(split.train)} patterns to train on, {len(split.test)} to test on")
        return
    torch.manual_seed(options.config.seed)
    learner = build(smoke=False, options=options.sizes)
    tests, watched = ([some.pattern(k) for k in range(len(some))] for some in (split.test, split.check))

    def check(step: int, current: Any) -> Mapping[str, float]:
        some = watched[:WATCHED]
        scores = [_score(true, own) for true, own in zip(some, sew(current.net, some), strict=True)]
        return {f"check_{name}": value for name, value in means_of(scores).items()}

    trained, _ = trained_by(options, learner, split, device, check=check, begun=began)
    best = trained.learner
    assert isinstance(best, StitchLearner)
    report = {
        "arguments": vars(args) | {"minutes": options.config.minutes},
        "data": {
            name: {"count": len(part), "patterns": part.patterns_hash, "ids": part.ids_hash}
            for name, part in (("train", split.train), ("test", split.test))
        },
        "config": asdict(learner.net.config),
        "parameters": sum(p.numel() for p in learner.parameters()),
        "device": torch.cuda.get_device_name(device) if device.type == "cuda" else "cpu",
        "steps": trained.steps,
        "train_s": round(trained.seconds, 1),
        **evaluate(best, tests, out, options.workers, calibrated(best, watched), kinds=split.test.kinds),
    }
    if args.examples:
        report["foreign"] = foreign(best, Path(args.examples))
    report["all_s"] = round(time.perf_counter() - began, 1)
    write_whole(out / "report.json", (json.dumps(report, indent=2) + "\n").encode())
    print(json.dumps({name: value for name, value in report.items() if name not in ("arguments", "config")}, indent=2))


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of ``train``, with other defaults, and those of the network."""
    add_training_arguments(parser)
    parser.set_defaults(**USUAL)
    parser.add_argument("--one-round", action="store_true", help="predict all seams at once")
    for name, text in SIZES.items():
        usual = getattr(StitchConfig(), name)
        flag = f"--{name.replace('_', '-')}"
        parser.add_argument(flag, type=type(usual), default=usual, help=f"{text} ({usual})")
    parser.add_argument("--examples", default="", help="folder whose specifications are scored, too")


def parsed(parser: argparse.ArgumentParser, arguments: Sequence[str] | None) -> argparse.Namespace:
    """The options; with ``--smoke``, ``SMOKE`` holds the defaults."""
    given = parser.parse_args(arguments)
    if given.smoke:
        parser.set_defaults(**SMOKE)
    if given.smoke and given.steps:
        parser.set_defaults(minutes=0.0)
    return parser.parse_args(arguments)


def options_of(args: argparse.Namespace) -> Options:
    """The options of the training and of the network. Raises ``ConfigError`` for unusable options."""
    if args.task != "T3":
        raise ConfigError(f"--task {args.task}: leave it out, these are stitches of T3")
    changes = {"smoke": False, "minutes": args.minutes or (0.0 if args.steps else MINUTES)}
    changes["data"] = args.data or str(Path(args.out) / "data")
    options = options_from(argparse.Namespace(**{**vars(args), **changes}), "stitches")
    sizes = {name: getattr(args, name) for name in SIZES} | ({"rounds": 1} if args.one_round else {})
    return replace(options, sizes={**sizes, **options.sizes})


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
    scores, first, floor = (list(parallel_map(_scored, some, workers)) for some in pairs)
    several = list(parallel_map(_interval_scored, zip(joined, parted, strict=True), workers))
    several_of = {entry.parts.name: score for entry, score in zip(joined, several, strict=True)}
    return {
        "one_to_one": _table(scores),
        "scores_of_kinds": {kind: means_of(own) for kind, own in _by_kind(kinds, scores).items()},
        "several_of_kinds": {
            kind: {"garments": len(own), **means_of(own)}
            for kind, own in _by_kind(kinds, [several_of.get(pattern.name) for pattern in patterns]).items()
        },
        "one_round": _table(first),
        "faultless_by_shape": _table([_moved_truth(pattern, rng) for pattern in patterns]),
        "greedy_by_length": means_of(floor),
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


if __name__ == "__main__":
    sys.exit(main())
