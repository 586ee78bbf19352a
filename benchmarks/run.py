"""Run a benchmark: one line a figure, ``case.metric value unit``, and a report where one is asked for.

python -m benchmarks.run reconstruction --smoke
python -m benchmarks.run patterns --count 1000 --keep
"""

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from benchmarks.cases import CASES, load_case
from benchmarks.report import report_text
from gcd_dataset.errors import GcdError
from gcd_dataset.files import write_whole

__all__ = ["main"]

REPORTS = Path(__file__).resolve().parent / "reports"


def main(arguments: Sequence[str] | None = None) -> int:
    """Exit code: 0, or 1 where the case could not be run."""
    given = list(sys.argv[1:] if arguments is None else arguments)
    name, options = _parsed(given)
    case = load_case(name)
    report = kept_report(name) if options.keep else options.report
    if report is None:
        kept = kept_report(name)
        print(f"benchmarks.run {name}: no report is written: --keep writes {kept}, --report another", file=sys.stderr)
    try:
        measured = case.run(options)
        for figure in measured.figures:
            print(f"{name}.{figure.metric} {figure.value:.6g} {figure.unit}")
        if report is not None:
            text = report_text(name, case.__doc__ or "", measured, ["benchmarks.run", *given])
            write_whole(report, text.encode())
    except GcdError as error:
        print(f"benchmarks.run {name}: {error}", file=sys.stderr)
        return 1
    return 0


def kept_report(name: str) -> Path:
    """Where the report of a case stands that goes with the tree."""
    return REPORTS / f"{name}.md"


def _parsed(given: Sequence[str]) -> tuple[str, argparse.Namespace]:
    """The case and its options; only the case that is run is imported."""
    choose = argparse.ArgumentParser(prog="benchmarks.run", description="Run a benchmark.")
    choose.add_argument("case", choices=CASES)
    name = str(choose.parse_args(given[:1]).case)
    case = load_case(name)
    shape = argparse.RawDescriptionHelpFormatter
    parser = argparse.ArgumentParser(prog=f"benchmarks.run {name}", description=case.__doc__, formatter_class=shape)
    report = parser.add_mutually_exclusive_group()
    report.add_argument("--report", type=Path, metavar="FILE", help="file for the report (default: none is written)")
    report.add_argument("--keep", action="store_true", help=f"write it to {kept_report(name)}, over the one there")
    case.add_arguments(parser)
    return name, parser.parse_args(given[1:])


if __name__ == "__main__":
    sys.exit(main())
