"""What a case gives back."""

import argparse
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple, Protocol

__all__ = ["Case", "Figure", "Measured"]


class Figure(NamedTuple):
    """One measured number; printed as ``case.metric value unit``."""

    metric: str
    value: float
    unit: str


@dataclass(frozen=True)
class Measured:
    """The figures of a run, and the rows they were taken from."""

    figures: Sequence[Figure]
    rows: Sequence[Mapping[str, Any]] = field(default_factory=tuple)
    """A table for the report; every row has the same keys."""


class Case(Protocol):
    """A module of this folder."""

    __doc__: str | None

    def add_arguments(self, parser: argparse.ArgumentParser) -> None:
        """The options of the case."""

    def run(self, options: argparse.Namespace) -> Measured:
        """Measure."""
