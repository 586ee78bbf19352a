"""Made-to-measure garments with their sewing patterns, for PyTorch.

``gcd_dataset.loaders`` serves them to a ``DataLoader``, ``gcd_dataset.generator`` makes them, ``gcd`` is the command
line; ``decode`` decodes tars that other libraries read. The names are imported on first use, with NumPy alone; torch
and Warp are imported by the modules that use them.
"""

from typing import TYPE_CHECKING

from gcd_dataset.lazy import lazy_names

if TYPE_CHECKING:
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
        Sample,
        Seam,
    )
    from gcd_dataset.shards.codec import decode

__all__ = [
    "Body",
    "BodyPart",
    "BodyShape",
    "BoxMesh",
    "Drape",
    "Edge",
    "EdgeRef",
    "Measurements",
    "Outcome",
    "Panel",
    "Pattern",
    "Placement",
    "Sample",
    "Seam",
    "__version__",
    "decode",
]

__version__ = "0.1.0"

_RECORDS = [name for name in __all__ if name not in ("__version__", "decode")]

__getattr__, __dir__ = lazy_names(__name__, {"records": _RECORDS, "shards.codec": ("decode",)})
