"""The tables of task T3: seams one to one, and n to m.

One to one: edges subdivided as drawn. N to m: edges joined wherever possible, scored on the seams of the parts.
"""

from collections.abc import Sequence
from dataclasses import asdict, astuple, fields, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np
import torch

from benchmarks.reconstruction.garments import Split
from benchmarks.reconstruction.judging import means_of
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
from gcd_dataset.files import make_folder
from gcd_dataset.records import Pattern
from gcd_dataset.spec import write_pattern
from gcd_dataset.workers import parallel_map

if TYPE_CHECKING:
    from benchmarks.reconstruction.stitching.net import StitchNet

Score = TypeVar("Score", StitchScore, IntervalScore)

DRAWS = 1000  # of the bootstrap
CUT_LOGITS = (0.0, -0.7, -1.4, -2.1, -2.8)  # log-odds of points of subdivision that are tried


def tables(net: "StitchNet", split: Split, out: Path, *, workers: int) -> dict[str, Any]:
    """The tables of seams one to one and n to m, beside the length-greedy baseline.

    The check garments choose how edges are subdivided for seams n to m. Writes the predicted and the true
    specifications of joined edges into folders of ``out``.
    """
    tests, checks = ([some.pattern(k) for k in range(len(some))] for some in (split.test, split.check))
    return evaluate(net, tests, out, workers, calibrated(net, checks), kinds=split.test.kinds)


def calibrated(net: "StitchNet", patterns: Sequence[Pattern]) -> Subdivision:
    """The subdivision of the best F1 of all seams for patterns that are neither trained on nor tested.

    Their edges are joined wherever possible; where none can be, the usual subdivision is returned.
    """
    joined = [found for pattern in patterns if (found := merged(pattern)) is not None]
    if not joined:
        return Subdivision()

    bare = [entry.pattern for entry in joined]
    scored = {
        way: np.mean([score_intervals(*pair).f1_symmetric for pair in zip(joined, answers, strict=True)])
        for way, answers in sew_in_ways(net, bare, CUT_LOGITS)
    }
    return max(scored, key=lambda way: float(scored[way]))


def evaluate(
    net: "StitchNet",
    patterns: Sequence[Pattern],
    out: Path,
    workers: int,
    way: Subdivision,
    *,
    kinds: Sequence[str],
) -> dict[str, Any]:
    """The tables of stitches one to one, and n to m, beside the length-greedy baseline.

    ``way``: how edges are subdivided for seams n to m. ``kinds``: kind of each garment.
    """
    greedy = []
    for pattern in patterns:
        graph = PackedGraphs.of([graph_of(replace(pattern, seams=()))])
        greedy.append(with_seams(pattern, greedy_by_length(graph[torch.zeros(1, dtype=torch.long)])[0]))
    rng = np.random.default_rng(0)
    joined = [found for pattern in patterns if (found := merged(pattern)) is not None]
    at_once, ours = sew(net, patterns, rounds=1), sew(net, patterns)
    parted = sew(net, [entry.pattern for entry in joined], subdivide=way)
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
    }


def write(folder: Path, patterns: Sequence[Pattern]) -> None:
    """Write the specifications of patterns for the evaluator; files of an earlier run are removed."""
    for old in make_folder(folder).glob("*_?????????_specification.json"):
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
