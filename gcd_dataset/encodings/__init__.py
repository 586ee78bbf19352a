"""Patterns in the encodings of published models, and back, one module for each: ``encode`` and ``decode``.

What an encoding does not hold is stated at the top of its module and measured in
``benchmarks/reports/encodings.md``. Definitions are facts from the papers and public code that the modules name.

>>> from gcd_dataset.encodings import neuraltailor
>>> neuraltailor.PANEL_CLASSES[0]
'top_front'
"""

__all__ = ["aipparel", "garmentdiffusion", "neuraltailor", "sewformer", "sewingldm"]
