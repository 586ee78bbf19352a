"""Outlines of panels for comparison: about the centroid, seen from the right side of the cloth."""

from dataclasses import dataclass

import numpy as np
import shapely
from jaxtyping import Float

from gcd_dataset.curves import LINE, sample_curve
from gcd_dataset.errors import PatternError
from gcd_dataset.records import Panel
from gcd_dataset.tensors import area_centroid, require_closed

CURVE_SAMPLES = 33  # points of a curved edge: an error of 1e-4 r for a quarter circle
CONTOUR_POINTS = 256
LARGEST = 1e12  # cm: specification files hold no larger number


@dataclass(frozen=True, eq=False)
class PanelShape:
    """A panel's outline about its centroid, seen from the right side of the cloth, and its position in space."""

    panel: Panel
    centroid: Float[np.ndarray, "2"]
    """In the panel's own coordinates [cm]."""
    side: float
    """1; or -1 for a panel whose loop runs clockwise, drawn from its wrong side."""
    loop: Float[np.ndarray, "n 2"]
    """Counter-clockwise polyline of the outline about the centroid [cm]; starts at the first corner."""
    polygon: shapely.Geometry
    centre: Float[np.ndarray, "3"]
    """The centroid in space [cm]."""
    matrix: Float[np.ndarray, "3 3"]
    """The rotation of ``loop``'s plane."""

    @staticmethod
    def of(panel: Panel) -> "PanelShape":
        """The shape of a panel.

        Raises ``PatternError`` for an open loop, an arc that does not span its chord, and numbers that are not finite.
        """
        outline = _polyline(panel)
        centroid, side = area_centroid(panel), float(np.copysign(1.0, signed_area(outline)))
        loop = (outline - centroid) * [side, 1.0]
        return PanelShape(
            panel=panel,
            centroid=centroid,
            side=side,
            loop=loop,
            polygon=shapely.buffer(shapely.make_valid(shapely.Polygon(loop)), 0.0),
            centre=panel.placement.apply(centroid),
            matrix=panel.placement.matrix @ np.diag([side, 1.0, side]),
        )

    def seen(self, points: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, "n 2"]:
        """Points of the panel's own coordinates about the centroid, as seen from the right side [cm]."""
        return (points - self.centroid) * [self.side, 1.0]

    def contour(self, count: int = CONTOUR_POINTS) -> Float[np.ndarray, "count 2"]:
        """Points at equal distances along the outline [cm]."""
        return resample_loop(self.loop, count)


def resample_loop(
    loop: Float[np.ndarray, "n 2"], count: int, offsets: Float[np.ndarray, "*o"] | float = 0.0
) -> Float[np.ndarray, "*o count 2"]:
    """``count`` points equally spaced along a closed polyline; the first lies ``offsets`` after the polyline's start.

    Offsets are arc lengths in the unit of ``loop``; an array of offsets gives one set of points for each.
    """
    closed = np.concatenate([loop, loop[:1]])
    arc_length = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(closed, axis=0), axis=1))])
    total = arc_length[-1]
    at = (np.asarray(offsets)[..., None] + np.arange(count) / count * total) % total if total else np.zeros(count)
    return np.stack([np.interp(at, arc_length, closed[:, axis]) for axis in (0, 1)], axis=-1)


def shape_or_none(panel: Panel) -> PanelShape | None:
    """The shape of a panel; ``None`` if it has no closed outline."""
    try:
        return PanelShape.of(panel)
    except PatternError:
        return None


def signed_area(loop: Float[np.ndarray, "n 2"]) -> float:
    """Area of a closed polyline, positive if it runs counter-clockwise [cm²]."""
    x, y = loop.T
    return float(0.5 * np.sum(x * np.roll(y, -1) - np.roll(x, -1) * y))


def _polyline(panel: Panel) -> Float[np.ndarray, "n 2"]:
    """The outline with sampled curves. Raises ``PatternError`` if it is not one closed loop."""
    require_closed(panel)
    if not _usable(panel.vertices):
        raise PatternError(f"panel {panel.name}: a vertex is not finite or too large: correct its vertices")
    if not _usable(panel.placement.translation) or not _usable(panel.placement.rotation):
        raise PatternError(f"panel {panel.name}: its placement is not finite or too large: correct it")
    pieces = [
        sample_curve(*panel.edge_ends(index), edge.curve, 2 if edge.curve == LINE else CURVE_SAMPLES)[:-1]
        for index, edge in enumerate(panel.edges)
    ]
    loop = np.concatenate(pieces)
    if len(loop) < 3:
        raise PatternError(f"panel {panel.name}: {len(loop)} straight edges: close the outline")
    if not _usable(loop):
        raise PatternError(f"panel {panel.name}: a curve is not finite or too large: correct its control points")
    return loop


def _usable(values: np.ndarray) -> bool:
    """Whether all values are finite and of a size that areas can be computed with."""
    return bool(np.all(np.abs(values) <= LARGEST))  # false for NaN
