"""How drawings of patterns lay out and colour their panels and seams."""

import colorsys
import functools
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from jaxtyping import Float

from gcd_dataset.curves import LINE, sample_curve, signed_area
from gcd_dataset.records import EdgeRef, Panel, Pattern

RGB: TypeAlias = tuple[int, int, int]

PAPER: RGB = (250, 250, 248)
INK: RGB = (40, 40, 40)
PLAIN_EDGE: RGB = (70, 70, 70)
"""The colour of edges without a seam."""
HUES = (
    (0.33, 0.47, 0.66), (0.85, 0.55, 0.36), (0.45, 0.62, 0.47), (0.76, 0.42, 0.44), (0.58, 0.49, 0.69),
    (0.87, 0.73, 0.43), (0.38, 0.63, 0.66), (0.80, 0.58, 0.67), (0.55, 0.55, 0.50), (0.62, 0.72, 0.42),
)  # fmt: skip
PALETTE = (*HUES, *((0.5 * r + 0.42, 0.5 * g + 0.42, 0.5 * b + 0.42) for r, g, b in HUES))
"""Panel colours by panel index, in renders and flat drawings; RGB, each 0 to 1."""
FLAT_LIGHTENING = 0.55  # share of white mixed in, so that edges and names stand out
GOLDEN_RATIO = 0.618034
ROUNDING = 1e-9  # cm


def cloth_colour(number: int) -> RGB:
    """The fill colour of panel ``number`` in a flat drawing."""
    red, green, blue = PALETTE[number % len(PALETTE)]
    return _rgb(*(channel + FLAT_LIGHTENING * (1 - channel) for channel in (red, green, blue)))


def seam_colour(number: int | None) -> RGB:
    """The colour of both edges of seam ``number``; ``None``: an edge without a seam.

    Hues step by the golden ratio, so that consecutive seams differ clearly.
    """
    if number is None:
        return PLAIN_EDGE
    return _rgb(*colorsys.hsv_to_rgb(number * GOLDEN_RATIO % 1.0, 0.85, 0.55 + 0.35 * (number % 3) / 2))


def _rgb(red: float, green: float, blue: float) -> RGB:
    return round(255 * red), round(255 * green), round(255 * blue)


FOLDED = {True: (1.2, 0.4, 0.2, 0.4), False: (0.8, 0.5)}
"""Dashes and gaps of folds, as in origami: a mountain fold (True) has dashes and dots, a valley fold dashes [cm]."""
CURVE_POINTS = 33  # points along a drawn curve
NAME_HEIGHTS = (0.5, 0.42, 0.58, 0.34, 0.66, 0.26, 0.74)  # heights to try, as shares of a panel's height
GRAIN_OFFSETS = (0.25, 0.75, 0.18, 0.82, 0.32, 0.68, 0.1, 0.9, 0.5)  # the same, shares of a panel's width


@dataclass(frozen=True, eq=False)
class SheetPanel:
    """A panel shifted to its position on the sheet; not turned, so its y axis is the grain."""

    panel: Panel
    number: int
    """Index of the panel in the pattern."""
    shift: Float[np.ndarray, "2"]
    """From the panel's plane to the sheet: x to the right, y up from the sheet's lower left corner [cm]."""
    seams: tuple[int | None, ...]
    """Index of the seam of each edge, then of each line, in the pattern; ``None``: no seam."""

    def edge_points(self, index: int) -> Float[np.ndarray, "n 2"]:
        """Points along an edge or line, both ends included, in the panel's plane [cm]."""
        return _edge_points(self.panel, index)

    @functools.cached_property
    def outline(self) -> Float[np.ndarray, "n 2"]:
        """Points along all edges, each corner once, in the panel's plane [cm]."""
        return _outline(self.panel)

    @property
    def orientation(self) -> float:
        """1 for an outline counter-clockwise on the sheet; -1 for clockwise, with the cloth's wrong side up."""
        return float(np.copysign(1.0, signed_area(self.outline)))

    def name_position(self) -> tuple[Float[np.ndarray, "2"], float]:
        """Centre and length of the widest horizontal stretch for the name, in the panel's plane [cm]."""
        return _widest_stretch(self.outline, NAME_HEIGHTS)

    def grain_position(self) -> tuple[Float[np.ndarray, "2"], float]:
        """Centre and length of the longest stretch along the grain, in the panel's plane [cm]."""
        centre, room = _widest_stretch(self.outline[:, ::-1], GRAIN_OFFSETS)
        return centre[::-1], room


@dataclass(frozen=True, eq=False)
class LayPlan:
    """The panels of a pattern on one sheet, without overlaps."""

    panels: tuple[SheetPanel, ...]
    width: float
    """[cm]"""
    height: float
    """[cm]"""


def lay_out(pattern: Pattern) -> LayPlan:
    """The panels in rows from the top down, tallest first."""
    return lay_out_nest([pattern])[0]


def lay_out_nest(patterns: Sequence[Pattern]) -> tuple[LayPlan, ...]:
    """A plan for each pattern, one garment in several sizes, with the origins of panels of one name at one point."""
    outlines = ((panel.name, _outline(panel)) for pattern in patterns for panel in pattern.panels)
    boxes = boxes_by_name((name, np.stack([outline.min(axis=0), outline.max(axis=0)])) for name, outline in outlines)
    lows, highs = np.stack(list(boxes.values()), axis=1)
    sizes = highs - lows
    gap = 0.04 * float(np.sqrt(sizes.prod(axis=1).sum()))
    widest = max(float(sizes[:, 0].max()), 1.15 * float(np.sqrt((sizes + gap).prod(axis=1).sum())))
    corners, height = pack(sizes, width=widest, gap=gap)
    width = float((corners + sizes)[:, 0].max())
    shifts = dict(zip(boxes, corners - lows, strict=True))
    return tuple(LayPlan(tuple(_sheet_panels(pattern, shifts)), width, height) for pattern in patterns)


def boxes_by_name(boxes: Iterable[tuple[str, Float[np.ndarray, "2 2"]]]) -> dict[str, Float[np.ndarray, "2 2"]]:
    """The box round all boxes of each name; a box is its lower left and its upper right corner."""
    found: dict[str, Float[np.ndarray, "2 2"]] = {}
    for name, box in boxes:
        low, high = found.get(name, box)
        found[name] = np.stack([np.minimum(low, box[0]), np.maximum(high, box[1])])
    return found


def _sheet_panels(pattern: Pattern, shifts: Mapping[str, Float[np.ndarray, "2"]]) -> Iterator[SheetPanel]:
    seam_of = {side: number for number, seam in enumerate(pattern.seams) for side in (seam.left, seam.right)}
    for number, panel in enumerate(pattern.panels):
        seams = tuple(seam_of.get(EdgeRef(panel.name, index)) for index in range(len(panel.edges) + len(panel.lines)))
        yield SheetPanel(panel, number, shifts[panel.name], seams)


def pack(sizes: Float[np.ndarray, "p 2"], *, width: float, gap: float) -> tuple[Float[np.ndarray, "p 2"], float]:
    """Lower left corners of rectangles on a sheet of ``width``, ``gap`` apart [cm], and the height of the sheet.

    y points up from the lower left corner of the sheet. Each rectangle takes the first shelf with room for it; one
    wider than the sheet takes a shelf of its own.
    """
    shelves: list[tuple[float, float, float]] = []  # top, height, used width
    corners = np.zeros_like(sizes)
    for number in np.argsort(-sizes[:, 1], kind="stable"):
        w, h = sizes[number].tolist()
        row = next((i for i, (_, _, used) in enumerate(shelves) if used + gap + w <= width + ROUNDING), None)
        if row is None:
            top = shelves[-1][0] - shelves[-1][1] - gap if shelves else 0.0
            corners[number] = (0.0, top - h)
            shelves.append((top, h, w))
        else:
            top, height, used = shelves[row]
            corners[number] = (used + gap, top - h)
            shelves[row] = (top, height, used + gap + w)
    height = shelves[-1][1] - shelves[-1][0] if shelves else 0.0
    return corners + [0.0, height], height


def _edge_points(panel: Panel, index: int) -> Float[np.ndarray, "n 2"]:
    edge = panel.edge(index)
    return sample_curve(*panel.edge_ends(index), edge.curve, 2 if edge.curve == LINE else CURVE_POINTS)


def _outline(panel: Panel) -> Float[np.ndarray, "n 2"]:
    return np.concatenate([_edge_points(panel, index)[:-1] for index in range(len(panel.edges))])


def _widest_stretch(outline: Float[np.ndarray, "n 2"], shares: Sequence[float]) -> tuple[Float[np.ndarray, "2"], float]:
    """Centre and width of the widest horizontal stretch inside an outline, at one of the shares of its height."""
    low, high = outline.min(axis=0), outline.max(axis=0)
    best, centre = 0.0, 0.5 * (low + high)
    for share in shares:
        level = low[1] + share * (high[1] - low[1])
        start, end = outline, np.roll(outline, -1, axis=0)
        crossed = (start[:, 1] < level) != (end[:, 1] < level)
        (x0, y0), (x1, y1) = start[crossed].T, end[crossed].T
        crossings = np.sort(x0 + (level - y0) / (y1 - y0) * (x1 - x0))  # x where the outline crosses the level
        for left, right in zip(crossings[::2], crossings[1::2], strict=False):
            if right - left > 1.05 * best:  # the first of nearly equal stretches is kept
                best, centre = float(right - left), np.array([0.5 * (left + right), level])
    return centre, best
