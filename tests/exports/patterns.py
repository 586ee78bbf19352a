"""Patterns with known cut lines."""

from dataclasses import replace

import numpy as np

from gcd_dataset.curves import Arc, sample_curve
from gcd_dataset.records import EdgeRef, InnerLine, LineRole, Panel, Pattern, Seam
from tests.generator.mesh.shapes import panel, rectangle

SIDE = 40.0  # cm, of the squares
DART_MOUTH, DART_DEPTH = 4.0, 12.0  # cm
RADIUS = 30.0  # cm, of the quarter circle


def square(name: str, *, fold: int | None = None) -> Panel:
    """A square of 40 cm, counter-clockwise from the lower left; edge ``fold`` lies at a fold."""
    return panel(name, rectangle(SIDE, SIDE), labels={} if fold is None else {fold: "fold"})


def squares() -> Pattern:
    """Two squares: the right edge of the first is sewn to the left edge of the second."""
    return Pattern("squares", (square("one"), square("two")), (Seam(EdgeRef("one", 1), EdgeRef("two", 3)),))


def lined() -> Pattern:
    """``squares`` with a diagonal and a half circle in the first, the diagonal sewn to an edge of the second."""
    one, two = squares().panels
    lines = (InnerLine(0, 2, role=LineRole.FOLD), InnerLine(4, 5, Arc(5.0, False, True)))
    inner = replace(one, vertices=np.concatenate([one.vertices, [[25.0, 10.0], [35.0, 10.0]]]), lines=lines)
    return Pattern("lined", (inner, two), (*squares().seams, Seam(EdgeRef("one", 4), EdgeRef("two", 0))))


NAMES = (
    *("Cós esquerdo", "cos esquerdo", "x" * 40, "x" * 41),
    *("前片", "后片", "перед", "спинка", "앞판", "الأمام", "👗", "👚"),
    *("front left", "front_left", "front\u3000left", "نیم\u200cتنه", "👩\u200d🦰"),
    *("body", "Body", "world", "1a", "a#b", "a/b"),
)
"""Names in many scripts; some differ only in letters that a format cannot hold."""


def named(*names: str, title: str = "named") -> Pattern:
    """Squares with these names."""
    return Pattern(title, tuple(replace(square("a"), name=name) for name in names), ())


def darted() -> Pattern:
    """A square with a dart in the middle of its upper edge."""
    half, middle = DART_MOUTH / 2, SIDE / 2
    corners = [(0, 0), (SIDE, 0), (SIDE, SIDE), (middle + half, SIDE), (middle, SIDE - DART_DEPTH)]
    front = panel("front", [*corners, (middle - half, SIDE), (0, SIDE)])
    return Pattern("darted", (front,), (Seam(EdgeRef("front", 3), EdgeRef("front", 4)),))


def quarter_circle() -> Pattern:
    """A quarter of a circle of 30 cm: two radii and an arc."""
    arc = Arc(RADIUS, large=False, right=True)
    return Pattern("quarter", (panel("quarter", [(0, 0), (RADIUS, 0), (0, RADIUS)], curves={1: arc}),), ())


def exact_area(panel: Panel) -> float:
    """Area of a panel [cm²], from 2,000 points of each edge."""
    edges = [sample_curve(*panel.edge_ends(i), edge.curve, 2001)[:-1] for i, edge in enumerate(panel.edges)]
    x, y = np.concatenate(edges).T
    return float(abs(0.5 * (x * np.roll(y, -1) - np.roll(x, -1) * y).sum()))
