"""A square with one knife pleat, sewn to a band along its top."""

import numpy as np

from gcd_dataset.records import Edge, EdgeRef, InnerLine, LineRole, Panel, Pattern, Placement, Seam


def pleated_square() -> Pattern:
    """Cloth of 20 by 12 cm, 12 by 12 cm when folded, under a band of 12 by 4 cm.

    The mountain fold is at x = 8, the valley fold at x = 12: from 4 to 8 cm three layers lie on each other.
    """
    hem, top = [(x, 0.0) for x in (0, 8, 12, 20)], [(x, 12.0) for x in (20, 16, 12, 8, 4, 0)]
    below = Panel(
        "skirt",
        np.array([*hem, *top]),
        tuple(Edge(i, (i + 1) % 10) for i in range(10)),
        Placement(np.array([0.0, 0.0, 10.0]), np.zeros(3)),
        lines=(InnerLine(7, 1, role=LineRole.FOLD, angle=180.0), InnerLine(6, 2, role=LineRole.FOLD, angle=-180.0)),
    )
    corners = [(0.0, 4.0), (0.0, 0.0), (4.0, 0.0), (8.0, 0.0), (12.0, 0.0), (12.0, 4.0)]
    band = Panel(
        "band",
        np.array(corners),
        tuple(Edge(i, (i + 1) % 6) for i in range(6)),
        Placement(np.array([0.0, 13.0, 10.0]), np.zeros(3)),
    )
    sides = [("band", 1, "skirt", 8), ("band", 2, "skirt", 7), ("skirt", 7, "skirt", 6), ("skirt", 6, "skirt", 5)]
    sides.append(("band", 3, "skirt", 4))
    return Pattern("pleat", (below, band), tuple(Seam(EdgeRef(a, i), EdgeRef(b, k)) for a, i, b, k in sides))
