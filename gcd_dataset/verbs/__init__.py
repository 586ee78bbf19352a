"""The verbs of ``gcd`` as functions: ``generate``, ``merge``, ``convert``, ``export``, ``publish`` and ``doctor``.

Each but ``doctor``, which only reads, reports its progress to a callback and resumes an earlier call that was stopped.

>>> from gcd_dataset.verbs import generate
>>> generate("shards", 1000, seed=7).made  # doctest: +SKIP
1000
"""

from typing import TYPE_CHECKING

from gcd_dataset.lazy import lazy_names

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

_NAMES_OF_MODULE = {
    "converting": ("convert",),
    "examining": ("doctor",),
    "exporting": ("export",),
    "making": ("generate", "generate_recipe"),
    "body_set": ("generate_people",),
    "merging": ("merge",),
    "array_jobs": ("JobPart",),
    "progress": ("Progress", "ProgressCallback"),
    "publishing": ("Published", "publish"),
}

__getattr__, __dir__ = lazy_names(__name__, _NAMES_OF_MODULE)
