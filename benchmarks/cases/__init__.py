"""The benchmark cases by name; each is a module of the form ``figures.CaseModule``, imported on use."""

from collections.abc import Mapping
from importlib import import_module
from typing import cast

from benchmarks.cases.figures import CaseModule

__all__ = ["CASES", "load_case"]

CASES: Mapping[str, str] = {
    "bodies": "benchmarks.cases.bodies",
    "bodies_draped": "benchmarks.cases.bodies_draped",
    "design_space": "benchmarks.cases.design_space",
    "drape": "benchmarks.cases.drape",
    "fabrics": "benchmarks.cases.fabrics",
    "generated": "benchmarks.cases.generated",
    "loaders": "benchmarks.cases.loaders",
    "measures": "benchmarks.cases.measures",
    "parity": "benchmarks.cases.parity",
    "patterns": "benchmarks.cases.patterns",
    "pictures_matter": "benchmarks.reconstruction.picture_training",
    "reconstruction": "benchmarks.cases.reconstruction",
    "remote": "benchmarks.cases.remote",
    "render": "benchmarks.cases.render",
    "scale": "benchmarks.cases.scale",
}
"""Case to its module, imported on use: each has heavy dependencies of its own."""


def load_case(name: str) -> CaseModule:
    """The module of a case in ``CASES``."""
    return cast(CaseModule, import_module(CASES[name]))
