"""Checks of a pattern: each fault with its panel, edge, rule and figure.

An *error* makes a pattern impossible to sew: it would not mesh, or not as drawn. A pattern with a *warning* can be
meshed, and the fault may be intended (gathers), but it is typical of broken patterns.
"""

from collections import Counter
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from enum import Enum, StrEnum
from itertools import islice
from math import dist, hypot, isclose, log

import numpy as np
import shapely
from jaxtyping import Complex

from gcd_dataset.crossings import edge_hulls, find_crossings
from gcd_dataset.curves import LINE, Arc, curve_length, sample_curve
from gcd_dataset.errors import PatternError, shown
from gcd_dataset.records import Closure, EdgeRef, InnerLine, LineRole, Panel, Pattern, Seam

__all__ = ["MOST_EDGES", "MOST_PANELS", "Fault", "Rule", "Severity", "check_pattern", "require_valid"]

SHORTEST_EDGE = 0.5  # cm: shorter edges have defeated cloth simulators (a fifth of published patterns have one)
NARROWEST_DART = 0.5  # cm: a narrower dart is lost in the thickness of its own seam
NARROWEST_PANEL = 0.5  # cm: mean width of the narrowest binding
SMALLEST_PANEL = 4.0  # cm²: a smaller panel has no cloth left between its seams
LARGEST = 1000.0  # cm: a panel ten metres across is in the wrong unit
LONGEST_OUTLINE = 10_000.0  # cm: a ruffle of 8 m has an outline of 20 m
MOST_NAMES = 40  # most names listed in a message
MOST_PANELS = 200  # per garment; published and sampled garments have up to 24, a quilt a hundred
MOST_EDGES = 2000  # per panel: 10 m in steps of half a centimetre; published and sampled panels have up to 36
MOST_EDGES_IN_ALL = 10_000  # per garment; published and sampled garments have up to 350
WIDE = 400.0  # cm: a ruffle may be wider, but then most edges of the garment are shorter than LONG
LONG = 60.0  # cm: between the median edge of a garment and the median edge of a garment scaled by ten
HIGH = 400.0  # cm: higher than any panel hangs
LOW = 25.0  # cm: only shoes have their top so low
FLAT = 0.01  # ratio of the depth of a garment to its greatest extent: panels in one plane were never placed
ACROSS = 300.0  # cm: more than the second largest extent of any placed garment
TINY = 10.0  # cm: the largest panel of a garment that is not placed, even of a belt, is larger
USUAL = 90.0  # cm: the largest panel of a typical garment, to guess the unit
USUAL_ACROSS = 60.0  # cm: the second largest extent of a typical garment, a better guess if its panels are placed
UNITS = {"millimetres": 1000, "centimetres": 100, "inches": 39.37, "metres": 1}  # units per metre
CROSSWISE = 0.85  # a seam is crosswise if pairing its ends the other way shortens their distance to this share …
APART = 2.0  # … and by this much [cm]; published and sampled seams all keep a share of 0.9 or more
GATHER = 1.05 + 1e-6  # ratio of two lengths sewn together, above which cloth gathers visibly; skirts are eased by 1.05
LINE_POINTS = 65  # points along a line or an edge, to find where they meet
TOUCH = 0.01  # cm: a line and an edge so near to a common vertex meet there
SLACK = 0.5  # cm: a difference of two lengths that any seam absorbs


class Severity(StrEnum):
    """Whether a fault forbids sewing."""

    ERROR = "error"
    WARNING = "warning"


class Rule(Enum):
    """The checks; the value is the description of the fault in messages."""

    NO_PANEL = "no panels"
    MANY_PANELS = "too many panels"
    PANEL_NAME = "unusable panel name"
    FEW_EDGES = "too few edges"
    MANY_EDGES = "too many edges"
    VERTEX_RANGE = "vertex out of range"
    OPEN_LOOP = "open loop"
    NO_LENGTH = "edge without length"
    ARC_RADIUS = "arc radius under half its chord"
    TOO_LARGE = "panel over 10 m"
    UNLIKELY_SIZE = "size unlikely for a person"
    UNLIKELY_HEIGHT = "hangs above or below every person"
    SELF_CROSSING = "outline crosses itself"
    LINE = "line that cannot be drawn"
    LINE_CROSSING = "line meets the outline or a line"
    LINE_OUTSIDE = "line outside its panel"
    FOLD = "line that cannot be folded"
    NO_SUCH_EDGE = "stitch to a missing edge"
    STITCHED_TWICE = "edge stitched twice"
    LABELS_DIFFER = "stitched edges have different labels"
    CLOSURE = "closure that cannot be made"
    SHORT_EDGE = "edge under 0.5 cm"
    NARROW_DART = "dart under 0.5 cm"
    SMALL_PANEL = "panel too small to sew"
    SEAM_LENGTHS = "seam lengths differ"
    SEWN_CROSSWISE = "stitch joins the far ends"

    @property
    def severity(self) -> Severity:
        """Whether a pattern with this fault can still be sewn."""
        return Severity.WARNING if self in SEWABLE else Severity.ERROR


SEWABLE = frozenset(
    {
        Rule.UNLIKELY_SIZE,
        Rule.UNLIKELY_HEIGHT,
        Rule.SHORT_EDGE,
        Rule.NARROW_DART,
        Rule.SMALL_PANEL,
        Rule.SEAM_LENGTHS,
        Rule.SEWN_CROSSWISE,
    }
)


@dataclass(frozen=True, slots=True)
class Fault:
    """A broken rule, with panel and edge."""

    rule: Rule
    panel: str
    """Name of the panel; empty for a fault of the whole pattern."""
    edge: int | None
    """Index in the panel's loop; ``None`` for a fault of the whole panel."""
    figure: str
    """Measured numbers and remedy."""

    @property
    def severity(self) -> Severity:
        """The severity of its rule."""
        return self.rule.severity

    def __str__(self) -> str:
        position = [f"panel {shown(self.panel)}"] if self.panel else []
        position += [f"edge {self.edge}"] if self.edge is not None else []
        return f"{', '.join(position) or 'pattern'}: {self.severity}: {self.rule.value}: {self.figure}"


def check_pattern(pattern: Pattern) -> tuple[Fault, ...]:
    """All faults of a pattern, panel by panel, then seam by seam; empty if there is none."""
    if not pattern.panels:
        return (Fault(Rule.NO_PANEL, "", None, "there is nothing to sew: draw one"),)
    if len(pattern.panels) > MOST_PANELS:
        figure = f"{len(pattern.panels)}, more than {MOST_PANELS}: leave one garment in the file"
        return (Fault(Rule.MANY_PANELS, "", None, figure),)
    if (count := sum(len(panel.edges) for panel in pattern.panels)) > MOST_EDGES_IN_ALL:
        figure = f"{count}, more than {MOST_EDGES_IN_ALL}: draw curves instead of many lines"
        return (Fault(Rule.MANY_EDGES, "", None, figure),)
    faults = {number: list(_loop_faults(panel)) for number, panel in enumerate(pattern.panels)}
    units = _units(pattern)
    drawn = {number: edge_hulls(panel) for number, panel in enumerate(pattern.panels) if not faults[number]}
    for number in _may_be_large(drawn):
        # Checked before sampling: a huge panel would need too much memory.
        if huge := list(_size_faults(pattern.panels[number], drawn[number], units)):
            faults[number] += huge
            del drawn[number]
    edge_lengths = {number: pattern.panels[number].edge_lengths() for number in drawn}
    for number, edges in edge_lengths.items():
        name = pattern.panels[number].name
        faults[number] += [
            Fault(Rule.SHORT_EDGE, name, index, f"it is {length:.3g} cm: join it to its neighbour")
            for index, length in enumerate(edges)
            if length < SHORTEST_EDGE
        ]
        if (outline := sum(edges)) > LONGEST_OUTLINE:
            figure = f"its outline is {outline / 100:.0f} m long: check units_in_meter, and the curvature of its edges"
            faults[number].append(Fault(Rule.TOO_LARGE, name, None, figure))
            del drawn[number]
    crossings = list(_crossings(pattern.panels, drawn, edge_lengths))
    simple = {number: drawn[number] for number in drawn.keys() - dict(crossings).keys()}  # others have no area
    lined = ((number, fault) for number in simple for fault in _line_faults(pattern.panels[number]))
    for number, fault in (*crossings, *_small_panels(pattern.panels, simple), *lined):
        faults[number].append(fault)
    if sound := [number for number in simple if pattern.panels[number].lines and not faults[number]]:
        edge_lengths |= {number: pattern.panels[number].lengths() for number in sound}
    lengths = {
        EdgeRef(pattern.panels[number].name, index): length
        for number, edges in edge_lengths.items()
        for index, length in enumerate(edges)
    }
    of_panels = (fault for number in sorted(faults) for fault in faults[number])
    of_all = _unlikely_size(pattern, list(drawn.values()), lengths.values(), units) if len(drawn) == len(faults) else ()
    of_seams = (*_narrow_darts(pattern, lengths), *_seam_faults(pattern, lengths))
    return (*of_all, *_name_faults(pattern.panels), *of_panels, *of_seams)


def require_valid(pattern: Pattern, source: str = "") -> Pattern:
    """The pattern, if it has no error; ``source`` names its file in the message.

    Raises ``PatternError`` with the first error and the number of the others.
    """
    errors = [fault for fault in check_pattern(pattern) if fault.severity is Severity.ERROR]
    if errors:
        more = f" (and {len(errors) - 1} more: gcd check lists them)" if len(errors) > 1 else ""
        raise PatternError(f"{source or pattern.name}: {errors[0]}{more}")
    return pattern


def _name_faults(panels: Sequence[Panel]) -> Iterator[Fault]:
    """Panel names that are empty, unprintable or repeated: seams, mesh files and messages refer to panels by name."""
    for number, panel in enumerate(panels):
        if not panel.name.strip():
            yield Fault(Rule.PANEL_NAME, "", None, f"panel {number} of {len(panels)} has no name: give it one")
        elif shown(panel.name) != panel.name:
            yield Fault(Rule.PANEL_NAME, panel.name, None, "it holds an unprintable character: remove it")
    for name, count in Counter(panel.name for panel in panels if panel.name.strip()).items():
        if count > 1:
            yield Fault(Rule.PANEL_NAME, name, None, f"{count} panels have this name: give each its own")


def _loop_faults(panel: Panel) -> Iterator[Fault]:
    """Faults that keep the outline from being a closed curve."""
    count, corners, points = len(panel.edges), len(panel.vertices), panel.vertices.tolist()
    straight = all(edge.curve == LINE for edge in panel.edges)
    if count < (3 if straight else 2):
        kind = "straight" if straight else "curved"
        yield Fault(Rule.FEW_EDGES, panel.name, None, f"{count} {kind}: close the outline")
    if count > MOST_EDGES:
        figure = f"{count}, more than {MOST_EDGES}: draw curves instead of many lines"
        yield Fault(Rule.MANY_EDGES, panel.name, None, figure)
        return
    for index, edge in enumerate(panel.edges):
        outside = [vertex for vertex in (edge.start, edge.end) if not 0 <= vertex < corners]
        if outside:
            figure = f"vertex {outside[0]} of {corners}, numbered from 0: correct its endpoints"
            yield Fault(Rule.VERTEX_RANGE, panel.name, index, figure)
            continue
        before = panel.edges[index - 1]
        if before.end != edge.start and 0 <= before.end < corners:
            figure = f"it starts at vertex {edge.start}, edge {(index - 1) % count} ends at {before.end}: join them"
            yield Fault(Rule.OPEN_LOOP, panel.name, index, figure)
        chord = dist(points[edge.start], points[edge.end])
        if chord == 0.0:
            yield Fault(Rule.NO_LENGTH, panel.name, index, "its ends coincide: remove it, or move a vertex")
        elif isinstance(edge.curve, Arc):
            try:
                curve_length(*panel.edge_ends(index), edge.curve)
            except PatternError:
                figure = f"radius {edge.curve.radius:.4g} cm, chord {chord:.4g} cm: give {chord / 2:.4g} cm or more"
                yield Fault(Rule.ARC_RADIUS, panel.name, index, figure)


def _may_be_large(drawn: Mapping[int, Complex[np.ndarray, "e 4"]]) -> list[int]:
    """The panels to check for size: none if all coordinates are far below the limit, as in usual patterns."""
    # In the hull of a large arc the inner points lie at least one radius from the ends: its diameter is below LARGEST.
    if drawn and np.abs(np.concatenate(list(drawn.values()))).max() < LARGEST / 4:
        return []
    return list(drawn)


def _size_faults(panel: Panel, hulls: Complex[np.ndarray, "e 4"], units: float) -> Iterator[Fault]:
    """A fault if the outline or its control points extend too far."""
    radii = [edge.curve.radius if isinstance(edge.curve, Arc) and edge.curve.large else 0.0 for edge in panel.edges]
    # The end tangents of an arc over a half circle meet far outside of it: take its diameter instead.
    near = np.where(np.array(radii)[:, None] > 0, hulls[:, :1], hulls)
    across = float(max(np.ptp(near.real), np.ptp(near.imag), 2 * max(radii)))
    if not across <= LARGEST:
        figure = f"{across:.6g} cm across with its control points: {_probable_unit(across, units, USUAL / across)}"
        yield Fault(Rule.TOO_LARGE, panel.name, None, figure)


def _unlikely_size(
    pattern: Pattern, hulls: Sequence[Complex[np.ndarray, "e 4"]], lengths: Collection[float], units: float
) -> Iterator[Fault]:
    """A fault if the garment is too large or too small for a person, as with a wrong length unit."""
    corners, first = np.concatenate(hulls)[:, 0], np.cumsum([0, *map(len, hulls[:-1])])
    largest = max(
        float((np.maximum.reduceat(part, first) - np.minimum.reduceat(part, first)).max())
        for part in (corners.real, corners.imag)
    )
    highest = max(float(panel.placement.translation[1]) for panel in pattern.panels)
    if TINY <= largest <= WIDE and LOW <= highest <= HIGH:
        return
    points = np.concatenate([panel.placement.apply(panel.vertices) for panel in pattern.panels])
    extents, top = np.ptp(points, axis=0), float(points[:, 1].max())
    placed, across = extents[2] > FLAT * extents.max(), float(np.median(extents))
    if largest > WIDE and np.median(list(lengths)) > LONG:
        figure = f"its largest panel is {largest:.4g} cm, and half of its edges are over {LONG:.0f} cm"
    elif placed and across > ACROSS:
        figure = f"it extends over {across:.4g} cm in two directions, its largest panel is {largest:.4g} cm"
    elif (extents.max() if placed else largest) < TINY:
        figure = f"its largest panel is {largest:.4g} cm"
    else:
        if placed and not LOW <= top <= HIGH:
            figure = f"its top is {top:.0f} cm above the floor: correct the translations; gcd drape moves most garments"
            yield Fault(Rule.UNLIKELY_HEIGHT, "", None, figure)
        return
    scale = USUAL_ACROSS / across if placed and across else USUAL / largest
    yield Fault(Rule.UNLIKELY_SIZE, "", None, f"{figure}: {_probable_unit(largest, units, scale)}")


def _units(pattern: Pattern) -> float:
    """Length units in a metre, as declared in the pattern's file."""
    properties = pattern.extra.get("properties", {})
    units = properties.get("original_units_in_meter", properties.get("units_in_meter"))
    return float(units) if isinstance(units, int | float) and units > 0 else float(UNITS["centimetres"])


def _probable_unit(size: float, units: float, scale: float | None) -> str:
    """A remedy that names the unit in which the garment is about ``scale`` times as large.

    ``size``: as read, in the declared unit [cm]; ``units``: the declared length units in a metre.
    """
    if scale is not None:
        off = {unit: abs(log(units / per_metre / scale)) for unit, per_metre in UNITS.items()}
        likely = min(off, key=lambda unit: off[unit])
        if off[likely] < log(10) and not isclose(units, UNITS[likely]):
            drawn = size * units / UNITS[likely]
            return f"in {likely} it would be {drawn:.3g} cm: set properties.units_in_meter to {UNITS[likely]:g}"
    return f"check properties.units_in_meter, which is {units:g}"


def _small_panels(
    panels: Sequence[Panel], hulls: Mapping[int, Complex[np.ndarray, "e 4"]]
) -> Iterator[tuple[int, Fault]]:
    """Panel number and fault for panels with too little cloth; each curve is taken through its middle point."""
    for number, points in hulls.items():
        is_arc = np.array([isinstance(edge.curve, Arc) for edge in panels[number].edges])
        middles = np.where(is_arc, 0.5 * (points[:, 1] + points[:, 2]), points @ [0.125, 0.375, 0.375, 0.125])
        loop = np.stack([points[:, 0], middles], axis=1).ravel()
        area = 0.5 * abs(float((loop.conj() * np.roll(loop, -1)).imag.sum()))
        across = float(hypot(np.ptp(loop.real), np.ptp(loop.imag)))
        if area < max(SMALLEST_PANEL, NARROWEST_PANEL * across):
            figure = f"{area:.3g} cm² over a length of {across:.3g} cm: join it to its neighbour"
            yield number, Fault(Rule.SMALL_PANEL, panels[number].name, None, figure)


def _crossings(
    panels: Sequence[Panel], hulls: Mapping[int, Complex[np.ndarray, "e 4"]], lengths: Mapping[int, list[float]]
) -> Iterator[tuple[int, Fault]]:
    """Panel number and fault for edges that meet themselves or another edge outside a shared corner."""
    numbers = list(hulls)
    drawn = [panels[number] for number in numbers]
    for row, crossing in find_crossings(drawn, list(hulls.values()), [lengths[number] for number in numbers]):
        x, y = crossing.point
        figure = f"it meets edge {crossing.other} at ({x:.2f}, {y:.2f}) cm: part them"
        if crossing.edge == crossing.other:
            figure = "it crosses itself: bend it less"
        yield numbers[row], Fault(Rule.SELF_CROSSING, drawn[row].name, crossing.edge, figure)


def _line_faults(panel: Panel) -> Iterator[Fault]:
    """Lines that cannot be drawn, lie outside the outline, or meet it or another line apart from common vertices."""
    drawn: list[tuple[int, InnerLine, shapely.LineString]] = []
    for number, line in enumerate(panel.lines):
        try:
            ends = panel.edge_ends(len(panel.edges) + number)
            length = curve_length(*ends, line.curve)
        except (IndexError, PatternError):
            length = 0.0
        figure = f"line {number}, from vertex {line.start} to {line.end}: correct its ends and its curve"
        if is_drawn := min(line.start, line.end) >= 0 and length > 0:
            figure = f"line {number} has role {shown(line.role)}: give one of {', '.join(LineRole)}"
        if not is_drawn or line.role not in tuple(LineRole):
            yield Fault(Rule.LINE, panel.name, None, figure)
            continue
        drawn.append((number, line, shapely.LineString(sample_curve(*ends, line.curve, LINE_POINTS))))
    if not drawn:
        return
    edges = [sample_curve(*panel.edge_ends(i), edge.curve, LINE_POINTS)[:-1] for i, edge in enumerate(panel.edges)]
    cloth, corners = shapely.Polygon(np.concatenate(edges)), {edge.start for edge in panel.edges}
    for place, (number, line, points) in enumerate(drawn):
        others = [(f"line {n}", other, {own.start, own.end}) for n, own, other in drawn[:place]]
        for name, other, known in (("the outline", cloth.exterior, corners), *others):
            common = shapely.MultiPoint(panel.vertices[sorted(known & {line.start, line.end})])
            met = points.intersection(other).difference(common.buffer(TOUCH))
            if not met.is_empty or not points.is_simple:
                x, y = met.representative_point().coords[0] if not met.is_empty else points.coords[0]
                figure = f"line {number} meets {name} at ({x:.2f}, {y:.2f}) cm: part them, or end it at a vertex"
                yield Fault(Rule.LINE_CROSSING, panel.name, None, figure)
                break
        else:
            if line.angle and (fault := _unfolded(line, corners)):
                yield Fault(Rule.FOLD, panel.name, None, f"line {number} has a rest angle of {line.angle:g}°: {fault}")
            if not cloth.contains(points.interpolate(0.5, normalized=True)):
                yield Fault(Rule.LINE_OUTSIDE, panel.name, None, f"line {number}: draw it inside the outline")


def _unfolded(line: InnerLine, corners: Collection[int]) -> str:
    """Why cloth cannot be folded along a line, with the remedy; empty if it can."""
    if line.role != LineRole.FOLD:
        return f"its role is {shown(line.role)}, give it the role fold"
    if not abs(line.angle) <= 180.0:
        return "give -180 to 180"
    if line.curve != LINE or not {line.start, line.end} <= set(corners):
        return "draw it straight, from the outline to the outline"
    return ""


def _seam_faults(pattern: Pattern, lengths: dict[EdgeRef, float]) -> Iterator[Fault]:
    labels = {EdgeRef(p.name, i): edge.label for p in pattern.panels for i, edge in enumerate(p.edges)}
    labels |= {EdgeRef(p.name, len(p.edges) + i): "" for p in pattern.panels for i in range(len(p.lines))}
    edges_of = {panel.name: len(panel.edges) + len(panel.lines) for panel in pattern.panels}
    uses = Counter(side for seam in pattern.seams if not pattern.layers(seam) for side in (seam.left, seam.right))
    panels = {panel.name: panel for panel in pattern.panels}
    corners = {panel.name: panel.placement.apply(panel.vertices).tolist() for panel in pattern.panels}
    reported: set[EdgeRef] = set()
    for number, seam in enumerate(pattern.seams):
        missing = [side for side in (seam.left, seam.right) if side not in labels]
        for side in missing:
            yield _no_such_edge(number, side, edges_of)
        for side in (seam.left, seam.right):
            if uses[side] > 1 and side not in reported:
                reported.add(side)
                figure = f"stitch {number} is one of {uses[side]}: split the edge, or drop a stitch"
                yield Fault(Rule.STITCHED_TWICE, side.panel, side.edge, figure)
        if not missing:
            yield from _closure_fault(number, seam)
            yield from _unlike_sides(number, seam, labels, lengths)
        if seam.left in lengths and seam.right in lengths:
            yield from _crosswise(number, seam, panels, corners)


def _narrow_darts(pattern: Pattern, lengths: Collection[EdgeRef]) -> Iterator[Fault]:
    """Darts with a narrow mouth: neighbouring edges of a panel, sewn together from their common corner outwards."""
    sewn = {frozenset((seam.left, seam.right)) for seam in pattern.seams}
    panels = {panel.name: panel for panel in pattern.panels}
    for seam in pattern.seams:
        if seam.left.panel != seam.right.panel or seam.left not in lengths or seam.right not in lengths:
            continue
        panel, count = panels[seam.left.panel], len(panels[seam.left.panel].edges)
        if max(seam.left.edge, seam.right.edge) >= count:
            continue
        steps = (seam.right.edge - seam.left.edge) % count, (seam.left.edge - seam.right.edge) % count
        if 1 not in steps:
            continue
        first = seam.left.edge if steps[0] == 1 else seam.right.edge
        last = first + 1
        while last - first < count - 2:
            if {EdgeRef(panel.name, edge % count) for edge in (first - 1, last + 1)} not in sewn:
                break
            first, last = first - 1, last + 1
        start, end = panel.edges[first % count].start, panel.edges[last % count].end
        width = dist(*panel.vertices[[start, end]].tolist())
        if start != end and width < NARROWEST_DART:
            figure = (
                f"with edge {last % count} it is {width:.3g} cm wide: leave it out, and take its width in at a seam"
            )
            yield Fault(Rule.NARROW_DART, panel.name, first % count, figure)


def _no_such_edge(number: int, side: EdgeRef, edges_of: dict[str, int]) -> Fault:
    if side.panel not in edges_of:
        figure = f"stitch {number}: there is no panel of that name: there are {_listed(edges_of)}"
    else:
        figure = f"stitch {number}: the panel has {edges_of[side.panel]} edges, numbered from 0: correct the stitch"
    return Fault(Rule.NO_SUCH_EDGE, side.panel, side.edge, figure)


def _listed(names: Collection[str]) -> str:
    """The first names, for a message."""
    first = ", ".join(shown(name) for name in islice(names, MOST_NAMES))
    return first if len(names) <= MOST_NAMES else f"{first} and {len(names) - MOST_NAMES} more"


def _closure_fault(number: int, seam: Seam) -> Iterator[Fault]:
    start, end = seam.closed
    if seam.closure not in set(Closure):
        figure = f"{shown(str(seam.closure))}: give one of {', '.join(Closure)}"
    elif not 0.0 <= start <= end <= 1.0:
        figure = f"closed from {start:g} to {end:g}: give two shares of its length, in ascending order from 0 to 1"
    else:
        return
    yield Fault(Rule.CLOSURE, seam.left.panel, seam.left.edge, f"stitch {number}: {figure}")


def _unlike_sides(
    number: int, seam: Seam, labels: dict[EdgeRef, str], lengths: dict[EdgeRef, float]
) -> Iterator[Fault]:
    left, right = seam.left, seam.right
    partner = f"stitch {number} with panel {shown(right.panel)}, edge {right.edge}"
    if labels[left] and labels[right] and labels[left] != labels[right]:
        figure = f"{partner}: {shown(labels[left])} and {shown(labels[right])}: take one away"
        yield Fault(Rule.LABELS_DIFFER, left.panel, left.edge, figure)
    if left in lengths and right in lengths:
        shorter, longer = sorted((lengths[left], lengths[right]))
        if longer > GATHER * shorter and longer - shorter > SLACK:
            figure = f"{partner}: {lengths[left]:.2f} and {lengths[right]:.2f} cm, ratio {longer / shorter:.3f}"
            yield Fault(Rule.SEAM_LENGTHS, left.panel, left.edge, figure)


def _crosswise(
    number: int, seam: Seam, panels: Mapping[str, Panel], corners: Mapping[str, list[list[float]]]
) -> Iterator[Fault]:
    """A fault if the ends that a stitch joins hang far apart, and would be nearer when joined the other way.

    ``corners``: panel name to the panel's vertices in space [cm].
    """
    edges = [(corners[side.panel], panels[side.panel].edge(side.edge)) for side in (seam.left, seam.right)]
    (a, b), (c, d) = ((points[edge.start], points[edge.end]) for points, edge in edges)
    if not seam.right_wrong:
        c, d = d, c
    joined, other = dist(a, c) + dist(b, d), dist(a, d) + dist(b, c)
    if not (other < CROSSWISE * joined and joined - other > APART):
        return
    left, right = panels[seam.left.panel], panels[seam.right.panel]
    if left is not right and left.placement == right.placement:
        return  # drawn on one sheet and never placed: their positions are meaningless
    starts = "the starts of both meet" if seam.right_wrong else "the start of one meets the end of the other"
    figure = (
        f"stitch {number} with panel {shown(right.name)}, edge {seam.right.edge}: {starts}, {joined / 2:.1f} cm apart "
        f"as the panels hang, and {other / 2:.1f} cm the other way: draw one loop the other way round"
    )
    yield Fault(Rule.SEWN_CROSSWISE, left.name, seam.left.edge, figure)
