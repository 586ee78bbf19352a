"""The drawing language for garments: strokes make outlines, outlines pieces, pieces components, components a pattern.

A bag, open at the top, with a notch 10 cm deep in the hem of its front:

>>> side = Outline.start(0, 0).line(40, 0, name="hem").line(40, 40, name="left").line(0, 40, name="top")
>>> square = side.close(name="right")
>>> front = Piece("front", cut_into(square, "hem", notch(2.0, 10.0), at=20.0)).at(-20, 100, 15)
>>> back = Piece("back", square).at(-20, 100, -15)
>>> round_the_edge = ("right", "hem", "left")
>>> bag = Component.of(front, back).sewn(front.along(*round_the_edge), back.along(*round_the_edge))
>>> pattern = assemble(bag, "bag")
>>> [edge.name for edge in pattern.panel("front").edges]
['hem', 'notch.0', 'notch.1', 'hem', 'left', 'top', 'right']
>>> len(pattern.seams)  # the back's hem is divided to match the front's
4
"""

from gcd_dataset.generator.pattern.assemble import MeasuredJoin, assemble, assemble_and_measure, measure_joins, panel_of
from gcd_dataset.generator.pattern.component import Component
from gcd_dataset.generator.pattern.cubic_fit import s_shaped_cubic, smooth_cubic, tangent_quadratic
from gcd_dataset.generator.pattern.dart import cut_corner, cut_end, cut_into, dart, notch
from gcd_dataset.generator.pattern.outline import Outline
from gcd_dataset.generator.pattern.piece import Interface, Piece, backwards
from gcd_dataset.generator.pattern.stroke import Stroke, chain_from, rotate

__all__ = [
    "Component", "Interface", "MeasuredJoin", "Outline", "Piece", "Stroke", "assemble", "assemble_and_measure",
    "backwards", "chain_from", "cut_corner", "cut_end", "cut_into", "dart", "measure_joins", "notch", "panel_of",
    "rotate", "s_shaped_cubic", "smooth_cubic", "tangent_quadratic",
]  # fmt: skip
