"""The result types of a benchmark case."""

import argparse
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple, Protocol


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
