"""Made-to-measure garments with their sewing patterns, for PyTorch.

``gcd_dataset.loaders`` serves them to a ``DataLoader``, ``gcd_dataset.generator`` makes them, ``gcd`` is the command
line; ``decode`` decodes tars that other libraries read. ``generate``, ``convert``, ``index``, ``export`` and
``publish`` are the commands of the same names: each can be repeated after it was stopped, and those that take long
report their progress to a callback: ``generate("shards", 1000, seed=7)``. The names are imported on first use: those
of records need NumPy alone, those of commands what the command needs.
"""

from typing import TYPE_CHECKING

from gcd_dataset.lazy import lazy_names

if TYPE_CHECKING:
    from gcd_dataset.exports.datasets import export
    from gcd_dataset.hub.publish import publish
    from gcd_dataset.making.conversion import convert
    from gcd_dataset.making.garments import generate, generate_people, generate_recipe
    from gcd_dataset.making.progress import Progress, ProgressCallback
    from gcd_dataset.making.run import index
    from gcd_dataset.making.tasks import Job
    from gcd_dataset.records import (
        Body,
        BodyPart,
        BodyShape,
        BoxMesh,
        Drape,
        Edge,
        EdgeRef,
        Measurements,
        Outcome,
        Panel,
        Pattern,
        Placement,
        Pose,
        Sample,
        Seam,
    )
    from gcd_dataset.shards.codec import decode

__all__ = [
    "Body", "BodyPart", "BodyShape", "BoxMesh", "Drape", "Edge", "EdgeRef", "Job", "Measurements", "Outcome", "Panel",
    "Pattern", "Placement", "Pose", "Progress", "ProgressCallback", "Sample", "Seam", "__version__", "convert",
    "decode", "export", "generate", "generate_people", "generate_recipe", "index", "publish",
]  # fmt: skip

__version__ = "1.0.0"

__getattr__, __dir__ = lazy_names(__name__)
