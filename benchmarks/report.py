"""A benchmark's figures as a Markdown report, with command, commit, hardware and versions."""

import os
import platform
import shlex
import subprocess
from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import torch

from benchmarks.cases.figures import CaseResult

ROOT = Path(__file__).resolve().parent.parent
PACKAGES = (
    "gcd-dataset", "newton", "numpy", "scipy", "shapely", "torch", "warp-lang", "webdataset", "litdata", "h5py",
    "mmap_ninja", "mosaicml-streaming", "pylance", "pyarrow",
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
    return subprocess.run(["git", *arguments], cwd=ROOT, capture_output=True, text=True, check=True).stdout.strip()


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
