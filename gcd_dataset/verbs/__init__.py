"""The verbs of ``gcd`` as functions: ``generate``, ``merge``, ``convert``, ``export``, ``publish`` and ``doctor``.

Each but ``doctor``, which only reads, reports its progress to a callback and resumes an earlier call that was stopped.

>>> from gcd_dataset.verbs import generate
>>> generate("shards", 1000, seed=7).made  # doctest: +SKIP
1000
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from gcd_dataset.verbs.array_jobs import JobPart
    from gcd_dataset.verbs.body_set import generate_people
    from gcd_dataset.verbs.converting import convert
    from gcd_dataset.verbs.examining import doctor
    from gcd_dataset.verbs.exporting import export
    from gcd_dataset.verbs.making import generate, generate_recipe
    from gcd_dataset.verbs.merging import merge
    from gcd_dataset.verbs.progress import Progress, ProgressCallback
    from gcd_dataset.verbs.publishing import Published, publish

__all__ = [
    "JobPart",
    "Progress",
    "ProgressCallback",
    "Published",
    "convert",
    "doctor",
    "export",
    "generate",
    "generate_people",
    "generate_recipe",
    "merge",
    "publish",
]

_HOME = {
    "convert": "converting",
    "doctor": "examining",
    "export": "exporting",
    "generate": "making",
    "generate_people": "body_set",
    "generate_recipe": "making",
    "merge": "merging",
    "JobPart": "array_jobs",
    "Progress": "progress",
    "ProgressCallback": "progress",
    "Published": "publishing",
    "publish": "publishing",
}


def __getattr__(name: str) -> Any:
    """Import a verb's module on first use: publishing needs no simulator."""
    if name not in _HOME:
        raise AttributeError(f"module {__name__} has no attribute {name}")
    return getattr(import_module(f"{__name__}.{_HOME[name]}"), name)


def __dir__() -> list[str]:
    return __all__
