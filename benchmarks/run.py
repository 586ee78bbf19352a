"""Run a benchmark: prints one line per figure, ``case.metric value unit``, and writes a report on request.

python -m benchmarks.run patterns --count 1000 --keep
"""

import argparse
import os
import platform
import shlex
import subprocess
import sys
from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import torch

from benchmarks.cases import CASES, CaseResult, load_case
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


# --------------------------------------------------------------------------------------------------------------- report


TREE = Path(__file__).resolve().parent.parent
PACKAGES = (
    "gcd-dataset", "newton", "numpy", "scipy", "shapely", "torch", "warp-lang", "webdataset", "litdata", "h5py",
    "mosaicml-streaming",
)  # fmt: skip


def report_text(case: str, about: str, measured: CaseResult, arguments: Sequence[str]) -> str:
    """The report of a case; ``arguments`` follow ``python -m`` in the command."""
    figures = [{"figure": f"{case}.{f.metric}", "value": _short(f.value), "unit": f.unit} for f in measured.figures]
    provenance = {
        "command": f"`python -m {shlex.join(arguments)}`",
        "commit": _commit(),
        "date": datetime.now(UTC).strftime("%Y-%m-%d %H:%M UTC"),
        "hardware": _hardware(),
        "versions": ", ".join([f"Python {platform.python_version()}", *_versions()]),
    }
    parts = [f"# {case}", about.strip(), _table(figures), _table(measured.rows)]
    parts += ["\n".join(f"- {name}: {text}" for name, text in provenance.items())]
    return "\n\n".join(part for part in parts if part) + "\n"


def _table(rows: Sequence[Mapping[str, Any]]) -> str:
    if not rows:
        return ""
    head = list(rows[0])
    lines = [head, ["---"] * len(head), *([_short(row[name]) for name in head] for row in rows)]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


def _short(value: Any) -> str:
    return f"{value:.5g}" if isinstance(value, float) else str(value)


def _commit() -> str:
    """The commit; followed by ``+`` if the tree has changes."""
    try:
        return _git("rev-parse", "--short=12", "HEAD") + ("+" if _git("status", "--porcelain") else "")
    except (OSError, subprocess.CalledProcessError):
        return "not a git checkout"


def _git(*arguments: str) -> str:
    return subprocess.run(["git", *arguments], cwd=TREE, capture_output=True, text=True, check=True).stdout.strip()


def _versions() -> list[str]:
    found = []
    for package in PACKAGES:
        try:
            found.append(f"{package} {version(package)}")
        except PackageNotFoundError:
            continue  # not installed, and not needed by every case
    return found


def _hardware() -> str:
    gpus = [torch.cuda.get_device_name(i) for i in range(torch.cuda.device_count())]
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    cpu = f"{cores} CPU cores, {torch.get_num_threads()} threads of torch ({platform.machine()})"
    return ", ".join([cpu, *gpus])


if __name__ == "__main__":
    sys.exit(main())
