"""Garments in the formats of other programs: meshes for renderers, patterns for cutters and printers.

``glb``, ``obj``, ``ply`` and ``usd`` write a draped sample; ``dxf`` and ``pdf`` write the pattern of a sample or of a
specification file. Each writes its file whole or not at all.

>>> from gcd_dataset.exports import pdf
>>> from gcd_dataset.spec import read_pattern
>>> pdf(read_pattern("shirt_specification.json"), "shirt.pdf", seam_allowance=1.5)  # doctest: +SKIP
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from gcd_dataset.exports.dxf_file import dxf
    from gcd_dataset.exports.mesh_files import glb, obj, ply
    from gcd_dataset.exports.pdf_file import pdf
    from gcd_dataset.exports.usd_file import usd

__all__ = ["dxf", "glb", "obj", "pdf", "ply", "usd"]

_HOME = {
    "dxf": "dxf_file",
    "glb": "mesh_files",
    "obj": "mesh_files",
    "pdf": "pdf_file",
    "ply": "mesh_files",
    "usd": "usd_file",
}


def __getattr__(name: str) -> Any:
    """Import the module of a format on first use."""
    if name not in _HOME:
        raise AttributeError(f"module {__name__} has no attribute {name}")
    return getattr(import_module(f"{__name__}.{_HOME[name]}"), name)


def __dir__() -> list[str]:
    return __all__
