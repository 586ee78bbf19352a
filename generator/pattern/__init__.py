"""The language that garments are drawn in: outlines, pieces, components, and the pattern they are assembled to."""

from gcd_dataset.generator.pattern.assemble import assemble
from gcd_dataset.generator.pattern.component import Component
from gcd_dataset.generator.pattern.dart import cut_corner, cut_into, dart, notch
from gcd_dataset.generator.pattern.edge import Stroke, chain_from, rotate
from gcd_dataset.generator.pattern.fit import smooth_cubic
from gcd_dataset.generator.pattern.outline import Outline
from gcd_dataset.generator.pattern.panel import Piece
from gcd_dataset.generator.pattern.seam import Interface, backwards

__all__ = [
    "Component",
    "Interface",
    "Outline",
    "Piece",
    "Stroke",
    "assemble",
    "backwards",
    "chain_from",
    "cut_corner",
    "cut_into",
    "dart",
    "notch",
    "rotate",
    "smooth_cubic",
]
