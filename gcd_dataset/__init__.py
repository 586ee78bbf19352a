"""Made-to-measure garments with their sewing patterns, for PyTorch.

``gcd_dataset.loaders`` serves them to a ``DataLoader``, ``gcd_dataset.generator`` makes them, ``gcd`` is the command
line. This module imports NumPy and the records only; torch and Warp are imported by the modules that use them.
"""

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
]

__version__ = "0.1.0"
