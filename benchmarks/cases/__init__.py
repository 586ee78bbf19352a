"""The benchmarks by name; each is a module like ``figures.Case``, imported when it is run."""

from collections.abc import Mapping
from importlib import import_module
from typing import cast

from benchmarks.cases.figures import Case

__all__ = ["CASES", "load_case"]

CASES: Mapping[str, str] = {
    "bodies": "benchmarks.cases.bodies",
    "design_space": "benchmarks.cases.design_space",
    "drape": "benchmarks.cases.drape",
    "engines": "benchmarks.cases.engines",
    "fabrics": "benchmarks.cases.fabrics",
    "fleet": "benchmarks.cases.fleet",
    "generated": "benchmarks.cases.generated",
    "libraries": "benchmarks.cases.libraries",
    "loaders": "benchmarks.cases.loaders",
    "measures": "benchmarks.cases.measures",
    "parity": "benchmarks.cases.parity",
    "patterns": "benchmarks.cases.patterns",
    "reconstruction": "benchmarks.cases.reconstruction",
    "scale": "benchmarks.cases.scale",
}
"""Case to its module: one needs a simulator, another a network."""


def load_case(name: str) -> Case:
    """The case of that name, one of ``CASES``."""
    return cast(Case, import_module(CASES[name]))
