"""A square with one knife pleat, sewn to a band along its top."""

from dataclasses import replace

from gcd_dataset.records import EdgeRef, InnerLine, LineRole, Pattern, Seam
from tests.generator.mesh.shapes import panel


def pleated_square() -> Pattern:
    """Cloth of 20 by 12 cm, 12 by 12 cm when folded, under a band of 12 by 4 cm.

    The mountain fold is at x = 8, the valley fold at x = 12: from 4 to 8 cm three layers lie on each other.
    """
    hem, top = [(x, 0.0) for x in (0, 8, 12, 20)], [(x, 12.0) for x in (20, 16, 12, 8, 4, 0)]
    folds = InnerLine(7, 1, role=LineRole.FOLD, angle=180.0), InnerLine(6, 2, role=LineRole.FOLD, angle=-180.0)
    below = replace(panel("skirt", [*hem, *top], at=(0.0, 0.0, 10.0)), lines=folds)
    corners = [(0.0, 4.0), (0.0, 0.0), (4.0, 0.0), (8.0, 0.0), (12.0, 0.0), (12.0, 4.0)]
    band = panel("band", corners, at=(0.0, 13.0, 10.0))
    sides = [("band", 1, "skirt", 8), ("band", 2, "skirt", 7), ("skirt", 7, "skirt", 6), ("skirt", 6, "skirt", 5)]
    sides.append(("band", 3, "skirt", 4))
    return Pattern("pleat", (below, band), tuple(Seam(EdgeRef(a, i), EdgeRef(b, k)) for a, i, b, k in sides))
