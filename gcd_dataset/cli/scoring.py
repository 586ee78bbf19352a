"""The verbs that score answers: score, and bench with inputs, submit and board."""

import argparse
import math
import sys
from collections.abc import Iterable
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from gcd_dataset.cli.common import Bar, Parser, add_quiet, add_verb, natural_number
from gcd_dataset.errors import ConfigError, OutputError

if TYPE_CHECKING:
    from gcd_dataset.scoring.folders import Scores
    from gcd_dataset.scoring.garments import Scored

OF_DRAPES = {"inputs": None, "partial": False, "resolution": None, "device": None}
"""Options with an effect on drapes only, and their values where they are not given."""


def add_verbs(verbs: Any) -> None:
    """Add these verbs to ``gcd``."""
    score = add_verb(verbs, "score", _score, "compare the patterns that a model answered with the true ones")
    _add_scoring(score)
    score.add_argument("--bodies", metavar="DIR|NAME", help="bodies named after the garments, or one for all")
    score.add_argument("--inputs", type=Path, metavar="DIR", help="meshes or points [cm] that the model was given")
    score.add_argument("--partial", action="store_true", help="inputs show a part of the garment, as a scan does")
    score.add_argument("--resolution", type=float, metavar="CM", help="mesh edges of drapes (default: 2)")
    score.add_argument("--by-kind", action="store_true", help="also every score for each kind of garment")
    score.add_argument("--json", type=Path, metavar="FILE", help="write all scores of all garments")

    bench = add_verb(verbs, "bench", _bench, "the scoreboard: test inputs, a result file, the tables")
    actions = bench.add_subparsers(dest="action", required=True, metavar="ACTION")
    inputs = actions.add_parser("inputs", help="write the frozen test inputs of a task; resumes if stopped")
    inputs.add_argument("task", metavar="TASK", help="T1, T1-scan, T2, T3, T3-subdivided, T4, T5, T6 or T8")
    inputs.add_argument("out", type=Path, metavar="OUT", help="folder for inputs, true patterns and bodies")
    inputs.add_argument("--mini", action="store_true", help="100 garments, of T8 20, for a laptop (default: 2000, 200)")
    inputs.add_argument("--pictures", type=Path, metavar="DIR", help="of T2: lay out these photographs instead")
    inputs.add_argument("--device", default="auto", help="device of the drapes: auto, cpu or cuda:0 (default: auto)")
    inputs.add_argument("--workers", type=natural_number, default=0, metavar="K", help="processes (default: 0)")
    add_quiet(inputs)
    submit = actions.add_parser("submit", help="score a model's answers for a task, as one result file")
    _add_scoring(submit)
    submit.set_defaults(bodies=None, inputs=None, partial=False, resolution=None)  # a task's own, so that all are alike
    submit.add_argument("--card", type=Path, required=True, metavar="TOML", help="the model: see docs/evaluate.md")
    submit.add_argument("--out", type=Path, required=True, metavar="JSON", help="the result file")
    tables = actions.add_parser("board", help="print the tables of result files")
    tables.add_argument("results", nargs="+", type=Path, metavar="JSON", help="result files of gcd bench submit")


def _add_scoring(parser: Parser) -> None:
    parser.add_argument(
        "answers", type=Path, metavar="ANSWERS", help="folder of NAME.json, NAME.npz: see docs/evaluate.md"
    )
    parser.add_argument(
        "truth", type=Path, metavar="TRUTH|TASK", help="folder of true specification files, or of gcd bench inputs"
    )
    parser.add_argument("--repair", action="store_true", help="mend and name the faults of networks in specifications")
    parser.add_argument("--drape", action="store_true", help="also drape the answers on the bodies of their garments")
    parser.add_argument("--device", metavar="NAME", help="device of the drapes: auto, cpu or cuda:0 (default: auto)")
    parser.add_argument("--workers", type=natural_number, default=1, metavar="K", help="processes (default: 1)")
    add_quiet(parser)


def _score(options: argparse.Namespace) -> int:
    from gcd_dataset.files import write_whole
    from gcd_dataset.scoring.board import result_text

    _require_file(options.json)
    scores = _scores(options)
    if options.json is not None:
        write_whole(options.json, result_text(scores.tree()).encode())
    for line in scores.lines(by_kind=options.by_kind):
        print(line, flush=True)
    return 0


def _bench(options: argparse.Namespace) -> int:
    from gcd_dataset.scoring import board, inputs

    if options.action == "board":
        print(board.tables(options.results))
        return 0
    if options.action == "inputs" and options.pictures is not None:
        if options.task != "T2" or options.mini:
            raise ConfigError("--pictures are inputs of T2: give T2, without --mini")
        names = inputs.lay_out_pictures(options.pictures, options.out)
        print(f"{options.out}: {len(names)} garments, unscored; gcd show ANSWERS --sheet answers.jpg draws the answers")
        return 0
    if options.action == "inputs":
        work = partial(inputs.write_inputs, options.task, options.out, mini=options.mini)
        work = partial(work, device=options.device, workers=options.workers)
        folder = Bar("garment", options.quiet, verb="bench inputs").run(work)
        print(
            f"{folder.path}: {folder.count} garments; answers to inputs/NAME… go into a folder as NAME.json or NAME.npz"
        )
        return 0
    from gcd_dataset.files import write_whole

    board.read_card(options.card)
    _require_file(options.out)
    inputs.read_task(options.truth)
    result = board.result_of(_scores(options), options.card)
    write_whole(options.out, board.result_text(result).encode())
    print(f"{options.out}: {len(result['garments'])} garments")
    return 0


def _scores(options: argparse.Namespace) -> "Scores":
    from gcd_dataset.scoring.folders import Drapes, score
    from gcd_dataset.scoring.garments import SPACING

    if not options.drape and (given := [name for name, off in OF_DRAPES.items() if getattr(options, name) != off]):
        raise ConfigError(f"--{given[0]} has an effect with --drape only: add --drape")
    if options.partial and options.inputs is None:
        raise ConfigError("--partial has an effect with --inputs only: add --inputs DIR")
    resolution = SPACING if options.resolution is None else options.resolution
    if not 0.2 <= resolution <= 10.0 or math.isnan(resolution):
        raise ConfigError(f"--resolution {resolution:g}: give 0.2 to 10 centimetres")
    drapes = Drapes(options.inputs, options.partial, resolution, options.device or "auto")
    scores = score(
        options.answers,
        options.truth,
        repair=options.repair,
        bodies=options.bodies,
        drapes=drapes if options.drape else None,
        workers=options.workers,
        shown=partial(_with_bar, quiet=options.quiet),
    )
    for remark in scores.remarks:
        print(f"gcd {options.verb}: {remark}", file=sys.stderr)
    return scores


def _with_bar(scored: "Iterable[Scored]", total: int, word: str, *, quiet: bool) -> "Iterable[Scored]":
    from tqdm import tqdm

    return tqdm(scored, total=total, unit="garment", desc=word, disable=quiet or not sys.stderr.isatty())


def _require_file(path: Path | None) -> None:
    """Raise ``OutputError`` before the work for a file that cannot be written after it."""
    if path is None:
        return
    if not path.absolute().parent.is_dir():
        raise OutputError(f"{path}: no such folder: create {path.absolute().parent}")
    if path.is_dir():
        raise OutputError(f"{path}: a folder: give a file")
