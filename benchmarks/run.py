"""Run a benchmark: prints one line per figure, ``case.metric value unit``, and writes a report on request.

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

REPORTS = Path(__file__).resolve().parent / "reports"


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a case. Returns the exit code: 0, or 1 if the case failed or refused an input."""
    given = list(sys.argv[1:] if arguments is None else arguments)
    name, options = _parsed(given)
    case = load_case(name)
    report = report_in_tree(name) if options.keep else options.report
    if report is None:
        in_tree = report_in_tree(name)
        print(
            f"benchmarks.run {name}: no report is written: --keep writes {in_tree}, --report another file",
            file=sys.stderr,
        )
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
    for refused, reason in measured.refused:
        print(f"benchmarks.run {name}: {refused}: REFUSED: {reason}", file=sys.stderr)
    return int(bool(measured.refused))


def report_in_tree(name: str) -> Path:
    """Path of the case's report in the repository."""
    return REPORTS / f"{name}.md"


def _parsed(given: Sequence[str]) -> tuple[str, argparse.Namespace]:
    """Name and options of the case; imports that case only."""
    cases = argparse.ArgumentParser(prog="benchmarks.run", description="Run a benchmark.")
    cases.add_argument("case", choices=CASES)
    name = str(cases.parse_args(given[:1]).case)
    case = load_case(name)
    formatter = argparse.RawDescriptionHelpFormatter
    parser = argparse.ArgumentParser(prog=f"benchmarks.run {name}", description=case.__doc__, formatter_class=formatter)
    report = parser.add_mutually_exclusive_group()
    report.add_argument("--report", type=Path, metavar="FILE", help="file for the report (default: none)")
    report.add_argument("--keep", action="store_true", help=f"overwrite {report_in_tree(name)}")
    case.add_arguments(parser)
    return name, parser.parse_args(given[1:])


if __name__ == "__main__":
    sys.exit(main())
