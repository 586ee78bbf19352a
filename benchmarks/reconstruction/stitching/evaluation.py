"""The tables of task T3: seams one to one, and n to m.

One to one: edges subdivided as drawn. N to m: edges joined wherever possible, scored on the seams of the parts.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from benchmarks.reconstruction.garments import Split
from benchmarks.reconstruction.judging import intervals, means_of
from benchmarks.reconstruction.stitching.graphs import edge_refs, graph_of
from benchmarks.reconstruction.stitching.merging import Merged, merged
from benchmarks.reconstruction.stitching.scores import StitchScore, score_intervals, score_stitches
from benchmarks.reconstruction.stitching.sewing import sew
from gcd_dataset.files import make_folder
from gcd_dataset.metrics import PatternScore
from gcd_dataset.records import Pattern
from gcd_dataset.scoring.garments import scores_of
from gcd_dataset.spec import write_pattern
from gcd_dataset.workers import parallel_map

if TYPE_CHECKING:
    from benchmarks.reconstruction.stitching.net import StitchNet

CUT_LOGITS = (0.0, -0.7, -1.4, -2.1, -2.8)  # log-odds of points of subdivision that are tried


def tables(net: "StitchNet", split: Split, out: Path, *, workers: int) -> dict[str, Any]:
    """The tables of seams one to one and n to m, and the scores of the scoreboard.

    The check garments choose how edges are subdivided for seams n to m. Writes the answers to joined edges into the
    folder ``predictions`` of ``out``, those to edges as drawn into ``subdivided``.
    """
    tests, checks = ([some.pattern(k) for k in range(len(some))] for some in (split.test, split.check))
    found = evaluate(net, tests, out, workers, calibrated(net, checks), kinds=split.test.kinds)
    scores = {
        f"{part}_{score}": found[table][f"{score}_symmetric"]
        for part, table in (("joined", "several"), ("subdivided", "one_to_one"))
        for score in ("perfect", "f1")
        if found.get(table)
    }
    board = {name: found["board"][name] for name in ("stitch_nm_perfect", "stitch_nm_f1")}
    return {"scores": board | scores, **found}


def calibrated(net: "StitchNet", patterns: Sequence[Pattern]) -> float:
    """The log-odds of subdivision of the best F1 of all seams for patterns that are neither trained on nor tested.

    Their edges are joined wherever possible; where none can be, 0 is returned.
    """
    joined = [found for pattern in patterns if (found := merged(pattern)) is not None]

    def f1(logit: float) -> float:
        answers = sew(net, [entry.pattern for entry in joined], cuts_above=logit)
        return float(np.mean([score_intervals(*pair).f1_symmetric for pair in zip(joined, answers, strict=True)]))

    return max(CUT_LOGITS, key=f1) if joined else 0.0


def evaluate(
    net: "StitchNet",
    patterns: Sequence[Pattern],
    out: Path,
    workers: int,
    cuts_above: float,
    *,
    kinds: Sequence[str],
) -> dict[str, Any]:
    """The tables of stitches one to one, and n to m, and the scores of the scoreboard.

    ``cuts_above``: log-odds of the points at which edges are subdivided for seams n to m. ``kinds``: of the garments.
    """
    entries = [merged(pattern) for pattern in patterns]
    given = [pattern if entry is None else entry.pattern for pattern, entry in zip(patterns, entries, strict=True)]
    ours, sewn = sew(net, patterns), sew(net, given, cuts_above=cuts_above)
    for folder, answers in (("predictions", sewn), ("subdivided", ours)):
        make_folder(out / folder)
        for answer in answers:
            write_pattern(answer, out / folder / f"{answer.name}.json")
    joined = [entry for entry in entries if entry is not None]
    parted = [answer for answer, entry in zip(sewn, entries, strict=True) if entry is not None]
    scores = list(parallel_map(_scored, zip(patterns, ours, strict=True), workers))
    several = list(parallel_map(_interval_scored, zip(joined, parted, strict=True), workers))
    several_of = {entry.parts.name: score for entry, score in zip(joined, several, strict=True)}
    return {
        "one_to_one": _table(scores),
        "scores_of_kinds": {kind: means_of(own) for kind, own in _by_kind(kinds, scores).items()},
        "several_of_kinds": {
            kind: {"garments": len(own), **means_of(own)}
            for kind, own in _by_kind(kinds, [several_of.get(pattern.name) for pattern in patterns]).items()
        },
        "board": _table(scores_of(sewn, patterns, workers=workers)),
        "several": _table(several),
        "subdivision": {"logit": cuts_above},
    }


def _scored(pair: tuple[Pattern, Pattern]) -> StitchScore:
    return _score(*pair)


def _score(true: Pattern, predicted: Pattern) -> StitchScore:
    row_of = {ref: row for row, ref in enumerate(edge_refs(true))}
    return score_stitches(graph_of(true), [(row_of[seam.left], row_of[seam.right]) for seam in predicted.seams])


def _interval_scored(pair: tuple[Merged, Pattern]) -> StitchScore:
    return score_intervals(*pair)


def _by_kind(kinds: Sequence[str], scores: Sequence[StitchScore | None]) -> dict[str, list[StitchScore]]:
    """The scores of each kind of garment, without missing ones; kinds that have some, by name."""
    found: dict[str, list[StitchScore]] = {}
    for kind, score in sorted(zip(kinds, scores, strict=True), key=lambda pair: pair[0]):
        if score is not None:
            found.setdefault(kind, []).append(score)
    return found


def _table(scores: Sequence[StitchScore] | Sequence[PatternScore]) -> dict[str, Any]:
    """Means with 95 % bootstrap intervals; empty for no garments."""
    return {"garments": len(scores), **intervals(scores)} if scores else {}
