"""Garments in the formats of other programs: meshes for renderers, patterns for cutters and printers.

``glb``, ``obj``, ``ply`` and ``usd`` write a draped sample; ``dxf`` and ``pdf`` write the pattern of a sample or of a
specification file. Each writes its file whole or not at all.

>>> from gcd_dataset.exports import pdf
>>> from gcd_dataset.spec import read_pattern
>>> pdf(read_pattern("shirt_specification.json"), "shirt.pdf", seam_allowance=1.5)  # doctest: +SKIP
"""

from typing import TYPE_CHECKING

from gcd_dataset.lazy import lazy_names

if TYPE_CHECKING:
    from gcd_dataset.exports.dxf_file import dxf
    from gcd_dataset.exports.meshes import glb, obj, ply, usd
    from gcd_dataset.exports.pdf_file import pdf

__all__ = ["dxf", "glb", "obj", "pdf", "ply", "usd"]

__getattr__, __dir__ = lazy_names(__name__)
