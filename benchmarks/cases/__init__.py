"""The benchmark cases by name, each a module of the form ``CaseModule``, imported on use; their result types."""

import argparse
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from importlib import import_module
from pathlib import Path
from typing import Any, NamedTuple, Protocol, cast


class Figure(NamedTuple):
    """One measured number, printed as ``case.metric value unit``."""

    metric: str
    value: float
    unit: str


@dataclass(frozen=True)
class CaseResult:
    """The figures of a run, and the table behind them."""

    figures: Sequence[Figure]
    rows: Sequence[Mapping[str, Any]] = field(default_factory=tuple)
    """Rows of the report's table; all have the same keys."""
    refused: Sequence[tuple[str, str]] = ()
    """Name and reason of each input that could not be measured; the others were."""


class CaseModule(Protocol):
    """The interface of a case module."""

    __doc__: str | None

    def add_arguments(self, parser: argparse.ArgumentParser) -> None:
        """Add the options of the case."""

    def run(self, options: argparse.Namespace) -> CaseResult:
        """Run the benchmark."""


def jpeg_file(text: str) -> Path:
    """The path of a JPEG file. Raises ``ArgumentTypeError`` for the name of another format."""
    path = Path(text)
    if path.suffix.lower() not in (".jpg", ".jpeg"):
        raise argparse.ArgumentTypeError(f"{text}: the picture is a JPEG, so end the name in .jpg")
    return path


# -------------------------------------------------------------------------------------------------------------   init


CASES: Mapping[str, str] = {
    "bodies": "benchmarks.cases.bodies",
    "bodies_draped": "benchmarks.cases.bodies_draped",
    "design_space": "benchmarks.cases.design_space",
    "drape": "benchmarks.cases.drape",
    "fabrics": "benchmarks.cases.fabrics",
    "fits": "benchmarks.cases.fits",
    "generated": "benchmarks.cases.generated",
    "loaders": "benchmarks.cases.loaders",
    "measures": "benchmarks.cases.measures",
    "outfits": "benchmarks.cases.outfits",
    "parity": "benchmarks.cases.parity",
    "patterns": "benchmarks.cases.patterns",
    "remote": "benchmarks.cases.remote",
    "render": "benchmarks.cases.render",
    "scale": "benchmarks.cases.scale",
    "waistband": "benchmarks.cases.waistband",
}
"""Case to its module, imported on use: each has heavy dependencies of its own."""


def load_case(name: str) -> CaseModule:
    """The module of a case in ``CASES``."""
    return cast(CaseModule, import_module(CASES[name]))
