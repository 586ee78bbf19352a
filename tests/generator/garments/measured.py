"""Measures of drawn patterns, and designs of the reference with their patterns."""

from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np
from jaxtyping import Float

from gcd_dataset.curves import curve_length, sample_curve
from gcd_dataset.faults import Severity, check_pattern
from gcd_dataset.generator.garments import design_from_dict, draw_garment
from gcd_dataset.generator.garments.mends import ALL_MENDS, Mend
from gcd_dataset.generator.garments.wardrobe import Bottom
from gcd_dataset.records import EdgeRef, Measurements, Panel, Pattern, Seam

BOTH = ("skirt_front", "skirt_back")
TORSOS = ("right_ftorso", "left_ftorso", "right_btorso", "left_btorso")
EXAMPLES = (
    "asymm_circle_skirt_lapel_dress", "asymmetric_top", "circle_skirt", "dress", "fitted_shirt", "godet_skirt",
    "jumpsuit", "levels_skirt", "pants_cuff", "pencil_skirt", "shirt_sleeves_hood", "strapless_dress",
)  # fmt: skip
"""Designs of the reference, each with its pattern on two bodies."""


def skirt(
    size: Measurements, kind: Bottom, sections: Mapping[str, Any], *, mends: frozenset[Mend] = ALL_MENDS
) -> Pattern:
    """The pattern of a skirt alone."""
    return draw_garment(
        size, design_from_dict({"meta": {"upper": None, "bottom": kind.value}, **sections}), mends=mends
    )


def edge_lengths(panel: Panel, name: str) -> list[float]:
    """Length of each edge of a name [cm]."""
    return [curve_length(*panel.edge_ends(i), edge.curve) for i, edge in enumerate(panel.edges) if edge.name == name]


def length(panel: Panel, *names: str) -> float:
    """Length of all edges of these names [cm]."""
    return sum(sum(edge_lengths(panel, name)) for name in names)


def lengths(pattern: Pattern, edge: str, panels: Iterable[str] = BOTH) -> float:
    """Length of all edges named ``edge`` in several panels [cm]."""
    return sum(length(pattern.panel(name), edge) for name in panels)


def ref_length(pattern: Pattern, ref: EdgeRef) -> float:
    """Length of one edge [cm]."""
    panel = pattern.panel(ref.panel)
    return curve_length(*panel.edge_ends(ref.edge), panel.edge(ref.edge).curve)


def seams(pattern: Pattern, one: str, other: str) -> list[Seam]:
    """The seams between two panels."""
    return [seam for seam in pattern.seams if {seam.left.panel, seam.right.panel} == {one, other}]


def ends(panel: Panel, edge: str) -> tuple[tuple[float, float], tuple[float, float]]:
    """Both ends of an edge in space, seen from the front [cm]."""
    (index,) = (i for i, e in enumerate(panel.edges) if e.name == edge)
    (ax, ay, _), (bx, by, _) = panel.placement.apply(np.array(panel.edge_ends(index)))
    return (float(ax), float(ay)), (float(bx), float(by))


def contour(panel: Panel, *, placed: bool = False) -> Float[np.ndarray, "n k"]:
    """Points along the outline [cm]: in the panel, from its first corner, or in space."""
    points = np.concatenate([sample_curve(*panel.edge_ends(i), edge.curve, 60) for i, edge in enumerate(panel.edges)])
    return panel.placement.apply(points) if placed else points - panel.vertices[0]


def errors(pattern: Pattern) -> list[str]:
    return [str(fault) for fault in check_pattern(pattern) if fault.severity is Severity.ERROR]
