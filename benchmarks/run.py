"""Run a benchmark: one line a figure, ``case.metric value unit``, and a report.

python -m benchmarks.run reconstruction --smoke
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
    try:
        measured = case.run(options)
        for figure in measured.figures:
            print(f"{name}.{figure.metric} {figure.value:.6g} {figure.unit}")
        text = report_text(name, case.__doc__ or "", measured, ["benchmarks.run", *given])
        write_whole(options.report, text.encode())
    except GcdError as error:
        print(f"benchmarks.run {name}: {error}", file=sys.stderr)
        return 1
    return 0


def _parsed(given: Sequence[str]) -> tuple[str, argparse.Namespace]:
    """The case and its options; only the case that is run is imported."""
    choose = argparse.ArgumentParser(prog="benchmarks.run", description="Run a benchmark.")
    choose.add_argument("case", choices=CASES)
    name = str(choose.parse_args(given[:1]).case)
    case = load_case(name)
    shape = argparse.RawDescriptionHelpFormatter
    parser = argparse.ArgumentParser(prog=f"benchmarks.run {name}", description=case.__doc__, formatter_class=shape)
    parser.add_argument("--report", type=Path, default=REPORTS / f"{name}.md", help="where the report goes")
    case.add_arguments(parser)
    return name, parser.parse_args(given[1:])


if __name__ == "__main__":
    sys.exit(main())
