"""Score predicted patterns against true ones: anyone's specification files, matched by file name.

    python -m gcd_dataset.scoring.evaluate PREDICTIONS TRUTH
    python -m gcd_dataset.scoring.evaluate PREDICTIONS TRUTH --drape --bodies DIR --inputs DIR

Every true pattern counts: a prediction that is missing or cannot be read gets the worst value of every score. The
definitions are in docs/evaluate.md. Exit code 0, or 1 with one line on what to correct.
"""

import argparse
import hashlib
import json
import math
import sys
from collections.abc import Iterable, Iterator, Mapping, Sequence
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from gcd_dataset import __version__
from gcd_dataset.errors import ConfigError, GcdError, OutputError, SpecError
from gcd_dataset.files import discard_stdout, write_whole
from gcd_dataset.metrics import PatternScore, score_pattern
from gcd_dataset.records import Pattern
from gcd_dataset.scoring.garments import SPACING, Scored, match_folders, score_cases
from gcd_dataset.scoring.table import (
    garment_table,
    line_of,
    summaries,
    summaries_by_kind,
    tree_of,
)
from gcd_dataset.workers import parallel_map

if TYPE_CHECKING:
    from gcd_dataset.scoring.bodies import Wearers
    from gcd_dataset.scoring.distances import Shape

INTERRUPTED = 130
PRESETS = ("neuraltailor", "aipparel", "garmentdiffusion", "stitched", "reweaver")
OF_DRAPES = ("bodies", "inputs", "resolution", "device")
"""Options with an effect on drapes only."""
BY_NAME = {"neuraltailor", "aipparel"}
"""Presets that match panels, or the panels of seams, by name."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command. Returns the exit code: 0, or 1 for bad input, 2 for a missing device, 130 after Ctrl-C.

    Exits 2 for wrong usage.
    """
    parser = evaluator()
    options = parser.parse_args(arguments)
    if not options.drape and (given := [name for name in OF_DRAPES if getattr(options, name) is not None]):
        parser.error(f"--{given[0]} has an effect with --drape only: add --drape")
    if options.partial and options.inputs is None:
        parser.error("--partial has an effect with --inputs only: add --inputs DIR")
    try:
        for line in evaluate(options):
            print(line, flush=True)
    except KeyboardInterrupt:
        print("evaluate: interrupted", file=sys.stderr)
        return INTERRUPTED
    except GcdError as error:
        print(f"evaluate: {error}", file=sys.stderr)
        return 2 if isinstance(error, ConfigError) else 1
    except BrokenPipeError:
        discard_stdout()
        return 1
    return 0


def evaluate(options: argparse.Namespace) -> Iterator[str]:
    """The lines of the report, in order; remarks go to stderr. Writes the JSON file. Raises ``GcdError``."""
    folders = match_folders(options.predictions, options.truth)
    for remark in folders.remarks():
        print(f"evaluate: {remark}", file=sys.stderr)
    names = [case.name for case in folders.cases]
    if options.json is not None and not options.json.absolute().parent.is_dir():
        raise OutputError(f"{options.json}: no such folder: create {options.json.absolute().parent}")
    if options.json is not None and options.json.is_dir():
        raise OutputError(f"{options.json}: a folder: give a file")
    wearers, inputs = _wearers(options, names), _inputs(options.inputs, names)
    scored: Iterable[Scored] = score_cases(folders.cases, workers=options.workers)
    garments = list(_with_bar(scored, len(folders.cases), "scored", options.quiet))
    if wearers is not None:
        garments = list(_with_bar(_draped(garments, wearers, inputs, options), len(garments), "draped", options.quiet))
    figures, kinds = summaries(garments), summaries_by_kind(garments)
    presets = {preset: _preset(preset, garments) for preset in options.preset}
    if (named := sorted(BY_NAME & presets.keys())) and not any(map(_shares_a_name, garments)):
        print(
            f"evaluate: preset {', '.join(named)} matches panels by name, and no predicted panel has the name of a "
            "true one: rename them, or import them with --panels",
            file=sys.stderr,
        )
    for preset, scores in presets.items():
        for remark in _of_no_number(scores):
            print(f"evaluate: preset {preset}: {remark}", file=sys.stderr)
    if options.json is not None:
        hashes = _hashes(options, {case.name: case.true for case in folders.cases})
        tree = tree_of(garments, figures, kinds, presets, {**_settings(options), "hashes": hashes})
        write_whole(options.json, (json.dumps(_finite(tree), indent=1, allow_nan=False) + "\n").encode())
    yield garment_table(garments)
    yield ""
    yield f"evaluate.garments {len(garments)} garments"
    yield f"evaluate.failed {sum(bool(garment.failure) for garment in garments)} garments"
    yield from map(line_of, figures)
    if options.by_kind:
        for kind, rows in kinds.items():
            count = sum(garment.kind == kind for garment in garments)
            yield f"evaluate.{_word(kind)}.garments {count} garments"
            yield from (line_of(row, f"evaluate.{_word(kind)}") for row in rows)
    for preset, scores in presets.items():
        yield from (f"evaluate.{preset}.{name} {value:.4g} as published" for name, value in scores.items())


def evaluator() -> argparse.ArgumentParser:
    """The arguments of the command."""
    title, _, rest = (__doc__ or "").partition("\n")
    parser = argparse.ArgumentParser(
        prog="gcd_dataset.scoring.evaluate",
        description=f"{title}\n{rest}",
        formatter_class=argparse.RawDescriptionHelpFormatter,
        allow_abbrev=False,
    )
    parser.add_argument("predictions", type=Path, metavar="PREDICTIONS", help="folder of predicted specification files")
    parser.add_argument("truth", type=Path, metavar="TRUTH", help="folder of true specification files")
    parser.add_argument("--drape", action="store_true", help="drape the predictions on the bodies of their garments")
    parser.add_argument(
        "--bodies",
        metavar="DIR|NAME",
        help="folder of bodies named after the garments, or one body for all, such as neutral, random:7 or a mesh file "
        "(default: neutral)",
    )
    parser.add_argument(
        "--inputs",
        type=Path,
        metavar="DIR",
        help="meshes or points [cm] from which the garments were predicted; distances are to these (default: to the "
        "draped true pattern)",
    )
    parser.add_argument("--partial", action="store_true", help="inputs show a part of the garment, as a scan does")
    parser.add_argument("--resolution", type=_centimetres, metavar="CM", help=f"mesh edges of drapes ({SPACING})")
    parser.add_argument("--device", help="device of the drapes: auto, cpu or cuda:0 (auto)")
    parser.add_argument(
        "--preset",
        action="append",
        choices=PRESETS,
        default=[],
        metavar="NAME",
        help=f"also the metrics of a paper, for old tables: {', '.join(PRESETS)}; may be repeated",
    )
    parser.add_argument("--by-kind", action="store_true", help="also every score for each kind of garment")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write all scores of all garments")
    parser.add_argument("--workers", type=_natural, default=1, metavar="K", help="processes that score and mesh (1)")
    parser.add_argument("--quiet", action="store_true", help="no progress bar")
    return parser


def _natural(text: str) -> int:
    if not text.isdecimal() or int(text) < 1:
        raise argparse.ArgumentTypeError(f"{text!r}: give a whole number of 1 or more")
    return int(text)


def _centimetres(text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not 0.2 <= value <= 10.0:
        raise argparse.ArgumentTypeError(f"{text!r}: give 0.2 to 10 centimetres")
    return value


def _inputs(folder: Path | None, names: Sequence[str]) -> "dict[str, Shape] | None":
    """The input of every garment. Raises ``SpecError`` for a garment without one."""
    if folder is None:
        return None
    from gcd_dataset.scoring.distances import input_files, read_shape

    files = input_files(folder)
    missing = [name for name in names if name not in files]
    if missing:
        raise SpecError(f"{folder}: no input for {missing[0]} ({len(missing)} in all): add {missing[0]}.ply")
    return {name: read_shape(files[name]) for name in names}


def _wearers(options: argparse.Namespace, names: Sequence[str]) -> "Wearers | None":
    """The bodies, if predictions are draped. Raises ``BodyError`` for a garment without one."""
    if not options.drape:
        return None
    from gcd_dataset.scoring.bodies import NEUTRAL, wearers_of

    wearers = wearers_of(options.bodies or NEUTRAL)
    wearers.require(names)
    return wearers


def _draped(
    garments: Sequence[Scored], wearers: "Wearers", inputs: "dict[str, Shape] | None", options: argparse.Namespace
) -> Iterator[Scored]:
    from gcd_dataset.scoring.bodies import NEUTRAL, Wearers
    from gcd_dataset.scoring.draping import with_drapes

    return with_drapes(
        garments,
        wearers,
        own=Wearers(options.predictions, NEUTRAL, {}),
        inputs=inputs,
        partial=options.partial,
        spacing=options.resolution or SPACING,
        device=options.device or "auto",
        workers=options.workers,
    )


def _preset(preset: str, garments: Sequence[Scored]) -> dict[str, float]:
    legacy = import_module("benchmarks.reconstruction.legacy")
    predicted, true = [garment.predicted for garment in garments], [garment.true for garment in garments]
    return dict(legacy.legacy_scores(preset, predicted, true))


def _of_no_number(scores: Mapping[str, float]) -> Iterator[str]:
    """A line on the scores that are infinite, and one on those that are NaN."""
    infinite, unknown = ([name for name, value in scores.items() if test(value)] for test in (math.isinf, math.isnan))
    if infinite:
        yield f"{', '.join(infinite)}: infinite by its definition, since a prediction has no panels"
    if unknown:
        yield f"{', '.join(unknown)}: not a number (nan), since none of these garments counts by its definition"


def _shares_a_name(garment: Scored) -> bool:
    ours, theirs = (
        {panel.name for panel in pattern.panels} if pattern else set() for pattern in (garment.predicted, garment.true)
    )
    return bool(ours & theirs)


def _with_bar(scored: Iterable[Scored], total: int, word: str, quiet: bool) -> Iterator[Scored]:
    from tqdm import tqdm

    yield from tqdm(scored, total=total, unit="garment", desc=word, disable=quiet or not sys.stderr.isatty())


def _settings(options: argparse.Namespace) -> dict[str, Any]:
    given = {name: str(value) if isinstance(value, Path) else value for name, value in vars(options).items()}
    if options.drape:
        given["resolution"] = options.resolution or SPACING
    return {"gcd_dataset": __version__, "numpy": np.__version__, **given}


def _hashes(options: argparse.Namespace, truth: Mapping[str, Path]) -> dict[str, str]:
    """Hashes of the true patterns, and of the bodies and inputs of drapes."""
    found = {"truth": _hash_of(truth)}
    if not options.drape:
        return found
    if options.inputs is not None:
        from gcd_dataset.scoring.distances import input_files

        files = input_files(options.inputs)
        found["inputs"] = _hash_of({name: files[name] for name in truth})
    from gcd_dataset.scoring.bodies import NEUTRAL

    bodies = Path(named := options.bodies or NEUTRAL)
    files = {str(path.relative_to(bodies)): path for path in (bodies.rglob("*") if bodies.is_dir() else [bodies])}
    found["bodies"] = _hash_of(files) if bodies.exists() else hashlib.sha256(named.encode()).hexdigest()
    return found


def _hash_of(files: Mapping[str, Path]) -> str:
    """SHA-256 of names and contents."""
    found = hashlib.sha256()
    for name, path in sorted(files.items()):
        if path.is_file():
            with path.open("rb") as file:
                content = hashlib.file_digest(file, "sha256").hexdigest()
            found.update(f"{name}\n{content}\n".encode())
    return found.hexdigest()


def _finite(tree: Any) -> Any:
    """The tree with null for numbers that JSON lacks, such as a preset's mean over no garment."""
    if isinstance(tree, dict):
        return {key: _finite(value) for key, value in tree.items()}
    if isinstance(tree, list):
        return [_finite(value) for value in tree]
    return None if isinstance(tree, float) and not math.isfinite(tree) else tree


def _word(kind: str) -> str:
    """A kind as a part of a figure's name."""
    return "".join(char if char.isalnum() else "_" for char in kind)


# ---------------------------------------------------------------------------------------- scores of patterns in memory


def scores_of(predicted: Sequence[Pattern], true: Sequence[Pattern], *, workers: int = 0) -> list[PatternScore]:
    """The score of each predicted pattern, computed by ``workers`` processes."""
    return list(parallel_map(_score_pair, zip(predicted, true, strict=True), workers))


def _score_pair(pair: tuple[Pattern, Pattern]) -> PatternScore:
    return score_pattern(*pair)


if __name__ == "__main__":
    sys.exit(main())
