"""What the verbs of ``gcd`` do, as functions: ``generate``, ``merge``, ``convert``, ``export`` and ``publish``.

Each tells how far it has come, returns that, and goes on where an earlier call was stopped.

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
    from gcd_dataset.verbs.exporting import export
    from gcd_dataset.verbs.making import generate, generate_recipe
    from gcd_dataset.verbs.merging import merge
    from gcd_dataset.verbs.progress import Progress, Told
    from gcd_dataset.verbs.publishing import Published, publish

__all__ = [
    "JobPart",
    "Progress",
    "Published",
    "Told",
    "convert",
    "export",
    "generate",
    "generate_people",
    "generate_recipe",
    "merge",
    "publish",
]

_HOME = {
    "convert": "converting",
    "export": "exporting",
    "generate": "making",
    "generate_people": "body_set",
    "generate_recipe": "making",
    "merge": "merging",
    "JobPart": "array_jobs",
    "Progress": "progress",
    "Told": "progress",
    "Published": "publishing",
    "publish": "publishing",
}


def __getattr__(name: str) -> Any:
    """Each function comes with what it needs alone: to publish takes no simulator."""
    if name not in _HOME:
        raise AttributeError(f"module {__name__} has no attribute {name}")
    return getattr(import_module(f"{__name__}.{_HOME[name]}"), name)


def __dir__() -> list[str]:
    return __all__
