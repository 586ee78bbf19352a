"""Patterns as SVG drawings at true scale, for printers and cutters.

One unit is a centimetre. Each panel is a group with a transform to its own plane, y up, so that paths hold the
pattern's own coordinates: the cloth as one closed path, each edge as a path (``data-edge``, ``data-seam``), the grain
line.
"""

from collections.abc import Mapping
from xml.etree import ElementTree

import numpy as np
from jaxtyping import Float

from gcd_dataset.curves import Arc, Cubic, Curve, Point, Quadratic, curve_points, curve_tangents, from_frame
from gcd_dataset.errors import shown
from gcd_dataset.generator.lay_plan import (
    FOLDED,
    INK,
    RGB,
    LayPlan,
    SheetPanel,
    cloth_colour,
    lay_out,
    lay_out_nest,
    seam_colour,
)
from gcd_dataset.records import InnerLine, Pattern

__all__ = ["nest_svg", "pattern_svg"]

MARGIN = 1.0  # cm of empty border round the drawing
LINE_WIDTH = 0.12  # cm
LARGEST_NAME, SMALLEST_NAME = 2.0, 0.3  # cm, height of letters
LETTER_WIDTH = 0.6  # mean, as a share of the height, in the usual sans serif
NAME_SHARE = 0.45  # share of the room that a name may take; the grain line needs the rest
GRAIN_SHARE, ARROW = 0.6, 0.8  # share of the room along the grain; length of an arrow head [cm]
SIZE_ROW, SIZE_NAME = 4.0, 1.5  # cm, heights of the row of a nest's sizes, and of their names
SEAM_NUMBER, SEAM_SHARE = 0.9, 0.3  # height of a seam number [cm], at most this share of its edge's length
TINY = 1e-9  # cm: least divisor, for edges without length

Node = ElementTree.Element


def pattern_svg(pattern: Pattern, plan: LayPlan | None = None) -> bytes:
    """The panels side by side with names and grain lines; edges sewn together share a colour and a number.

    The number is the seam's index in the pattern, and the index of its stitch in a specification file. ``plan``: the
    pattern's ``lay_out``, where it is known.
    """
    plan = plan or lay_out(pattern)
    root, height = _sheet(pattern.name, plan.width, plan.height)
    root.extend(_panel(piece, height) for piece in plan.panels)
    return _written(root)


def nest_svg(patterns: Mapping[str, Pattern]) -> bytes:
    """One garment in several sizes, panels of one name over one another; ``patterns``: size to pattern, one at least.

    Each size is a group (``data-size``, a layer in Inkscape) in a colour of its own, smallest first, as in the row of
    sizes below the panels. Names and seam numbers are those of the first size that has the panel.
    """
    [pattern, *_], plans = patterns.values(), lay_out_nest(list(patterns.values()))
    root, height = _sheet(pattern.name, plans[0].width, plans[0].height + SIZE_ROW)
    root.set("xmlns:inkscape", "http://www.inkscape.org/namespaces/inkscape")
    drawn: set[str] = set()
    for number, (size, plan) in enumerate(zip(patterns, plans, strict=True)):
        ink, name = seam_colour(number), shown(size)
        layer = {"data-size": name, "inkscape:groupmode": "layer", "inkscape:label": name}
        group = ElementTree.SubElement(root, "g", layer)
        column = plan.width / len(plans)
        letters = min(SIZE_NAME, 0.8 * column / (LETTER_WIDTH * max(len(name), 1)))
        at = _upright(MARGIN + (number + 0.5) * column, height - MARGIN - 0.5 * SIZE_ROW)
        ElementTree.SubElement(group, "g", {"transform": at}).append(_text(name, np.zeros(2), letters, ink))
        for piece in plan.panels:
            group.append(_panel(piece, height - SIZE_ROW, ink, is_named=piece.panel.name not in drawn))
            drawn.add(piece.panel.name)
    return _written(root)


def _sheet(title: str, width: float, height: float) -> tuple[Node, float]:
    """An empty drawing with room for ``width`` and ``height`` [cm], and its height with margins."""
    width, height = width + 2 * MARGIN, height + 2 * MARGIN
    root = ElementTree.Element(
        "svg",
        {
            "xmlns": "http://www.w3.org/2000/svg",
            "width": f"{_number(width)}cm",
            "height": f"{_number(height)}cm",
            "viewBox": f"0 0 {_number(width)} {_number(height)}",
            "font-family": "sans-serif",
            "text-anchor": "middle",
            "fill": "none",
            "stroke-linecap": "round",
            "stroke-linejoin": "round",
            "stroke-width": str(LINE_WIDTH),
        },
    )
    ElementTree.SubElement(root, "title").text = shown(title)
    return root, height


def _written(root: Node) -> bytes:
    ElementTree.indent(root)
    return ElementTree.tostring(root, encoding="utf-8", xml_declaration=True) + b"\n"


def _panel(piece: SheetPanel, height: float, ink: RGB | None = None, *, is_named: bool = True) -> Node:
    """The group of one panel: cloth, edges, grain line; name and seam numbers if ``is_named``.

    ``ink``: colour of all lines of a panel in a nest, whose cloth has none; ``None``: colours by panel and seam.
    """
    x, y = piece.shift[0] + MARGIN, height - MARGIN - piece.shift[1]
    name = shown(piece.panel.name)
    group = ElementTree.Element("g", {"data-panel": name, "transform": _upright(x, y)})
    ElementTree.SubElement(group, "title").text = name
    steps = [_command(*piece.panel.edge_ends(i), edge.curve) for i, edge in enumerate(piece.panel.edges)]
    loop = " ".join([f"M{_point(piece.panel.edge_ends(0)[0])}", *steps, "Z"])
    ElementTree.SubElement(group, "path", {"d": loop} | ({} if ink else {"fill": _hex(cloth_colour(piece.number))}))
    for index, seam in enumerate(piece.seams):
        start, end = piece.panel.edge_ends(index)
        edge = piece.panel.edge(index)
        attributes = {"data-edge": str(index)} | ({} if seam is None else {"data-seam": str(seam)})
        if isinstance(edge, InnerLine):
            attributes |= {"data-role": shown(edge.role), "stroke-width": str(0.5 * LINE_WIDTH)}
            if edge.angle:
                dashes = " ".join(map(str, FOLDED[edge.angle > 0.0]))
                attributes |= {"data-angle": f"{edge.angle:g}", "stroke-dasharray": dashes}
        line = f"M{_point(start)} {_command(start, end, edge.curve)}"
        ElementTree.SubElement(group, "path", {"d": line, "stroke": _hex(ink or seam_colour(seam)), **attributes})
    group.append(_grain_line(piece, ink or INK))
    if not is_named:
        return group
    centre, room = piece.name_position()
    fitting = NAME_SHARE * room / (LETTER_WIDTH * max(len(name), 1))
    group.append(_text(name, centre, min(LARGEST_NAME, max(SMALLEST_NAME, fitting)), INK))
    group.extend(_seam_number(piece, index, seam) for index, seam in enumerate(piece.seams) if seam is not None)
    return group


def _command(start: Point, end: Point, curve: Curve) -> str:
    """The path command for an edge, from the current point ``start`` to ``end``."""
    match curve:
        case Quadratic(control):
            return f"Q{_point(from_frame(start, end, control))} {_point(end)}"
        case Cubic(control0, control1):
            return (
                f"C{_point(from_frame(start, end, control0))} {_point(from_frame(start, end, control1))} {_point(end)}"
            )
        case Arc(radius, large, right):  # sweep 1 turns from x towards y, with y up or down
            return f"A{_number(radius)} {_number(radius)} 0 {large:d} {right:d} {_point(end)}"
        case _:
            return f"L{_point(end)}"


def _grain_line(piece: SheetPanel, ink: RGB) -> Node:
    """A line along the warp, the panel's y axis, with an arrow head at both ends."""
    (x, y), room = piece.grain_position()
    half = 0.5 * GRAIN_SHARE * room
    head = min(ARROW, half)
    line = f"M{_point((x, y - half))} L{_point((x, y + half))}"
    heads = [_arrow_head(x, y + sign * half, sign * head) for sign in (1, -1)]
    return ElementTree.Element("path", {"class": "grain", "d": " ".join([line, *heads]), "stroke": _hex(ink)})


def _arrow_head(x: float, tip: float, length: float) -> str:
    barb = 0.4 * length
    return f"M{_point((x - barb, tip - length))} L{_point((x, tip))} L{_point((x + barb, tip - length))}"


def _seam_number(piece: SheetPanel, index: int, seam: int) -> Node:
    """The number of a seam, on the cloth beside the middle of its edge."""
    ends, half = (*piece.panel.edge_ends(index), piece.panel.edge(index).curve), np.array([0.5])
    (dx, dy), middle = curve_tangents(*ends, half)[0], curve_points(*ends, half)[0]
    size = min(SEAM_NUMBER, SEAM_SHARE * float(np.hypot(*np.subtract(ends[1], ends[0]))))
    inwards = piece.orientation * np.array([-dy, dx]) / max(float(np.hypot(dx, dy)), TINY)
    return _text(str(seam), middle + 0.7 * size * inwards, size, seam_colour(seam))


def _text(text: str, centre: Float[np.ndarray, "2"], size: float, colour: RGB) -> Node:
    attributes = {"transform": _upright(*centre), "font-size": _number(size), "dy": "0.35em", "fill": _hex(colour)}
    node = ElementTree.Element("text", attributes)
    node.text = text
    return node


def _upright(x: float, y: float) -> str:
    """The transform to ``(x, y)`` with y flipped: from y up to y down, or back."""
    return f"matrix(1 0 0 -1 {_number(x)} {_number(y)})"


def _point(point: Point) -> str:
    return f"{_number(point[0])} {_number(point[1])}"


def _number(value: float) -> str:
    """Six decimals (1e-5 mm in centimetres) without trailing zeros."""
    return f"{value:.6f}".rstrip("0").rstrip(".")


def _hex(colour: RGB) -> str:
    return "#" + "".join(f"{part:02x}" for part in colour)
