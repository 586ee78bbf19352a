"""Measuring helpers for the tests of skirts."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from gcd_dataset.curves import curve_length
from gcd_dataset.faults import Severity, check_pattern
from gcd_dataset.generator.garments import design_from_dict, draw_garment
from gcd_dataset.generator.garments.mends import ALL_MENDS, Mend
from gcd_dataset.generator.garments.wardrobe import Bottom
from gcd_dataset.records import Measurements, Panel, Pattern

BOTH = ("skirt_front", "skirt_back")


def skirt(
    size: Measurements, kind: Bottom, sections: Mapping[str, Any], *, mends: frozenset[Mend] = ALL_MENDS
) -> Pattern:
    """The pattern of a skirt alone."""
    return draw_garment(
        size, design_from_dict({"meta": {"upper": None, "bottom": kind.value}, **sections}), mends=mends
    )


def length(panel: Panel, edge: str) -> float:
    """Length of all edges named ``edge`` [cm]."""
    return sum(curve_length(*panel.edge_ends(i), e.curve) for i, e in enumerate(panel.edges) if e.name == edge)


def lengths(pattern: Pattern, edge: str, panels: tuple[str, ...] = BOTH) -> float:
    """Length of all edges named ``edge`` in several panels [cm]."""
    return sum(length(pattern.panel(name), edge) for name in panels)


def ends(panel: Panel, edge: str) -> tuple[tuple[float, float], tuple[float, float]]:
    """Both ends of an edge in space, seen from the front [cm]."""
    (index,) = (i for i, e in enumerate(panel.edges) if e.name == edge)
    (ax, ay, _), (bx, by, _) = panel.placement.apply(np.array(panel.edge_ends(index)))
    return (float(ax), float(ay)), (float(bx), float(by))


def errors(pattern: Pattern) -> list[str]:
    return [str(fault) for fault in check_pattern(pattern) if fault.severity is Severity.ERROR]
