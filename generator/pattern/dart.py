"""Cuts in an outline: darts, notches and cut-off corners.

>>> from gcd_dataset.generator.pattern.outline import Outline
>>> skirt = Outline.start(0, 0).line(0, -40).line(60, -40, name="hem").line(60, 0).close(name="waist")
>>> cut = cut_into(skirt, "hem", notch(4.0, 10.0), at=30.0)
>>> [round(piece.length, 3) for piece in cut.run("hem")], cut.area
([28.0, 28.0], 2380.0)
"""

from math import atan2, hypot, sqrt

from gcd_dataset.curves import Point
from gcd_dataset.errors import PatternError
from gcd_dataset.generator.pattern.outline import Outline
from gcd_dataset.generator.pattern.stroke import Stroke, chain_from

MOUTH_TOLERANCE = 1e-9  # cm², of Newton's method
MOUTH_STEPS = 20  # most steps of Newton's method


def dart(width: float, leg: float, *, name: str = "dart") -> tuple[Stroke, Stroke]:
    """The two legs of a dart, each ``leg`` long, over an opening of ``width`` [cm].

    Raises ``PatternError`` for legs too short to meet.
    """
    if leg <= 0.5 * width:
        raise PatternError(f"dart {name}: legs of {leg:.2f} cm do not meet over an opening of {width:.2f} cm")
    return notch(width, sqrt(leg**2 - 0.25 * width**2), name=name)


def notch(width: float, depth: float, *, name: str = "notch") -> tuple[Stroke, Stroke]:
    """The sides ``name.0`` and ``name.1`` of an isosceles notch, ``width`` wide at the edge and ``depth`` deep [cm]."""
    tip = (0.5 * width, depth)
    return Stroke((0.0, 0.0), tip, name=f"{name}.0"), Stroke(tip, (width, 0.0), name=f"{name}.1")


def cut_into(outline: Outline, edge: str, shape: tuple[Stroke, ...], *, at: float) -> Outline:
    """The outline with a shape cut into an edge: its mouth centred ``at`` cm along the edge, its depth to the inside.

    The shape is drawn from the origin along the x axis, with its depth in positive y. The remaining parts of the edge
    keep its name; ``at`` counts along the parts that earlier cuts have left.
    Raises ``PatternError`` for a mouth that does not fit between the ends of the edge.
    """
    stroke, at = _part_at(outline.run(edge), at)
    mouth = hypot(shape[-1].end[0], shape[-1].end[1])
    first, last = _mouth(stroke, at, mouth)
    before, under, after = stroke.split_at([first, last])
    if outline.area < 0:  # drawn clockwise: the inside lies to the right
        shape = tuple(side.upside_down() for side in shape)
    return outline.with_strokes((stroke,), (before, *_aligned(shape, under), after))


def cut_end(outline: Outline, edge: str, shape: tuple[Stroke, ...], *, last: bool) -> Outline:
    """The outline with a shape cut into the start of an edge, or (``last``) into its end; otherwise as ``cut_into``.

    Raises ``PatternError`` for a mouth wider than the edge.
    """
    run = outline.run(edge)
    stroke = run[-1] if last else run[0]
    mouth = hypot(shape[-1].end[0], shape[-1].end[1])
    if last:
        rest, under = stroke.split_at([1 - _chord_parameter(stroke.reversed(), mouth)])
    else:
        under, rest = stroke.split_at([_chord_parameter(stroke, mouth)])
    if outline.area < 0:
        shape = tuple(side.upside_down() for side in shape)
    cut = _aligned(shape, under)
    return outline.with_strokes((stroke,), (rest, *cut) if last else (*cut, rest))


def cut_corner(outline: Outline, low: str, high: str, shape: tuple[Stroke, ...]) -> Outline:
    """The outline with the corner between two straight edges replaced by a shape, which is moved but not turned.

    ``low`` ends at the corner and ``high`` begins there; of divided edges the adjacent parts are taken. Both are
    shortened to the ends of the shape, at parameters ``a`` and ``b``: ``low(a) + chord = high(b)``, two linear
    equations.
    Raises ``PatternError`` for a shape that does not fit between the edges.
    """
    below, above = outline.run(low)[-1], outline.run(high)[0]
    chord = (shape[-1].end[0] - shape[0].start[0], shape[-1].end[1] - shape[0].start[1])
    a, b = _corner_parameters(below, above, chord)
    kept_below, _ = below.split_at([a])
    _, kept_above = above.split_at([b])
    placed = chain_from(kept_below.end, *shape)
    return outline.with_strokes((below, above), (kept_below, *placed, kept_above))


def _part_at(parts: tuple[Stroke, ...], at: float) -> tuple[Stroke, float]:
    """The part of a divided edge that contains the point ``at`` cm along the edge, and the rest of ``at`` within it."""
    for part in parts[:-1]:
        if at <= part.length:
            return part, at
        at -= part.length
    return parts[-1], at


def _corner_parameters(low: Stroke, high: Stroke, chord: Point) -> tuple[float, float]:
    """Parameters ``a`` and ``b`` on the two edges with ``low(a) + chord = high(b)``."""
    (ux, uy), (vx, vy) = low.chord, high.chord
    rx, ry = high.start[0] - low.start[0] - chord[0], high.start[1] - low.start[1] - chord[1]
    determinant = vx * uy - ux * vy
    if determinant == 0.0:
        raise PatternError(f"edges {low.name} and {high.name} are parallel: there is no corner to cut")
    a, b = (vx * ry - vy * rx) / determinant, (ux * ry - uy * rx) / determinant
    if not all(0.0 < share < 1.0 for share in (a, b)):
        raise PatternError(
            f"a cut from {low.name} to {high.name} does not fit the corner: it would end at {a:.2f} and {b:.2f} of them"
        )
    return a, b


def _chord_parameter(stroke: Stroke, chord: float) -> float:
    """The curve parameter of the point at ``chord`` cm straight distance from the start, by Newton's method."""
    t = chord / stroke.length
    for _ in range(MOUTH_STEPS):
        (x, y), (dx, dy) = stroke.at(t), stroke.velocity(t)
        ax, ay = x - stroke.start[0], y - stroke.start[1]
        excess = ax * ax + ay * ay - chord * chord
        if abs(excess) <= MOUTH_TOLERANCE and 0.0 < t < 1.0:
            return t
        t -= excess / (2 * (ax * dx + ay * dy))
    raise PatternError(f"edge {stroke.name} of {stroke.length:.2f} cm: an opening of {chord:.2f} cm does not fit")


def _mouth(stroke: Stroke, at: float, width: float) -> tuple[float, float]:
    """Curve parameters of two points ``width`` cm apart, equally far from the point ``at`` cm along the stroke."""
    length = stroke.length
    if not 0.5 * width < at < length - 0.5 * width:
        raise PatternError(
            f"edge {stroke.name} of {length:.2f} cm: an opening of {width:.2f} cm centred at {at:.2f} cm does not fit"
        )
    middle = stroke.parameter(at / length)
    centre, half = stroke.at(middle), 0.5 * width / hypot(*stroke.velocity(middle))
    low, high = middle - half, middle + half
    for _ in range(MOUTH_STEPS):
        residual, step = _mouth_step(stroke, centre, low, high, width)
        if residual <= MOUTH_TOLERANCE:
            break
        low, high = low + step[0], high + step[1]
    if residual > MOUTH_TOLERANCE or not 0.0 < low < high < 1.0:
        raise PatternError(f"edge {stroke.name}: an opening of {width:.2f} cm at {at:.2f} cm runs past its end")
    return low, high


def _mouth_step(stroke: Stroke, centre: Point, low: float, high: float, width: float) -> tuple[float, Point]:
    """Residual [cm²] and Newton step of two equations: ends equally far from the centre, and ``width`` apart."""
    (px, py), (qx, qy) = stroke.at(low), stroke.at(high)
    (dpx, dpy), (dqx, dqy) = stroke.velocity(low), stroke.velocity(high)
    ax, ay, bx, by = px - centre[0], py - centre[1], qx - centre[0], qy - centre[1]
    uneven = ax * ax + ay * ay - bx * bx - by * by
    wide = (qx - px) ** 2 + (qy - py) ** 2 - width * width
    j00, j01 = 2 * (ax * dpx + ay * dpy), -2 * (bx * dqx + by * dqy)
    j10, j11 = -2 * ((qx - px) * dpx + (qy - py) * dpy), 2 * ((qx - px) * dqx + (qy - py) * dqy)
    determinant = j00 * j11 - j01 * j10
    step = ((j01 * wide - j11 * uneven) / determinant, (j10 * uneven - j00 * wide) / determinant)
    return max(abs(uneven), abs(wide)), step


def _aligned(shape: tuple[Stroke, ...], under: Stroke) -> tuple[Stroke, ...]:
    """The shape turned and moved onto the part of an edge that it replaces."""
    angle = atan2(under.chord[1], under.chord[0])
    return chain_from(under.start, *(side.rotated(angle) for side in shape))
