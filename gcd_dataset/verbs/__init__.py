"""The verbs of ``gcd`` as functions: ``generate``, ``convert``, ``index``, ``export``, ``publish`` and ``doctor``.

Each but ``doctor``, which only reads, can be repeated after it was stopped; those that take long report their progress
to a callback.

>>> from gcd_dataset.verbs import generate
>>> generate("shards", 1000, seed=7).made  # doctest: +SKIP
1000
"""

from typing import TYPE_CHECKING

from gcd_dataset.lazy import lazy_names

if TYPE_CHECKING:
    from gcd_dataset.hub.publish import publish
    from gcd_dataset.making.conversion import convert
    from gcd_dataset.making.garments import generate, generate_recipe
    from gcd_dataset.making.people import generate_people
    from gcd_dataset.making.progress import Progress, ProgressCallback
    from gcd_dataset.making.run import index
    from gcd_dataset.making.tasks import Job
    from gcd_dataset.verbs.examining import doctor
    from gcd_dataset.verbs.exporting import export

__all__ = [
    "Job",
    "Progress",
    "ProgressCallback",
    "convert",
    "doctor",
    "export",
    "generate",
    "generate_people",
    "generate_recipe",
    "index",
    "publish",
]

_NAMES_OF_MODULE = {
    "gcd_dataset.hub.publish": ("publish",),
    "gcd_dataset.making.conversion": ("convert",),
    "gcd_dataset.making.garments": ("generate", "generate_recipe"),
    "gcd_dataset.making.people": ("generate_people",),
    "gcd_dataset.making.progress": ("Progress", "ProgressCallback"),
    "gcd_dataset.making.run": ("index",),
    "gcd_dataset.making.tasks": ("Job",),
    "examining": ("doctor",),
    "exporting": ("export",),
}

__getattr__, __dir__ = lazy_names(__name__, _NAMES_OF_MODULE)
