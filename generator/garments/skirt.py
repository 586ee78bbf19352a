"""Functions for skirts of a front and a back, as wide at the top as the body and sewn at the sides.

Pieces are drawn symmetrically about x = 0, with the middle of their ``top`` at the origin; ``right`` is the wearer's.
"""

from gcd_dataset.generator.garments.trunk import waist_back, waist_front
from gcd_dataset.generator.pattern import Interface, Piece, backwards
from gcd_dataset.records import Measurements

SHORTEST = 5.0  # cm: the shortest skirt, GarmentCode


def length_below_waist(size: Measurements, below_hips: float, *, rise: float) -> float:
    """Length [cm] from a top at ``rise`` (0 hips, 1 waist) to the hem; ``below_hips``: of hips to floor."""
    return rise * size.hips_line + below_hips * size.leg_length


def waist_ring(size: Measurements, front: Piece, back: Piece) -> Interface:
    """The ring of both tops, gathered so that the side seams meet the sides of the waist."""
    front_ruffle = front.outline.length("top") / waist_front(size)
    back_ruffle = back.outline.length("top") / waist_back(size)
    return across(front, "top", ruffle=front_ruffle) + backwards(across(back, "top", ruffle=back_ruffle))


def hem_ring(front: Piece, back: Piece) -> Interface:
    """The ring of both hems."""
    return across(front, "bottom") + backwards(across(back, "bottom"))


def across(piece: Piece, edge: str, *, ruffle: float = 1.0) -> Interface:
    """An edge walked from the wearer's right to the left, whatever its drawing direction."""
    run = piece.outline.run(edge)
    if run[0].start[0] < run[-1].end[0]:
        return piece.along(edge, ruffle=ruffle)
    return piece.against(edge, ruffle=ruffle)
